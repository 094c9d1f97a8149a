"""A plan: chosen stations in the order of the way, with what will be known after them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import count

import numpy as np

from ..arrays import BoolArray, FloatArray, IntArray
from ..data.station_list import StationList
from ..data.value import Value
from ..validation.simulate import Stations
from .bounds import Plate
from .goal import Aim, Forecast
from .way import divided, driven, shortest
from .workspace import Workspace

VIA = "via"
"""Beginning of the names of stations on the way, at which nothing need be read."""


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
    workspace: Workspace,
    candidates: Stations,
    rows: FloatArray,
    *,
    chosen: IntArray,
    labels: Sequence[str],
    plates: Sequence[Plate | None],
    taken: Sequence[str] = (),
    length: float | None = None,
) -> tuple[Plan, IntArray]:
    """Return a plan of chosen candidates, with a way to them.

    Where the arm finds no way to some, the best others beside those that it reaches take their places,
    as long as there are others. The choice with the most stations wins.

    Parameters
    ----------
    aim, workspace
    candidates : Stations
        All of them, N.
    rows : (N, B, U)
        Their whitened rows.
    chosen : (C,)
        Indices of candidates, in the order in which they matter.
    labels, plates, taken, length
        As `visited` has them.

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
        stations, origin = visited(
            workspace, candidates[some], labels=labels, plates=plates, taken=taken, length=length
        )
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
