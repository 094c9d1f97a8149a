"""Unit vectors and rotations; laser spots and the planes through them; the scatter of poses."""

import numpy as np

from ..arrays import FloatArray, IntArray

ROTATION_CELL = 2e-3
"""Rotations whose matrices agree to about this many radians count as equal."""
COORDINATE_AXES = np.eye(3)
"""The coordinate axes."""
CROSSED = np.array([np.cross(axis, COORDINATE_AXES).ravel() for axis in COORDINATE_AXES])
"""A vector times this (3, 9) has its cross products with the three axes."""


def tangent_basis(unit: FloatArray) -> FloatArray:
    """Return an orthonormal basis (N, 3, 2) of the tangent planes at unit vectors (N, 3).

    It is the basis of `gtsam.Unit3`: its first vector is at right angles to the axis that is farthest
    from the unit vector. A test compares the two.
    """
    axis = np.abs(unit).argmin(axis=1)
    index = np.arange(0, unit.size, 3) + axis
    along = unit.take(index)[:, None]
    scale = 1.0 / np.sqrt(1.0 - along * along)
    basis = np.empty((len(unit), 3, 2))
    # The cross product of the vector and the axis, then that of the vector and its first tangent.
    crossed = (unit @ CROSSED).reshape(-1, 3).take(index, axis=0)
    np.multiply(crossed, scale, out=basis[..., 0])
    np.multiply(unit * along - COORDINATE_AXES.take(axis, axis=0), scale, out=basis[..., 1])
    return basis


def cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return the cross products of vectors (3, ...), in half of the time of `numpy.cross`."""
    crossed = np.empty((3, *np.broadcast_shapes(a.shape[1:], b.shape[1:])))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        np.subtract(a[j] * b[k], a[k] * b[j], out=crossed[i])
    return crossed


def rotation_cells(R: FloatArray) -> IntArray:
    """Return whole numbers (N, 9) for rotations (N, 3, 3), the same where they count as equal."""
    return np.floor(R.reshape(-1, 9) / ROTATION_CELL + 0.377).astype(np.int64)


def skew(vectors: FloatArray) -> FloatArray:
    """Return the matrices (..., 3, 3) that multiply by vectors (..., 3) crosswise."""
    matrices = np.zeros((*vectors.shape, 3))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        matrices[..., i, j], matrices[..., j, i] = -vectors[..., k], vectors[..., k]
    return matrices


def normalized(vectors: FloatArray) -> FloatArray:
    """Return vectors (..., 3) divided by their lengths."""
    lengths: FloatArray = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return vectors / lengths


def spots(
    R: FloatArray, t: FloatArray, r: FloatArray, v: FloatArray, ranges: FloatArray
) -> FloatArray:
    """Return where beams end, R (r + s v) + t (N, 3), for true ranges s (N,); world frame."""
    moved: FloatArray = np.einsum("nij,nj->ni", R, r + ranges[:, None] * v)
    return moved + t


def means_and_scatter(
    points: FloatArray, first: IntArray, weights: FloatArray | None = None
) -> tuple[FloatArray, FloatArray]:
    """Return means (..., G, 3) and scatter matrices (..., G, 3, 3) of groups of points.

    Parameters
    ----------
    points : (..., N, 3)
    first : (G,)
        The first point of each group; groups follow one another.
    weights : (..., N), optional
        Weights of the points; the scatter of each group is as for weights whose sum is one.
    """
    count = np.diff(np.append(first, points.shape[-2]))
    x = np.ascontiguousarray(np.moveaxis(points, -1, 0))  # sums along the last axis are fast
    if weights is None:
        share = np.repeat(1.0 / count, count)
    else:
        share = weights / np.repeat(np.add.reduceat(weights, first, axis=-1), count, axis=-1)
    means = np.add.reduceat(x * share, first, axis=-1)
    x -= np.repeat(means, count, axis=-1)
    scaled = x if weights is None else x * share
    scatter = np.empty((*means.shape[1:], 3, 3))
    for i in range(3):
        for j in range(i + 1):
            scatter[..., i, j] = np.add.reduceat(x[i] * scaled[j], first, axis=-1)
            scatter[..., j, i] = scatter[..., i, j]
    return np.moveaxis(means, 0, -1), scatter


def plane_through(points: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the plane through points (N, 3) by total least squares.

    Returns
    -------
    axes : (3, 3)
        Principal axes, one a row; the last is the normal.
    middle : (3,)
        Of the points, which is on the plane.
    size : (3,)
        Roots of the summed squares along the principal axes, the largest first; points whose second
        one vanishes are on a line, and the normal means nothing.
    """
    middle = points.mean(axis=0)
    _, size, axes = np.linalg.svd(points - middle, full_matrices=len(points) < 3)
    return axes, middle, size


def nearest_rotation(M: FloatArray) -> FloatArray:
    """Return the rotations nearest to matrices (..., 3, 3)."""
    U, _, Vt = np.linalg.svd(M)
    side = np.ones(M.shape[:-1])
    side[..., 2] = np.sign(np.linalg.det(U @ Vt))
    return np.asarray((U * side[..., None, :]) @ Vt)
