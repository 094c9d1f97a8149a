r"""A first motion, before anything is known but bounds: translations, then turns.

At one orientation, at which the beams face the plate, the hand makes four positions that span space, so
that the plate's normal follows in closed form (Lemma 1 of Wei and Hirzinger). It then turns about the
point at which the beams are expected on the plate, so that readings change little: to which sides and
how far (Lemma 2 asks for two axes) is chosen among many turns, all of which keep the readings of every
mount that was drawn from the bounds within the sensor's limits, by what is known worst afterwards.
"""

import math
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from scipy.spatial.transform import Rotation

from .. import model
from ..arrays import BoolArray, FloatArray, IntArray
from ..checks import require_count, require_kind
from ..data.noise import Noise
from ..data.parameters import Parameters
from ..errors import InputError
from ..model.sensor import Sensor
from ..model.weighting import Variances
from ..validation.simulate import Stations, plane_name
from .belief import Belief, belief_about
from .bounds import Bounds
from .choice import choose, value
from .goal import Goal
from .information import told, updated
from .plate import MOST_PLANES
from .route import Plan, forecast_of, goal_rows, planned
from .workspace import STEEPEST, Workspace, inside, joined, picked, require_range

MOUNTS = 2000
"""Mounts drawn from the bounds: no station leaves the sensor's limits at any of them."""
FEW = 50
"""Of them, at which every turn is tried first."""
AT_ONCE = 20_000
"""Readings predicted at a time: more would leave the processor's cache."""
JUDGED = 4
"""Mounts at which stations are compared by what they tell."""
SHARES = (1.0, 0.7, 0.5, 0.35, 0.2, 0.1)
"""Of the largest translations, which are tried."""
TETRAHEDRON = np.array([[1.0, 1.0, 1.0], [1.0, -1.0, -1.0], [-1.0, 1.0, -1.0], [-1.0, -1.0, 1.0]])
TRIED = 1500
"""Turns that are tried."""
SIDES = 8
"""To so many sides the hand turns."""
LEAST_STATIONS, MOST_BLIND = 11, 60
"""Before a plane: four positions and seven turns; beyond the most, the bounds are too wide."""
MORE = 4
"""Stations that are added at a time, where those before do not determine the mounts."""
KNOWN = 0.05
"""Largest standard deviation after a first motion: of a direction [rad], and of a location as a part
of the middle of the sensor's range. A calibration calls undetermined what is known half as well."""
BARELY_KNOWN = 0.08
"""The same where the number of stations is given."""
LEAST_SINE = 1e-12
"""Of the angle between beams and normal: below, they are parallel."""
PART_OF_RANGE = 1e-3
"""Of its range, a sensor whose noise is not known errs by so much."""


@dataclass(frozen=True, slots=True)
class _Cell:
    """What is known of mounts, plate, sensor and robot."""

    bounds: Bounds
    sensor: Sensor
    workspace: Workspace
    variances: Variances

    @property
    def middle(self) -> float:
        """The middle of the sensor's range [m]."""
        return 0.5 * (self.sensor.range_min + self.sensor.range_max)


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
    variances = expected_noise(Noise() if noise is None else noise, sensor, len(bounds.locations))
    cell = _Cell(bounds, sensor, workspace, variances)
    return _plan(cell, _motion(cell, stations, rng), planes, Goal() if goal is None else goal, rng)


def _plan(cell: _Cell, motion: Stations, planes: int, goal: Goal, rng: np.random.Generator) -> Plan:
    """Return a plan of the same motion before each plane."""
    bounds = cell.bounds
    plates = {plane_name(p): bounds.plate for p in range(planes)}
    belief = _middle(cell).before(plates, only=True)
    each = np.zeros(len(motion.plane), dtype=np.intp)
    every = joined([replace(motion, plane=each + p) for p in range(planes)])
    order = np.arange(len(every.plane))
    distance = goal.distance(cell.sensor)
    forecast = forecast_of(belief, told(belief, every), order, distance)
    others = bounds.draw(rng, MOUNTS)
    safe = float(safe_stations(others, motion, cell.sensor).all(axis=1).mean())
    return planned(
        belief, every, goal, cell.workspace, forecast, ordered=True, plates=plates, safe=safe
    )


