"""Chosen stations moved a little for better ones: what lies between the candidates that were drawn."""

import numpy as np
from scipy.spatial.transform import Rotation

from ..errors import GrazingBeamError, InputError
from ..validation.simulate import Stations
from .information import outlook, told
from .route import Task
from .workspace import inside, joined, picked, safe, within_reach

ROUNDS = (0.4, 0.15)
"""Moves of each round, as parts of the largest turn and of the sensor's range."""
NEIGHBOURS = 24
"""Moved copies of every station a round."""


def refined(task: Task, stations: Stations, rng: np.random.Generator) -> Stations:
    """Return as many stations near those given, or they themselves, that tell more at the mean."""
    belief, workspace, count = task.belief, task.workspace, len(stations.plane)
    for size in ROUNDS:
        near = _neighbours(task, stations, size, rng)
        near = near[inside(workspace, near)]
        try:
            near = near[safe(outlook(belief, near), task.sensor)]
            near = near[within_reach(belief, workspace, near)]
        except (GrazingBeamError, InputError):  # a move too far; the next round moves less
            continue
        pool = joined([stations, near])
        start = np.arange(count)
        found = task.chosen(told(belief, pool)[None], count, exchange=True, start=start)
        stations = picked(pool, found.candidates)
    return stations


def _neighbours(task: Task, stations: Stations, size: float, rng: np.random.Generator) -> Stations:
    """Return moved copies of stations."""
    span = task.sensor.range_max - task.sensor.range_min
    each = np.repeat(np.arange(len(stations.plane)), NEIGHBOURS)
    turn = size * task.workspace.largest_turn * rng.standard_normal((len(each), 3))
    step = size * span * rng.standard_normal((len(each), 3))
    R = stations.world_R_hand[each] @ Rotation.from_rotvec(0.5 * turn).as_matrix()
    return Stations(R, stations.world_t_hand[each] + 0.5 * step, stations.plane[each])
