"""What is known of mounts and of a plate before any reading, and how a person can move the plate."""

import math
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from .. import model
from ..arrays import FloatArray
from ..checks import number_array, require_count, require_fields
from ..data.parameters import Parameters
from ..data.value import Value
from ..errors import ArgumentError, InputError
from ..quantities import LARGEST_LENGTH

STEEPEST_TILT = math.pi / 3.0
"""Nobody tilts a plate further, nor knows its direction worse."""
MOST_PLANNED = 1000
"""Nobody drives to more stations, nor puts up a plate more often: a larger number is a slip."""
SIDES = 8
"""Sides to which a plate, or a hand, is turned: neighbours have a cosine of 0.7."""
PLACED_WITHIN = 0.002
"""How far off in distance a person puts a plate, where nothing else is stated [m]."""
PLACED_TILT = math.radians(2.0)
"""How far off in orientation [rad]."""


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
    across : float or None
        How far it extends [m]: a disc about its point, on which all spots of a first motion are to
        lie; of any size where not given.

    Raises
    ------
    InputError
        Numbers that are not finite, a normal without a length, or bounds beyond sense.
    """

    point: FloatArray
    normal: FloatArray
    within: float = PLACED_WITHIN
    tilt: float = PLACED_TILT
    across: float | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "point", vectors("point", self.point, 1)[0])
        object.__setattr__(self, "normal", directions("normal", self.normal, 1)[0])
        require_fields(self, "within", unit="m")
        require_fields(self, "tilt", most=STEEPEST_TILT, unit="rad")
        require_fields(self, "across", above=True, unit="m")


@dataclass(frozen=True, slots=True)
class Placement:
    """How a person can move the plate: its orientations are part of the plan.

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
    within: float = PLACED_WITHIN
    tilt: float = PLACED_TILT

    def __post_init__(self) -> None:
        require_count("planes", self.count, 1, MOST_PLANNED)
        require_fields(self, "within", unit="m")
        require_fields(self, "largest_tilt", "tilt", most=STEEPEST_TILT, unit="rad")

    def orientations(self, plate: Plate) -> list[Plate]:
        """Return the plates that are compared: as it stands, and turned about its point."""
        across = model.tangent_basis(plate.normal[None])[0]
        normals = [plate.normal]
        if self.largest_tilt > 0.0:
            # The largest tilts are the best ones for a workspace that reaches them, half of them for
            # others; to so many sides that neighbours have a cosine of 0.7.
            side = np.linspace(0.0, 2.0 * math.pi, SIDES, endpoint=False)
            toward = np.column_stack((np.cos(side), np.sin(side))) @ across.T
            for tilt in (0.5 * self.largest_tilt, self.largest_tilt):
                normals += list(math.cos(tilt) * plate.normal + math.sin(tilt) * toward)
        return [Plate(plate.point, n, self.within, self.tilt, plate.across) for n in normals]


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Bounds(Value):
    """Where B beams and a plate roughly are.

    Attributes
    ----------
    locations : (B, 3)
        Middle of the box in which each beam's location lies, hand frame [m].
    directions : (B, 3)
        Axis of the cone in which each beam's direction lies, hand frame; scaled to a length of one.
    plate : Plate
        World frame.
    location_within : float
        Half the width of the box [m].
    cone : float
        Half the opening angle of the cone [rad].

    Raises
    ------
    InputError
        Arrays that do not belong together, or numbers beyond sense.
    """

    locations: FloatArray
    directions: FloatArray
    plate: Plate
    location_within: float = 0.005
    cone: float = math.radians(10.0)

    def __post_init__(self) -> None:
        locations = vectors("locations", self.locations)
        axes = directions("directions", self.directions)
        if len(locations) != len(axes) or not len(locations):
            found = f"{len(locations)} locations and {len(axes)} directions"
            raise InputError(found, "one of each for every beam")
        object.__setattr__(self, "locations", locations)
        object.__setattr__(self, "directions", axes)
        require_fields(self, "location_within", unit="m")
        require_fields(self, "cone", most=STEEPEST_TILT, unit="rad")

    def middle(self) -> Parameters:
        """Return the beams and the plate in the middle of the bounds, without range errors."""
        n = self.plate.normal
        offset = -np.array([n @ self.plate.point])
        nothing = np.zeros((len(self.locations), 2))
        return Parameters(self.locations, self.directions, nothing, n[None], offset)

    def draw(self, rng: np.random.Generator, count: int = 1) -> Parameters:
        """Return beams and plates within the bounds, without range errors.

        Draws follow one another: (count B) beams, and (count) planes.
        """
        beams, plate = count * len(self.locations), self.plate
        box = rng.uniform(-1.0, 1.0, (beams, 3)) * self.location_within
        n = tilted(np.tile(plate.normal, (count, 1)), plate.tilt, rng)
        point = plate.point + rng.uniform(-1.0, 1.0, (count, 1)) * plate.within * n
        return Parameters(
            np.tile(self.locations, (count, 1)) + box,
            tilted(np.tile(self.directions, (count, 1)), self.cone, rng),
            np.zeros((beams, 2)),
            n,
            -(n * point).sum(axis=1),
        )


def tilted(axes: FloatArray, most: float, rng: np.random.Generator) -> FloatArray:
    """Return unit vectors (N, 3) within an angle of the axes, evenly over the cone."""
    axes = model.normalized(axes)
    basis = model.tangent_basis(axes)
    angle = most * np.sqrt(rng.uniform(size=len(axes)))
    side = rng.uniform(0.0, 2.0 * np.pi, len(axes))
    turn = angle[:, None] * np.stack((np.cos(side), np.sin(side)), axis=1)
    return Rotation.from_rotvec(np.einsum("nij,nj->ni", basis, turn)).apply(axes)


def plate_of(
    normal: object,
    offset: float,
    near: FloatArray,
    sigma: tuple[float | None, float | None] = (None, None),
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
    within = PLACED_WITHIN if sigma[0] is None else 2.0 * sigma[0]
    tilt = PLACED_TILT if sigma[1] is None else min(2.0 * sigma[1], STEEPEST_TILT)
    return Plate(near - (n @ near + offset) * n, n, within, tilt)


def vectors(name: str, values: object, count: int | None = None) -> FloatArray:
    """Return rows of three finite numbers (count, 3).

    Raises
    ------
    InputError
    """
    rows = np.atleast_2d(number_array(name, values))  # type: ignore[arg-type]
    if rows.ndim != 2 or rows.shape[1] != 3 or (count is not None and len(rows) != count):
        raise InputError(f"{name} of shape {rows.shape}", "three numbers each")
    if not (np.abs(rows) <= LARGEST_LENGTH).all():
        raise InputError(f"{name} with numbers that are not finite", "finite numbers")
    return rows


def directions(name: str, values: object, count: int | None = None) -> FloatArray:
    """Return rows of unit vectors (count, 3).

    Raises
    ------
    InputError
    """
    rows = vectors(name, values, count)
    if not np.linalg.norm(rows, axis=1).all():
        raise ArgumentError(name, "without a length", "a direction")
    return model.normalized(rows)
