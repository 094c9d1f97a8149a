"""Starts among outliers: many candidates, each tightened around the readings that agree with it.

A linear start follows its outliers. Here every candidate, linear or swept, is refined with Cauchy's
loss, whose scale follows the residuals of those readings that must be good for the answer to mean
anything, and so tightens by itself; a few steps with Tukey's loss let go of the rest. Gross errors
agree with nothing: the candidates that reach the strongest evidence have reached the consensus.

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
from ..model.search import LossScale
from ..quantities import ROUNDING
from ..solvers.refine import Refined, refine_many
from .directions import FLATTEST, direction_starts, random_starts, subset_starts
from .growing import PartialStart, grow
from .search import AGREEING, FINALISTS, FIRST_STEPS, LAST_STEPS, Candidate, Judge, Round, search

METHOD = "consensus"
GOOD_SHARES = (0.5, 0.25, 0.0)
"""Parts of the redundant readings that must be good, besides as many as there are unknowns."""
SAME_CRITERION = 0.5
"""Candidates whose evidence, twice a logarithm, differs by less than this are one solution."""


@dataclass(frozen=True, slots=True)
class RobustSearch:
    """How many candidates the robust search tries, and how it mends their planes.

    Attributes
    ----------
    first_swept, swept, directions : int
        Starts that the first sweep on subsets of the stations and every later one keep, of so
        many directions that are tried.
    subset_rounds : int
        Sweeps on subsets after the first.
    random_rounds, random_starts : int
        Rounds of random starts, the last resort, and starts a round.
    late_agreeing : int
        Candidates of the same evidence that end the search once sweeps on subsets have not brought
        about more.
    mended : int
        Best candidates whose planes are mended in every round.
    mending_scales : float
        Readings within this many scales of a candidate support a plane that replaces its own.
    triples : int
        Draws of three spots a plane: all but 1e-4 of the cases hold three good ones where half are.
    far_scales : float
        Readings at least this many such scales off count alike.
    far_range : float
        Readings above this many times the upper quartile take no part in the starts.
    """

    first_swept: int = 12
    swept: int = 32
    directions: int = 400
    subset_rounds: int = 4
    random_rounds: int = 3
    random_starts: int = 48
    late_agreeing: int = 2
    mended: int = 8
    mending_scales: float = 3.0
    triples: int = 60
    far_scales: float = 4.0
    far_range: float = 5.0


SEARCH = RobustSearch()
"""The sizes of every robust search."""


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
    candidates, _ = search(_rounds(readings, others, terms, rng), loss, judge)
    candidates = [candidate for candidate in candidates if np.isfinite(candidate.criterion)]
    values = np.array([candidate.criterion for candidate in candidates])
    first = np.flatnonzero(np.diff(values, prepend=-np.inf) > SAME_CRITERION)
    return [candidates[i] for i in first[:FINALISTS]]


def least_scale(readings: Readings, range_sigma: float | None) -> float:
    """Return the least scale of a robust loss [m]: the given sigma, or rounding."""
    return max(range_sigma or 0.0, ROUNDING * readings.largest_range())


def _rounds(
    readings: Readings, others: Sequence[Parameters], terms: int, rng: np.random.Generator
) -> Iterator[Round]:
    """Yield starts on subsets, sweeps of all readings and random starts."""
    total, unknowns = len(readings), readings.unknowns(terms)
    parts = [(unknowns + share * max(total - unknowns, 0)) / total for share in GOOD_SHARES]
    parts = [min(max(part, 0.5), 1.0) for part in parts]
    # A reading far beyond the bulk, as of 100 m, would tilt every plane.
    limit = SEARCH.far_range * float(np.quantile(readings.distance, 0.75))
    near = readings.subset(np.flatnonzero(readings.distance <= limit))
    if not np.bincount(near.plane, minlength=readings.planes).all():
        near = readings

    def grown(starts: list[PartialStart]) -> list[tuple[str, Parameters]]:
        return [(METHOD, grow(start, near)) for start in starts]

    known = [(METHOD, other) for other in others]
    few = grown(subset_starts(near, SEARCH.first_swept, SEARCH.directions, rng))
    yield Round([*known, *few], parts[0], AGREEING)
    for number in range(SEARCH.subset_rounds):
        drawn = grown(subset_starts(near, SEARCH.swept, SEARCH.directions, rng))
        yield Round(drawn, parts[number % len(parts)], AGREEING)
    swept = grown(direction_starts(near, SEARCH.swept, SEARCH.directions))
    for part in parts:
        yield Round([*known, *swept], part, SEARCH.late_agreeing)
    for _ in range(SEARCH.random_rounds):
        drawn = grown(random_starts(near, SEARCH.random_starts, rng))
        for part in parts:
            yield Round(drawn, part, SEARCH.late_agreeing)


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
        loose = refine_many(starts, self.readings, 0, LAST_STEPS, Loss("cauchy"), rule)
        pairs = zip(latest.starts, self._tight(loose, rule), strict=True)
        return [(method, refined) for (method, _), refined in pairs if refined is not None]

    def mended(self, best: Sequence[Candidate], latest: Round) -> list[Refined | None]:
        """Return the best candidates with planes that more readings agree with."""
        rule = LossScale(self.least, latest.good)
        new = [
            mended(
                candidate.parameters,
                self.readings,
                SEARCH.mending_scales * candidate.scale,
                self.rng,
            )
            for candidate in best[: SEARCH.mended]
        ]
        return self._tight(self._under("cauchy", new, rule), rule)

    def _tight(self, loose: list[Refined | None], rule: LossScale) -> list[Refined | None]:
        usable = [refined.parameters for refined in loose if refined is not None]
        tight = iter(self._under("tukey", usable, rule))
        return [None if refined is None else next(tight) for refined in loose]

    def _under(
        self, loss: LossName, parameters: list[Parameters], rule: LossScale
    ) -> list[Refined | None]:
        return refine_many(parameters, self.readings, self.terms, FIRST_STEPS, Loss(loss), rule)


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
        rows = slice(first, end)
        n, b = _through_triples(spots[rows], rng)
        n = np.vstack((normals[plane], n))
        b = np.append(offsets[plane], b)
        # The limited sums of squares of residuals of spots before the planes, in scales.
        away, cosine = np.abs(n @ spots[rows].T + b[:, None]), np.abs(n @ ahead[rows].T)
        e = np.where(cosine > FLATTEST, away / np.maximum(cosine, FLATTEST) / scale, np.inf)
        best = int(np.argmin((np.minimum(e, SEARCH.far_scales) ** 2).sum(axis=1)))
        if best:  # its normal points away from most sensors
            sign = -1.0 if np.median(ahead[rows] @ n[best]) < 0.0 else 1.0
            normals[plane], offsets[plane] = sign * n[best], sign * b[best]
    return replace(parameters, normals=normals, offsets=offsets)


def _through_triples(spots: FloatArray, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """Return planes (C, 3), (C,) through triples of spots that are not in a line."""
    drawn = np.argsort(rng.random((SEARCH.triples, len(spots))), axis=1)[:, :3]
    a, b, c = spots[drawn].swapaxes(0, 1)
    n = np.cross(b - a, c - a)
    length = np.linalg.norm(n, axis=1)
    usable = length > ROUNDING * np.ptp(spots, axis=0).max() ** 2
    n = n[usable] / length[usable, None]
    return n, -np.einsum("ci,ci->c", n, a[usable])
