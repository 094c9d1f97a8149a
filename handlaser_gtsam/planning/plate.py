"""Where a plate roughly stands, and how a person can put it anew."""

import math
from dataclasses import dataclass

import numpy as np

from .. import model
from ..arrays import FloatArray
from ..checks import number_array, require_count, require_number
from ..data.parameters import Parameters
from ..data.value import Value
from ..errors import ArgumentError, InputError
from ..quantities import LARGEST_LENGTH
from ..validation.simulate import plane_name

STEEPEST_TILT = math.pi / 3.0
"""Nobody tilts a plate further, nor knows its direction worse."""
MOST_PLANES = 100
"""Nobody puts up a plate more often: a larger number is a slip."""
TILTS = (0.5, 1.0)
"""Of the largest tilt: how far a plate is turned in the orientations that are compared."""
SIDES = 8
"""To so many sides."""


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Plate(Value):
    """Where a plate roughly stands, world frame.

    Attributes
    ----------
    point : (3,)
        A point of the plate [m], amid the part that the beams are to meet.
    normal : (3,)
        Its normal, away from the sensor; scaled to a length of one.
    within : float
        By how much it is nearer or farther at most [m].
    tilt : float
        By how much it is tilted to any side at most [rad].

    Raises
    ------
    InputError
        Numbers that are not finite, a normal without a length, or bounds beyond sense.
    """

    point: FloatArray
    normal: FloatArray
    within: float = 0.002
    tilt: float = math.radians(2.0)

    def __post_init__(self) -> None:
        object.__setattr__(self, "point", vectors("a point of the plate", self.point, 1)[0])
        normal = directions("the normal of the plate", self.normal, 1)[0]
        object.__setattr__(self, "normal", normal)
        require_number("within", self.within, 0.0, LARGEST_LENGTH, unit="m")
        require_number("tilt", self.tilt, 0.0, STEEPEST_TILT, unit="rad")

    def turned(self, tilt: float, side: float) -> "Plate":
        """Return the plate turned about its point by `tilt` [rad], to the side `side` [rad]."""
        across = model.tangent_basis(self.normal[None])[0]
        toward = across @ np.array([math.cos(side), math.sin(side)])
        normal = math.cos(tilt) * self.normal + math.sin(tilt) * toward
        return Plate(self.point, normal, self.within, self.tilt)


@dataclass(frozen=True, slots=True)
class Placement:
    """How a person can put the plate anew: its orientations are part of the plan.

    Attributes
    ----------
    count : int
        How many times.
    largest_tilt : float
        How far it can be turned from where it stands, to any side [rad].
    within, tilt : float
        By how much it is then off at most, in distance [m] and in orientation [rad].

    Raises
    ------
    InputError
        Numbers beyond sense.
    """

    count: int = 1
    largest_tilt: float = math.radians(25.0)
    within: float = 0.002
    tilt: float = math.radians(2.0)

    def __post_init__(self) -> None:
        require_count("planes", self.count, 1, MOST_PLANES)
        require_number("largest_tilt", self.largest_tilt, 0.0, STEEPEST_TILT, unit="rad")
        require_number("within", self.within, 0.0, LARGEST_LENGTH, unit="m")
        require_number("tilt", self.tilt, 0.0, STEEPEST_TILT, unit="rad")

    def orientations(self, plate: Plate) -> list[Plate]:
        """Return the plates that are compared: as it stands, and turned to all sides."""
        stands = Plate(plate.point, plate.normal, self.within, self.tilt)
        sides = 2.0 * math.pi * np.arange(SIDES) / SIDES
        turned = [
            stands.turned(share * self.largest_tilt, float(side))
            for share in TILTS
            for side in sides
        ]
        return [stands, *(turned if self.largest_tilt > 0.0 else ())]


def standing(at: Parameters, plane: int, point: FloatArray) -> Plate:
    """Return a known plane as a plate, about the foot of a point (3,) on it."""
    n, b = at.normals[plane], float(at.offsets[plane])
    return Plate(point - (n @ point + b) * n, n)


def plate_of(
    normal: object,
    offset: float,
    near: FloatArray,
    sigma: tuple[float | None, float | None] | None = None,
) -> Plate:
    """Return a plane n . x + b = 0 as a plate, about the foot of a point (3,) on it.

    Parameters
    ----------
    normal : (3,)
    offset : float
        b [m].
    near : (3,)
    sigma : (float or None, float or None), optional
        Standard deviations of b [m] and of the normal [rad]; None for what is not known, which counts
        as for a plate that a person has put there.
    """
    n = directions("a normal", normal, 1)[0]
    shift, turn = (None, None) if sigma is None else sigma
    known = Plate(near - (n @ near + offset) * n, n)
    within = known.within if shift is None else 2.0 * shift
    tilt = known.tilt if turn is None else 2.0 * turn
    return Plate(known.point, n, within, min(tilt, STEEPEST_TILT))


def unused_names(taken: tuple[str, ...], count: int) -> list[str]:
    """Return names A, B, ... for planes that have none yet."""
    names = (plane_name(index) for index in range(count + len(taken)))
    return [name for name in names if name not in taken][:count]


def vectors(name: str, values: object, count: int | None = None) -> FloatArray:
    """Return rows of three finite numbers (count, 3).

    Raises
    ------
    InputError
    """
    found = np.atleast_2d(number_array(name, values))  # type: ignore[arg-type]
    if found.ndim != 2 or found.shape[1] != 3 or (count is not None and len(found) != count):
        raise InputError(f"{name} of shape {found.shape}", "three numbers each")
    if not (np.abs(found) <= LARGEST_LENGTH).all():
        raise InputError(f"{name} with numbers that are not finite", "finite numbers")
    return found


def directions(name: str, values: object, count: int | None = None) -> FloatArray:
    """Return rows of unit vectors (count, 3).

    Raises
    ------
    InputError
    """
    found = vectors(name, values, count)
    if not np.linalg.norm(found, axis=1).all():
        raise ArgumentError(name, "without a length", "a direction")
    return model.normalized(found)
