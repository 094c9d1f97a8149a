"""The result of a calibration."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from scipy.stats import norm
from scipy.stats import t as student

from ..arrays import FloatArray, IntArray
from ..data.noise import Noise
from ..data.parameters import Parameters, RangeErrorPrior
from ..data.recording import Recording
from ..errors import CalibrationWarning
from ..estimation.learned import LearnedScales
from ..estimation.mixture import mixture_quantiles
from ..model.joint import JointCovariance
from ..model.losses import LossName
from ..model.sensor import Rejected
from ..model.weighting import Variances
from ..observability.rank import Indices
from ..observability.wording import OpenPart
from .correlations import Correlation
from .systematic import SystematicError

Status = Literal["converged", "unobservable", "not_converged"]

POOR_SIGMA = 0.5
"""An estimated sigma whose own standard deviation is above this part of it is hardly known."""


@dataclass(frozen=True, slots=True)
class Beam:
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


@dataclass(frozen=True, slots=True)
class Plane:
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


@dataclass(frozen=True, slots=True)
class Fit:
    """How well the readings agree with the calibration.

    Attributes
    ----------
    readings : int
        Readings used.
    rms, largest : float
        Root mean square and largest absolute residual [m].
    largest_at : (str, str)
        Station and beam of the largest residual.
    chi2 : float
        Sum of squared residuals in units of the covariance behind the weights. If all readings weigh
        the same and no range sigma was given: over 1 m^2.
    dof : int
        Readings, and pseudo-readings of the prior of range errors, less determined unknowns.
    sigma0 : float
        sqrt(chi2 / dof): near 1 when the given sigmas are right; the estimated range sigma in metres
        if all readings weigh the same and none was given.
    range_sigma : float
        Standard deviation of a reading behind the covariances, given or estimated [m]; the median of
        the beams where it was estimated by beam.
    range_sigma_given : bool
    poses : str
        How errors of the hand poses counted: `exact`, `marginalised` or `estimated`.
    median_reading, typical_range : float
        Median of the readings, and the natural unit of lengths [m]: the same unless some are negative.
    loss : str
        `gaussian`, or the robust loss of the estimate.
    farthest : float
        Largest residual in units of its own standard deviation, that of the reading and its pose.
    farthest_at : (str, str)
        Station and beam of it.
    residuals : (M, B)
        Residual of every reading [m], stations by beams; NaN where there is none or it was rejected.
    rejected : readings left out, each with its reason
    """

    readings: int
    rms: float
    largest: float
    largest_at: tuple[str, str]
    chi2: float
    dof: int
    sigma0: float
    range_sigma: float
    range_sigma_given: bool
    poses: Literal["exact", "marginalised", "estimated"]
    median_reading: float
    typical_range: float
    loss: LossName
    farthest: float
    farthest_at: tuple[str, str]
    residuals: FloatArray
    rejected: tuple[Rejected, ...]


@dataclass(frozen=True, slots=True)
class NoiseComponent:
    """What a sigma is of, its estimate, and the standard deviation of that [m], or [rad] to turn.

    `quantity` is `range`, `pose translation` or `pose rotation`; `beam` is the name of the beam where a
    range sigma is that of one beam. `prior_carries` says that the recording hardly tells the sigma:
    what is expected of such a robot or sensor decides about it. With a robust loss the error is not
    known, and NaN.
    """

    quantity: str
    sigma: float
    error: float
    beam: str | None = None

    @property
    def name(self) -> str:
        """The quantity, with its beam."""
        return self.quantity if self.beam is None else f"{self.quantity} of beam {self.beam}"

    @property
    def prior_carries(self) -> bool:
        """Whether the sigma is hardly determined by the recording."""
        return self.error >= POOR_SIGMA * self.sigma


@dataclass(frozen=True, slots=True)
class RangeErrorScales:
    """What the range errors of all beams typically are, learned from them.

    Attributes
    ----------
    k1, k2_per_m : float
        Standard deviations of the zero-mean prior of k1 [1] and k2 [1/m]: posterior means.
    linearity : float
        Scale of the half-Cauchy prior of both, as a part of the reading.
    """

    k1: float
    k2_per_m: float
    linearity: float


@dataclass(frozen=True, slots=True)
class BeamMixture:
    """The posterior of the beams as a mixture of Gaussians, one a set of scales.

    Attributes
    ----------
    weight : (C,)
    means, sigmas : (C, B, 8)
        Of (x, y, z, vx, vy, vz, k1, k2); means counted from the estimate.
    members : (C, 2) of int
        Which points and scales of `Calibration.learned` are behind each.
    """

    weight: FloatArray
    means: FloatArray
    sigmas: FloatArray
    members: IntArray

    def grown(self, factor: float) -> "BeamMixture":
        """Return the mixture spread out about the estimate."""
        return replace(self, means=factor * self.means, sigmas=factor * self.sigmas)


@dataclass(frozen=True, slots=True)
class ScaledSolution:
    """The solution at the most probable scales, over which nothing is integrated: others can repeat it.

    Attributes
    ----------
    parameters : Parameters
        In the order of the recording, world frame.
    covariance : JointCovariance
    range_error_prior : RangeErrorPrior or None
    """

    parameters: Parameters
    covariance: JointCovariance
    range_error_prior: RangeErrorPrior | None


@dataclass(frozen=True, slots=True)
class Determined:
    """What the readings determine; see `diagnosis.observability`.

    Attributes
    ----------
    rank, unknowns : int
    condition : float or None
        Condition number in natural units; None when rank is short.
    undetermined : tuple of str
        What is left open, in words.
    advice : tuple of str
        Which motion would determine it.
    open_parts : tuple of OpenPart
        The same as names and axes.
    indices : Indices or None
        Observability indices O1 to O4; None when rank is short.
    weakest : str
        Along what the solution is known worst, in words; empty when rank is short.
    """

    rank: int
    unknowns: int
    condition: float | None
    undetermined: tuple[str, ...] = ()
    advice: tuple[str, ...] = ()
    open_parts: tuple[OpenPart, ...] = ()
    indices: Indices | None = None
    weakest: str = ""


@dataclass(frozen=True, slots=True)
class StartReport:
    """Which start was used, and the rms residual [m] of every start tried, lowest first."""

    method: str
    tried: tuple[tuple[str, float], ...]


@dataclass(frozen=True, slots=True)
class Calibration:
    """Beams and planes with their uncertainty, and how they were found.

    Attributes
    ----------
    status : str
        `converged`; `unobservable` when the recording leaves something open: numbers are then
        one of many solutions and have no covariance; `not_converged` when the solver gave up.
    message : str
        The same in words.
    warnings : tuple of CalibrationWarning
        Signs that the result should not be believed, the gravest first.
    beams, planes : mappings by name, in the order of the recording
    fit : Fit
    observability : Determined
    start : StartReport
    iterations : int
        Steps of the final solution.
    interrupted : bool
        Whether Ctrl-C ended the solver.
    variances : Variances or None
        Behind the weights of the readings, by beam and station in the order of the recording; None
        where all weigh the same.
    noise_estimate : tuple of NoiseComponent
        Sigmas that were estimated beside those of the mounts.
    covariance : JointCovariance or None
        Of all beams and planes together; None unless everything is determined.
    correlations : tuple of Correlation
        Unknowns of the beams that the recording hardly tells apart.
    range_error_scales : RangeErrorScales or None
        Learned scales of the range errors; None where they have no prior.
    mixture : BeamMixture or None
        Of the beams, where scales were integrated over.
    at_scales : ScaledSolution or None
        The solution at the most probable scales, where they were.
    learned : LearnedScales or None
        The scales that were integrated over.
    systematic : tuple of SystematicError
        What the recording says of errors that the model leaves out.
    recording : Recording or None
        What was solved: repeated stations are merged, and readings that are codes taken out. None
        where it is not known.
    """

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

    def parameters(self) -> Parameters:
        """Return beams and planes as arrays, in their order."""
        beams, planes = list(self.beams.values()), list(self.planes.values())
        return Parameters(
            np.array([beam.location for beam in beams]),
            np.array([beam.direction for beam in beams]),
            np.array([beam.range_error for beam in beams]),
            np.array([plane.normal for plane in planes]),
            np.array([plane.offset for plane in planes]),
        )

    def noise(self, given: Noise) -> Noise:
        """Return `given` with what was estimated in its place, for readings of the same kind."""
        found = replace(given, range_sigma=self.fit.range_sigma)
        if given.pose_covariance is not None and given.pose_covariance.ndim == 3:
            return found
        pose = self.pose_covariance
        if pose is None:
            exact = {"pose_translation_sigma": 0.0, "pose_rotation_sigma": 0.0}
            return replace(found, **exact, pose_covariance=None)
        return replace(
            found,
            pose_translation_sigma=None,
            pose_rotation_sigma=None,
            pose_covariance=pose,
        )

    @property
    def pose_covariance(self) -> FloatArray | None:
        """What hand poses err by (6, 6): that of the first station that was used; None if exact."""
        if self.variances is None or self.variances.pose is None:
            return None
        pose = self.variances.pose
        used = np.flatnonzero(pose.any(axis=(1, 2)))
        return pose[used[0]] if used.size else None

    def intervals(self, beam: str, level: float = 0.95) -> FloatArray | None:
        """Return where each coordinate of a beam lies with probability `level`, (8, 2).

        Quantiles of the mixture where scales were integrated over; else Gaussian, or Student's t where
        the range sigma comes from the residuals. None where there are no standard deviations; infinite
        where the recording leaves a coordinate undetermined.
        """
        found = self.beams[beam]
        if found.sigma is None:
            return None
        value = np.concatenate((found.location, found.direction, found.range_error))
        if self.mixture is not None:
            mixture, i = self.mixture, list(self.beams).index(beam)
            sides = [
                mixture_quantiles(mixture.weight, mixture.means[:, i], mixture.sigmas[:, i], tail)
                for tail in (0.5 * (1.0 - level), 0.5 * (1.0 + level))
            ]
            return value[:, None] + np.stack(sides, axis=1)
        known = self.fit.range_sigma_given and not self.noise_estimate
        tail = 0.5 * (1.0 + level)
        factor = float(norm.ppf(tail) if known else student.ppf(tail, max(self.fit.dof, 1)))
        return np.stack((value - factor * found.sigma, value + factor * found.sigma), axis=1)
