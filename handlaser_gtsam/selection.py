"""Which readings a calibration uses, and the joint solution of those.

Readings outside the sensor's range are left out first, then outliers, then those that meet their plane
too flat. Outliers are tested again with the final model, for range errors may have looked like them.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from . import sensor as limits
from .arrays import BoolArray, IntArray
from .consensus import find_consensus
from .diagnosis.outliers import CUT, enough, test
from .noise import Noise
from .options import CalibrationOptions
from .range_error import MOST_TERMS, Choice, choose_terms
from .recording import Readings, Recording
from .solvers.levenberg import Trial
from .starts import Start, find_start

OUTSIDE = "outside the sensor's range"
FLAT = "incidence above the sensor's limit"
ROUNDS = 5

Progress = Callable[[Trial], None] | None


@dataclass(frozen=True, slots=True)
class Selection:
    """The readings that were used, and the solution of those.

    Attributes
    ----------
    used : (N,) of bool
    outside, flat : (N,) of bool
        Left out by the sensor's limits; what else is left out is an outlier.
    start : Start
    method : str
        Of the start that led to the solution.
    choice : Choice
        Of the readings `used`, in their order.
    """

    used: BoolArray
    outside: BoolArray
    flat: BoolArray
    start: Start
    method: str
    choice: Choice

    def outliers(self) -> BoolArray:
        """Return which readings (N,) were left out because the others contradict them."""
        return ~(self.used | self.outside | self.flat)


def select(
    recording: Recording,
    readings: Readings,
    noise: Noise,
    options: CalibrationOptions,
    progress: Progress = None,
) -> Selection:
    """Choose readings and solve them jointly.

    Raises
    ------
    InputError
        The sensor's limits leave a beam or a plane without readings.
    """
    inside = np.zeros(len(readings), dtype=bool)
    inside[limits.within_range(readings, options.sensor)] = True
    limits.require_all(recording, readings.subset(np.flatnonzero(inside)))
    terms = MOST_TERMS[options.range_error]
    rows = np.flatnonzero(inside)
    part = readings.subset(rows)
    start = find_start(part, noise.range_sigma, terms, thorough=options.outliers == "keep")
    parameters, method = start.parameters, start.method
    used = inside.copy()
    if options.outliers == "reject":
        consensus = find_consensus(part, start, noise.range_sigma, terms)
        used[rows] = consensus.kept
        parameters, method = consensus.parameters, consensus.method
    choice = choose_terms(
        readings.subset(np.flatnonzero(used)), parameters, noise, options, progress
    )
    flat = np.zeros(len(readings), dtype=bool)
    for _ in range(ROUNDS):
        before = used.copy()
        if options.outliers == "reject":
            used = _tested(readings, inside & ~flat, used, choice, noise)
        steep = limits.within_incidence(readings, choice.solution.parameters, options.sensor)
        flat = inside.copy()
        flat[steep] = False
        used &= ~flat
        if (used == before).all():
            break
        limits.require_all(recording, readings.subset(np.flatnonzero(used)))
        latest = choice.solution.parameters
        choice = choose_terms(
            readings.subset(np.flatnonzero(used)), latest, noise, options, progress
        )
    return Selection(used, ~inside, flat, start, method, choice)


def _tested(
    readings: Readings, allowed: BoolArray, used: BoolArray, choice: Choice, noise: Noise
) -> BoolArray:
    """Return which allowed readings agree with the solution of those `used`."""
    solution = choice.solution
    rows: IntArray = np.flatnonzero(allowed)
    part, kept = readings.subset(rows), used[rows]
    terms = solution.problem.terms
    if not solution.observability.full or not enough(part, kept, terms):
        return used
    _, _, t = test(part, kept, solution.parameters, terms, noise.range_sigma)
    agreeing = np.abs(t) <= CUT
    if not enough(part, agreeing, terms):
        return used
    tested = np.zeros_like(used)
    tested[rows] = agreeing
    return tested
