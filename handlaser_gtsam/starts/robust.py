"""Starts among outliers: many candidates, each tightened around the readings that agree with it.

A linear start follows its outliers. Here every candidate, linear or swept, is refined with Cauchy's
loss, whose scale follows the residuals of those readings that must be good for the answer to mean
anything, and so tightens by itself; a few steps with Tukey's loss let go of the rest. Gross errors
agree with nothing: the candidates that reach the strongest evidence are those that found the consensus.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from ..arrays import FloatArray
from ..data.parameters import Parameters
from ..data.recording import Readings
from ..model.losses import Loss
from ..solvers.refine import Scale, refine_many
from .directions import direction_starts, random_starts
from .mending import mended
from .partial import grow
from .subsets import subset_starts

FIRST_SWEPT, SWEPT, TRIED = 12, 32, 400
SUBSET_ROUNDS = 4
RANDOM_ROUNDS, RANDOM_STARTS = 3, 48
CAUCHY_STEPS, TUKEY_STEPS = 40, 10
SHARES = (0.5, 0.25, 0.0)
"""Parts of the redundant readings that must be good, besides as many as there are unknowns."""
AGREEING, LATE_AGREEING = 4, 2
"""So many candidates of the same evidence end the search where the best is beyond chance, and so many
where sweeps on subsets have not brought about more."""
SAME_EVIDENCE, SAME_PART = 0.5, 0.1
"""The same to so much, or to this part of what is beyond chance: not every candidate has arrived."""
FIRST_MENDED, MENDING = 8, 3.0
"""So many of the best candidates are mended in each round, with so many times their scale."""
KEPT = 6
FAR = 5.0
"""Readings so many times beyond three quarters of them take no part in the starts."""


@dataclass(frozen=True, slots=True)
class RobustStart:
    """A candidate, the scale of the readings that agree with it [m], and its evidence (low is good)."""

    parameters: Parameters
    scale: float
    evidence: float


Evidence = Callable[[Parameters, float], float]
"""Of a candidate and its scale; lower is better."""
BeyondChance = Callable[[Parameters, float], float]
"""By how much [nats] a candidate and its scale are beyond chance; negative where they are not."""


def robust_starts(
    readings: Readings,
    others: list[Parameters],
    range_sigma: float | None,
    terms: int,
    evidence: Evidence,
    beyond_chance: BeyondChance,
) -> list[RobustStart]:
    """Return the best candidates for readings with outliers, the strongest evidence first.

    Parameters
    ----------
    readings : Readings
    others : Parameters, each
        Candidates of other starts, which compete.
    range_sigma : float, optional
        Standard deviation of a reading [m]; the scale never falls below it.
    terms : int
        Range-error terms of the last steps.
    evidence : callable
    beyond_chance : callable
    """
    least = max(range_sigma or 0.0, 1e-9 * readings.largest_range())
    found: list[RobustStart] = []
    rng = np.random.default_rng(0)
    for starts, good, needed in _rounds(readings, others, terms, rng):
        found += _tightened(starts, readings, terms, Scale(least, good), evidence)
        found = _mended(found, readings, terms, Scale(least, good), evidence, rng)
        if found and needed <= _agreeing(found, beyond_chance(found[0].parameters, found[0].scale)):
            break
    return _different(found)


def _agreeing(found: list[RobustStart], beyond: float) -> int:
    """Return how many candidates are where the best one is; none if that is not `beyond` chance."""
    same = found[0].evidence + max(SAME_EVIDENCE, SAME_PART * beyond)
    return sum(one.evidence <= same for one in found) if beyond > 0.0 else 0


def _rounds(
    readings: Readings, others: list[Parameters], terms: int, rng: np.random.Generator
) -> Iterator[tuple[list[Parameters], float, int]]:
    """Yield starts, the part of the readings that must be good, and how many must agree to end."""
    total = len(readings)
    unknowns = (5 + terms) * readings.beams + 3 * readings.planes
    parts = [(unknowns + share * max(total - unknowns, 0)) / total for share in SHARES]
    parts = [min(max(part, 0.5), 1.0) for part in parts]
    near = _without_far_readings(readings)
    few = [grow(start, near) for start in subset_starts(near, FIRST_SWEPT, TRIED, rng)]
    yield [*others, *few], parts[0], AGREEING
    for number in range(SUBSET_ROUNDS):
        drawn = [grow(start, near) for start in subset_starts(near, SWEPT, TRIED, rng)]
        yield drawn, parts[number % len(parts)], AGREEING
    swept = [grow(start, near) for start in direction_starts(near, SWEPT, TRIED)]
    for part in parts:
        yield [*others, *swept], part, LATE_AGREEING
    for _ in range(RANDOM_ROUNDS):
        drawn = [grow(start, near) for start in random_starts(near, RANDOM_STARTS, rng)]
        for part in parts:
            yield drawn, part, LATE_AGREEING


def _without_far_readings(readings: Readings) -> Readings:
    """Return the readings without those far beyond the bulk: one of 100 m would tilt every plane."""
    limit = FAR * float(np.quantile(readings.distance, 0.75))
    near = readings.subset(np.flatnonzero(readings.distance <= limit))
    seen = np.bincount(near.plane, minlength=readings.planes)
    return near if seen.all() else readings


def _tightened(
    starts: list[Parameters], readings: Readings, terms: int, rule: Scale, evidence: Evidence
) -> list[RobustStart]:
    loose = refine_many(starts, readings, 0, CAUCHY_STEPS, Loss("cauchy"), rule)
    usable = [one.parameters for one in loose if one is not None]
    return _tight(usable, readings, terms, rule, evidence)


def _tight(
    starts: list[Parameters], readings: Readings, terms: int, rule: Scale, evidence: Evidence
) -> list[RobustStart]:
    tight = refine_many(starts, readings, terms, TUKEY_STEPS, Loss("tukey"), rule)
    return [
        RobustStart(one.parameters, one.scale, evidence(one.parameters, one.scale))
        for one in tight
        if one is not None
    ]


def _mended(
    found: list[RobustStart],
    readings: Readings,
    terms: int,
    rule: Scale,
    evidence: Evidence,
    rng: np.random.Generator,
) -> list[RobustStart]:
    """Return the candidates in order, the best of them with planes mended where that is better."""
    found = sorted(found, key=lambda candidate: candidate.evidence)
    new = [
        mended(one.parameters, readings, MENDING * one.scale, rng) for one in found[:FIRST_MENDED]
    ]
    again = refine_many(new, readings, terms, TUKEY_STEPS, Loss("cauchy"), rule)
    usable = [one.parameters for one in again if one is not None]
    tight = _tight(usable, readings, terms, rule, evidence)
    both = [min(pair, key=lambda one: one.evidence) for pair in zip(found, tight, strict=False)]
    return sorted([*both, *found[len(both) :]], key=lambda candidate: candidate.evidence)


def _different(found: list[RobustStart]) -> list[RobustStart]:
    """Return the best few candidates that differ in their evidence."""
    found = [candidate for candidate in found if np.isfinite(candidate.evidence)]
    evidence: FloatArray = np.array([candidate.evidence for candidate in found])
    first = np.flatnonzero(np.diff(evidence, prepend=-np.inf) > SAME_EVIDENCE)
    return [found[i] for i in first[:KEPT]]
