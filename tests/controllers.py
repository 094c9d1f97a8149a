"""Logs of robot controllers, written by formulas of their own: sines, cosines, and nothing else.

Each writer takes angles that a person could read off a teach pendant, and returns the columns of the
log beside the matrix that these mean by the manual of the controller, multiplied out by hand.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np


def rx(a: float) -> np.ndarray:
    c, s = math.cos(a), math.sin(a)
    return np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])


def ry(a: float) -> np.ndarray:
    c, s = math.cos(a), math.sin(a)
    return np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])


def rz(a: float) -> np.ndarray:
    c, s = math.cos(a), math.sin(a)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


DEG = math.pi / 180.0


def about_z_y_x(first: float, second: float, third: float) -> np.ndarray:
    """Turn about Z, then about the new Y, then about the new X."""
    return rz(first) @ ry(second) @ rx(third)


def about_fixed_x_y_z(first: float, second: float, third: float) -> np.ndarray:
    """Turn about the base's X, then its Y, then its Z."""
    return rz(third) @ ry(second) @ rx(first)


def about_moving_x_y_z(first: float, second: float, third: float) -> np.ndarray:
    return rx(first) @ ry(second) @ rz(third)


def about_z_y_z(first: float, second: float, third: float) -> np.ndarray:
    return rz(first) @ ry(second) @ rz(third)


def rodrigues(a: float, b: float, c: float) -> np.ndarray:
    angle = math.sqrt(a * a + b * b + c * c)
    if angle == 0.0:
        return np.eye(3)
    x, y, z = a / angle, b / angle, c / angle
    k = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + math.sin(angle) * k + (1.0 - math.cos(angle)) * (k @ k)


def of_quaternion(w: float, x: float, y: float, z: float) -> np.ndarray:
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


@dataclass(frozen=True)
class Controller:
    """How a controller writes poses.

    names: of the columns; draws: numbers of a rotation from a generator; matrix: what they mean;
    length: how many of its units are a metre; number: of an angle, per radian.
    """

    names: tuple[str, ...]
    matrix: Callable[..., np.ndarray]
    length: float = 1e3
    per_radian: float = 1.0 / DEG
    whole: str = ""


MM_DEG = (1e3, 1.0 / DEG)
CONTROLLERS = {
    "kuka": Controller(("X", "Y", "Z", "A", "B", "C"), about_z_y_x),
    "abb": Controller(("X", "Y", "Z", "q1", "q2", "q3", "q4"), of_quaternion),
    "abb-euler": Controller(("X", "Y", "Z", "EZ", "EY", "EX"), about_z_y_x),
    "fanuc": Controller(("X", "Y", "Z", "W", "P", "R"), about_fixed_x_y_z),
    "yaskawa": Controller(("X", "Y", "Z", "Rx", "Ry", "Rz"), about_fixed_x_y_z),
    "denso": Controller(("X", "Y", "Z", "RX", "RY", "RZ"), about_fixed_x_y_z),
    "mitsubishi": Controller(("X", "Y", "Z", "A", "B", "C"), about_fixed_x_y_z),
    "ur": Controller(("x", "y", "z", "rx", "ry", "rz"), rodrigues, 1.0, 1.0),
    "staubli": Controller(("x", "y", "z", "rx", "ry", "rz"), about_moving_x_y_z),
    "kawasaki": Controller(("X", "Y", "Z", "O", "A", "T"), about_z_y_z),
    "doosan": Controller(("x", "y", "z", "a", "b", "c"), about_z_y_z),
    "comau": Controller(("X", "Y", "Z", "A", "E", "R"), about_z_y_z),
    "nachi": Controller(("X", "Y", "Z", "Roll", "Pitch", "Yaw"), about_z_y_x),
    "epson": Controller(("X", "Y", "Z", "U", "V", "W"), about_z_y_x),
    "estun": Controller(("X", "Y", "Z", "A", "B", "C"), about_z_y_x),
    "franka": Controller(tuple(f"O_T_EE[{i}]" for i in range(16)), rodrigues, 1.0, 1.0, "columns"),
    "matrix": Controller(
        tuple(f"T{i}{j}" for i in range(4) for j in range(4)), rodrigues, 1.0, 1.0, "rows"
    ),
    "ros": Controller(("x", "y", "z", "qx", "qy", "qz", "qw"), of_quaternion, 1.0),
    "urdf-rpy": Controller(("x", "y", "z", "roll", "pitch", "yaw"), about_fixed_x_y_z, 1.0, 1.0),
}


def written(
    name: str, rng: np.random.Generator, count: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the rows of a log (M, k), and the rotations and positions [m] that they mean."""
    how = CONTROLLERS[name]
    rows, R, t = [], [], []
    for _ in range(count):
        position = rng.uniform(-0.9, 0.9, 3)
        if how.matrix is of_quaternion:
            q = rng.standard_normal(4)
            q /= math.sqrt(sum(part * part for part in q))
            turn = how.matrix(*q)  # w, x, y, z
            numbers = list(q) if name == "abb" else [*q[1:], q[0]]
        else:
            angles = rng.uniform(-1.0, 1.0, 3) * [3.1, 1.5, 3.1]
            if how.matrix is rodrigues:
                angles *= 3.0 / math.sqrt(3.1**2 + 1.5**2 + 3.1**2)
            turn = how.matrix(*angles)
            numbers = [how.per_radian * angle for angle in angles]
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = turn, how.length * position
        if how.whole:
            rows.append((T if how.whole == "rows" else T.T).ravel())
        else:
            rows.append([*(how.length * position), *numbers])
        R.append(turn)
        t.append(position)
    return np.array(rows), np.array(R), np.array(t)
