"""Simulated recordings: what the scenes promise."""

import numpy as np
import pytest
from helpers import simulated

from handlaser_gtsam.errors import InputError
from handlaser_gtsam.model.sensor_limits import Sensor
from handlaser_gtsam.validation import scenes
from handlaser_gtsam.validation.scenes import ERRORS, SENSORS, Layout
from handlaser_gtsam.validation.simulate import Errors, plane_name, read_back, simulate


@pytest.mark.parametrize("seed", range(5))
def test_the_paper_scene_stays_within_30_mm(seed):
    recording, truth = simulated("paper", Layout(planes=13), range_sigma=0.0, seed=seed)
    assert recording.ranges.shape == (13 * 11, 4)
    assert recording.ranges.min() > 0.0
    assert recording.ranges.max() < 0.030
    assert np.allclose(np.linalg.norm(truth.directions, axis=1), 1.0)


def test_the_paper_scene_holds_its_designed_motions():
    recording, _ = simulated("paper")
    R = recording.world_R_hand[:11]
    assert np.array_equal(R[:4], np.tile(np.eye(3), (4, 1, 1)))
    assert np.array_equal(R[4], R[5])
    assert np.array_equal(R[6], R[7])
    assert np.linalg.matrix_rank(np.diff(recording.world_t_hand[:4], axis=0)) == 3


def test_the_arm_scene_never_repeats_a_rotation():
    recording, _ = simulated("arm")
    R = recording.world_R_hand.reshape(-1, 9)
    assert len(np.unique(R.round(6), axis=0)) == len(R)


def test_noise_has_the_size_asked_for():
    layout = Layout(planes=13, stations=40)
    quiet, _ = simulated("arm", layout, range_sigma=0.0)
    noisy, _ = simulated("arm", layout, range_sigma=1e-3)
    difference = noisy.ranges - quiet.ranges
    # 2080 draws: the standard deviation to 1.6 %, three of them.
    assert difference.std() == pytest.approx(1e-3, rel=0.05)


def test_pose_errors_move_readings_but_not_recorded_poses():
    rng = np.random.default_rng(1)
    truth, stations = scenes.paper(Layout(), rng)
    exact = simulate(truth, stations, Errors(0.0), np.random.default_rng(2))
    moved = simulate(truth, stations, Errors(0.0, 5e-5, 5e-4, (1,)), np.random.default_rng(2))
    assert np.array_equal(exact.world_R_hand, moved.world_R_hand)
    assert 1e-6 < np.nanstd(moved.ranges - exact.ranges) < 1e-4


@pytest.mark.parametrize("errors", [Errors(0.0, 5e-5), Errors(0.0, 0.0, 5e-4)])
def test_each_pose_error_moves_readings_by_itself(errors):
    truth, stations = scenes.paper(Layout(), np.random.default_rng(1))
    exact = simulate(truth, stations, Errors(0.0), np.random.default_rng(2))
    moved = simulate(truth, stations, errors, np.random.default_rng(2))
    # 0.05 mm, and 0.5 mrad about the hand's origin with spots a few centimetres away.
    assert 2e-6 < np.nanstd(moved.ranges - exact.ranges) < 1e-4


def test_the_sensor_leaves_out_what_it_cannot_measure():
    rng = np.random.default_rng(1)
    truth, stations = scenes.paper(Layout(), rng)
    recording = simulate(truth, stations, Errors(0.0), rng, Sensor(0.005, 0.020))
    assert np.isnan(recording.ranges).any()
    assert np.nanmin(recording.ranges) >= 0.005
    assert np.nanmax(recording.ranges) <= 0.020


def test_same_seed_same_recording():
    first, _ = simulated(seed=7)
    again, _ = simulated(seed=7)
    other, _ = simulated(seed=8)
    assert np.array_equal(first.ranges, again.ranges)
    assert not np.array_equal(first.ranges, other.ranges)


def test_the_papers_errors():
    assert ERRORS["paper"] == Errors(3e-5, 5e-5, np.radians(0.03), (1,))
    assert SENSORS["paper"].range_max == 0.030


@pytest.mark.parametrize("k", [[-2.0, 0.0], [0.0, -1000.0]])
def test_range_errors_without_a_reading_are_refused(k):
    with pytest.raises(InputError, match="turn the reading back"):
        read_back(np.array([0.03]), np.array([k]))


@pytest.mark.parametrize("sigma", [-1.0, np.nan, np.inf])
def test_errors_that_cannot_be_are_refused(sigma):
    with pytest.raises(InputError, match="range_sigma"):
        Errors(sigma)


@pytest.mark.parametrize("size", ["beams", "planes", "stations"])
def test_sizes_below_one_are_refused(size):
    with pytest.raises(InputError, match=size):
        Layout(**{size: 0})


def test_plane_names_go_on_after_z():
    assert [plane_name(i) for i in (0, 25, 26, 53)] == ["A", "Z", "A1", "B2"]
