r"""Beams, with the scales of noise and range errors integrated over.

For given scales everything is Gaussian. With the typical range D, the range errors of beam i are

    k1_i = m1 + d1_i,  k2_i D = m2 + d2_i,  d1 ~ N(0, s1^2),  d2 ~ N(0, s2^2),  m1, m2 ~ N(0, S^2):

sensors of one kind err alike, and the robot's scale does so to all of them. All that may also stand
along each beam's axes of what readings know worst and best; scales and axes have priors, too
(`range_error_grid`). The means
over the beams and the contrasts between them make the prior diagonal (`contrasts`). From the solution
with a wide prior, k^ with covariance V, a narrower prior is a linear update: with the precision E that
it adds, R = E^(1/2) and Z = R inv(1 + R V R) R,

    mean - U Z k^,   covariance - U Z U',   log evidence - (log|1 + R V R| + k^' Z k^) / 2 + ...,

U the columns of the covariance that belong to k. Nothing is inverted that could be singular, whether
or not the readings determine k. The posterior is a mixture over all scales: its mean, its covariance
within and between, and quantiles of its components.
"""

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array
from scipy.special import logsumexp, ndtr

from ..arrays import FloatArray, IntArray
from ..solvers.elimination import inverse_and_log_det
from .contrasts import Contrasts, worst_known
from .information import Information
from .range_error_grid import RangeErrorGrid

LOST = 1e-4
"""The smallest components, which have this weight together, are not kept for quantiles."""
LEAST_INFORMATION = 1e-6
"""Of every unknown in natural units: a part of a recording may lack a beam."""
NEGLIGIBLE = 1e-6
"""Components of smaller weight beside the largest count for nothing."""
MOST_BEAMS = 30
"""So many beams, evenly chosen, tell the scales of range errors."""
LARGE = 400
"""Beyond so many unknowns an inverse by Cholesky's factor saves time."""
LARGEST_CHUNK = 4_000_000
"""Numbers of the largest intermediate array."""
BISECTIONS = 45
"""Halvings of an interval: what is left of it, 3e-14, is rounding."""


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
        Of the components that are kept, with their
    means, sigmas : (C, m)
        of m coordinates that were asked for, and their
    members : (C, 2) of int
        set of noise scales, and scales of the range errors.
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
    """Return quantiles (m,) of mixtures of Gaussians: weights (C,), means and sigmas (C, m)."""
    reach = 12.0 * sigmas.max(axis=0) + 1e-300
    low, high = means.min(axis=0) - reach, means.max(axis=0) + reach
    safe = np.maximum(sigmas, 1e-300)
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        below = weight @ ndtr((middle - means) / safe) < probability
        low, high = np.where(below, middle, low), np.where(below, high, middle)
    found: FloatArray = 0.5 * (low + high)
    return found


