"""What a calibration holds, and what follows from it at once."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from ..arrays import FloatArray
from ..checks import require_kind, require_number
from ..data.noise import Noise
from ..data.parameters import Parameters, RangeErrorPrior
from ..data.recording import Recording
from ..data.value import Value
from ..errors import CalibrationWarning, InputError
from ..estimation.learned import LearnedScales
from ..estimation.mixture import mixture_quantiles
from ..model.distributions import gaussian_quantile, student_quantile
from ..model.joint import JointCovariance
from ..model.weighting import Variances
from .correlations import Correlation
from .reports import (
    Beam,
    BeamMixture,
    Determined,
    Fit,
    FreedEffect,
    NoiseComponent,
    Plane,
    RangeErrorScales,
    ScaledSolution,
    StartReport,
)
from .significance import CONFIDENCE
from .systematic import SystematicError

Status = Literal["converged", "unobservable", "not_converged"]


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class CalibrationData(Value):
    """The fields of a `Calibration`, which says what they are; verdict and screen are made of them."""

    status: Status
    message: str
    warnings: tuple[CalibrationWarning, ...]
    beams: Mapping[str, Beam]
    planes: Mapping[str, Plane]
    fit: Fit
    observability: Determined
    start: StartReport
    iterations: int
    interrupted: bool = False
    variances: Variances | None = None
    noise_estimate: tuple[NoiseComponent, ...] = ()
    covariance: JointCovariance | None = None
    correlations: tuple[Correlation, ...] = ()
    range_error_scales: RangeErrorScales | None = None
    mixture: BeamMixture | None = None
    at_scales: ScaledSolution | None = None
    learned: LearnedScales | None = None
    systematic: tuple[SystematicError, ...] = ()
    recording: Recording | None = None
    range_error_prior: RangeErrorPrior | None = None
    cost: float = math.nan
    sensor_kind: str | None = None
    effects: tuple[FreedEffect, ...] = ()
    recorded: Recording | None = None

    @property
    def success(self) -> bool:
        """Whether the solver converged on a solution that the recording determines."""
        return self.status == "converged"

    def parameters(self) -> Parameters:
        """Return beams and planes as arrays, in their order."""
        beams, planes = self.beams.values(), self.planes.values()
        return Parameters(
            np.array([beam.location for beam in beams]),
            np.array([beam.direction for beam in beams]),
            np.array([beam.range_error for beam in beams]),
            np.array([plane.normal for plane in planes]),
            np.array([plane.offset for plane in planes]),
        )

    def noise(self, given: Noise) -> Noise:
        """Return `given` with what was estimated in its place, for readings of the same kind."""
        require_kind("noise", given, Noise)
        estimated = replace(given, range_sigma=self.fit.range_sigma)
        if given.pose_covariance is not None and given.pose_covariance.ndim == 3:
            return estimated
        pose = self.pose_covariance
        sigma = 0.0 if pose is None else None
        return replace(
            estimated, pose_translation_sigma=sigma, pose_rotation_sigma=sigma, pose_covariance=pose
        )

    @property
    def pose_covariance(self) -> FloatArray | None:
        """What hand poses err by (6, 6): of the first station that was used; None if exact."""
        if self.variances is None or self.variances.pose is None:
            return None
        pose = self.variances.pose
        used = np.flatnonzero(pose.any(axis=(1, 2)))
        return pose[used[0]] if used.size else None

    def used_in(self, recording: Recording) -> Recording:
        """Return the stations and readings that were used; of `recording` where none is held."""
        return (self.recording or recording).without(np.isnan(self.fit.residuals))

    def intervals(self, beam: str, level: float = CONFIDENCE) -> FloatArray | None:
        """Return where each coordinate of a beam lies with probability `level`, (8, 2).

        Quantiles of the mixture where scales were integrated over; else Gaussian, or Student's t where
        the range sigma comes from the residuals. None where there are no standard deviations; infinite
        where the recording leaves a coordinate undetermined.

        Raises
        ------
        InputError
            No such beam, or no probability.
        """
        if beam not in self.beams:
            raise InputError(f"beam {beam!r}", f"one of {', '.join(self.beams)}")
        require_number("level", level, 0.0, 1.0)
        value, sigma = self.beams[beam].coordinates, self.beams[beam].sigma
        if sigma is None:
            return None
        if self.mixture is not None:
            mixture, i = self.mixture, list(self.beams).index(beam)
            sides = [
                mixture_quantiles(mixture.weight, mixture.means[:, i], mixture.sigmas[:, i], tail)
                for tail in (0.5 * (1.0 - level), 0.5 * (1.0 + level))
            ]
            return value[:, None] + np.stack(sides, axis=1)
        known = self.fit.range_sigma_given and not self.noise_estimate
        tail = 0.5 * (1.0 + level)
        factor = float(
            gaussian_quantile(tail) if known else student_quantile(tail, max(self.fit.dof, 1))
        )
        return np.stack((value - factor * sigma, value + factor * sigma), axis=1)
