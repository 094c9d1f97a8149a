"""Poses of the hand from the numbers of a log, and what these numbers alone say against that."""

import math
from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ...arrays import BoolArray, FloatArray
from ...errors import InputError
from ...model.conventions import (
    FORMATS,
    LENGTHS,
    UNIT_WORDS,
    Convention,
    called,
    finds,
    inverted,
    matrices,
    poses_of,
)
from ...quantities import ROUNDING
from ..recording_csv import ROTATION_TOLERANCE, off_unit
from .format import LogFormat
from .format_checks import convention_of
from .motion import Way

FARTHEST = 30.0
"""A position beyond this [m] is in millimetres, not in metres: no arm is so long."""
NEAREST = 5.0
"""Positions that all stay within this distance [mm] of the origin are in metres."""


class Fault(NamedTuple):
    """Rows that cannot be under a convention.

    Attributes
    ----------
    wrong : (M,)
    numbers : slice
        Which of the numbers of the pose show it.
    found, expected : str
    doubt : bool
        Whether the user may insist: it is a sign, not an impossibility.
    """

    wrong: BoolArray
    numbers: slice
    found: str
    expected: str
    doubt: bool = False


def faults(x: FloatArray, convention: Convention) -> list[Fault]:
    """Return what cannot be, or can hardly be, of the numbers x (M, k) under a convention."""
    return [fault for fault in _faults(x, convention) if fault.wrong.any()]


def _faults(x: FloatArray, convention: Convention) -> Iterator[Fault]:
    """Yield all faults that may be, with the rows that have them: often none."""
    position, t = slice(0, 3), x[:, :3]
    if convention.is_matrix:
        yield from _matrix_faults(x, convention)
        position, t = slice(0, x.shape[1]), matrices(x, convention)[:, :3, 3]
    elif not convention.has_angles:
        length, wrong = off_unit(x[:, 3:])
        found = f"a quaternion of length {length[wrong.argmax()]:.6g}"
        expected = f"length 1 within {ROTATION_TOLERANCE:g}; are these angles, or other columns?"
        yield Fault(wrong, slice(3, 7), found, expected)
    elif convention.angles == "rad":
        a = np.abs(x[:, 3:])
        size = np.linalg.norm(a, axis=1) if convention.rotation == "rotvec" else a.max(axis=1)
        wrong, found = size > 2.0 * math.pi * (1.0 + ROUNDING), f"angles of {size.max():.4g}"
        expected = f"at most 2 pi; are they degrees? {_others(replace(convention, angles='deg'))}"
        yield Fault(wrong, slice(3, 6), f"{found} read as radians", expected, doubt=True)
    size, units = np.abs(t).max(axis=1), convention.units
    other = _others(replace(convention, units="mm" if units == "m" else "m"))
    expected = f"at most {FARTHEST:g} m of an arm"
    expected += f"; is it millimetres? {other}" if units == "m" else ""
    found = f"a position of {size.max():.6g} read as {UNIT_WORDS[units]}"
    yield Fault(size * LENGTHS[units] > FARTHEST, position, found, expected, doubt=True)
    if units == "mm" and size.max() < NEAREST and len(x) > 1:
        found = f"positions within {size.max():.4g} of the origin read as millimetres"
        expected = f"some of {NEAREST:g} mm or more; are they metres? {other}"
        yield Fault(np.ones(len(x), dtype=bool), position, found, expected, doubt=True)


def _matrix_faults(x: FloatArray, convention: Convention) -> Iterator[Fault]:
    T, every = matrices(x, convention), slice(0, x.shape[1])
    other = "matrix" if convention.rotation == "matrix-columns" else "matrix-columns"
    instead = f"{ROWS[other]}: {called(replace(convention, rotation=other))}"
    wrong = (T[:, 3] != (0.0, 0.0, 0.0, 1.0)).any(axis=1)
    row = np.array2string(T[wrong.argmax(), 3], precision=6, separator=", ")
    expected = f"0, 0, 0, 1 ({ROWS[convention.rotation]}); is it {instead}?"
    yield Fault(wrong, every, f"a matrix whose last row is {row}", expected)
    R = np.clip(T[:, :3, :3], -2.0, 2.0)
    off = np.abs(np.swapaxes(R, 1, 2) @ R - np.eye(3)).max(axis=(1, 2))
    wrong, expected = ~(off <= ROTATION_TOLERANCE), "a rotation, of right-handed frames"
    found = "a matrix with the determinant -1, of a left-handed frame"
    yield Fault((np.linalg.det(R) < 0.0) & ~wrong, every, found, expected)
    found = f"R'R differs from the identity by {off[wrong.argmax()]:.2g}"
    expected = f"a rotation to {ROTATION_TOLERANCE:g}, {ROWS[convention.rotation]}; if {instead}"
    yield Fault(wrong, every, f"a matrix that is no rotation ({found})", expected)


ROWS = {"matrix": "row by row", "matrix-columns": "column by column"}


def _others(other: Convention) -> str:
    """Name what states a convention, and formats with its units."""
    units = other.numbers, other.units, other.has_angles and other.angles
    alike = [
        name
        for name, one in FORMATS.items()
        if (one.numbers, one.units, other.has_angles and one.angles) == units
        and one.meaning != other.meaning
        and finds(one, other.header)
    ]
    words = f"then state {called(other)}"
    return words + (f", or --pose-format {'|'.join(alike)} if it is one of those" if alike else "")


def hand_poses(numbers: FloatArray, way: Way, given: LogFormat) -> tuple[FloatArray, FloatArray]:
    """Return rotations (S, 3, 3) and positions (S, 3) [m] of the hand at stations.

    Where a tool or a base was active, the log has poses of that tool in that base:

        robot_T_flange = robot_T_base  base_T_tool  inverse(flange_T_tool)

    Parameters
    ----------
    numbers : (M, k)
        The pose of every row as it is written.
    way : Way
    given : LogFormat

    Raises
    ------
    InputError
        The numbers of a tool or a base are no pose.
    """
    convention = convention_of(given)
    R, t = way.poses(numbers, convention, inverse=given.inverted)
    for name, stated in (("tool", given.tool), ("base", given.base)):
        if not stated:
            continue
        if len(stated) not in convention.numbers:
            expected = " or ".join(map(str, convention.numbers))
            expected += f", as a pose of the log: {convention.words}"
            raise InputError(f"--{name} of {len(stated)} numbers", expected)
        x = np.array([stated], dtype=np.float64)
        for fault in faults(x, convention):
            raise InputError(f"{name}: {fault.found}", fault.expected)
        S, s = poses_of(x, convention)
        if name == "tool":
            S, s = inverted(S, s)
            R, t = R @ S[0], t + R @ s[0]
        else:
            R, t = S[0] @ R, t @ S[0].T + s[0]
    return R, t
