"""Predictions of readings that a calibration has not seen."""

import json
import math
import runpy

import numpy as np
import pytest
from helpers import ROOT, simulated

import handlaser_gtsam as hl
from benchmarks import rigs_by_rays
from benchmarks.rigs import HAND, STATED, survey_of
from handlaser_gtsam.files.validation_json import validation_text
from handlaser_gtsam.validation.prediction import predict, reconstruction
from handlaser_gtsam.validation.scenes import Layout
from handlaser_gtsam.validation.validation import drawn, verdict_of_validation

NOISE = hl.Noise(3e-5)


@pytest.fixture(scope="module")
def validation(gripper):
    return hl.validate(gripper, NOISE, splits=4)


@pytest.mark.slow
def test_every_plane_is_left_out_in_turn(validation):
    assert [one.name for one in validation.targets] == ["A", "B", "C", "D"]
    for one in validation.targets:
        assert one.result.p_value > 1e-3
        assert one.result.noise_p_value > 1e-3
        assert one.result.rms < 2 * 3e-5


@pytest.mark.slow
def test_splits_err_as_their_own_sigmas_say(validation):
    assert len(validation.splits) == 4
    mean = np.mean([one.standardized**2 for one in validation.predictions])
    # Four times 48 predictions, some of them twice: a mean square to 15 % or so.
    assert 0.6 < mean < 1.5
    assert all(one.tests == 48 for one in validation.predictions)


def test_a_reconstructed_plane_predicts_better_with_range_errors(validation):
    chosen, without = validation.reconstructions
    assert chosen.tests == 4 * 11 * 10 * 4
    assert chosen.rms < 0.3 * without.rms
    assert np.isnan(chosen.standardized)


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
    assert found.targets == ()
    assert len(found.predictions) == 2
    assert found.reconstructions == ()


def test_what_is_no_calibration_is_not_validated():
    recording, _ = simulated("paper", Layout(1, 1, 5))
    with pytest.raises(hl.SolverError, match="no calibration to validate"):
        hl.validate(recording, NOISE)


@pytest.mark.slow
@pytest.mark.parametrize("pose_sigmas", [(2e-5, 1e-4), (0.0, 0.0)])
def test_the_bootstrap_agrees_with_the_covariance(gripper, pose_sigmas):
    """GTSAM's marginals and SciPy's Gauss-Markov matrix agree to 1e-5 (test_cross_check)."""
    count = 200
    bootstrap = runpy.run_path(str(ROOT / "examples" / "07_bootstrap.py"))["bootstrap"]
    ratio = bootstrap(
        gripper, hl.validation.Errors(3e-5, *pose_sigmas), np.random.default_rng(0), count
    )
    assert ratio.shape == (4, 8)
    # n draws tell a standard deviation to 1 / sqrt(2 n); the largest of 32 is within four of it.
    one = 1.0 / math.sqrt(2.0 * count)
    assert np.abs(ratio - 1.0).max() < 4.0 * one
    assert ratio.mean() == pytest.approx(1.0, abs=one)


def test_a_random_split_leaves_out_30_percent_of_every_group():
    groups = np.repeat([0, 1, 2, 5], [10, 3, 1, 20])
    draws = np.array([drawn(groups, np.random.default_rng(seed)) for seed in range(400)])
    left_out = np.array([draws[:, groups == group].sum(axis=1) for group in (0, 1, 2, 5)])
    assert (left_out == np.array([[3], [1], [0], [6]])).all()
    # Each is as likely as the others: of 400 draws, a share of 0.3 varies by 0.023.
    assert np.abs(draws[:, groups == 5].mean(axis=0) - 0.3).max() < 4.0 * 0.023


@pytest.mark.slow
def test_a_part_that_is_not_predicted_has_a_reason_and_null_for_its_numbers():
    """The second plane alone, and three of its stations, determine no beam."""
    recording, _ = simulated(layout=Layout(planes=2))
    rows = np.arange(len(recording.plane_labels))
    few = recording.part(rows[(recording.plane_of_station == 0) | (rows % 11 < 2)])
    options = hl.CalibrationOptions("none", poses="exact")
    found = hl.validate(few, NOISE, options, splits=1)
    first, last = found.targets
    assert first.result is None
    assert "determine" in first.message
    assert np.isnan(first.p_value)
    assert last.p_value == last.result.p_value
    text = json.loads(validation_text(found, found.verdict))
    missing, known = text["planes_left_out"]
    assert list(missing) == list(known)
    assert (missing["plane"], missing["message"]) == (first.name, first.message)
    assert {missing[name] for name in list(missing)[2:]} == {None}
    assert known["rms_m"] == last.result.rms
    (split,) = text["splits"]
    assert found.predictions == ()
    assert (split["name"], split["tests"]) == ("1", None)
    assert "determine" in split["message"]


@pytest.mark.slow
def test_spots_move_by_chance_as_far_as_is_said():
    """Of 32 parts and random splits, which overlap, 95 % are expected within what holds 95 %."""
    found = [
        hl.validate(survey_of(rigs_by_rays.profiler(seed, hand_sigma=HAND)), STATED, splits=4)
        for seed in range(5)
    ]
    parts = [one.result for each in found for one in (*each.targets, *each.splits)]
    ratio = np.array([one.shift / one.by_chance for one in parts if one is not None])
    assert len(ratio) > 25
    assert (ratio < 1.0).mean() > 0.85
    assert 0.2 < np.median(ratio) < 0.6  # 0.34 along one axis, 0.55 along three alike


@pytest.mark.slow
def test_a_survey_takes_no_options_and_counts_its_parts():
    survey = survey_of(rigs_by_rays.beams(3, targets="planes+sphere"))
    with pytest.raises(hl.InputError, match="options with a survey"):
        hl.validate(survey, options=hl.CalibrationOptions())
    told = []
    found = hl.validate(survey, STATED, splits=1, progress=told.append)
    parts = [one for one in told if one.phase == "leave-out"]
    assert [(one.done, one.total) for one in parts] == [(i, 5) for i in range(5)]
    assert [one.name for one in found.targets] == ["plane:A", "plane:B", "sphere:S1"]
    assert parts[1].name == "without plane:A"
    assert found.verdict.confirmed_by == 0
    strict = verdict_of_validation(found, hl.Limits(location_sigma=1e-9))
    assert (strict.code, strict.usable) == ("outside-limits", False)
    text = json.loads(validation_text(found, found.verdict))
    assert text["format"] == "handlaser-survey-validation"
    assert text["targets_left_out"][0]["shift_m"] == found.targets[0].result.shift
    assert text["targets_left_out"][0]["by_chance_m"] == found.targets[0].result.by_chance
    assert text["contradicted"] == []
