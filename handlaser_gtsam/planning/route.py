"""A plan: chosen stations in the order of the way, with what will be known after them.

The order is a short one, and long steps are divided. The way of an arm is straight in its joints, and
nothing touches on it. Where the straight way between two stations would touch the plate, the hand
withdraws from it, moves, and comes back; where that does not help either, it passes the joints at which
the arm stood before. Between planes it always withdraws, and no plate is in the way: a person puts it
up again where the hand then stands, withdrawn from where the plate will be.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import count, islice

import numpy as np
from scipy.spatial.transform import Rotation

from ..arrays import BoolArray, FloatArray, IntArray
from ..data.station_list import StationList
from ..data.value import Value
from ..errors import InputError
from ..quantities import ROUNDING
from ..validation.simulate import Stations
from .bounds import Plate
from .goal import Aim, Forecast
from .robot import Robot
from .workspace import Workspace, inside, joined

VIA = "via"
"""Beginning of the names of stations on the way, at which nothing need be read."""
TRIED_SOLUTIONS = 4
"""Joints of one pose that are tried: an arm of six joints has up to eight."""


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Plan(Value):
    """Stations to measure next.

    Their order shortens the way; in a survey and in a first motion it is the order in which they
    matter.

    Attributes
    ----------
    stations : StationList
        Those named "via 1", ... divide a step that is longer than the workspace allows, or lead around
        the plate; nothing need be read there. With an arm, they have its joints.
    ranges : (M, B)
        What every beam before planes is expected to read [m]; NaN on the way. None is expected of a
        survey (M, 0).
    range_sigmas : (M, B)
        How far the reading may be off [m], noise included.
    forecast : Forecast
        If they were measured in the order in which they matter. NaN as long as a survey, with the
        stations up to there, leaves anything undetermined.
    reached : int or None
        How many of them reach the goal, in that order; None where all do not, or none is stated.
    plates : mapping by name
        Where the plate is to be put, for planes that are to be moved.
    safe : float or None
        Of a first motion: the part of mounts within the bounds at which all readings are within the
        sensor's limits.
    plate_across : float or None
        Of a first motion: how far across the plate is about its point, at least, so that all spots lie
        on it, wherever the mounts are within the bounds [m].
    skipped : int
        Stations fewer than were chosen: the arm found no way to them, nor to others in their place.
    uncounted : tuple of str
        Codes of errors that were free in the calibration, of which the stations are taken to have none.
    sensors : tuple of str
        Of a survey: the sensor that looks at the target, or `beam NAME`, at each station; empty on the
        way. No names where all beams read at every station.
    undetermined : tuple of str
        What the calibration of a survey leaves undetermined, in sentences.
    """

    stations: StationList
    ranges: FloatArray
    range_sigmas: FloatArray
    forecast: Forecast
    reached: int | None = None
    plates: Mapping[str, Plate] = field(default_factory=dict)
    safe: float | None = None
    plate_across: float | None = None
    skipped: int = 0
    uncounted: tuple[str, ...] = ()
    sensors: tuple[str, ...] = ()
    undetermined: tuple[str, ...] = ()

    @property
    def assumed(self) -> tuple[str, ...]:
        """What it takes for granted of freed errors, in words, a sentence each."""
        if not self.uncounted:
            return ()
        words = ", ".join(self.uncounted)
        return (
            f"the stations are taken to be without the freed errors {words}: let there be none",
        )

    @property
    def determined(self) -> bool:
        """Whether everything is determined once there are its stations."""
        return bool(np.isfinite(self.forecast.spot[-1]))

    @property
    def read(self) -> BoolArray:
        """Tell which stations (M,) are to be read: the others lie on the way."""
        return np.array([not name.startswith(VIA) for name in self.stations.station_names])

    def __len__(self) -> int:
        """Return how many stations are to be read."""
        return int(self.read.sum())


def visited(
    workspace: Workspace,
    stations: Stations,
    *,
    labels: Sequence[str],
    plates: Sequence[Plate | None],
    taken: Sequence[str] = (),
    length: float | None = None,
) -> tuple[StationList, IntArray]:
    """Return a way to stations: straight without an arm, in steps that the workspace allows.

    Parameters
    ----------
    workspace : Workspace
    stations : Stations
    labels, plates : sequences by plane
        The name of each plane or other target, and what the arm is not to touch there.
    taken : sequence of str
        Names of stations that there are already.
    length : float, optional
        The order is a short one, in which a turn by one radian counts as a move by this length [m];
        that of the stations where not given.

    Returns
    -------
    StationList
        With others on the way, which are named `VIA`.
    origin : (M,)
        Index of each among the given ones, -1 on the way. Those are missing to which the arm finds no
        way.
    """
    robot, joints = workspace.robot, None
    order = np.arange(len(stations)) if length is None else shortest(stations, length)
    if robot is None:
        way, origin = divided(stations[order], workspace.largest_step)
    else:
        way, origin, joints = driven(robot, stations[order], workspace, plates)
    read = origin >= 0
    numbers = (str(i) for i in count(len(taken) + 1) if str(i) not in taken)
    passed = (f"{VIA} {i}" for i in count(1) if f"{VIA} {i}" not in taken)
    listed = StationList(
        way.world_R_hand,
        way.world_t_hand,
        tuple(labels[plane] for plane in way.plane),
        tuple(next(numbers if is_read else passed) for is_read in read),
        joints,
        () if robot is None else robot.joint_names,
    )
    return listed, np.where(read, order[origin], -1)


def planned(
    aim: Aim,
    candidates: Stations,
    rows: FloatArray,
    chosen: IntArray,
    visit: Callable[[Stations], tuple[StationList, IntArray]],
) -> tuple[Plan, IntArray]:
    """Return a plan of chosen candidates, with a way to them.

    Where the arm finds no way to some, the best others beside those that it reaches take their places,
    as long as there are others. The choice with the most stations wins.

    Parameters
    ----------
    aim : Aim
    candidates : Stations
        All of them, N.
    rows : (N, B, U + c)
        Their whitened rows; see `Aim`.
    chosen : (C,)
        Indices of candidates, in the order in which they matter.
    visit : callable
        Returns a way to some of them, as `visited` does.

    Returns
    -------
    Plan
        Without what is expected to be read.
    candidate : (M,)
        Index of the candidate at each station of the plan; -1 on the way.

    Raises
    ------
    InputError
        The arm finds no way to any station.
    """

    def way(some: IntArray) -> tuple[StationList, IntArray, IntArray]:
        """Return a way, the candidate at each of its stations, and those reached as they matter."""
        stations, origin = visit(candidates[some])
        return stations, np.where(origin >= 0, some[origin], -1), some[np.sort(origin[origin >= 0])]

    others = np.setdiff1d(np.arange(len(rows)), chosen)
    stations, candidate, reached = way(chosen)
    found = reached
    for _ in range(5):  # most plans need one or two, before fewer stations have to do
        missing = len(chosen) - len(found)
        if not missing or len(others) < missing:
            break
        more = others[aim.chosen(rows[None, others], missing, rows[found])]
        others = np.setdiff1d(others, more)
        every = np.concatenate((found, more))
        tried = way(every[aim.chosen(rows[None, every], len(every))])
        found = tried[2]
        if len(found) > len(reached):
            stations, candidate, reached = tried
    forecast = aim.forecast(rows[reached])
    enough = forecast.reaches(aim.goal) if aim.goal.stated else None
    nothing, skipped = np.empty((len(stations), 0)), len(chosen) - len(reached)
    return Plan(stations, nothing, nothing, forecast, enough, skipped=skipped), candidate


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
    wanted = np.linalg.norm(steps, axis=1) / largest_step - ROUNDING
    parts = np.maximum(np.ceil(wanted), 1).astype(int)
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
            yield passed[1:]

    def along(q: FloatArray, before: int, way: Stations, left: Iterator[int]) -> list[FloatArray]:
        """Return joints of a way from joints q before plane `before`; fewer where none is free.

        No plate stands on the way to another plane. `left` ends after as many ways as may be tried.
        """
        if not len(way):
            return []
        plane, rest = int(way.plane[0]), way[1:]
        R, t = way.world_R_hand[0], way.world_t_hand[0]
        solutions = robot.solutions(R, t, plates[plane], q)
        for solved, _ in zip(islice(solutions, TRIED_SOLUTIONS), left, strict=False):
            if robot.free_way(q, solved, plates[plane] if plane == before else None, box):
                found = [solved, *along(solved, plane, rest, left)]
                if len(found) == len(way):
                    return found
        return []

    def drive(first: int, q: FloatArray) -> list[tuple[Stations, list[FloatArray], int]]:
        """Drive to all stations from joints at the `first` one, or from the start before all (-1).

        Each leg is a way, the joints along it, and the index of the station at its end.
        """
        legs = [(stations[first : first + 1], [q], first)] if first >= 0 else []
        for index in range(first + 1, len(stations)):
            last = legs[-1][0][-1:] if legs else None
            for way in ways(last, stations[index : index + 1]):
                plane = int((way if last is None else last).plane[0])
                # Ways between two stations that are tried, before another detour: a second or two.
                found = along(legs[-1][1][-1] if legs else q, plane, way, iter(range(100)))
                if found:
                    legs.append((way, found, index))
                    break
        return legs

    legs: list[tuple[Stations, list[FloatArray], int]] = []
    for first, q in _beginnings(robot, stations, plates):
        # From some, the arm is in its own way, or at a limit, soon.
        tried = drive(first, q)
        if len(tried) <= len(legs):
            break
        legs = tried
        if len(legs) == len(stations):
            break
    if not legs:
        raise InputError(
            "no way of the arm without a collision to any station",
            "more room around the plate, a smaller clearance or other start joints",
        )
    passed, joints, ends = zip(*legs, strict=True)
    origin = [[-1] * (len(way) - 1) + [end] for way, end in zip(passed, ends, strict=True)]
    return joined(passed), np.concatenate(origin).astype(np.intp), np.concatenate(joints)


def _beginnings(
    robot: Robot, stations: Stations, plates: Sequence[Plate | None]
) -> Iterator[tuple[int, FloatArray]]:
    """Yield where an arm may begin: the index of a station and joints there, or -1 and its start.

    Without a start, several joints lead to the first station that it can be at.
    """
    if len(robot.start):
        yield -1, robot.start
        return
    middle = 0.5 * np.add(*robot.limits)
    poses = zip(stations.world_R_hand, stations.world_t_hand, stations.plane, strict=True)
    for index, (R, t, plane) in enumerate(poses):
        some = list(islice(robot.solutions(R, t, plates[plane], middle), TRIED_SOLUTIONS))
        if some:
            yield from ((index, q) for q in some)
            return
