"""The simulated robot cell: what it says it does, checked without its own formulas."""

import math
from dataclasses import replace

import gtsam
import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp

import handlaser_gtsam as hl
from benchmarks import defaults, robot_cell, systematic_errors
from benchmarks.robot_arm import forward, pose_covariance
from benchmarks.robot_cell import CODES, Scene, cell

QUIET = Scene(joint_sigma_deg=0.0, range_sigma=0.0, a=0.3)
SIZES = {"lag": 0.03, "turn-scale": 0.002, "translation-scale": 0.003}
MM = 1e-3


def made(code="", size=0.0, scene=QUIET, seed=3, subject=None):
    scene = replace(scene, code=code, size=size, subject=subject)
    return cell(scene, np.random.default_rng(seed))


def spots(truth):
    """Where beams of the truth end in the world, (M, B, 3)."""
    R, t = truth.world_R_hand, truth.world_t_hand
    hand = truth.locations + truth.ranges[..., None] * truth.directions
    return np.einsum("mij,mbj->mbi", R, hand) + t[:, None]


def heights(truth):
    """How far the spots are above the plate, along its normal, (M, B) [m]."""
    away = spots(truth) - truth.plate_centres[:, None]
    return np.einsum("mbi,mi->mb", away, truth.plate_axes[:, :, 2])


def corrected(recording, truth):
    k1, k2 = truth.range_errors.T
    return recording.ranges * (1.0 + k1 + k2 * recording.ranges)


def test_the_forward_kinematics_are_those_of_a_ur5():
    """The arm stretched out, by hand: all lengths along -x, the wrist's offsets along -y and z."""
    R, t = forward(np.zeros((1, 6)))
    assert t[0] == pytest.approx([-0.81725, -0.10915 - 0.0823, 0.089159 - 0.09465], abs=1e-12)
    assert np.allclose(R[0].T @ R[0], np.eye(3), atol=1e-12)
    assert R[0, :, 2] == pytest.approx([0.0, -1.0, 0.0], abs=1e-12)


@pytest.mark.parametrize("beams", [4, 1])
@pytest.mark.parametrize("motion", [0.16, 1.0])
def test_without_errors_the_truth_is_found(beams, motion):
    recording, truth = made(scene=replace(QUIET, beams=beams, motion=motion))
    result = hl.calibrate(recording, hl.Noise(1e-4, 0.0, 0.0), hl.CalibrationOptions("k1k2"))
    found = result.parameters()
    # The readings are exact to rounding, and the range errors known a thousand times worse than r.
    assert np.allclose(found.locations, truth.locations, rtol=0.0, atol=1e-7)
    assert np.allclose(found.directions, truth.directions, rtol=0.0, atol=1e-7)
    assert np.allclose(found.range_errors, truth.range_errors, rtol=0.0, atol=1e-6)


def test_spots_lie_on_the_plate_and_readings_turn_into_ranges():
    recording, truth = made(scene=replace(QUIET, a=3.0, motion=1.0))
    assert np.abs(heights(truth)).max() < 1e-12
    assert np.abs(corrected(recording, truth) - truth.ranges).max() < 1e-14
    assert truth.ranges.min() >= 0.15
    assert truth.ranges.max() <= 0.45
    beam = np.einsum("mij,bj->mbi", truth.world_R_hand, truth.directions)
    cosine = np.einsum("mbi,mi->mb", beam, truth.plate_axes[:, :, 2])
    assert cosine.min() >= math.cos(math.radians(60.0))
    R, t = forward(truth.joints)
    assert np.array_equal(recording.world_R_hand, R)
    assert np.array_equal(recording.world_t_hand, t)


def test_errors_of_joints_have_the_covariance_stated():
    """Poses of 4000 draws of the errors at one posture, through gtsam's own tangent space."""
    joints = made()[1].joints[:1]
    rng = np.random.default_rng(1)
    sigma = math.radians(0.004)
    R, t = forward(np.repeat(joints, 4000, axis=0) + sigma * rng.standard_normal((4000, 6)))
    mean_R, mean_t = forward(joints)
    mean = gtsam.Pose3(gtsam.Rot3(mean_R[0]), mean_t[0])
    away = [mean.localCoordinates(gtsam.Pose3(gtsam.Rot3(a), b)) for a, b in zip(R, t, strict=True)]
    stated = pose_covariance(joints, sigma)[0]
    scale = np.sqrt(np.diagonal(stated))
    drawn = np.cov(np.array(away).T) / np.outer(scale, scale)
    # A variance of 4000 draws errs by 2.2 %: four of them.
    assert np.allclose(drawn, stated / np.outer(scale, scale), atol=0.09)


