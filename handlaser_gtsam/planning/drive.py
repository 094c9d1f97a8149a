"""The way of an arm from station to station, straight in its joints, on which nothing touches.

Where the straight way between two stations would touch the plate, the hand withdraws from it, moves,
and comes back; where that does not help either, it passes the joints at which the arm stood before.
Between planes it always withdraws, and no plate is in the way: a person puts it anew where the hand
then stands, withdrawn from where the plate will be.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from ..arrays import FloatArray, IntArray
from ..errors import InputError
from ..validation.simulate import Stations
from .order import divided
from .plate import Plate
from .robot import Robot
from .workspace import Workspace, inside, joined, picked

BACK = (0.05, 0.1, 0.02)
"""How far the hand withdraws from the plate [m], in the order in which it is tried."""
TRIED = 4
"""Solutions of a pose that are tried on the way."""
PATIENCE = 100
"""Ways between two stations that are tried, before another detour."""


@dataclass(frozen=True, slots=True)
class _Drive:
    """Who drives, where it may, and the plate of every plane."""

    robot: Robot
    workspace: Workspace
    plates: Sequence[Plate]

    @property
    def box(self) -> tuple[FloatArray, FloatArray] | None:
        """That the hand keeps to on its way where nothing else says how far down it may go."""
        where = self.workspace
        return (where.low, where.high) if self.robot.table is None else None


@dataclass(slots=True)
class _Patience:
    left: int = PATIENCE


def driven(
    robot: Robot, stations: Stations, workspace: Workspace, plates: Sequence[Plate]
) -> tuple[Stations, IntArray, FloatArray]:
    """Return stations with those between them that the arm passes, and the joints of all.

    What is passed lies in the workspace, too, except where the arm stands at first. There is one plate
    a plane.

    Returns
    -------
    Stations
    origin : (M,)
        Index of each among those given, -1 where it was put between. Those to which no way was found
        are left out.
    joints : (M, J)
        [rad], [m].

    Raises
    ------
    InputError
        No way to any of the stations was found.
    """
    drive = _Drive(robot, workspace, plates)
    parts: list[Stations] = []
    joints: list[FloatArray] = []
    origin: list[int] = []
    here: Stations | None = None
    q = robot.start if len(robot.start) else None
    for index in range(len(stations.plane)):
        there = picked(stations, np.array([index]))
        leg = _leg(drive, here, q, there)
        if leg is None:
            continue
        passed, along = leg
        parts.append(passed)
        joints.append(along)
        origin += [-1] * (len(along) - 1) + [index]
        here, q = there, along[-1]
    if not parts:
        raise InputError(
            "no way of the arm without a collision to any station",
            "more room around the plate, a smaller clearance or other start joints",
        )
    return joined(parts), np.array(origin, dtype=np.intp), np.concatenate(joints)


def _leg(
    drive: _Drive, here: Stations | None, q: FloatArray | None, there: Stations
) -> tuple[Stations, FloatArray] | None:
    """Return what is passed on the way to a station, itself included, and the joints."""
    if q is None or here is None:
        return _begin(drive, q, there)
    for passed in _detours(drive, here, there):
        along = _along(drive, q, passed, 0, int(here.plane[0]), _Patience())
        if along is not None:
            return passed, np.array(along)
    return None


def _begin(
    drive: _Drive, q: FloatArray | None, there: Stations
) -> tuple[Stations, FloatArray] | None:
    """Return the way to the first station: from where the arm stands, if that is known."""
    plane = int(there.plane[0])
    if q is None:
        R, t = there.world_R_hand, there.world_t_hand
        joints = drive.robot.joints(R, t, drive.plates[plane])
        return None if np.isnan(joints).any() else (there, joints)
    for passed in (there, *(joined([back, there]) for back in _back(drive, there))):
        along = _along(drive, q, passed, 0, plane, _Patience())
        if along is not None:
            return passed, np.array(along)
    return None


def _detours(drive: _Drive, here: Stations, there: Stations) -> Iterator[Stations]:
    """Yield what can be passed on the way to a station, itself included."""
    step = drive.workspace.largest_step
    ways = [[here, there]] if here.plane[0] == there.plane[0] else []
    home = _home(drive, int(there.plane[0]))
    for middle in ([], home) if home else ([],):
        ways += [
            [here, one, *middle, other, there]
            for one, other in zip(_back(drive, here), _back(drive, there), strict=False)
        ]
    for way in ways:
        passed, _ = divided(joined(way), step)
        yield picked(passed, np.arange(1, len(passed.plane)))


def _back(drive: _Drive, station: Stations) -> list[Stations]:
    """Return where the hand is withdrawn from the plate, as far as the workspace allows."""
    n = drive.plates[int(station.plane[0])].normal
    found = [
        Stations(station.world_R_hand, station.world_t_hand - far * n, station.plane)
        for far in BACK
    ]
    return [one for one in found if inside(drive.workspace, one).all()]


def _home(drive: _Drive, plane: int) -> list[Stations]:
    """Return where the arm stood before, if that is known."""
    if not len(drive.robot.start):
        return []
    R, t = drive.robot.poses(drive.robot.start)
    return [Stations(R, t, np.array([plane], dtype=np.intp))]


def _along(
    drive: _Drive, q: FloatArray, way: Stations, at: int, before: int, patience: _Patience
) -> list[FloatArray] | None:
    """Return joints of the stations of a way from `at` on, each reached from those before.

    `before` is the plane of the joints q: no plate stands on the way to another one.
    """
    if at == len(way.plane):
        return []
    robot, plane = drive.robot, int(way.plane[at])
    own = drive.plates[plane]
    between = own if plane == before else None
    R, t = way.world_R_hand[at], way.world_t_hand[at]
    for tried, joints in enumerate(robot.solutions(R, t, own, q)):
        if tried == TRIED or patience.left <= 0:
            break
        patience.left -= 1
        if robot.free_way(q, joints, between, drive.box):
            rest = _along(drive, joints, way, at + 1, plane, patience)
            if rest is not None:
                return [joints, *rest]
    return None
