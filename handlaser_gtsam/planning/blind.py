r"""A first motion, before anything is known but bounds; and what a motion that was begun still lacks.

At one orientation, at which the beams face the plate, the hand makes four positions that span space, so
that the plate's normal follows in closed form (Lemma 1 of Wei and Hirzinger). It then turns about the
point at which the beams are expected on the plate: to which sides and how far (Lemma 2 asks for two
axes) is chosen among many turns, by what is least known afterwards. All keep the readings of every
mount that was drawn from the bounds within the sensor's limits.
"""

from dataclasses import replace

import numpy as np

from ..arrays import FloatArray
from ..checks import require_count, require_kind
from ..data.noise import Noise
from ..data.recording import Recording
from ..errors import InputError
from ..model.sensor import Sensor
from ..validation.simulate import Stations, plane_name
from .belief import Belief
from .bounds import Bounds
from .goal import Goal
from .information import recorded_rows, station_rows, updated
from .moves import COMPARED_MOUNTS, FIRST_MOUNTS, MOUNTS, assumed, safe_stations
from .plate import MOST_PLACEMENTS
from .route import Plan, planned
from .task import Task
from .workspace import Workspace, joined, workspace_of

LEAST_BLIND = 11
"""Stations before a plane, at least: four positions and seven turns."""
MOST_BLIND = 60
"""Stations before a plane, at most: where they do not determine the mounts, the bounds are too wide."""
ADDED = 4
"""Stations that are added at a time, where those before do not determine the mounts."""
DETERMINED = 0.05
"""Largest standard deviation after enough stations: of a direction [rad], and of a location as a part
of the middle of the sensor's range. A calibration calls undetermined what is known half as well."""
BARELY_DETERMINED = 0.08
"""The same where the number of stations is given: nearly what a calibration calls undetermined."""
COMPLETING_COUNTS = (3, 4, 5, 6, 8, 10, 12)
"""Numbers of stations that are tried, until they determine the mounts."""
SHIFTS = 500
"""Moves without a turn from recorded stations that are tried beside turns, a third as many."""


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
        require_count("stations before each plane", stations, LEAST_BLIND, MOST_BLIND)
    require_count("planes", planes, 1, MOST_PLACEMENTS)
    rng = np.random.default_rng(0) if rng is None else rng
    known = assumed(bounds, sensor, workspace, noise)
    mounts = bounds.draw(rng, MOUNTS)
    first = known.translations(mounts)
    turns = known.turns(rng)
    turns = known.safe(turns, (bounds.draw(rng, FIRST_MOUNTS), mounts))
    beliefs = [known.belief(bounds.draw(rng)) for _ in range(COMPARED_MOUNTS)]
    before = [updated(belief.covariance, station_rows(belief, first)) for belief in beliefs]
    enough = DETERMINED if stations is None else BARELY_DETERMINED
    motion: Stations | None = None
    most = MOST_BLIND if stations is None else stations
    for number in range(stations or LEAST_BLIND, most + 1, ADDED):
        more = number - len(first)
        if len(turns) < more:
            break
        chosen, worst = known.best(beliefs, before, turns, more)
        if worst <= enough:
            motion = joined([first, turns[chosen]])
            break
    if motion is None:
        raise InputError(
            "no motion that determines the mounts and keeps the beams of all within the bounds in range"
            + ("" if workspace.robot is None else ", and that the arm reaches"),
            "narrower bounds of mount and plate, a wider workspace, more stations or a sensor of "
            "longer range",
        )
    plates = {plane_name(p): bounds.plate for p in range(planes)}
    belief = known.belief(bounds.middle()).before(plates, only=True)
    every = joined([replace(motion, plane=np.full(len(motion), p)) for p in range(planes)])
    others = bounds.draw(rng, MOUNTS)
    safe = float(safe_stations(others, motion, sensor).all(axis=1).mean())
    task = Task(belief, workspace, sensor, Goal() if goal is None else goal)
    return planned(task, every, ordered=True, plates=plates, safe=safe)[0]


def completing_motion(
    bounds: Bounds,
    sensor: Sensor,
    recording: Recording,
    workspace: Workspace | None = None,
    noise: Noise | None = None,
    goal: Goal | None = None,
) -> Plan:
    """Return the best stations before the last plane of a recording that determines too little.

    No calibration says yet where the beams are, so that the bounds do, as for a first motion. Every
    plane counts as the plate within its bounds.

    Raises
    ------
    InputError
        The sensor's range is not stated, the bounds are of another number of beams, or hardly a
        station is safe for all mounts within them.
    """
    beams, rng = len(bounds.locations), np.random.default_rng(0)
    if beams != len(recording.beam_names):
        found = f"bounds of {beams} beams for {len(recording.beam_names)} in the recording"
        raise InputError(found, "the bounds of all beams, in the order of the columns")
    workspace = workspace_of(recording) if workspace is None else workspace
    known = assumed(bounds, sensor, workspace, noise)
    plates = dict.fromkeys(recording.plane_names, bounds.plate)
    drawn = [bounds.draw(rng) for _ in range(COMPARED_MOUNTS)]
    beliefs = [known.belief(at).before(plates, only=True) for at in drawn]
    before = [_after(belief, recording) for belief in beliefs]
    # Turns before the last plane, and moves without a turn from stations recorded there.
    taken = Stations(recording.world_R_hand, recording.world_t_hand, recording.plane_of_station)
    last = np.flatnonzero(taken.plane == taken.plane[-1])
    moved = taken[rng.choice(last, SHIFTS)]
    span = 0.5 * (sensor.range_max - sensor.range_min)
    moved = replace(
        moved, world_t_hand=moved.world_t_hand + span * rng.uniform(-1.0, 1.0, (SHIFTS, 3))
    )
    pool = joined([known.turns(rng), moved])
    pool = known.safe(pool, (bounds.draw(rng, FIRST_MOUNTS), bounds.draw(rng, MOUNTS)))
    pool = replace(pool, plane=np.full(len(pool), taken.plane[-1]))
    if len(pool) < COMPLETING_COUNTS[-1]:
        expected = "narrower bounds of mount and plate, a wider workspace or a longer range"
        raise InputError("no stations that are safe for all mounts within the bounds", expected)
    for count in COMPLETING_COUNTS:
        chosen, worst = known.best(beliefs, before, pool, count)
        if worst <= DETERMINED:
            break
    belief = known.belief(bounds.middle()).before(plates, only=True)
    belief = replace(belief, covariance=_after(belief, recording))
    goal = Goal() if goal is None else goal
    task = Task(belief, workspace, sensor, goal, recording.station_names)
    return planned(task, pool[chosen])[0]


def _after(belief: Belief, recording: Recording) -> FloatArray:
    """Return what is known after the readings of a recording, where all beams can read."""
    rows = recorded_rows(belief, recording)
    if not len(rows):
        raise InputError(
            "bounds of beams and plate that face each other at no station of the recording",
            "the normal of the plate away from the sensor, and directions in the hand frame",
        )
    return updated(belief.covariance, rows)
