"""Parts held out without calibrating anew: the same as calibrating anew, and many times as fast."""

import dataclasses

import numpy as np
import pytest
from helpers import simulated

import handlaser_gtsam as hl
from handlaser_gtsam.files.report.subject import history
from handlaser_gtsam.solvers import graph_levenberg as levenberg
from handlaser_gtsam.validation.quick_validation import WholeSolution, held_out
from handlaser_gtsam.validation.scenes import Layout
from handlaser_gtsam.validation.validation import USUAL_SPLITS

EXACT = {"pose_translation_sigma": 0.0, "pose_rotation_sigma": 0.0}
CASES = {
    "exact poses": (hl.Noise(3e-5, **EXACT), hl.CalibrationOptions(range_error="k1k2")),
    "poses that err": (hl.Noise(3e-5, 5e-5, 5e-4), hl.CalibrationOptions(range_error="k1")),
    "a sigma from the residuals": (hl.Noise(None, **EXACT), hl.CalibrationOptions("none")),
}


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES)
def test_it_is_what_calibrating_anew_gives(gripper, case):
    """Both end at one optimum, to what the solvers stop at: 1e-6 of a standard deviation."""
    noise, options = CASES[case]
    if case == "a sigma from the residuals":  # for which `validate` has one from the part alone
        gripper = simulated(layout=Layout(planes=5))[0]
        options = hl.CalibrationOptions("none")
    calibration = hl.calibrate(gripper, noise, options)
    fast = held_out(calibration)
    slow = hl.validate(gripper, noise, options, splits=USUAL_SPLITS)
    assert [one.name for one in fast.targets] == [one.name for one in slow.targets]
    given = noise.range_sigma is not None
    for one, other in zip(fast.targets, slow.targets, strict=True):
        assert one.result.rms == pytest.approx(other.result.rms, rel=1e-5)
        assert one.result.max_residual == pytest.approx(other.result.max_residual, rel=1e-4)
        if given:
            assert one.result.p_value == pytest.approx(other.result.p_value, rel=1e-4)
    for one, other in zip(fast.predictions, slow.predictions, strict=True):
        assert one.tests == other.tests
        assert one.rms == pytest.approx(other.rms, rel=1e-5)
        if given:
            assert one.standardized == pytest.approx(other.standardized, rel=1e-4)


@pytest.mark.slow
def test_nothing_is_calibrated_anew(gripper, monkeypatch):
    """What takes the time: `validate` solves for every plane and part (benchmarks.waiting)."""
    noise, options = CASES["exact poses"]
    calibration, solved = hl.calibrate(gripper, noise, options), []
    monkeypatch.setattr(
        levenberg,
        "damped_step",
        lambda *of, solve=levenberg.damped_step: solved.append(1) or solve(*of),
    )
    held_out(calibration)
    assert not solved
    hl.validate(gripper, noise, options)
    assert solved


@pytest.mark.slow
def test_a_plane_that_was_moved_while_it_was_read_is_contradicted():
    """Half its stations see it a millimetre nearer; the beams without it are not touched by that."""
    recording, _ = simulated(layout=Layout(planes=5))
    ranges = recording.ranges.copy()
    rows = np.flatnonzero(recording.plane_of_station == 2)
    ranges[rows] *= 1.0 + 0.02 * np.linspace(-1.0, 1.0, len(rows))[:, None]
    bent = dataclasses.replace(recording, ranges=ranges)
    options = hl.CalibrationOptions(range_error="k1k2", outliers="keep")
    found = held_out(hl.calibrate(bent, hl.Noise(3e-5, **EXACT), options))
    p = {one.name: one.p_value for one in found.targets}
    assert min(p, key=p.get) == recording.plane_names[2]


@pytest.mark.slow
def test_there_is_a_reason_where_nothing_is_held_out(gripper):
    robust = hl.calibrate(gripper, hl.Noise(3e-5, **EXACT), hl.CalibrationOptions(loss="huber"))
    with pytest.raises(hl.SolverError, match="huber loss"):
        held_out(robust)
    part = gripper.part([0, 1, 2, 3])
    with pytest.raises(hl.SolverError, match="no calibration"):
        held_out(hl.calibrate(part, hl.Noise(3e-5, **EXACT)))
    with pytest.raises(hl.InputError, match=r"Calibration\(...\)"):
        held_out(3)