@pytest.mark.slow
def test_each_source_of_randomness_is_its_own():
    base, truth = made(scene=Scene())
    for other in (Scene(a=1.0), Scene(joint_sigma_deg=0.1), Scene(range_sigma=1e-3)):
        recording, again = made(scene=other)
        assert np.array_equal(recording.world_t_hand, base.world_t_hand)
        assert np.array_equal(again.locations, truth.locations)
        assert not np.array_equal(recording.ranges, base.ranges)
    quiet, _ = made(scene=replace(Scene(), range_sigma=0.0))
    difference = base.ranges - quiet.ranges
    # 312 draws: the standard deviation to 4 %, four of them.
    assert difference.std() == pytest.approx(1e-4, rel=0.16)
    errors = np.concatenate([made(scene=Scene(a=1.0), seed=s)[1].range_errors for s in range(200)])
    assert errors.std(axis=0) == pytest.approx([0.01, 0.2], rel=0.1)


@pytest.mark.parametrize("code", CODES)
def test_a_systematic_error_of_size_zero_is_none(code):
    clean, _ = made(scene=Scene(a=1.0))
    none, _ = made(code, 0.0, Scene(a=1.0))
    assert np.allclose(none.ranges, clean.ranges, rtol=0.0, atol=1e-14)
    assert np.allclose(none.world_t_hand, clean.world_t_hand, rtol=0.0, atol=1e-14)


@pytest.mark.parametrize("code", ["incidence", "cubic", "drift", "beam-on-plane"])
def test_errors_of_the_sensor(code):
    clean, truth = made()
    wrong, same = made(code, MM, subject=(2, 1))
    assert np.array_equal(same.ranges, truth.ranges)
    added = wrong.ranges - clean.ranges
    expected = np.zeros_like(added)
    if code == "incidence":
        beam = np.einsum("mij,bj->mbi", truth.world_R_hand, truth.directions)
        cosine = np.einsum("mbi,mi->mb", beam, truth.plate_axes[:, :, 2])
        expected = np.tan(np.arccos(cosine)) ** 2
    elif code == "cubic":
        expected = (wrong.ranges / wrong.ranges.max()) ** 3
    elif code == "drift":
        expected += np.arange(78)[:, None] / 77.0 - 0.5
    else:
        expected[26:39, 1] = 1.0
    assert np.allclose(added, MM * expected, rtol=0.0, atol=1e-14)


def test_a_sagging_plate_is_a_paraboloid():
    _, flat = made()
    recording, truth = made("sag", MM)
    assert np.abs(corrected(recording, truth) - truth.ranges).max() < 1e-14
    farthest = 0.0
    for plane in np.split(spots(flat), 6):
        middle = plane.reshape(-1, 3).mean(axis=0)
        farthest = max(farthest, np.linalg.norm(plane - middle, axis=2).max())
    away = spots(truth) - truth.plate_centres[:, None]
    height = heights(truth)
    across = (away**2).sum(axis=2) - height**2
    assert np.allclose(height, MM * across / farthest**2, rtol=0.0, atol=1e-14)


def test_a_displaced_plane():
    _, clean = made()
    recording, truth = made("displaced", MM, subject=(2, 5))
    assert np.abs(corrected(recording, truth) - truth.ranges).max() < 1e-14
    away = spots(truth) - clean.plate_centres[:, None]
    moved = np.einsum("mbi,mi->mb", away, clean.plate_axes[:, :, 2])
    expected = np.zeros((78, 4))
    expected[26 + 5 : 39] = MM
    assert np.allclose(moved, expected, rtol=0.0, atol=1e-12)
    assert (truth.ranges[31:39] > clean.ranges[31:39]).all()


def test_a_lag_is_a_share_of_the_motion():
    recording, truth = made("lag", SIZES["lag"])
    R, t = recording.world_R_hand, recording.world_t_hand
    assert np.abs(heights(truth)).max() < 1e-12
    for j, (before, after) in ((14, (13, 15)), (13, (13, 14)), (25, (24, 25))):
        share = SIZES["lag"] / (after - before)
        moved = truth.world_t_hand[j] - t[j]
        assert np.allclose(moved, share * (t[after] - t[before]), rtol=0.0, atol=1e-15)
        way = Slerp([0.0, 1.0], Rotation.from_matrix(R[[before, after]]))
        turn = (way(0.0).inv() * way(share)).as_matrix()
        assert np.allclose(truth.world_R_hand[j], R[j] @ turn, rtol=0.0, atol=1e-12)


