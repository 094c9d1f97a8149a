"""A six-axis arm with a fan of beams before a plate: kinematics, rays, stations where all beams read.

Nothing here is taken from the package: every range is cast as a ray onto the plate, where the ray
parameter and the two coordinates in the plate solve three linear equations.
"""

import math
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from handlaser_gtsam.arrays import BoolArray, FloatArray

DH_A = np.array([0.0, -0.425, -0.39225, 0.0, 0.0, 0.0])
DH_D = np.array([0.089159, 0.0, 0.0, 0.10915, 0.09465, 0.0823])
DH_ALPHA = np.array([0.5, 0.0, 0.0, 0.5, -0.5, 0.0]) * math.pi
"""Link lengths [m], offsets [m] and twists [rad] of a UR5."""
POSTURE = np.radians([0.0, -90.0, 100.0, -100.0, -90.0, 0.0])
PLANE_SPREAD = np.radians([60.0, 15.0, 15.0, 20.0, 20.0, 90.0])
STATION_SPREAD = np.radians([12.0, 8.0, 10.0, 25.0, 25.0, 90.0])
"""Joint angles of work, how far the posture before each plane differs from them, and how far the
stations there go from that posture where the motion is 1."""
NEAREST, FARTHEST = 0.15, 0.45
MOST_INCIDENCE = math.radians(60.0)
HALF_PLATE = 0.4
"""Ranges [m], angles of incidence and half the side of the plate [m] at which a station counts."""

Beams = tuple[FloatArray, FloatArray]
"""Locations r and directions v (B, 3), hand frame [m]."""
Poses = tuple[FloatArray, FloatArray]
"""R (N, 3, 3) and t (N, 3) of the hand, world frame [m]."""


@dataclass(frozen=True, slots=True)
class Plates:
    """Centres (M, 3) and axes (M, 3, 3) of the plate at every station."""

    centres: FloatArray
    axes: FloatArray


