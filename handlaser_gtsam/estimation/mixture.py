r"""Beams, with the scales of noise and range errors integrated over.

For given scales everything is Gaussian. With the typical range D, the range errors of beam i are

    k1_i = m1 + d1_i,  k2_i D = m2 + d2_i,  d1 ~ N(0, s1^2),  d2 ~ N(0, s2^2),  m1, m2 ~ N(0, S^2):

sensors of one kind err alike, and the robot's scale does so to all of them. All that may also stand
along the axes of each beam that readings know least and best; scales and axes have priors, too
(`range_error_grid`). The means over the beams and the contrasts between them make the prior diagonal
(`Contrasts`). With the widest prior let k have the estimate k^ and the covariance V = T T', and let all
other unknowns follow it,

    x = m + G (k - k^),   with the covariance P where k is known.

A narrower prior adds the precision E. Then

    V' = T inv(1 + T' E T) T',   k' = V' inv(V) k^,   mean m + G (k' - k^),   covariance P + G V' G',
    log evidence - (log|1 + R V R| + k^' Z k^) / 2 + ...,   R = E^(1/2),  Z = R inv(1 + R V R) R.

Sums of squares alone: no digit is lost where the readings do not determine k and the widest prior is
far wider than the narrower one. The posterior is a mixture over all scales: its mean, its covariance
within and between, and quantiles of its components.
"""

from dataclasses import dataclass

import numpy as np
from scipy.optimize.elementwise import find_root
from scipy.sparse import csr_array
from scipy.special import logsumexp, ndtr

from ..arrays import FloatArray, IntArray, evenly
from ..model.elimination import LARGE_MATRIX, inverse_and_log_det
from ..quantities import NEGLIGIBLE, NUMBERS_AT_ONCE, REPRESENTATIVE_BEAMS, TINY
from .information import Information
from .range_error_grid import Contrasts, RangeErrorGrid, worst_known

LOST_WEIGHT = 1e-4
"""The smallest components, of this weight together, are not kept: quantiles hardly move."""


@dataclass(frozen=True, slots=True)
class Mixture:
    """The posterior of the beams' step from the linearisation, natural units.

    Attributes
    ----------
    mean : (n,)
    covariance : (n, n)
    sets : (J,)
        Weights of the sets of noise scales.
    grid : (G,)
        Weights of the scales of the range errors.
    weight : (C,)
        Weights of the components that are kept.
    means, sigmas : (C, m)
        Of the m coordinates that were asked for, in every component that is kept: means, counted from
        that of the whole mixture, and standard deviations.
    members : (C, 2) of int
        Indices of the set of noise scales and of the scales of the range errors of every component.
    """

    mean: FloatArray
    covariance: FloatArray
    sets: FloatArray
    grid: FloatArray
    weight: FloatArray
    means: FloatArray
    sigmas: FloatArray
    members: IntArray


def mixture_quantiles(
    weight: FloatArray, means: FloatArray, sigmas: FloatArray, probability: float
) -> FloatArray:
    """Return quantiles (m,) of mixtures of Gaussians: weights (C,), means and sigmas (C, m).

    That is where the distribution function has the probability; SciPy narrows a bracket of it to the
    last digits (Chandrupatla's method).
    """
    reach = 12.0 * sigmas.max(axis=0) + TINY
    bracket = means.min(axis=0) - reach, means.max(axis=0) + reach
    safe = np.maximum(sigmas, TINY)

    def excess(x: FloatArray, i: IntArray) -> FloatArray:
        return weight @ ndtr((x - means[:, i]) / safe[:, i]) - probability

    each = np.arange(means.shape[1])
    return np.asarray(find_root(excess, bracket, args=(each,)).x)


