r"""Relations: rows that tie a few variables, such as an angle between two planes that is known.

A relation is its residuals, and nothing else: derivatives follow from a step along an imaginary axis,
f(x + i h u) = f(x) + i h f'(x) u + O(h^2). No digit is lost, as no difference is formed (Squire and
Trapp, SIAM Review 40(1), 1998, doi 10.1137/S003614459631241X).

Functions return the relations that `[[known]]` states, between planes, of a sphere, a body, or mounts,
with rows in standard deviations. Planes are n . (x - c) + h = 0 with the normal n away from the
sensors; p = c - h n is the foot of the centre c on the plane. sigma is a length [m] and sigma_angle an
angle [rad]. A unit vector that is to lie along another has two rows: its components along the
tangents of the other. Where both are variables, the tangents T of the first are held, and the part of
the second along the first is taken out: T' (m - (m . n) n).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from ..arrays import FloatArray
from ..errors import InputError
from ..quantities import SINGULAR
from .block import Rows, Slot, Values, Weights
from .families import BEAM, FAMILIES, OF_DIRECTION, PLANE, Family, Motion, bases, pose_of, register
from .geometry import skew
from .range_blocks import slots_of
from .sensors.mounted import SENSOR
from .targets.sphere import SPHERE

Numbers = NDArray[np.complex128]
"""Numbers (..., size) of members: real, or with a small imaginary part."""
Rule = Callable[..., Numbers]
"""Takes the numbers (..., size) of each member; returns residuals (..., S) in standard deviations.

