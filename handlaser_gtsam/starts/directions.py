r"""A start from few stations of many planes or beams: sweep the common direction of the beams.

Blocks of one beam and one plane may be too small to solve alone. Here all beams share one location
and direction for a moment. For a direction v the laser spots of a reading lie at

    X = R (r + d v) + t

so that, from r = 0 on, planes follow from their spots by total least squares, and r follows from the
planes by linear least squares, in turns. The directions whose spots are flattest become starts; every
beam gets its own location and direction when they are refined. Where beams sit far from the hand's
origin and blocks are tiny, r = 0 is too far away: then r is drawn at random too.

Among gross errors a plane that is fitted to all spots follows the wrong ones: spots of a station whose
label names another plane, or of a reading that is no range. So every direction may begin with its
stations drawn at random, so that many begin without the wrong ones; then all readings count, but the
less the farther they are from their plane, in units of the nearer part of the readings of that plane.
The nearer part of all readings says how good such a direction is.
"""

import numpy as np

from .. import model
from ..arrays import BoolArray, FloatArray
from ..data.parameters import Parameters
from ..data.recording import Readings
from ..quantities import MAJORITY, NEGLIGIBLE, NUMBERS_AT_ONCE, TINY
from .growing import grown_from

FITTING_TURNS = 3
"""Turns of fitting planes, then the location, after which directions can be ranked; one more for
directions that begin with some stations, which the first uses alone."""
FLATTEST = 0.1
"""A beam at a smaller cosine to its plane (84 degrees) counts as at this one: its spot says little. A
direction of a single beam that meets a plane so is no candidate."""
DRAWN = (0.4, 0.9)
"""Least and largest part of the stations that a direction begins with: fewer rarely fit well, and more
rarely avoid a wrong station."""


def direction_starts(readings: Readings, count: int, tried: int = 200) -> list[Parameters]:
    """Return the `count` best starts of `tried` directions over the sphere."""
    v = sphere(tried)
    away, r, n, b = _swept(v, readings)
    best = np.argsort((away**2).sum(axis=1), kind="stable")[:count]
    return _starts(r[best], v[best], n[best], b[best], readings)


