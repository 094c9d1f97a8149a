"""Order stations so that the way between them is short."""

import numpy as np
from scipy.spatial.transform import Rotation

from ..arrays import FloatArray, IntArray
from ..simulation.simulate import Stations


def shortest(stations: Stations, length: float, first: int | None = None) -> IntArray:
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
            after = cost[order[i - 1], order[j]] + np.append(
                cost[order[i], order[j[:-1] + 1]], 0.0
            )
            best = int(np.argmin(after - before))
            if after[best] < before[best] - 1e-12:
                order[i : j[best] + 1] = order[i : j[best] + 1][::-1]
                better = True
    return order
