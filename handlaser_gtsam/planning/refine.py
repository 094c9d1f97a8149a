"""Chosen stations moved a little for better ones: what lies between the candidates that were drawn."""

import numpy as np
from scipy.spatial.transform import Rotation

from ..arrays import FloatArray
from ..errors import GrazingBeamError, InputError
from ..model.sensor import Sensor
from ..validation.simulate import Stations
from .belief import Belief
from .choice import choose
from .goal import Goal
from .information import outlook, told
from .workspace import Workspace, inside, joined, picked, safe, within_reach

ROUNDS = (0.4, 0.15)
"""Moves of each round, as parts of the largest turn and of the sensor's range."""
NEIGHBOURS = 24
"""Moved copies of every station a round."""


def refined(
    belief: Belief,
    stations: Stations,
    weight: FloatArray,
    goal: Goal,
    workspace: Workspace,
    sensor: Sensor,
    rng: np.random.Generator,
) -> Stations:
    """Return as many stations near those given, or they themselves, that tell more at the mean."""
    count = len(stations.plane)
    for size in ROUNDS:
        near = _neighbours(stations, size, workspace, sensor, rng)
        near = picked(near, np.flatnonzero(inside(workspace, near)))
        try:
            near = picked(near, np.flatnonzero(safe(outlook(belief, near), sensor)))
            near = picked(near, np.flatnonzero(within_reach(belief, workspace, near)))
        except (GrazingBeamError, InputError):  # a move too far; the next round moves less
            continue
        pool = joined([stations, near])
        rows = told(belief, pool)[None]
        start = np.arange(count)
        found = choose(rows, belief.covariance, weight, count, goal.criterion, start=start)
        stations = picked(pool, found.candidates)
    return stations


def _neighbours(
    stations: Stations,
    size: float,
    workspace: Workspace,
    sensor: Sensor,
    rng: np.random.Generator,
) -> Stations:
    """Return moved copies of stations."""
    each = np.repeat(np.arange(len(stations.plane)), NEIGHBOURS)
    turn = size * workspace.largest_turn * rng.standard_normal((len(each), 3))
    step = size * (sensor.range_max - sensor.range_min) * rng.standard_normal((len(each), 3))
    R = stations.world_R_hand[each] @ Rotation.from_rotvec(0.5 * turn).as_matrix()
    return Stations(R, stations.world_t_hand[each] + 0.5 * step, stations.plane[each])
