"""Moves of the hand before anything is known but bounds, and at which of them all mounts can read."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from scipy.spatial.transform import Rotation

from .. import model
from ..arrays import BoolArray, FloatArray, IntArray
from ..data.noise import Noise
from ..data.parameters import Parameters
from ..errors import InputError
from ..model.sensor import Sensor
from ..model.weighting import Variances
from ..validation.simulate import Stations
from .belief import Belief, belief_about
from .bounds import Bounds
from .choice import choose, value
from .goal import Goal
from .information import after, told
from .route import goal_rows
from .workspace import STEEPEST, Workspace, inside, picked

MOUNTS = 2000
"""Mounts drawn from the bounds: no station leaves the sensor's limits at any of them."""
FEW = 50
"""Of them, at which every turn is tried first."""
AT_ONCE = 20_000
"""Readings predicted at a time: more would leave the processor's cache."""
JUDGED = 4
"""Mounts at which stations are compared by what they tell."""
KNOWN = 0.05
"""Largest standard deviation after enough stations: of a direction [rad], and of a location as a part
of the middle of the sensor's range. A calibration calls undetermined what is known half as well."""
SHARES = (1.0, 0.7, 0.5, 0.35, 0.2, 0.1)
"""Of the largest translations, which are tried."""
TETRAHEDRON = np.array([[1.0, 1.0, 1.0], [1.0, -1.0, -1.0], [-1.0, 1.0, -1.0], [-1.0, -1.0, 1.0]])
TRIED = 1500
"""Turns that are tried."""
SIDES = 8
"""To so many sides the hand turns."""
LEAST_SINE = 1e-12
"""Of the angle between beams and normal: below, they are parallel."""
PART_OF_RANGE = 1e-3
"""Of its range, a sensor whose noise is not known errs by so much."""


@dataclass(frozen=True, slots=True)
class Cell:
    """What is known of mounts, plate, sensor and robot."""

    bounds: Bounds
    sensor: Sensor
    workspace: Workspace
    variances: Variances

    @property
    def middle(self) -> float:
        """The middle of the sensor's range [m]."""
        return 0.5 * (self.sensor.range_min + self.sensor.range_max)


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


def middle_of(cell: Cell) -> Belief:
    """Return the belief about the middle of the bounds."""
    bounds, plate = cell.bounds, cell.bounds.plate
    offset = -float(plate.normal @ plate.point)
    zero = np.zeros((len(bounds.locations), 2))
    at = Parameters(
        bounds.locations, bounds.directions, zero, plate.normal[None], np.array([offset])
    )
    return belief_about(bounds, at, cell.variances, cell.sensor)


def spread_translations(cell: Cell, base: FloatArray, mounts: Parameters) -> Stations:
    """Return four positions that span space, as far apart as is safe at all mounts."""
    span = cell.sensor.range_max - cell.sensor.range_min
    n = cell.bounds.plate.normal
    across = model.tangent_basis(n[None])[0].T
    for share in sorted(product(SHARES, SHARES), key=lambda one: -(one[0] * one[1] ** 2)):
        depth, move = 0.5 * span * share[0] * n, span * share[1] * across
        shift = TETRAHEDRON[:, :2] @ move + TETRAHEDRON[:, 2:] * depth
        stations = moved_about(cell, base, np.zeros((4, 3)), shift)
        safe = bool(inside(cell.workspace, stations).all())
        safe = safe and bool(safe_stations(mounts, stations, cell.sensor).all())
        if safe and within_arm(cell, stations).all():
            return stations
    raise InputError(
        "no translations that keep the beams of all mounts within the bounds in range"
        + ("" if cell.workspace.robot is None else ", and that the arm reaches"),
        "narrower bounds of mount and plate, a wider workspace or a sensor of longer range",
    )


def drawn_turns(cell: Cell, base: FloatArray, rng: np.random.Generator) -> Stations:
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
    return moved_about(cell, base, turns + spin[:, None] * v, span * (along + depth * n))


def moved_about(cell: Cell, base: FloatArray, turns: FloatArray, shift: FloatArray) -> Stations:
    """Return stations turned about the point where the beams are expected on the plate."""
    v = model.normalized(cell.bounds.directions.mean(axis=0))
    lever = base @ (cell.bounds.locations.mean(axis=0) + cell.middle * v)
    R = Rotation.from_rotvec(turns)
    t = cell.bounds.plate.point - R.apply(lever) + shift
    return Stations(R.as_matrix() @ base, t, np.zeros(len(t), dtype=np.intp))


def facing_plate(cell: Cell) -> FloatArray:
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


def within_arm(cell: Cell, stations: Stations) -> BoolArray:
    """Tell which stations the arm reaches; all without an arm."""
    robot, R, t = cell.workspace.robot, stations.world_R_hand, stations.world_t_hand
    return np.ones(len(t), bool) if robot is None else robot.reachable(R, t, cell.bounds.plate)


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


def safe_for_all(cell: Cell, stations: Stations, mounts: Sequence[Parameters]) -> Stations:
    """Return the stations in the workspace that are safe at all mounts, a few of them tried first."""
    stations = stations[inside(cell.workspace, stations)]
    for some in mounts:
        stations = stations[safe_stations(some, stations, cell.sensor).all(axis=0)]
    return stations[within_arm(cell, stations)]


def best_beside(
    cell: Cell,
    beliefs: Sequence[Belief],
    before: Sequence[FloatArray],
    stations: Stations,
    count: int,
) -> tuple[IntArray, float]:
    """Return stations that leave the least of what is known worst, and that standard deviation.

    Parameters
    ----------
    beliefs : K of Belief
        About several mounts within the bounds.
    before : K of (U, U)
        What is known before these stations, if the mount is that of the belief.
    """
    rows = np.stack([told(belief, stations) for belief in beliefs])
    weight = goal_rows(beliefs[0], Goal("E", cell.middle, 1.0), cell.middle)
    found = choose(rows, np.stack(before), weight, count, "E", exchange=False).candidates
    left = (after(C, own[found]) for C, own in zip(before, rows, strict=True))
    return found, max(math.sqrt(value(C, weight, "E")) for C in left)
