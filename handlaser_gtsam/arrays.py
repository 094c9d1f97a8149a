"""Array types, and the helpers that columns go through."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.intp]
BoolArray = NDArray[np.bool_]


def frozen(values: ArrayLike) -> FloatArray:
    """Return `values` as a read-only float array: a copy, unless nobody can write to them.

    A read-only view of a writable array, as pandas hands out, or of a file in memory is copied: its
    owner could change it.
    """
    if isinstance(values, np.ndarray) and values.dtype == np.float64 and _is_immutable(values):
        return values
    array = np.array(values, dtype=np.float64, order="C")
    array.flags.writeable = False
    return array


def _is_immutable(values: np.ndarray) -> bool:
    """Tell whether neither an array nor any array that it is a view of can be written to."""
    owner: object = values
    while isinstance(owner, np.ndarray):
        if owner.flags.writeable:
            return False
        owner = owner.base
    return owner is None or isinstance(owner, bytes)


def gathered(values: FloatArray, index: IntArray) -> FloatArray:
    """Return rows `index` of values (M, ...), column by column in memory: arithmetic is fast there."""
    found: FloatArray = values.T.take(index, axis=-1).T
    return found


def frozen_indices(values: ArrayLike) -> IntArray:
    """Return a read-only integer copy of `values`."""
    array = np.array(values, dtype=np.intp)
    array.flags.writeable = False
    return array


def renumbered(numbers: IntArray) -> IntArray:
    """Return the rank (N,), from zero, of each whole number of at least zero among those that occur."""
    occurs = np.bincount(numbers) > 0
    ranks: IntArray = (np.cumsum(occurs) - 1)[numbers]
    return ranks


def evenly(count: int, most: int) -> IntArray:
    """Return all `count` indices, or `most` of them that are evenly spread."""
    return np.linspace(0, count - 1, min(count, most)).round().astype(np.intp)
