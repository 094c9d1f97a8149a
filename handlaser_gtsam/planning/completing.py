"""What a motion that leaves something open still lacks: the best stations beside those recorded.

No calibration tells yet where the beams are, so that the bounds of mounts and plate do, as for a first
motion: stations are safe for all mounts within, and are chosen by what is known worst after them.
"""

from dataclasses import replace

import numpy as np

from ..arrays import FloatArray
from ..data.noise import Noise
from ..data.recording import Recording
from ..errors import InputError
from ..model.sensor import Sensor
from ..validation.simulate import Stations
from . import moves
from .belief import Belief, belief_about
from .bounds import Bounds
from .goal import Goal
from .information import after, told_by
from .moves import KNOWN, Cell
from .route import Plan, Task, planned
from .workspace import Workspace, joined, picked, require_facing, require_range, workspace_of

COUNTS = (3, 4, 5, 6, 8, 10, 12)
"""So many stations are tried, until they determine the mounts."""
SHIFTS = 500
"""Moves without a turn from recorded stations that are tried beside turns."""


def completing_motion(
    bounds: Bounds,
    sensor: Sensor,
    recording: Recording,
    workspace: Workspace | None = None,
    noise: Noise | None = None,
    goal: Goal | None = None,
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
    beams, rng = len(bounds.locations), np.random.default_rng(0)
    if beams != len(recording.beam_names):
        found = f"bounds of {beams} beams for {len(recording.beam_names)} in the recording"
        raise InputError(found, "the bounds of all beams, in the order of the columns")
    workspace = workspace_of(recording) if workspace is None else workspace
    variances = moves.expected_noise(Noise() if noise is None else noise, sensor, beams)
    cell = Cell(bounds, sensor, workspace, variances)
    require_facing("the plate", workspace, bounds.directions, bounds.plate.normal)
    taken = _taken(recording)
    drawn = [bounds.draw(rng) for _ in range(moves.JUDGED)]
    judged = [
        _before_planes(belief_about(bounds, at, variances, sensor), bounds, recording)
        for at in drawn
    ]
    known = [after(one.covariance, _told(one, recording)) for one in judged]
    pool = _pool(cell, taken, rng)
    if len(pool.plane) < COUNTS[-1]:
        expected = "narrower bounds of mount and plate, a wider workspace or a longer range"
        raise InputError("no stations that are safe for all mounts within the bounds", expected)
    for count in COUNTS:
        chosen, left = moves.best_beside(cell, judged, known, pool, count)
        if left <= KNOWN:
            break
    return _plan(cell, recording, picked(pool, chosen), Goal() if goal is None else goal)


def _plan(cell: Cell, recording: Recording, chosen: Stations, goal: Goal) -> Plan:
    """Return the plan of chosen stations, with a forecast for the middle of the bounds."""
    belief = _before_planes(moves.middle_of(cell), cell.bounds, recording)
    C = after(belief.covariance, _told(belief, recording))
    belief, names = replace(belief, covariance=C), recording.station_names
    return planned(Task(belief, cell.workspace, cell.sensor, goal, names), chosen)[0]


def _before_planes(belief: Belief, bounds: Bounds, recording: Recording) -> Belief:
    """Return a belief of beams before the planes of a recording, all within the same bounds."""
    return belief.before(dict.fromkeys(recording.plane_names, bounds.plate), only=True)


def _taken(recording: Recording) -> Stations:
    """Return the stations that were recorded."""
    return Stations(recording.world_R_hand, recording.world_t_hand, recording.plane_of_station)


def _told(belief: Belief, recording: Recording) -> FloatArray:
    """Return what was told by the readings that there are, at stations where all beams can read."""
    rows = told_by(belief, recording)
    if not len(rows):
        raise InputError(
            "bounds of beams and plate that face each other at no station of the recording",
            "the normal of the plate away from the sensor, and directions in the hand frame",
        )
    return rows


def _pool(cell: Cell, taken: Stations, rng: np.random.Generator) -> Stations:
    """Return stations before the last plane that are safe for all mounts within the bounds."""
    last = np.flatnonzero(taken.plane == taken.plane[-1])
    some = rng.choice(last, SHIFTS)
    span = 0.5 * (cell.sensor.range_max - cell.sensor.range_min)
    shift = span * rng.uniform(-1.0, 1.0, (SHIFTS, 3))
    moved = Stations(
        taken.world_R_hand[some], taken.world_t_hand[some] + shift, np.zeros_like(some)
    )
    pool = joined([moves.drawn_turns(cell, moves.facing_plate(cell), rng), moved])
    mounts = cell.bounds.draw(rng, moves.FEW), cell.bounds.draw(rng, moves.MOUNTS)
    pool = moves.safe_for_all(cell, pool, mounts)
    return replace(pool, plane=np.full(len(pool.plane), taken.plane[-1]))
