"""Errors of beams and robot that are stated, and priors of those that are not.

Sensors of many rays have their own standard deviation (`survey.Shots.sigma`).
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..arrays import FloatArray, IntArray
from ..checks import number_array, require_covariance, require_fields
from ..errors import InputError
from ..quantities import ROUNDING
from .value import Value

POSE_SIGMAS = "pose_translation_sigma", "pose_rotation_sigma"
OF_POSE = (*POSE_SIGMAS, "pose_covariance")
"""Fields of `Noise` that state errors of the hand poses."""
SIGMAS = ("range_sigma", *POSE_SIGMAS)
"""Fields of `Noise` that are estimated where they are not given, or where readings contradict them."""
LEAST_SIGMA = 1e-12
"""No sensor is better than this [m]: inverse squares of smaller numbers overflow in products."""


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Noise(Value):
    """Standard deviations; None where unknown: then they are estimated.

    Attributes
    ----------
    range_sigma : float, optional
        Standard deviation of a reading of a single beam at right angles [m].
    pose_translation_sigma : float, optional
        Standard deviation of the hand position an axis [m]; zero for a robot that is exact.
    pose_rotation_sigma : float, optional
        Standard deviation of the hand rotation about each axis [rad]; zero likewise.
    incidence_sigma : float
        Contribution of the incidence angle [m]: at the angle a a reading has the variance
        range_sigma^2 + (incidence_sigma tan a)^2, as for a spot of that half width.
    pose_covariance : (6, 6) or (M, 6, 6), optional
        Instead of the two pose sigmas: covariance of the hand pose, or of the pose of every station in
        the order of the recording, about and along the axes of the hand (rx, ry, rz, x, y, z)
        [rad, m]: the order of `gtsam.Pose3`.
    pose_translation_prior, pose_rotation_prior : float
        Scales of the half-Cauchy priors of the pose sigmas that are not given [m], [rad]: errors of an
        industrial arm.

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
        remedy = "; leave it out if unknown"
        require_fields(self, "range_sigma", least=LEAST_SIGMA, unit="m", remedy=remedy)
        require_fields(self, *POSE_SIGMAS, "incidence_sigma")
        require_fields(self, "pose_translation_prior", "pose_rotation_prior", least=LEAST_SIGMA)
        if self.pose_covariance is not None:
            if self.pose_translation_sigma is not None or self.pose_rotation_sigma is not None:
                raise InputError("a pose covariance and pose sigmas", "one of the two")
            name, expected = "a pose covariance", "(6, 6) or (stations, 6, 6)"
            matrix = number_array(name, self.pose_covariance, f"numbers, {expected}")
            if matrix.shape[-2:] != (6, 6) or matrix.ndim not in (2, 3) or not matrix.size:
                raise InputError(f"{name} of shape {matrix.shape}", f"shape {expected}")
            require_covariance(name, matrix, ROUNDING)
            object.__setattr__(self, "pose_covariance", matrix)

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

    @property
    def standstill(self) -> tuple[float, float]:
        """The shift [m] and turn [rad] below which recorded poses are of one stop: errors of the hand.

        Errors of the hand are the same again where it has hardly moved. They are those stated, or as is
        usual.
        """
        if self.pose_covariance is not None:
            variances = np.einsum("...ii->...i", self.pose_covariance).reshape(-1, 2, 3)
            turn, shift = np.sqrt(variances.mean(axis=(0, 2))).tolist()
            return shift, turn
        shift, turn = self.pose_translation_sigma, self.pose_rotation_sigma
        shift = self.pose_translation_prior if shift is None else shift
        return shift, self.pose_rotation_prior if turn is None else turn

    def pose_covariances(self, stations: int) -> FloatArray:
        """Return the covariance (M, 6, 6) of every station's pose, (rx, ry, rz, x, y, z).

        Raises
        ------
        InputError
            Covariances of fewer stations.
        """
        S = self.pose_covariance
        if S is None:
            sigmas = self.pose_rotation_sigma or 0.0, self.pose_translation_sigma or 0.0
            S = np.diag(np.repeat(sigmas, 3) ** 2)
        if S.ndim == 2:
            return np.broadcast_to(S, (stations, 6, 6))
        if len(S) < stations:
            raise InputError(f"{len(S)} pose covariances", f"{stations}, one a station")
        return S

    def without(self, sigmas: Iterable[str]) -> "Noise":
        """Return the same without some of its sigmas, which are estimated then."""
        unknown: dict[str, Any] = dict.fromkeys(sigmas)
        return replace(self, **unknown)

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
