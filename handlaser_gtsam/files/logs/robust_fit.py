"""How well a few readings fit, whatever some of them are: for the comparison of conventions."""

from collections.abc import Callable

import numpy as np

from ...data.ordering import sorted_readings
from ...data.parameters import Parameters
from ...data.recording import Recording
from ...model.equation import plausible_range_errors, residuals_or_infinite
from ...model.losses import Loss
from ...solvers.refine import LossScale, refine_many
from ...starts import find_start
from ...starts.directions import subset_starts
from ...starts.growing import grow
from ...starts.robust import least_scale

GOOD = 0.7
"""This part of the readings must be good."""
QUANTILE = 1.0364
"""Of the absolute residuals at that part, in standard deviations of Gaussian noise."""
CANDIDATES, SUBSETS, TRIED = 6, 8, 200
"""Starts of all readings, and of parts of the stations, of so many directions that are tried."""
STEPS = 30


Measure = Callable[[Recording, int, float], float]
"""Returns how badly a recording of one beam fits: its squared residual in parts of the squared spread.

It takes the number of range-error terms, and how far from the hand's origin a beam may lie [m]:
readings in a wrong unit can fit as those of a beam that is metres away.
"""


def misfit_at_a_glance(recording: Recording, terms: int, reach: float) -> float:
    """Return the mean squared residual after a few starts."""
    readings, _ = sorted_readings(recording)
    readings = readings.seen_from(readings.plane_means(readings.world_t_hand))
    start = find_start(readings, None, terms, effort="glance")
    if not _within(start.parameters, reach):
        return np.inf
    return float(start.tried[0][1] ** 2) / max(float(np.nanvar(recording.ranges)), 1e-300)


def robust_misfit(recording: Recording, terms: int, reach: float) -> float:
    """Return the squared residual below which `GOOD` of the readings are, as if it were Gaussian."""
    readings, _ = sorted_readings(recording)
    readings = readings.seen_from(readings.plane_means(readings.world_t_hand))
    rng = np.random.default_rng(0)
    starts = [one.parameters for one in find_start(readings, None, 0, effort="glance").candidates]
    starts = starts[:CANDIDATES]
    starts += [grow(one, readings) for one in subset_starts(readings, SUBSETS, TRIED, rng)]
    rule = LossScale(least_scale(readings, None), GOOD)
    loose = refine_many(starts, readings, 0, STEPS, Loss("cauchy"), rule)
    usable = [one.parameters for one in loose if one is not None]
    tight = refine_many(usable, readings, terms, STEPS // 3, Loss("cauchy"), rule)
    found = [
        float(np.quantile(np.abs(residuals_or_infinite(one.parameters, readings)), GOOD))
        for one in tight
        if one is not None
        and _within(one.parameters, reach)
        and plausible_range_errors(one.parameters, readings)
    ]
    best = min(found, default=np.inf) / QUANTILE
    return float(best**2) / max(readings.spread() ** 2, 1e-300)


def _within(parameters: Parameters, reach: float) -> bool:
    return bool(np.linalg.norm(parameters.locations, axis=1).max() <= reach)
