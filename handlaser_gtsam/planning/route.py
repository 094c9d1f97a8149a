"""A plan: chosen stations in the order of the way, with what is expected there."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import count

import numpy as np

from ..arrays import FloatArray, IntArray
from ..data.station_list import StationList
from ..data.value import Value
from ..errors import InputError
from ..validation.simulate import Stations
from .bounds import Plate
from .goal import Forecast
from .information import outlook, station_rows
from .task import Task
from .way import divided, driven, shortest

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
    belief, robot = task.belief, task.workspace.robot
    location, direction = task.goal.units
    order = np.arange(len(stations))
    if not ordered:
        order = shortest(stations, location / direction)
    reading, reading_sigma, _, _ = outlook(belief, stations)
    joints: FloatArray | None = None
    if robot is None:
        way, origin = divided(stations[order], task.workspace.largest_step)
    else:
        way, origin, joints = driven(robot, stations[order], task.workspace, belief.plates())
    read = origin >= 0
    kept = order[origin[read]]
    skipped = len(stations) - len(kept)
    if skipped and ordered:
        raise InputError(
            f"no way of the arm to {skipped} of {len(stations)} stations of a first motion",
            "more room around the plate, or a smaller clearance",
        )
    numbers = (str(i) for i in count(len(task.taken) + 1) if str(i) not in task.taken)
    passed = (f"{VIA} {i}" for i in count(1) if f"{VIA} {i}" not in task.taken)
    listed = StationList(
        way.world_R_hand,
        way.world_t_hand,
        tuple(belief.plane_names[plane] for plane in way.plane),
        tuple(next(numbers if is_read else passed) for is_read in read),
        joints,
        () if robot is None else robot.joint_names,
    )
    ranges, sigmas = (np.full((len(way), belief.beams), math.nan) for _ in range(2))
    ranges[read], sigmas[read] = reading[kept], reading_sigma[kept]
    forecast = task.forecast(station_rows(belief, stations[np.sort(kept)]))
    reached = forecast.reaches(task.goal) if task.goal.stated else None
    put = {} if plates is None else dict(plates)
    plan = Plan(listed, ranges, sigmas, forecast, reached, put, safe, skipped, belief.uncounted)
    return plan, np.sort(kept)
