"""The prior of range errors: the scales at which it is integrated over, and in what coordinates.

The means over all beams and the contrasts between them make the prior of `mixture` diagonal.

With L the linearity of the sensor, S is half-Cauchy about L; s1 and s2 are drawn about a scale t that
they share and that is half-Cauchy about L: 1 / (1 + s^2 / t^2), by which a range error that is known
as well as t would be drawn to zero, is uniform (Daniels, Canadian Journal of Statistics 27(3), 1999).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np

from ..arrays import BoolArray, FloatArray, IntArray
from ..data.value import Value

SPAN, STEP = 4.5, 1.5
"""The scales of range errors are sought within exp(+-SPAN) of the linearity, in such steps."""
SHARED, SHARED_STEP = 10.0, 0.1
"""The scale t that the terms share is integrated over within exp(+-SHARED) of the linearity."""
WIDTH = 9.0
"""A grid that is refined keeps what is within this of the top, in the logarithm."""
POINTS = 8


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class RangeErrorGrid(Value):
    """Scales of the range errors at which their prior is integrated over, natural units.

    Attributes
    ----------
    own : (G, T)
        s1, s2: of the beams by themselves, for T terms.
    common : (G,)
        S: of what all beams share; zero for one beam.
    log_prior : (G,)
        With the volume of a cell.
    """

    own: FloatArray
    common: FloatArray
    log_prior: FloatArray

    def total(self) -> FloatArray:
        """Return the standard deviations (G, T) of the range errors of one beam."""
        found: FloatArray = np.hypot(self.own, self.common[:, None])
        return found

    def near(self, value: FloatArray) -> "RangeErrorGrid":
        """Return the points whose value (G,), in the logarithm, is not far below the largest."""
        kept = value >= value[: max(len(value) - 1, 1)].max() - WIDTH
        kept[-1] = True
        return RangeErrorGrid(self.own[kept], self.common[kept], self.log_prior[kept])


@cache
def widest_grid(linearity: float, terms: int, beams: int) -> RangeErrorGrid:
    """Return a coarse grid over all scales that are possible."""
    steps = round(SPAN / STEP)
    side = np.arange(-steps, steps + 1, dtype=np.float64) * STEP
    return _grid([side] * _axes(terms, beams), linearity, terms)


def refined_grid(
    grid: RangeErrorGrid, log_evidence: FloatArray, linearity: float
) -> RangeErrorGrid:
    """Return a finer grid where the posterior of the scales, (G,) without the prior, is not small."""
    terms = grid.own.shape[1]
    if terms == 0:
        return grid
    value = log_evidence + grid.log_prior
    points = np.column_stack((grid.own, grid.common))[value >= value.max() - WIDTH]
    points = points[:, : terms + int(grid.common.any())]
    near = np.log(points / linearity)
    sides = [
        np.linspace(max(low - 0.5 * STEP, -SPAN), min(high + 0.5 * STEP, SPAN), POINTS)
        for low, high in zip(near.min(axis=0), near.max(axis=0), strict=True)
    ]
    return _grid(sides, linearity, terms)


def _axes(terms: int, beams: int) -> int:
    """Return how many scales there are."""
    return 0 if terms == 0 else terms + int(beams > 1)


def _grid(sides: Sequence[FloatArray], linearity: float, terms: int) -> RangeErrorGrid:
    if not sides:
        return RangeErrorGrid(np.ones((1, 0)), np.zeros(1), np.zeros(1))
    x = np.stack([axis.ravel() for axis in np.meshgrid(*sides, indexing="ij")], axis=1)
    cell = sum(float(np.log(side[1] - side[0])) for side in sides)
    shared = np.arange(-SHARED, SHARED + 0.5 * SHARED_STEP, SHARED_STEP)
    density = SHARED_STEP * _half_cauchy(shared)
    for side in sides[:terms]:  # what is shared stays the last axis
        density = density[..., None, :] * _uniform_shrinkage(side[:, None] - shared)
    density = density.sum(axis=-1)
    for side in sides[terms:]:
        density = density[..., None] * _half_cauchy(side)
    log_prior = np.log(density).ravel()
    scale = linearity * np.exp(x)
    common = scale[:, terms] if x.shape[1] > terms else np.zeros(len(x))
    return RangeErrorGrid(scale[:, :terms], common, log_prior + cell)


def _half_cauchy(x: FloatArray) -> FloatArray:
    """Return the density of the logarithm x of a half-Cauchy variable of scale 1: |x| below 700."""
    density: FloatArray = 1.0 / (np.pi * np.cosh(x))
    return density


def _uniform_shrinkage(x: FloatArray) -> FloatArray:
    """Return the density of the logarithm x of a scale for which 1 / (1 + scale^2) is uniform."""
    density: FloatArray = 0.5 / np.cosh(x) ** 2
    return density


@dataclass(frozen=True, slots=True)
class Contrasts:
    """Range errors of some beams as means over these and contrasts between them: K = B T.

    Attributes
    ----------
    at : (K,)
        Their places among all unknowns.
    terms : (K,)
        The term of each mean or contrast.
    turn : (K, K)
        Orthogonal, from range errors, beam after beam, to means (times the root of B) and contrasts.
    is_mean : (K,) of bool
    widest : (K,)
        Standard deviations under the widest prior.
    """

    at: IntArray
    terms: IntArray
    turn: FloatArray
    is_mean: BoolArray
    widest: FloatArray

    @classmethod
    def of(cls, beams: IntArray, terms: int, width: int, widest: float) -> "Contrasts":
        """Return those of `terms` range errors of some beams of `width` unknowns."""
        at = (beams[:, None] * width + 5 + np.arange(terms)).ravel()
        turn, is_mean = _contrasts(len(beams), terms)
        wide = np.where(is_mean, np.sqrt(1.0 + len(beams)), 1.0) * widest
        return cls(at, np.repeat(np.arange(terms), len(beams)), turn, is_mean, wide)

    def spread(self, grid: RangeErrorGrid) -> FloatArray:
        """Return the standard deviations (G, K) of the means over the beams and of their contrasts."""
        if grid.own.shape[1] == 0:  # range errors without a prior
            return np.ones((len(grid.common), len(self.terms)))
        count = np.sqrt(self.is_mean.size / max(int(self.is_mean.sum()), 1))
        shared = np.where(self.is_mean, count, 0.0) * grid.common[:, None]
        found: FloatArray = np.hypot(grid.own[:, self.terms], shared)
        return found


def _contrasts(beams: int, terms: int) -> tuple[FloatArray, BoolArray]:
    """Return an orthogonal matrix (K, K) from range errors, beam after beam, to means and contrasts.

    Term after term, the mean over the beams, times the root of their number, first. Also return which
    of them are means.
    """
    one = np.eye(beams)
    if beams > 1:
        one = np.linalg.qr(np.column_stack((np.ones(beams), np.eye(beams)[:, 1:])))[0].T
    turn = np.zeros((terms, beams, beams, terms))
    for term in range(terms):
        turn[term, :, :, term] = one
    is_mean = np.tile(np.arange(beams) == 0, terms)
    return turn.reshape(terms * beams, beams * terms), is_mean
