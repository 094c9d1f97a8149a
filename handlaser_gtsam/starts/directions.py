r"""A start from few stations of many planes or beams: sweep the common direction of the beams.

Blocks of one beam and one plane may be too small to solve alone. Here all beams share one location
and direction for a moment. For a direction v the laser spots of a reading lie at

    X = R (r + d v) + t

so that, from r = 0 on, planes follow from their spots by total least squares, and r follows from the
planes by linear least squares, in turns. The directions whose spots are flattest become starts; every
beam gets its own location and direction when they are refined. Where beams sit far from the hand's
origin and blocks are tiny, r = 0 is too far away: then r is drawn at random too.
"""

import numpy as np

from .. import model
from ..arrays import FloatArray
from ..data.recording import Readings
from .partial import PartialStart

TURNS = 3
LEAST_COSINE = 0.1


def direction_starts(readings: Readings, count: int, tried: int = 200) -> list[PartialStart]:
    """Return the `count` best starts of `tried` directions over the sphere."""
    v = sphere(tried)
    r = np.zeros_like(v)
    reach = reach_of(v, readings)
    for _ in range(TURNS):
        n, b = planes_through(reach + turned(r, readings), readings)
        r = common_location(reach, n, b, readings)
    spots = reach + turned(r, readings)
    n, b = planes_through(spots, readings)
    best = np.argsort(_misfit(spots, v, n, b, readings), kind="stable")[:count]
    return as_starts(r[best], v[best], n[best], b[best], readings)


def random_starts(readings: Readings, count: int, rng: np.random.Generator) -> list[PartialStart]:
    """Return starts of random directions and locations, up to twenty ranges from the hand's origin."""
    v = model.normalized(rng.standard_normal((count, 3)))
    r = model.normalized(rng.standard_normal((count, 3)))
    r *= readings.typical_range() * 10.0 ** rng.uniform(-0.5, 1.3, (count, 1))
    n, b = planes_through(reach_of(v, readings) + turned(r, readings), readings)
    return as_starts(r, v, n, b, readings)


def as_starts(
    r: FloatArray, v: FloatArray, n: FloatArray, b: FloatArray, readings: Readings
) -> list[PartialStart]:
    """Return starts of C locations and directions, which all beams share, and of C times P planes."""
    starts = []
    for c in range(len(v)):
        start = PartialStart.empty(readings)
        start.locations[:], start.directions[:] = r[c], v[c]
        start.normals[:], start.offsets[:] = n[c], b[c]
        starts.append(start)
    return starts


def reach_of(v: FloatArray, readings: Readings) -> FloatArray:
    """Return d R v + t (C, N, 3) for directions v (C, 3)."""
    return turned(v, readings) * readings.distance[:, None] + readings.world_t_hand


def turned(vectors: FloatArray, readings: Readings) -> FloatArray:
    """Return R u (C, N, 3) for vectors u (C, 3), hand frame."""
    turned: FloatArray = np.einsum("nij,cj->cni", readings.world_R_hand, vectors)
    return turned


def sphere(count: int) -> FloatArray:
    """Return `count` unit vectors (count, 3) spread evenly over the sphere (Fibonacci lattice)."""
    index = np.arange(count) + 0.5
    z = 1.0 - 2.0 * index / count
    angle = index * np.pi * (3.0 - np.sqrt(5.0))
    radius = np.sqrt(1.0 - z * z)
    return np.stack((radius * np.cos(angle), radius * np.sin(angle), z), axis=1)


def planes_through(
    spots: FloatArray, readings: Readings, weights: FloatArray | None = None
) -> tuple[FloatArray, FloatArray]:
    """Fit every plane to its spots (C, N, 3), with weights (C, N); return (C, P, 3) and (C, P)."""
    first = np.flatnonzero(np.diff(readings.plane, prepend=-1))
    centre, scatter = model.means_and_scatter(spots, first, weights)
    n = np.linalg.eigh(scatter)[1][..., 0]
    normals = np.zeros((len(spots), readings.planes, 3))
    normals[..., 2] = 1.0
    offsets = np.zeros((len(spots), readings.planes))
    seen = readings.plane[first]
    normals[:, seen] = n
    offsets[:, seen] = -np.einsum("cpi,cpi->cp", n, centre)
    return normals, offsets


def common_location(
    reach: FloatArray,
    n: FloatArray,
    b: FloatArray,
    readings: Readings,
    weights: FloatArray | None = None,
) -> FloatArray:
    """Return the location (C, 3) that all beams share, for known planes; weights are (C, N)."""
    each = n[:, readings.plane]
    A = np.einsum("nji,cnj->cni", readings.world_R_hand, each)
    rhs = -(np.einsum("cni,cni->cn", each, reach) + b[:, readings.plane])
    At = np.swapaxes(A if weights is None else A * weights[..., None], 1, 2)
    H = At @ A
    ridge = 1e-6 * np.trace(H, axis1=1, axis2=2)[:, None, None] * np.eye(3)
    solved: FloatArray = np.linalg.solve(H + ridge, At @ rhs[..., None])[..., 0]
    return solved


def _misfit(
    spots: FloatArray, v: FloatArray, n: FloatArray, b: FloatArray, readings: Readings
) -> FloatArray:
    """Return the sum of squared residuals along the beams (C,)."""
    misfit: FloatArray = (along_beams(spots, v, n, b, readings) ** 2).sum(axis=1)
    return misfit


def along_beams(
    spots: FloatArray, v: FloatArray, n: FloatArray, b: FloatArray, readings: Readings
) -> FloatArray:
    """Return how far along their beams the spots (C, N, 3) are from their planes (C, N) [m]."""
    each = n[:, readings.plane]
    away = np.einsum("cni,cni->cn", each, spots) + b[:, readings.plane]
    cosine = np.abs(np.einsum("cni,cni->cn", each, turned(v, readings)))
    found: FloatArray = np.abs(away) / np.maximum(cosine, LEAST_COSINE)
    return found