class BeamPosterior:
    """The beams for J sets of noise scales under the widest prior of their range errors.

    Parameters
    ----------
    information : Information
    k : (B, T)
        Range errors at the linearisation, natural units.
    widest : float
        The widest scale of a range error's prior; where the range errors are free, infinite.
    """

    def __init__(self, information: Information, k: FloatArray, widest: float) -> None:
        terms, size, beams = k.shape[1], information.matrix.shape[1], np.arange(len(k))
        self.every = Contrasts.of(beams, terms, size // max(len(k), 1), widest)
        self.has_prior = bool(self.every.places.size) and np.isfinite(widest)
        places, turn, wide = self.every.places, self.every.turn, self.every.widest
        precision, mean = turn.T @ (wide[:, None] ** -2 * turn), turn @ k.ravel()
        self.others = np.setdiff1d(np.arange(size), places)
        matrix, vector = information.matrix, information.vector.copy()
        vector[:, places] -= precision @ k.ravel()
        of_others = matrix[:, self.others[:, None], self.others]
        of_others += NEGLIGIBLE * np.eye(len(self.others))  # a part of a recording may lack a beam
        self.P, log_det = _inverses(of_others)
        across = matrix[:, self.others[:, None], places] @ turn.T
        self.G = np.zeros((len(matrix), size, len(places)))
        self.G[:, self.others], self.G[:, places] = -(self.P @ across), turn.T
        of_k = matrix[:, places[:, None], places] + precision + NEGLIGIBLE * np.eye(len(places))
        of_k = turn @ of_k @ turn.T + np.swapaxes(across, 1, 2) @ self.G[:, self.others]
        self.T, root = _inverse_roots(of_k, wide)
        self.V = self.T @ np.swapaxes(self.T, 1, 2)
        log_det -= 2.0 * root
        alone = np.einsum("jab,jb->ja", self.P, vector[:, self.others])
        towards = np.einsum("jak,ja->jk", self.G, vector)
        step = np.einsum("jkl,jl->jk", self.V, towards)
        self.mean = np.einsum("jak,jk->ja", self.G, step)
        self.mean[:, self.others] += alone
        self.log_evidence = information.constant + 0.5 * np.einsum("ja,ja->j", vector, self.mean)
        self.log_evidence -= 0.5 * log_det
        if self.has_prior:
            self.log_evidence -= 0.5 * float((mean**2 / wide**2).sum())
            self.log_evidence -= float(np.log(wide).sum())
        self.k = step + mean
        # inv(V) k^, without a difference that could cancel.
        self.y = towards + np.einsum("jkl,l->jk", of_k, mean)
        self.few = evenly(len(beams), REPRESENTATIVE_BEAMS)
        self.telling = self._of_few(k, size // max(len(k), 1), widest)

    def _of_few(
        self, k: FloatArray, width: int, widest: float
    ) -> tuple[Contrasts, FloatArray, FloatArray]:
        """Return contrasts of at most `REPRESENTATIVE_BEAMS` beams, their covariances and estimates.

        Covariances are positive semidefinite to the last bit, whatever is nearly undetermined.
        """
        if len(k) <= REPRESENTATIVE_BEAMS:
            return self.every, _semidefinite(self.V), self.k
        few = Contrasts.of(self.few, k.shape[1], width, widest)
        rows = few.turn @ self.G[:, few.places]
        V = rows @ self.V @ np.swapaxes(rows, 1, 2)
        estimates = self.mean[:, few.places] + k[self.few].ravel()
        return few, _semidefinite(V), estimates @ few.turn.T

    def narrowed(
        self, grid: RangeErrorGrid, sets: IntArray, scales: IntArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return V' (C, K, K) and k' (C, K) for pairs (C,) of a set and a point of the grid."""
        if not self.has_prior:
            return self.V[sets], self.k[sets]
        V = np.empty((len(sets), *self.V.shape[1:]))
        for turned, points in grid.bases():
            turn = self.every.turned(grid.angles) if turned else np.eye(V.shape[1])
            here = np.isin(scales, points)
            for j in np.unique(sets[here]).tolist():
                T, rows = self.T[j], np.flatnonzero(here & (sets == j))
                R = _roots(self.every.spread(grid.part(scales[rows])), self.every.widest)
                seen = R[:, :, None] * (turn @ T)
                inner = np.swapaxes(seen, 1, 2) @ seen
                inner[:, range(R.shape[1]), range(R.shape[1])] += 1.0
                half = np.swapaxes(_times(np.linalg.inv(inner), T.T), 1, 2)
                V[rows] = _times(half, T.T)
        return V, np.einsum("cab,cb->ca", V, self.y[sets])

    def log_evidence_of(self, grid: RangeErrorGrid) -> FloatArray:
        """Return the log evidence (J, G) of the noise scales and the scales of the range errors."""
        evidence = np.repeat(self.log_evidence[:, None], len(grid.log_prior), axis=1)
        if self.has_prior:
            contrasts, V, k = self.telling
            for turned, points in grid.bases():
                spread = contrasts.spread(grid.part(points))
                if turned:  # these points are the last
                    turn = contrasts.turned(grid.angles[self.few])
                    V, k = turn @ V @ turn.T, k @ turn.T
                evidence[:, points] += _log_evidence(V, k, spread, contrasts.widest)
        return evidence

    def worst_known(self) -> FloatArray | None:
        """Return the angles (b,) of the least known combinations of k1 and k2 D in the first set."""
        if not self.has_prior:
            return None
        places = self.every.places.reshape(-1, max(self.every.terms, default=0) + 1)
        rows = self.G[0][places]
        return worst_known(rows @ self.V[0] @ np.swapaxes(rows, 1, 2))

    def log_marginal(self, grid: RangeErrorGrid) -> FloatArray:
        """Return the logarithm of the likelihood (J,) of the noise scales."""
        return np.asarray(logsumexp(self.log_evidence_of(grid) + grid.log_prior, axis=1))

    def conditional(self, scale: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return mean (n,) and covariance (n, n) of the first set, every beam's k ~ N(0, scale^2)."""
        first = np.zeros(1, dtype=np.intp)
        V, k = self.narrowed(RangeErrorGrid.at(scale), first, first)
        covariance = self.G[0] @ V[0] @ self.G[0].T
        covariance[np.ix_(self.others, self.others)] += self.P[0]
        return self.mean[0] + self.G[0] @ (k[0] - self.k[0]), covariance

    def mixture(
        self,
        grid: RangeErrorGrid,
        log_weight: FloatArray,
        coordinates: FloatArray | None = None,
    ) -> Mixture:
        """Return the posterior for weights of the sets (J,), and of `coordinates` (m, n) if given."""
        if coordinates is None:
            coordinates = np.empty((0, self.mean.shape[1]))
        log_w = self.log_evidence_of(grid) + grid.log_prior + log_weight[:, None]
        w = np.exp(log_w - logsumexp(log_w))
        w[w < NEGLIGIBLE * w.max()] = 0.0
        w /= w.sum()
        members = np.argwhere(w)
        weight = w[w > 0.0]
        order = np.argsort(-weight, kind="stable")
        enough = int(np.searchsorted(np.cumsum(weight[order]), 1.0 - LOST_WEIGHT)) + 1
        kept = np.sort(order[:enough])
        means, sigmas, within = self._components(grid, weight, members, coordinates, kept)
        mean = weight @ means
        off = means - mean
        covariance = within + (weight[:, None] * off).T @ off
        return Mixture(
            mean,
            0.5 * (covariance + covariance.T),
            w.sum(axis=1),
            w.sum(axis=0),
            weight[kept] / weight[kept].sum(),
            off[kept] @ coordinates.T,
            sigmas,
            members[kept],
        )

    def _components(
        self,
        grid: RangeErrorGrid,
        weight: FloatArray,
        members: IntArray,
        coordinates: FloatArray,
        kept: IntArray,
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return means of components (C,), sigmas of coordinates in some, and their mean covariance.

        For members (C, 2), a set and a point of the grid each, in ascending order, as are those that
        are `kept`.
        """
        sets = members[:, 0]
        V, k = self.narrowed(grid, sets, members[:, 1])
        G, P = self.G, self.P
        seen, first = np.unique(sets, return_index=True)
        Vbar = np.add.reduceat(weight[:, None, None] * V, first)
        within = np.tensordot(G[seen] @ Vbar, G[seen], axes=((0, 2), (0, 2)))
        known = np.einsum("j,jab->ab", np.add.reduceat(weight, first), P[seen])
        within[np.ix_(self.others, self.others)] += known
        few = csr_array(coordinates)  # each of them is one of some unknowns of one beam
        of_others = few[:, self.others]
        means, variances = self.mean[sets], np.empty((len(kept), len(coordinates)))
        for j, a, e in zip(seen, first, np.append(first[1:], len(sets)), strict=True):
            means[a:e] += (k[a:e] - self.k[j]) @ G[j].T
            along, some = few @ G[j], slice(*np.searchsorted(kept, [a, e]))
            variances[some] = of_others.multiply(of_others @ P[j]).sum(axis=1)
            moved = _times(V[kept[some]], along.T)
            variances[some] += np.einsum("ckm,km->cm", moved, along.T)
        return means, np.sqrt(variances), within


def _log_evidence(
    V: FloatArray, k: FloatArray, spread: FloatArray, widest: FloatArray
) -> FloatArray:
    """Return what priors (G, K) add to the log evidence (J,) of estimates (J, K) under the widest."""
    evidence = np.empty((len(k), len(spread)))
    R, size = _roots(spread, widest), spread.shape[1]
    RR, rows = R[:, :, None] * R[:, None, :], np.arange(size)
    share = max(NUMBERS_AT_ONCE // max(RR.size, 1), 1)
    for a in range(0, len(k), share):
        some = slice(a, a + share)
        right = R * k[some, None]
        # The last row of the factor of 1 + R V R bordered by R k solves for R k.
        inner = np.empty((*right.shape[:2], size + 1, size + 1))
        np.multiply(V[some, None], RR, out=inner[..., :size, :size])
        inner[..., rows, rows] += 1.0
        inner[..., size, :size] = right
        inner[..., size, size] = 1.0 + (right**2).sum(axis=2)
        root = np.linalg.cholesky(inner)
        squares = (root[..., size, :size] ** 2).sum(axis=2)
        evidence[some] = -0.5 * squares - np.log(root[..., rows, rows]).sum(axis=2)
    evidence -= np.log(spread / widest).sum(axis=1)
    return evidence


def _roots(spread: FloatArray, widest: FloatArray) -> FloatArray:
    """Return the roots (C, K) of the information of priors (C, K) beyond the widest prior."""
    return np.asarray(np.sqrt(np.maximum(spread**-2 - widest**-2, 0.0)))


def _times(stack: FloatArray, matrix: FloatArray) -> FloatArray:
    """Return matrices (C, K, L) times one (L, M) in a single product, which is faster."""
    C, K, L = stack.shape
    return np.asarray((stack.reshape(C * K, L) @ matrix).reshape(C, K, matrix.shape[1]))


def _semidefinite(V: FloatArray) -> FloatArray:
    """Return covariances (J, K, K) without what rounding made negative."""
    values, axes = np.linalg.eigh(0.5 * (V + np.swapaxes(V, 1, 2)))
    return np.asarray((axes * np.maximum(values, 0.0)[:, None]) @ np.swapaxes(axes, 1, 2))


def _inverse_roots(matrix: FloatArray, widest: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return T with T T' the inverses of information (J, K, K), and the logarithms (J,) of det T.

    Information that rounding made negative is raised to what the widest prior (K,) gives.
    """
    try:
        T = np.swapaxes(np.linalg.inv(np.linalg.cholesky(matrix)), 1, 2)
        return T, np.log(np.einsum("jkk->jk", T)).sum(axis=1)
    except np.linalg.LinAlgError:
        values, axes = np.linalg.eigh(matrix)
        values = np.maximum(values, max(float(widest.max()) ** -2, NEGLIGIBLE))
        return axes / np.sqrt(values)[:, None], -0.5 * np.log(values).sum(axis=1)


def _inverses(matrix: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the inverses of information (J, n, n), and the logarithms (J,) of its determinants.

    `matrix` is overwritten: with many beams a copy costs as much as it does.
    """
    diagonal = np.einsum("jii->ji", matrix)
    scale = 1.0 / np.sqrt(np.maximum(diagonal, NEGLIGIBLE))
    matrix *= scale[:, :, None]
    matrix *= scale[:, None, :]
    if matrix.shape[1] > LARGE_MATRIX:
        size = np.empty(len(matrix))
        for copy in range(len(matrix)):
            matrix[copy], size[copy] = inverse_and_log_det(matrix[copy])
    else:
        size = np.linalg.slogdet(matrix)[1]
        matrix[:] = np.linalg.inv(matrix)
    matrix *= scale[:, :, None]
    matrix *= scale[:, None, :]
    return matrix, size - 2.0 * np.log(scale).sum(axis=1)
