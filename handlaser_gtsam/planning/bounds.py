"""What is known of the mounts and of a plate before any reading: bounds."""

import math
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from .. import model
from ..arrays import FloatArray
from ..checks import require_number
from ..data.parameters import Parameters
from ..data.value import Value
from ..errors import InputError
from ..quantities import LARGEST_LENGTH
from .plate import STEEPEST_TILT, Plate, directions, vectors


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
        require_number("location_within", self.location_within, 0.0, LARGEST_LENGTH, unit="m")
        require_number("cone", self.cone, 0.0, STEEPEST_TILT, unit="rad")

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
