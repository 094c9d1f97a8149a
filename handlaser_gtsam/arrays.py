"""Array types, and the two helpers that every frozen column goes through."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.intp]
BoolArray = NDArray[np.bool_]


def frozen(values: ArrayLike) -> FloatArray:
    """Return a read-only, contiguous float copy of `values`."""
    array = np.array(values, dtype=np.float64, order="C")
    array.flags.writeable = False
    return array


def frozen_indices(values: ArrayLike) -> IntArray:
    """Return a read-only integer copy of `values`."""
    array = np.array(values, dtype=np.intp)
    array.flags.writeable = False
    return array