def subset_starts(
    readings: Readings, count: int, tried: int, rng: np.random.Generator
) -> list[Parameters]:
    """Return the `count` best starts of `tried` directions over the sphere; every plane has readings.

    Parameters
    ----------
    readings : Readings
    count, tried : int
    rng : numpy.random.Generator
        Draws the stations.
    """
    v = sphere(tried)
    drawn_part = rng.uniform(*DRAWN, (tried, 1))
    drawn = rng.random((tried, int(readings.station.max()) + 1)) < drawn_part
    # Spots and weights of all directions take about ten numbers a reading.
    share = max(NUMBERS_AT_ONCE // (10 * len(readings)), 1)
    parts = []
    for i in range(0, tried, share):
        away, *fitted = _swept(v[i : i + share], readings, drawn[i : i + share])
        parts.append((_nearer(away), *fitted))
    misfit, r, n, b = (np.concatenate(column) for column in zip(*parts, strict=True))
    best = np.argsort(misfit, kind="stable")[:count]
    return _starts(r[best], v[best], n[best], b[best], readings)


def _swept(
    v: FloatArray, readings: Readings, drawn: BoolArray | None = None
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Fit planes and the location in turns, for directions (C, 3) that begin with `drawn` stations.

    Return distances along the beams (C, N), locations (C, 3), normals (C, P, 3) and offsets (C, P).
    """
    # A plane of which no station is drawn keeps its readings.
    weights = None if drawn is None else np.where(drawn[:, readings.station], 1.0, 1e-3)
    turns = FITTING_TURNS if drawn is None else FITTING_TURNS + 1
    reach, r, plane = _reach(v, readings), np.zeros_like(v), readings.plane
    for turn in range(turns + 1):
        spots = reach + _turned(r, readings)
        n, b = _planes_through(spots, readings, weights)
        away = np.einsum("cni,cni->cn", n[:, plane], spots) + b[:, plane]
        if turn == turns:
            break
        if turn and drawn is not None:
            weights = _weights(np.abs(away), readings)
        # The location that all beams share, for known planes.
        each = n[:, plane]
        A = (each.transpose(1, 0, 2) @ readings.world_R_hand).transpose(1, 0, 2)
        rhs = -(np.einsum("cni,cni->cn", each, reach) + b[:, plane])
        r = least_squares(A, rhs, NEGLIGIBLE, weights)
    cosine = np.abs(np.einsum("cni,cni->cn", n[:, plane], _turned(v, readings)))
    return np.abs(away) / np.maximum(cosine, FLATTEST), r, n, b


def random_starts(readings: Readings, count: int, rng: np.random.Generator) -> list[Parameters]:
    """Return starts of random directions and locations, up to twenty ranges from the hand's origin."""
    v = model.normalized(rng.standard_normal((count, 3)))
    r = model.normalized(rng.standard_normal((count, 3)))
    r *= readings.typical_range() * 10.0 ** rng.uniform(-0.5, 1.3, (count, 1))
    n, b = _planes_through(_reach(v, readings) + _turned(r, readings), readings)
    return _starts(r, v, n, b, readings)


def _starts(
    r: FloatArray, v: FloatArray, n: FloatArray, b: FloatArray, readings: Readings
) -> list[Parameters]:
    """Return starts of C locations and directions, which all beams share, and of C times P planes."""
    rows = zip(r, v, n, b, strict=True)
    return [grown_from(readings, r=r, v=v, n=n, b=b) for r, v, n, b in rows]


def _reach(v: FloatArray, readings: Readings) -> FloatArray:
    """Return d R v + t (C, N, 3) for directions v (C, 3)."""
    return _turned(v, readings) * readings.distance[:, None] + readings.world_t_hand


def _turned(vectors: FloatArray, readings: Readings) -> FloatArray:
    """Return R u (C, N, 3) for vectors u (C, 3), hand frame."""
    along = vectors @ readings.world_R_hand.reshape(-1, 3).T
    return np.asarray(along.reshape(len(vectors), -1, 3))


def sphere(count: int) -> FloatArray:
    """Return `count` unit vectors (count, 3) spread evenly over the sphere (Fibonacci lattice)."""
    index = np.arange(count) + 0.5
    z = 1.0 - 2.0 * index / count
    angle = index * np.pi * (3.0 - np.sqrt(5.0))
    radius = np.sqrt(1.0 - z * z)
    return np.stack((radius * np.cos(angle), radius * np.sin(angle), z), axis=1)


def half_sphere(count: int) -> FloatArray:
    """Return `count` unit vectors (count, 3) spread evenly over half a sphere."""
    return sphere(2 * count)[:count]


def _planes_through(
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


def least_squares(
    A: FloatArray, rhs: FloatArray, ridge: float, weights: FloatArray | None = None
) -> FloatArray:
    """Return x (C, K) of least |A x - rhs| for every A (C, M, K), and a part of the trace as ridge."""
    At = np.swapaxes(A if weights is None else A * weights[..., None], 1, 2)
    H: FloatArray = At @ A
    trace = np.trace(H, axis1=1, axis2=2)[:, None, None]
    solved: FloatArray = np.linalg.solve(
        H + ridge * trace * np.eye(H.shape[1]), At @ rhs[..., None]
    )
    return solved[..., 0]


def _weights(away: FloatArray, readings: Readings) -> FloatArray:
    """Return the weights (C, N) of spots by their distances from their planes."""
    first = np.flatnonzero(np.diff(readings.plane, prepend=-1))
    weights: FloatArray = np.empty_like(away)
    for rows in np.split(np.arange(len(readings)), first[1:]):
        unit = _nearer(away[:, rows])[:, None] + TINY
        with np.errstate(over="ignore"):  # spots exactly on a plane: what is off weighs nothing
            weights[:, rows] = 1.0 / (1.0 + (away[:, rows] / unit) ** 2) ** 2
    return weights


def _nearer(away: FloatArray) -> FloatArray:
    """Return the distance (C,) within which the nearer part of distances (C, N) are."""
    rank = min(int(MAJORITY * away.shape[1]), away.shape[1] - 1)
    return np.asarray(np.partition(away, rank, axis=1)[:, rank])
