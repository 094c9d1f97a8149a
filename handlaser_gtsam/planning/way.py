"""The way from station to station: a short order, steps that are divided, and the way of an arm.

The way of an arm is straight in its joints, and nothing touches on it. Where the straight way between
two stations would touch the plate, the hand withdraws from it, moves, and comes back; where that does
not help either, it passes the joints at which the arm stood before. Between planes it always withdraws,
and no plate is in the way: a person puts it up again where the hand then stands, withdrawn from where
the plate will be.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import islice

import numpy as np
from scipy.spatial.transform import Rotation

from ..arrays import FloatArray, IntArray
from ..errors import InputError
from ..validation.simulate import Stations
from .bounds import Plate
from .robot import Robot
from .workspace import Workspace, inside, joined


def shortest(stations: Stations, length: float) -> IntArray:
    """Return an order (M,) of stations with a short way: plane by plane, nearest first, uncrossed.

    Parameters
    ----------
    stations : Stations
    length : float
        A turn by one radian counts as a move by this length [m].
    """
    t, q = stations.world_t_hand, Rotation.from_matrix(stations.world_R_hand).as_quat()
    turns = 2.0 * np.arccos(np.minimum(np.abs(q @ q.T), 1.0))
    costs = np.linalg.norm(t[:, None] - t, axis=2) + length * turns
    order: list[int] = []
    for plane in np.unique(stations.plane):
        rows = np.flatnonzero(stations.plane == plane)
        cost = costs[np.ix_(rows, rows)]
        path = [int(costs[order[-1], rows].argmin()) if order else 0]
        left = set(range(len(rows))) - set(path)
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


def driven(
    robot: Robot, stations: Stations, workspace: Workspace, plates: Sequence[Plate | None]
) -> tuple[Stations, IntArray, FloatArray]:
    """Return stations with those between them that the arm passes, and the joints of all.

    What is passed lies in the workspace, too, except where the arm stands at first. There is one plate
    a plane.

    Returns
    -------
    Stations
    origin : (M,)
        Index of each among the given ones, -1 where it was put between. Stations to which no way was
        found are missing.
    joints : (M, J)
        [rad], [m].

    Raises
    ------
    InputError
        No way to any of the stations was found.
    """
    # Where no table says how far down the hand may go, it keeps to the box of its stations.
    box = None if robot.table is not None else (workspace.low, workspace.high)
    parts: list[Stations] = []
    joints: list[FloatArray] = []
    origin: list[int] = []

    def withdrawn(station: Stations) -> list[Stations]:
        """Return where the hand is withdrawn from the plate, as far as the workspace allows."""
        plate, t = plates[int(station.plane[0])], station.world_t_hand
        if plate is None:
            return []
        # How far the hand withdraws from the plate [m], in the order in which it is tried: most
        # hands clear the plate with 50 mm, farther or nearer is for narrow cells.
        moved = (replace(station, world_t_hand=t - far * plate.normal) for far in (0.05, 0.1, 0.02))
        return [away for away in moved if inside(workspace, away).all()]

    def ways(before: Stations | None, station: Stations) -> Iterator[Stations]:
        """Yield what the hand can pass on its way to a station, which is the last."""
        back = withdrawn(station)
        if before is None:
            yield station
            if len(robot.start):
                yield from (joined([away, station]) for away in back)
            return
        start, end = int(before.plane[0]), int(station.plane[0])
        free = start == end or plates[start] is None or plates[end] is None
        routes = [[before, station]] if free else []
        both = list(zip(withdrawn(before), back, strict=False))
        routes += [[before, one, other, station] for one, other in both]
        if len(robot.start):
            home = Stations(*robot.poses(robot.start), station.plane)
            routes += [[before, one, home, other, station] for one, other in both]
        for route in routes:
            passed, _ = divided(joined(route), workspace.largest_step)
            yield passed[np.arange(1, len(passed))]

    def along(q: FloatArray, before: int, way: Stations, left: Iterator[int]) -> list[FloatArray]:
        """Return joints of a way from joints q before plane `before`; fewer where none is free.

        No plate stands on the way to another plane. `left` ends after as many ways as may be tried.
        """
        if not len(way):
            return []
        plane, rest = int(way.plane[0]), way[np.arange(1, len(way))]
        R, t = way.world_R_hand[0], way.world_t_hand[0]
        solutions = robot.solutions(R, t, plates[plane], q)
        # Solutions of a pose that are tried on the way: an arm of six joints has up to eight.
        for solved, _ in zip(islice(solutions, 4), left, strict=False):
            if robot.free_way(q, solved, plates[plane] if plane == before else None, box):
                found = [solved, *along(solved, plane, rest, left)]
                if len(found) == len(way):
                    return found
        return []

    before: Stations | None = None
    for index in range(len(stations)):
        station = stations[np.array([index])]
        for way in ways(before, station):
            q = joints[-1] if joints else robot.start
            plane = int((way if before is None else before).plane[0])
            if len(q):
                # Ways between two stations that are tried, before another detour: a second or two.
                found = along(q, plane, way, iter(range(100)))
            else:  # where no joints are known before, only those of the station matter
                solved = robot.joints(way.world_R_hand, way.world_t_hand, plates[plane])
                found = [] if np.isnan(solved).any() else list(solved)
            if found:
                parts.append(way)
                joints += found
                origin += [-1] * (len(way) - 1) + [index]
                before = station
                break
    if not parts:
        raise InputError(
            "no way of the arm without a collision to any station",
            "more room around the plate, a smaller clearance or other start joints",
        )
    return joined(parts), np.array(origin, dtype=np.intp), np.array(joints)
