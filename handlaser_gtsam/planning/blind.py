r"""A first motion, before anything is known but bounds; and what a motion that was begun still lacks.

The hand turns from an orientation at which the beams face the plate, about the point at which they are
expected there, and moves a little. Which of many such stations, and how many, is chosen by what is
known after them: that leads to turns about two axes at least (Lemma 2 of Wei and Hirzinger). All keep
the readings of every mount that was drawn from the bounds within the sensor's limits.
"""

import math
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from .. import model
from ..arrays import BoolArray, IntArray
from ..checks import require_count, require_kind
from ..data.noise import Noise
from ..data.parameters import Parameters
from ..data.recording import Recording
from ..errors import InputError
from ..model.sensor import Sensor
from ..model.weighting import Variances
from ..quantities import KNOWN, ROUNDING, SINGULAR
from ..validation.simulate import Stations, generator, plane_name
from .belief import UNKNOWN_ANGLE, UNKNOWN_LENGTH, UNKNOWN_PLANE, Belief
from .bounds import MOST_PLANNED, Bounds
from .choice import updated
from .goal import Goal
from .information import recorded_rows, station_rows
from .route import Plan, planned
from .task import Task
from .workspace import (
    Workspace,
    inside,
    joined,
    least_cosine,
    reached,
    require_facing,
    require_range,
    workspace_of,
)

MOUNTS = 2000
"""Mounts drawn from the bounds: no station leaves the sensor's limits at any of them, so that one in a
thousand others does at most."""
TRIED_MOVES = 1500
"""Moves that are tried: of a narrow workspace a tenth is safe."""
NOISE_PART = 1e-3
"""A sensor whose noise is not known errs by this part of its range, as cheap ones do."""
LEAST_BLIND = 11
"""Stations before a plane, at least: fewer leave hardly a reading to notice a mistake by."""
MOST_BLIND = 60
"""Stations before a plane, at most: where they do not determine the mounts, the bounds are too wide."""


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
    require_count("planes", planes, 1, MOST_PLANNED)
    rng = generator(rng)
    plates = {plane_name(p): bounds.plate for p in range(planes)}
    first = Task(_belief(bounds, sensor, workspace, noise), workspace, sensor, goal or Goal())
    pool = _safe_moves(bounds, first, rng)
    least, most = stations or LEAST_BLIND, stations or MOST_BLIND
    chosen, determined = _determining(first, pool, least, most)
    every = [replace(pool, plane=np.full(len(pool), p)) for p in range(planes)]
    task = first._replace(belief=first.belief.before(plates, only=True))
    safe = safe_stations(bounds.draw(rng, MOUNTS), pool[chosen], sensor).all(axis=1).mean()
    same = np.concatenate([chosen + p * len(pool) for p in range(planes)])
    motion = planned(task, joined(every), same, plates=plates, safe=float(safe))
    if motion.skipped or not determined:
        reach = "" if workspace.robot is None else ", and that the arm reaches"
        raise InputError(
            "no motion that determines the mounts and keeps the beams of all mounts within the bounds "
            f"in range{reach}",
            "narrower bounds of mount and plate, a wider workspace, more stations or a sensor of "
            "longer range",
        )
    return motion


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
    beams = len(bounds.locations)
    if beams != len(recording.beam_names):
        found = f"bounds of {beams} beams for {len(recording.beam_names)} in the recording"
        raise InputError(found, "the bounds of all beams, in the order of the columns")
    workspace = workspace_of(recording) if workspace is None else workspace
    plates = dict.fromkeys(recording.plane_names, bounds.plate)
    belief = _belief(bounds, sensor, workspace, noise).before(plates, only=True)
    rows = recorded_rows(belief, recording)
    if not len(rows):
        raise InputError(
            "bounds of beams and plate that face each other at no station of the recording",
            "the normal of the plate away from the sensor, and directions in the hand frame",
        )
    belief = replace(belief, covariance=updated(belief.covariance, rows))
    task = Task(belief, workspace, sensor, goal or Goal(), recording.station_names)
    pool = _safe_moves(bounds, task, np.random.default_rng(0))
    pool = replace(pool, plane=np.full(len(pool), recording.plane_of_station[-1]))
    chosen, _ = _determining(task, pool, 3, LEAST_BLIND)
    return planned(task, pool, chosen)


def _determining(task: Task, pool: Stations, least: int, most: int) -> tuple[IntArray, bool]:
    """Return the best stations (M,) of a pool that determine the mounts, and whether they do.

    The standard deviations are half of what a calibration calls undetermined, amid the bounds.
    """
    middle = 0.5 * (task.sensor.range_min + task.sensor.range_max)
    goal = Goal("A", 0.5 * KNOWN * middle, 0.5 * KNOWN)
    rows, known = station_rows(task.belief, pool), task.known._replace(goal=goal)
    enough = known.forecast(rows[known.chosen(rows, most)]).reaches(goal)
    chosen = known.chosen(rows, most if enough is None else max(enough, least))
    return chosen, enough is not None


