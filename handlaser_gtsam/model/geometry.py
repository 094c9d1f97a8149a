"""Unit vectors and their tangent planes."""

import numpy as np

from ..arrays import FloatArray


def tangent_basis(unit: FloatArray) -> FloatArray:
    """Return an orthonormal basis (N, 3, 2) of the tangent planes at unit vectors (N, 3).

    Smooth everywhere but at -z (Duff et al., Building an Orthonormal Basis, Revisited, JCGT 2017).
    """
    x, y, z = unit[:, 0], unit[:, 1], unit[:, 2]
    sign = np.copysign(1.0, z)
    a = -1.0 / (sign + z)
    xy = x * y * a
    first = np.stack((1.0 + sign * x * x * a, sign * xy, -sign * x), axis=1)
    second = np.stack((xy, sign + y * y * a, -y), axis=1)
    return np.stack((first, second), axis=2)


def normalized(vectors: FloatArray) -> FloatArray:
    """Return vectors (..., 3) divided by their lengths."""
    lengths: FloatArray = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return vectors / lengths
