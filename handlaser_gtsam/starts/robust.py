"""Starts among outliers: many candidates, each tightened around the readings that agree with it.

A linear start follows its outliers. Here every candidate, linear or swept, is refined with Cauchy's
loss, whose scale follows the residuals of those readings that must be good for the answer to mean
anything, and so tightens by itself; a few steps with Tukey's loss let go of the rest. Gross errors
agree with nothing: the candidates that reach the strongest evidence are those that found the consensus.

A plane is in none but its own readings, so that a candidate may have its beams right and one plane
wrong: where few stations see the plane, one of them with the label of another is enough. So candidates
are mended. Given the beams a plane has three unknowns only, and any three spots determine it: many
triples are drawn, and the plane that most readings agree with replaces the candidate's where it is
better.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from .. import model
from ..arrays import FloatArray
from ..data.parameters import Parameters
from ..data.recording import Readings
from ..model.losses import Loss, LossName
from ..solvers.refine import LossScale, Refined, refine_many
from .directions import direction_starts, random_starts, subset_starts
from .growing import PartialStart, grow
from .search import Candidate, Judge, Round, search

METHOD = "consensus"
FIRST_SWEPT, SWEPT, TRIED = 12, 32, 400
SUBSET_ROUNDS = 4
RANDOM_ROUNDS, RANDOM_STARTS = 3, 48
CAUCHY_STEPS, TUKEY_STEPS = 40, 10
SHARES = (0.5, 0.25, 0.0)
"""Parts of the redundant readings that must be good, besides as many as there are unknowns."""
AGREEING, LATE_AGREEING = 4, 2
"""So many candidates of the same evidence end the search where the best is beyond chance, and so many
where sweeps on subsets have not brought about more."""
SAME_CRITERION = 0.5
"""Candidates whose criteria differ by less are one solution."""
FIRST_MENDED, MENDING = 8, 3.0
"""So many of the best candidates are mended in each round, with so many times their scale."""
TRIPLES = 60
"""So many draws of three hold three good ones in all but 1e-4 of the cases where half the spots are."""
WIDE = 4.0
"""Readings so many scales off, or more, count alike."""
LEAST_COSINE = 0.1
"""Draws that a beam meets flatter than this make its readings count as far off."""
KEPT = 6
FAR = 5.0
"""Readings so many times beyond three quarters of them take no part in the starts."""


def robust_search(
    readings: Readings,
    others: Sequence[Parameters],
    range_sigma: float | None,
    terms: int,
    judge: Judge,
) -> list[Candidate]:
    """Return the best candidates for readings with outliers that differ, the best first.

    Parameters
    ----------
    readings : Readings
    others : sequence of Parameters
        Candidates of other starts, which compete.
    range_sigma : float, optional
        Standard deviation of a reading [m]; the scale never falls below it.
    terms : int
        Range-error terms of the last steps.
    judge : Judge
        Compares candidates by the readings that agree with them.
    """
    rng = np.random.default_rng(0)
    loss = _RobustLoss(readings, terms, least_scale(readings, range_sigma), rng)
    found, _ = search(_rounds(readings, others, terms, rng), loss, judge)
    found = [one for one in found if np.isfinite(one.criterion)]
    values = np.array([one.criterion for one in found])
    first = np.flatnonzero(np.diff(values, prepend=-np.inf) > SAME_CRITERION)
    return [found[i] for i in first[:KEPT]]


def least_scale(readings: Readings, range_sigma: float | None) -> float:
    """Return the least scale of a robust loss [m]: the given sigma, or rounding."""
    return max(range_sigma or 0.0, 1e-9 * readings.largest_range())


def _rounds(
    readings: Readings, others: Sequence[Parameters], terms: int, rng: np.random.Generator
) -> Iterator[Round]:
    """Yield starts on subsets, sweeps of all readings and random starts."""
    total, unknowns = len(readings), readings.unknowns(terms)
    parts = [(unknowns + share * max(total - unknowns, 0)) / total for share in SHARES]
    parts = [min(max(part, 0.5), 1.0) for part in parts]
    near = _without_far_readings(readings)

    def grown(starts: list[PartialStart]) -> list[tuple[str, Parameters]]:
        return [(METHOD, grow(start, near)) for start in starts]

    known = [(METHOD, other) for other in others]
    few = grown(subset_starts(near, FIRST_SWEPT, TRIED, rng))
    yield Round([*known, *few], parts[0], AGREEING)
    for number in range(SUBSET_ROUNDS):
        drawn = grown(subset_starts(near, SWEPT, TRIED, rng))
        yield Round(drawn, parts[number % len(parts)], AGREEING)
    swept = grown(direction_starts(near, SWEPT, TRIED))
    for part in parts:
        yield Round([*known, *swept], part, LATE_AGREEING)
    for _ in range(RANDOM_ROUNDS):
        drawn = grown(random_starts(near, RANDOM_STARTS, rng))
        for part in parts:
            yield Round(drawn, part, LATE_AGREEING)


def _without_far_readings(readings: Readings) -> Readings:
    """Return the readings without those far beyond the bulk: one of 100 m would tilt every plane."""
    limit = FAR * float(np.quantile(readings.distance, 0.75))
    near = readings.subset(np.flatnonzero(readings.distance <= limit))
    seen = np.bincount(near.plane, minlength=readings.planes)
    return near if seen.all() else readings


@dataclass(frozen=True, slots=True)
class _RobustLoss:
    """Cauchy's loss, then Tukey's; planes of the best candidates are mended."""

    readings: Readings
    terms: int
    least: float
    rng: np.random.Generator

    def refined(self, latest: Round) -> list[tuple[str, Refined]]:
        """Return all starts after both losses."""
        rule, starts = LossScale(self.least, latest.good), [start for _, start in latest.starts]
        loose = refine_many(starts, self.readings, 0, CAUCHY_STEPS, Loss("cauchy"), rule)
        pairs = zip(latest.starts, self._tight(loose, rule), strict=True)
        return [(method, one) for (method, _), one in pairs if one is not None]

    def mended(self, best: Sequence[Candidate], latest: Round) -> list[Refined | None]:
        """Return the best candidates with planes that more readings agree with."""
        rule = LossScale(self.least, latest.good)
        new = [
            mended(one.parameters, self.readings, MENDING * one.scale, self.rng)
            for one in best[:FIRST_MENDED]
        ]
        return self._tight(self._under("cauchy", new, rule), rule)

    def _tight(self, loose: list[Refined | None], rule: LossScale) -> list[Refined | None]:
        usable = [one.parameters for one in loose if one is not None]
        tight = iter(self._under("tukey", usable, rule))
        return [None if one is None else next(tight) for one in loose]

    def _under(self, loss: LossName, at: list[Parameters], rule: LossScale) -> list[Refined | None]:
        return refine_many(at, self.readings, self.terms, TUKEY_STEPS, Loss(loss), rule)


def mended(
    parameters: Parameters, readings: Readings, scale: float, rng: np.random.Generator
) -> Parameters:
    """Return `parameters` with planes that more readings agree with, within about `scale` [m]."""
    normals, offsets = parameters.normals.copy(), parameters.offsets.copy()
    x = model.scene(parameters, readings)
    ahead = np.einsum("nij,nj->ni", x.R, x.v)
    spots = model.spots(x.R, x.t, x.r, x.v, model.corrected(readings.distance, x.k))
    starts = np.searchsorted(readings.plane, np.arange(readings.planes + 1))
    for plane, (first, end) in enumerate(pairwise(starts.tolist())):
        if end - first <= 3:
            continue
        own = slice(first, end)
        n, b = _through_triples(spots[own], rng)
        n = np.vstack((normals[plane], n))
        b = np.append(offsets[plane], b)
        best = int(np.argmin(_costs(n, b, spots[own], ahead[own], scale)))
        if best:
            normals[plane], offsets[plane] = _facing(n[best], b[best], ahead[own])
    return replace(parameters, normals=normals, offsets=offsets)


def _through_triples(spots: FloatArray, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """Return planes (C, 3), (C,) through triples of spots; those in a line are not among them."""
    a, b, c = spots[np.argsort(rng.random((TRIPLES, len(spots))), axis=1)[:, :3]].swapaxes(0, 1)
    n = np.cross(b - a, c - a)
    length = np.linalg.norm(n, axis=1)
    usable = length > 1e-9 * np.ptp(spots, axis=0).max() ** 2
    n = n[usable] / length[usable, None]
    return n, -np.einsum("ci,ci->c", n, a[usable])


def _costs(
    n: FloatArray, b: FloatArray, spots: FloatArray, ahead: FloatArray, scale: float
) -> FloatArray:
    """Return the limited sums of squares (C,) of residuals of spots before planes, in scales."""
    away, cosine = np.abs(n @ spots.T + b[:, None]), np.abs(n @ ahead.T)
    z = np.where(cosine > LEAST_COSINE, away / np.maximum(cosine, LEAST_COSINE) / scale, np.inf)
    cost: FloatArray = (np.minimum(z, WIDE) ** 2).sum(axis=1)
    return cost


def _facing(n: FloatArray, b: float, ahead: FloatArray) -> tuple[FloatArray, float]:
    """Return the plane with its normal away from most sensors."""
    sign = -1.0 if np.median(ahead @ n) < 0.0 else 1.0
    return sign * n, sign * b
