r"""A first motion, before anything is known but bounds: translations, then turns.

At the home orientation the hand makes four positions that span space, so that the plate's normal
follows in closed form (Lemma 1 of Wei and Hirzinger); it then turns to both sides about two axes across
the beams, with a translation at two of those orientations (Lemma 2). It turns about the point where the
beams are expected on the plate, so that readings change little. How far it moves and turns is a choice
among many: the one that tells most of those at which the beams of nearly all mounts within the bounds
stay within the sensor's limits.
"""

import math
from dataclasses import dataclass
from itertools import product

import numpy as np
from scipy.spatial.transform import Rotation

from .. import model
from ..arrays import FloatArray
from ..data.parameters import Parameters
from ..errors import GrazingBeamError, InputError
from ..model.sensor import Sensor
from ..model.weighting import Variances
from ..simulation.simulate import Stations
from .bounds import Bounds
from .information import outlook, updated
from .workspace import STEEPEST, Workspace

MOUNTS = 400
"""Mounts drawn from the bounds, at which every motion is tried."""
SAFE = 0.997
"""Part of the mounts at which all readings are within the limits: of a hundred others, 99 are."""
JUDGED = 5
"""Mounts at which the motions that are safe are compared by what they tell."""
SHARES = (0.1, 0.2, 0.35, 0.5, 0.7, 1.0)
"""Of the largest move and the largest turn that are tried."""
TETRAHEDRON = np.array([[1.0, 1.0, 1.0], [1.0, -1.0, -1.0], [-1.0, 1.0, -1.0], [-1.0, -1.0, 1.0]])


@dataclass(frozen=True, slots=True)
class Motion:
    """A first motion.

    Attributes
    ----------
    stations : Stations
    move, depth : float
        Size of the translations along the plate and across it [m].
    turn : float
        [rad]
    safe : float
        Part of the mounts tried whose readings are all within the limits.
    """

    stations: Stations
    move: float
    depth: float
    turn: float
    safe: float


def blind_motion(
    bounds: Bounds,
    sensor: Sensor,
    workspace: Workspace,
    variances: Variances,
    rng: np.random.Generator | None = None,
) -> Motion:
    """Return a motion that determines any mount within the bounds.

    Raises
    ------
    InputError
        The sensor's range is not stated, or no motion is safe for nearly all mounts.
    """
    if not math.isfinite(sensor.range_max):
        raise InputError("no range of the sensor", "range_mm in the table [sensor] of the rig file")
    rng = np.random.default_rng(0) if rng is None else rng
    mounts = [bounds.draw(rng) for _ in range(MOUNTS)]
    span = sensor.range_max - sensor.range_min
    best: Motion | None = None
    most = -np.inf
    for depth, move, turn in product(SHARES, SHARES, SHARES):
        sizes = 0.5 * span * depth, 2.0 * span * move, workspace.largest_turn * turn
        stations = _motion(bounds, sensor, workspace, *sizes)
        if not workspace.holds(stations).all():
            continue
        safe = _safe_part(mounts, stations, sensor)
        if safe < SAFE:
            continue
        told = _told(bounds, mounts[:JUDGED], stations, variances, sensor)
        if told > most:
            best, most = Motion(stations, sizes[1], sizes[0], sizes[2], safe), told
    if best is None:
        raise InputError(
            "no motion at which the beams of nearly all mounts within the bounds stay in range",
            "narrower bounds of mount and plate, a wider workspace or a sensor of longer range",
        )
    return best


def _motion(
    bounds: Bounds, sensor: Sensor, workspace: Workspace, depth: float, move: float, turn: float
) -> Stations:
    """Return 11 stations: 4 + 2 translations, turns to both sides about two axes, and one of both."""
    n = model.normalized(bounds.plate_normal)
    base = _facing(workspace, bounds, n, turn)
    v = base @ model.normalized(bounds.directions.mean(axis=0))
    foot = bounds.plate_point
    across = model.tangent_basis(n[None])[0]
    steps = TETRAHEDRON[:, :2] @ (0.5 * move * across.T) + 0.5 * depth * TETRAHEDRON[:, 2:] * n
    axes = model.tangent_basis(v[None])[0].T
    x, y = turn * axes
    turns = [np.zeros(3)] * 4 + [x, x, -x, y, y, -y, (x + y) / math.sqrt(2.0) + 0.5 * turn * v]
    shifts = [*steps, steps[0], steps[3], steps[1], steps[1], steps[2], steps[0], steps[2]]
    middle = 0.5 * (sensor.range_min + sensor.range_max)
    lever = base @ bounds.locations.mean(axis=0) + middle * v
    R = Rotation.from_rotvec(turns)
    t = foot - R.apply(lever) + np.array(shifts)
    return Stations(R.as_matrix() @ base, t, np.zeros(len(t), dtype=np.intp))


def _facing(workspace: Workspace, bounds: Bounds, n: FloatArray, turn: float) -> FloatArray:
    """Return the orientation nearest to home at which the beams face a plate with normal n (3,).

    As far as the workspace allows, with room for further turns.
    """
    v = workspace.home @ model.normalized(bounds.directions.mean(axis=0))
    axis = np.cross(v, n)
    size = float(np.linalg.norm(axis))
    if size < 1e-12:
        return workspace.home
    angle = min(math.atan2(size, float(v @ n)), max(workspace.largest_turn - 1.15 * turn, 0.0))
    return np.asarray(Rotation.from_rotvec(axis / size * angle).as_matrix() @ workspace.home)


def _safe_part(mounts: list[Parameters], stations: Stations, sensor: Sensor) -> float:
    """Return the part of the mounts whose readings are all within the sensor's limits."""
    R, t = stations.world_R_hand, stations.world_t_hand
    r = np.stack([one.locations for one in mounts])
    v = np.stack([one.directions for one in mounts])
    n = np.concatenate([one.normals for one in mounts])
    b = np.concatenate([one.offsets for one in mounts])
    n_hand = np.einsum("mji,kj->kmi", R, n)
    cosine = np.einsum("kmi,kbi->kmb", n_hand, v)
    height = np.einsum("kmi,kbi->kmb", n_hand, r) + (n @ t.T + b[:, None])[..., None]
    with np.errstate(all="ignore"):
        s = -height / cosine
        good = sensor.can_read(s) & (cosine >= math.cos(min(sensor.max_incidence, STEEPEST)))
    return float(good.all(axis=(1, 2)).mean())


def _told(
    bounds: Bounds,
    mounts: list[Parameters],
    stations: Stations,
    variances: Variances,
    sensor: Sensor,
) -> float:
    """Return how much a motion tells of the beams: minus the logarithm of the volume left."""
    told = 0.0
    for at in mounts:
        belief = bounds.belief(at, variances, sensor.linearity)
        try:
            rows = outlook(belief, stations).rows
        except GrazingBeamError:
            return -np.inf
        C = belief.covariance
        for one in rows:
            C = updated(C, one)
        told -= float(np.linalg.slogdet(C[: belief.of_beams, : belief.of_beams])[1])
    return told
