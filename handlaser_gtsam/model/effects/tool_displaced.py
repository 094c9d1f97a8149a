"""A tool frame that is displaced while recording, at once or steadily, along one of some directions.

It moves in the hand; displacements are counted from their mean.
"""

from itertools import product

import numpy as np

from ...arrays import FloatArray, IntArray
from ..geometry import normalized
from .displaced import LEAST_STATIONS
from .effect import Everywhere, SeenStations

TOOL_STEPS = 7
"""Evenly spaced stations from which on a tool frame may be displaced: a step half-way between two of
them correlates by 0.88 or more with one of the two."""


def _since(stations: SeenStations) -> IntArray:
    """Return the positions of the stations at which a displacement may begin; -1 for a steady one."""
    times = np.unique(stations.position)
    splits = np.linspace(0, len(times), TOOL_STEPS + 2)[1:-1].round().astype(np.intp)
    splits = np.unique(splits[(splits >= LEAST_STATIONS) & (splits <= len(times) - LEAST_STATIONS)])
    return np.concatenate(([-1], times[splits]))


def directions() -> FloatArray:
    """Return directions (13, 3) in which a tool frame may be displaced.

    They are the axes and diagonals of a cube, one of which has a cosine of 0.886 or more to any
    direction.
    """
    corners = np.array(list(product((-1.0, 0.0, 1.0), repeat=3)))
    half = corners[len(corners) // 2 + 1 :]  # the others are opposite
    return normalized(half)


def twists(stations: SeenStations) -> FloatArray:
    """Return displacements (S, 6, 3 T) by a metre along x, y and z, for each time they may begin.

    The first of the T is steady; the others begin at a station.
    """
    shares = _shares(stations)[stations.first[0]]
    moved = np.zeros((len(shares), 6, shares.shape[1], 3))
    moved[:, 3:] = shares[:, None, :, None] * np.eye(3)[:, None]
    return moved.reshape(len(shares), 6, -1)


def _shares(stations: SeenStations) -> FloatArray:
    """Return which part of each displacement there is at every reading (N, T), less its mean."""
    since, position = _since(stations).tolist(), stations.position
    shares = np.stack(
        [stations.time if first < 0 else position >= first for first in since], axis=1
    )
    return np.asarray(shares - shares.mean(axis=0))


def members(stations: SeenStations) -> Everywhere:
    """Return a member for every direction, and for every time at which it may happen."""
    since, along = _since(stations), directions()
    each_time = np.asarray(np.kron(np.eye(len(since)), along.T), dtype=float)
    # What `by_poses` makes of the twists, but for their zeros: these are many.
    columns = -_shares(stations)[:, :, None] * stations.linear.pose[:, None, 3:]
    columns = columns.reshape(len(columns), -1)
    times = ["steadily" if n < 0 else f"from station number {n + 1} on" for n in since.tolist()]
    parts = tuple(f"along {axis} {time}" for time in times for axis in "xyz")
    return Everywhere(columns, each_time, np.repeat(since, len(along)), parts)
