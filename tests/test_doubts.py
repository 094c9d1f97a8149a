"""Files that would give a wrong calibration are refused or flagged, and the reason is named."""

import json
import pickle
from dataclasses import replace

import numpy as np
import pytest
from helpers import codes, simulated

import handlaser_gtsam as hl
from handlaser_gtsam.data.parameters import Parameters
from handlaser_gtsam.data.recording import sorted_readings
from handlaser_gtsam.files.calibration_writing import calibration_text
from handlaser_gtsam.model.distributions import chi2_cdf
from handlaser_gtsam.observability.motion import check_motion
from handlaser_gtsam.observability.wording import BeamAndPlaneNames
from handlaser_gtsam.results.warnings import implausible_mounts
from handlaser_gtsam.validation.scenes import SCENES, Layout
from handlaser_gtsam.validation.simulate import Errors, simulate

SIGMA = 3e-5
NONE = hl.CalibrationOptions("none")


@pytest.fixture(scope="module")
def recording():
    return simulated("paper", Layout(3, 2, 11))[0]


@pytest.fixture(scope="module")
def too_long(recording):
    """What is found where all readings of a beam are five times as long, and the noise is known."""
    ranges = recording.ranges * np.array([1.0, 5.0, 1.0])
    return hl.calibrate(replace(recording, ranges=ranges), hl.Noise(SIGMA, 0.0, 0.0), NONE)


@pytest.mark.slow
@pytest.mark.parametrize("stated", [True, False])
def test_a_beam_that_is_too_long_is_named(stated, recording, too_long):
    """Most of its readings would be left out, and the rest fitted by chance."""
    ranges = recording.ranges * np.array([1.0, 5.0, 1.0])
    found = too_long if stated else hl.calibrate(replace(recording, ranges=ranges), options=NONE)
    assert found.status != "converged"
    named = {one.code: one.message for one in found.warnings}
    assert "readings of beam 2 contradict the others" in named["contradicting-beam"]


@pytest.mark.slow
def test_a_beam_that_is_ten_times_too_long_has_another_unit(recording):
    ranges = recording.ranges * np.array([1.0, 10.0, 1.0])
    found = hl.calibrate(replace(recording, ranges=ranges), hl.Noise(SIGMA, 0.0, 0.0), NONE)
    words = "the ranges of beam 2 look like millimetres, and the others like centimetres"
    assert found.message.startswith(words)


@pytest.mark.slow
def test_a_sigma_that_is_ten_times_too_small_is_no_calibration(recording):
    """Of an exact robot: errors of a robot that nobody describes would explain the residuals."""
    found = hl.calibrate(recording, hl.Noise(SIGMA / 20.0, 0.0, 0.0), NONE)
    assert found.status == "not_converged"
    assert codes(found)[0] == "no-fit"
    assert found.fit.sigma0 > 10.0
    assert all(beam.covariance is None for beam in found.beams.values())


@pytest.mark.slow
def test_millimetres_taken_for_metres_are_asked_about(recording):
    moved = replace(
        recording, world_t_hand=1e3 * recording.world_t_hand, ranges=1e3 * recording.ranges
    )
    found = hl.calibrate(moved, options=NONE)
    assert "far-beam" in codes(found)
    assert not found.judged().usable
    assert "far-beam" not in codes(hl.calibrate(recording, options=NONE))


def test_a_hand_that_only_turns_leaves_its_mirror_image_open(recording):
    turning = replace(recording, world_t_hand=np.zeros_like(recording.world_t_hand))
    found = check_motion(turning)
    assert "mirror image" in found.undetermined[0]
    assert "move the hand" in found.advice[0]
    assert check_motion(recording).undetermined == ()


@pytest.mark.parametrize("sides", ["one beam", "two beams"])
def test_beams_that_hit_a_plane_from_its_two_sides_are_named(sides):
    """The plane is z = 1, between two stations, or between two beams of one."""
    R = np.stack((np.eye(3), np.diag([1.0, -1.0, -1.0])))
    t, ranges = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 2.0]]), np.array([[1.0], [1.0]])
    if sides == "two beams":
        t, ranges = np.zeros((2, 3)), np.array([[1.0, np.nan], [np.nan, -1.0]])
    beams = ranges.shape[1]
    labels = {"plane_labels": ("A", "A"), "beam_names": ("1", "2")[:beams]}
    recording = hl.Recording(R, t, ranges, **labels, range_min=-2.0)
    readings, order = sorted_readings(recording)
    at, v = np.zeros((beams, 3)), np.tile([0.0, 0.0, 1.0], (beams, 1))
    plane = np.array([[0.0, 0.0, 1.0]]), np.array([-1.0])
    parameters = Parameters(at, v, np.zeros((beams, 2)), *plane)
    names = BeamAndPlaneNames.of(recording, order)
    warning = implausible_mounts(readings, parameters, names)
    words = "beam 1 hits plane A" if sides == "one beam" else "beams 1 and 2 hit plane A"
    assert warning.code == "two-sides"
    assert f"{words} from its two sides, which no plate allows" in warning.message