def test_scales_of_the_robot():
    recording, truth = made("turn-scale", SIZES["turn-scale"])
    assert np.abs(heights(truth)).max() < 1e-12
    assert np.allclose(truth.world_t_hand, recording.world_t_hand, rtol=0.0, atol=1e-15)
    mean = Rotation.from_matrix(recording.world_R_hand).mean()
    angles = [
        (mean.inv() * Rotation.from_matrix(R)).magnitude()
        for R in (recording.world_R_hand, truth.world_R_hand)
    ]
    assert np.allclose(angles[1], 1.002 * angles[0], rtol=1e-9)
    recording, truth = made("translation-scale", SIZES["translation-scale"])
    assert np.allclose(1.003 * recording.world_t_hand, truth.world_t_hand, rtol=1e-14)
    assert np.array_equal(recording.ranges, made()[0].ranges)


def test_unknown_systematic_errors_are_refused():
    with pytest.raises(ValueError, match="warp"):
        Scene(code="warp")


@pytest.mark.slow
def test_the_study_of_the_defaults_judges_by_the_stated_covariance():
    """With the noise given and both terms free, NEES is 1 to what the recordings can tell."""
    runs = [defaults.run_once(defaults.Case(4, 0.3, True), seed) for seed in range(12)]
    found = [one["k1k2"] for one in runs]
    assert all(one is not None for one in found)
    # One NEES over 28 unknowns has a standard deviation of 0.27; four of that of the mean.
    bound = 4.0 * 0.27 / math.sqrt(len(found))
    assert np.mean([one.nees for one in found]) == pytest.approx(1.0, abs=bound)
    assert np.mean([one.covered for one in found]) > 0.85
    assert max(one.farthest for one in found) < defaults.FAR


@pytest.mark.slow
@pytest.mark.parametrize("seed", [41, 104, 109])
def test_range_errors_that_all_beams_share_are_not_explained_away(seed):
    """Beams that hardly differ say nothing of what they share, and k was up to 7 sigma off."""
    one = defaults.run_once(defaults.Case(4, 1.0, given=True, kind="alike"), seed)["auto"]
    assert one.farthest < 4.5


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1, 6])
def test_range_errors_that_cancel_are_not_explained_away(seed):
    """The motion sees the sum of both terms, which is nothing, and k was up to 10 sigma off."""
    one = defaults.run_once(defaults.Case(4, 1.0, given=True, kind="parabola"), seed)["auto"]
    assert one.farthest < 4.5
    assert one.mount_nees < 2.5


@pytest.mark.slow
@pytest.mark.parametrize("seed", [3, 8, 13])
def test_beams_may_read_from_different_distances(seed):
    """Each trimmed at zero and twice its distance; with axes in common k was up to 23 sigma off."""
    scene, rng = Scene(beams=4, motion=robot_cell.MOTION, a=0.0), np.random.default_rng(seed)
    recording, truth = cell(scene, rng)
    back = np.array([0.0, 0.3, 1.0, 2.0])
    s = truth.ranges + back
    k1 = 0.01 * rng.standard_normal(4)
    k = np.column_stack((k1, -0.5 * k1 / np.median(s, axis=0)))
    ranges = robot_cell.readings_of(s, k) + 1e-4 * rng.standard_normal(s.shape)
    result = hl.calibrate(replace(recording, ranges=ranges), defaults.stated_noise(scene, truth))
    true = np.hstack((truth.locations - back[:, None] * truth.directions, truth.directions, k))
    found = defaults.judge(result, true)
    assert found.farthest < 4.5
    assert found.nees < 3.0


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 3])
def test_a_sensor_may_be_far_worse_than_its_data_sheet(seed):
    """300 times here; with scales up to 90 times the linearity k was 11 and 12 sigma off."""
    scene = robot_cell.Scene(beams=4, motion=robot_cell.MOTION, a=10.0)
    recording, truth = robot_cell.cell(scene, np.random.default_rng(seed))
    options = hl.CalibrationOptions(sensor=hl.Sensor(linearity=3e-4))
    result = hl.calibrate(recording, defaults.stated_noise(scene, truth), options)
    true = np.hstack((truth.locations, truth.directions, truth.range_errors))
    assert defaults.judge(result, true).farthest < 4.5


def test_a_regression_finds_the_ratio():
    rng = np.random.default_rng(2)
    stated = rng.standard_normal((50, 2, 4, 3))
    runs = [systematic_errors.Injected(True, True, 0.9 * one, one) for one in stated]
    slope, rest = systematic_errors.regression(runs, 0)
    assert slope == pytest.approx(0.9)
    assert rest == pytest.approx(0.0, abs=1e-12)
    assert set(systematic_errors.LOCAL) <= set(robot_cell.CODES)
