"""The prior of range errors: the scales at which it is integrated over, and along what axes.

With L the linearity of the sensor, S is half-Cauchy about L. Along the axes of k1 and k2 D, s1 and s2
are drawn about a scale t that they share and that is half-Cauchy about L: 1 / (1 + s^2 / t^2), by which
a range error that is known as well as t would be drawn to zero, is uniform (Daniels, Canadian Journal
of Statistics 27(3), 1999). Along axes of what readings know worst and best, the scale of the best
known is half-Cauchy about L, and that of the other is drawn likewise about the root of the sum of
both squares: where readings find nothing, that says nothing of what they hardly see.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from ..arrays import FloatArray, IntArray
from ..data.value import Value

SPAN, STEP = 4.5, 1.5
"""The scales of range errors are sought within exp(+-SPAN) of the linearity, in such steps,"""
LARGEST = 0.9
"""and at least up to this part of the reading, however good a sensor is said to be."""
SHARED, SHARED_STEP = 14.0, 0.1
"""The scale t that the terms share is integrated over within exp(+-SHARED) of the linearity."""
ALIGNED = 1.0 / 3.0
"""Prior probability of the axes of k1 and k2 D beside others."""
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
    angle : (G,)
        By which the axes of s1 and s2 are turned from those of k1 and k2 D [rad].
    log_prior : (G,)
        With the volume of a cell.
    """

    own: FloatArray
    common: FloatArray
    angle: FloatArray
    log_prior: FloatArray

    @classmethod
    def at(cls, own: FloatArray, angle: float = 0.0) -> "RangeErrorGrid":
        """Return the single point of beams that share nothing."""
        return cls(own[None], np.zeros(1), np.full(1, angle), np.zeros(1))

    def total(self) -> FloatArray:
        """Return the standard deviations (G, T) of the range errors of one beam."""
        squares = self.own**2
        for angle, rows in self.bases():
            squares[rows] = squares[rows] @ axes(angle, self.own.shape[1]) ** 2
        found: FloatArray = np.sqrt(squares + self.common[:, None] ** 2)
        return found

    def typical(self, weight: FloatArray) -> "RangeErrorGrid":
        """Return a point for beams that share nothing, on the most probable axes: weights (G,)."""
        angle, rows = max(self.bases(), key=lambda basis: float(weight[basis[1]].sum()))
        own = np.log(np.hypot(self.own[rows], self.common[rows, None]))
        return RangeErrorGrid.at(np.exp(weight[rows] @ own / weight[rows].sum()), angle)

    def drawn(self, point: int, beams: int, rng: np.random.Generator) -> FloatArray:
        """Return range errors (B, T) of some beams, drawn from the prior at a point."""
        terms = self.own.shape[1]
        own = self.own[point] * rng.standard_normal((beams, terms))
        shared = self.common[point] * rng.standard_normal(terms)
        found: FloatArray = own @ axes(float(self.angle[point]), terms) + shared
        return found

    def bases(self) -> Iterator[tuple[float, IntArray]]:
        """Yield every angle with its points."""
        for angle in np.unique(self.angle).tolist():
            yield angle, np.flatnonzero(self.angle == angle)

    def part(self, rows: IntArray) -> "RangeErrorGrid":
        """Return some of the points."""
        every = (self.own, self.common, self.angle, self.log_prior)
        return RangeErrorGrid(*(one[rows] for one in every))

    def near(self, value: FloatArray) -> "RangeErrorGrid":
        """Return the points whose value (G,), in the logarithm, is not far below the largest."""
        return self.part(np.flatnonzero(value >= value.max() - WIDTH))


def axes(angle: float, terms: int) -> FloatArray:
    """Return the axes (T, T), a row each, that are turned by an angle from those of k1 and k2 D."""
    if terms != 2:
        return np.eye(terms)
    cosine, sine = np.cos(angle), np.sin(angle)
    return np.array([[cosine, sine], [-sine, cosine]])


def farthest(linearity: float) -> float:
    """Return the logarithm of the largest scale of range errors, as a multiple of the linearity."""
    return max(SPAN, STEP * math.ceil(math.log(LARGEST / linearity) / STEP))


