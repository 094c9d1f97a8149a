r"""Families of variables: what a variable is, how it moves, and what its coordinates are called.

A family is a product of parts (vectors, unit vectors, rigid motions, constants). Its members are rows
of plain numbers, (..., size); a step is along its tangent coordinates, (..., dim). All that depends on
the kind of a variable (how many coordinates, their names, their natural units) is asked of its family,
so that a new sensor or target adds a family and nothing else has to know it.

The natural unit of a tangent coordinate is a power of the typical range L: L for a length, 1 for an
angle, 1 / L for a curvature of the range error.
"""

from collections.abc import Iterable, Sequence
from itertools import accumulate, pairwise
from typing import Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from ..arrays import BoolArray, FloatArray
from ..data.readings import Readings
from ..errors import InputError
from .geometry import skew, tangent_basis

Reals = TypeVar("Reals", FloatArray, NDArray[np.complex128])
"""Numbers, along an imaginary axis, too, where derivatives are taken."""


class Part(Protocol):
    """A manifold: numbers of a point, and coordinates of a step, by their names with units."""

    @property
    def size(self) -> int:
        """Numbers of a point."""

    @property
    def coordinates(self) -> tuple[str, ...]:
        """Names of the coordinates of a step: `x_m`, `v1`, `k2_per_m`."""

    @property
    def numbers(self) -> tuple[str, ...]:
        """Names of the numbers that people and files see."""

    def retract(self, x: FloatArray, step: FloatArray) -> FloatArray:
        """Return points (..., size) moved by steps (..., coordinates)."""

    def tangents_at(self, x: FloatArray) -> FloatArray:
        """Return the derivatives (..., size, coordinates) of the numbers of points by a step."""


class Vector:
    """Numbers that a step is added to.

    Parameters
    ----------
    coordinates : str, each
        Their names with units.
    numbers : tuple of str, optional
        What people and files see them called; the same where not given.
    """

    def __init__(self, *coordinates: str, numbers: tuple[str, ...] = ()) -> None:
        self.coordinates, self.numbers = coordinates, numbers or coordinates
        self.size = len(coordinates)

    def retract(self, x: FloatArray, step: FloatArray) -> FloatArray:
        """Add."""
        return x + step

    def tangents_at(self, x: FloatArray) -> FloatArray:
        """Return the unit matrix."""
        return np.broadcast_to(np.eye(self.size), (*x.shape, self.size))


class Direction:
    """A unit vector, which moves along `tangent_basis` and is normalised again.

    Parameters
    ----------
    letter : str
        Of its names: v1 and v2, and vx, vy, vz.
    """

    size = 3

    def __init__(self, letter: str) -> None:
        self.coordinates = (f"{letter}1", f"{letter}2")
        self.numbers = tuple(letter + axis for axis in "xyz")

    def retract(self, x: FloatArray, step: FloatArray) -> FloatArray:
        """Move along the tangents."""
        moved = x + (bases(x) @ step[..., None])[..., 0]
        moved /= np.sqrt(np.einsum("...i,...i->...", moved, moved))[..., None]
        return moved

    def tangents_at(self, x: FloatArray) -> FloatArray:
        """Return `bases`."""
        return bases(x)


def pose_of(x: Reals) -> tuple[Reals, Reals]:
    """Return rotations (..., 3, 3) and translations (..., 3) [m] from the numbers of motions."""
    return x[..., :9].reshape(*x.shape[:-1], 3, 3), x[..., 9:12]


class Motion:
    """A rigid motion: its rotation matrix row by row, then its translation.

    A step (omega, u) multiplies it on the right, in the order of `gtsam.Pose3`.
    """

    size = 12
    coordinates: tuple[str, ...] = ("rx", "ry", "rz", "x_m", "y_m", "z_m")
    numbers = coordinates

    def retract(self, x: FloatArray, step: FloatArray) -> FloatArray:
        """Turn and shift in the own frame."""
        R, t = pose_of(x)
        turn = Rotation.from_rotvec(step[..., :3].reshape(-1, 3)).as_matrix().reshape(R.shape)
        shift = (R @ step[..., 3:, None])[..., 0]
        return np.concatenate(((R @ turn).reshape(*x.shape[:-1], 9), t + shift), axis=-1)

    def tangents_at(self, x: FloatArray) -> FloatArray:
        """Return how the matrix turns about each of its axes, and the axes themselves."""
        R, _ = pose_of(x)
        tangents = np.zeros((*x.shape, len(self.coordinates)))
        turned = np.einsum("...ab,jbc->...acj", R, skew(np.eye(3)))
        tangents[..., :9, :3] = turned.reshape(*x.shape[:-1], 9, 3)
        tangents[..., 9:, 3:] = R
        return tangents


class Constant:
    """Numbers that travel with a member and never move.

    Parameters
    ----------
    names : str, each
        Of the numbers, which no file has.
    """

    coordinates: tuple[str, ...] = ()
    numbers: tuple[str, ...] = ()

    def __init__(self, *names: str) -> None:
        self.size = len(names)

    def retract(self, x: FloatArray, step: FloatArray) -> FloatArray:  # noqa: ARG002  (it is empty)
        """Stay."""
        return x

    def tangents_at(self, x: FloatArray) -> FloatArray:
        """Return that there are none."""
        return np.empty((*x.shape, 0))


UNITS = {"_per_m": -1, "_m": 1, "": 0}
"""Powers of the metre by what a name with such a unit ends with, the longest ending first."""


