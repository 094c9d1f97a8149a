"""Where the hand may go, and the stations there at which every beam can read its plane."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from .. import model
from ..arrays import BoolArray, FloatArray
from ..checks import require_kind, require_number
from ..data.recording import Recording, rotation_matrix
from ..data.station_list import StationList
from ..data.value import Value
from ..errors import InputError
from ..model.sensor_limits import Sensor
from ..quantities import LARGEST_LENGTH, MM, ROUNDING
from ..validation.simulate import Stations
from .bounds import Plate, vectors
from .robot import Robot

STEEPEST = math.radians(75.0)
"""Incidence to which a sensor without a stated limit is used: beyond, most sensors read nothing."""


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Workspace(Value):
    """Where the hand may go.

    Attributes
    ----------
    low, high : (3,)
        Box of the hand's origin, world frame [m].
    home : (3, 3)
        Orientation from which turns count, world_R_hand.
    largest_turn : float
        [rad]
    largest_step : float
        Between stations [m]; longer ways are divided.
    robot : Robot, optional
        The arm that is to reach every station.

    Raises
    ------
    InputError
        Arrays of other shapes, a box that is none, or numbers beyond sense.
    """

    low: FloatArray
    high: FloatArray
    home: FloatArray
    largest_turn: float = math.radians(30.0)
    largest_step: float = math.inf
    robot: Robot | None = None

    def __post_init__(self) -> None:
        for name in ("low", "high"):
            object.__setattr__(self, name, vectors(name, getattr(self, name), 1)[0])
        if not (self.low <= self.high).all():
            raise InputError(f"a workspace from {self.low} to {self.high} m", "low at most high")
        object.__setattr__(self, "home", rotation_matrix("home", self.home))
        require_number("largest_turn", self.largest_turn, 0.0, math.pi, above=True, unit="rad")
        if self.largest_step != math.inf:  # which says that there is no limit
            require_number(
                "largest_step", self.largest_step, 0.0, LARGEST_LENGTH, above=True, unit="m"
            )
        if self.robot is not None:
            require_kind("robot", self.robot, Robot)


def inside(workspace: Workspace, stations: Stations) -> BoolArray:
    """Tell which stations (M,) lie within a workspace."""
    t = stations.world_t_hand
    turn = Rotation.from_matrix(workspace.home.T @ stations.world_R_hand).magnitude()
    within = ((t >= workspace.low) & (t <= workspace.high)).all(axis=1)
    return np.asarray(within & (turn <= workspace.largest_turn + ROUNDING))


def reached(workspace: Workspace, stations: Stations, plates: Sequence[Plate | None]) -> BoolArray:
    """Tell which stations (M,) the arm of a workspace reaches; all where it has none.

    It is not to touch the plate of a station's plane, where there is one.
    """
    good = np.ones(len(stations), dtype=bool)
    if workspace.robot is None:
        return good
    for plane in np.unique(stations.plane):
        there = stations.plane == plane
        R, t = stations.world_R_hand[there], stations.world_t_hand[there]
        good[there] = workspace.robot.reachable(R, t, plates[plane])
    return good


def workspace_of(recording: Recording | StationList) -> Workspace:
    """Return the workspace that the stations of a recording show, and a quarter of it around them.

    The hand turns as far as there, and by 20 degrees where it has turned less: any hand can.
    """
    t, R = recording.world_t_hand, Rotation.from_matrix(recording.world_R_hand)
    home = R.mean()
    turn = room_to_turn(float((home.inv() * R).magnitude().max()))
    room = max(0.25 * float(np.ptp(t, axis=0).max()), MM)  # for a hand that has not moved
    return Workspace(t.min(axis=0) - room, t.max(axis=0) + room, home.as_matrix(), turn)


def room_to_turn(turned: float) -> float:
    """Return how far a hand may turn that has turned so far [rad]: by 20 degrees any hand can."""
    return max(turned, math.radians(20.0))


def require_facing(
    what: str, workspace: Workspace, directions: FloatArray, normal: FloatArray
) -> None:
    """Refuse a home from which no turn that is allowed brings all beams to face a plane.

    Parameters
    ----------
    what : str
        The plane, in words.
    workspace : Workspace
    directions : (B, 3)
        Of the beams, hand frame.
    normal : (3,)
        Of the plane, away from the sensor, world frame.

    Raises
    ------
    InputError
        The angle between a beam and the normal is above a right angle by more than the largest turn.
    """
    away = np.arccos(np.clip(directions @ workspace.home.T @ normal, -1.0, 1.0))
    if float(away.max()) <= 0.5 * math.pi + workspace.largest_turn:
        return
    x, y, z, w = Rotation.from_matrix(workspace.home).as_quat(canonical=True)
    raise InputError(
        f"beams that look away from {what} however the hand turns from its home, home_quaternion "
        f"[{x:.4g}, {y:.4g}, {z:.4g}, {w:.4g}]",
        "home_quaternion in the table [workspace]: qx, qy, qz, qw of a hand that faces the plate, such "
        "as a station's; and a normal of the plate that points away from the sensor",
    )


def require_range(sensor: Sensor) -> None:
    """Refuse a sensor whose range is not stated.

    Raises
    ------
    InputError
    """
    if not math.isfinite(sensor.range_max):
        raise InputError("no range of the sensor", "range_mm in the table [sensor] of the rig file")


def least_cosine(sensor: Sensor) -> float:
    """Return the cosine of the largest incidence to which a sensor is used."""
    return math.cos(min(sensor.max_incidence, STEEPEST))


def drawn_turns(workspace: Workspace, count: int, rng: np.random.Generator) -> FloatArray:
    """Return random orientations (count, 3, 3) of the hand in a workspace."""
    axis = model.normalized(rng.standard_normal((count, 3)))
    # The turns of candidates are the largest one times the root of this order of a uniform number:
    # nine of ten turn by more than three quarters of it, because stations that turn far say most.
    angle = workspace.largest_turn * rng.uniform(size=count) ** (1.0 / 9.0)
    return np.asarray(workspace.home @ Rotation.from_rotvec(angle[:, None] * axis).as_matrix())


def joined(parts: Sequence[Stations]) -> Stations:
    """Return stations one after the other."""
    return Stations(
        np.concatenate([one.world_R_hand for one in parts]),
        np.concatenate([one.world_t_hand for one in parts]),
        np.concatenate([one.plane for one in parts]),
    )