It is a formula of +, *, `sqrt` and the like, which hold for complex numbers: no absolute value, and no
comparison but of real parts."""


@dataclass(frozen=True, slots=True, eq=False)
class Relation:
    """Rows that tie members.

    Attributes
    ----------
    of : sequence of (family, member)
    rule : Rule
    """

    of: Sequence[tuple[str, int]]
    rule: Rule
    weights: Weights = field(default_factory=Weights)

    def slots(self) -> tuple[Slot, ...]:
        """Return the members, which the only group sees."""
        return slots_of(*((family, np.array([member])) for family, member in self.of))

    def evaluate(self, values: Values) -> Rows:
        """Return the rows.

        Raises
        ------
        InputError
            The rule returns no array of residuals.
        """
        slots = self.slots()
        numbers = []
        for slot in slots:
            x = values[slot.family][:, slot.member[0]]
            # A row with a step along each tangent coordinate of all members, and one without.
            stepped = np.zeros((slots[-1].columns.stop + 1, *x.shape), dtype=complex)
            stepped[:] = x
            tangents = FAMILIES[slot.family].tangents_at(x)
            stepped[slot.columns] += 1j * SINGULAR * np.moveaxis(tangents, -1, 0)
            numbers.append(stepped)
        e = self.rule(*numbers)
        if not isinstance(e, np.ndarray):
            raise InputError(
                f"a rule that returns a {type(e).__name__}",
                "the residuals alone: their derivatives follow from them",
            )
        columns: FloatArray = e.imag / SINGULAR
        columns[-1] = e[-1].real
        return Rows(columns[:, :, None])


BODY = register(Family("body", Motion()))
"""The pose of a rigid body whose planes are known in its own frame."""
DIRECTIONS = {PLANE.name: PLANE.places[0], BEAM.name: OF_DIRECTION}
"""Where the unit vector stands among the numbers of a variable."""


def at_an_angle(family: str, first: int, second: int, angle: float, sigma: float) -> Relation:
    """Return that two planes, or two beams, are at an angle [rad], neither 0 nor 180 degrees."""
    at = DIRECTIONS[family]

    def rule(x: Numbers, y: Numbers) -> Numbers:
        off = _dot(x[..., at], y[..., at]) - np.cos(angle)
        return np.asarray(off[..., None] / (sigma * np.sin(angle)))

    return Relation(((family, first), (family, second)), rule)


def parallel(
    first: int, second: int, distance: float, sigma: float, sigma_angle: float
) -> Relation:
    """Return that two planes are parallel at a distance [m], seen from one side or from two."""

    def rule(x: Numbers, y: Numbers) -> Numbers:
        n, m = x[..., :3], y[..., :3]
        across = m - _dot(n, m)[..., None] * n
        turn = (across[..., None, :] @ bases(n.real))[..., 0, :]
        q = _dot(m, _foot(x) - y[..., 4:]) + y[..., 3]
        apart = np.where(q.real < 0.0, -q, q) - distance
        return _joined(turn / sigma_angle, apart[..., None] / sigma)

    return Relation(((PLANE.name, first), (PLANE.name, second)), rule)


def along(plane: int, direction: FloatArray, sigma: float) -> Relation:
    """Return that the normal of a plane, a floor say, lies along a direction in the world."""
    T = bases(direction / np.linalg.norm(direction))
    return Relation(((PLANE.name, plane),), lambda x: x[..., :3] @ T / sigma)


def upright(plane: int, direction: FloatArray, sigma: float) -> Relation:
    """Return that a plane, a wall say, contains a direction in the world."""
    g = direction / np.linalg.norm(direction)
    return Relation(((PLANE.name, plane),), lambda x: x[..., :3] @ g[:, None] / sigma)


def plane_at(
    plane: int, normal: FloatArray, offset: float, sigma: float, sigma_angle: float
) -> Relation:
    """Return that a plane is normal . x + offset = 0 [m] in the world."""
    of_face = face(plane, 0, normal, -offset, sigma, sigma_angle).rule
    world = np.append(np.eye(3), np.zeros(3))
    return Relation(((PLANE.name, plane),), lambda x: of_face(x, world))


def radius(sphere: int, value: float, sigma: float) -> Relation:
    """Return that a sphere has a radius [m]."""
    return Relation(((SPHERE.name, sphere),), lambda x: (x[..., 3:4] - value) / sigma)


def position(family: str, member: int, place: FloatArray, sigma: float) -> Relation:
    """Return that a point, or the centre of a sphere, is at a place [m] in the world."""
    return Relation(((family, member),), lambda x: (x[..., :3] - place) / sigma)


def distance(
    first: tuple[str, int], second: tuple[str, int], value: float, sigma: float
) -> Relation:
    """Return that two points, or centres of spheres, are at a distance [m]."""

    def rule(x: Numbers, y: Numbers) -> Numbers:
        off = x[..., :3] - y[..., :3]
        return np.asarray((np.sqrt(_dot(off, off))[..., None] - value) / sigma)

    return Relation((first, second), rule)


def face(
    plane: int, body: int, normal: FloatArray, offset: float, sigma: float, sigma_angle: float
) -> Relation:
    """Return that a plane is a face of a body: outward normal . x = offset [m] in its frame."""
    length = float(np.linalg.norm(normal))
    m, d = normal / length, offset / length
    T = bases(m)

    def rule(x: Numbers, y: Numbers) -> Numbers:
        R, t = pose_of(y)
        off = _seen(R, _foot(x) - t) @ m[:, None] - d
        return _joined(_seen(R, x[..., :3]) @ T / sigma_angle, off / sigma)

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
    at, place = pose[:9].reshape(3, 3), pose[9:]

    def rule(x: Numbers) -> Numbers:
        R, t = pose_of(x)
        return np.asarray(_joined(_turn(at.T @ R), (t - place) @ at) @ open_.T / sigma)

    return Relation(((BODY.name, body),), rule)


def mounted_at(sensor: int, pose: FloatArray, sigma: float, sigma_angle: float) -> Relation:
    """Return that a sensor sits where a drawing has it: hand_T_sensor (4, 4)."""
    at, place = pose[:3, :3], pose[:3, 3]

    def rule(x: Numbers) -> Numbers:
        R, t = pose_of(x)
        return _joined(_turn(at.T @ R) / sigma_angle, (t - place) @ at / sigma)

    return Relation(((SENSOR.name, sensor),), rule)


def mounted_together(
    first: int, second: int, pose: FloatArray, sigma: float, sigma_angle: float
) -> Relation:
    """Return that two sensors sit at a known pose to each other: first_T_second (4, 4)."""

    def rule(x: Numbers, y: Numbers) -> Numbers:
        (R, t), (Q, s) = pose_of(x), pose_of(y)
        turn = _turn(pose[:3, :3].T @ np.swapaxes(R, -1, -2) @ Q)
        return _joined(turn / sigma_angle, (_seen(R, s - t) - pose[:3, 3]) / sigma)

    return Relation(((SENSOR.name, first), (SENSOR.name, second)), rule)


def beam_at(
    beam: int, location: FloatArray, direction: FloatArray, sigma: float, sigma_angle: float
) -> Relation:
    """Return that a beam sits where a drawing has it: location [m] and direction in the hand."""
    T = bases(direction / np.linalg.norm(direction))

    def rule(x: Numbers) -> Numbers:
        return _joined((x[..., :3] - location) / sigma, x[..., 3:6] @ T / sigma_angle)

    return Relation(((BEAM.name, beam),), rule)


def _dot(a: Numbers, b: Numbers) -> Numbers:
    return np.asarray((a * b).sum(axis=-1))


def _joined(*parts: Numbers | FloatArray) -> Numbers:
    return np.concatenate(parts, axis=-1, dtype=complex)


def _foot(plane: Numbers) -> Numbers:
    return np.asarray(plane[..., 4:] - plane[..., 3:4] * plane[..., :3])


def _seen(R: Numbers, vectors: Numbers) -> Numbers:
    """Return R' v for rotations (..., 3, 3) and vectors (..., 3)."""
    return np.asarray((vectors[..., None, :] @ R)[..., 0, :])


def _turn(E: Numbers) -> Numbers:
    """Return the rotation vectors (..., 3) of rotations, by their derivative in the own frame.

    With a = |v|, a turn by w in the own frame changes the vector v by

        (I + V / 2 + (1 - (a / 2) / tan(a / 2)) / a^2 V V) w.
    """
    R = E.real
    v = Rotation.from_matrix(R.reshape(-1, 3, 3)).as_rotvec().reshape(R.shape[:-1])
    by_turn = np.swapaxes(R, -1, -2) @ E.imag
    w = np.stack((by_turn[..., 2, 1], by_turn[..., 0, 2], by_turn[..., 1, 0]), axis=-1)
    angle = np.linalg.norm(v, axis=-1)[..., None, None]
    small = angle < 1e-4
    half = 0.5 * np.where(small, 1.0, angle)
    factor = np.where(small, 1.0 / 12.0, (1.0 - half / np.tan(half)) / (4.0 * half**2))
    V = skew(v)
    J = np.eye(3) + 0.5 * V + factor * V @ V
    return np.asarray(v + 1j * (J @ w[..., None])[..., 0])
