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

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from .. import model
from ..arrays import FloatArray
from ..data.parameters import Parameters
from ..data.recording import Readings
from ..model.damped_search import RobustLoss
from ..model.families import count_unknowns
from ..model.losses import Loss
from ..quantities import FAR_SIGMAS, ROUNDING
from ..solvers.beam_problem import Candidate, refine_many
from .directions import FLATTEST, direction_starts, random_starts, subset_starts
from .rounds import AGREEING, FINALISTS, FIRST_STEPS, LAST_STEPS, Round, search

METHOD = "consensus"
CAUCHY = Loss("cauchy")
SAME_CRITERION = 0.5
"""Candidates whose evidence, twice a logarithm, differs by less than this are one solution."""


def robust_search(
    readings: Readings,
    others: Sequence[Parameters],
    range_sigma: float | None,
    terms: int,
    criterion: Callable[[Candidate], float],
    convinced: Callable[[Sequence[Candidate], Round, float], bool],
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
    criterion, convinced : callable
        Compare candidates by the readings that agree with them; see `rounds`.
    """
    rng = np.random.default_rng(0)
    least = least_scale(readings, range_sigma)

    def judged(one: Candidate) -> Candidate:
        return one._replace(criterion=criterion(one), method=METHOD)

    def mend(best: Sequence[Candidate], latest: Round) -> list[Candidate | None]:
        """Return the best eight candidates with planes that more readings agree with.

        Readings within three scales of a candidate support a plane that replaces its own.
        """
        rule = RobustLoss(CAUCHY, least, latest.good)
        new = [mended(one.parameters, readings, 3.0 * one.scale, rng) for one in best[:8]]
        loose = refine_many(new, readings, terms, FIRST_STEPS, rule)
        tight = _tight(loose, readings, terms, rule)
        return [None if one is None else judged(one) for one in tight]

    candidates, _ = search(
        rounds(readings, others, terms, rng),
        lambda latest: list(map(judged, refined_starts(latest, readings, terms, least))),
        convinced,
        mend,
    )
    candidates = [candidate for candidate in candidates if np.isfinite(candidate.criterion)]
    values = np.array([candidate.criterion for candidate in candidates])
    first = np.flatnonzero(np.diff(values, prepend=-np.inf) > SAME_CRITERION)
    return [candidates[i] for i in first[:FINALISTS]]


def least_scale(readings: Readings, range_sigma: float | None) -> float:
    """Return the least scale of a robust loss [m]: the given sigma, or rounding."""
    return max(range_sigma or 0.0, ROUNDING * readings.largest_range())


def rounds(
    readings: Readings, others: Sequence[Parameters], terms: int, rng: np.random.Generator
) -> Iterator[Round]:
    """Yield starts on subsets, sweeps of all readings and random starts."""
    total, unknowns = len(readings), count_unknowns(readings, terms)
    # Beside as many as there are unknowns a half, a quarter or none of the readings must be good.
    parts = [(unknowns + share * max(total - unknowns, 0)) / total for share in (0.5, 0.25, 0.0)]
    parts = [min(max(part, 0.5), 1.0) for part in parts]
    # A reading far beyond the bulk, as of 100 m, would tilt every plane: none takes part above five
    # times the upper quartile.
    limit = 5.0 * float(np.quantile(readings.distance, 0.75))
    near = readings.subset(np.flatnonzero(readings.distance <= limit))
    if not np.bincount(near.plane, minlength=readings.planes).all():
        near = readings

    directions = 400  # that each sweep tries; it keeps so many of them as the next number says
    few = subset_starts(near, 12, directions, rng)
    yield Round.of(METHOD, [*others, *few], parts[0], AGREEING)
    for number in range(4):
        drawn = subset_starts(near, 32, directions, rng)
        yield Round.of(METHOD, drawn, parts[number % len(parts)], AGREEING)
    # Sweeps on subsets have not brought about agreement: two alike will do.
    swept = direction_starts(near, 32, directions)
    for part in parts:
        yield Round.of(METHOD, [*others, *swept], part, 2)
    for _ in range(3):
        drawn = random_starts(near, 48, rng)
        for part in parts:
            yield Round.of(METHOD, drawn, part, 2)


def refined_starts(latest: Round, readings: Readings, terms: int, least: float) -> list[Candidate]:
    """Return all starts of a round after Cauchy's loss and then Tukey's."""
    rule, starts = RobustLoss(CAUCHY, least, latest.good), [start for _, start in latest.starts]
    loose = refine_many(starts, readings, 0, LAST_STEPS, rule)
    return [one for one in _tight(loose, readings, terms, rule) if one is not None]


def _tight(
    loose: list[Candidate | None], readings: Readings, terms: int, rule: RobustLoss
) -> list[Candidate | None]:
    """Return candidates after Tukey's loss."""
    usable = [refined.parameters for refined in loose if refined is not None]
    rule = replace(rule, loss=Loss("tukey"))
    tight = iter(refine_many(usable, readings, terms, FIRST_STEPS, rule))
    return [None if refined is None else next(tight) for refined in loose]


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
        # The sums of squares of residuals of spots before the planes, in scales: far ones count alike.
        away, cosine = np.abs(n @ spots[rows].T + b[:, None]), np.abs(n @ ahead[rows].T)
        e = np.where(cosine > FLATTEST, away / np.maximum(cosine, FLATTEST) / scale, np.inf)
        best = int(np.argmin((np.minimum(e, FAR_SIGMAS) ** 2).sum(axis=1)))
        if best:  # its normal points away from most sensors
            sign = -1.0 if np.median(ahead[rows] @ n[best]) < 0.0 else 1.0
            normals[plane], offsets[plane] = sign * n[best], sign * b[best]
    return replace(parameters, normals=normals, offsets=offsets)


def _through_triples(spots: FloatArray, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """Return planes (C, 3), (C,) through triples of spots that are not in a line."""
    # All but 1e-4 of the cases hold three good spots where half are good.
    drawn = np.argsort(rng.random((60, len(spots))), axis=1)[:, :3]
    a, b, c = spots[drawn].swapaxes(0, 1)
    n = np.cross(b - a, c - a)
    length = np.linalg.norm(n, axis=1)
    usable = length > ROUNDING * np.ptp(spots, axis=0).max() ** 2
    n = n[usable] / length[usable, None]
    return n, -np.einsum("ci,ci->c", n, a[usable])
