"""Plan the next stations of a calibration."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from ..checks import require_count, require_kind
from ..model.sensor import Sensor
from ..results.calibration import Calibration
from ..results.mounts import Mounts
from ..validation.simulate import generator, plane_name
from .bounds import MOST_PLANNED, Placement, Plate
from .choice import updated
from .goal import Goal, goal_rows
from .information import station_rows
from .route import Plan, planned
from .task import Task, planning_task
from .workspace import Workspace

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
    rng = generator(rng)
    require_kind("sensor", sensor, Sensor)
    require_count("stations", stations, 1, MOST_PLANNED)
    if not isinstance(calibration, Mounts):
        require_kind("calibration", calibration, Calibration, "a Calibration, or Mounts")
    if workspace is not None:
        require_kind("workspace", workspace, Workspace)
    task = planning_task(calibration, sensor, workspace, goal or Goal(), plates)
    put: Mapping[str, Plate] = {}
    if placement is not None:
        put = _placed(task, placement, max(stations // placement.count, 1), rng)
        task = task._replace(belief=task.belief.before(put, only=True))
    pool = task.reachable(max(POOL // len(task.belief.plane_names), 2 * stations), rng)
    return planned(
        task, pool, task.known.enough(station_rows(task.belief, pool), stations), plates=put
    )


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
    taken, orientations = task.belief.plane_names, placement.orientations(task.belief.plates()[-1])
    names = [plane_name(index) for index in range(placement.count + len(taken))]
    put: dict[str, Plate] = {}
    for name in [name for name in names if name not in taken][: placement.count]:
        turned = {f"{name}, orientation {i}": plate for i, plate in enumerate(orientations, 1)}
        belief = task.belief.before(turned, only=True)
        task = task._replace(belief=belief)
        pool = task.reachable(POOL // 20, rng)  # for a choice among orientations
        rows, known, left = station_rows(belief, pool), {}, {}
        weight = goal_rows(task.goal, task.known.mounts)
        for plane in np.unique(pool.plane).tolist():
            mine = rows[pool.plane == plane]
            known[plane] = updated(belief.covariance, mine[task.known.chosen(mine, count)])
            left[plane] = float(np.trace(weight @ known[plane] @ weight.T))
        best = min(left, key=lambda plane: left[plane])
        put[name] = orientations[best]
        task = task._replace(belief=replace(belief, covariance=known[best]))
    return put
