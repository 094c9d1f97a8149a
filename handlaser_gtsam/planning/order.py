"""Order stations so that the way between them is short."""

import math

import numpy as np
from scipy.spatial.transform import Rotation

from ..arrays import FloatArray, IntArray
from ..validation.simulate import Stations


def shortest(stations: Stations, length: float) -> IntArray:
    """Return an order (M,) of stations with a short way: plane by plane, nearest first, uncrossed.

    Parameters
    ----------
    stations : Stations
    length : float
        A turn by one radian counts as a move by so much [m].
    """
    order: list[int] = []
    for plane in np.unique(stations.plane):
        rows = np.flatnonzero(stations.plane == plane)
        cost = _distances(stations, rows, length)
        start = 0 if not order else int(_from(stations, order[-1], rows, length).argmin())
        order += rows[_uncrossed(_nearest(cost, start), cost)].tolist()
    return np.array(order, dtype=np.intp)


def way(stations: Stations, order: IntArray, length: float) -> float:
    """Return the length of the way [m], turns included."""
    cost = _distances(stations, order, length)
    return float(np.diagonal(cost, 1).sum())


def divided(stations: Stations, largest_step: float) -> tuple[Stations, IntArray]:
    """Return stations with others between them wherever a step is longer than `largest_step` [m].

    Returns
    -------
    Stations
    origin : (M,)
        Index of each among those given, -1 where it was put between.
    """
    R, t, planes, origin = [], [], [], []
    for index in range(len(stations.plane)):
        here, turn = stations.world_t_hand[index], stations.world_R_hand[index]
        if index:
            step = here - stations.world_t_hand[index - 1]
            before = stations.world_R_hand[index - 1]
            vector = Rotation.from_matrix(before.T @ turn).as_rotvec()
            parts = math.ceil(float(np.linalg.norm(step)) / largest_step - 1e-9)
            for share in np.arange(1, parts) / max(parts, 1):
                R.append(before @ Rotation.from_rotvec(share * vector).as_matrix())
                t.append(here - (1.0 - share) * step)
                planes.append(stations.plane[index])
                origin.append(-1)
        R.append(turn)
        t.append(here)
        planes.append(stations.plane[index])
        origin.append(index)
    way = Stations(np.array(R), np.array(t), np.array(planes, dtype=np.intp))
    return way, np.array(origin, dtype=np.intp)


def _distances(stations: Stations, rows: IntArray, length: float) -> FloatArray:
    return np.stack([_from(stations, int(i), rows, length) for i in rows])


def _from(stations: Stations, one: int, rows: IntArray, length: float) -> FloatArray:
    t, R = stations.world_t_hand, stations.world_R_hand
    turn = Rotation.from_matrix(R[one].T @ R[rows]).magnitude()
    return np.asarray(np.linalg.norm(t[rows] - t[one], axis=1) + length * turn)


def _nearest(cost: FloatArray, start: int) -> list[int]:
    """Go to the nearest station that was not visited."""
    path, left = [start], set(range(len(cost))) - {start}
    while left:
        path.append(min(left, key=lambda j: (cost[path[-1], j], j)))
        left.remove(path[-1])
    return path


def _uncrossed(path: list[int], cost: FloatArray) -> IntArray:
    """Turn parts of the way round while that shortens it (2-opt); the first station stays."""
    order = np.array(path)
    count = len(order)
    better = True
    while better:
        better = False
        for i in range(1, count - 1):
            j = np.arange(i + 1, count)
            before = cost[order[i - 1], order[i]] + np.append(
                cost[order[j[:-1]], order[j[:-1] + 1]], 0.0
            )
            after = cost[order[i - 1], order[j]] + np.append(cost[order[i], order[j[:-1] + 1]], 0.0)
            best = int(np.argmin(after - before))
            if after[best] < before[best] - 1e-12:
                order[i : j[best] + 1] = order[i : j[best] + 1][::-1]
                better = True
    return order
