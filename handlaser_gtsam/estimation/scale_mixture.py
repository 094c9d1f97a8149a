r"""Beams, with the scales of noise and range errors integrated over.

For given scales everything is Gaussian. With the typical range D, the range errors of beam i are

    k1_i = m1 + d1_i,  k2_i D = m2 + d2_i,  d1 ~ N(0, s1^2),  d2 ~ N(0, s2^2),  m1, m2 ~ N(0, S^2):

sensors of one kind err alike, and the robot's scale does so to all of them. All that may also stand
along the axes of each beam that readings know least and best; scales and axes have priors, too
(`RangeErrorGrid`). With a prior wider than any of these let k have the estimate k^ and the covariance
V = T T', and let all other unknowns follow it,

    x = m + G (k - k^),   with the covariance P where k is known.

A narrower prior, R^2 more information in a basis in which it is diagonal (`RangeErrorGrid.contrasts`),
makes that

    V' = T inv(1 + T' R^2 T) T',   k' = V' inv(V) k^,   mean m + G (k' - k^),   covariance P + G V' G',
    log evidence = -(log|1 + R V R| + k^' R inv(1 + R V R) R k^) / 2 + what all narrower priors share.

Sums of squares alone: no digit is lost where the readings do not determine k and the widest prior is
far wider than the narrower one. The posterior is the mixture over all scales, of which mean and
covariance count.

With L the linearity of the sensor, the scale S of the mean of all beams is half-Cauchy about L. What
each beam has beside it has one of two priors, each as probable as the other:

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

from ..arrays import BoolArray, FloatArray, IntArray
from ..data.value import Value
from ..model.families import MOUNT_DIM
from ..quantities import NEGLIGIBLE, SINGULAR

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


def information_of(A: FloatArray, b: FloatArray, c: FloatArray) -> FloatArray:
    """Return what readings say of the beams for J sets of noise scales as one array (J, n + 1, n + 1).

    A (J, n, n) is bordered by b (J, n), with c (J,) in the corner: what planes say adds up.
    """
    return np.block([[A, b[:, :, None]], [b[:, None], c[:, None, None]]])


def parts_of(information: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return A, b and c of `information_of`, with or without the axis of the sets."""
    return information[..., :-1, :-1], information[..., :-1, -1], information[..., -1, -1]


