r"""Relations that are known beside the readings: between planes, of a sphere, a body, or mounts.

Each returns a `Relation` whose rows are in standard deviations. Planes are n . (x - c) + h = 0 with the
normal n away from the sensors; p = c - h n is the foot of the centre c on the plane. sigma is a length
[m] and sigma_angle an angle [rad].
"""

import numpy as np
from scipy.spatial.transform import Rotation

from ..arrays import FloatArray
from .families import (
    BEAM,
    DIRECTION,
    LOCATION,
    MOUNT_DIM,
    OF_DIRECTION,
    PLANE,
    POSE,
    Family,
    Motion,
    bases,
    register,
)
from .geometry import skew
from .relations import Relation
from .sensors.mounted import SENSOR
from .targets.point import POINT
from .targets.sphere import SPHERE

BODY = register(Family("body", (Motion(),), POSE.coordinates, POSE.powers))
"""The pose of a rigid body whose planes are known in its own frame."""
DIRECTIONS = {PLANE.name: PLANE.places[0], BEAM.name: OF_DIRECTION}
"""Where the unit vector stands among the numbers of a variable."""
TURNS = {PLANE.name: PLANE.tangents[0], BEAM.name: DIRECTION}
"""Its tangent coordinates."""
CENTRES = {SPHERE.name: SPHERE.dim, POINT.name: POINT.dim}
"""Families whose first three numbers are a position, and their dimension."""


def at_an_angle(family: str, first: int, second: int, angle: float, sigma: float) -> Relation:
    """Return that two planes, or two beams, are at an angle [rad], neither 0 nor 180 degrees."""
    at, turn = DIRECTIONS[family], TURNS[family]
    dim = {PLANE.name: PLANE.dim, BEAM.name: BEAM.dim}[family]

    def rule(x: FloatArray, y: FloatArray) -> tuple[FloatArray, tuple[FloatArray, ...]]:
        n, m, scale = x[:, at], y[:, at], sigma * np.sin(angle)
        by_n, by_m = np.zeros((2, len(n), 1, dim))
        by_n[:, 0, turn] = np.einsum("ki,kij->kj", m, bases(n))
        by_m[:, 0, turn] = np.einsum("ki,kij->kj", n, bases(m))
        e = np.einsum("ki,ki->k", n, m)[:, None] - np.cos(angle)
        return e / scale, (by_n / scale, by_m / scale)

    return Relation(((family, first), (family, second)), rule)


def parallel(
    first: int, second: int, distance: float, sigma: float, sigma_angle: float
) -> Relation:
    """Return that two planes are parallel at a distance [m], seen from one side or from two."""

    def rule(x: FloatArray, y: FloatArray) -> tuple[FloatArray, tuple[FloatArray, ...]]:
        n, h, c = x[:, :3], x[:, 3], x[:, 4:]
        m, g, b = y[:, :3], y[:, 3], y[:, 4:]
        N, M = bases(n), bases(m)
        off = c - h[:, None] * n - b
        q = np.einsum("ki,ki->k", m, off) + g
        side = np.where(q < 0.0, -1.0, 1.0)
        turn = np.einsum("kij,ki->kj", N, m)
        cosine = np.einsum("ki,ki->k", n, m)
        by_x, by_y = np.zeros((2, len(n), 3, 3))
        by_x[:, :2, :2] = -cosine[:, None, None] * np.eye(2) / sigma_angle
        by_y[:, :2, :2] = np.einsum("kij,kil->kjl", N, M) / sigma_angle
        scale = (side / sigma)[:, None]
        by_x[:, 2, :2] = -h[:, None] * turn * scale
        by_x[:, 2, 2] = -cosine * scale[:, 0]
        by_y[:, 2, :2] = np.einsum("kij,ki->kj", M, off) * scale
        by_y[:, 2, 2] = scale[:, 0]
        e = np.column_stack((turn / sigma_angle, (side * q - distance) / sigma))
        return e, (by_x, by_y)

    return Relation(((PLANE.name, first), (PLANE.name, second)), rule)


def along(plane: int, direction: FloatArray, sigma: float) -> Relation:
    """Return that the normal of a plane, a floor say, lies along a direction in the world."""
    T = bases(direction / np.linalg.norm(direction))

    def rule(x: FloatArray) -> tuple[FloatArray, tuple[FloatArray, ...]]:
        by_n = np.zeros((len(x), 2, 3))
        by_n[..., :2] = T.T @ bases(x[:, :3]) / sigma
        return x[:, :3] @ T / sigma, (by_n,)

    return Relation(((PLANE.name, plane),), rule)


def upright(plane: int, direction: FloatArray, sigma: float) -> Relation:
    """Return that a plane, a wall say, contains a direction in the world."""
    g = direction / np.linalg.norm(direction)

    def rule(x: FloatArray) -> tuple[FloatArray, tuple[FloatArray, ...]]:
        by_n = np.zeros((len(x), 1, 3))
        by_n[:, 0, :2] = np.einsum("i,kij->kj", g, bases(x[:, :3])) / sigma
        return (x[:, :3] @ g / sigma)[:, None], (by_n,)

    return Relation(((PLANE.name, plane),), rule)


