"""Plan the next stations of a calibration, of beams before planes or of a survey."""

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial.transform import Rotation

from ..arrays import IntArray
from ..checks import require_count, require_kind
from ..errors import GrazingBeamError, InputError
from ..model.sensor_limits import Sensor
from ..results.calibration import Calibration
from ..results.mounts import Mounts
from ..validation.simulate import Stations, generator, plane_name
from .belief import COMPARED_DRAWS
from .bounds import MOST_PLANNED, Placement, Plate
from .choice import updated, value
from .goal import Goal
from .information import station_rows
from .route import Plan
from .task import Task, planning_task
from .workspace import Workspace, inside, joined, reached

if TYPE_CHECKING:
    from ..results.survey import SurveyCalibration

POOL = 1200
"""Candidates of all planes together: twice as many lower the criterion by about 2 %."""


def plan(
    calibration: "Calibration | Mounts | SurveyCalibration",
    stations: int,
    sensor: Sensor | None = None,
    workspace: Workspace | None = None,
    goal: Goal | None = None,
    *,
    plates: Mapping[str, Plate] | None = None,
    placement: Placement | None = None,
    rng: np.random.Generator | None = None,
) -> Plan:
    """Choose the stations that determine the mounts best, given what a calibration knows so far.

    They lie before the planes of the calibration, which stand where they stood, and before `plates`;
    with a `placement` before the last of these planes only, moved to the best orientations. Stations of
    a survey look at its planes and spheres as they were found, and first determine what its motion has
    left undetermined.

    Parameters
    ----------
    calibration : Calibration, Mounts or SurveyCalibration
        Mounts know no planes: `plates` says where there are some. A survey may be undetermined.
    stations : int
        At most; fewer where fewer reach what the goal states.
    sensor : Sensor
        Of beams before planes; sensors of a survey read as far as they did so far.
    workspace : Workspace, optional
        Around the stations so far, where not given.
    goal : Goal, optional
        Stations of a survey are chosen for spots, at the typical reading of each beam and sensor.
    plates : mapping of names to Plate, optional
        Of which nothing was read yet; for beams before planes.
    placement : Placement, optional
        For beams before planes.
    rng : numpy.random.Generator, optional

    Raises
    ------
    InputError
        No covariance, plane, workspace or sensor's range is known, or no station is safe; a survey of
        cones, one that does not fit, or arguments that are for beams before planes.
    """
    goal = Goal() if goal is None else goal
    rng = generator(rng)
    require_count("stations", stations, 1, MOST_PLANNED)
    if workspace is not None:
        require_kind("workspace", workspace, Workspace)
    if not isinstance(calibration, Calibration | Mounts):
        from ..results.survey import SurveyCalibration  # which plans of beams do not need
        from .survey import plan_survey

        expected = "a Calibration, a SurveyCalibration, or Mounts"
        require_kind("calibration", calibration, SurveyCalibration, expected)
        if sensor is not None or plates is not None or placement is not None:
            raise InputError(
                "a sensor, plates or a placement for a survey",
                "none of them: its stations go by the readings and targets that it has",
            )
        return plan_survey(calibration, stations, workspace, goal, rng)
    if sensor is None:
        raise InputError("no sensor for beams before planes", "the Sensor that states their range")
    require_kind("sensor", sensor, Sensor)
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
    aim = task.aim
    if goal.stated:  # how many are enough, before these are chosen with more care
        quick = aim.chosen(rows[:1], stations)
        stations = aim.enough(rows[0, quick])
    chosen = aim.chosen(rows, stations, exchange=True)
    best = _refined(task, pool[chosen], rng)
    best = best[np.arange(aim.enough(station_rows(belief, best)))]
    return task.planned(best, without(pool, chosen), plates=put)


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
            rows, aim = station_rows(belief, pool), trial.aim
            known = updated(belief.covariance, rows[aim.chosen(rows[None], count)])
            left = value(known, aim.weight, task.goal.criterion)
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
        near = near[inside(workspace, near)]
        try:
            near = near[task.safe(near)]
            near = near[reached(workspace, near, belief.plates())]
        except (GrazingBeamError, InputError):  # a move too far; the next round moves less
            continue
        pool = joined([stations, near])
        rows = station_rows(belief, pool)[None]
        stations = pool[task.aim.chosen(rows, count, exchange=True, start=np.arange(count))]
    return stations
