"""What is known about the errors of sensor and robot."""

import math
from dataclasses import dataclass

from .errors import InputError

LEAST_SIGMA, MOST_SIGMA = 1e-12, 1e6
"""No sensor is better or worse [m]; beyond, squares overflow."""


@dataclass(frozen=True, slots=True)
class Noise:
    """Standard deviations; None where unknown.

    Attributes
    ----------
    range_sigma : float, optional
        Standard deviation of a reading [m]. Unknown: estimated from the residuals.
    pose_translation_sigma : float, optional
        Standard deviation of the hand position an axis [m].
    pose_rotation_sigma : float, optional
        Standard deviation of the hand rotation about each axis [rad].

    Raises
    ------
    InputError
        A range sigma that is not positive, or a pose sigma that is negative.
    """

    range_sigma: float | None = None
    pose_translation_sigma: float | None = None
    pose_rotation_sigma: float | None = None

    def __post_init__(self) -> None:
        sigma = self.range_sigma
        if sigma is not None and not LEAST_SIGMA <= sigma <= MOST_SIGMA:
            raise InputError(
                f"range sigma {sigma:g} m",
                f"{LEAST_SIGMA:g} to {MOST_SIGMA:g} m; leave it out if unknown",
            )
        for name in ("pose_translation_sigma", "pose_rotation_sigma"):
            value = getattr(self, name)
            if value is not None and not (math.isfinite(value) and value >= 0.0):
                raise InputError(f"{name} {value:g}", "zero or a positive number")

    @property
    def poses_uncertain(self) -> bool:
        """Whether the hand poses are stated to have errors."""
        return bool(self.pose_translation_sigma or self.pose_rotation_sigma)
