"""A beam that is moved amid a recording is named, and nothing else is called that."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import handlaser_gtsam as hl
from benchmarks import arm_errors
from handlaser_gtsam.results.warnings import DISPLACED

PLANES = np.array([[0.1, 0.2, 1.0, 0.05], [1.0, -0.3, 0.4, -0.6], [-0.4, 1.0, 0.5, -0.5]])
LOCATIONS = np.array([[0.05, 0.0, 0.04], [-0.03, 0.05, 0.05], [-0.02, -0.05, 0.06]])


def recorded(seed, moved=None, stations=42, noise=5e-5):
    """Return a recording in front of three plates in turn, and where beams meet them.

    `moved` changes locations and directions (3, 3) of the beams from the middle on. Poses are drawn
    until all beams meet their plate from 0.1 to 0.5 m.
    """
    rng = np.random.default_rng(seed)
    directions = np.array([[0.1, 0.0, 1.0], [-0.2, 0.1, 1.0], [0.0, -0.25, 1.0]])
    R, t, ranges, names = [], [], [], []
    while len(R) < stations:
        plane = PLANES[len(R) % 3]
        n = plane[:3] / np.linalg.norm(plane[:3])
        turn = Rotation.align_vectors(-n[None], [[0.0, 0.0, 1.0]])[0]
        turn = turn * Rotation.from_rotvec(rng.uniform(-0.6, 0.6, 3))
        at = rng.uniform(-0.2, 0.2, 3) + n * (rng.uniform(0.25, 0.5) - plane[3])
        r, v = LOCATIONS, directions / np.linalg.norm(directions, axis=1)[:, None]
        if moved is not None and len(R) >= stations // 2:
            r, v = moved(r, v)
        origin, ray = turn.apply(r) + at, turn.apply(v)
        s = -(origin @ n + plane[3]) / (ray @ n)
        if (s > 0.1).all() and (s < 0.6).all():
            R.append(turn.as_matrix())
            t.append(at)
            ranges.append(s + noise * rng.standard_normal(3))
            names.append("ABC"[len(names) % 3])
    t = np.array(t) + 1e-4 * rng.standard_normal((stations, 3))  # of the robot
    return hl.Recording(np.array(R), t, np.array(ranges), tuple(names), ("1", "2", "3"))


def bent(degrees):
    """Return what turns the second beam about x."""

    def moved(r, v):
        turned = Rotation.from_rotvec([np.radians(degrees), 0.0, 0.0]).apply(v)
        return r, np.where(np.arange(3)[:, None] == 1, turned, v)

    return moved


def shifted(metres):
    """Return what shifts the second beam to the side."""
    return lambda r, v: (r + np.where(np.arange(3)[:, None] == 1, [metres, 0.0, 0.0], 0.0), v)


@pytest.mark.slow
@pytest.mark.parametrize("moved", [bent(0.5), bent(1.0), shifted(3e-3)])
@pytest.mark.parametrize("seed", [1, 2])
def test_a_beam_that_was_moved_is_named_with_its_station(moved, seed):
    found = hl.calibrate(recorded(seed, moved))
    (warning,) = (one for one in found.warnings if one.code == DISPLACED)
    assert warning.values["target"] == "beam 2"
    assert abs(int(warning.values["station"]) - 22) <= 3
    assert found.verdict.code == "systematic-error"
    assert "beam 2" in found.verdict.sentence
    assert found.verdict.best.code == DISPLACED
    assert not any(one.warning for one in found.systematic)  # consequences are no findings


def test_how_far_the_spot_was_moved_is_told():
    found = hl.calibrate(recorded(3, shifted(1.5e-3)))
    (warning,) = (one for one in found.warnings if one.code == DISPLACED)
    assert warning.values["shift"] == pytest.approx(1.5e-3, rel=0.3)
    assert warning.values["turn_deg"] < 0.5


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(5))
def test_no_beam_of_a_good_recording_was_moved(seed):
    found = hl.calibrate(recorded(seed))
    assert found.verdict.usable
    assert not any(one.code == DISPLACED for one in found.warnings)


@pytest.mark.slow
def test_gross_errors_at_the_end_are_no_move():
    whole = recorded(4)
    ranges = whole.ranges.copy()
    ranges[[33, 36, 38, 41], 1] += [0.02, -0.05, 0.03, 0.07]
    found = hl.calibrate(replace(whole, ranges=ranges))
    assert len(found.fit.rejected) == 4
    assert not any(one.code == DISPLACED for one in found.warnings)


@pytest.mark.parametrize(("seed", "station"), [(1, 3), (5, 40)])
def test_one_gross_reading_near_an_end_is_no_move(seed, station):
    """The five unknowns of a move follow one gross reading among eight, as one rejection does."""
    whole = recorded(seed)
    ranges = whole.ranges.copy()
    ranges[station, 1] += 0.05
    found = hl.calibrate(replace(whole, ranges=ranges))
    assert [one.station for one in found.fit.rejected] == [str(station + 1)]
    assert not any(one.code == DISPLACED for one in found.warnings)


def test_a_large_turn_near_the_end_is_a_move_although_its_readings_are_rejected():
    """Derivatives leave millimetres of it: the beam before and after it are fitted as two."""
    found = hl.calibrate(recorded(1, bent(5.0)).part(np.arange(32)))
    assert len(found.fit.rejected) > 8
    (warning,) = (one for one in found.warnings if one.code == DISPLACED)
    assert (warning.values["target"], warning.values["station"]) == ("beam 2", "22")


@pytest.mark.slow
def test_a_plate_or_a_tool_frame_that_was_moved_is_no_beam():
    whole = recorded(5)
    late = np.arange(len(whole.ranges)) >= 21
    on_a = np.array([label == "A" for label in whole.plane_labels]) & late
    n = PLANES[0, :3] / np.linalg.norm(PLANES[0, :3])
    # A plate that comes nearer by 2 mm, and a tool frame that is logged 1 mm beside.
    r = np.array([[0.1, 0.0, 1.0], [-0.2, 0.1, 1.0], [0.0, -0.25, 1.0]])
    rays = np.einsum("sij,bj->sbi", whole.world_R_hand, r / np.linalg.norm(r, axis=1)[:, None])
    nearer = whole.ranges + np.where(on_a[:, None], 2e-3 / (rays @ n), 0.0)
    beside = whole.world_t_hand + np.where(late[:, None], 1e-3 * whole.world_R_hand[:, :, 0], 0.0)
    for poses, ranges in ((whole.world_t_hand, nearer), (beside, whole.ranges)):
        found = hl.calibrate(replace(whole, world_t_hand=poses, ranges=ranges))
        assert not any(one.code == DISPLACED for one in found.warnings)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [5, 6, 7])
@pytest.mark.parametrize("length", [0.02, 0.06])
def test_a_tool_frame_that_changed_between_plates_is_named(seed, length):
    """Plates follow it all but its tilt, and errors of the hand became large enough for the rest."""
    good = recorded(seed)
    order = np.argsort(good.plane_labels, kind="stable")
    late = np.arange(len(order)) >= 14
    t = good.world_t_hand[order] + late[:, None] * length * good.world_R_hand[order][:, :, 2]
    changed = replace(
        good,
        world_R_hand=good.world_R_hand[order],
        world_t_hand=t,
        ranges=good.ranges[order],
        plane_labels=tuple(good.plane_labels[i] for i in order),
        station_names=(),
    )
    found = hl.calibrate(changed)
    (warning,) = (one for one in found.warnings if one.code == DISPLACED)
    assert "tool frame" in warning.message
    assert warning.values["station"] == "15"
    assert warning.values["shift"] == pytest.approx(length, rel=0.2)
    assert found.verdict.code == "systematic-error"
    assert "the tool was moved" in found.verdict.sentence


@pytest.mark.slow
@pytest.mark.parametrize("seed", [3, 9])
def test_an_arm_that_errs_is_no_tool_that_was_moved(seed):
    """Though its poses are stated as exact, and it errs by three times as much as is usual."""
    scene = arm_errors.Scene(arm_errors.Case("beams", True, False, 3.0), seed)
    found = hl.calibrate(scene.recording(), hl.Noise(None, 0.0, 0.0))
    assert not any(one.code == DISPLACED for one in found.warnings)


@pytest.mark.slow
def test_a_beam_that_reads_something_else_than_one_plate_is_not_moved():
    """Its readings there are rejected, and the rest is as it was."""
    whole = recorded(6)
    order = np.argsort(np.array(whole.plane_labels), kind="stable")  # plate after plate
    ranges = whole.ranges[order].copy()
    ranges[28:, 1] += 0.04 + 0.1 * np.abs(np.sin(np.arange(14.0)))
    labels = tuple(whole.plane_labels[i] for i in order)
    R, t = whole.world_R_hand[order], whole.world_t_hand[order]
    found = hl.calibrate(hl.Recording(R, t, ranges, labels, whole.beam_names))
    assert not any(one.code == DISPLACED for one in found.warnings)
    (off,) = (one for one in found.warnings if one.code == "off-target")
    assert off.values == {"beam": "2", "target": "C", "readings": 14, "of": 14}
    assert found.verdict.code == "usable-with-care"


def test_a_single_beam_that_was_moved_is_the_tool_frame_as_well():
    whole = recorded(7, shifted(4e-3), stations=60)
    recording = replace(whole, ranges=whole.ranges[:, 1:2], beam_names=("2",))
    codes = {one.code for one in hl.calibrate(recording).warnings}
    assert codes & {DISPLACED, "systematic-tool-displaced"}


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
def test_pure_noise_of_few_readings_shows_no_systematic_error(seed):
    """A sum of squares that one reading leaves says nothing, however small it is."""
    few = recorded(seed, stations=12, noise=1e-4)
    few = replace(few, ranges=few.ranges[:, :2], beam_names=few.beam_names[:2])
    found = hl.calibrate(few)
    assert not any(one.found for one in found.systematic)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(6))
def test_good_readings_are_not_left_out_until_few_agree(seed):
    """Noise of a millimetre at 15 stations: with 30 unknowns, any choice of 41 of 45 fits better."""
    found = hl.calibrate(recorded(seed, stations=15, noise=1e-3))
    assert len(found.fit.rejected) <= 1


@pytest.mark.slow
def test_too_few_stations_to_have_moved_amid_them():
    whole = recorded(3)
    few = hl.calibrate(whole.part(np.arange(12)))
    assert not any(one.code == DISPLACED for one in few.warnings)


STATED = hl.Noise(range_sigma=5e-5)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1])
def test_a_true_range_sigma_does_not_let_poses_explain_a_beam_that_was_moved(seed):
    """Large pose errors would explain it at the stated sigma: the fit was off by 3 mm (seed 0)."""
    recording = recorded(seed, shifted(3e-3))
    found, free = hl.calibrate(recording, STATED), hl.calibrate(recording)
    assert found.verdict.code == "systematic-error"
    moved = [one for one in found.warnings if one.code == DISPLACED]
    assert [one.values["target"] for one in moved] == ["beam 2"]
    assert not found.fit.range_sigma_given
    (stated,) = (one for one in found.warnings if one.code == "sigmas-too-small")
    sigma = found.fit.range_sigma
    assert stated.values == {"stated": 5e-5, "sigma": sigma, "times": sigma / 5e-5}
    for name in ("1", "3"):
        one, other = found.beams[name], free.beams[name]
        assert (np.abs(one.location - other.location) < 0.1 * other.sigma[:3]).all()


@pytest.mark.parametrize("robot", [1.0, 10.0])
def test_large_errors_of_poses_do_not_contradict_a_true_range_sigma(robot):
    recording = recorded(4)
    rng = np.random.default_rng(4)
    t = recording.world_t_hand + robot * 1e-4 * rng.standard_normal((42, 3))
    found = hl.calibrate(replace(recording, world_t_hand=t), STATED)
    assert found.fit.range_sigma_given
    assert "sigmas-too-small" not in {one.code for one in found.warnings}


@pytest.mark.parametrize("seed", [5, 6, 10])
def test_gross_errors_that_were_not_rejected_are_no_move(seed):
    """Of 3 % of the readings by up to 1 mm: a move was named in 19 of about 150 such recordings."""
    recording, rng = recorded(seed), np.random.default_rng(seed)
    gross = rng.random(recording.ranges.shape) < 0.03
    ranges = recording.ranges + np.where(gross, rng.uniform(-1e-3, 1e-3, gross.shape), 0.0)
    found = hl.calibrate(replace(recording, ranges=ranges))
    assert not any(one.code == DISPLACED for one in found.warnings)
