"""Where the hand may go, and the stations there at which every beam can read its plane."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from .. import model
from ..arrays import BoolArray, FloatArray, IntArray
from ..checks import require_kind, require_number
from ..data.recording import Recording
from ..data.recording_checks import rotation_matrix
from ..data.value import Value
from ..errors import InputError
from ..model.sensor import Sensor
from ..quantities import LARGEST_LENGTH
from ..validation.simulate import Stations
from .belief import Belief
from .information import Outlook, outlook
from .plate import Plate, standing, vectors
from .robot import Robot

MARGIN = 4.0
"""Readings and angles stay so many standard deviations inside their limits: of a hundred readings at
the very margin, less than one in a hundred plans has one beyond."""
STEEPEST = math.radians(75.0)
"""Incidence to which a sensor without a stated limit is used."""
ROOMY = 0.25
"""A workspace that is not stated is that of the stations so far, and this part of it more."""
LEAST_TURN = math.radians(20.0)
"""Hands that have not turned may turn so far all the same."""
LEAST_ROOM = 1e-3
"""Hands that have not moved may move so far [m]."""
ENDS = 0.4
"""Both exponents of the beta distribution of where in the range candidates read: mostly at its ends."""
ROUNDING = 1e-9
"""Of a turn [rad]."""
TRIES = 40
"""So many times the poses that are wanted are drawn, before giving up."""
MOST_AT_ONCE = 3000
"""Poses drawn in one round, or as many as are wanted if those are more."""
MORE_THAN_MISSING = 1.3
"""So many times the poses that seem to be missing are drawn: most rounds are the last."""
ARM_TRIES = 3
"""An arm, which takes longer, is asked for so many times the poses that are wanted, at most."""
LEAST_CANDIDATES = 10
"""So few are no choice."""


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
        if not (self.low < self.high).all():
            raise InputError(f"a workspace from {self.low} to {self.high} m", "low below high")
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


def within_reach(belief: Belief, workspace: Workspace, stations: Stations) -> BoolArray:
    """Tell which stations (M,) the arm reaches without touching the plate; all without an arm."""
    count = len(stations.plane)
    found = np.ones(count, dtype=bool)
    if workspace.robot is None or not count:
        return found
    for plane in np.unique(stations.plane):
        rows = np.flatnonzero(stations.plane == plane)
        R, t = stations.world_R_hand[rows], stations.world_t_hand[rows]
        found[rows] = workspace.robot.reachable(R, t, plates_of(belief)[plane])
    return found


def plates_of(belief: Belief) -> list[Plate]:
    """Return the planes of a belief as plates."""
    origins = enumerate(belief.origins)
    return [standing(belief.mean, plane, origin) for plane, origin in origins]


def workspace_of(recording: Recording) -> Workspace:
    """Return the workspace that the stations of a recording show."""
    t, R = recording.world_t_hand, Rotation.from_matrix(recording.world_R_hand)
    home = R.mean()
    turn = max(float((home.inv() * R).magnitude().max()), LEAST_TURN)
    room = max(ROOMY * float(np.ptp(t, axis=0).max()), LEAST_ROOM)
    return Workspace(t.min(axis=0) - room, t.max(axis=0) + room, home.as_matrix(), turn)


def candidates(
    belief: Belief,
    plane: int,
    workspace: Workspace,
    sensor: Sensor,
    count: int,
    rng: np.random.Generator,
) -> Stations:
    """Return up to `count` stations before a plane at which every beam can read it safely.

    Raises
    ------
    InputError
        The sensor's range is not stated, or there is hardly a station.
    """
    require_range(sensor)
    at, name = belief.mean, belief.plane_names[plane]
    require_facing(f"plane {name}", workspace, at.directions, at.normals[plane])
    kept: list[Stations] = []
    drawn = found_so_far = tried_by_arm = 0
    while drawn < TRIES * count and found_so_far < count and tried_by_arm < ARM_TRIES * count:
        wanted = _round(count, drawn, found_so_far)
        tried = _drawn(belief, plane, workspace, sensor, wanted, rng)
        drawn += wanted
        tried = picked(tried, np.flatnonzero(inside(workspace, tried)))
        if not tried.plane.size:
            continue
        tried = picked(tried, np.flatnonzero(safe(outlook(belief, tried), sensor)))
        if workspace.robot is not None:
            tried = picked(tried, np.arange(min(len(tried.plane), count)))
            tried_by_arm += len(tried.plane)
        kept.append(picked(tried, np.flatnonzero(within_reach(belief, workspace, tried))))
        found_so_far += len(kept[-1].plane)
    found = joined(kept) if kept else None
    if found is None or len(found.plane) < LEAST_CANDIDATES:
        raise _nowhere(belief.plane_names[plane], workspace, tried_by_arm)
    return picked(found, np.arange(min(count, len(found.plane))))


def _round(count: int, drawn: int, found: int) -> int:
    """Return how many poses to draw next, from how many of those drawn were good so far."""
    if not drawn:
        return count
    missing = MORE_THAN_MISSING * (count - found) * drawn / max(found, 1)
    return int(np.clip(missing, 0.1 * count, min(max(MOST_AT_ONCE, count), TRIES * count - drawn)))


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


def _nowhere(plane: str, workspace: Workspace, tried_by_arm: int) -> InputError:
    """Return the refusal of a plane before which there is hardly a station."""
    if workspace.robot is not None and tried_by_arm >= LEAST_CANDIDATES:
        return InputError(
            f"no station before plane {plane} that the arm reaches without a collision, of "
            f"{tried_by_arm} that are safe for the sensor",
            "another place of the plate or of the arm's base, or a smaller clearance",
        )
    return InputError(
        f"no station before plane {plane} at which every beam reads it safely",
        "a workspace that reaches the sensor's range, or a calibration that is known better",
    )


def reachable(
    belief: Belief, workspace: Workspace, sensor: Sensor, count: int, rng: np.random.Generator
) -> Stations:
    """Return up to `count` safe stations before each plane; some planes may be out of reach.

    Raises
    ------
    InputError
        The sensor's range is not stated, or all planes are out of reach.
    """
    found, refusal = [], None
    for plane in range(len(belief.plane_names)):
        try:
            found.append(candidates(belief, plane, workspace, sensor, count, rng))
        except InputError as error:
            refusal = refusal or error
    if refusal is not None and not found:
        raise refusal
    return joined(found)


def require_range(sensor: Sensor) -> None:
    """Refuse a sensor whose range is not stated.

    Raises
    ------
    InputError
    """
    if not math.isfinite(sensor.range_max):
        raise InputError("no range of the sensor", "range_mm in the table [sensor] of the rig file")


def safe(ahead: Outlook, sensor: Sensor) -> BoolArray:
    """Tell at which stations (M,) all readings are within the sensor's limits, with a margin."""
    spread = MARGIN * ahead.reading_sigma
    near, far = ahead.reading - spread, ahead.reading + spread
    least = math.cos(min(sensor.max_incidence, STEEPEST))
    steep = ahead.cosine - MARGIN * ahead.cosine_sigma >= least
    return np.asarray((sensor.can_read(near) & sensor.can_read(far) & steep).all(axis=1))


