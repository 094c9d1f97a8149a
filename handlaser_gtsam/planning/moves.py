"""Moves of the hand before any calibration, and at which of them all mounts within bounds can read."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
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
from .belief import UNKNOWN_ANGLE, UNKNOWN_LENGTH, UNKNOWN_PLANE, Belief
from .bounds import Bounds
from .choice import choose, value
from .goal import Goal
from .information import station_rows, updated
from .plate import SIDES
from .task import goal_rows
from .workspace import Workspace, inside, least_cosine, require_facing, require_range

MOUNTS = 2000
"""Mounts drawn from the bounds: no station leaves the sensor's limits at any of them, so that one in a
thousand others does at most."""
FIRST_MOUNTS = 50
"""Mounts at which every turn is tried first: they refuse nearly all that are refused."""
READINGS_AT_ONCE = 20_000
"""Readings predicted at a time: more would leave the processor's cache."""
COMPARED_MOUNTS = 4
"""Mounts at which stations are compared by what they say: the worst of them counts."""
TRANSLATION_SHARES = (1.0, 0.7, 0.5, 0.35, 0.2, 0.1)
"""Parts of the largest translations that are tried: each is about 0.7 of the one before."""
TETRAHEDRON = np.array([[1.0, 1.0, 1.0], [1.0, -1.0, -1.0], [-1.0, 1.0, -1.0], [-1.0, -1.0, 1.0]])
"""Four positions that span space evenly."""
TRIED_TURNS = 1500
"""Turns that are tried: of a narrow workspace a tenth is safe."""
PARALLEL = 1e-12
"""Sine of the angle between beams and normal below which they are parallel, but for rounding."""
NOISE_PART = 1e-3
"""A sensor whose noise is not known errs by this part of its range, as cheap ones do."""
UNIFORM = 1.0 / math.sqrt(3.0)
"""Standard deviation of a uniform number over its half-width."""
KNOWN_EXACTLY = 1e-9
"""Standard deviation of what is known exactly: none that matters, and not zero."""


@dataclass(frozen=True, slots=True)
class Blind:
    """What is known before any calibration.

    Attributes
    ----------
    bounds : Bounds
    sensor : Sensor
    workspace : Workspace
    variances : Variances
        What readings are expected to err by.
    """

    bounds: Bounds
    sensor: Sensor
    workspace: Workspace
    variances: Variances

    @property
    def middle(self) -> float:
        """The middle of the sensor's range [m]."""
        return 0.5 * (self.sensor.range_min + self.sensor.range_max)

    def belief(self, at: Parameters) -> Belief:
        """Return what a calibration would start from about some beams and a plate: next to nothing.

        It does not use the bounds; they are the `spread`.
        """
        bounds, plate, sensor = self.bounds, self.bounds.plate, self.sensor
        k = sensor.linearity * np.array([1.0, 1.0 / max(abs(sensor.range_max), KNOWN_EXACTLY)])
        unknown = np.tile([*[UNKNOWN_LENGTH] * 3, *[UNKNOWN_ANGLE] * 2, *k], len(bounds.locations))
        within = [*[UNIFORM * bounds.location_within] * 3, *[0.5 * bounds.cone] * 2, *k]
        placed = [0.5 * plate.tilt, 0.5 * plate.tilt, UNIFORM * plate.within]
        spread = np.append(np.tile(within, len(bounds.locations)), placed)
        return Belief(
            at,
            np.diag(np.append(unknown, UNKNOWN_PLANE) ** 2),
            model.tangent_basis(at.directions),
            model.tangent_basis(at.normals),
            plate.point[None],
            self.variances,
            ("plate",),
            np.diag(np.maximum(spread, KNOWN_EXACTLY) ** 2),
        )

    def facing(self) -> FloatArray:
        """Return the orientation nearest to home at which the beams face the plate.

        As far as half of the largest turn: the other half is left for the motion.
        """
        home, n = self.workspace.home, self.bounds.plate.normal
        v = home @ model.normalized(self.bounds.directions.mean(axis=0))
        axis = np.cross(v, n)
        size = float(np.linalg.norm(axis))
        if size < PARALLEL:
            return home
        angle = min(math.atan2(size, float(v @ n)), 0.5 * self.workspace.largest_turn)
        return np.asarray(Rotation.from_rotvec(axis / size * angle).as_matrix() @ home)

    def moved(self, turns: FloatArray, shift: FloatArray) -> Stations:
        """Return stations that are turned from `facing`, and shifted.

        They turn about the point where the beams are expected on the plate, so that readings change
        little.
        """
        facing, bounds = self.facing(), self.bounds
        v = model.normalized(bounds.directions.mean(axis=0))
        lever = facing @ (bounds.locations.mean(axis=0) + self.middle * v)
        R = Rotation.from_rotvec(turns)
        t = bounds.plate.point - R.apply(lever) + shift
        return Stations(R.as_matrix() @ facing, t, np.zeros(len(t), dtype=np.intp))

    def translations(self, mounts: Parameters) -> Stations:
        """Return four positions that span space, as far apart as is safe at all mounts."""
        span, n = self.sensor.range_max - self.sensor.range_min, self.bounds.plate.normal
        across = model.tangent_basis(n[None])[0].T
        shares = product(TRANSLATION_SHARES, TRANSLATION_SHARES)
        for deep, wide in sorted(shares, key=lambda pair: -(pair[0] * pair[1] ** 2)):
            depth = TETRAHEDRON[:, 2:] * (0.5 * span * deep * n)
            stations = self.moved(
                np.zeros((4, 3)), TETRAHEDRON[:, :2] @ (span * wide * across) + depth
            )
            if len(self.safe(stations, [mounts])) == 4:
                return stations
        raise InputError(
            "no translations that keep the beams of all mounts within the bounds in range"
            + ("" if self.workspace.robot is None else ", and that the arm reaches"),
            "narrower bounds of mount and plate, a wider workspace or a sensor of longer range",
        )

    def turns(self, rng: np.random.Generator) -> Stations:
        """Return turns to several sides, about the beams too, each with a translation."""
        span, n = self.sensor.range_max - self.sensor.range_min, self.bounds.plate.normal
        v = self.facing() @ model.normalized(self.bounds.directions.mean(axis=0))
        across = model.tangent_basis(v[None])[0].T
        side = 2.0 * math.pi * rng.integers(SIDES, size=TRIED_TURNS) / SIDES
        size = self.workspace.largest_turn * rng.uniform(size=TRIED_TURNS)
        spin = rng.choice([-0.5, 0.0, 0.5], size=TRIED_TURNS) * size
        tilt = size[:, None] * (
            np.cos(side)[:, None] * across[0] + np.sin(side)[:, None] * across[1]
        )
        along = rng.uniform(-1.0, 1.0, (TRIED_TURNS, 2)) @ model.tangent_basis(n[None])[0].T
        depth = rng.uniform(-0.5, 0.5, (TRIED_TURNS, 1))
        return self.moved(tilt + spin[:, None] * v, span * (along + depth * n))

    def safe(self, stations: Stations, draws: Sequence[Parameters]) -> Stations:
        """Return the stations of the workspace that are safe at all mounts, draw after draw."""
        stations = stations[inside(self.workspace, stations)]
        for mounts in draws:
            safe = safe_stations(mounts, stations, self.sensor)
            stations = stations[np.flatnonzero(safe.all(axis=0))]
        if self.workspace.robot is None:
            return stations
        R, t = stations.world_R_hand, stations.world_t_hand
        return stations[self.workspace.robot.reachable(R, t, self.bounds.plate)]

    def best(
        self,
        beliefs: Sequence[Belief],
        before: Sequence[FloatArray],
        stations: Stations,
        count: int,
    ) -> tuple[IntArray, float]:
        """Return the stations after which the largest standard deviation is least, and it.

        It is the largest over directions [rad] and over locations as parts of the middle of the
        sensor's range.

        Parameters
        ----------
        beliefs : K of Belief
            About several mounts within the bounds.
        before : K of (U, U)
            Covariance before these stations, about the same mount.
        stations : Stations
        count : int
        """
        rows = np.stack([station_rows(belief, stations) for belief in beliefs])
        weight = goal_rows(beliefs[0], Goal("E", self.middle, 1.0), self.middle)
        best = choose(rows, np.stack(before), weight, count, "E", exchange=False).candidates
        after = (updated(C, each[best]) for C, each in zip(before, rows, strict=True))
        return best, max(math.sqrt(value(C, weight, "E")) for C in after)


