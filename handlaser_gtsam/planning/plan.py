"""Plan the next stations of a calibration."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from ..arrays import FloatArray
from ..checks import require_count, require_kind
from ..errors import GrazingBeamError, InputError
from ..model.sensor import Sensor
from ..results.calibration import Calibration
from ..results.mounts import Mounts
from ..validation.simulate import Stations
from .goal import Goal
from .information import judged, told
from .plate import Placement, Plate, standing
from .refine import refined
from .replacing import planned_with_spare
from .route import Plan, Task, forecast_of
from .turning import placed
from .workspace import Workspace, picked, reachable, workspace_of

POOL = 1200
"""Candidates of all planes together: twice as many lower the criterion by about 2 %."""
MOST_STATIONS = 1000
"""Nobody drives to more of them: a larger number is a slip."""
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
    require_count("stations", stations, 1, MOST_STATIONS)
    task = _task(calibration, workspace, plates, sensor, goal)
    put = {} if placement is None else _placed(task, placement, stations, rng)
    if put:
        task = replace(task, belief=task.belief.before(put, only=True))
    return _best(task, stations, put, rng)


def _best(task: Task, stations: int, put: Mapping[str, Plate], rng: np.random.Generator) -> Plan:
    """Return the plan of the best stations before all planes of a belief."""
    pool, rows = _pool(task, stations, rng)
    count, goal = stations, task.goal
    if goal.stated:  # how many are enough, before these are chosen with more care
        quick = task.chosen(rows[:1], stations).candidates
        enough = forecast_of(task.belief, rows[0], quick, task.distance).reaches(goal)
        count = stations if enough is None else max(enough, 1)
    chosen = task.chosen(rows, count, exchange=True).candidates
    found = refined(task, picked(pool, chosen), rng)
    if goal.stated:
        enough = task.forecast(found).reaches(goal)
        found = found if enough is None else picked(found, np.arange(max(enough, 1)))
    spare = picked(pool, np.setdiff1d(np.arange(len(pool.plane)), chosen))
    return planned_with_spare(task, found, spare, put)


def _task(
    calibration: Calibration | Mounts,
    workspace: Workspace | None,
    plates: Mapping[str, Plate] | None,
    sensor: Sensor,
    goal: Goal,
) -> Task:
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
    belief = judged(calibration, goal, sensor)
    if plates is not None:
        belief = belief.before(plates)
    if not belief.plane_names:
        raise InputError("no plane to plan stations before", "where a plate stands roughly")
    taken = () if recording is None else recording.station_names
    return Task(belief, workspace, sensor, goal, taken)


def _placed(
    task: Task, placement: Placement, stations: int, rng: np.random.Generator
) -> Mapping[str, Plate]:
    """Return where the last plate is to be put."""
    last = len(task.belief.plane_names) - 1
    plate = standing(task.belief.mean, last, task.belief.origins[last])
    return placed(task, plate, placement, max(stations // placement.count, 1), rng)


def _pool(task: Task, count: int, rng: np.random.Generator) -> tuple[Stations, FloatArray]:
    """Return the candidates before all planes, and their rows at the mean and at draws."""
    belief = task.belief
    share = max(POOL // len(belief.plane_names), 2 * count)
    pool = reachable(belief, task.workspace, task.sensor, share, rng)
    rows = [told(belief, pool)]
    for _ in range(DRAWS):
        try:
            rows.append(told(belief.about(belief.draw(rng)), pool))
        except (GrazingBeamError, InputError):  # so wide a posterior has draws that read nothing
            continue
    return pool, np.stack(rows)
