"""Range errors as means over all beams and contrasts between them, which make their prior diagonal."""

import math
from dataclasses import dataclass

import numpy as np

from ..arrays import BoolArray, FloatArray, IntArray
from ..model.families import MOUNT_DIM
from .range_error_grid import RangeErrorGrid, axes

LEAST_ELONGATION = 3.0
"""With a smaller ratio of its standard deviations no combination of k1 and k2 D is the least known."""


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
        total: FloatArray = np.hypot(grid.individual[:, self.terms], shared)
        return total


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
    turned: FloatArray = mean + off
    return turned
