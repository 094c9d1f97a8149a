"""The closed loop on a simulated robot: first motion, calibration, planned motion, update."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

import handlaser_gtsam as hl
from benchmarks.planned_cell import SENSOR, cell
from handlaser_gtsam.planning.belief import belief_of
from handlaser_gtsam.planning.plan import Task
from handlaser_gtsam.planning.workspace import joined
from handlaser_gtsam.validation.simulate import Errors

ERRORS = Errors(1e-5, 2e-5, math.radians(0.01), (0, 1, 2))
"""A good sensor, on a robot that was calibrated."""
NORMAL_95 = 1.959964
GOAL = hl.planning.Goal("A", 1e-4 / NORMAL_95, math.radians(0.1) / NORMAL_95)
TURN = 4
"""Stations from one update to the next."""
MOST = 400


@dataclass(frozen=True, slots=True)
class Loop:
    """How many stations after the first motion were needed, and whether the goal was reached."""

    stations: int
    reached: bool


def loop(seed: int) -> dict[str, Loop]:
    """Return how many stations a planned and a random motion need, on one robot."""
    return {way: _run(seed, way) for way in ("planned", "random")}


def _run(seed: int, way: str) -> Loop:
    rng = np.random.default_rng(seed)
    here = cell(rng, errors=ERRORS)
    session = hl.Session(here.noise, hl.CalibrationOptions("none", sensor=SENSOR))
    motion = hl.planning.blind_motion(here.bounds, SENSOR, here.workspace, here.noise)
    read = here.measured(motion, rng)
    session.add(read)
    first = taken = len(read.station_names)
    while taken - first < MOST:
        calibration = session.calibration()
        if reached(calibration):
            return Loop(taken - first, reached=True)
        missing = here.unread(session.recording())
        if way == "planned":
            plan = hl.plan(calibration, TURN, SENSOR, here.workspace, GOAL, plates=missing, rng=rng)
        else:
            plan = random_plan(calibration, TURN, here.workspace, missing, rng)
        read = here.measured(plan, rng, first=taken)
        session.add(read)
        taken += len(read.station_names)
    return Loop(taken - first, reached=reached(session.calibration()))


def reached(calibration: hl.Calibration) -> bool:
    """Tell whether all 95 % intervals of the mounts are within the goal."""
    return all(
        beam.sigma is not None
        and beam.direction_sigma is not None
        and float(beam.sigma[:3].max()) <= (GOAL.location_sigma or 0.0)
        and beam.direction_sigma <= (GOAL.direction_sigma or 0.0)
        for beam in calibration.beams.values()
    )


def random_plan(
    calibration: hl.Calibration,
    count: int,
    workspace: hl.planning.Workspace,
    plates: Mapping[str, hl.planning.Plate],
    rng: np.random.Generator,
) -> hl.planning.Plan:
    """Return safe stations before all planes, drawn instead of chosen."""
    belief = belief_of(calibration).before(plates)
    planes = range(len(belief.plane_names))
    task = Task(belief, workspace, SENSOR, GOAL)
    pool = joined([task.candidates(p, 40, rng) for p in planes])
    every = len(pool.plane)
    chosen = rng.choice(every, count, replace=False)
    return replace(task.planned(pool[chosen]), plates=plates)
