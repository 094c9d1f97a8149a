"""Order stations so that the way between them is short."""

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
        A turn by one radian counts as a move by this length [m].
    """
    order: list[int] = []
    for plane in np.unique(stations.plane):
        rows = np.flatnonzero(stations.plane == plane)
        start = int(_costs(stations, order[-1], rows, length).argmin()) if order else 0
        cost = np.stack([_costs(stations, int(row), rows, length) for row in rows])
        path, left = [start], set(range(len(rows))) - {start}
        while left:
            path.append(min(left, key=lambda j: (cost[path[-1], j], j)))
            left.remove(path[-1])
        order += rows[_uncrossed(path, cost)].tolist()
    return np.array(order, dtype=np.intp)


def divided(stations: Stations, largest_step: float) -> tuple[Stations, IntArray]:
    """Return stations with others between them wherever a step is longer than `largest_step` [m].

    Returns
    -------
    Stations
    origin : (M,)
        Index of each among the given ones, -1 where it was put between.
    """
    R, t = stations.world_R_hand, stations.world_t_hand
    steps = np.diff(t, axis=0, prepend=t[:1])
    parts = np.maximum(np.ceil(np.linalg.norm(steps, axis=1) / largest_step - 1e-9), 1).astype(int)
    after = np.repeat(np.arange(len(parts)), parts)  # the station at which each step ends
    share = np.concatenate([np.arange(1, count + 1) / count for count in parts])
    before = np.maximum(after - 1, 0)
    turn = Rotation.from_matrix(np.swapaxes(R[before], 1, 2) @ R[after]).as_rotvec()
    turned = R[before] @ Rotation.from_rotvec(share[:, None] * turn).as_matrix()
    there = share == 1.0
    way = Stations(
        np.where(there[:, None, None], R[after], turned),
        t[after] - (1.0 - share)[:, None] * steps[after],
        stations.plane[after],
    )
    return way, np.where(there, after, -1)


def _costs(stations: Stations, start: int, rows: IntArray, length: float) -> FloatArray:
    """Return the lengths of the ways from one station to others (N,) [m], turns included."""
    t, R = stations.world_t_hand, stations.world_R_hand
    turn = Rotation.from_matrix(R[start].T @ R[rows]).magnitude()
    return np.asarray(np.linalg.norm(t[rows] - t[start], axis=1) + length * turn)


def _uncrossed(path: list[int], cost: FloatArray) -> IntArray:
    """Turn parts of the way round while that shortens it (2-opt); the first station stays."""
    order = np.array(path)
    count = len(order)
    better = True
    while better:
        better = False
        for i in range(1, count - 1):
            j = np.arange(i + 1, count)
            ends = order[j[:-1] + 1]
            before = cost[order[i - 1], order[i]] + np.append(cost[order[j[:-1]], ends], 0.0)
            after = cost[order[i - 1], order[j]] + np.append(cost[order[i], ends], 0.0)
            best = int(np.argmin(after - before))
            if after[best] < before[best] - 1e-12:
                order[i : j[best] + 1] = order[i : j[best] + 1][::-1]
                better = True
    return order
