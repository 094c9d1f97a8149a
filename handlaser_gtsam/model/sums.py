"""Sums over rows that belong together."""

import numpy as np

from ..arrays import FloatArray, IntArray


class SumsByKey:
    """Sums over groups of equal key, along the second axis of an array.

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
        self._tiles, self._order, self._run = 1, None, 0
        again = np.flatnonzero((key[1:] == key[0]) & (key[:-1] != key[0])) + 1
        if again.size and len(key) % again[0] == 0:
            first = key[: again[0]]
            if (key.reshape(-1, len(first)) == first).all():
                self._tiles, key = len(key) // len(first), first
        if (np.diff(key) < 0).any():
            self._order = np.argsort(key, kind="stable")
            key = key[self._order]
        self._first = np.flatnonzero(np.diff(key, prepend=key[0] - 1))
        self.keys: IntArray = key[self._first]
        lengths = np.diff(self._first, append=len(key))
        if (lengths == lengths[0]).all():
            self._run = int(lengths[0])

    def __call__(self, array: FloatArray) -> FloatArray:
        """Return the sums (K, U, ...) of an array (K, G, ...)."""
        K, rest = array.shape[0], array.shape[2:]
        if self._tiles > 1:
            array = array.reshape(K, self._tiles, array.shape[1] // self._tiles, *rest).sum(axis=1)
        if self._order is not None:
            array = array[:, self._order]
        if self._run == 1:
            return array
        if self._run:
            return np.asarray(array.reshape(K, len(self.keys), self._run, *rest).sum(axis=2))
        return np.asarray(np.add.reduceat(array, self._first, axis=1))
