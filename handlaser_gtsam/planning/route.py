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
from ..errors import InputError
from ..validation.simulate import Stations
from .bounds import Plate
from .goal import Forecast
from .information import outlook, station_rows, updated
from .task import Task
from .way import divided, driven, shortest
from .workspace import Workspace, joined

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
    rows: FloatArray,
    chosen: IntArray,
    choose: Callable[[IntArray, int, IntArray], IntArray],
    way: Callable[[IntArray], Visit],
) -> tuple[IntArray, Visit]:
    """Return chosen candidates with a way to them, in the order in which they matter.

    Where the arm finds no way to some, the best others beside those that it reaches take their places,
    as long as there are others. The choice with the most stations wins.

    Parameters
    ----------
    rows : (N, B, U)
        Whitened rows of all candidates.
    chosen : (M,)
    choose : callable
        Takes candidates, how many to choose, and those that are chosen already.
    way : callable
        Takes candidates.
    """
    nothing, others = chosen[:0], np.setdiff1d(np.arange(len(rows)), chosen)
    tried, visit = chosen, way(chosen)
    best = tried[np.sort(visit.kept)], visit
    for _ in range(5):  # most plans need one or two, before fewer stations have to do
        reached = tried[np.sort(visit.kept)]
        missing = len(chosen) - len(reached)
        if not missing or len(others) < missing:
            break
        more = choose(others, missing, reached)
        others = np.setdiff1d(others, more)
        tried = choose(np.concatenate((reached, more)), len(chosen), nothing)
        visit = way(tried)
        if len(visit.kept) > len(best[0]):
            best = tried[np.sort(visit.kept)], visit
    return best


def planned(
    task: Task,
    stations: Stations,
    spare: Stations | None = None,
    *,
    ordered: bool = False,
    plates: Mapping[str, Plate] | None = None,
    safe: float | None = None,
) -> Plan:
    """Return a plan of stations, which matter in the order given, or of `spare` ones instead.

    They are visited in another order, unless this one is to stay (`ordered`), with others between them
    where steps are long.

    Raises
    ------
    InputError
        The arm finds no way to any station, or not to all that are ordered.
    """
    belief, workspace = task.belief, task.workspace
    location, direction = task.goal.units
    pool, names, before = stations, belief.plane_names, belief.plates()
    if spare is not None and workspace.robot is not None:
        pool = joined([stations, spare])
    rows, C = station_rows(belief, pool), belief.covariance

    def choose(some: IntArray, number: int, beside: IntArray) -> IntArray:
        return some[task.chosen(rows[None, some], number, updated(C, rows[beside]))]

    def way(some: IntArray) -> Visit:
        length = None if ordered else location / direction
        return visited(workspace, pool[some], names, before, task.taken, length)

    every = np.arange(len(stations))
    chosen, visit = with_ways(rows, every, choose, way)
    skipped = len(stations) - len(chosen)
    if skipped and ordered:
        raise InputError(
            f"no way of the arm to {skipped} of {len(stations)} stations of a first motion",
            "more room around the plate, or a smaller clearance",
        )
    ranges, sigmas = (np.full((len(visit.read), belief.beams), math.nan) for _ in range(2))
    in_order = chosen[np.argsort(np.argsort(visit.kept))]
    ranges[visit.read], sigmas[visit.read], _, _ = outlook(belief, pool[in_order])
    forecast = task.forecast(rows[chosen])
    reached = forecast.reaches(task.goal) if task.goal.stated else None
    put = {} if plates is None else dict(plates)
    at = visit.stations
    return Plan(at, ranges, sigmas, forecast, reached, put, safe, skipped, belief.uncounted)