def expected_noise(noise: Noise, sensor: Sensor, beams: int) -> Variances:
    """Return what readings are expected to err by; what is not stated is as its prior says."""
    sigma = noise.range_sigma
    if sigma is None:
        sigma = PART_OF_RANGE * (sensor.range_max - sensor.range_min)
    pose = noise.pose_covariance
    if pose is None:
        shift, turn = noise.pose_translation_sigma, noise.pose_rotation_sigma
        shift = noise.pose_translation_prior if shift is None else shift
        turn = noise.pose_rotation_prior if turn is None else turn
        pose = np.diag([turn**2] * 3 + [shift**2] * 3)
    elif pose.ndim == 3:
        pose = pose.mean(axis=0)
    errs = bool(np.any(pose))
    return Variances(np.full(beams, sigma), noise.incidence_sigma, pose[None] if errs else None)


def _middle(cell: _Cell) -> Belief:
    """Return the belief about the middle of the bounds."""
    bounds, plate = cell.bounds, cell.bounds.plate
    offset = -float(plate.normal @ plate.point)
    zero = np.zeros((len(bounds.locations), 2))
    at = Parameters(
        bounds.locations, bounds.directions, zero, plate.normal[None], np.array([offset])
    )
    return belief_about(bounds, at, cell.variances, cell.sensor)


def _motion(cell: _Cell, count: int | None, rng: np.random.Generator) -> Stations:
    """Return translations and turns that are safe for all mounts drawn, and determine them."""
    mounts = cell.bounds.draw(rng, MOUNTS)
    base = _facing(cell)
    first = _translations(cell, base, mounts)
    turns = _turns(cell, base, rng)
    turns = picked(turns, np.flatnonzero(inside(cell.workspace, turns)))
    for some in (cell.bounds.draw(rng, FEW), mounts):  # most turns fail at a few mounts already
        safe = safe_stations(some, turns, cell.sensor).all(axis=0)
        turns = picked(turns, np.flatnonzero(safe))
    turns = picked(turns, np.flatnonzero(_within_reach(cell, turns)))
    number = LEAST_STATIONS if count is None else count
    judged = [cell.bounds.draw(rng) for _ in range(JUDGED)]
    while len(turns.plane) >= number - len(first.plane):
        chosen, known = _chosen(cell, judged, first, turns, number - len(first.plane))
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


def _chosen(
    cell: _Cell, mounts: list[Parameters], first: Stations, turns: Stations, count: int
) -> tuple[IntArray, float]:
    """Return turns that leave the least of what is known worst, and that standard deviation."""
    rows, before = [], []
    for at in mounts:
        belief = belief_about(cell.bounds, at, cell.variances, cell.sensor)
        C = belief.covariance
        for one in told(belief, first):
            C = updated(C, one)
        before.append(C)
        rows.append(told(belief, turns))
    unit = Goal("E", cell.middle, 1.0)
    weight = goal_rows(belief, unit, cell.middle)
    found = choose(np.stack(rows), np.stack(before), weight, count, "E", exchange=False)
    worst = 0.0
    for C, own in zip(before, rows, strict=True):
        for index in found.candidates:
            C = updated(C, own[index])
        worst = max(worst, math.sqrt(value(C, weight, "E")))
    return found.candidates, worst


def _translations(cell: _Cell, base: FloatArray, mounts: Parameters) -> Stations:
    """Return four positions that span space, as far apart as is safe at all mounts."""
    span = cell.sensor.range_max - cell.sensor.range_min
    n = cell.bounds.plate.normal
    across = model.tangent_basis(n[None])[0].T
    for share in sorted(product(SHARES, SHARES), key=lambda one: -(one[0] * one[1] ** 2)):
        depth, move = 0.5 * span * share[0] * n, span * share[1] * across
        shift = TETRAHEDRON[:, :2] @ move + TETRAHEDRON[:, 2:] * depth
        stations = _about(cell, base, np.zeros((4, 3)), shift)
        safe = bool(inside(cell.workspace, stations).all())
        safe = safe and bool(safe_stations(mounts, stations, cell.sensor).all())
        if safe and _within_reach(cell, stations).all():
            return stations
    raise InputError(
        "no translations that keep the beams of all mounts within the bounds in range"
        + ("" if cell.workspace.robot is None else ", and that the arm reaches"),
        "narrower bounds of mount and plate, a wider workspace or a sensor of longer range",
    )


