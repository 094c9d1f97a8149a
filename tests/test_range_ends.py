"""Readings beyond a sensor's range are told from other outliers, by their order and their signs."""

from dataclasses import replace

import numpy as np
import pytest
from helpers import codes, simulated

import handlaser_gtsam as hl
from handlaser_gtsam.model.distributions import FAMILY_LEVEL
from handlaser_gtsam.outliers.reasons import range_ends

SIGMA = 1e-3
NONE = hl.CalibrationOptions("none")
BEAMS = "abcdefgh"


def beyond(recording, beam, seed, *, far, count=9):
    """Return readings of one beam that stay near its limit beyond it, with noise of their own."""
    ranges, rng = recording.ranges.copy(), np.random.default_rng(seed)
    d = ranges[:, beam]
    limit = np.sort(d)[-count if far else count - 1]
    past = d >= limit if far else d <= limit
    d[past] = limit + SIGMA * rng.standard_normal(count)
    return replace(recording, ranges=ranges), limit


@pytest.mark.parametrize("far", [True, False], ids=["far", "near"])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_the_end_of_a_range_is_named(far, seed):
    recording, _ = simulated("arm", range_sigma=SIGMA, seed=seed)
    spoilt, limit = beyond(recording, 1, seed, far=far)
    found = hl.calibrate(spoilt, hl.Noise(SIGMA), NONE)
    (warning,) = [one for one in found.warnings if one.code == "range-end"]
    assert warning.values["beam"] == recording.beam_names[1]
    # The nearest readings beyond the limit are off by less than anyone can see.
    assert warning.values["limit_m"] == pytest.approx(limit, abs=8.0 * SIGMA)
    reasons = {r.reason for r in found.fit.rejected if r.sensor == recording.beam_names[1]}
    assert any("end of the range" in one or "near end" in one for one in reasons)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_beam_that_misses_the_plate_is_another_matter(seed):
    """What it reads is far, but too long."""
    recording, _ = simulated("arm", range_sigma=SIGMA, seed=seed)
    ranges = recording.ranges.copy()
    ranges[[4, 9, 15, 30], 2] = 3.0 + 0.1 * np.arange(4)
    found = hl.calibrate(replace(recording, ranges=ranges), hl.Noise(SIGMA), NONE)
    assert len(found.fit.rejected) >= 4
    assert "range-end" not in codes(found)


@pytest.mark.slow
def test_outliers_by_chance_look_so_as_rarely_as_stated():
    """Half of them as likely at an end as anywhere, with either sign."""
    readings = simulated("arm", range_sigma=SIGMA)[0].readings()
    rng, alarms = np.random.default_rng(5), 0
    for _ in range(2000):
        out = rng.permutation(len(readings)) < rng.integers(2, len(readings) // 4)
        ends = range_ends(
            readings, out, rng.standard_normal(len(readings)), BEAMS[: readings.beams]
        )
        alarms += any(True for _ in ends)
    assert alarms <= FAMILY_LEVEL * 2000


def test_one_reading_is_no_pattern():
    readings = simulated("arm", range_sigma=SIGMA)[0].readings()
    out = np.zeros(len(readings), dtype=bool)
    out[np.argmax(readings.distance)] = True
    assert not list(range_ends(readings, out, np.ones(len(readings)), BEAMS[: readings.beams]))
