"""A plan: chosen stations in the order of the way, with what is expected there."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from .. import model
from ..arrays import FloatArray, IntArray
from ..data.station_list import StationList
from ..data.value import Value
from ..errors import InputError
from ..model.sensor import Sensor
from ..results.spot_error import radius
from ..validation.simulate import Stations
from .belief import BEAM, Belief
from .choice import Chosen, choose
from .drive import driven
from .goal import Forecast, Goal
from .information import outlook, told, updated
from .order import divided, shortest
from .plate import Plate
from .workspace import Workspace, picked, plates_of

VIA = "via"
"""Beginning of the names of stations on the way, at which nothing need be read."""


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Plan(Value):
    """Stations to measure next, in an order that shortens the way.

    Attributes
    ----------
    stations : StationList
        Those named "via 1", ... divide a step that is longer than the workspace allows, or lead around
        the plate; nothing need be read there. With an arm, they have its joints.
    ranges : (M, B)
        What every beam is expected to read [m]; NaN on the way.
    range_sigmas : (M, B)
        How far the reading may be off [m], noise included.
    forecast : Forecast
        If they were measured in the order in which they matter.
    reached : int or None
        How many of them reach the goal, in that order; None where all do not, or none is stated.
    plates : mapping by name
        Where the plate is to be put, for planes that are to be placed anew.
    safe : float or None
        Of a first motion: the part of mounts within the bounds at which all readings are within the
        sensor's limits.
    skipped : int
        Stations fewer than were chosen: the arm found no way to them, nor to others in their place.
    """

    stations: StationList
    ranges: FloatArray
    range_sigmas: FloatArray
    forecast: Forecast
    reached: int | None = None
    plates: Mapping[str, Plate] = field(default_factory=dict)
    safe: float | None = None
    skipped: int = 0

    def __len__(self) -> int:
        """Return how many stations are to be read."""
        return sum(not name.startswith(VIA) for name in self.stations.station_names)


@dataclass(frozen=True, slots=True)
class Task:
    """What is known, where the hand may go, what its beams can read, and what a plan is for.

    Attributes
    ----------
    belief : Belief
    workspace : Workspace
    sensor : Sensor
    goal : Goal
    taken : sequence of str
        Names of stations that there are already.
    """

    belief: Belief
    workspace: Workspace
    sensor: Sensor
    goal: Goal
    taken: Sequence[str] = ()

    @property
    def distance(self) -> float:
        """The working distance of forecasts [m]."""
        return self.goal.distance(self.sensor)

    @property
    def weight(self) -> FloatArray:
        """What is to become small (W, U)."""
        return goal_rows(self.belief, self.goal, self.distance)

    def chosen(
        self,
        rows: FloatArray,
        count: int,
        covariance: FloatArray | None = None,
        *,
        exchange: bool = False,
        start: IntArray | None = None,
    ) -> Chosen:
        """Choose among stations given by rows (K, N, B, U) at the belief and draws; see `choose`.

        Beside what the `covariance` (U, U) says, or the belief where it is not given.
        """
        known, weight = self.belief.covariance if covariance is None else covariance, self.weight
        criterion = self.goal.criterion
        return choose(rows, known, weight, count, criterion, exchange=exchange, start=start)

    def forecast(self, stations: Stations) -> Forecast:
        """Return what will be known after each of some stations, one after the other."""
        rows, order = told(self.belief, stations), np.arange(len(stations.plane))
        return forecast_of(self.belief, rows, order, self.distance)


def planned(
    task: Task,
    stations: Stations,
    *,
    ordered: bool = False,
    plates: Mapping[str, Plate] | None = None,
    safe: float | None = None,
) -> tuple[Plan, IntArray]:
    """Return a plan of stations, which matter in the order given, and which are in it, ascending.

    They are visited in another order, unless this one is to stay (`ordered`), with others between them
    where steps are long.
    """
    belief, count = task.belief, len(stations.plane)
    location, direction = task.goal.units
    order = np.arange(count) if ordered else shortest(stations, location / direction)
    ahead = outlook(belief, stations)
    listed, origin = _way(task, picked(stations, order))
    read = origin >= 0
    kept = order[origin[read]]
    if len(kept) < count and ordered:
        raise _no_way(count - len(kept), count)
    forecast = task.forecast(picked(stations, np.sort(kept)))
    expected = np.full((2, len(origin), belief.beams), math.nan)
    expected[:, read] = ahead.reading[kept], ahead.reading_sigma[kept]
    plan = Plan(
        listed,
        expected[0],
        expected[1],
        forecast,
        forecast.reaches(task.goal) if task.goal.stated else None,
        {} if plates is None else dict(plates),
        safe,
        count - len(kept),
    )
    return plan, np.sort(kept)


def _no_way(missing: int, of: int) -> InputError:
    found = f"no way of the arm to {missing} of {of} stations of a first motion"
    return InputError(found, "more room around the plate, or a smaller clearance")


def _way(task: Task, stations: Stations) -> tuple[StationList, IntArray]:
    """Return what is visited, and the index of each among the stations, -1 on the way."""
    belief, workspace = task.belief, task.workspace
    joints: FloatArray | None = None
    joint_names: tuple[str, ...] = ()
    if workspace.robot is None:
        way, origin = divided(stations, workspace.largest_step)
    else:
        joint_names = workspace.robot.joint_names
        way, origin, joints = driven(workspace.robot, stations, workspace, plates_of(belief))
    labels, names = tuple(belief.plane_names[p] for p in way.plane), _names(origin, task.taken)
    return StationList(
        way.world_R_hand, way.world_t_hand, labels, names, joints, joint_names
    ), origin


def forecast_of(belief: Belief, rows: FloatArray, chosen: IntArray, distance: float) -> Forecast:
    """Return what will be known after each of the chosen stations, given by their whitened rows."""
    C, found = belief.covariance, []
    for step in range(len(chosen) + 1):
        found.append((*beam_sigmas(belief, C), spot_radius(belief, C, distance)))
        if step < len(chosen):
            C = updated(C, rows[chosen[step]])
    location, direction, spot = np.array(found).T
    return Forecast(location, direction, spot, distance)


def beam_sigmas(belief: Belief, covariance: FloatArray) -> tuple[float, float]:
    """Return the largest sigmas over the beams of a coordinate [m] and along the tangent [rad]."""
    blocks = [
        covariance[np.ix_(at, at)] for at in (BEAM * i + np.arange(5) for i in range(belief.beams))
    ]
    location = max(float(np.sqrt(np.diagonal(C)[:3].max())) for C in blocks)
    direction = max(float(np.sqrt(np.linalg.eigvalsh(C[3:, 3:])[-1])) for C in blocks)
    return location, direction


def spot_radius(belief: Belief, covariance: FloatArray, distance: float) -> float:
    """Return the largest radius over the beams that holds the laser spot with 95 % [m]."""
    rows = spot_rows(belief, distance).reshape(belief.beams, 3, -1)
    return max(radius(one @ covariance @ one.T) for one in rows)


def goal_rows(belief: Belief, goal: Goal, distance: float) -> FloatArray:
    """Return what is to become small (W, U): the beams in units of the goal, or their spots [m]."""
    if goal.criterion == "spot":
        return spot_rows(belief, distance)
    unit = np.repeat(goal.units, (3, 2))
    rows = np.zeros((5 * belief.beams, len(belief.covariance)))
    for i in range(belief.beams):
        rows[5 * i + np.arange(5), BEAM * i + np.arange(5)] = 1.0 / unit
    return rows


def spot_rows(belief: Belief, distance: float) -> FloatArray:
    """Return derivatives (3 B, U) of the laser spots at a reading [m] by the unknowns."""
    d, rows = distance, np.zeros((3 * belief.beams, len(belief.covariance)))
    for i, (v, k) in enumerate(zip(belief.mean.directions, belief.mean.range_errors, strict=True)):
        s = float(model.corrected(np.array([d]), k[None])[0])
        spot = np.hstack((np.eye(3), s * belief.beam_bases[i], np.outer(v, [d, d * d])))
        rows[3 * i : 3 * i + 3, BEAM * i : BEAM * (i + 1)] = spot
    return rows


def _names(origin: IntArray, taken: Sequence[str]) -> tuple[str, ...]:
    """Return the numbers that follow those taken, and "via 1", ... on the way."""
    used, number, passed, names = set(taken), len(taken), 0, []
    for index in origin:
        name = ""
        while not name or name in used:
            if index < 0:
                passed += 1
                name = f"{VIA} {passed}"
            else:
                number += 1
                name = str(number)
        names.append(name)
    return tuple(names)