def _within_reach(cell: _Cell, stations: Stations) -> BoolArray:
    """Tell which stations the arm reaches; all without an arm."""
    robot, R, t = cell.workspace.robot, stations.world_R_hand, stations.world_t_hand
    return np.ones(len(t), bool) if robot is None else robot.reachable(R, t, cell.bounds.plate)


def _turns(cell: _Cell, base: FloatArray, rng: np.random.Generator) -> Stations:
    """Return turns to several sides, about the beams too, each with a translation."""
    span = cell.sensor.range_max - cell.sensor.range_min
    n = cell.bounds.plate.normal
    v = base @ model.normalized(cell.bounds.directions.mean(axis=0))
    axes = model.tangent_basis(v[None])[0].T
    side = 2.0 * math.pi * rng.integers(SIDES, size=TRIED) / SIDES
    size = cell.workspace.largest_turn * rng.uniform(size=TRIED)
    spin = rng.choice([-0.5, 0.0, 0.5], size=TRIED) * size
    turns = size[:, None] * (np.cos(side)[:, None] * axes[0] + np.sin(side)[:, None] * axes[1])
    along = rng.uniform(-1.0, 1.0, (TRIED, 2)) @ model.tangent_basis(n[None])[0].T
    depth = rng.uniform(-0.5, 0.5, (TRIED, 1))
    return _about(cell, base, turns + spin[:, None] * v, span * (along + depth * n))


def _about(cell: _Cell, base: FloatArray, turns: FloatArray, shift: FloatArray) -> Stations:
    """Return stations turned about the point where the beams are expected on the plate."""
    v = model.normalized(cell.bounds.directions.mean(axis=0))
    lever = base @ (cell.bounds.locations.mean(axis=0) + cell.middle * v)
    R = Rotation.from_rotvec(turns)
    t = cell.bounds.plate.point - R.apply(lever) + shift
    return Stations(R.as_matrix() @ base, t, np.zeros(len(t), dtype=np.intp))


def _facing(cell: _Cell) -> FloatArray:
    """Return the orientation nearest to home at which the beams face the plate.

    As far as half of the largest turn: the other half is left for the motion.
    """
    home, n = cell.workspace.home, cell.bounds.plate.normal
    v = home @ model.normalized(cell.bounds.directions.mean(axis=0))
    axis = np.cross(v, n)
    size = float(np.linalg.norm(axis))
    if size < LEAST_SINE:
        return home
    angle = min(math.atan2(size, float(v @ n)), 0.5 * cell.workspace.largest_turn)
    return np.asarray(Rotation.from_rotvec(axis / size * angle).as_matrix() @ home)


def safe_stations(mounts: Parameters, stations: Stations, sensor: Sensor) -> BoolArray:
    """Tell at which stations all readings of each mount are within the sensor's limits, (K, M).

    `mounts` are K draws from bounds: as many beams each, and a plane.
    """
    R, t = stations.world_R_hand, stations.world_t_hand
    n, b = mounts.normals, mounts.offsets
    r, v = (one.reshape(len(n), -1, 3) for one in (mounts.locations, mounts.directions))
    least = math.cos(min(sensor.max_incidence, STEEPEST))
    good = np.empty((len(n), len(t)), dtype=bool)
    size = max(AT_ONCE // max(len(t) * r.shape[1], 1), 1)
    for some in (slice(k, k + size) for k in range(0, len(n), size)):
        n_hand = (n[some] @ R.transpose(1, 0, 2).reshape(3, -1)).reshape(-1, len(t), 3)
        cosine = n_hand @ np.swapaxes(v[some], 1, 2)
        height = n_hand @ np.swapaxes(r[some], 1, 2) + (n[some] @ t.T + b[some, None])[..., None]
        with np.errstate(all="ignore"):
            good[some] = (sensor.can_read(-height / cosine) & (cosine >= least)).all(axis=2)
    return good
