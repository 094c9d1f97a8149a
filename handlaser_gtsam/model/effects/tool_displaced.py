"""A tool frame that is displaced while recording, at once or steadily, along one of some directions.

It moves in the hand; displacements are counted from their mean.
"""

from itertools import product

import numpy as np

from .displaced import LEAST_STATIONS
from .effect import Effect, Everywhere, SeenStations

DIRECTIONS = np.array(
    [
        axis
        for axis in product((0.0, 1.0, -1.0), repeat=3)
        if any(axis) and axis > tuple(-x for x in axis)
    ]
)
"""Directions in which a tool frame may be displaced (13, 3): the axes and diagonals of a cube, one of
which has a cosine of 0.886 or more to any direction."""
DIRECTIONS /= np.linalg.norm(DIRECTIONS, axis=1, keepdims=True)
TOOL_STEPS = 7
"""Evenly spaced stations from which on a tool frame may be displaced: a step half-way between two of
them correlates by 0.88 or more with one of the two."""


def members(stations: SeenStations) -> Everywhere:
    """Return the derivatives (N, 3) by a metre along x, y and z for every time at which it may happen.

    The first displacement is steady, and its position -1; the others begin at a station.
    """
    position = stations.position
    times = np.unique(position)
    splits = np.linspace(0, len(times), TOOL_STEPS + 2)[1:-1].round().astype(np.intp)
    splits = np.unique(splits[(splits >= LEAST_STATIONS) & (splits <= len(times) - LEAST_STATIONS)])
    since = np.concatenate(([-1], times[splits]))
    shares = [stations.time, *((position >= first).astype(float) for first in since[1:])]
    along = -stations.linear.location
    columns = [along * (share - share.mean())[:, None] for share in shares]
    each_time = np.kron(np.eye(len(since)), DIRECTIONS.T)
    return Everywhere(np.hstack(columns), each_time, np.repeat(since, len(DIRECTIONS)))


TOOL_DISPLACED = Effect(
    code="tool-displaced",
    phrase="a displacement of the tool frame by {size} {subject}",
    remedy="fasten the bracket of the sensors and the tool, let the robot warm up, and record again",
    reveal="repeat the first stations at the end, before the same planes",
    anywhere="while recording",
    members=members,
    of_cell=2.5e-4,
)
"""A tool frame steps or creeps by half a millimetre while recording: half of that from its middle."""