def _belief(bounds: Bounds, sensor: Sensor, workspace: Workspace, noise: Noise | None) -> Belief:
    """Return what a calibration would start from amid the bounds: next to nothing.

    It does not use the bounds. The bounds of the beams are the `spread`; those of a plate come with
    `Belief.before`. Noise that is not stated is as its prior says.

    Raises
    ------
    InputError
        The sensor's range is not stated, or no beam can face the plate.
    """
    require_range(sensor)
    require_facing("the plate", workspace, bounds.directions, bounds.plate.normal)
    noise, beams = Noise() if noise is None else noise, len(bounds.locations)
    sigma = noise.range_sigma
    if sigma is None:
        sigma = NOISE_PART * (sensor.range_max - sensor.range_min)
    shift, turn = noise.pose_translation_sigma, noise.pose_rotation_sigma
    if noise.pose_covariance is None:
        shift = noise.pose_translation_prior if shift is None else shift
        turn = noise.pose_rotation_prior if turn is None else turn
    stated = replace(noise, pose_translation_sigma=shift, pose_rotation_sigma=turn)
    pose = stated.pose_covariances(1).mean(axis=0)
    variances = Variances(
        np.full(beams, sigma), noise.incidence_sigma, pose[None] if pose.any() else None
    )
    k = sensor.linearity * np.array([1.0, 1.0 / max(abs(sensor.range_max), ROUNDING)])
    unknown = np.tile([*[UNKNOWN_LENGTH] * 3, *[UNKNOWN_ANGLE] * 2, *k], beams)
    # The sigma of a uniform number is its half-width over the root of three.
    box, cone = bounds.location_within / math.sqrt(3.0), 0.5 * bounds.cone
    spread = np.tile([*[box] * 3, *[cone] * 2, *k], beams)
    at = bounds.middle()
    return Belief(
        at,
        np.diag(np.append(unknown, UNKNOWN_PLANE) ** 2),
        model.tangent_basis(at.directions),
        model.tangent_basis(at.normals),
        bounds.plate.point[None],
        variances,
        ("plate",),
        np.diag(np.append(np.maximum(spread, ROUNDING), UNKNOWN_PLANE) ** 2),
    )


def _safe_moves(bounds: Bounds, task: Task, rng: np.random.Generator) -> Stations:
    """Return turns to all sides, about the beams too, and moves that are safe at all mounts.

    Raises
    ------
    InputError
        There are hardly any.
    """
    workspace, sensor, n = task.workspace, task.sensor, bounds.plate.normal
    axis = model.normalized(bounds.directions.mean(axis=0))
    # The orientation nearest to home at which the beams face the plate, as far as half of the largest
    # turn: the other half is left for the motion.
    facing = workspace.home
    v = facing @ axis
    across = np.cross(v, n)
    sine = float(np.linalg.norm(across))
    if sine > SINGULAR:
        angle = min(math.atan2(sine, float(v @ n)), 0.5 * workspace.largest_turn)
        facing = Rotation.from_rotvec(across / sine * angle).as_matrix() @ facing
        v = facing @ axis
    # They turn about the point where the beams are expected on the plate, so that readings change
    # little.
    size = workspace.largest_turn * rng.uniform(size=(TRIED_MOVES, 1))
    side = rng.uniform(0.0, 2.0 * math.pi, TRIED_MOVES)
    tilt = np.stack((np.cos(side), np.sin(side)), axis=1) @ model.tangent_basis(v[None])[0].T
    spin = rng.choice([-0.5, 0.0, 0.5], size=(TRIED_MOVES, 1))
    R = Rotation.from_rotvec(size * (tilt + spin * v))
    span, middle = sensor.range_max - sensor.range_min, 0.5 * (sensor.range_min + sensor.range_max)
    along = rng.uniform(-1.0, 1.0, (TRIED_MOVES, 2)) @ model.tangent_basis(n[None])[0].T
    shift = span * (along + rng.uniform(-0.5, 0.5, (TRIED_MOVES, 1)) * n)
    lever = facing @ (bounds.locations.mean(axis=0) + middle * axis)
    t = bounds.plate.point - R.apply(lever) + shift
    moves = Stations(R.as_matrix() @ facing, t, np.zeros(TRIED_MOVES, dtype=np.intp))
    moves = moves[inside(workspace, moves)]
    for _ in range(MOUNTS // 50):  # few mounts refuse nearly all that are refused
        safe = safe_stations(bounds.draw(rng, 50), moves, sensor)
        moves = moves[np.flatnonzero(safe.all(axis=0))]
    moves = moves[reached(workspace, moves, [bounds.plate])]
    if len(moves) < LEAST_BLIND:
        expected = "narrower bounds of mount and plate, a wider workspace or a longer range"
        raise InputError("no stations that are safe for all mounts within the bounds", expected)
    return moves


def safe_stations(mounts: Parameters, stations: Stations, sensor: Sensor) -> BoolArray:
    """Tell at which stations all readings of each mount are within the sensor's limits, (K, M).

    `mounts` are K draws from bounds: the same number of beams each, and a plane.
    """
    R, t = stations.world_R_hand, stations.world_t_hand
    n, b = mounts.normals, mounts.offsets
    r, v = (x.reshape(len(n), -1, 3) for x in (mounts.locations, mounts.directions))
    n_hand = np.einsum("kj,mji->kmi", n, R)
    cosine = n_hand @ np.swapaxes(v, 1, 2)
    height = n_hand @ np.swapaxes(r, 1, 2) + (n @ t.T + b[:, None])[..., None]
    with np.errstate(all="ignore"):
        within = sensor.can_read(-height / cosine) & (cosine >= least_cosine(sensor))
    return np.asarray(within.all(axis=2))
