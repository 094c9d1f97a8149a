"""What a calibration holds: beams and planes with their uncertainty, fit, noise, rank and start.

`CalibrationData` has all of it as fields, and what follows from them at once.
"""

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
from ..estimation.errors_by_pose import SizesByPose
from ..estimation.learning_scales import LearnedScales
from ..estimation.options import ChosenPoses
from ..estimation.scales import NoiseComponent
from ..model.distributions import CONFIDENCE, chi2_sf, gaussian_quantile, student_quantile
from ..model.effects import EFFECTS
from ..model.effects.effect import size_in_words
from ..model.families import OF_DIRECTION
from ..model.joint import Correlation, JointCovariance
from ..model.losses import LossName
from ..model.sensor_limits import BY_LIMITS, Rejected
from ..model.weighting import Variances
from ..observability.rank import Indices
from ..observability.wording import OpenPart
from ..quantities import IN_MM, IN_PERCENT
from ..text import count
from .lines import decimals
from .messages import said
from .shared_errors import InCommon
from .systematic import SystematicError

Status = Literal["converged", "unobservable", "not_converged"]


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
    def coordinates(self) -> FloatArray:
        """(x, y, z, vx, vy, vz, k1, k2), as in the covariance (8,)."""
        return np.concatenate((self.location, self.direction, self.range_error))

    @property
    def location_sigma(self) -> FloatArray | None:
        """Standard deviations of the location (3,) [m]; infinite where open."""
        return None if self.sigma is None else self.sigma[:3]

    @property
    def direction_sigma(self) -> float | None:
        """Largest standard deviation over the tangent plane [rad]; infinite if open."""
        return _largest_sigma(self.sigma, self.covariance, OF_DIRECTION)

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
    def coordinates(self) -> FloatArray:
        """(nx, ny, nz, b), as in the covariance (4,)."""
        return np.append(self.normal, self.offset)

    @property
    def normal_sigma(self) -> float | None:
        """Largest standard deviation of the normal over its tangent plane [rad]; infinite if open."""
        return _largest_sigma(self.sigma, self.covariance, slice(3))

    @property
    def offset_sigma(self) -> float | None:
        """Standard deviation of the offset [m]; infinite if open."""
        return None if self.sigma is None else float(self.sigma[3])


def _largest_sigma(
    sigma: FloatArray | None, covariance: FloatArray | None, rows: slice
) -> float | None:
    """Return the largest standard deviation of a unit vector over its tangent plane [rad]."""
    if sigma is None:
        return None
    if covariance is None:
        return float(np.linalg.norm(sigma[rows]))  # an upper bound, infinite if open
    return float(np.sqrt(np.linalg.eigvalsh(covariance[rows, rows])[-1]))


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Fit(Value):
    """How well the readings agree with the calibration.

    Attributes
    ----------
    readings : int
        Readings used.
    rms, max_residual : float
        Root mean square and largest absolute residual [m].
    max_residual_at : (str, str)
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
    max_standardized_residual : float
        Largest residual in its own standard deviation, the errors of reading and pose included; zero
        where all fit exactly.
    max_standardized_residual_at : (str, str)
        Station and beam of it.
    residuals : (M, B)
        Residual of every reading [m], stations by beams; NaN where there is none or it was rejected.
    standardized : (M, B)
        The same in their own standard deviations.
    rejected : readings that were rejected, each with its reason
    """

    readings: int
    rms: float
    max_residual: float
    max_residual_at: tuple[str, str]
    chi2: float
    dof: int
    sigma0: float
    range_sigma: float
    range_sigma_given: bool
    poses: ChosenPoses
    median_reading: float
    typical_range: float
    loss: LossName
    max_standardized_residual: float
    max_standardized_residual_at: tuple[str, str]
    residuals: FloatArray
    standardized: FloatArray
    rejected: tuple[Rejected, ...]

    @property
    def p_value(self) -> float:
        """Probability of a larger chi2 if the sigmas are right; NaN without degrees of freedom."""
        return float(chi2_sf(self.chi2, self.dof)) if self.dof > 0 else math.nan

    @property
    def outliers(self) -> int:
        """How many readings were rejected because they contradict others, not by a sensor's limits."""
        return sum(one.reason not in BY_LIMITS for one in self.rejected)


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class FreedEffect(Value):
    """A systematic error that was an unknown, or one of its unknowns.

    Attributes
    ----------
    code : str
    subject : str
        Whom or what it concerns; empty for everything.
    unit : str
        Of sizes: "m", or "1" for relative ones.
    size, sigma : float
        Estimated, with its standard deviation.
    prior_sigma : float
        Standard deviation of the zero-mean prior.
    determined : bool
        Whether the readings say more of it than the prior.
    of_effects : (q,)
        Covariance with the size of every freed error, itself included, in the order of
        `Calibration.effects`.
    of_mounts : (n,)
        Covariance with the tangent coordinates of beams and planes, in the order of
        `Calibration.covariance`.
    """

    code: str
    subject: str
    unit: str
    size: float
    sigma: float
    prior_sigma: float
    determined: bool
    of_effects: FloatArray
    of_mounts: FloatArray

    @property
    def brief(self) -> str:
        """The size with its standard deviation."""
        scale, unit = (IN_MM, "mm") if self.unit == "m" else (IN_PERCENT, "%")
        places = decimals(self.sigma * scale, 4)
        return f"{self.size * scale:.{places}f} +- {self.sigma * scale:.{places}f} {unit}"

    @property
    def words(self) -> str:
        """What was found, in words; how to determine it first, where the readings do not."""
        effect = EFFECTS[self.code]
        whose = self.subject if "{subject}" in effect.phrase else ""
        part = f" ({self.subject})" if self.subject and not whose else ""
        if not self.determined:
            what, how = effect.without_size(self.subject or None) + part, effect.reveal
            code, brief = self.code, self.brief
            return said("freed:undetermined", code=code, brief=brief, reveal=how, what=what)
        sigma = size_in_words(self.sigma, self.unit)
        return f"{effect.with_size(self.size, whose)}{part} (+- {sigma})"


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class ScaledSolution(Value):
    """The solution at the most probable scales, over which nothing is integrated: others can repeat it.

    Attributes
    ----------
    parameters : Parameters
        In the order of the recording, world frame.
    covariance : JointCovariance
    range_error_prior : RangeErrorPrior or None
    effect_sigmas : (q,)
        Standard deviations of the freed errors, in the order of `Calibration.effects`.
    """

    parameters: Parameters
    covariance: JointCovariance
    range_error_prior: RangeErrorPrior | None
    effect_sigmas: FloatArray


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Determined(Value):
    """What the readings determine; see `observability`.

    Attributes
    ----------
    rank, unknowns : int
    condition : float or None
        Condition number in natural units; None when rank is short.
    undetermined : tuple of str
        What is undetermined, in words.
    advice : tuple of str
        Which motion would determine it.
    open_parts : tuple of OpenPart
        The same as names and axes.
    indices : Indices or None
        Observability indices O1 to O4; None when rank is short.
    weakest : str
        Along what the solution is least certain, in words; empty when rank is short.
    """

    rank: int
    unknowns: int
    condition: float | None
    undetermined: tuple[str, ...] = ()
    advice: tuple[str, ...] = ()
    open_parts: tuple[OpenPart, ...] = ()
    indices: Indices | None = None
    weakest: str = ""


