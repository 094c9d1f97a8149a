"""How to calibrate: one frozen set of options, with defaults that work."""

from dataclasses import dataclass, field, replace
from typing import Literal

from .arrays import IntArray
from .diagnosis.observability import ObservabilityOptions
from .errors import InputError
from .losses import LossName
from .noise import Noise
from .sensor import Sensor
from .solvers.levenberg import LevenbergOptions

Poses = Literal["auto", "exact", "marginalised", "estimated"]
RangeError = Literal["auto", "none", "k1", "k1k2"]
Outliers = Literal["reject", "keep"]


LEAST_READINGS = 15
"""Of a beam whose own range sigma is estimated: fewer would tell it to worse than a third."""


@dataclass(frozen=True, slots=True)
class CalibrationOptions:
    """Options of `calibrate`.

    Attributes
    ----------
    range_error : {"auto", "none", "k1", "k1k2"}
        Range-error terms of every beam; `auto` chooses by evidence.
    outliers : {"reject", "keep"}
        Whether readings that the others contradict are left out, and listed.
    loss : {"gaussian", "huber", "cauchy", "tukey"}
        Loss of the final estimate, reading by reading; the covariance follows it.
    poses : {"auto", "exact", "marginalised", "estimated"}
        How errors of the hand poses count: not at all, in the weights of the readings of a station
        together, or as a variable a station. `auto` is `marginalised` where the noise says that
        poses err, else `exact`.
    range_sigma_by_beam : bool
        Whether the range sigma of every beam is estimated by itself.
    estimate_noise : bool
        Whether the sigmas of ranges, hand translations and hand rotations are estimated from
        the residuals; those of the noise are then where the estimates start.
    sensor : Sensor
        Readings outside its limits are left out, and listed.
    solver : LevenbergOptions
    observability : ObservabilityOptions
    """

    range_error: RangeError = "auto"
    outliers: Outliers = "reject"
    loss: LossName = "gaussian"
    poses: Poses = "auto"
    range_sigma_by_beam: bool = False
    estimate_noise: bool = False
    sensor: Sensor = field(default_factory=Sensor)
    solver: LevenbergOptions = field(default_factory=LevenbergOptions)
    observability: ObservabilityOptions = field(default_factory=ObservabilityOptions)

    def treats_poses(self, noise: Noise) -> bool:
        """Tell whether errors of the hand poses are counted."""
        return self.poses != "exact" and (noise.poses_uncertain or self.estimate_noise)

    def estimates_variances(self, noise: Noise) -> bool:
        """Tell whether variances are estimated while the weights are found.

        A common factor of all variances is not: sigma0 finds it without any effort.
        """
        several = self.treats_poses(noise) or noise.incidence_sigma > 0.0
        unknown = noise.range_sigma is None and several
        return self.estimate_noise or self.range_sigma_by_beam or unknown

    def without_variances(self) -> "CalibrationOptions":
        """Return the options for exact poses and one range sigma."""
        return replace(self, poses="exact", estimate_noise=False, range_sigma_by_beam=False)

    def require_pose_noise(self, noise: Noise) -> None:
        """Refuse to count errors of the poses that are not stated.

        Raises
        ------
        InputError
        """
        if self.poses == "exact" and self.estimate_noise:
            raise InputError(
                "estimate_noise with exact poses", "another treatment of poses: their noise counts"
            )
        counted = self.poses in ("marginalised", "estimated")
        if counted and not (noise.poses_uncertain or self.estimate_noise):
            raise InputError(
                f"poses {self.poses} without a pose sigma above zero",
                "a pose sigma or covariance, or the noise to be estimated",
            )

    def require_readings(self, count: IntArray, names: tuple[str, ...]) -> None:
        """Refuse to estimate the sigma of a beam that has few readings (B,).

        Raises
        ------
        InputError
        """
        if not self.range_sigma_by_beam:
            return
        for name, readings in zip(names, count.tolist(), strict=True):
            if readings < LEAST_READINGS:
                raise InputError(
                    f"a range sigma by beam from {readings} readings of beam {name}",
                    f"{LEAST_READINGS} or more; estimate one sigma for all beams",
                )