def links(joints: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the frames before each joint and of the hand: R (N, 7, 3, 3) and p (N, 7, 3) [m]."""
    count = len(joints)
    R, p = np.zeros((count, 7, 3, 3)), np.zeros((count, 7, 3))
    R[:, 0] = np.eye(3)
    for i in range(6):
        c, s = np.cos(joints[:, i]), np.sin(joints[:, i])
        ca, sa = math.cos(DH_ALPHA[i]), math.sin(DH_ALPHA[i])
        step = np.zeros((count, 3, 3))
        step[:, 0, 0], step[:, 0, 1], step[:, 0, 2] = c, -s * ca, s * sa
        step[:, 1, 0], step[:, 1, 1], step[:, 1, 2] = s, c * ca, -c * sa
        step[:, 2, 1], step[:, 2, 2] = sa, ca
        along = np.stack((DH_A[i] * c, DH_A[i] * s, np.full(count, DH_D[i])), axis=1)
        R[:, i + 1] = R[:, i] @ step
        p[:, i + 1] = p[:, i] + (R[:, i] @ along[:, :, None])[:, :, 0]
    return R, p


def forward(joints: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the hand pose of joint angles (N, 6) [rad]: R (N, 3, 3) and t (N, 3) [m]."""
    R, p = links(joints)
    return R[:, 6], p[:, 6]


def pose_covariance(joints: FloatArray, sigma: float) -> FloatArray:
    """Return the covariance (N, 6, 6) of the hand pose, from that of independent joint angles.

    The geometric Jacobian in the hand frame; (rx, ry, rz, x, y, z) about and along the axes of the
    hand [rad, m], the order of `gtsam.Pose3`.

    Parameters
    ----------
    joints : (N, 6)
        Commanded joint angles [rad].
    sigma : float
        Standard deviation of each [rad].
    """
    R, p = links(joints)
    axis = R[:, :6, :, 2]
    velocity = np.cross(axis, p[:, 6:] - p[:, :6])
    J = np.concatenate((axis @ R[:, 6], velocity @ R[:, 6]), axis=2)
    S: FloatArray = sigma**2 * np.swapaxes(J, 1, 2) @ J
    return 0.5 * (S + np.swapaxes(S, 1, 2))


def cast(
    origin: FloatArray, direction: FloatArray, centre: FloatArray, axes: FloatArray
) -> FloatArray:
    """Return (N, 3): where N rays meet their plates, (range, two coordinates in the plate) [m].

    Solves origin + s direction = centre + u axis_1 + w axis_2 for (s, u, w).
    """
    columns = np.broadcast_arrays(direction, -axes[..., 0], -axes[..., 1])
    found: FloatArray = np.linalg.solve(np.stack(columns, axis=-1), (centre - origin)[..., None])
    return found[..., 0]


def mounts(count: int, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """Return beams 30 to 50 mm from the axis of the flange that fan out by 5 to 15 deg."""
    around = 2.0 * math.pi * np.arange(count) / count + rng.uniform(0.0, 2.0 * math.pi)
    radius, height = rng.uniform(0.03, 0.05, count), rng.uniform(0.0, 0.03, count)
    tilt = rng.uniform(math.radians(5.0), math.radians(15.0), count)
    towards = around + rng.uniform(-0.6, 0.6, count)
    r = np.stack((radius * np.cos(around), radius * np.sin(around), height), axis=1)
    sine = np.sin(tilt)
    v = np.stack((sine * np.cos(towards), sine * np.sin(towards), np.cos(tilt)), axis=1)
    return r, v


def stations_of(
    planes: int, stations: int, motion: float, beams: Beams, rng: np.random.Generator
) -> tuple[FloatArray, Plates]:
    """Return joint angles and the plate of every station: random ones at which every beam reads.

    `stations` before each of the planes, with `motion` as a part of `STATION_SPREAD`.
    """
    spread = PLANE_SPREAD * rng.uniform(-1.0, 1.0, (planes, 6))
    postures = POSTURE + spread
    centres, axes = plates_before(postures, rng)
    joints = np.full((planes, stations, 6), np.nan)
    found = np.zeros(planes, dtype=int)
    while (found < stations).any():
        wanted = np.repeat(np.flatnonzero(found < stations), 6 * stations)
        away = motion * STATION_SPREAD * rng.uniform(-1.0, 1.0, (len(wanted), 6))
        tries = postures[wanted] + away
        good = _seen(forward(tries), beams, Plates(centres[wanted], axes[wanted]))
        for p in np.unique(wanted):
            new = tries[good & (wanted == p)][: stations - found[p]]
            joints[p, found[p] : found[p] + len(new)] = new
            found[p] += len(new)
    each = np.repeat(np.arange(planes), stations)
    return joints.reshape(-1, 6), Plates(centres[each], axes[each])


def plates_before(postures: FloatArray, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """Return centres and axes of the plate before the hand at each posture, tilted to all sides."""
    count = len(postures)
    R, t = forward(postures)
    distance = rng.uniform(0.27, 0.33, count)
    azimuth = 2.0 * math.pi * np.arange(count) / count + rng.uniform(-0.4, 0.4, count)
    tilt = rng.uniform(math.radians(10.0), math.radians(30.0), count)
    vector = tilt[:, None] * np.stack((np.cos(azimuth), np.sin(azimuth), 0.0 * tilt), axis=1)
    return t + distance[:, None] * R[:, :, 2], R @ Rotation.from_rotvec(vector).as_matrix()


def rays(pose: Poses, beams: Beams) -> tuple[FloatArray, FloatArray]:
    """Return origins and directions (N, B, 3) of the beams in the world frame."""
    R, t = pose
    r, v = beams
    turned = np.swapaxes(R, 1, 2)
    return t[:, None] + r @ turned, v @ turned


def hits(pose: Poses, beams: Beams, plates: Plates) -> FloatArray:
    """Return (N, B, 3): range and coordinates in the plate [m] of every beam."""
    return cast(*rays(pose, beams), plates.centres[:, None], plates.axes[:, None])


def tangent_squared(pose: Poses, beams: Beams, plates: Plates) -> FloatArray:
    """Return tan^2 of the angles of incidence (N, B): what lies in the plate, over what does not."""
    _, direction = rays(pose, beams)
    parts = direction @ plates.axes
    found: FloatArray = (parts[..., 0] ** 2 + parts[..., 1] ** 2) / parts[..., 2] ** 2
    return found


def _seen(pose: Poses, beams: Beams, plates: Plates) -> BoolArray:
    """Tell at which poses (N,) every beam meets the plate within its range, and not too flat."""
    hit = hits(pose, beams, plates)
    good = (hit[..., 0] >= NEAREST) & (hit[..., 0] <= FARTHEST)
    good &= (np.abs(hit[..., 1:]) <= HALF_PLATE).all(axis=-1)
    good &= tangent_squared(pose, beams, plates) <= math.tan(MOST_INCIDENCE) ** 2
    return np.asarray(good.all(axis=1))