class Family:
    """A kind of variable.

    Parameters
    ----------
    name : str
    parts : Part, each
    labels : sequence of str, optional
        The numbers that people see in words; their names where not given.

    Attributes
    ----------
    coordinates, numbers : tuple of str
        Names of the tangent coordinates, and of the numbers of a member that people and files see,
        without units.
    keys : tuple of str
        Names of the latter with units, as in tables and files: `x_m`, `k2_per_m`.
    powers : tuple of int
        Of the metre in the units of the tangent coordinates.
    size, dim : int
        Numbers and tangent coordinates of a member.
    places, tangents : tuples of slice
        Where the numbers, and the tangent coordinates, of each part stand.
    """

    def __init__(self, name: str, *parts: Part, labels: Sequence[str] = ()) -> None:
        self.name, self.parts = name, parts
        spelled = [key for part in parts for key in part.coordinates]
        self.keys = tuple(key for part in parts for key in part.numbers)
        self.coordinates, self.powers = zip(*map(_unit_of, spelled), strict=True)
        self.numbers, self._number_powers = zip(*map(_unit_of, self.keys), strict=True)
        self.labels = tuple(labels) or self.numbers
        self.places = _cuts(part.size for part in parts)
        self.tangents = _cuts(len(part.coordinates) for part in parts)
        self.size, self.dim = self.places[-1].stop, len(spelled)

    def retract(self, x: FloatArray, step: FloatArray) -> FloatArray:
        """Return members (..., size) moved by steps (..., dim)."""
        cuts = zip(self.parts, self.places, self.tangents, strict=True)
        moved = [part.retract(x[..., a], step[..., b]) for part, a, b in cuts]
        return moved[0] if len(moved) == 1 else np.concatenate(moved, axis=-1)

    def tangents_at(self, x: FloatArray) -> FloatArray:
        """Return the derivatives (..., size, dim) of the numbers of members by a step."""
        tangents = np.zeros((*x.shape, self.dim))
        for part, a, b in zip(self.parts, self.places, self.tangents, strict=True):
            tangents[..., a, b] = part.tangents_at(x[..., a])
        return tangents

    def natural_units(self, length: float) -> FloatArray:
        """Return the natural units (dim,) of the tangent coordinates for a typical range [m]."""
        return float(length) ** np.array(self.powers, dtype=float)

    def number_units(self, length: float) -> FloatArray:
        """Return the natural units of the numbers that people see, for a typical range [m]."""
        return float(length) ** np.array(self._number_powers, dtype=float)


def _unit_of(key: str) -> tuple[str, int]:
    """Return a name without its unit, and the power of the metre that this is."""
    ending = next(ending for ending in UNITS if key.endswith(ending))
    return key.removesuffix(ending), UNITS[ending]


def _cuts(lengths: Iterable[int]) -> tuple[slice, ...]:
    """Return slices of some lengths, one behind the other."""
    return tuple(slice(*ends) for ends in pairwise(accumulate(lengths, initial=0)))


FAMILIES: dict[str, Family] = {}
"""All families by name."""


def register(family: Family) -> Family:
    """Make a family known under its name; one with the same numbers again changes nothing.

    Raises
    ------
    InputError
        Another family has this name.
    """
    known = FAMILIES.setdefault(family.name, family)
    if (known.keys, known.size, known.powers) != (family.keys, family.size, family.powers):
        raise InputError(f"two families named {family.name}", "a name of its own for each")
    return known


def require_family(name: str) -> None:
    """Refuse a name that no family has.

    Raises
    ------
    InputError
    """
    if name not in FAMILIES:
        raise InputError(f"a family {name!r}", f"one of {', '.join(FAMILIES)}; `register` it")


def bases(unit: FloatArray) -> FloatArray:
    """Return `tangent_basis` (..., 3, 2) of unit vectors (..., 3) in any shape."""
    return tangent_basis(unit.reshape(-1, 3)).reshape(*unit.shape, 2)


BEAM = register(
    Family(
        "beam",
        Vector("x_m", "y_m", "z_m"),
        Direction("v"),
        Vector("k1", "k2_per_m"),
        labels=[f"{what} {axis}" for what in ("location", "direction") for axis in "xyz"]
        + ["k1", "k2"],
    )
)
"""Location and direction in the hand, then the range error (k1, k2)."""
LOCATION, DIRECTION, RANGE_ERROR = BEAM.tangents
"""Tangent coordinates of a beam by what they are of."""
OF_LOCATION, OF_DIRECTION, OF_RANGE_ERROR = BEAM.places
"""Numbers of a beam by what they are of."""
MOUNT_DIM: int = DIRECTION.stop
"""Tangent coordinates of location and direction; range errors follow them."""
PLANE = register(
    Family(
        "plane",
        Direction("n"),
        Vector("offset_m", numbers=("b_m",)),
        Constant("centre x", "centre y", "centre z"),
    )
)
"""Normal n and height h about a fixed centre c: n . (x - c) + h = 0, world frame."""
POSE = register(Family("pose", Motion()))
"""A hand pose, world_T_hand."""


def count_unknowns(readings: Readings, terms: int) -> int:
    """Return the number of unknowns of beams, with `terms` range errors each, and planes."""
    return (MOUNT_DIM + terms) * readings.beams + PLANE.dim * readings.planes


def modelled(terms: Sequence[int]) -> BoolArray:
    """Return which tangent coordinates (B, 7) of beams with some range-error terms are unknown."""
    known: BoolArray = np.arange(BEAM.dim) < MOUNT_DIM + np.asarray(terms)[:, None]
    return known
