r"""A first motion, before anything is known but bounds: translations, then turns.

At one orientation, at which the beams face the plate, the hand makes four positions that span space, so
that the plate's normal follows in closed form (Lemma 1 of Wei and Hirzinger). It then turns about the
point at which the beams are expected on the plate, so that readings change little: to which sides and
how far (Lemma 2 asks for two axes) is chosen among many turns, all of which keep the readings of every
mount that was drawn from the bounds within the sensor's limits, by what is known worst afterwards.
"""

from dataclasses import replace

import numpy as np

from ..checks import require_count, require_kind
from ..data.noise import Noise
from ..errors import InputError
from ..model.sensor import Sensor
from ..validation.simulate import Stations, plane_name
from . import moves
from .belief import belief_about
from .bounds import Bounds
from .goal import Goal
from .information import after, told
from .moves import KNOWN, Cell
from .plate import MOST_PLANES
from .route import Plan, Task, planned
from .workspace import Workspace, joined, picked, require_facing, require_range

LEAST_STATIONS, MOST_BLIND = 11, 60
"""Before a plane: four positions and seven turns; beyond the most, the bounds are too wide."""
MORE = 4
"""Stations that are added at a time, where those before do not determine the mounts."""
BARELY_KNOWN = 0.08
"""What stands for `KNOWN` where the number of stations is given."""


def blind_motion(
    bounds: Bounds,
    sensor: Sensor,
    workspace: Workspace,
    noise: Noise | None = None,
    stations: int | None = None,
    *,
    planes: int = 1,
    goal: Goal | None = None,
    rng: np.random.Generator | None = None,
) -> Plan:
    """Return a first motion that determines any mount within the bounds.

    Parameters
    ----------
    bounds : Bounds
        Where beams and plate roughly are.
    sensor : Sensor
        Its range is needed.
    workspace : Workspace
    noise : Noise, optional
    stations : int, optional
        Before each plane, 11 at least; as many as the mounts need where not given.
    planes : int
        How many times the plate is put within its bounds: the motion is the same before each.
    goal : Goal, optional
    rng : numpy.random.Generator, optional
        Draws the mounts at which motions are tried; a fixed one where not given.

    Raises
    ------
    InputError
        The sensor's range is not stated, or no safe motion determines the mounts.
    """
    require_kind("bounds", bounds, Bounds)
    require_kind("sensor", sensor, Sensor)
    require_kind("workspace", workspace, Workspace)
    if stations is not None:
        require_count("stations before each plane", stations, LEAST_STATIONS, MOST_BLIND)
    require_count("planes", planes, 1, MOST_PLANES)
    require_range(sensor)
    rng = np.random.default_rng(0) if rng is None else rng
    variances = moves.expected_noise(noise or Noise(), sensor, len(bounds.locations))
    cell = Cell(bounds, sensor, workspace, variances)
    return _plan(cell, _motion(cell, stations, rng), planes, Goal() if goal is None else goal, rng)


def _plan(cell: Cell, motion: Stations, planes: int, goal: Goal, rng: np.random.Generator) -> Plan:
    """Return a plan of the same motion before each plane."""
    bounds = cell.bounds
    plates = {plane_name(p): bounds.plate for p in range(planes)}
    belief = moves.middle_of(cell).before(plates, only=True)
    each = np.zeros(len(motion.plane), dtype=np.intp)
    every = joined([replace(motion, plane=each + p) for p in range(planes)])
    others = bounds.draw(rng, moves.MOUNTS)
    safe = float(moves.safe_stations(others, motion, cell.sensor).all(axis=1).mean())
    task = Task(belief, cell.workspace, cell.sensor, goal)
    return planned(task, every, ordered=True, plates=plates, safe=safe)[0]


def _motion(cell: Cell, count: int | None, rng: np.random.Generator) -> Stations:
    """Return translations and turns that are safe for all mounts drawn, and determine them."""
    plate = cell.bounds.plate
    require_facing("the plate", cell.workspace, cell.bounds.directions, plate.normal)
    mounts = cell.bounds.draw(rng, moves.MOUNTS)
    base = moves.facing_plate(cell)
    first = moves.spread_translations(cell, base, mounts)
    turns = moves.drawn_turns(cell, base, rng)
    turns = moves.safe_for_all(cell, turns, (cell.bounds.draw(rng, moves.FEW), mounts))
    number = LEAST_STATIONS if count is None else count
    judged = [cell.bounds.draw(rng) for _ in range(moves.JUDGED)]
    beliefs = [belief_about(cell.bounds, at, cell.variances, cell.sensor) for at in judged]
    known_before = [after(belief.covariance, told(belief, first)) for belief in beliefs]
    while len(turns.plane) >= number - len(first.plane):
        more = number - len(first.plane)
        chosen, known = moves.best_beside(cell, beliefs, known_before, turns, more)
        if known <= (KNOWN if count is None else BARELY_KNOWN):
            return joined([first, picked(turns, chosen)])
        if count is not None or number + MORE > MOST_BLIND:
            break
        number += MORE
    raise InputError(
        "no motion that determines the mounts and keeps the beams of all within the bounds in range"
        + ("" if cell.workspace.robot is None else ", and that the arm reaches"),
        "narrower bounds of mount and plate, a wider workspace, more stations or a sensor of longer "
        "range",
    )
