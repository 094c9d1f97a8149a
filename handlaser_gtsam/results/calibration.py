"""The result of a calibration."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal

import numpy as np
from scipy.stats import norm
from scipy.stats import t as student

from ..arrays import FloatArray
from ..checks import require_kind, require_number
from ..data.noise import Noise
from ..data.parameters import Parameters, RangeErrorPrior
from ..data.recording import Recording
from ..data.value import Value
from ..errors import CalibrationWarning, InputError
from ..estimation.learned import LearnedScales
from ..estimation.mixture import mixture_quantiles
from ..model.joint import JointCovariance
from ..model.weighting import Variances
from .correlations import Correlation
from .estimates import Beam, Plane
from .reports import (
    BeamMixture,
    Determined,
    Fit,
    NoiseComponent,
    RangeErrorScales,
    ScaledSolution,
    StartReport,
)
from .systematic import SystematicError

if TYPE_CHECKING:
    import gtsam
    import polars as pl

    from ..solvers.graph import CalibrationGraph
    from .limits import Limits

__all__ = [
    "Beam",
    "BeamMixture",
    "Calibration",
    "Determined",
    "Fit",
    "NoiseComponent",
    "Plane",
    "RangeErrorScales",
    "ScaledSolution",
    "StartReport",
    "Status",
]

Status = Literal["converged", "unobservable", "not_converged"]


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Calibration(Value):
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
    range_error_prior : RangeErrorPrior or None
        The prior of the range errors at the most probable scales, beams as in the recording.
    cost : float
        What the solver minimised, as GTSAM counts it: half the squares (or the robust loss) of the
        residuals and the priors in units of their standard deviations. NaN where nothing was solved.

    Notes
    -----
    A calibration can be pickled, copied and compared, which GTSAM graphs with Python factors cannot.
    So it does not keep its graph: `problem`, and `graph` and `values` after it, build it again.
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
    range_error_prior: RangeErrorPrior | None = None
    cost: float = math.nan

    @property
    def success(self) -> bool:
        """Whether the solver converged on a solution that the recording determines."""
        return self.status == "converged"

    def problem(self) -> "CalibrationGraph":
        """Return the factor graph that was solved, in the world frame, with the keys of everything.

        Rejected readings are not in it. Its values are the estimate, or the solution at the most
        probable scales where scales were integrated over. Hand poses that are variables stand at
        their recorded values: `hl.optimize` moves them to their optimum.

        Raises
        ------
        InputError
            The calibration does not hold its recording.
        """
        from .solved_graph import solved_graph  # which imports GTSAM

        return solved_graph(self)

    @property
    def graph(self) -> "gtsam.NonlinearFactorGraph":
        """The factor graph that was solved, built anew every time; see `problem`."""
        return self.problem().graph

    @property
    def values(self) -> "gtsam.Values":
        """The solution as GTSAM values, for `graph`; see `problem`."""
        return self.problem().values

    def summary(self, limits: "Limits | None" = None, reading: float | None = None) -> str:
        """Return what `handlaser calibrate` prints: the verdict first, 30 lines of 100 columns.

        But for the next best stations, which `hl.plan` chooses.

        Parameters
        ----------
        limits : Limits, optional
            What its user demands; the verdict says whether it holds.
        reading : float, optional
            Working distance at which laser spots are judged [m]; the median reading where not given.
        """
        from .screen import screen_lines  # which reads calibrations, as the verdict does
        from .verdict import verdict

        recording = self.recording
        return "\n".join(screen_lines(self, recording, verdict(self, recording, limits, reading)))

    def to_polars(self) -> "tuple[pl.DataFrame, pl.DataFrame]":
        """Return a table of the beams and one of the planes, a row each.

        Columns of the first: `beam`, `terms`, `x_m`, `y_m`, `z_m`, `vx`, `vy`, `vz`, `k1`, `k2_per_m`;
        of the second: `plane`, `nx`, `ny`, `nz`, `b_m`. Then the standard deviation of every
        coordinate, as `x_sigma_m`: infinite where the recording leaves it undetermined, null where
        nothing is known.
        """
        from .tables import beam_table, plane_table  # which import Polars

        return beam_table(self), plane_table(self)

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
        require_kind("noise", given, Noise)
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