def picked(stations: Stations, rows: IntArray) -> Stations:
    """Return some of the stations."""
    return Stations(stations.world_R_hand[rows], stations.world_t_hand[rows], stations.plane[rows])


def joined(parts: Sequence[Stations]) -> Stations:
    """Return stations one after the other."""
    return Stations(
        np.concatenate([one.world_R_hand for one in parts]),
        np.concatenate([one.world_t_hand for one in parts]),
        np.concatenate([one.plane for one in parts]),
    )


def _drawn(
    belief: Belief,
    plane: int,
    workspace: Workspace,
    sensor: Sensor,
    count: int,
    rng: np.random.Generator,
) -> Stations:
    """Return random stations of the workspace, moved along the normal until the beams can read."""
    axis = model.normalized(rng.standard_normal((count, 3)))
    # Stations that tell most turn far, and read near an end of the range.
    angle = workspace.largest_turn * rng.uniform(size=count) ** (1.0 / 9.0)
    R = workspace.home @ Rotation.from_rotvec(angle[:, None] * axis).as_matrix()
    t = rng.uniform(workspace.low, workspace.high, (count, 3))
    n, b = belief.mean.normals[plane], belief.mean.offsets[plane]
    n_hand = np.einsum("mji,j->mi", R, n)
    cosine = n_hand @ belief.mean.directions.T
    good = np.flatnonzero((cosine > math.cos(min(sensor.max_incidence, STEEPEST))).all(axis=1))
    R, t, n_hand, cosine = R[good], t[good], n_hand[good], cosine[good]
    s = -(n_hand @ belief.mean.locations.T + (t @ n + b)[:, None]) / cosine
    limits = np.array([sensor.range_min, sensor.range_max])
    k = belief.mean.range_errors
    low, high = (np.asarray(model.corrected(np.full(len(k), d), k)) for d in limits)
    # A step back by h along the normal lengthens the range of a beam by h over its cosine.
    nearest = ((low - s) * cosine).max(axis=1)
    farthest = ((high - s) * cosine).min(axis=1)
    fits = np.flatnonzero(farthest > nearest)
    share = rng.beta(ENDS, ENDS, size=len(fits))
    back = nearest[fits] + share * (farthest - nearest)[fits]
    return Stations(R[fits], t[fits] - back[:, None] * n, np.full(len(fits), plane))
