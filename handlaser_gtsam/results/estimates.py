"""The estimates of a calibration: beams and planes with their uncertainty."""

from dataclasses import dataclass

import numpy as np

from ..arrays import FloatArray
from ..data.value import Value


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Beam(Value):
    """The mount of one beam, hand frame.

    Attributes
    ----------
    name : str
    location : (3,)
        Where the range is zero, r [m].
    direction : (3,)
        Unit vector v.
    range_error : (2,)
        k1 [1], k2 [1/m]: the true range is d + k1 d + k2 d^2 for a reading d.
    terms : int
        How many of k1, k2 are in the model; the others are zero.
    covariance : (8, 8) or None
        Over (x, y, z, vx, vy, vz, k1, k2) in SI units, the direction in ambient coordinates (its
        row along v is zero). None unless all of the beam is determined.
    sigma : (8,) or None
        Standard deviations of the same coordinates, infinite where the recording leaves one open;
        None where nothing is known: a solver that gave up, or a second solution.
    """

    name: str
    location: FloatArray
    direction: FloatArray
    range_error: FloatArray
    terms: int
    covariance: FloatArray | None
    sigma: FloatArray | None

    @property
    def location_sigma(self) -> FloatArray | None:
        """Standard deviations of the location (3,) [m]; infinite where open."""
        return None if self.sigma is None else self.sigma[:3]

    @property
    def direction_sigma(self) -> float | None:
        """Largest standard deviation over the tangent plane [rad]; infinite if open."""
        if self.sigma is None:
            return None
        if self.covariance is None:
            return float(np.linalg.norm(self.sigma[3:6]))  # an upper bound, infinite if open
        return float(np.sqrt(np.linalg.eigvalsh(self.covariance[3:6, 3:6])[-1]))

    @property
    def range_error_sigma(self) -> FloatArray | None:
        """Standard deviations of k1 [1] and k2 [1/m]; zero where not estimated, infinite if open."""
        return None if self.sigma is None else self.sigma[6:]


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Plane(Value):
    """One plane, n . x + b = 0 in the world frame.

    Attributes
    ----------
    name : str
    normal : (3,)
        Unit vector n; points away from the sensor.
    offset : float
        b [m].
    covariance : (4, 4) or None
        Over (nx, ny, nz, b), the normal in ambient coordinates. None unless all is determined.
    sigma : (4,) or None
        Standard deviations of the same coordinates, infinite where the recording leaves one open.
    """

    name: str
    normal: FloatArray
    offset: float
    covariance: FloatArray | None
    sigma: FloatArray | None

    @property
    def normal_sigma(self) -> float | None:
        """Largest standard deviation of the normal over its tangent plane [rad]; infinite if open."""
        if self.sigma is None:
            return None
        if self.covariance is None:
            return float(np.linalg.norm(self.sigma[:3]))  # an upper bound, infinite if open
        return float(np.sqrt(np.linalg.eigvalsh(self.covariance[:3, :3])[-1]))

    @property
    def offset_sigma(self) -> float | None:
        """Standard deviation of the offset [m]; infinite if open."""
        return None if self.sigma is None else float(self.sigma[3])
