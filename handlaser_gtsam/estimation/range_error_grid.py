"""The prior of range errors: the scales at which it is integrated over, and along what axes.

With L the linearity of the sensor, S is half-Cauchy about L. Along the axes of k1 and k2 D, s1 and s2
are drawn about a scale t that they share and that is half-Cauchy about L: 1 / (1 + s^2 / t^2), by which
a range error that is known as well as t would be drawn to zero, is uniform (Daniels, Canadian Journal
of Statistics 27(3), 1999). Along the axes of every beam that readings know least and best, the scale of
the best known axis is half-Cauchy about L. The scale s of the other axis is drawn about h, the root
mean square of both: the root of 1 / (1 + s^2 / h^2) is uniform (Strawderman, Annals of Mathematical
Statistics 42(1), 1971). A range error that readings do not show then says nothing of one that they
hardly see.

`Contrasts` turn range errors into means over all beams and contrasts between them: there the prior is
diagonal.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np

from ..arrays import BoolArray, FloatArray, IntArray
from ..data.value import Value
from ..model.families import MOUNT_DIM

SCALE_SPAN = 4.5
"""Scales of range errors lie within exp(+-SCALE_SPAN), a hundredfold, of a stated linearity."""
SCALE_STEP = 1.5
"""Step of the coarse grid in the logarithm of a scale, before it is refined near the posterior."""
LARGEST_RANGE_ERROR = 0.9
"""Scales reach up to this part of the reading, however good a sensor is said to be."""
SHARED_SPAN = 16.0
"""The shared scale t lies within exp(+-SHARED_SPAN) of the linearity: its density ends at 1e-7."""
SHARED_STEP = 0.1
"""Step in the logarithm of the shared scale t, far below the width of its densities."""
LOG_DEPTH = 9.0
"""A refined grid keeps points whose log posterior is within this of the largest: e^-9 is nothing."""
REFINED_POINTS = 8
"""Points of a refined grid along each scale: the smooth posterior there needs no more."""
LEAST_ELONGATION = 3.0
"""With a smaller ratio of its standard deviations no combination of k1 and k2 D is the least known."""


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class RangeErrorGrid(Value):
    """Scales of the range errors at which their prior is integrated over, natural units.

    Attributes
    ----------
    individual : (G, T)
        s1, s2: the scales of the individual range errors of the beams, for T terms.
    common : (G,)
        S: the scale of the range error that all beams share; zero for one beam.
    turned : (G,) of bool
        Whether s1 and s2 stand along the axes that readings know least and best, not k1 and k2 D.
    log_prior : (G,)
        Logarithm of the prior, with the volume of a cell.
    angles : (B,)
        Angles from k1 and k2 D to these axes of every beam [rad].
    """

    individual: FloatArray
    common: FloatArray
    turned: BoolArray
    log_prior: FloatArray
    angles: FloatArray

    @classmethod
    def at(cls, individual: FloatArray, angles: FloatArray | None = None) -> "RangeErrorGrid":
        """Return the single point of beams that share nothing, on turned axes where they are given."""
        turned = np.full(1, angles is not None)
        angles = np.zeros(0) if angles is None else angles
        return cls(individual[None], np.zeros(1), turned, np.zeros(1), angles)

    def total(self) -> FloatArray:
        """Return the standard deviations (G, T) of the range errors of a beam, in the mean of all."""
        squares = self.individual**2
        if self.turned.any():
            squares[self.turned] = squares[self.turned] @ (axes(self.angles) ** 2).mean(axis=0)
        return np.asarray(np.sqrt(squares + self.common[:, None] ** 2))

    def typical(self, weight: FloatArray, angles: FloatArray | None) -> "RangeErrorGrid":
        """Return a point for beams that share nothing, on the most probable axes.

        `weight` (G,) are the weights of the points, and `angles` (B,) turn the axes of the beams.
        """
        turned, rows = max(self.bases(), key=lambda basis: float(weight[basis[1]].sum()))
        scale = np.log(np.hypot(self.individual[rows], self.common[rows, None]))
        scale = np.exp(weight[rows] @ scale / weight[rows].sum())
        return RangeErrorGrid.at(scale, angles if turned else None)

    def bases(self) -> Iterator[tuple[bool, IntArray]]:
        """Yield the points whose axes are not turned, and those whose are."""
        for turned in (False, True):
            rows = np.flatnonzero(self.turned == turned)
            if rows.size:
                yield turned, rows

    def part(self, rows: IntArray) -> "RangeErrorGrid":
        """Return some of the points."""
        individual, common = self.individual[rows], self.common[rows]
        turned, log_prior = self.turned[rows], self.log_prior[rows]
        return RangeErrorGrid(individual, common, turned, log_prior, self.angles)


def near_largest(value: FloatArray) -> IntArray:
    """Return the points whose value (G,), a logarithm, is not far below the largest."""
    return np.flatnonzero(value >= value.max() - LOG_DEPTH)


def axes(angles: FloatArray) -> FloatArray:
    """Return axes (B, 2, 2), a row each, that are turned by angles (B,) from k1 and k2 D."""
    cosine, sine = np.cos(angles), np.sin(angles)
    rows = np.array([[cosine, sine], [-sine, cosine]])
    return np.moveaxis(rows, 2, 0)


def farthest(linearity: float) -> float:
    """Return the logarithm of the largest scale of range errors, as a multiple of the linearity."""
    return max(
        SCALE_SPAN, SCALE_STEP * math.ceil(math.log(LARGEST_RANGE_ERROR / linearity) / SCALE_STEP)
    )


def widest_grid(
    linearity: float, terms: int, beams: int, angles: FloatArray | None = None
) -> RangeErrorGrid:
    """Return a coarse grid over all scales that are possible, with angles (B,) also on turned axes."""
    aligned = _widest(linearity, terms, beams, turned=False)
    if angles is None:
        return aligned
    return _joined([aligned, _widest(linearity, terms, beams, turned=True)], angles)


def refined_grid(
    grid: RangeErrorGrid, log_evidence: FloatArray, linearity: float
) -> RangeErrorGrid:
    """Return a finer grid where the posterior of the scales, (G,) without the prior, is not small."""
    terms, most, grids = grid.individual.shape[1], farthest(linearity), []
    if terms == 0:
        return grid
    kept = grid.part(near_largest(log_evidence + grid.log_prior))
    for turned, rows in kept.bases():
        some = kept.part(rows)
        shared = [some.common] if some.common.any() else []
        points = np.column_stack((some.individual, *shared))
        near = np.log(points / linearity)
        low = np.maximum(near.min(axis=0) - 0.5 * SCALE_STEP, -SCALE_SPAN)
        high = np.minimum(near.max(axis=0) + 0.5 * SCALE_STEP, most)
        sides = np.linspace(low, high, REFINED_POINTS, axis=1)
        grids.append(_grid(list(sides), linearity, terms, turned=turned))
    return _joined(grids, grid.angles)


@cache
def _widest(linearity: float, terms: int, beams: int, *, turned: bool) -> RangeErrorGrid:
    if terms == 0:
        return RangeErrorGrid.at(np.ones(0))
    side = np.arange(-SCALE_SPAN, farthest(linearity) + 0.5 * SCALE_STEP, SCALE_STEP)
    return _grid([side] * (terms + int(beams > 1)), linearity, terms, turned=turned)


def _joined(grids: Sequence[RangeErrorGrid], angles: FloatArray) -> RangeErrorGrid:
    """Return grids, each as probable, as one for beams whose axes are turned by angles (B,)."""
    return RangeErrorGrid(
        np.concatenate([grid.individual for grid in grids]),
        np.concatenate([grid.common for grid in grids]),
        np.concatenate([grid.turned for grid in grids]),
        np.concatenate([grid.log_prior for grid in grids]) - math.log(len(grids)),
        angles,
    )


def _grid(
    sides: Sequence[FloatArray], linearity: float, terms: int, *, turned: bool
) -> RangeErrorGrid:
    x = np.stack([axis.ravel() for axis in np.meshgrid(*sides, indexing="ij")], axis=1)
    cell = sum(float(np.log(side[1] - side[0])) for side in sides)
    density = _least_and_best_known(*sides[:2]) if turned else _alike(sides[:terms])
    for side in sides[terms:]:
        density = density[..., None] * _half_cauchy(side)
    scale = linearity * np.exp(x)
    common = scale[:, terms] if x.shape[1] > terms else np.zeros(len(x))
    log_prior = np.log(density).ravel() + cell
    individual = scale[:, :terms]
    return RangeErrorGrid(individual, common, np.full(len(x), turned), log_prior, np.zeros(0))


def _alike(sides: Sequence[FloatArray]) -> FloatArray:
    """Return the density of logarithms of scales that are drawn about one that they share."""
    shared = np.arange(-SHARED_SPAN, SHARED_SPAN + 0.5 * SHARED_STEP, SHARED_STEP)
    density = SHARED_STEP * _half_cauchy(shared)
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


@dataclass(frozen=True, slots=True)
class Contrasts:
    """Range errors of some beams as means over these and contrasts between them: K = B T.

    Attributes
    ----------
    places : (K,)
        Indices of the range errors among all unknowns.
    terms : (K,)
        The term of each mean or contrast.
    turn : (K, K)
        Orthogonal, from range errors, beam after beam, to means (times the root of B) and contrasts.
    is_mean : (K,) of bool
    widest : (K,)
        Standard deviations under the widest prior: all the same, and so along any axes.
    """

    places: IntArray
    terms: IntArray
    turn: FloatArray
    is_mean: BoolArray
    widest: FloatArray

    @classmethod
    def of(cls, beams: IntArray, terms: int, width: int, widest: float) -> "Contrasts":
        """Return the contrasts of `terms` range errors of some beams of `width` unknowns.

        Term after term, the mean over the beams, times the root of their number, first.
        """
        count, places = len(beams), beams[:, None] * width + MOUNT_DIM + np.arange(terms)
        helmert = np.eye(count)
        if count > 1:
            helmert = np.linalg.qr(np.column_stack((np.ones(count), np.eye(count)[:, 1:])))[0].T
        return cls(
            places.ravel(),
            np.repeat(np.arange(terms), count),
            # Rows are terms, then means and contrasts; columns are beams, then terms.
            np.einsum("ab,st->sabt", helmert, np.eye(terms)).reshape((places.size,) * 2),
            np.tile(np.arange(count) == 0, terms),
            np.full(places.size, np.sqrt(1.0 + count) * widest),
        )

    def turned(self, angles: FloatArray) -> FloatArray:
        """Return the matrix (K, K) to the same along axes turned by the angles (B,) of the beams."""
        size = len(self.terms)
        each = self.turn.reshape(size, len(angles), 2)
        turned: FloatArray = np.einsum("kbt,bts->kbs", each, axes(angles)).reshape(size, size)
        return turned @ self.turn.T

    def spread(self, grid: RangeErrorGrid) -> FloatArray:
        """Return the standard deviations (G, K) of the means over the beams and of their contrasts."""
        if grid.individual.shape[1] == 0:  # range errors without a prior
            return np.ones((len(grid.common), len(self.terms)))
        count = np.sqrt(self.is_mean.size / max(int(self.is_mean.sum()), 1))
        shared = np.where(self.is_mean, count, 0.0) * grid.common[:, None]
        return np.asarray(np.hypot(grid.individual[:, self.terms], shared))


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
