"""The command line: robot errors, noise and validation."""

import json
import math
import re
from dataclasses import replace

import numpy as np
import pytest
from helpers import GRIPPER, degenerate

import handlaser_gtsam as hl

RECORDING, RIG = str(GRIPPER / "recording.csv"), str(GRIPPER / "rig.toml")
QUICK = ("--poses", "exact", "--range-error", "k1k2")
"""What is true of the shipped recording, so that little is left to estimate."""
POSES = ("--pose-translation-sigma-mm", "0.02", "--pose-rotation-sigma-deg", "0.01")


def one_line_each(text):
    """Return what was printed with its continued lines joined."""
    return text.replace("\n  ", " ").splitlines()


@pytest.mark.slow
@pytest.mark.parametrize("poses", ["auto", "marginalised", "estimated"])
def test_robot_errors_widen_the_result(handlaser, poses):
    code, out, _ = handlaser("calibrate", RECORDING, "--rig", RIG, "--json")
    exact = json.loads(out)
    arguments = ("calibrate", RECORDING, "--rig", RIG, *POSES, "--poses", poses, "--json")
    code, out, _ = handlaser(*arguments)
    found = json.loads(out)
    assert code == 0
    assert found["fit"]["poses"] == ("marginalised" if poses == "auto" else poses)
    for mine, other in zip(found["beams"], exact["beams"], strict=True):
        assert mine["sigma"]["location_m"][0] > other["sigma"]["location_m"][0]


@pytest.mark.slow
def test_sigmas_that_are_not_given_are_estimated(handlaser):
    """Those of the robot too, unless it is stated to be exact."""
    estimated = {}
    for poses in ("auto", "estimated", "exact"):
        code, out, _ = handlaser("calibrate", RECORDING, "--poses", poses, "--json")
        assert code == 0
        estimated[poses] = {one["name"] for one in json.loads(out)["fit"]["noise_estimate"]}
    assert estimated["auto"] == {"range", "pose translation", "pose rotation"}
    assert estimated["estimated"] == estimated["auto"]
    assert estimated["exact"] <= {"range"}


def test_counting_the_errors_of_an_exact_robot_is_refused(refusal):
    zero = ("--pose-translation-sigma-mm", "0", "--pose-rotation-sigma-deg", "0")
    assert "poses estimated with pose sigmas of zero" in refusal(
        "calibrate", RECORDING, *zero, "--poses", "estimated"
    )


@pytest.mark.slow
def test_the_result_says_what_the_tables_say(handlaser):
    arguments = ("calibrate", RECORDING, "--rig", RIG, *POSES, "--at-range-mm", "20")
    code, out, _ = handlaser(*arguments, "--json")
    found = json.loads(out)
    beam = found["beams"][0]
    low, high = beam["interval_95"]["location_m"][0]
    assert low < beam["location_m"][0] < high
    assert beam["spot"]["reading_m"] == pytest.approx(0.02)
    low_k, high_k = beam["interval_95"]["k2_per_m"]
    assert beam["range_error_excludes_zero"]["k2_per_m"] == (not low_k < 0.0 < high_k)
    assert np.array(found["beam_covariance"]).shape == (32, 32)
    assert np.allclose(np.array(found["beam_covariance"])[:8, :8], beam["covariance"])
    code, out, _ = handlaser(*arguments, "--verbose")
    assert code == 0
    assert f"{1e3 * low:.3f}" in out
    out = " ".join(out.split())
    assert "laser spots. At a reading of 20.00 mm" in out
    assert "A plane measured by all beams at once, as at station" in out
    assert "hand poses: marginalised" in out
    assert "beam 1 k1 beam 1 k2 -0.9" in out  # correlated
    words = re.search(r"zero is excluded \(95 %\) for (.*?) hand poses:", out)[1]
    named = [beam["range_error_excludes_zero"]["k1"] for beam in found["beams"]]
    k1 = re.search(r"k1 of (all beams|beams? ([\d, ]+))", words)
    listed = [name in k1[0] for name in "1234"] if k1 and k1[2] else [k1 is not None] * 4
    assert listed == named


@pytest.mark.slow
def test_estimated_noise_is_printed_with_its_error(handlaser):
    arguments = ("calibrate", RECORDING, "--estimate-noise", "--range-sigma-by-beam")
    code, out, _ = handlaser(*arguments, "--verbose")
    assert code == 0
    (line,) = [line for line in one_line_each(out) if line.startswith("noise: ")]
    for name in ("reading of beam 1", "reading of beam 4", "hand position", "hand rotation"):
        assert name in line
    assert line.count("(estimated)") >= 5


def test_a_rig_may_hold_a_pose_covariance(handlaser, refusal, tmp_path):
    S = np.diag([math.radians(0.01) ** 2] * 3 + [2e-5**2] * 3)
    rig = tmp_path / "rig.toml"
    sigmas = "range_sigma_mm = 0.03\nincidence_sigma_mm = 0.01"
    rig.write_text(f"[noise]\n{sigmas}\npose_covariance = {S.tolist()}\n")
    assert hl.read_rig(rig).noise == hl.Noise(3e-5, incidence_sigma=1e-5, pose_covariance=S)
    _, out, _ = handlaser("calibrate", RECORDING, "--rig", rig, "--json")
    told = ("--range-sigma-mm", "0.03", "--incidence-sigma-mm", "0.01", *POSES)
    _, other, _ = handlaser("calibrate", RECORDING, *told, "--json")
    mine, its = json.loads(out)["beams"][1], json.loads(other)["beams"][1]
    assert np.allclose(mine["location_m"], its["location_m"], atol=1e-12)
    rig.write_text("[noise]\npose_covariance = [[1.0, 2.0]]\n")
    assert "6 rows of 6 numbers" in refusal("calibrate", RECORDING, "--rig", rig)


