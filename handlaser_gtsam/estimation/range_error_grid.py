"""The prior of range errors: the scales at which it is integrated over, and along what axes.

With L the linearity of the sensor, the mean of the range errors of all beams has a scale S that is
half-Cauchy about L, and what each beam has beside it has scales s1 and s2. These have one of two
priors, each as probable as the other:

- Along k1 and k2 D, s1 and s2 are drawn about a scale t that they share and that is half-Cauchy about
  L: 1 / (1 + s^2 / t^2), by which a range error that is known as well as t would be drawn to zero, is
  uniform (Daniels, Canadian Journal of Statistics 27(3), 1999).
- Along the axes of every beam that readings know least and best, the scale of the best known axis is
  half-Cauchy about L. The scale s of the other is drawn about h, the root mean square of both: the root
  of 1 / (1 + s^2 / h^2) is uniform (Strawderman, Annals of Mathematical Statistics 42(1), 1971). A
  range error that readings do not show then says nothing of one that they hardly see.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import helmert

from ..arrays import FloatArray, IntArray
from ..data.value import Value

SCALE_SPAN = 4.5
"""Scales of range errors lie within exp(+-SCALE_SPAN), a hundredfold, of a stated linearity."""
GRID_POINTS = 8
"""Points along each scale of the coarse grid over all, and of the finer one about probable ones."""
LOG_DEPTH = 9.0
"""A grid keeps points whose log posterior is within this of the largest: e^-9 is nothing."""
LEAST_ELONGATION = 3.0
"""With a smaller ratio of its standard deviations no combination of k1 and k2 D is the least known."""


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class RangeErrorGrid(Value):
    """Scales of the range errors at which one of their priors is integrated over, natural units.

    Attributes
    ----------
    individual : (G, T)
        s1, s2: the scales of the individual range errors of the beams, for T terms.
    common : (G,)
        S: the scale of the range error that all beams share; zero for one beam.
    log_prior : (G,)
        Logarithm of the prior, with the volume of a cell.
    angles : (B,)
        Angles of the axes of s1 and s2 from those of k1 and k2 D, for every beam [rad].
    """

    individual: FloatArray
    common: FloatArray
    log_prior: FloatArray
    angles: FloatArray

    @classmethod
    def at(cls, scale: FloatArray, angles: FloatArray) -> "RangeErrorGrid":
        """Return the single point of known scales (T,) of beams that share nothing."""
        return cls(scale[None], np.zeros(1), np.zeros(1), angles)

    @property
    def turned(self) -> bool:
        """Whether s1 and s2 stand along other axes than k1 and k2 D."""
        return bool(self.angles.any())

    def total(self) -> FloatArray:
        """Return the standard deviations (G, T) of k1 and k2 D of a beam, in the mean of all."""
        squares = self.individual**2 @ (self._axes() ** 2).mean(axis=0)
        return np.asarray(np.sqrt(squares + self.common[:, None] ** 2))

    def contrasts(self) -> FloatArray:
        """Return the orthogonal matrix (B T, B T) that makes the prior diagonal.

        Range errors, beam after beam, become their mean over the beams along each axis, times the root
        of B, then contrasts between beams.
        """
        size = self.individual.shape[1] * len(self.angles)
        turned = np.einsum("ab,bst->asbt", helmert(len(self.angles), full=True), self._axes())
        return np.asarray(turned.reshape(size, size))

    def spread(self) -> FloatArray:
        """Return the standard deviations (G, B T) of the means and contrasts under the prior."""
        count = len(self.angles)
        variance = np.repeat(self.individual[:, None] ** 2, count, axis=1)
        variance[:, 0] += count * self.common[:, None] ** 2
        return np.asarray(np.sqrt(variance.reshape(len(variance), -1)))

    def part(self, rows: IntArray) -> "RangeErrorGrid":
        """Return some of the points."""
        individual, common = self.individual[rows], self.common[rows]
        return RangeErrorGrid(individual, common, self.log_prior[rows], self.angles)

    def _axes(self) -> FloatArray:
        """Return the axes (B, T, T) of every beam, a row each."""
        cosine, sine = np.cos(self.angles), np.sin(self.angles)
        terms = self.individual.shape[1]
        rows = np.array([[cosine, sine], [-sine, cosine]])[:terms, :terms]
        return np.moveaxis(rows, 2, 0)


def near_largest(
    grids: Sequence[RangeErrorGrid], values: Sequence[FloatArray]
) -> list[tuple[RangeErrorGrid, FloatArray]]:
    """Return the points of grids whose values (G,), logarithms, are near the largest of all."""
    least = max(float(value.max()) for value in values) - LOG_DEPTH
    near = [np.flatnonzero(value >= least) for value in values]
    pairs = zip(grids, values, near, strict=True)
    return [(grid.part(rows), value[rows]) for grid, value, rows in pairs if rows.size]


def widest_scale(linearity: float) -> float:
    """Return the largest scale of range errors: about the reading, whatever is said of the sensor."""
    return max(linearity * math.exp(SCALE_SPAN), 0.9)


def widest_grids(
    linearity: float, terms: int, beams: int, angles: FloatArray | None
) -> list[RangeErrorGrid]:
    """Return a coarse grid over all scales that are possible, and one along turned axes (B,) if any."""
    if terms == 0:
        return [RangeErrorGrid.at(np.ones(0), np.zeros(beams))]
    sides = [_side(linearity)] * (terms + int(beams > 1))
    axes = [np.zeros(beams)] if angles is None else [np.zeros(beams), angles]
    return [_grid(sides, linearity, terms, each) for each in axes]


def refined_grid(near: RangeErrorGrid, linearity: float) -> RangeErrorGrid:
    """Return a finer grid about the points of the coarse one that are near the most probable."""
    terms = near.individual.shape[1]
    if terms == 0:
        return near
    shared = [near.common] if near.common.any() else []
    points = np.log(np.column_stack((near.individual, *shared)) / linearity)
    side = _side(linearity)
    half = 0.5 * (side[1] - side[0])
    low = np.maximum(points.min(axis=0) - half, side[0])
    high = np.minimum(points.max(axis=0) + half, side[-1])
    sides = np.linspace(low, high, GRID_POINTS, axis=1)
    return _grid(list(sides), linearity, terms, near.angles)


def _side(linearity: float) -> FloatArray:
    """Return logarithms of scales, as multiples of the linearity, over all that is possible."""
    return np.linspace(-SCALE_SPAN, math.log(widest_scale(linearity) / linearity), GRID_POINTS)


def _grid(
    sides: Sequence[FloatArray], linearity: float, terms: int, angles: FloatArray
) -> RangeErrorGrid:
    """Return the grid over logarithms of scales over the linearity: of the axes, then of S if any."""
    x = np.stack([axis.ravel() for axis in np.meshgrid(*sides, indexing="ij")], axis=1)
    cell = sum(float(np.log(side[1] - side[0])) for side in sides)
    own = sides[:terms]
    density = _least_and_best_known(*own) if angles.any() else _alike(own)
    for side in sides[terms:]:
        density = density[..., None] * _half_cauchy(side)
    scale = linearity * np.exp(x)
    common = scale[:, terms] if x.shape[1] > terms else np.zeros(len(x))
    return RangeErrorGrid(scale[:, :terms], common, np.log(density).ravel() + cell, angles)


def _alike(sides: Sequence[FloatArray]) -> FloatArray:
    """Return the density of logarithms of scales that are drawn about one that they share."""
    step = 0.1  # far below the width of the densities, which at the ends are 1e-7
    shared = np.arange(-16.0, 16.0 + 0.5 * step, step)
    density = step * _half_cauchy(shared)
    for side in sides:  # what is shared stays the last axis; 1 / (1 + scale^2) is uniform
        density = density[..., None, :] * 0.5 / np.cosh(side[:, None] - shared) ** 2
    return np.asarray(density.sum(axis=-1))


def _least_and_best_known(worst: FloatArray, best: FloatArray) -> FloatArray:
    """Return the density of logarithms of the scales along the axes that are known least and best."""
    about = 0.5 * (np.logaddexp(0.0, 2.0 * best) - math.log(2.0))
    x = worst[:, None] - about
    uniform = np.exp(2.0 * x - 1.5 * np.logaddexp(0.0, 2.0 * x))  # 1 / sqrt(1 + scale^2) is
    return np.asarray(uniform * _half_cauchy(best))


def _half_cauchy(x: FloatArray) -> FloatArray:
    """Return the density of the logarithm x of a half-Cauchy variable of scale 1: |x| below 700."""
    return np.asarray(1.0 / (np.pi * np.cosh(x)))


def worst_known(V: FloatArray) -> FloatArray | None:
    """Return the angles (B,) [rad] from k1 to the least known combination of k1 and k2 D of each beam.

    That is the longest axis of the covariance (B, T, T) of the beam; a beam without such an axis takes
    the mean of the others. None where there is one term, or no beam has such an axis.
    """
    if V.shape[1] != 2:
        return None
    values, vectors = np.linalg.eigh(V)
    angles = np.arctan2(vectors[:, 1, 1], vectors[:, 0, 1])
    long = values[:, 1] > LEAST_ELONGATION**2 * np.maximum(values[:, 0], 0.0)
    if not long.any():
        return None
    double = np.exp(2j * angles[long]).sum()
    mean = 0.5 * float(np.angle(double))
    # Axes have no sign: let the axes of all beams point the same way.
    off = np.where(long, (angles - mean + 0.5 * math.pi) % math.pi - 0.5 * math.pi, 0.0)
    return np.asarray(mean + off)
