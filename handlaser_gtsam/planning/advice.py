"""The next best stations of a calibration, found at once: the last word of a verdict."""

from collections.abc import Iterator
from itertools import accumulate, chain

import numpy as np
from scipy.spatial.transform import Rotation

from ..data.noise import Noise
from ..data.recording import Recording
from ..data.station_list import StationList
from ..errors import HandlaserError
from ..model.sensor_limits import Sensor
from ..quantities import IN_MM
from ..results.calibration import Calibration
from ..results.lines import wrapped
from .belief import station_rows
from .blind import completing_motion
from .bounds import Bounds
from .goal import Goal
from .plan import POOL, planning_task, without
from .route import Plan
from .workspace import Workspace

ADVISED_BEAMS = 16
"""With more beams, a plan takes longer than a word of advice may."""


def next_stations(
    calibration: Calibration,
    sensor: Sensor,
    workspace: Workspace | None = None,
    goal: Goal | None = None,
) -> Plan | None:
    """Return a plan of the next few stations; None where there is no basis for one.

    Chosen greedily from few candidates at the estimate itself: `plan` does better, and takes longer.
    """
    if calibration.recording is None or len(calibration.beams) > ADVISED_BEAMS:
        return None
    try:
        task = planning_task(calibration, sensor, workspace, Goal() if goal is None else goal)
        share = POOL // 5 // len(task.belief.plane_names)  # so that nobody waits
        pool = task.reachable(share, np.random.default_rng(0))
        # Stations that are named: more are a plan.
        chosen = task.aim.chosen(station_rows(task.belief, pool)[None], 3)
        return task.planned(pool[chosen], without(pool, chosen))
    except HandlaserError:
        return None


def missing_stations(
    recording: Recording,
    bounds: Bounds | None,
    sensor: Sensor,
    workspace: Workspace | None = None,
    noise: Noise | None = None,
    goal: Goal | None = None,
) -> Plan | None:
    """Return a plan of the stations that an undetermined recording lacks; None without a basis."""
    if bounds is None or len(bounds.locations) > ADVISED_BEAMS:
        return None
    try:
        return completing_motion(bounds, sensor, recording, workspace, noise, goal)
    except HandlaserError:
        return None


def advice_lines(plan: Plan) -> list[str]:
    """Return the next best stations in words, one a line."""
    stations, number = plan.stations, len(plan)
    lines = [
        f"next best stations, hand poses world_T_hand; after these {number}: "
        f"{plan.forecast.words(number)} (now {plan.forecast.words(0)})"
        + "".join(f"; {words}" for words in plan.assumed)
    ]
    named = zip(stations.plane_labels, pose_words(stations), plan.read, strict=True)
    return [*lines, *(f"  before plane {plane}: {pose}" for plane, pose, one in named if one)]


def pose_words(stations: StationList) -> Iterator[str]:
    """Yield the hand pose world_T_hand of each station in words [mm; unit quaternion]."""
    quaternions = Rotation.from_matrix(stations.world_R_hand).as_quat(canonical=True)
    for position, quaternion in zip(stations.world_t_hand * IN_MM, quaternions, strict=True):
        t = ", ".join(f"{value:.1f}" for value in position)
        q = ", ".join(f"{value:.4f}" for value in quaternion)
        yield f"({t}) mm, qx qy qz qw ({q})"


def advice_within(plan: Plan, most: int, width: int) -> list[str]:
    """Return the same in at most `most` lines of a screen; stations without room are counted.

    What is said before them is always there.
    """
    head, *stations = [wrapped(line, None, width) for line in advice_lines(plan)]
    ends = list(accumulate(map(len, stations), initial=len(head)))
    if ends[-1] <= most:
        return [*head, *chain(*stations)]
    number = sum(end < most for end in ends[1:])  # one line says how many more there are
    more = f"  and {len(stations) - number} more: --verbose"
    return [*head, *chain(*stations[:number]), more]
