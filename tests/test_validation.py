"""Predictions of readings that a calibration has not seen."""

import math
import runpy

import numpy as np
import pytest
from helpers import ROOT, first_and_slow, simulated

import handlaser_gtsam as hl
from handlaser_gtsam.validation.prediction import predict, reconstruction
from handlaser_gtsam.validation.scenes import Layout

NOISE = hl.Noise(3e-5)


@pytest.fixture(scope="module")
def validation(gripper):
    return hl.validate(gripper, NOISE, splits=4)


@pytest.mark.slow
def test_every_plane_is_left_out_in_turn(validation):
    assert [one.plane for one in validation.planes] == ["A", "B", "C", "D"]
    for one in validation.planes:
        assert one.result.p_value > 1e-3
        assert one.result.noise_p_value > 1e-3
        assert one.result.rms < 2 * 3e-5


@pytest.mark.slow
def test_splits_err_as_their_own_sigmas_say(validation):
    assert len(validation.splits) == 4
    mean = np.mean([one.standardized**2 for one in validation.splits])
    # Four times 48 predictions, some of them twice: a mean square to 15 % or so.
    assert 0.6 < mean < 1.5
    assert all(one.tests == 48 for one in validation.splits)


def test_a_reconstructed_plane_predicts_better_with_range_errors(validation):
    assert validation.reconstruction.tests == 4 * 11 * 10 * 4
    assert validation.reconstruction.rms < 0.3 * validation.without_range_error.rms
    assert np.isnan(validation.reconstruction.standardized)


def test_reconstruction_is_what_the_paper_describes(gripper):
    """By hand for one pair of stations: plane from four spots, ranges at the other station."""
    calibration = hl.calibrate(gripper, NOISE)
    part = hl.Recording(
        gripper.world_R_hand[:2],
        gripper.world_t_hand[:2],
        gripper.ranges[:2],
        gripper.plane_labels[:2],
        gripper.beam_names,
    )
    errors = []
    for here, there in ((0, 1), (1, 0)):
        plane = hl.measured_plane(
            calibration, dict(zip(part.beam_names, part.ranges[here], strict=True))
        )
        R, t = part.world_R_hand[here], part.world_t_hand[here]
        n = R @ plane.normal
        b = plane.offset - n @ t
        for i, beam in enumerate(calibration.beams.values()):
            R, t = part.world_R_hand[there], part.world_t_hand[there]
            s = -(n @ (R @ beam.location + t) + b) / (n @ R @ beam.direction)
            d = part.ranges[there, i]
            errors.append(s - d * (1 + beam.range_error[0] + beam.range_error[1] * d))
    found = reconstruction(calibration, part)
    assert found.tests == 8
    assert found.rms == pytest.approx(np.sqrt(np.mean(np.square(errors))))
    assert found.max_residual == pytest.approx(np.abs(errors).max())


def test_predictions_of_the_readings_themselves_are_the_residuals(gripper):
    calibration = hl.calibrate(gripper, NOISE)
    found = predict(calibration, gripper, NOISE)
    assert found.rms == pytest.approx(calibration.fit.rms, rel=1e-6)
    assert found.max_residual == pytest.approx(calibration.fit.max_residual, rel=1e-6)


def test_one_plane_and_one_beam_leave_less_to_validate():
    recording, _ = simulated("unplanned", Layout(1, 1, 32))
    found = hl.validate(recording, NOISE, hl.CalibrationOptions("none"), splits=2)
    assert found.planes == ()
    assert len(found.splits) == 2
    assert found.reconstruction is None


def test_what_is_no_calibration_is_not_validated():
    recording, _ = simulated("paper", Layout(1, 1, 5))
    with pytest.raises(hl.SolverError, match="no calibration to validate"):
        hl.validate(recording, NOISE)


@pytest.mark.parametrize("pose_sigmas", [(2e-5, 1e-4), (0.0, 0.0)])
@pytest.mark.parametrize("count", first_and_slow(200, 1000))
def test_the_bootstrap_agrees_with_the_covariance(gripper, pose_sigmas, count):
    """GTSAM's marginals and SciPy's Gauss-Markov matrix agree to 1e-5 (test_cross_check)."""
    bootstrap = runpy.run_path(str(ROOT / "examples" / "07_bootstrap.py"))["bootstrap"]
    ratio = bootstrap(
        gripper, hl.validation.Errors(3e-5, *pose_sigmas), np.random.default_rng(0), count
    )
    assert ratio.shape == (4, 8)
    # n draws tell a standard deviation to 1 / sqrt(2 n); the largest of 32 is within four of it.
    one = 1.0 / math.sqrt(2.0 * count)
    assert np.abs(ratio - 1.0).max() < 4.0 * one
    assert ratio.mean() == pytest.approx(1.0, abs=one)
