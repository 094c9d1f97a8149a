"""Frames whose axis lies along a beam, and their orientation as robots write it.

A beam has no roll: any frame turned about it is as good. One rule chooses it, `smallest_rotation`.
"""

import math
from typing import Literal

import numpy as np

from ...arrays import FloatArray

Axis = Literal["x", "y", "z"]
OPPOSITE = 1e-12
"""Sum of two unit vectors below which they count as opposite."""
HALF_TURN = {"x": (0.0, 0.0, 1.0), "y": (1.0, 0.0, 0.0), "z": (0.0, 1.0, 0.0)}
"""Where the beam is opposite to an axis: the axis that is turned over with it."""


def smallest_rotation(axis: Axis, v: FloatArray) -> FloatArray:
    """Return the rotation (3, 3) by the smallest angle that takes an axis of the hand to `v` (3,).

    It is continuous in `v` everywhere but where `v` is opposite to the axis. There every half turn is
    as small; the one about the next axis is taken: about y for x, about z for y, about x for z.

    The rotation is composed of two reflections, which keeps R a = v to rounding even beside the
    opposite, where the roll depends on the last digits of `v`.
    """
    a = np.zeros(3)
    a["xyz".index(axis)] = 1.0
    between = a + v
    length = float(np.linalg.norm(between))
    h = np.array(HALF_TURN[axis]) if length < OPPOSITE else between / length
    turn: FloatArray = _reflection(h) @ _reflection(a)
    return turn


def _reflection(normal: FloatArray) -> FloatArray:
    return np.eye(3) - 2.0 * np.outer(normal, normal)


def yaw_pitch_roll(R: FloatArray) -> tuple[float, float, float]:
    """Return angles (A, B, C) [rad] with R = Rz(A) Ry(B) Rx(C); B is within a quarter turn.

    The last angle is taken from R after the first: their rounding cancels where B is a quarter turn,
    and only their sum or difference is determined.
    """
    A = math.atan2(R[1, 0], R[0, 0])
    B = math.atan2(-R[2, 0], math.hypot(R[0, 0], R[1, 0]))
    s, c = math.sin(A), math.cos(A)
    C = math.atan2(s * R[0, 2] - c * R[1, 2], c * R[1, 1] - s * R[0, 1])
    return A, B, C


def quaternion(R: FloatArray) -> tuple[float, float, float, float]:
    """Return the unit quaternion (x, y, z, w) of a rotation; w is not negative."""
    from scipy.spatial.transform import Rotation

    x, y, z, w = Rotation.from_matrix(R).as_quat(canonical=True).tolist()
    return x, y, z, w


def rotation_vector(R: FloatArray) -> tuple[float, float, float]:
    """Return the rotation vector [rad] of a rotation."""
    from scipy.spatial.transform import Rotation

    x, y, z = Rotation.from_matrix(R).as_rotvec().tolist()
    return x, y, z
