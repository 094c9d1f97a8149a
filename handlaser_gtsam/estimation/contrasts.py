"""Range errors as means over all beams and contrasts between them, which make their prior diagonal."""

import math
from dataclasses import dataclass

import numpy as np

from ..arrays import BoolArray, FloatArray, IntArray
from .range_error_grid import RangeErrorGrid, axes

LEAST_ELONGATION = 3.0
"""Ratio of standard deviations of combinations of k1 and k2 D: below, axes of these mean little."""


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

    @property
    def count(self) -> int:
        """Of the terms."""
        return int(self.terms.max(initial=-1)) + 1

    def turned(self, angle: float) -> FloatArray:
        """Return the matrix (K, K) to the same along other axes of k1 and k2 D."""
        one, beams = axes(angle, self.count), len(self.terms) // self.count
        return np.asarray(np.kron(one, np.eye(beams)), dtype=np.float64)

    def worst_known(self, V: FloatArray) -> float | None:
        """Return the angle from the axis of k1 to that of what is known worst of k1 and k2 D [rad].

        That is an axis of the beams' mean information, from a covariance (K, K) of means and contrasts;
        None where there is one term, or no combination of both is known far better than another.
        """
        if self.count != 2:
            return None
        each = (self.turn.T @ V @ self.turn).reshape(len(V) // 2, 2, -1, 2)
        beams = np.arange(len(each))
        information = np.linalg.inv(each[beams, :, beams])
        values, vectors = np.linalg.eigh(information.mean(axis=0))
        if values[1] < LEAST_ELONGATION**2 * values[0]:
            return None
        along, across = vectors[:, 0].tolist()
        # No angle is another than none: axes that are those of k1 and k2 D have that part of the prior.
        return math.atan2(across, along) % math.pi or None

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