@pytest.mark.parametrize("noise", [hl.Noise(SIGMA, 0.0, 0.0), hl.Noise()])
def test_few_readings_more_than_unknowns_are_warned_of(noise):
    """A gross error of one may pass for a range error, and the noise is hardly determined."""
    few, enough = (simulated("paper", Layout(1, 2, stations))[0] for stations in (8, 14))
    warning = hl.calibrate(few, noise, NONE).warnings[0]
    assert warning.code == "few-readings"
    assert warning.values["redundancy"] == 16 - 11
    assert ("gross error" in warning.message) == (noise.range_sigma is not None)
    assert "few-readings" not in codes(hl.calibrate(enough, noise, NONE))


def test_few_readings_count_freed_errors():
    recording = simulated("paper", Layout(1, 2, 11))[0]
    sensor = hl.Sensor(kind="triangulation")
    free = hl.CalibrationOptions("none", free=("tool-displaced",), sensor=sensor)
    known, found = (
        hl.calibrate(recording, hl.Noise(SIGMA, 0.0, 0.0), chosen) for chosen in (NONE, free)
    )
    assert (known.fit.dof, found.fit.dof) == (11, 5)
    assert "few-readings" not in codes(known)
    (warning,) = [one for one in found.warnings if one.code == "few-readings"]
    assert warning.values["redundancy"] == 5


def of_a_robot(errors, seed=3):
    """Return a recording of a robot that errs, before seven planes."""
    rng = np.random.default_rng(seed)
    truth, stations = SCENES["arm"](Layout(3, 7, 13), rng)
    return simulate(truth, stations, errors, rng)


@pytest.mark.parametrize("part", [0.0, 0.2])
def test_readings_that_are_compressed_far_out_are_asked_about(part):
    """They fit range errors and a mount that are wrong, with hardly larger residuals."""
    recording = of_a_robot(Errors(SIGMA, 1e-4, 1e-4))
    d = recording.ranges
    far = np.quantile(d, 0.6)
    short = replace(recording, ranges=d - part * np.maximum(d - far, 0.0))
    found = hl.calibrate(short)
    (warning,) = [one for one in found.warnings if one.code == "large-range-error"] or [None]
    assert (warning is None) == (part == 0.0)
    if warning is not None:
        assert warning.values["size"] > 10.0 * warning.values["expected"] == 0.1
        assert found.verdict.code == "usable-with-care"


@pytest.mark.slow
def test_errors_that_no_robot_has_are_asked_about():
    """They stand for something else, as for gross errors, and nothing else says so."""
    recording = of_a_robot(Errors(SIGMA, 3e-3, 0.01))
    found = hl.calibrate(recording, hl.Noise(SIGMA), NONE)
    assert codes(found).count("large-pose-errors") == 2
    expected = hl.Noise(SIGMA, pose_translation_prior=2e-3, pose_rotation_prior=0.005)
    assert "large-pose-errors" not in codes(hl.calibrate(recording, expected, NONE))


def test_errors_that_a_robot_has_are_not_asked_about():
    recording = of_a_robot(Errors(SIGMA, 4e-4, 1e-3))
    assert "large-pose-errors" not in codes(hl.calibrate(recording, hl.Noise(SIGMA), NONE))


@pytest.mark.slow
def test_sensors_without_range_errors_do_not_make_sigmas_too_large():
    """Forty range errors of zero are less than any prior of some width says: chi2 is too small."""
    rng = np.random.default_rng(44)
    truth, stations = SCENES["arm"](Layout(20, 4, 16), rng)
    errors = Errors(SIGMA, 5e-5, 5e-4)
    found = hl.calibrate(simulate(truth, stations, errors, rng), hl.Noise(SIGMA, 5e-5, 5e-4))
    assert chi2_cdf(found.fit.chi2, found.fit.dof) < 1e-3
    assert not {"sigmas-too-large", "sigmas-too-small"} & set(codes(found))


@pytest.mark.parametrize(
    ("code", "factor", "names"),
    [
        ("sigmas-too-small", 1.0 / 3.0, {"stated", "sigma", "times"}),
        ("sigmas-too-large", 3.0, {"sigma0", "p_value"}),
        pytest.param(
            *("contradicting-beam", None, {"beam", "rejected", "readings"}), marks=pytest.mark.slow
        ),
    ],
)
def test_a_warning_carries_the_numbers_of_its_message(recording, request, code, factor, names):
    if factor is None:
        found = request.getfixturevalue("too_long")
    else:
        exact = replace(NONE, poses="exact")
        found = hl.calibrate(recording, hl.Noise(factor * SIGMA, 0.0, 0.0), exact)
    (warning,) = [one for one in found.warnings if one.code == code]
    assert set(warning.values) == names
    if "sigma0" in names:
        assert warning.values["sigma0"] == found.fit.sigma0
        assert f"{found.fit.sigma0:.2f} times" in warning.message
    elif factor is None:
        assert warning.values["beam"] == "2"
        rejected = [one for one in found.fit.rejected if one.sensor == "2"]
        assert warning.values["rejected"] == len(rejected)
    file = json.loads(calibration_text(found))
    assert warning.values == next(one for one in file["warnings"] if one["code"] == code)["values"]
    assert pickle.loads(pickle.dumps(warning)) == warning