def test_a_plane_without_which_nothing_is_determined_says_so():
    """Two planes that only turn and only move: neither alone determines the beams."""
    recording, truth = simulated(layout=Layout(planes=2))
    rows = np.arange(len(recording.plane_labels))
    few = recording.part(rows[(recording.plane_of_station == 0) | (rows % 11 < 2)])
    options = hl.CalibrationOptions(range_error="none")
    found = held_out(hl.calibrate(few, hl.Noise(3e-5, **EXACT), options))
    first, last = found.targets
    assert first.result is None
    assert "undetermined" in first.message
    assert last.result is not None
    assert truth.offsets.shape == (2,)


def test_the_history_ends_where_the_calibration_is(gripper):
    noise, options = CASES["exact poses"]
    calibration = hl.calibrate(gripper, noise, options)
    stations, found = history(calibration, 0.015)
    assert stations[-1] == len(gripper.plane_labels)
    sigma = max(beam.location_sigma.max() for beam in calibration.beams.values())
    assert found.location_sigma[-1] == pytest.approx(sigma, rel=1e-6)
    known = ~np.isnan(found.location_sigma)
    assert known.sum() >= 8
    assert not known[0]
    for values in (found.location_sigma, found.direction_sigma, found.spot):
        assert (np.diff(values[known]) <= 1e-9 * values[known][:-1]).all()  # no station unteaches
    half = hl.calibrate(gripper.part(np.arange(stations[12])), noise, options)
    if half.success:
        own = max(beam.location_sigma.max() for beam in half.beams.values())
        # The same stations at another estimate: covariances differ by second-order terms.
        assert found.location_sigma[12] == pytest.approx(own, rel=0.2)


@pytest.mark.slow
@pytest.mark.parametrize("noise", [hl.Noise(3e-5, **EXACT), hl.Noise(3e-5), hl.Noise()])
def test_the_history_ends_there_where_scales_were_learned(gripper, noise):
    """Scales that are integrated over, and what the beams have in common, count at the end."""
    calibration = hl.calibrate(gripper, noise)
    assert calibration.learned is not None
    _, known = history(calibration, 0.015)
    beams = calibration.beams.values()
    assert known.location_sigma[-1] == pytest.approx(max(b.location_sigma.max() for b in beams))
    assert known.direction_sigma[-1] == pytest.approx(max(b.direction_sigma for b in beams))
    # Where a beam ends, drawn a hundred thousand times: Satterthwaite's radius is within 1 % of the
    # true one, and the draws tell a quantile to half a percent.
    rng = np.random.default_rng(5)
    spots = [hl.spot(calibration, name, 0.015).covariance for name in calibration.beams]
    away = [rng.multivariate_normal(np.zeros(3), S, 100_000) for S in spots]
    radii = [np.quantile(np.linalg.norm(x, axis=1), 0.95) for x in away]
    assert known.spot[-1] == pytest.approx(max(radii), rel=0.02)


@pytest.mark.slow
def test_no_history_without_a_calibration(gripper):
    open_ = hl.calibrate(gripper.part([0, 1, 2, 3]), hl.Noise(3e-5, **EXACT))
    assert history(open_, 0.015) is None


@pytest.mark.slow
def test_all_stations_are_the_solution_at_the_most_probable_scales(gripper):
    """With the prior of the range errors that was learned, and the errors of the poses."""
    calibration = hl.calibrate(gripper, hl.Noise())
    scaled = calibration.at_scales
    assert scaled.range_error_prior is not None
    everything = np.ones(len(gripper.plane_labels), dtype=bool)
    at, joint = WholeSolution(calibration).known_by(everything, solve=True)
    own = np.sqrt(np.diagonal(joint.matrix(planes=[])))
    whole = np.sqrt(np.diagonal(scaled.covariance.matrix(planes=[])))
    assert own == pytest.approx(whole, rel=1e-3)
    off = np.abs(at.locations - scaled.parameters.locations).max()
    assert off < 1e-2 * whole[:3].min()
    off = np.abs(at.range_errors - scaled.parameters.range_errors)
    assert (off < 1e-2 * whole.reshape(-1, 8)[:, 6:]).all()
