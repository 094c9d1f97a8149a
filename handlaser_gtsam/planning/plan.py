"""Plan the next stations of a calibration."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ..arrays import FloatArray
from ..checks import require_count, require_kind
from ..errors import InputError
from ..model.sensor import Sensor
from ..results.calibration import Calibration
from ..results.mounts import Mounts
from ..simulation.simulate import Stations
from .belief import Belief, belief_of
from .choice import choose
from .goal import Goal
from .information import outlook
from .plate import Placement, Plate, standing
from .route import Plan, forecast_of, goal_rows, planned
from .turning import placed
from .workspace import Workspace, candidates, joined, picked, workspace_of

POOL = 1200
"""Candidates of all planes together: twice as many lower the criterion by about 2 %."""
MOST_STATIONS = 1000
DRAWS = 4
"""Draws of the belief over which the gain is averaged beside its mean."""


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

    They lie before the planes of the calibration, which stand where they stood. With `plates` or a
    `placement` these are gone, and the stations lie before the plates, or before the placements of the
    plate in the orientations that tell most; the plate to be turned is the last one.

    Parameters
    ----------
    calibration : Calibration or Mounts
        So far, with a covariance. Mounts know no planes: `plates` says where there are some.
    stations : int
        How many at most; fewer where fewer reach what the goal states.
    sensor : Sensor
        Its range is needed.
    workspace : Workspace, optional
        Around the stations so far, where not given.
    goal : Goal, optional
    plates : mapping of names to Plate, optional
    placement : Placement, optional
    rng : numpy.random.Generator, optional
        Draws the candidates; a fixed one where not given.

    Raises
    ------
    InputError
        The calibration has no covariance, it is not known where a plane or the workspace is, the
        sensor's range is not stated, or no station is safe.
    """
    goal = Goal() if goal is None else goal
    rng = np.random.default_rng(0) if rng is None else rng
    require_kind("sensor", sensor, Sensor)
    require_count("stations to plan", stations, 1, MOST_STATIONS)
    task = _task(calibration, sensor, workspace)
    put: Mapping[str, Plate] = {}
    if plates is not None:
        task = _Task(task.belief.before(plates, only=True), task.workspace, task.taken)
    if not task.belief.plane_names:
        raise InputError("no plane to plan stations before", "where a plate stands roughly")
    if placement is not None:
        put = _placements(task, placement, sensor, goal, stations, rng)
        task = _Task(task.belief.before(put, only=True), task.workspace, task.taken)
    pool, rows = _pool(task, sensor, stations, rng)
    weight = goal_rows(task.belief, goal, goal.distance(sensor))
    chosen = choose(rows, task.belief.covariance, weight, stations, goal.criterion).candidates
    forecast = forecast_of(task.belief, rows[0], chosen, goal.distance(sensor))
    enough = forecast.reaches(goal) if goal.stated else None
    if enough is not None:
        chosen = chosen[: max(enough, 1)]
        forecast = forecast_of(task.belief, rows[0], chosen, goal.distance(sensor))
    return planned(
        task.belief,
        picked(pool, chosen),
        goal,
        task.workspace,
        forecast,
        task.taken,
        plates=put or plates,
    )


@dataclass(frozen=True, slots=True)
class _Task:
    """What is known, where the hand may go, and the names of the stations so far."""

    belief: Belief
    workspace: Workspace
    taken: tuple[str, ...]


def _task(
    calibration: Calibration | Mounts, sensor: Sensor, workspace: Workspace | None
) -> _Task:
    recording = calibration.recording if isinstance(calibration, Calibration) else None
    if workspace is None:
        if recording is None:
            raise InputError("no recording that shows the workspace", "a workspace")
        workspace = workspace_of(recording)
    belief = belief_of(calibration)
    return _Task(belief, workspace, () if recording is None else recording.station_names)


def _placements(
    task: _Task,
    placement: Placement,
    sensor: Sensor,
    goal: Goal,
    stations: int,
    rng: np.random.Generator,
) -> Mapping[str, Plate]:
    last = len(task.belief.plane_names) - 1
    plate = standing(task.belief.mean, last, task.belief.origins[last])
    share = max(stations // placement.count, 1)
    return placed(task.belief, plate, placement, task.workspace, sensor, goal, share, rng)


def _pool(
    task: _Task, sensor: Sensor, count: int, rng: np.random.Generator
) -> tuple[Stations, FloatArray]:
    """Return the candidates before all planes, and their rows at the mean and at draws."""
    belief = task.belief
    planes = range(len(belief.plane_names))
    share = max(POOL // len(planes), 2 * count)
    pool = joined([candidates(belief, p, task.workspace, sensor, share, rng)[0] for p in planes])
    drawn = [belief, *(belief.about(belief.draw(rng)) for _ in range(DRAWS))]
    return pool, np.stack([outlook(one, pool).rows for one in drawn])
