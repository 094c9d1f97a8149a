"""What is known of the mounts and of a plate before any reading: bounds."""

import math
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from .. import model
from ..arrays import FloatArray
from ..checks import require_number
from ..data.parameters import Parameters
from ..data.recording import LARGEST
from ..data.value import Value
from ..errors import InputError
from ..model.sensor import Sensor
from ..model.weighting import Variances
from .belief import UNKNOWN_ANGLE, UNKNOWN_LENGTH, UNKNOWN_PLANE, Belief
from .plate import STEEPEST_TILT, Plate, directions, vectors

UNIFORM = 1.0 / math.sqrt(3.0)
"""Standard deviation of a uniform number over its half-width."""
LEAST = 1e-9
"""Standard deviation of what is known exactly."""


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
        require_number("location_within", self.location_within, 0.0, LARGEST, unit="m")
        require_number("cone", self.cone, 0.0, STEEPEST_TILT, unit="rad")

    def draw(self, rng: np.random.Generator) -> Parameters:
        """Return beams and a plate within the bounds, without range errors."""
        beams, plate = len(self.locations), self.plate
        box = rng.uniform(-1.0, 1.0, (beams, 3)) * self.location_within
        n = tilted(plate.normal[None], plate.tilt, rng)[0]
        point = plate.point + rng.uniform(-1.0, 1.0) * plate.within * n
        return Parameters(
            self.locations + box,
            tilted(self.directions, self.cone, rng),
            np.zeros((beams, 2)),
            n[None],
            np.array([-n @ point]),
        )

    def belief(self, at: Parameters, variances: Variances, sensor: Sensor) -> Belief:
        """Return what a calibration would start from about some beams and a plate: next to nothing.

        It does not use the bounds; they are the `spread`.
        """
        k = sensor.linearity * np.array([1.0, 1.0 / max(abs(sensor.range_max), LEAST)])
        box, plate = self.location_within * UNIFORM, self.plate
        known = np.concatenate(([box] * 3, [0.5 * self.cone] * 2, k))
        placed = [0.5 * plate.tilt, 0.5 * plate.tilt, UNIFORM * plate.within]
        unknown = np.concatenate(([UNKNOWN_LENGTH] * 3, [UNKNOWN_ANGLE] * 2, k))
        beams = len(self.locations)
        spread = np.concatenate((np.tile(known, beams), placed))
        sigma = np.concatenate((np.tile(unknown, beams), UNKNOWN_PLANE))
        return Belief(
            at,
            np.diag(sigma**2),
            model.tangent_basis(at.directions),
            model.tangent_basis(at.normals),
            plate.point[None],
            variances,
            ("plate",),
            np.diag(np.maximum(spread, LEAST) ** 2),
        )


def tilted(axes: FloatArray, most: float, rng: np.random.Generator) -> FloatArray:
    """Return unit vectors (N, 3) within an angle of the axes, evenly over the cone."""
    axes = model.normalized(axes)
    basis = model.tangent_basis(axes)
    angle = most * np.sqrt(rng.uniform(size=len(axes)))
    side = rng.uniform(0.0, 2.0 * np.pi, len(axes))
    turn = angle[:, None] * np.stack((np.cos(side), np.sin(side)), axis=1)
    return Rotation.from_rotvec(np.einsum("nij,nj->ni", basis, turn)).apply(axes)
