"""Variances from residuals: against the formula on dense matrices, and against the truth."""

import math

import numpy as np
import pytest
from handlaser_gtsam.variance_components import Wanted, estimate_components

import handlaser_gtsam as hl
from benchmarks.noise_components import NAMES, run_once
from handlaser_gtsam import model
from handlaser_gtsam.scenes import SCENES, Layout
from handlaser_gtsam.simulate import Errors, simulate
from handlaser_gtsam.weighting import Variances

RANGE, TRANSLATION, ROTATION = 3e-5, 5e-5, math.radians(0.03)


def robot(layout, errors=(RANGE, TRANSLATION, ROTATION), seed=4):
    rng = np.random.default_rng(seed)
    truth, stations = SCENES["paper"](layout, rng)
    recording = simulate(truth, stations, Errors(*errors), rng)
    readings = recording.readings()
    origins = readings.plane_means(readings.world_t_hand)
    return recording, readings.seen_from(origins), truth.seen_from(origins)


def dense_score(readings, at, variances):
    """Return fisher and right side of one scoring step by the textbook, on N x N matrices."""
    lin = model.linearize(model.scene(at, readings), readings.distance, with_pose=True)
    v, n = model.tangent_basis(at.directions), model.tangent_basis(at.normals)
    A = np.zeros((len(readings), 5 * readings.beams + 3 * readings.planes))
    for row, (i, p) in enumerate(zip(readings.beam, readings.plane, strict=True)):
        A[row, 5 * i : 5 * i + 3] = lin.location[row]
        A[row, 5 * i + 3 : 5 * i + 5] = lin.direction[row] @ v[i]
        first = 5 * readings.beams + 3 * p
        A[row, first : first + 2] = lin.normal[row] @ n[p]
        A[row, first + 2] = lin.offset[row]
    same = readings.station[:, None] == readings.station
    J = lin.pose
    S = variances.pose[0]
    Q = [np.diag(variances.range_sigma[readings.beam] ** 2)]
    for axes in (slice(3, 6), slice(0, 3)):
        Q.append(np.where(same, J[:, axes] @ S[axes, axes] @ J[:, axes].T, 0.0))
    inverse = np.linalg.inv(sum(Q))
    A = A / np.linalg.norm(A, axis=0)
    P = inverse - inverse @ A @ np.linalg.inv(A.T @ inverse @ A) @ A.T @ inverse
    e = lin.residual
    fisher = np.array([[np.trace(P @ a @ P @ b) for b in Q] for a in Q])
    return np.linalg.solve(fisher, [e @ P @ a @ P @ e for a in Q])


def test_the_estimate_is_the_fixed_point_of_the_textbook_formula():
    recording, readings, truth = robot(Layout(4, 5, 14))
    S = np.diag([ROTATION**2] * 3 + [TRANSLATION**2] * 3)
    pose = np.broadcast_to(S, (len(recording.plane_labels), 6, 6))
    start = Variances(np.full(4, RANGE), 0.0, pose)
    found = estimate_components(truth, readings, 0, start, Wanted(poses=True))
    assert [name for name, _ in found.parts] == ["range", "pose translation", "pose rotation"]
    assert (found.sigmas > 0.0).all()
    # At the estimate the same formula gives factors of one.
    assert np.allclose(dense_score(readings, truth, found.variances), 1.0, atol=1e-4)


@pytest.mark.parametrize(
    ("scene", "spread"), [("arm", (0.03, 0.07, 0.07)), ("paper", (0.04, 0.05, 0.4))]
)
def test_sigmas_are_estimated_from_thirteen_planes(scene, spread):
    """A small run of benchmarks.noise_components, which found these spreads of single runs."""
    ratio, said = run_once(0, scene)[:3], run_once(0, scene)[3:]
    assert len(ratio) == len(NAMES)
    assert (np.abs(ratio - 1.0) < 3.0 * np.array(spread)).all()
    # What is said of the errors is of the size of the spread; at a sigma of zero it is infinite.
    assert (said < 3.0 * np.array(spread))[ratio > 0.3].all()