def widest_grid(
    linearity: float, terms: int, beams: int, angle: float | None = None
) -> RangeErrorGrid:
    """Return a coarse grid over all scales that are possible, with an angle also on turned axes."""
    aligned = _widest(linearity, terms, beams, turned=False)
    if angle is None:
        return aligned
    return _joined({0.0: aligned, angle: _widest(linearity, terms, beams, turned=True)})


def refined_grid(
    grid: RangeErrorGrid, log_evidence: FloatArray, linearity: float
) -> RangeErrorGrid:
    """Return a finer grid where the posterior of the scales, (G,) without the prior, is not small."""
    terms, most, found = grid.own.shape[1], farthest(linearity), {}
    if terms == 0:
        return grid
    kept = grid.near(log_evidence + grid.log_prior)
    for angle, rows in kept.bases():
        some = kept.part(rows)
        points = np.column_stack((some.own, some.common))[:, : terms + int(some.common.any())]
        near = np.log(points / linearity)
        sides = [
            np.linspace(max(low - 0.5 * STEP, -SPAN), min(high + 0.5 * STEP, most), POINTS)
            for low, high in zip(near.min(axis=0), near.max(axis=0), strict=True)
        ]
        found[angle] = _grid(sides, linearity, terms, turned=angle != 0.0)
    return _joined(found)


@cache
def _widest(linearity: float, terms: int, beams: int, *, turned: bool) -> RangeErrorGrid:
    if terms == 0:
        return RangeErrorGrid.at(np.ones(0))
    side = np.arange(-SPAN, farthest(linearity) + 0.5 * STEP, STEP)
    return _grid([side] * (terms + int(beams > 1)), linearity, terms, turned=turned)


def _joined(grids: Mapping[float, RangeErrorGrid]) -> RangeErrorGrid:
    """Return grids, each on axes turned by its angle, as one."""
    if len(grids) == 1:
        ((angle, grid),) = grids.items()
        return replace(grid, angle=grid.angle + angle)
    parts = []
    for angle, grid in grids.items():
        share = np.log(ALIGNED if angle == 0.0 else 1.0 - ALIGNED)
        parts.append((grid.own, grid.common, grid.angle + angle, grid.log_prior + share))
    return RangeErrorGrid(*map(np.concatenate, zip(*parts, strict=True)))


def _grid(
    sides: Sequence[FloatArray], linearity: float, terms: int, *, turned: bool
) -> RangeErrorGrid:
    x = np.stack([axis.ravel() for axis in np.meshgrid(*sides, indexing="ij")], axis=1)
    cell = sum(float(np.log(side[1] - side[0])) for side in sides)
    density = _worst_and_best(*sides[:2]) if turned else _alike(sides[:terms])
    for side in sides[terms:]:
        density = density[..., None] * _half_cauchy(side)
    scale = linearity * np.exp(x)
    common = scale[:, terms] if x.shape[1] > terms else np.zeros(len(x))
    log_prior = np.log(density).ravel() + cell
    return RangeErrorGrid(scale[:, :terms], common, np.zeros(len(x)), log_prior)


def _alike(sides: Sequence[FloatArray]) -> FloatArray:
    """Return the density of logarithms of scales that are drawn about one that they share."""
    shared = np.arange(-SHARED, SHARED + 0.5 * SHARED_STEP, SHARED_STEP)
    density = SHARED_STEP * _half_cauchy(shared)
    for side in sides:  # what is shared stays the last axis
        density = density[..., None, :] * _uniform_shrinkage(side[:, None] - shared)
    found: FloatArray = density.sum(axis=-1)
    return found


def _worst_and_best(worst: FloatArray, best: FloatArray) -> FloatArray:
    """Return the density of logarithms of the scales along what is known worst and best."""
    about = 0.5 * np.logaddexp(0.0, 2.0 * best)
    return _uniform_shrinkage(worst[:, None] - about) * _half_cauchy(best)


def _half_cauchy(x: FloatArray) -> FloatArray:
    """Return the density of the logarithm x of a half-Cauchy variable of scale 1: |x| below 700."""
    density: FloatArray = 1.0 / (np.pi * np.cosh(x))
    return density


def _uniform_shrinkage(x: FloatArray) -> FloatArray:
    """Return the density of the logarithm x of a scale for which 1 / (1 + scale^2) is uniform."""
    density: FloatArray = 0.5 / np.cosh(x) ** 2
    return density
