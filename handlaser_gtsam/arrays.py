"""Array types, and the two helpers that every frozen column goes through."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.intp]
BoolArray = NDArray[np.bool_]


def frozen(values: ArrayLike) -> FloatArray:
    """Return `values` as a read-only float array: a copy, unless they are one already."""
    if isinstance(values, np.ndarray) and values.dtype == np.float64 and not values.flags.writeable:
        return values
    array = np.array(values, dtype=np.float64, order="C")
    array.flags.writeable = False
    return array


def gathered(values: FloatArray, index: IntArray) -> FloatArray:
    """Return rows `index` of values (M, ...), column by column in memory: arithmetic is fast there."""
    found: FloatArray = values.T.take(index, axis=-1).T
    return found


def frozen_indices(values: ArrayLike) -> IntArray:
    """Return a read-only integer copy of `values`."""
    array = np.array(values, dtype=np.intp)
    array.flags.writeable = False
    return array