def test_a_perfect_robot_gets_small_sigmas_and_says_how_sure_it_is():
    recording, _, _ = robot(Layout(4, 6, 15), (RANGE, 0.0, 0.0))
    options = hl.CalibrationOptions("none", estimate_noise=True)
    found = hl.calibrate(recording, options=options)
    by_name = {one.name: one for one in found.noise_estimate}
    assert by_name["range"].sigma == pytest.approx(RANGE, rel=0.2)
    assert by_name["pose translation"].sigma < 0.5 * RANGE
    assert 0.0 < by_name["range"].error < 0.2 * RANGE


def test_each_beam_may_have_its_own_sigma():
    recording, _, _ = robot(Layout(3, 5, 14), (RANGE, 0.0, 0.0))
    rng = np.random.default_rng(5)
    extra = np.array([0.0, 3.0, 6.0]) * RANGE
    noisy = recording.ranges + extra * rng.standard_normal(recording.ranges.shape)
    found = hl.calibrate(
        hl.Recording(
            recording.world_R_hand,
            recording.world_t_hand,
            noisy,
            recording.plane_labels,
            recording.beam_names,
        ),
        options=hl.CalibrationOptions("none", range_sigma_by_beam=True),
    )
    assert [one.name for one in found.noise_estimate] == [f"range of beam {i}" for i in "123"]
    sigma = np.array([one.sigma for one in found.noise_estimate])
    # Seventy readings a beam tell a sigma to 9 %.
    assert np.allclose(sigma, np.hypot(RANGE, extra), rtol=0.3)
    assert found.beams["3"].location_sigma.max() > found.beams["1"].location_sigma.max()


def test_an_unknown_range_sigma_is_estimated_beside_known_poses():
    recording, _, _ = robot(Layout(4, 6, 15))
    noise = hl.Noise(None, TRANSLATION, ROTATION)
    found = hl.calibrate(recording, noise, hl.CalibrationOptions("none"))
    assert found.fit.poses == "marginalised"
    assert not found.fit.range_sigma_given
    assert found.fit.range_sigma == pytest.approx(RANGE, rel=0.2)
    assert [one.name for one in found.noise_estimate] == ["range"]
    assert found.fit.sigma0 == pytest.approx(1.0, abs=0.05)


def test_what_cannot_be_estimated_is_refused():
    recording, _, _ = robot(Layout(2, 2, 6), (RANGE, 0.0, 0.0))
    with pytest.raises(hl.InputError, match="12 readings of beam 1; expected 15"):
        hl.calibrate(recording, options=hl.CalibrationOptions("none", range_sigma_by_beam=True))
    options = hl.CalibrationOptions("none", poses="exact", estimate_noise=True)
    with pytest.raises(hl.InputError, match="estimate_noise with exact poses"):
        hl.calibrate(recording, options=options)


def test_sigmas_that_are_hardly_told_are_named():
    """One beam cannot tell its own noise from that of the hand along it."""
    recording, _, _ = robot(Layout(1, 5, 20))
    options = hl.CalibrationOptions("none", estimate_noise=True)
    found = hl.calibrate(recording, options=options)
    assert any("hardly told by this recording" in words for words in found.warnings)
    assert found.fit.range_sigma > 0.0


def test_a_robust_loss_chooses_its_terms_before_the_noise_is_estimated():
    recording, _, _ = robot(Layout(3, 4, 14))
    options = hl.CalibrationOptions(loss="huber", estimate_noise=True)
    found = hl.calibrate(recording, options=options)
    assert {beam.terms for beam in found.beams.values()} == {0}


def test_predictions_carry_the_noise_that_was_estimated():
    recording, _, _ = robot(Layout(4, 5, 16))
    options = hl.CalibrationOptions("none", estimate_noise=True)
    found = hl.validate(recording, options=options, splits=4)
    mean = np.mean([one.standardized**2 for one in found.splits])
    assert 0.6 < mean < 1.5
    assert all(one.result.p_value > 1e-3 for one in found.planes)
