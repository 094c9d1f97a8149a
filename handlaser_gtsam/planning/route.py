"""A plan: chosen stations in the order of the way, with what is expected there."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import count
from typing import NamedTuple

import numpy as np

from ..arrays import BoolArray, FloatArray, IntArray
from ..data.station_list import StationList
from ..data.value import Value
from ..validation.simulate import Stations
from .bounds import Plate
from .choice import Known, updated
from .goal import Forecast
from .information import outlook, station_rows
from .task import Task
from .way import divided, driven, shortest
from .workspace import Workspace

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
        Where the plate is to be put, for planes that are to be moved.
    safe : float or None
        Of a first motion: the part of mounts within the bounds at which all readings are within the
        sensor's limits.
    skipped : int
        Stations fewer than were chosen: the arm found no way to them, nor to others in their place.
    uncounted : tuple of str
        Codes of errors that were free in the calibration, of which the stations are taken to have none.
    """

    stations: StationList
    ranges: FloatArray
    range_sigmas: FloatArray
    forecast: Forecast
    reached: int | None = None
    plates: Mapping[str, Plate] = field(default_factory=dict)
    safe: float | None = None
    skipped: int = 0
    uncounted: tuple[str, ...] = ()

    @property
    def assumed(self) -> tuple[str, ...]:
        """What it takes for granted of freed errors, in words, a sentence each."""
        if not self.uncounted:
            return ()
        words = ", ".join(self.uncounted)
        return (
            f"the stations are taken to be without the freed errors {words}: let there be none",
        )

    def __len__(self) -> int:
        """Return how many stations are to be read."""
        return sum(not name.startswith(VIA) for name in self.stations.station_names)


class Visit(NamedTuple):
    """Stations in the order in which they are visited.

    Attributes
    ----------
    stations : StationList
        With others on the way, which are named `VIA`.
    read : (M,) of bool
        Which of them are to be read.
    kept : indices
        Which of the chosen stations these are, in this order: the arm found a way to them.
    """

    stations: StationList
    read: BoolArray
    kept: IntArray


def visited(
    workspace: Workspace,
    stations: Stations,
    labels: Sequence[str],
    plates: Sequence[Plate | None],
    taken: Sequence[str] = (),
    length: float | None = None,
) -> Visit:
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
    return Visit(listed, read, order[origin[read]])


def with_ways(
    rows: FloatArray, known: Known, chosen: IntArray, way: Callable[[IntArray], Visit]
) -> tuple[IntArray, Visit]:
    """Return chosen candidates with a way to them, in the order in which they matter.

    Where the arm finds no way to some, the best others beside those that it reaches take their places,
    as long as there are others. The choice with the most stations wins.

    Parameters
    ----------
    rows : (N, B, U)
        Whitened rows of all candidates.
    known : Known
    chosen : (M,)
    way : callable
        Takes candidates.
    """
    others, tried, best = np.arange(len(rows)), chosen, None
    for _ in range(6):  # most plans need one or two, before fewer stations have to do
        visit = way(tried)
        found = tried[np.sort(visit.kept)]
        if best is None or len(found) > len(best[0]):
            best = found, visit
        others, missing = np.setdiff1d(others, tried), len(chosen) - len(found)
        if not missing or len(others) < missing:
            break
        beside = known._replace(covariance=updated(known.covariance, rows[found]))
        tried = np.concatenate((found, others[beside.chosen(rows[others], missing)]))
    assert best is not None
    return best


def planned(
    task: Task,
    pool: Stations,
    chosen: IntArray,
    *,
    plates: Mapping[str, Plate] | None = None,
    safe: float | None = None,
) -> Plan:
    """Return a plan of chosen stations, which matter in the order given, or of others of the pool.

    They are visited in another order, with others between them where steps are long.

    Raises
    ------
    InputError
        The arm finds no way to any station.
    """
    belief, workspace, known = task.belief, task.workspace, task.known
    location, direction = task.goal.units
    rows, before = station_rows(belief, pool), belief.plates()

    def way(some: IntArray) -> Visit:
        where, length = pool[some], location / direction
        return visited(workspace, where, belief.plane_names, before, task.taken, length)

    found, visit = with_ways(rows, known, chosen, way)
    ranges, sigmas = (np.full((len(visit.read), belief.beams), math.nan) for _ in range(2))
    in_order = found[np.argsort(np.argsort(visit.kept))]
    ranges[visit.read], sigmas[visit.read], _, _ = outlook(belief, pool[in_order])
    forecast = known.forecast(rows[found])
    return Plan(
        visit.stations,
        ranges,
        sigmas,
        forecast,
        forecast.reaches(task.goal),
        dict(plates or {}),
        safe,
        len(chosen) - len(found),
        belief.uncounted,
    )
