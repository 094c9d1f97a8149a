"""What a motion that leaves something open still lacks: the best stations beside those recorded.

No calibration tells yet where the beams are, so that the bounds of mounts and plate do, as for a first
motion: stations are safe for all mounts within, and are chosen by what is known worst after them.
"""

from dataclasses import replace

import numpy as np

from .. import model
from ..arrays import FloatArray
from ..data.noise import Noise
from ..data.recording import Recording
from ..errors import InputError
from ..model.sensor import Sensor
from ..validation.simulate import Stations
from .belief import Belief, belief_about
from .bounds import Bounds
from .goal import Goal
from .information import after, told
from .moves import (
    FEW,
    JUDGED,
    MOUNTS,
    Cell,
    best_beside,
    drawn_turns,
    expected_noise,
    facing_plate,
    middle_of,
    safe_for_all,
)
from .route import Plan, forecast_of, planned
from .workspace import Workspace, joined, picked, require_facing, require_range, workspace_of

COUNTS = (3, 4, 5, 6, 8, 10, 12)
"""So many stations are tried, until they determine the mounts."""
ENOUGH = 0.05
"""Largest standard deviation after them: of a direction [rad], and of a location as a part of the
middle of the sensor's range. A calibration calls undetermined what is known half as well."""
SHIFTS = 500
"""Moves without a turn from recorded stations that are tried beside turns."""


def completing_motion(
    bounds: Bounds,
    sensor: Sensor,
    recording: Recording,
    workspace: Workspace | None = None,
    noise: Noise | None = None,
    goal: Goal | None = None,
    *,
    rng: np.random.Generator | None = None,
) -> Plan:
    """Return the best stations before the last plane of a recording that leaves something open.

    Every plane counts as the plate within its bounds.

    Raises
    ------
    InputError
        The sensor's range is not stated, the bounds are of another number of beams, or hardly a
        station is safe for all mounts within them.
    """
    require_range(sensor)
    beams, rng = len(bounds.locations), np.random.default_rng(0) if rng is None else rng
    if beams != len(recording.beam_names):
        found = f"bounds of {beams} beams for {len(recording.beam_names)} in the recording"
        raise InputError(found, "the bounds of all beams, in the order of the columns")
    workspace = workspace_of(recording) if workspace is None else workspace
    variances = expected_noise(Noise() if noise is None else noise, sensor, beams)
    cell = Cell(bounds, sensor, workspace, variances)
    require_facing("the plate", workspace, bounds.directions, bounds.plate.normal)
    taken = _taken(recording)
    drawn = [bounds.draw(rng) for _ in range(JUDGED)]
    judged = [
        _before_planes(belief_about(bounds, at, variances, sensor), bounds, recording)
        for at in drawn
    ]
    known = [after(one.covariance, _told(one, taken, recording)) for one in judged]
    pool = _pool(cell, taken, rng)
    if len(pool.plane) < COUNTS[-1]:
        expected = "narrower bounds of mount and plate, a wider workspace or a longer range"
        raise InputError("no stations that are safe for all mounts within the bounds", expected)
    for count in COUNTS:
        chosen, left = best_beside(cell, judged, known, pool, count)
        if left <= ENOUGH:
            break
    return _plan(cell, recording, taken, picked(pool, chosen), Goal() if goal is None else goal)


def _plan(cell: Cell, recording: Recording, taken: Stations, chosen: Stations, goal: Goal) -> Plan:
    """Return the plan of chosen stations, with a forecast for the middle of the bounds."""
    belief = _before_planes(middle_of(cell), cell.bounds, recording)
    C = after(belief.covariance, _told(belief, taken, recording))
    belief, distance = replace(belief, covariance=C), goal.distance(cell.sensor)
    order = np.arange(len(chosen.plane))
    forecast = forecast_of(belief, told(belief, chosen), order, distance)
    return planned(belief, chosen, goal, cell.workspace, forecast, recording.station_names)


def _before_planes(belief: Belief, bounds: Bounds, recording: Recording) -> Belief:
    """Return a belief of beams before the planes of a recording, all within the same bounds."""
    return belief.before(dict.fromkeys(recording.plane_names, bounds.plate), only=True)


def _taken(recording: Recording) -> Stations:
    """Return the stations that were recorded."""
    return Stations(recording.world_R_hand, recording.world_t_hand, recording.plane_of_station)


def _told(belief: Belief, taken: Stations, recording: Recording) -> FloatArray:
    """Return what was told by the readings that there are, at stations where all beams can read."""
    n = belief.mean.normals[taken.plane]
    n_hand = np.einsum("mji,mj->mi", taken.world_R_hand, n)
    facing = (n_hand @ belief.mean.directions.T > model.GRAZING_LIMIT).all(axis=1)
    if not facing.any():
        raise InputError(
            "bounds of beams and plate that face each other at no station of the recording",
            "the normal of the plate away from the sensor, and directions in the hand frame",
        )
    rows = told(belief, picked(taken, np.flatnonzero(facing)))
    read = ~np.isnan(recording.ranges[facing])
    return np.where(read[..., None], rows, 0.0)


def _pool(cell: Cell, taken: Stations, rng: np.random.Generator) -> Stations:
    """Return stations before the last plane that are safe for all mounts within the bounds."""
    last = np.flatnonzero(taken.plane == taken.plane[-1])
    some = rng.choice(last, SHIFTS)
    span = 0.5 * (cell.sensor.range_max - cell.sensor.range_min)
    shift = span * rng.uniform(-1.0, 1.0, (SHIFTS, 3))
    moved = Stations(
        taken.world_R_hand[some], taken.world_t_hand[some] + shift, np.zeros_like(some)
    )
    pool = joined([drawn_turns(cell, facing_plate(cell), rng), moved])
    pool = safe_for_all(cell, pool, (cell.bounds.draw(rng, FEW), cell.bounds.draw(rng, MOUNTS)))
    return replace(pool, plane=np.full(len(pool.plane), taken.plane[-1]))
