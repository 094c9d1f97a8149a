r"""Families of variables: what a variable is, how it moves, and what its coordinates are called.

A family is a product of parts (vectors, unit vectors, rigid motions, constants). Its members are rows
of plain numbers, (..., size); a step is along its tangent coordinates, (..., dim). All that depends on
the kind of a variable (how many coordinates, their names, their natural units) is asked of its family,
so that a new sensor or target adds a family and nothing else has to know it.

The natural unit of a tangent coordinate is a power of the typical range L: L for a length, 1 for an
angle, 1 / L for a curvature of the range error.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import accumulate, pairwise
from typing import Protocol

import numpy as np
from scipy.spatial.transform import Rotation

from ..arrays import BoolArray, FloatArray
from ..data.readings import Readings
from ..errors import InputError
from .geometry import skew, tangent_basis


class Part(Protocol):
    """A manifold: `size` numbers a point, `dim` coordinates a step."""

    @property
    def size(self) -> int:
        """Numbers of a point."""

    @property
    def dim(self) -> int:
        """Coordinates of a step."""

    def retract(self, x: FloatArray, step: FloatArray) -> FloatArray:
        """Return points (..., size) moved by steps (..., dim)."""

    def tangents_at(self, x: FloatArray) -> FloatArray:
        """Return the derivatives (..., size, dim) of the numbers of points by a step."""


@dataclass(frozen=True, slots=True)
class Vector:
    """Numbers that a step is added to."""

    dim: int

    @property
    def size(self) -> int:
        """As many as a step has."""
        return self.dim

    def retract(self, x: FloatArray, step: FloatArray) -> FloatArray:
        """Add."""
        return x + step

    def tangents_at(self, x: FloatArray) -> FloatArray:
        """Return the unit matrix."""
        return np.broadcast_to(np.eye(self.dim), (*x.shape, self.dim))


@dataclass(frozen=True, slots=True)
class Direction:
    """A unit vector, which moves along `tangent_basis` and is normalised again."""

    size: int = 3
    dim: int = 2

    def retract(self, x: FloatArray, step: FloatArray) -> FloatArray:
        """Move along the tangents."""
        moved = x + (bases(x) @ step[..., None])[..., 0]
        moved /= np.sqrt(np.einsum("...i,...i->...", moved, moved))[..., None]
        return moved

    def tangents_at(self, x: FloatArray) -> FloatArray:
        """Return `bases`."""
        return bases(x)


@dataclass(frozen=True, slots=True)
class Motion:
    """A rigid motion: its rotation matrix row by row, then its translation.

    A step (omega, u) multiplies it on the right, in the order of `gtsam.Pose3`.
    """

    size: int = 12
    dim: int = 6

    def retract(self, x: FloatArray, step: FloatArray) -> FloatArray:
        """Turn and shift in the own frame."""
        R = x[..., :9].reshape(*x.shape[:-1], 3, 3)
        turn = Rotation.from_rotvec(step[..., :3].reshape(-1, 3)).as_matrix().reshape(R.shape)
        shift = (R @ step[..., 3:, None])[..., 0]
        return np.concatenate(((R @ turn).reshape(*x.shape[:-1], 9), x[..., 9:] + shift), axis=-1)

    def tangents_at(self, x: FloatArray) -> FloatArray:
        """Return how the matrix turns about each of its axes, and the axes themselves."""
        R = x[..., :9].reshape(*x.shape[:-1], 3, 3)
        tangents = np.zeros((*x.shape, self.dim))
        turned = np.einsum("...ab,jbc->...acj", R, skew(np.eye(3)))
        tangents[..., :9, :3] = turned.reshape(*x.shape[:-1], 9, 3)
        tangents[..., 9:, 3:] = R
        return tangents


@dataclass(frozen=True, slots=True)
class Constant:
    """Numbers that travel with a member and never move."""

    size: int
    dim: int = 0

    def retract(self, x: FloatArray, step: FloatArray) -> FloatArray:  # noqa: ARG002  (it is empty)
        """Stay."""
        return x

    def tangents_at(self, x: FloatArray) -> FloatArray:
        """Return that there are none."""
        return np.empty((*x.shape, 0))


@dataclass(frozen=True)
class Family:
    """A kind of variable.

    Attributes
    ----------
    name : str
    parts : tuple of Part
    coordinates : tuple of str
        Names of the tangent coordinates.
    powers : tuple of int
        Of the typical range in the natural unit of each tangent coordinate.
    numbers : tuple of str, optional
        Names of the numbers of a member that people and files see, the first of them all; the tangent
        coordinates where not given.
    number_powers : tuple of int, optional
        Of the metre in the unit of each of these numbers; `powers` where not given.
    labels : tuple of str, optional
        These numbers in words; their names where not given.
    """

    name: str
    parts: tuple[Part, ...]
    coordinates: tuple[str, ...]
    powers: tuple[int, ...]
    numbers: tuple[str, ...] = ()
    number_powers: tuple[int, ...] = ()
    labels: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for name, usual in (
            ("numbers", "coordinates"),
            ("number_powers", "powers"),
            ("labels", "numbers"),
        ):
            object.__setattr__(self, name, getattr(self, name) or getattr(self, usual))

    @cached_property
    def keys(self) -> tuple[str, ...]:
        """Names of the numbers with their units, as in tables and files: `x_m`, `k2_per_m`."""
        pairs = zip(self.numbers, self.number_powers, strict=True)
        return tuple(name + SUFFIXES[power] for name, power in pairs)

    def number_units(self, length: float) -> FloatArray:
        """Return the natural units of the numbers that people see, for a typical range [m]."""
        return float(length) ** np.array(self.number_powers, dtype=float)

    @cached_property
    def size(self) -> int:
        """Numbers of a member."""
        return sum(part.size for part in self.parts)

    @cached_property
    def dim(self) -> int:
        """Tangent coordinates of a member."""
        return sum(part.dim for part in self.parts)

    @cached_property
    def places(self) -> tuple[slice, ...]:
        """Where the numbers of each part stand in a member."""
        return _cuts(part.size for part in self.parts)

    @cached_property
    def tangents(self) -> tuple[slice, ...]:
        """Where the tangent coordinates of each part stand."""
        return _cuts(part.dim for part in self.parts)

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


def _cuts(lengths: Iterable[int]) -> tuple[slice, ...]:
    """Return slices of some lengths, one behind the other."""
    return tuple(slice(*ends) for ends in pairwise(accumulate(lengths, initial=0)))


SUFFIXES = {1: "_m", 0: "", -1: "_per_m"}
"""What a name ends with where its number has a unit, by the power of the metre."""
FAMILIES: dict[str, Family] = {}
"""All families by name."""


def register(family: Family) -> Family:
    """Make a family known under its name.

    Raises
    ------
    InputError
        Another family has this name, or coordinates and units are not one a tangent coordinate.
    """
    if FAMILIES.get(family.name, family) != family:
        raise InputError(f"two families named {family.name}", "a name of its own for each")
    if not len(family.coordinates) == len(family.powers) == family.dim:
        given = f"{len(family.coordinates)} names and {len(family.powers)} units"
        raise InputError(given, f"one for each of the {family.dim} coordinates of {family.name}")
    FAMILIES[family.name] = family
    return family


def bases(unit: FloatArray) -> FloatArray:
    """Return `tangent_basis` (..., 3, 2) of unit vectors (..., 3) in any shape."""
    return tangent_basis(unit.reshape(-1, 3)).reshape(*unit.shape, 2)


BEAM = register(
    Family(
        "beam",
        (Vector(3), Direction(), Vector(2)),
        ("x", "y", "z", "v1", "v2", "k1", "k2"),
        (1, 1, 1, 0, 0, 0, -1),
        ("x", "y", "z", "vx", "vy", "vz", "k1", "k2"),
        (1, 1, 1, 0, 0, 0, 0, -1),
        (*(f"{what} {axis}" for what in ("location", "direction") for axis in "xyz"), "k1", "k2"),
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
        (Direction(), Vector(1), Constant(3)),
        ("n1", "n2", "offset"),
        (0, 0, 1),
        ("nx", "ny", "nz", "b"),
        (0, 0, 0, 1),
    )
)
"""Normal n and height h about a fixed centre c: n . (x - c) + h = 0, world frame."""
POSE = register(
    Family(
        "pose",
        (Motion(),),
        ("rx", "ry", "rz", "x", "y", "z"),
        (0, 0, 0, 1, 1, 1),
    )
)
"""A hand pose, world_T_hand."""


def count_unknowns(readings: Readings, terms: int) -> int:
    """Return the number of unknowns of beams, with `terms` range errors each, and planes."""
    return (MOUNT_DIM + terms) * readings.beams + PLANE.dim * readings.planes


def modelled(terms: Sequence[int]) -> BoolArray:
    """Return which tangent coordinates (B, 7) of beams with some range-error terms are unknown."""
    known: BoolArray = np.arange(BEAM.dim) < MOUNT_DIM + np.asarray(terms)[:, None]
    return known
