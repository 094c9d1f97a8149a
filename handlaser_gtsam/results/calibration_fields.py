"""What a calibration holds, what follows from it at once, and which unknowns it cannot tell apart."""

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
from ..model.joint import BEAM_COORDINATES, JointCovariance
from ..model.weighting import Variances
from .reports import (
    Beam,
    BeamMixture,
    Determined,
    Fit,
    NoiseComponent,
    Plane,
    RangeErrorScales,
    ScaledSolution,
    StartReport,
)
from .systematic import SystematicError

Status = Literal["converged", "unobservable", "not_converged"]
STRONG = 0.95
"""Correlations above this are worth a word."""
NAMES = ("location x", "location y", "location z", "direction x", "direction y", "direction z")
LABELS = (*NAMES, "k1", "k2")
"""In the order of `joint.BEAM_COORDINATES`."""
FIRST_ERROR = 6
"""Coordinates from here on are range errors."""


@dataclass(frozen=True, slots=True)
class Coordinate:
    """One of the eight coordinates of a beam, as `joint.BEAM_COORDINATES` counts them."""

    beam: str
    number: int

    def __str__(self) -> str:
        """Return "beam NAME QUANTITY"."""
        return f"beam {self.beam} {LABELS[self.number]}"


@dataclass(frozen=True, slots=True)
class Correlation:
    """Two unknowns and their correlation coefficient."""

    first: Coordinate
    second: Coordinate
    coefficient: float

    @property
    def advice(self) -> str:
        """What would tell the two apart."""
        if max(self.first.number, self.second.number) >= FIRST_ERROR:
            return "measure over a wider span of ranges, or estimate fewer range-error terms"
        if self.first.beam != self.second.beam:
            return "add planes with other normals"
        return "turn the hand further, and vary the range"


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
        found = replace(given, range_sigma=self.fit.range_sigma)
        if given.pose_covariance is not None and given.pose_covariance.ndim == 3:
            return found
        pose = self.pose_covariance
        sigma = 0.0 if pose is None else None
        return replace(
            found, pose_translation_sigma=sigma, pose_rotation_sigma=sigma, pose_covariance=pose
        )

    @property
    def pose_covariance(self) -> FloatArray | None:
        """What hand poses err by (6, 6): that of the first station that was used; None if exact."""
        if self.variances is None or self.variances.pose is None:
            return None
        pose = self.variances.pose
        used = np.flatnonzero(pose.any(axis=(1, 2)))
        return pose[used[0]] if used.size else None

    def used_in(self, recording: Recording) -> Recording:
        """Return the stations and readings that were used; of `recording` where none is held."""
        return (self.recording or recording).without(np.isnan(self.fit.residuals))

    def intervals(self, beam: str, level: float = 0.95) -> FloatArray | None:
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
        found = self.beams[beam]
        if found.sigma is None:
            return None
        value = found.coordinates
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
        return np.stack((value - factor * found.sigma, value + factor * found.sigma), axis=1)


def strong_correlations(joint: JointCovariance, limit: float = STRONG) -> tuple[Correlation, ...]:
    """Return the pairs of beam unknowns whose correlation exceeds `limit`, strongest first.

    Of the three components of a direction, the largest follows from the others and is left out.
    """
    S = joint.matrix(planes=[])
    variance = np.diagonal(S)
    keep = variance > 0.0
    for beam, basis in enumerate(joint.beam_bases):
        # The component along which the tangent plane reaches least belongs to the largest one.
        keep[8 * beam + 3 + int(np.linalg.norm(basis, axis=1).argmin())] = False
    rows = np.flatnonzero(keep)
    sigma = np.sqrt(variance[rows])
    C = S[np.ix_(rows, rows)] / np.outer(sigma, sigma)
    first, second = np.triu_indices(len(rows), 1)
    strong = np.flatnonzero(np.abs(C[first, second]) > limit)
    strong = strong[np.argsort(-np.abs(C[first, second])[strong], kind="stable")]
    width = len(BEAM_COORDINATES)
    names = [Coordinate(joint.beam_names[row // width], row % width) for row in rows.tolist()]
    return tuple(
        Correlation(names[first[i]], names[second[i]], float(C[first[i], second[i]]))
        for i in strong
    )