def assumed(bounds: Bounds, sensor: Sensor, workspace: Workspace, noise: Noise | None) -> Blind:
    """Return what is known before any calibration; noise that is not stated is as its prior says.

    Raises
    ------
    InputError
        The sensor's range is not stated, or no beam can face the plate.
    """
    require_range(sensor)
    require_facing("the plate", workspace, bounds.directions, bounds.plate.normal)
    noise = Noise() if noise is None else noise
    sigma = noise.range_sigma
    if sigma is None:
        sigma = NOISE_PART * (sensor.range_max - sensor.range_min)
    shift, turn = noise.pose_translation_sigma, noise.pose_rotation_sigma
    if noise.pose_covariance is None:
        shift = noise.pose_translation_prior if shift is None else shift
        turn = noise.pose_rotation_prior if turn is None else turn
    stated = replace(noise, pose_translation_sigma=shift, pose_rotation_sigma=turn)
    pose = stated.pose_covariances(1).mean(axis=0)
    sigmas = np.full(len(bounds.locations), sigma)
    variances = Variances(sigmas, noise.incidence_sigma, pose[None] if pose.any() else None)
    return Blind(bounds, sensor, workspace, variances)


def safe_stations(mounts: Parameters, stations: Stations, sensor: Sensor) -> BoolArray:
    """Tell at which stations all readings of each mount are within the sensor's limits, (K, M).

    `mounts` are K draws from bounds: the same number of beams each, and a plane.
    """
    R, t = stations.world_R_hand, stations.world_t_hand
    n, b = mounts.normals, mounts.offsets
    r, v = (x.reshape(len(n), -1, 3) for x in (mounts.locations, mounts.directions))
    good = np.empty((len(n), len(t)), dtype=bool)
    size = max(READINGS_AT_ONCE // max(len(t) * r.shape[1], 1), 1)
    for some in (slice(k, k + size) for k in range(0, len(n), size)):
        n_hand = (n[some] @ R.transpose(1, 0, 2).reshape(3, -1)).reshape(-1, len(t), 3)
        cosine = n_hand @ np.swapaxes(v[some], 1, 2)
        height = n_hand @ np.swapaxes(r[some], 1, 2) + (n[some] @ t.T + b[some, None])[..., None]
        with np.errstate(all="ignore"):
            within = sensor.can_read(-height / cosine) & (cosine >= least_cosine(sensor))
        good[some] = within.all(axis=2)
    return good
