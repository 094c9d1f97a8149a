"""Plan the next stations of a calibration."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from ..arrays import FloatArray
from ..checks import require_count, require_kind
from ..errors import GrazingBeamError, InputError
from ..model.sensor import Sensor
from ..results.calibration import Calibration
from ..results.mounts import Mounts
from ..validation.simulate import Stations
from .belief import Belief, belief_of
from .choice import choose
from .goal import Goal
from .information import told
from .plate import Placement, Plate, standing
from .refine import refined
from .replacing import planned_with_spare
from .route import Plan, forecast_of, goal_rows
from .turning import placed
from .workspace import Workspace, picked, reachable, workspace_of

POOL = 1200
"""Candidates of all planes together: twice as many lower the criterion by about 2 %."""
MOST_STATIONS = 1000
DRAWS = 4
"""Draws of the belief over which the gain is averaged beside its mean."""


@dataclass(frozen=True, slots=True)
class _Task:
    """What is known, where the hand may go, and the names of the stations so far."""

    belief: Belief
    workspace: Workspace
    taken: tuple[str, ...]


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
    with a `placement` before the last of these planes only, put anew as tells most.

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
    rng = np.random.default_rng(0) if rng is None else rng
    require_kind("sensor", sensor, Sensor)
    require_count("stations to plan", stations, 1, MOST_STATIONS)
    task = _task(calibration, workspace, plates)
    put = _placements(task, placement, sensor, goal, stations, rng)
    if put:
        task = replace(task, belief=task.belief.before(put, only=True))
    return _best(task, sensor, goal, stations, put, rng)


def _best(
    task: _Task,
    sensor: Sensor,
    goal: Goal,
    stations: int,
    put: Mapping[str, Plate],
    rng: np.random.Generator,
) -> Plan:
    """Return the plan of the best stations before all planes of a belief."""
    belief, distance = task.belief, goal.distance(sensor)
    pool, rows = _pool(task, sensor, stations, rng)
    weight = goal_rows(belief, goal, distance)
    count = stations
    if goal.stated:  # how many are enough, before these are chosen with more care
        quick = choose(
            rows[:1], belief.covariance, weight, stations, goal.criterion, exchange=False
        ).candidates
        enough = forecast_of(belief, rows[0], quick, distance).reaches(goal)
        count = stations if enough is None else max(enough, 1)
    chosen = choose(rows, belief.covariance, weight, count, goal.criterion).candidates
    found = refined(belief, picked(pool, chosen), weight, goal, task.workspace, sensor, rng)
    if goal.stated:
        every = np.arange(count)
        enough = forecast_of(belief, told(belief, found), every, distance).reaches(goal)
        found = found if enough is None else picked(found, every[: max(enough, 1)])
    spare = picked(pool, np.setdiff1d(np.arange(len(pool.plane)), chosen))
    return planned_with_spare(
        belief, found, spare, weight, goal, task.workspace, distance, task.taken, plates=put
    )


def _task(
    calibration: Calibration | Mounts,
    workspace: Workspace | None,
    plates: Mapping[str, Plate] | None,
) -> _Task:
    if not isinstance(calibration, Mounts):
        require_kind("calibration", calibration, Calibration, "a Calibration, or Mounts")
    if workspace is not None:
        require_kind("workspace", workspace, Workspace)
    recording = calibration.recording if isinstance(calibration, Calibration) else None
    if workspace is None:
        if recording is None:
            raise InputError(
                "no recording that shows the workspace", "a workspace: [workspace] in a rig file"
            )
        workspace = workspace_of(recording)
    belief = belief_of(calibration)
    if plates is not None:
        belief = belief.before(plates)
    if not belief.plane_names:
        raise InputError("no plane to plan stations before", "where a plate stands roughly")
    return _Task(belief, workspace, () if recording is None else recording.station_names)


def _placements(
    task: _Task,
    placement: Placement | None,
    sensor: Sensor,
    goal: Goal,
    stations: int,
    rng: np.random.Generator,
) -> Mapping[str, Plate]:
    """Return where the last plate is to be put; nothing where it is not."""
    if placement is None:
        return {}
    last = len(task.belief.plane_names) - 1
    plate = standing(task.belief.mean, last, task.belief.origins[last])
    share = max(stations // placement.count, 1)
    return placed(task.belief, plate, placement, task.workspace, sensor, goal, share, rng)


def _pool(
    task: _Task, sensor: Sensor, count: int, rng: np.random.Generator
) -> tuple[Stations, FloatArray]:
    """Return the candidates before all planes, and their rows at the mean and at draws."""
    belief = task.belief
    share = max(POOL // len(belief.plane_names), 2 * count)
    pool = reachable(belief, task.workspace, sensor, share, rng)
    rows = [told(belief, pool)]
    for _ in range(DRAWS):
        try:
            rows.append(told(belief.about(belief.draw(rng)), pool))
        except (GrazingBeamError, InputError):  # so wide a posterior has draws that read nothing
            continue
    return pool, np.stack(rows)