def plane_at(
    plane: int, normal: FloatArray, offset: float, sigma: float, sigma_angle: float
) -> Relation:
    """Return that a plane is normal . x + offset = 0 [m] in the world."""
    length = float(np.linalg.norm(normal))
    m, b = normal / length, offset / length
    T = bases(m)

    def rule(x: FloatArray) -> tuple[FloatArray, tuple[FloatArray, ...]]:
        n, h, c = x[:, :3], x[:, 3:4], x[:, 4:]
        N = bases(n)
        by = np.zeros((len(x), 3, 3))
        by[:, :2, :2] = T.T @ N / sigma_angle
        by[:, 2, :2] = -h * np.einsum("i,kij->kj", m, N) / sigma
        by[:, 2, 2] = -(n @ m) / sigma
        e = np.column_stack((n @ T / sigma_angle, ((c - h * n) @ m + b) / sigma))
        return e, (by,)

    return Relation(((PLANE.name, plane),), rule)


def radius(sphere: int, value: float, sigma: float) -> Relation:
    """Return that a sphere has a radius [m]."""

    def rule(x: FloatArray) -> tuple[FloatArray, tuple[FloatArray, ...]]:
        by = np.zeros((len(x), 1, SPHERE.dim))
        by[:, 0, 3] = 1.0 / sigma
        return (x[:, 3:4] - value) / sigma, (by,)

    return Relation(((SPHERE.name, sphere),), rule)


def position(family: str, member: int, place: FloatArray, sigma: float) -> Relation:
    """Return that a point, or the centre of a sphere, is at a place [m] in the world."""

    def rule(x: FloatArray) -> tuple[FloatArray, tuple[FloatArray, ...]]:
        by = np.broadcast_to(np.eye(3, CENTRES[family]) / sigma, (len(x), 3, CENTRES[family]))
        return (x[:, :3] - place) / sigma, (by,)

    return Relation(((family, member),), rule)


def distance(
    first: tuple[str, int], second: tuple[str, int], value: float, sigma: float
) -> Relation:
    """Return that two points, or centres of spheres, are at a distance [m]."""

    def rule(x: FloatArray, y: FloatArray) -> tuple[FloatArray, tuple[FloatArray, ...]]:
        off = x[:, :3] - y[:, :3]
        length = np.linalg.norm(off, axis=1)
        u = off / length[:, None] / sigma
        by_x, by_y = (np.zeros((len(x), 1, CENTRES[f])) for f, _ in (first, second))
        by_x[:, 0, :3], by_y[:, 0, :3] = u, -u
        return ((length - value) / sigma)[:, None], (by_x, by_y)

    return Relation((first, second), rule)


def face(
    plane: int, body: int, normal: FloatArray, offset: float, sigma: float, sigma_angle: float
) -> Relation:
    """Return that a plane is a face of a body: outward normal . x = offset [m] in its frame."""
    length = float(np.linalg.norm(normal))
    m, d = normal / length, offset / length
    T = bases(m)

    def rule(x: FloatArray, y: FloatArray) -> tuple[FloatArray, tuple[FloatArray, ...]]:
        n, h, c = x[:, :3], x[:, 3:4], x[:, 4:]
        R, t = y[:, :9].reshape(-1, 3, 3), y[:, 9:]
        N, q = bases(n), np.einsum("kij,ki->kj", R, n)
        foot = np.einsum("kij,ki->kj", R, c - h * n - t)
        RN = np.einsum("kij,kil->kjl", R, N)
        by_plane, by_body = np.zeros((len(x), 3, 3)), np.zeros((len(x), 3, 6))
        by_plane[:, :2, :2] = T.T @ RN / sigma_angle
        by_plane[:, 2, :2] = -h * np.einsum("i,kil->kl", m, RN) / sigma
        by_plane[:, 2, 2] = -(q @ m) / sigma
        by_body[:, :2, :3] = T.T @ skew(q) / sigma_angle
        by_body[:, 2, :3] = m @ skew(foot) / sigma
        by_body[:, 2, 3:] = -m / sigma
        e = np.column_stack((q @ T / sigma_angle, (foot @ m - d) / sigma))
        return e, (by_plane, by_body)

    return Relation(((PLANE.name, plane), (BODY.name, body)), rule)


