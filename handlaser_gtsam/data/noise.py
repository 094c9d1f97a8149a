"""What is known about the errors of sensor and robot, and what is expected of what is not."""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from ..arrays import FloatArray, IntArray
from ..checks import number_array, require_covariance, require_number
from ..errors import InputError
from .value import Value

LEAST_SIGMA, MOST_SIGMA = 1e-12, 1e6
"""No sensor is better or worse [m]; beyond, squares overflow."""
ROUNDING = 1e-9
"""Asymmetry and negative eigenvalues of a stated covariance, as a part of its variances."""


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Noise(Value):
    """Standard deviations; None where unknown: then they are estimated.

    Attributes
    ----------
    range_sigma : float, optional
        Standard deviation of a reading at right angles [m].
    pose_translation_sigma : float, optional
        Standard deviation of the hand position an axis [m]; zero for a robot that is exact.
    pose_rotation_sigma : float, optional
        Standard deviation of the hand rotation about each axis [rad]; zero likewise.
    incidence_sigma : float
        What the incidence angle adds to a reading [m]: at the angle a its variance is
        range_sigma^2 + (incidence_sigma tan a)^2, as for a spot of that half width.
    pose_covariance : (6, 6) or (M, 6, 6), optional
        Instead of the two pose sigmas: of the hand pose, or of every station's in the order of the
        recording, about and along its own axes (rx, ry, rz, x, y, z) [rad, m]: the hand frame, and the
        order of `gtsam.Pose3`.
    pose_translation_prior, pose_rotation_prior : float
        Scales of the half-Cauchy priors of the pose sigmas that are not given [m], [rad]: what an
        industrial arm errs by.

    Raises
    ------
    InputError
        A range sigma that is not positive, another sigma that is negative, a covariance that is none,
        or both ways to say the same.
    """

    range_sigma: float | None = None
    pose_translation_sigma: float | None = None
    pose_rotation_sigma: float | None = None
    incidence_sigma: float = 0.0
    pose_covariance: FloatArray | None = None
    pose_translation_prior: float = 1e-4
    pose_rotation_prior: float = math.radians(0.02)

    def __post_init__(self) -> None:
        if self.range_sigma is not None:
            bounds, remedy = (LEAST_SIGMA, MOST_SIGMA), "; leave it out if unknown"
            require_number("range_sigma", self.range_sigma, *bounds, unit="m", remedy=remedy)
        for name in ("pose_translation_sigma", "pose_rotation_sigma"):
            value = getattr(self, name)
            if value is not None:
                require_number(name, value, 0.0, MOST_SIGMA)
        require_number("incidence_sigma", self.incidence_sigma, 0.0, MOST_SIGMA)
        for name in ("pose_translation_prior", "pose_rotation_prior"):
            require_number(name, getattr(self, name), LEAST_SIGMA, MOST_SIGMA)
        if self.pose_covariance is not None:
            if self.pose_translation_sigma is not None or self.pose_rotation_sigma is not None:
                raise InputError("a pose covariance and pose sigmas", "one of the two")
            object.__setattr__(self, "pose_covariance", _checked(self.pose_covariance))

    @property
    def poses_uncertain(self) -> bool:
        """Whether the hand poses are stated to have errors."""
        if self.pose_covariance is not None:
            return bool(self.pose_covariance.any())
        return bool(self.pose_translation_sigma or self.pose_rotation_sigma)

    @property
    def poses_exact(self) -> bool:
        """Whether the hand poses are stated to have no errors."""
        if self.pose_covariance is not None:
            return not self.pose_covariance.any()
        return self.pose_translation_sigma == 0.0 and self.pose_rotation_sigma == 0.0

    def pose_covariances(self, stations: int) -> FloatArray:
        """Return the covariance (M, 6, 6) of every station's pose, (rx, ry, rz, x, y, z).

        Raises
        ------
        InputError
            Covariances of fewer stations.
        """
        if self.pose_covariance is None:
            rotation = [(self.pose_rotation_sigma or 0.0) ** 2] * 3
            one = np.diag([*rotation, *[(self.pose_translation_sigma or 0.0) ** 2] * 3])
        elif self.pose_covariance.ndim == 2:
            one = self.pose_covariance
        else:
            if len(self.pose_covariance) < stations:
                found = f"{len(self.pose_covariance)} pose covariances"
                raise InputError(found, f"{stations}, one a station")
            return self.pose_covariance
        return np.broadcast_to(one, (stations, 6, 6))

    def reordered(self, stations: IntArray) -> "Noise":
        """Return the same for a recording whose stations come in another order.

        Raises
        ------
        InputError
            Covariances of another number of stations.
        """
        S = self.pose_covariance
        if S is None or S.ndim == 2:
            return self
        if len(S) != len(stations):
            raise InputError(f"{len(S)} pose covariances", f"{len(stations)}, one a station")
        return replace(self, pose_covariance=S[stations])


def _checked(covariance: ArrayLike) -> FloatArray:
    expected = "numbers, (6, 6) or (stations, 6, 6)"
    matrix = number_array("a pose covariance", covariance, expected)
    if matrix.shape[-2:] != (6, 6) or matrix.ndim not in (2, 3) or not matrix.size:
        found = f"a pose covariance of shape {matrix.shape}"
        raise InputError(found, "shape (6, 6) or (stations, 6, 6)")
    require_covariance("a pose covariance", matrix, MOST_SIGMA, ROUNDING)
    return matrix
