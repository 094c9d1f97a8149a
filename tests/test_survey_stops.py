"""Several shots where the hand stands still: its error is common to them, and copies count once."""

import time
from functools import cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import handlaser_gtsam as hl
from benchmarks import rigs, rigs_by_rays
from handlaser_gtsam.data.station_list import StationList

NOISE = 3e-5 / np.sqrt(5.0)
"""Of a point of a profile [m]: 40 points tell as much as 200 with 0.03 mm."""


def survey_of(rig, shots, jitter=0.0, copies=False):
    """Return a survey of a rig with so many shots a stop, each with noise of its own, or copied."""
    rng = np.random.default_rng(1)
    (table,) = rig.tables.values()
    stations = len(rig.label)
    station = np.concatenate([table["station"] + stations * shot for shot in range(shots)])
    z = np.concatenate(
        [table["z"] + NOISE * rng.standard_normal(len(table["z"])) for _ in range(shots)]
    )
    if copies:
        z = np.tile(z[: len(table["z"])], shots)
    t = np.tile(rig.t, (shots, 1))
    t[stations:] += jitter * rng.standard_normal((len(t) - stations, 3))
    poses = hl.StationList(np.tile(rig.R, (shots, 1, 1)), t, tuple(rig.label) * shots)
    return hl.Survey(
        poses, (hl.Shots.profiler("profiler", station, np.tile(table["x"], shots), z),)
    )


def rig_of(seed):
    """Return a rig whose profiles have every fifth point only, which are 40 at most."""
    options = {"targets": "planes+sphere", "planes": 2, "spheres": 1, "stations": 7}
    rig = rigs_by_rays.profiler(seed, sigma=0.0, hand_sigma=rigs.HAND, **options)
    (table,) = rig.tables.values()
    few = np.arange(len(table["z"])) % 5 == 0
    table.update({column: table[column][few] for column in ("station", "x", "z")})
    return rig


@cache
def calibrated(shots, jitter=0.0):
    """Return the calibration of one rig, with stated errors of the hand; nobody may change it."""
    return hl.calibrate(survey_of(rig_of(3), shots, jitter), rigs.STATED)


def test_stations_within_the_error_of_the_hand_are_of_one_stop():
    t = np.array([[0.0, 0.0, 0.0], [5e-5, 0.0, 0.0], [2e-4, 0.0, 0.0], [0.0, 0.0, 0.0]])
    R = np.tile(np.eye(3), (4, 1, 1))
    R[3] = [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
    stations = StationList(R, t, ("A",) * 4)
    assert stations.stops(1e-4, 1e-3).tolist() == [0, 0, 2, 3]
    assert stations.stops(0.0, 0.0).tolist() == [0, 1, 2, 3]


def test_stops_of_a_hand_that_turns_about_a_point_are_found_in_linear_time():
    """All places are near each other there: compared in pairs, these took a minute."""
    turns = Rotation.random(2000, random_state=1)
    R = np.concatenate(
        (turns.as_matrix(), (turns * Rotation.from_rotvec([1e-4, 0, 0])).as_matrix())
    )
    stations = StationList(R, np.zeros((len(R), 3)), ("A",) * len(R))
    before = time.process_time()
    first = stations.stops(1e-4, 1.1e-4)
    assert time.process_time() - before < 5.0
    assert (first[2000:] == first[:2000]).all()
    assert (stations.stops(1e-4, 0.9e-4) == np.arange(4000)).all()


@pytest.mark.slow
@pytest.mark.parametrize("jitter", [0.0, 4e-6])
def test_more_shots_of_a_stop_do_not_lessen_the_error_of_the_hand(jitter):
    one, three = (found.sensors["profiler"] for found in (calibrated(1), calibrated(3, jitter)))
    # As three times as many stops they made these 0.58 of what they are.
    assert (
        np.sqrt(np.diagonal(three.covariance)[:6] / np.diagonal(one.covariance)[:6]) > 0.9
    ).all()
    assert np.linalg.norm(three.location - one.location) < one.spot_error


@pytest.mark.slow
def test_a_hand_that_comes_back_less_well_than_readings_are_known_contradicts_nothing():
    """Arms repeat a pose to some hundredths of a millimetre; readings of a shot tell micrometres."""
    found = hl.calibrate(survey_of(rig_of(3), 3, jitter=2e-5))
    assert found.usable
    assert not found.rejected
    assert 0.1 < found._found.noise.again < 1.0


@pytest.mark.slow
def test_errors_are_as_large_as_stated_with_four_shots_a_stop():
    squares = []
    for seed in range(5):
        rig = rig_of(seed)
        result = hl.calibrate(survey_of(rig, 4), rigs.STATED)
        ((error, C),) = rigs.errors_of(rig, result)
        squares.append(float(error @ np.linalg.solve(C, error)))
    # 30 numbers of variance one: between these with 99.9 %.
    assert 0.36 < np.mean(squares) / 6.0 < 2.07


@pytest.mark.slow
def test_copies_of_a_shot_count_once():
    rig = rig_of(4)
    one = hl.calibrate(survey_of(rig, 1))
    twice = hl.calibrate(survey_of(rig, 2, copies=True))
    C = one.sensors["profiler"].covariance
    assert np.abs(twice.sensors["profiler"].covariance - C).max() <= 1e-6 * np.abs(C).max()
    (warning,) = [one for one in twice.warnings if one.code == "repeated-stations"]
    assert warning.values["repeated"] == len(rig.label)
    assert "repeated-stations" not in [one.code for one in one.warnings]


@pytest.mark.slow
def test_the_reference_counts_errors_of_a_stop_once():
    checked = hl.cross_check(calibrated(3))
    # Readings of few points count noise along and across the profile to first order.
    assert checked.largest < 0.1
    assert checked.largest_sigma < 1e-3