def held(body: int, pose: FloatArray, faces: FloatArray, sigma: float) -> Relation | None:
    """Return that a body stays where it is along what its faces leave open; None where nothing is.

    Two faces that meet leave a shift along their edge, parallel ones two shifts and a turn; where the
    body is along these makes no difference to anything else.

    Parameters
    ----------
    body : int
    pose : (12,)
        Where it is.
    faces : (F, 4)
        Their normals and offsets in its frame.
    sigma : float
        How far it may go [rad], [m]: it has to be less than what counts as undetermined.
    """
    normals = faces[:, :3] / np.linalg.norm(faces[:, :3], axis=1)[:, None]
    turns = np.concatenate((skew(normals).reshape(-1, 3), np.zeros((len(faces), 3))))
    shifts = np.concatenate((np.zeros((3 * len(faces), 3)), normals))
    _, size, axes = np.linalg.svd(np.hstack((turns, shifts)))
    size = np.append(size, np.zeros(6))[:6]
    open_ = axes[size < 1e-6]
    if not len(open_):
        return None
    R0, t0 = pose[:9].reshape(3, 3), pose[9:]

    def rule(x: FloatArray) -> tuple[FloatArray, tuple[FloatArray, ...]]:
        E = R0.T @ x[:, :9].reshape(-1, 3, 3)
        turn = Rotation.from_matrix(E).as_rotvec()
        by = np.zeros((len(x), 6, 6))
        by[:, :3, :3], by[:, 3:, 3:] = _turned_by(turn), E
        e = np.concatenate((turn, (x[:, 9:] - t0) @ R0), axis=1)
        return e @ open_.T / sigma, (open_ @ by / sigma,)

    return Relation(((BODY.name, body),), rule)


def mounted_at(sensor: int, pose: FloatArray, sigma: float, sigma_angle: float) -> Relation:
    """Return that a sensor sits where a drawing has it: hand_T_sensor (4, 4)."""

    def rule(x: FloatArray) -> tuple[FloatArray, tuple[FloatArray, ...]]:
        R, t = x[:, :9].reshape(-1, 3, 3), x[:, 9:12]
        turn = Rotation.from_matrix(pose[:3, :3].T @ R).as_rotvec()
        by = np.zeros((len(x), 6, SENSOR.dim))
        by[:, :3, :3] = _turned_by(turn) / sigma_angle
        by[:, 3:, 3:6] = pose[:3, :3].T @ R / sigma
        e = np.concatenate((turn / sigma_angle, (t - pose[:3, 3]) @ pose[:3, :3] / sigma), axis=1)
        return e, (by,)

    return Relation(((SENSOR.name, sensor),), rule)


def mounted_together(
    first: int, second: int, pose: FloatArray, sigma: float, sigma_angle: float
) -> Relation:
    """Return that two sensors sit at a known pose to each other: first_T_second (4, 4)."""

    def rule(x: FloatArray, y: FloatArray) -> tuple[FloatArray, tuple[FloatArray, ...]]:
        R, Q = (z[:, :9].reshape(-1, 3, 3) for z in (x, y))
        E = np.swapaxes(R, 1, 2) @ Q
        t = np.einsum("kij,ki->kj", R, y[:, 9:12] - x[:, 9:12])
        turn = Rotation.from_matrix(pose[:3, :3].T @ E).as_rotvec()
        by_x, by_y = np.zeros((2, len(x), 6, SENSOR.dim))
        by_y[:, :3, :3] = _turned_by(turn) / sigma_angle
        by_x[:, :3, :3] = -by_y[:, :3, :3] @ np.swapaxes(E, 1, 2)
        by_x[:, 3:, :3], by_x[:, 3:, 3:6] = skew(t) / sigma, -np.eye(3) / sigma
        by_y[:, 3:, 3:6] = E / sigma
        e = np.concatenate((turn / sigma_angle, (t - pose[:3, 3]) / sigma), axis=1)
        return e, (by_x, by_y)

    return Relation(((SENSOR.name, first), (SENSOR.name, second)), rule)


def beam_at(
    beam: int, location: FloatArray, direction: FloatArray, sigma: float, sigma_angle: float
) -> Relation:
    """Return that a beam sits where a drawing has it: location [m] and direction in the hand."""
    u = direction / np.linalg.norm(direction)
    T = bases(u)

    def rule(x: FloatArray) -> tuple[FloatArray, tuple[FloatArray, ...]]:
        by = np.zeros((len(x), MOUNT_DIM, BEAM.dim))
        by[:, LOCATION, LOCATION] = np.eye(3) / sigma
        by[:, DIRECTION, DIRECTION] = T.T @ bases(x[:, 3:6]) / sigma_angle
        e = np.concatenate(((x[:, :3] - location) / sigma, x[:, 3:6] @ T / sigma_angle), axis=1)
        return e, (by,)

    return Relation(((BEAM.name, beam),), rule)


def _turned_by(turn: FloatArray) -> FloatArray:
    """Return the derivatives (K, 3, 3) of rotation vectors (K, 3) by a turn in their own frame."""
    angle = np.linalg.norm(turn, axis=1)[:, None, None]
    small = angle < 1e-4
    half = 0.5 * np.where(small, 1.0, angle)
    factor = np.where(small, 1.0 / 12.0, (1.0 - half / np.tan(half)) / (4.0 * half**2))
    W = skew(turn)
    return np.asarray(np.eye(3) + 0.5 * W + factor * W @ W)
