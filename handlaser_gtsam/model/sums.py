"""Sums over rows that belong together."""

import numpy as np

from ..arrays import FloatArray, IntArray


class SumsByKey:
    """Sums over groups of equal key, along an axis of an array.

    How to sum is found out once: keys that repeat as a whole, or in runs of one length, become a sum
    over a reshaped axis, all others a sorted `np.add.reduceat`.

    Parameters
    ----------
    key : (G,)
        Whole numbers, in any order.

    Attributes
    ----------
    keys : (U,)
        The different keys, ascending, in the order of the sums.
    """

    def __init__(self, key: IntArray) -> None:
        key = np.asarray(key)
        self._tiles, self._order = 1, None
        again = np.flatnonzero((key[1:] == key[0]) & (key[:-1] != key[0])) + 1
        if again.size and len(key) % again[0] == 0:
            first = key[: again[0]]
            if (key.reshape(-1, len(first)) == first).all():
                self._tiles, key = len(key) // len(first), first
        if (np.diff(key) < 0).any():
            self._order = np.argsort(key, kind="stable")
            key = key[self._order]
        self.keys: IntArray
        self.keys, self._first, lengths = np.unique(key, return_index=True, return_counts=True)
        self._run = int(lengths[0]) if (lengths == lengths[0]).all() else 0

    def __call__(self, array: FloatArray, axis: int = 1) -> FloatArray:
        """Return the sums (..., U, ...) of an array (..., G, ...) along an axis from 0 on."""
        before, after = array.shape[:axis], array.shape[axis + 1 :]
        if self._tiles > 1:
            width = array.shape[axis] // self._tiles
            array = array.reshape(*before, self._tiles, width, *after).sum(axis=axis)
        if self._order is not None:
            array = array.take(self._order, axis=axis)
        if self._run == 1:
            return array
        if self._run:
            runs = array.reshape(*before, len(self.keys), self._run, *after)
            return np.asarray(runs.sum(axis=axis + 1))
        return np.asarray(np.add.reduceat(array, self._first, axis=axis))