class BeamPosterior:
    """The beams for J sets of noise scales under the widest prior of their range errors.

    Parameters
    ----------
    information : Information
    k : (B, T)
        Range errors at the linearisation, natural units.
    widest : float
        The widest scale of a range error's prior; where the range errors are free, infinite.
    members : (b,), optional
        Beams whose range errors have the prior; all where not given.
    """

    def __init__(
        self,
        information: Information,
        k: FloatArray,
        widest: float,
        members: IntArray | None = None,
    ) -> None:
        terms, size = k.shape[1], information.matrix.shape[1]
        beams = np.arange(len(k)) if members is None else members
        self.every = Contrasts.of(beams, terms, size // max(len(k), 1), widest)
        self.has_prior = bool(self.every.at.size) and np.isfinite(widest)
        at, turn, wide = self.every.at, self.every.turn, self.every.widest
        own, mean = turn.T @ (wide[:, None] ** -2 * turn), turn @ k[beams].ravel()
        matrix, vector = information.matrix.copy(), information.vector.copy()
        matrix += LEAST_INFORMATION * np.eye(size)
        matrix[:, at[:, None], at] += own
        vector[:, at] -= own @ k[beams].ravel()
        self.covariance, log_det = _inverses(matrix)
        self.mean = np.einsum("jab,jb->ja", self.covariance, vector)
        self.log_evidence = information.constant + 0.5 * np.einsum("ja,ja->j", vector, self.mean)
        self.log_evidence -= 0.5 * log_det
        if self.has_prior:
            self.log_evidence -= 0.5 * float((mean**2 / wide**2).sum())
            self.log_evidence -= float(np.log(wide).sum())
        self.U = self.covariance[:, :, at] @ turn.T
        self.V = turn @ self.U[:, at]
        self.k = self.mean[:, at] @ turn.T + mean
        few = np.linspace(0, len(beams) - 1, min(len(beams), MOST_BEAMS))
        self.few: IntArray = few.round().astype(np.intp)
        self.telling = self._of_few(k, beams, size // max(len(k), 1), widest)

    def _of_few(
        self, k: FloatArray, beams: IntArray, width: int, widest: float
    ) -> tuple[Contrasts, FloatArray, FloatArray]:
        """Return contrasts of at most `MOST_BEAMS` beams, with covariances and estimates of them.

        Covariances are positive semidefinite to the last bit, whatever is nearly undetermined.
        """
        if len(beams) <= MOST_BEAMS:
            return self.every, _semidefinite(self.V), self.k
        few = Contrasts.of(beams[self.few], k.shape[1], width, widest)
        V = few.turn @ self.covariance[:, few.at[:, None], few.at] @ few.turn.T
        own = self.mean[:, few.at] + k[beams[self.few]].ravel()
        return few, _semidefinite(V), own @ few.turn.T

    def narrowed(
        self, grid: RangeErrorGrid, sets: IntArray, scales: IntArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return Z (C, K, K) and Z k^ (C, K) for pairs (C,) of a set and a point of the grid."""
        Z = np.zeros((len(sets), *self.V.shape[1:]))
        if self.has_prior:
            for turned, points in grid.bases():
                rows = np.flatnonzero(np.isin(scales, points))
                R = _roots(self.every.spread(grid.part(scales[rows])), self.every.widest)
                turn = self.every.turned(grid.angles) if turned else None
                V = self.V if turn is None else turn @ self.V @ turn.T
                inner = R[:, :, None] * V[sets[rows]] * R[:, None, :]
                inner[:, range(R.shape[1]), range(R.shape[1])] += 1.0
                own = R[:, :, None] * np.linalg.inv(inner) * R[:, None, :]
                Z[rows] = own if turn is None else turn.T @ own @ turn
        return Z, np.einsum("cab,cb->ca", Z, self.k[sets])

    def log_evidence_of(self, grid: RangeErrorGrid) -> FloatArray:
        """Return the log evidence (J, G) of the noise scales and those of the range errors."""
        found = np.repeat(self.log_evidence[:, None], len(grid.log_prior), axis=1)
        if self.has_prior:
            of, V, k = self.telling
            for turned, points in grid.bases():
                own = of.spread(grid.part(points))
                if turned:  # these points are the last
                    turn = of.turned(grid.angles[self.few])
                    V, k = turn @ V @ turn.T, k @ turn.T
                found[:, points] += _log_evidence(V, k, own, of.widest)
        return found

    def worst_known(self) -> FloatArray | None:
        """Return the angles (b,) of what the first set knows worst of k1 and k2 D, if it does."""
        at = self.every.at.reshape(-1, max(self.every.terms, default=0) + 1)
        V = self.covariance[0][at[:, :, None], at[:, None, :]]
        return worst_known(V) if self.has_prior else None

    def log_marginal(self, grid: RangeErrorGrid) -> FloatArray:
        """Return the logarithm of the likelihood (J,) of the noise scales."""
        marginal: FloatArray = logsumexp(self.log_evidence_of(grid) + grid.log_prior, axis=1)
        return marginal

    def conditional(self, scale: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return mean (n,) and covariance (n, n) of the first set, every beam's k ~ N(0, scale^2)."""
        first = np.zeros(1, dtype=np.intp)
        Z, Zk = self.narrowed(RangeErrorGrid.at(scale), first, first)
        U = self.U[0]
        return self.mean[0] - U @ Zk[0], self.covariance[0] - U @ Z[0] @ U.T

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
        means, within, covariance = self._components(grid, weight, members, coordinates)
        mean = weight @ means
        off = means - mean
        covariance = covariance + (weight[:, None] * off).T @ off
        order = np.argsort(-weight, kind="stable")
        enough = int(np.searchsorted(np.cumsum(weight[order]), 1.0 - LOST)) + 1
        kept = np.sort(order[:enough])
        return Mixture(
            mean,
            0.5 * (covariance + covariance.T),
            w.sum(axis=1),
            w.sum(axis=0),
            weight[kept] / weight[kept].sum(),
            off[kept] @ coordinates.T,
            within[kept],
            members[kept],
        )

    def _components(
        self, grid: RangeErrorGrid, weight: FloatArray, members: IntArray, coordinates: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return means and sigmas of components (C,), and their mean covariance.

        For members (C, 2), a set and a point of the grid each, in ascending order.
        """
        sets = members[:, 0]
        Z, Zk = self.narrowed(grid, sets, members[:, 1])
        U, S = self.U, self.covariance
        seen, first = np.unique(sets, return_index=True)
        Zbar = np.add.reduceat(weight[:, None, None] * Z, first)
        within = np.einsum("j,jab->ab", np.add.reduceat(weight, first), S[seen])
        within -= np.einsum("jak,jkl,jbl->ab", U[seen], Zbar, U[seen], optimize=True)
        few = csr_array(coordinates)  # each of them is one of some unknowns of one beam
        means, variances = self.mean[sets], np.empty((len(sets), len(coordinates)))
        for j, a, e in zip(seen, first, np.append(first[1:], len(sets)), strict=True):
            along = few @ U[j]
            means[a:e] -= Zk[a:e] @ U[j].T
            variances[a:e] = few.multiply(few @ S[j]).sum(axis=1)
            variances[a:e] -= np.einsum("cmk,mk->cm", along @ Z[a:e], along)
        return means, np.sqrt(np.maximum(variances, 0.0)), within


def _log_evidence(V: FloatArray, k: FloatArray, own: FloatArray, widest: FloatArray) -> FloatArray:
    """Return what priors (G, K) add to the log evidence (J,) of estimates (J, K) under the widest."""
    found = np.empty((len(k), len(own)))
    R, size = _roots(own, widest), own.shape[1]
    RR, rows = R[:, :, None] * R[:, None, :], np.arange(size)
    share = max(LARGEST_CHUNK // max(RR.size, 1), 1)
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
        found[some] = -0.5 * squares - np.log(root[..., rows, rows]).sum(axis=2)
    found -= np.log(own / widest).sum(axis=1)
    return found


def _roots(own: FloatArray, widest: FloatArray) -> FloatArray:
    """Return the roots (C, K) of the information of priors (C, K) beyond that of the widest."""
    found: FloatArray = np.sqrt(np.maximum(own**-2 - widest**-2, 0.0))
    return found


def _semidefinite(V: FloatArray) -> FloatArray:
    """Return covariances (J, K, K) without what rounding made negative."""
    values, axes = np.linalg.eigh(0.5 * (V + np.swapaxes(V, 1, 2)))
    found: FloatArray = (axes * np.maximum(values, 0.0)[:, None]) @ np.swapaxes(axes, 1, 2)
    return found


def _inverses(matrix: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the inverses of information (J, n, n), and the logarithms (J,) of its determinants.

    `matrix` is overwritten: with many beams a copy costs as much as it does.
    """
    diagonal = np.einsum("jii->ji", matrix)
    scale = 1.0 / np.sqrt(np.maximum(diagonal, LEAST_INFORMATION))
    matrix *= scale[:, :, None]
    matrix *= scale[:, None, :]
    if matrix.shape[1] > LARGE:
        size = np.empty(len(matrix))
        for one in range(len(matrix)):
            matrix[one], size[one] = inverse_and_log_det(matrix[one])
    else:
        size = np.linalg.slogdet(matrix)[1]
        matrix[:] = np.linalg.inv(matrix)
    matrix *= scale[:, :, None]
    matrix *= scale[:, None, :]
    return matrix, size - 2.0 * np.log(scale).sum(axis=1)