OF_GRAPH = "graph"


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class StartReport(Value):
    """Which start was used, and the rms residual [m] of every start tried, lowest first.

    The method is `OF_GRAPH` of a calibration that was read from a graph.
    """

    method: str
    tried: tuple[tuple[str, float], ...]


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
    shared: InCommon | None = None
    correlations: tuple[Correlation, ...] = ()
    at_scales: ScaledSolution | None = None
    learned: LearnedScales | None = None
    errors_by_pose: SizesByPose | None = None
    systematic: tuple[SystematicError, ...] = ()
    recording: Recording | None = None
    range_error_prior: RangeErrorPrior | None = None
    cost: float = math.nan
    sensor_kind: str | None = None
    effects: tuple[FreedEffect, ...] = ()
    recorded: Recording | None = None

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
    def reading_variances(self) -> Variances:
        """Variances behind the weights, also where all readings weigh the same."""
        alike = np.full(len(self.beams), self.fit.range_sigma)
        return Variances(alike) if self.variances is None else self.variances

    @property
    def pose_covariance(self) -> FloatArray | None:
        """What hand poses err by (6, 6): of the first station that was used; None if exact."""
        if self.variances is None or self.variances.pose is None:
            return None
        pose = self.variances.pose
        used = np.flatnonzero(pose.any(axis=(1, 2)))
        return pose[used[0]] if used.size else None

    def used_in(self, recording: Recording) -> Recording:
        """Return the stations and readings that were used; of `recording` where none is held.

        Raises
        ------
        InputError
            None is held, as of a graph, and `recording` has other beams, or another number of stations
            than the fit has rows.
        """
        held, rows = self.recording or recording, self.fit.residuals
        if held.beam_names != tuple(self.beams) or held.ranges.shape != rows.shape:
            stations, beams = held.ranges.shape
            found = f"another recording, of {count(stations, 'station')} and {count(beams, 'beam')}"
            expected = f"the one of the calibration, whose fit has {count(len(rows), 'row')}"
            raise InputError(found, f"{expected}; the result of hl.read_graph has none")
        return held.without(np.isnan(rows))

    def intervals(self, beam: str, level: float = CONFIDENCE) -> FloatArray | None:
        """Return where each coordinate of a beam lies with probability `level`, (8, 2).

        Gaussian, or Student's t where the residuals alone tell the range sigma, a scale over which
        nothing is integrated. None where there are no standard deviations; infinite
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
        given = self.fit.range_sigma_given and not self.noise_estimate
        known = given or self.learned is not None
        tail = 0.5 * (1.0 + level)
        factor = float(
            gaussian_quantile(tail) if known else student_quantile(tail, max(self.fit.dof, 1))
        )
        return np.stack((value - factor * sigma, value + factor * sigma), axis=1)
