"""Noise that is correlated in time is noticed, and makes standard deviations larger."""

from dataclasses import replace

import numpy as np
import pytest
from helpers import codes

import handlaser_gtsam as hl
from benchmarks import moving_robot, odd_readings, unflagged
from benchmarks.robot_cell import Scene, cell

SCENE = Scene(2, 4, 25, 0.0, 0.0, 0.6)
SIGMA = 1e-4
EXACT = hl.Noise(SIGMA, 0.0, 0.0)
NONE = hl.CalibrationOptions("none")


def autoregressive(shape, rho, rng):
    """Noise of unit variance, station after station."""
    noise = rng.standard_normal(shape)
    for j in range(1, len(noise)):
        noise[j] = rho * noise[j - 1] + np.sqrt(1.0 - rho**2) * noise[j]
    return noise


def calibrated(rho, seed, noise=EXACT):
    rng = np.random.default_rng(seed)
    recording, truth = cell(SCENE, rng)
    d = recording.ranges + SIGMA * autoregressive(recording.ranges.shape, rho, rng)
    return hl.calibrate(replace(recording, ranges=d), noise, NONE), truth


@pytest.mark.slow
@pytest.mark.parametrize("noise", [EXACT, hl.Noise(None, 0.0, 0.0)], ids=["given", "estimated"])
def test_correlated_noise_is_named_and_counted(noise):
    """For known beams the means of 25 readings in a row vary 7.3 times as much as of independent ones.

    That is 2.7 times the standard deviation. Chains of 25 tell the correlation to 0.1, which moves
    that by a factor of two either way: the geometric mean over four recordings is within sqrt(2).
    """
    growth = []
    for seed in range(1, 5):
        found, _ = calibrated(0.8, seed, noise)
        assert "correlated-in-time" in codes(found)
        quiet, _ = calibrated(0.0, seed, noise)
        assert "correlated-in-time" not in codes(quiet)
        variance, usual = (np.einsum("pii->pi", x.covariance.planes) for x in (found, quiet))
        growth.append(np.log(np.sqrt(variance / usual)).mean())
    assert 2.7 / np.sqrt(2.0) < np.exp(np.mean(growth)) < 2.7 * np.sqrt(2.0)


@pytest.mark.slow
def test_standard_deviations_cover_correlated_noise():
    """The mean squared error of r in its sigmas, over the draws: one would be right."""
    squares = []
    for seed in range(40):
        found, truth = calibrated(0.8, seed, hl.Noise(None, 0.0, 0.0))
        for beam, r in zip(found.beams.values(), truth.locations, strict=True):
            squares.append(((beam.location - r) / beam.location_sigma) ** 2)
    assert np.mean(squares) < 1.4


@pytest.mark.slow
@pytest.mark.parametrize("length", [0, 20])
def test_a_beam_that_is_knocked_is_named_whether_or_not_the_errors_vary_slowly(length):
    """By its station: those between it and the one that was tried first looked like slow errors."""
    recording, _, _ = moving_robot.recorded(length, 0)
    ranges = recording.ranges.copy()
    ranges[800:, 1] += 3e-3
    found = hl.calibrate(replace(recording, ranges=ranges), hl.Noise())
    (moved,) = [one for one in found.warnings if one.code == "displaced"]
    assert (moved.values["target"], moved.values["station"]) == ("beam 2", "801")


@pytest.mark.slow
@pytest.mark.parametrize("given", [True, False], ids=["given", "nothing"])
def test_errors_of_poses_that_change_smoothly_are_named_and_counted(given):
    """A robot that never stops: over 40 recordings the rms error is 1.0 to 1.2 standard deviations.

    That of one of ten coordinates that go together has a mean square of up to 1.44, and over three
    recordings hardly ever 4. Without the correlation it would be 7 to 16.
    """
    runs = [moving_robot.outcome((20, given, seed)) for seed in range(3)]
    assert all(one.length is not None and 8.0 < one.length < 60.0 for one in runs)
    assert np.mean([one.z**2 for one in runs]) < 4.0
    # Nothing else is wrong, and nothing else is named: what varies slowly is as likely noise.
    assert not {code for one in runs for code in one.others} - {"far-reading"}


@pytest.mark.slow
def test_a_moving_robot_with_independent_errors_raises_no_alarm():
    assert moving_robot.outcome((0, True, 1)).length is None


def test_smooth_noise_has_the_correlation_it_is_said_to_have():
    noise = moving_robot.smooth_noise(100_000, 5, np.random.default_rng(2))
    assert noise.var() == pytest.approx(1.0, rel=0.03)
    for lag in (1, 5, 10):
        found = (noise[lag:] * noise[:-lag]).mean()
        assert found == pytest.approx(np.exp(-0.5 * (lag / 5.0) ** 2), abs=0.02)


def test_a_drift_of_readings_is_a_drift_and_no_correlation():
    """What a systematic error that is found makes alike is taken out before."""
    recording, _ = cell(Scene(2, 4, 50, 0.0, 0.0, 0.6), np.random.default_rng(5))
    noise = SIGMA * np.random.default_rng(6).standard_normal(recording.ranges.shape)
    drift = 6.0 * SIGMA * np.linspace(-0.5, 0.5, len(noise))[:, None]
    found = hl.calibrate(replace(recording, ranges=recording.ranges + noise + drift), EXACT, NONE)
    assert "systematic-drift" in codes(found)
    assert "correlated-in-time" not in codes(found)


@pytest.mark.slow
def test_independent_noise_raises_no_alarm():
    """At most one recording in a hundred: more than the bound have a chance of 4 % at most."""
    alarms = 0
    for seed in range(30):
        noise = (EXACT, hl.Noise(SIGMA), hl.Noise())[seed % 3]
        alarms += "correlated-in-time" in codes(calibrated(0.0, seed, noise)[0])
    assert alarms <= 1


@pytest.mark.slow
@pytest.mark.parametrize("kind", odd_readings.KINDS)
def test_no_kind_of_readings_goes_by_unflagged(kind):
    """`benchmarks.unflagged` in small: no wrong result without a warning, no right one refused."""
    given = odd_readings.KINDS.index(kind) % 2 == 0
    # Either a column or the whole file is doubled, as the seed says.
    seeds = range(2 if kind == "doubled" else 1)
    found = [unflagged.outcome(kind, given, seed) for seed in seeds]
    assert not [one for one in found if one.unflagged and one.farthest > unflagged.FAR]
    if kind in ("held", "saturated"):
        expected = {"held": "repeated-stations", "saturated": "reading-code"}[kind]
        assert all(expected in one.codes for one in found)
    if kind == "doubled":
        assert all({"repeated-stations", "column-twice"} & set(one.codes) for one in found)
    if kind == "gaussian":
        assert all(one.status == "converged" and not one.codes for one in found)
    assert unflagged.line(kind, given, found).startswith(kind)
