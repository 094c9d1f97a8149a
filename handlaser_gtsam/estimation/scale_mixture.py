r"""Beams, with the scales of noise and range errors integrated over.

For given scales everything is Gaussian. With the typical range D, the range errors of beam i are

    k1_i = m1 + d1_i,  k2_i D = m2 + d2_i,  d1 ~ N(0, s1^2),  d2 ~ N(0, s2^2),  m1, m2 ~ N(0, S^2):

sensors of one kind err alike, and the robot's scale does so to all of them. All that may also stand
along the axes of each beam that readings know least and best; scales and axes have priors, too
(`range_error_grid`). With a prior wider than any of these let k have the estimate k^ and the covariance
V = T T', and let all other unknowns follow it,

    x = m + G (k - k^),   with the covariance P where k is known.

A narrower prior, R^2 more information in a basis in which it is diagonal (`RangeErrorGrid.contrasts`),
makes that

    V' = T inv(1 + T' R^2 T) T',   k' = V' inv(V) k^,   mean m + G (k' - k^),   covariance P + G V' G',
    log evidence = -(log|1 + R V R| + k^' R inv(1 + R V R) R k^) / 2 + what all narrower priors share.

Sums of squares alone: no digit is lost where the readings do not determine k and the widest prior is
far wider than the narrower one. The posterior is the mixture over all scales, of which mean and
covariance count.
"""

from collections.abc import Sequence

import numpy as np
from scipy.special import logsumexp

from ..arrays import BoolArray, FloatArray
from ..model.families import MOUNT_DIM
from ..quantities import NEGLIGIBLE
from .information import Information
from .range_error_grid import RangeErrorGrid, worst_known


class BeamPosterior:
    """The beams for J sets of noise scales under the widest prior of their range errors.

    Parameters
    ----------
    information : Information
    k : (B, T)
        Range errors at the linearisation that have a prior, natural units; T is zero where none has.
    widest : float
        The widest scale of a range error's prior.
    """

    def __init__(self, information: Information, k: FloatArray, widest: float) -> None:
        self.shape = beams, terms = k.shape
        size = information.vector.shape[1]
        places = np.arange(beams)[:, None] * (size // beams) + MOUNT_DIM + np.arange(terms)
        self.places = places.ravel()
        self.others = np.setdiff1d(np.arange(size), self.places)
        # The mean over B beams, times the root of B, has the scale that all share beside its own.
        self.widest = widest * np.sqrt(1.0 + beams)
        prior, here, of_others = self.widest**-2, k.ravel(), information.vector[:, self.others]
        # A part of a recording may lack a beam.
        matrix = information.matrix + NEGLIGIBLE * np.eye(size)
        across = matrix[:, self.others[:, None], self.places]
        self.P, log_det = _inverses(matrix[:, self.others[:, None], self.others])
        self.G = -(self.P @ across)
        known = matrix[:, self.places[:, None], self.places] + np.swapaxes(across, 1, 2) @ self.G
        values, axes = np.linalg.eigh(known)
        values = np.maximum(values, 0.0) + prior  # rounding may have made some negative
        self.T = axes / np.sqrt(values)[:, None]
        self.V = self.T @ np.swapaxes(self.T, 1, 2)
        towards = information.vector[:, self.places] - prior * here
        towards += np.einsum("jak,ja->jk", self.G, of_others)
        step = np.einsum("jkl,jl->jk", self.V, towards)
        alone = np.einsum("jab,jb->ja", self.P, of_others)
        self.k = here + step
        # inv(V) k^, without a difference that could cancel.
        self.y = towards + known @ here + prior * here
        self.mean = np.empty_like(information.vector)
        self.mean[:, self.places] = step
        self.mean[:, self.others] = alone + np.einsum("jak,jk->ja", self.G, step)
        squares = (of_others * alone).sum(axis=1) + (towards * step).sum(axis=1)
        squares -= log_det + np.log(values).sum(axis=1) + prior * float(here @ here)
        self.log_evidence = information.constant + 0.5 * squares

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

    def log_marginal(self, grid: RangeErrorGrid) -> FloatArray:
        """Return the logarithm of the likelihood (J,) of the noise scales."""
        return np.asarray(logsumexp(self.log_evidence_of(grid) + grid.log_prior, axis=1))

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
    log_det = np.linalg.slogdet(matrix * each)[1] - 2.0 * np.log(scale).sum(axis=1)
    return np.linalg.inv(matrix * each) * each, log_det
