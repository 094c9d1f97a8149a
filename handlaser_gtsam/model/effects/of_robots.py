"""Columns of errors of the robot: a lag, wrong scales, and a tool frame that is displaced."""

from itertools import product

import numpy as np
from scipy.spatial.transform import Rotation

from .effect import LEAST_STATIONS, Everywhere, SeenStations

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


def lag(stations: SeenStations) -> Everywhere:
    """Return derivatives (N, 1) by hands that are ahead of their recorded poses by a step.

    The step is half the way from the previous station of the plane to the next, or the whole way to or
    from the neighbour at the ends.
    """
    readings, row = stations.readings, stations.first[0]
    R, t = readings.world_R_hand[row], readings.world_t_hand[row]
    order = np.lexsort((stations.position[row], readings.plane[row]))
    plane = readings.plane[row][order]
    same = np.flatnonzero(plane[1:] == plane[:-1])
    before, after = order.copy(), order.copy()
    before[same + 1], after[same] = order[same], order[same + 1]
    count = np.maximum((before != order).astype(int) + (after != order), 1)[:, None]
    step = np.zeros((len(row), 6))
    turn = Rotation.from_matrix(np.swapaxes(R[before], 1, 2) @ R[after]).as_rotvec()
    step[order, :3] = turn / count
    step[order, 3:] = np.einsum("mij,mi->mj", R[order], (t[after] - t[before]) / count)
    return Everywhere(stations.by_pose(step)[:, None])


def turn_scale(stations: SeenStations) -> Everywhere:
    """Return derivatives (N, 1) by turns from the mean orientation that are twice as large."""
    R = stations.readings.world_R_hand[stations.first[0]]
    turn = Rotation.from_matrix(Rotation.from_matrix(R).mean().as_matrix().T @ R).as_rotvec()
    return Everywhere(stations.by_pose(np.hstack((turn, np.zeros_like(turn))))[:, None])


def translation_scale(stations: SeenStations) -> Everywhere:
    """Return derivatives (N, 1) by translations that are twice as large.

    They count from the origin of the plane's frame, in which the plane shifts.
    """
    readings, row = stations.readings, stations.first[0]
    shift = np.einsum("mij,mi->mj", readings.world_R_hand[row], readings.world_t_hand[row])
    return Everywhere(stations.by_pose(np.hstack((np.zeros_like(shift), shift)))[:, None])


def tool_displaced(stations: SeenStations) -> Everywhere:
    """Return derivatives (N, 3) by a metre along x, y and z for every time at which it may happen.

    The tool frame moves in the hand along one of `DIRECTIONS`, at once or steadily; displacements are
    counted from their mean. The first is steady, and its position -1; the others begin at a station.
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
