"""Plan the next stations of a calibration."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from ..arrays import IntArray
from ..checks import require_count, require_kind
from ..errors import GrazingBeamError, InputError
from ..model.sensor import Sensor
from ..results.calibration import Calibration
from ..results.mounts import Mounts
from ..validation.simulate import Stations, generator, plane_name
from .belief import COMPARED_DRAWS
from .bounds import MOST_PLANNED, Placement, Plate
from .choice import value
from .goal import Goal
from .information import station_rows, updated
from .route import Plan, planned
from .task import Task, planning_task
from .workspace import Workspace, joined

POOL = 1200
"""Candidates of all planes together: twice as many lower the criterion by about 2 %."""


def plan(
    calibration: Calibration | Mounts,
    stations: int,
    sensor: Sensor,
    workspace: Workspace | None = None,
    goal: Goal | None = None,
    *,
    plates: Mapping[str, Plate] | None = None,
    placement: Placement | None = None,
    rng: np.random.Generator | None = None,
) -> Plan:
    """Choose the stations that determine the beams best, given what a calibration knows so far.

    They lie before the planes of the calibration, which stand where they stood, and before `plates`;
    with a `placement` before the last of these planes only, moved to the best orientations.

    Parameters
    ----------
    calibration : Calibration or Mounts
        Mounts know no planes: `plates` says where there are some.
    stations : int
        At most; fewer where fewer reach what the goal states.
    sensor : Sensor
    workspace : Workspace, optional
        Around the stations so far, where not given.
    goal : Goal, optional
    plates : mapping of names to Plate, optional
        Of which nothing was read yet.
    placement : Placement, optional
    rng : numpy.random.Generator, optional

    Raises
    ------
    InputError
        No covariance, plane, workspace or sensor's range is known, or no station is safe.
    """
    goal = Goal() if goal is None else goal
    rng = generator(rng)
    require_kind("sensor", sensor, Sensor)
    require_count("stations", stations, 1, MOST_PLANNED)
    if not isinstance(calibration, Mounts):
        require_kind("calibration", calibration, Calibration, "a Calibration, or Mounts")
    if workspace is not None:
        require_kind("workspace", workspace, Workspace)
    task = planning_task(calibration, sensor, workspace, goal, plates)
    put: Mapping[str, Plate] = {}
    if placement is not None:
        put = _placed(task, placement, max(stations // placement.count, 1), rng)
        task = task._replace(belief=task.belief.before(put, only=True))
    belief = task.belief
    pool = task.reachable(max(POOL // len(belief.plane_names), 2 * stations), rng)
    each = [station_rows(belief, pool)]
    for _ in range(COMPARED_DRAWS):
        try:
            each.append(station_rows(belief.about(belief.draw(rng)), pool))
        except (GrazingBeamError, InputError):  # so wide a posterior has draws that read nothing
            continue
    rows = np.stack(each)
    if goal.stated:  # how many are enough, before these are chosen with more care
        quick = task.chosen(rows[:1], stations)
        enough = task.forecast(rows[0, quick]).reaches(goal)
        stations = stations if enough is None else max(enough, 1)
    chosen = task.chosen(rows, stations, exchange=True)
    best = _refined(task, pool[chosen], rng)
    if goal.stated:
        enough = task.forecast(station_rows(belief, best)).reaches(goal)
        best = best if enough is None else best[np.arange(max(enough, 1))]
    return planned(task, best, without(pool, chosen), plates=put)


def without(pool: Stations, chosen: IntArray) -> Stations:
    """Return the stations that were not chosen."""
    return pool[np.setdiff1d(np.arange(len(pool)), chosen)]


def _placed(
    task: Task, placement: Placement, count: int, rng: np.random.Generator
) -> Mapping[str, Plate]:
    """Return where to put the last plate, time after time, with a number of stations before each.

    Each orientation is the best beside those before.

    Raises
    ------
    InputError
        No orientation lets the beams read it.
    """
    taken, last = task.belief.plane_names, task.belief.plates()[-1]
    names = [plane_name(index) for index in range(placement.count + len(taken))]
    put: dict[str, Plate] = {}
    for name in [name for name in names if name not in taken][: placement.count]:
        best = np.inf
        before = task.belief
        for plate in placement.orientations(last):
            belief = before.before({name: plate})
            plane, trial = len(belief.plane_names) - 1, task._replace(belief=belief)
            try:
                pool = trial.candidates(plane, POOL // 20, rng)
            except InputError:
                continue
            rows = station_rows(belief, pool)
            known = updated(belief.covariance, rows[trial.chosen(rows[None], count)])
            left = value(known, trial.weight, task.goal.criterion)
            if left < best:
                best, put[name] = left, plate
                after = replace(belief, covariance=known)
        if name not in put:
            raise InputError(
                "no orientation of the plate in which every beam reads it safely",
                "a workspace that reaches the sensor's range, or beams that are known better",
            )
        task = task._replace(belief=after)
    return put


def _refined(task: Task, stations: Stations, rng: np.random.Generator) -> Stations:
    """Return as many stations near the given ones, or they themselves, that say more at the mean.

    What lies between the candidates that were drawn is tried.
    """
    belief, workspace, sensor = task.belief, task.workspace, task.sensor
    count, span = len(stations), sensor.range_max - sensor.range_min
    # Sizes of the moves by which chosen stations are refined, as parts of the largest turn and of
    # the sensor's range: about as far as candidates are apart, and then as those are.
    for size in (0.4, 0.15):
        # Moved copies of every station in each of these rounds: a few to either side of each
        # coordinate.
        near = stations[np.repeat(np.arange(count), 24)]
        turn = size * workspace.largest_turn * rng.standard_normal((len(near), 3))
        step = size * span * rng.standard_normal((len(near), 3))
        near = Stations(
            near.world_R_hand @ Rotation.from_rotvec(0.5 * turn).as_matrix(),
            near.world_t_hand + 0.5 * step,
            near.plane,
        )
        try:
            near = task.safe_and_reached(near)
        except (GrazingBeamError, InputError):  # a move too far; the next round moves less
            continue
        pool = joined([stations, near])
        rows = station_rows(belief, pool)[None]
        stations = pool[task.chosen(rows, count, exchange=True, start=np.arange(count))]
    return stations