class BeamPosterior:
    """The beams for J sets of noise scales under the widest prior of their range errors.

    Parameters
    ----------
    information : (J, n + 1, n + 1)
        In natural units (`information_of`).
    k : (B, T)
        Range errors at the linearisation that have a prior, natural units; T is zero where none has.
    widest : float
        The widest scale of a range error's prior.
    """

    def __init__(self, information: FloatArray, k: FloatArray, widest: float) -> None:
        self.shape = beams, terms = k.shape
        A, b, c = parts_of(information)
        size = b.shape[1]
        places = np.arange(beams)[:, None] * (size // beams) + MOUNT_DIM + np.arange(terms)
        self.places = places.ravel()
        self.others = np.setdiff1d(np.arange(size), self.places)
        # The mean over B beams, times the root of B, has the scale that all share beside its own.
        self.widest = widest * np.sqrt(1.0 + beams)
        prior, here, of_others = self.widest**-2, k.ravel(), b[:, self.others]
        # A part of a recording may lack a beam.
        matrix = A + NEGLIGIBLE * np.eye(size)
        across = matrix[:, self.others[:, None], self.places]
        self.P, log_det = _inverses(matrix[:, self.others[:, None], self.others])
        self.G = -(self.P @ across)
        known = matrix[:, self.places[:, None], self.places] + np.swapaxes(across, 1, 2) @ self.G
        values, axes = np.linalg.eigh(known)
        values = np.maximum(values, 0.0) + prior  # rounding may have made some negative
        self.T = axes / np.sqrt(values)[:, None]
        self.V = self.T @ np.swapaxes(self.T, 1, 2)
        towards = b[:, self.places] - prior * here
        towards += np.einsum("jak,ja->jk", self.G, of_others)
        step = np.einsum("jkl,jl->jk", self.V, towards)
        alone = np.einsum("jab,jb->ja", self.P, of_others)
        self.k = here + step
        # inv(V) k^, without a difference that could cancel.
        self.y = towards + known @ here + prior * here
        self.mean = np.empty_like(b)
        self.mean[:, self.places] = step
        self.mean[:, self.others] = alone + np.einsum("jak,jk->ja", self.G, step)
        squares = (of_others * alone).sum(axis=1) + (towards * step).sum(axis=1)
        squares -= log_det + np.log(values).sum(axis=1) + prior * float(here @ here)
        self.log_evidence = c + 0.5 * squares

    def log_evidence_of(self, grid: RangeErrorGrid) -> FloatArray:
        """Return the log evidence (J, G) of the noise scales and the scales of the range errors."""
        basis, spread = grid.contrasts(), grid.spread()
        R, size = self._beyond_widest(grid), spread.shape[1]
        V, k = basis @ self.V @ basis.T, self.k @ basis.T
        evidence = np.empty((len(k), len(R)))
        # The last row of the root of 1 + R V R bordered by R k solves for R k.
        inner, RR = np.zeros((len(R), size + 1, size + 1)), R[:, :, None] * R[:, None, :]
        diagonal = np.einsum("gkk->gk", inner)
        for j in range(len(k)):
            right = R * k[j]
            np.multiply(RR, V[j], out=inner[:, :size, :size])
            inner[:, size, :size] = right
            diagonal[:, size] = (right**2).sum(axis=1)
            diagonal += 1.0
            root = np.linalg.cholesky(inner)
            log_root = np.log(np.einsum("gkk->gk", root)[:, :size]).sum(axis=1)
            evidence[j] = -0.5 * (root[:, size, :size] ** 2).sum(axis=1) - log_root
        evidence += self.log_evidence[:, None] - np.log(spread).sum(axis=1)
        return evidence

    def worst_known(self) -> FloatArray | None:
        """Return the angles (B,) of the least known combinations of k1 and k2 D in the first set."""
        each = np.arange(self.shape[0])
        return worst_known(self.V[0].reshape(self.shape * 2)[each, :, each])

    def integrated(
        self, grids: Sequence[RangeErrorGrid], log_weight: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Integrate over all sets, of weights (J,), and over the scales of the range errors.

        Returns
        -------
        mean : (n,)
            Of the beams' step from the linearisation, natural units.
        covariance : (n, n)
        sets : (J,)
            Posterior weights of the sets.
        """
        priors = np.concatenate([grid.log_prior for grid in grids])
        evidence = np.concatenate([self.log_evidence_of(grid) for grid in grids], axis=1)
        log_w = evidence + priors + log_weight[:, None]
        w = np.exp(log_w - log_w.max())
        w[w < NEGLIGIBLE] = 0.0
        w /= w.sum()
        sets = w.sum(axis=1)
        used, size = np.flatnonzero(sets), self.mean.shape[1]
        means, covariance = self.mean[used], np.zeros((size, size))
        for j, mean in zip(used.tolist(), means, strict=True):  # the law of total variance, twice
            some = w[j] > 0.0
            V, k = self._narrowed(j, grids, some)
            own = w[j, some] / sets[j]
            off = k - own @ k
            among_scales = np.tensordot(own, V, 1) + (own[:, None] * off).T @ off
            follows = np.empty((size, self.places.size))
            follows[self.others], follows[self.places] = self.G[j], np.eye(self.places.size)
            mean += follows @ (own @ k - self.k[j])
            covariance += sets[j] * follows @ among_scales @ follows.T
            covariance[np.ix_(self.others, self.others)] += sets[j] * self.P[j]
        mean = sets[used] @ means
        off = means - mean
        covariance += (sets[used, None] * off).T @ off
        return mean, 0.5 * (covariance + covariance.T), sets

    def _narrowed(
        self, j: int, grids: Sequence[RangeErrorGrid], which: BoolArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return V' (C, K, K) and k' (C, K) of set j for those points of all grids that count."""
        T = self.T[j]
        seen = [self._beyond_widest(grid)[..., None] * (grid.contrasts() @ T) for grid in grids]
        some = np.concatenate(seen)[which]
        V = T @ np.linalg.inv(np.swapaxes(some, 1, 2) @ some + np.eye(len(T))) @ T.T
        return V, V @ self.y[j]

    def _beyond_widest(self, grid: RangeErrorGrid) -> FloatArray:
        """Return the roots (G, K) of the information of priors beyond the widest prior."""
        return np.asarray(np.sqrt(np.maximum(grid.spread() ** -2 - self.widest**-2, 0.0)))


def _inverses(matrix: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the inverses of information (J, n, n), and the logarithms (J,) of its determinants."""
    # Rounding may have made some negative, where errors of the hand are far above those of readings.
    scale = 1.0 / np.sqrt(np.maximum(np.einsum("jii->ji", matrix), NEGLIGIBLE))
    each = scale[:, :, None] * scale[:, None, :]
    scaled = matrix * each
    try:
        inverse = np.linalg.inv(scaled)
    except np.linalg.LinAlgError:  # or singular
        scaled = scaled + SINGULAR * np.eye(matrix.shape[1])
        inverse = np.linalg.inv(scaled)
    log_det = np.linalg.slogdet(scaled)[1] - 2.0 * np.log(scale).sum(axis=1)
    return inverse * each, log_det