@pytest.mark.slow
def test_a_recording_validates_itself(handlaser):
    code, out, _ = handlaser("validate", RECORDING, "--rig", RIG, *QUICK, "--splits", "2")
    assert code == 0
    for words in ("without plane A", "without plane D", "2 times", "plane from all beams"):
        assert words in out
    assert out.startswith("Usable, confirmed by 4 planes left out: ")
    assert max(len(line) for line in out.splitlines()) <= 100
    code, out, _ = handlaser("validate", RECORDING, "--rig", RIG, *QUICK, "--splits", "1", "--json")
    found = json.loads(out)
    assert found["format"] == "handlaser-validation"
    assert [one["plane"] for one in found["planes_left_out"]] == ["A", "B", "C", "D"]
    assert len(found["splits"]) == 1
    assert found["reconstruction"]["tests"] == 1760


@pytest.mark.slow
def test_an_old_calibration_holds_until_a_beam_is_displaced(handlaser, tmp_path):
    old = tmp_path / "old.json"
    handlaser("calibrate", RECORDING, "--rig", RIG, "--out", old, "-q")
    arguments = ("--rig", RIG, "--calibration", old)
    code, out, err = handlaser("validate", RECORDING, *arguments)
    assert (code, err) == (0, "")
    assert out.startswith("The calibration holds: ")
    recording = hl.read_recording(RECORDING)
    ranges = recording.ranges.copy()
    ranges[:, 2] += 2e-4
    moved = tmp_path / "moved.csv"
    hl.write_recording(moved, replace(recording, ranges=ranges))
    code, out, err = handlaser("validate", moved, *arguments)
    assert code == 4
    assert out.startswith("The calibration does not hold: ")
    assert "does not hold" in err
    assert "3" in err.split("beam ")[1].split(";")[0]
    code, out, _ = handlaser("validate", moved, *arguments, "--json")
    assert code == 4
    found = json.loads(out)
    assert min(found["beams"], key=lambda beam: beam["p_value"])["name"] == "3"


@pytest.mark.slow
def test_limits_hold_for_planes_left_out(handlaser, tmp_path):
    """The residuals of the calibration pass, those of a plane that was left out do not."""
    rig = tmp_path / "rig.toml"
    rig.write_text((GRIPPER / "rig.toml").read_text() + "[limits]\nrms_mm = 0.035\n")
    assert handlaser("calibrate", RECORDING, "--rig", rig, *QUICK, "-q")[0] == 0
    code, out, err = handlaser("validate", RECORDING, "--rig", rig, *QUICK, "--splits", "0")
    assert code == 4
    assert out.startswith("Not usable, outside the limits: without plane D")
    assert err.strip().startswith("handlaser: Not usable, outside the limits: without plane D")


@pytest.mark.slow
def test_a_plane_that_contradicts_the_beams_exits_with_4(handlaser, tmp_path):
    """Every beam reads too much on plane D by a bias of its own, as on another surface."""
    recording = hl.read_recording(RECORDING)
    ranges = recording.ranges.copy()
    rows = [label == "D" for label in recording.plane_labels]
    ranges[rows] += np.array([1.0, -1.0, 1.0, -1.0]) * 4e-5
    path = tmp_path / "biased.csv"
    hl.write_recording(path, replace(recording, ranges=ranges))
    arguments = ("validate", path, "--rig", RIG, *QUICK, "--splits", "0")
    code, out, _ = handlaser(*arguments, "--max-incidence-deg", "80")
    assert code == 4
    assert out.startswith("Not usable, contradicted: ")
    assert "D" in out.split("contradict")[1]
    found = json.loads(handlaser(*arguments, "--json")[1])
    assert min(one["p_value"] for one in found["planes_left_out"]) < 0.01 / 4


def test_a_second_recording_is_a_hold_out(handlaser):
    code, out, _ = handlaser("validate", RECORDING, "--rig", RIG, "--hold-out", RECORDING)
    assert code == 0
    assert "176 readings, planes fitted, beams as calibrated" in out


@pytest.mark.slow
def test_what_cannot_be_validated_is_refused(handlaser, refusal, tmp_path):
    assert "one of the two" in refusal(
        "validate", RECORDING, "--hold-out", "a", "--calibration", "b"
    )
    code, _, err = handlaser("validate", RECORDING, "--calibration", tmp_path / "none.json")
    assert code == 2
    assert "no readable file" in err
    poor = tmp_path / "poor.csv"
    hl.write_recording(poor, degenerate("pure translations"))
    for further in ((), ("--hold-out", RECORDING)):
        code, _, err = handlaser("validate", poor, *further)
        assert code == 3
        assert "does not determine" in err
