"""What is known of a mount and a plate before any reading: bounds."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from .. import model
from ..arrays import FloatArray
from ..checks import require_number
from ..data.parameters import Parameters
from ..data.recording import LARGEST
from ..errors import InputError
from ..model.weighting import Variances
from .belief import Belief

UNIFORM = 1.0 / np.sqrt(3.0)
"""Standard deviation of a uniform number over its half-width."""


@dataclass(frozen=True, slots=True)
class Bounds:
    """Where B beams and a plate roughly are.

    Attributes
    ----------
    locations : (B, 3)
        Middle of the box in which each beam's location lies, hand frame [m].
    location_within : float
        Half the width of the box [m].
    directions : (B, 3)
        Axis of the cone in which each beam's direction lies, hand frame.
    cone : float
        Half its opening angle [rad].
    plate_point, plate_normal : (3,)
        A point of the plate [m] and its normal away from the sensor, world frame.
    plate_within, plate_tilt : float
        By how much the plate is nearer or farther [m], and tilted to any side [rad], at most.
    """

    locations: FloatArray
    location_within: float
    directions: FloatArray
    cone: float
    plate_point: FloatArray
    plate_normal: FloatArray
    plate_within: float
    plate_tilt: float

    def __post_init__(self) -> None:
        require_number("location_within", self.location_within, 0.0, LARGEST)
        require_number("plate_within", self.plate_within, 0.0, LARGEST)
        for name in ("cone", "plate_tilt"):
            require_number(name, getattr(self, name), 0.0, np.pi / 3.0)
        if len(self.locations) != len(self.directions) or not len(self.locations):
            found = f"{len(self.locations)} locations and {len(self.directions)} directions"
            raise InputError(found, "one of each for every beam")
        for name in ("directions", "plate_normal"):
            lengths = np.linalg.norm(np.atleast_2d(getattr(self, name)), axis=1)
            if not (np.isfinite(lengths) & (lengths > 0.0)).all():
                raise InputError(f"{name} without a length", "a direction")

    def draw(self, rng: np.random.Generator) -> Parameters:
        """Return beams and a plate within the bounds, without range errors."""
        beams = len(self.locations)
        box = rng.uniform(-1.0, 1.0, (beams, 3)) * self.location_within
        n = tilted(self.plate_normal[None], self.plate_tilt, rng)[0]
        point = self.plate_point + rng.uniform(-1.0, 1.0) * self.plate_within * n
        return Parameters(
            self.locations + box,
            tilted(self.directions, self.cone, rng),
            np.zeros((beams, 2)),
            n[None],
            np.array([-n @ point]),
        )

    def belief(self, at: Parameters, variances: Variances, linearity: float) -> Belief:
        """Return a Gaussian as wide as the bounds about some beams and a plate."""
        d = float(np.linalg.norm(self.plate_point)) or 1.0
        beam = np.array([self.location_within] * 3 + [self.cone] * 2 + [linearity, linearity / d])
        plane = np.array([self.plate_tilt, self.plate_tilt, self.plate_within])
        beam[:3] *= UNIFORM
        plane[2] *= UNIFORM
        sigma = np.concatenate((np.tile(beam, len(self.locations)), plane))
        return Belief(
            at,
            np.diag(np.maximum(sigma, 1e-9) ** 2),
            model.tangent_basis(at.directions),
            model.tangent_basis(at.normals),
            self.plate_point[None],
            variances,
            ("plate",),
        )


def tilted(axes: FloatArray, most: float, rng: np.random.Generator) -> FloatArray:
    """Return unit vectors (N, 3) within an angle of the axes, evenly over the cone."""
    axes = model.normalized(axes)
    basis = model.tangent_basis(axes)
    angle = most * np.sqrt(rng.uniform(size=len(axes)))
    side = rng.uniform(0.0, 2.0 * np.pi, len(axes))
    turn = angle[:, None] * np.stack((np.cos(side), np.sin(side)), axis=1)
    return Rotation.from_rotvec(np.einsum("nij,nj->ni", basis, turn)).apply(axes)
