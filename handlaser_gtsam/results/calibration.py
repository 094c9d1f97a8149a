"""The result of a calibration."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from ..errors import InputError
from ..model.families import BEAM, PLANE, Family
from ..model.losses import Loss
from ..model.weighting import weighed, whitening
from ..quantities import UNIT_SIGMA
from .calibration_data import Beam, CalibrationData, Plane
from .limits import Limits
from .result import Result
from .verdict import Verdict
from .verdict import verdict as verdict_on

if TYPE_CHECKING:  # both take long to import, and few need them
    import polars as pl

    from ..solvers.graph import CalibrationGraph
    from .description.beams import CalibrationDescription


class Calibration(CalibrationData, Result):
    """Beams and planes with their uncertainty, and how they were found.

    Attributes
    ----------
    status : str
        `converged`; `unobservable` when the recording leaves something open: numbers are then
        one of many solutions and have no covariance; `not_converged` when no solver converged, or
        when the readings do not fit each other.
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
        Standard deviations of the noise that were estimated with the mounts.
    covariance : JointCovariance or None
        Of all beams and planes together; None unless everything is determined.
    shared : InCommon or None
        What errors that stations have in common add to the covariance of the beams; None where they
        have none, or where it is not known.
    correlations : tuple of Correlation
        Unknowns of the beams that the recording hardly tells apart.
    at_scales : ScaledSolution or None
        The solution at the most probable scales, where they were.
    errors_by_pose : SizesByPose or None
        Errors of the hand that change with its pose; None where it does not err, the loss is robust, or
        not everything is determined.
    learned : LearnedScales or None
        The scales of noise and range errors that were integrated over.
    systematic : tuple of SystematicError
        What the recording says of errors that the model leaves out.
    recording : Recording or None
        What was solved: repeated stations are merged, readings that are codes taken out, and poses
        and readings without the systematic errors that were unknowns. None where it is not known.
    range_error_prior : RangeErrorPrior or None
        The prior of the range errors at the most probable scales, beams as in the recording.
    cost : float
        What the solver minimised, as GTSAM counts it: half the squares (or the robust loss) of the
        residuals and the priors in units of their standard deviations. NaN where nothing was solved.
    sensor_kind : str or None
        What the options say of the sensor: which systematic errors are plausible of it.
    effects : tuple of FreedEffect
        Systematic errors that were unknowns, with their estimates.
    recorded : Recording or None
        `recording` with these errors; None where there are none.
    """

    __slots__ = ()

    def problem(self) -> "CalibrationGraph":
        """Return the factor graph that was solved, in the world frame, with the keys of everything.

        Rejected readings are not in it. Its values are the estimate, or the solution at the most
        probable scales where scales were integrated over. Hand poses that are variables stand at
        their recorded values: `hl.optimize` moves them to their optimum.

        Raises
        ------
        InputError
            The calibration does not hold its recording: it was read from a graph.
        """
        from ..solvers.graph import build_graph, pose_priors

        recording, fit, variances = self.recording, self.fit, self.variances
        if recording is None:
            raise InputError(
                "a calibration without its recording", "one that hl.calibrate returned"
            )
        used = np.where(np.isnan(fit.residuals), np.nan, recording.ranges)
        readings = replace(recording, ranges=used).readings()
        at = self.parameters() if self.at_scales is None else self.at_scales.parameters
        terms, loss = tuple(beam.terms for beam in self.beams.values()), Loss(fit.loss)
        if variances is None:
            sigma = fit.range_sigma or UNIT_SIGMA
            return build_graph(readings, at, terms, sigma, loss, None, self.range_error_prior)
        readings, _ = weighed(readings, at, variances, max(terms))
        priors = None
        if fit.poses == "estimated" and variances.pose is not None:
            priors = pose_priors(readings, variances.pose)
            variances = variances.without_poses()
        how = whitening(at, readings, variances)
        return build_graph(readings, at, terms, how, loss, priors, self.range_error_prior)

    def judged(self, limits: Limits | None = None, reading: float | None = None) -> Verdict:
        """Return the verdict by what a user demands, at a working distance [m].

        That is the median reading where not given.
        """
        return verdict_on(self, limits, reading)

    def described(self, verdict: Verdict) -> "CalibrationDescription":
        """Return what there is to say of it under a verdict, for the views of this package."""
        from .description.beams import CalibrationDescription

        return CalibrationDescription(self, verdict)

    def to_polars(self) -> "tuple[pl.DataFrame, pl.DataFrame]":
        """Return a table of the beams and one of the planes, a row each.

        Columns of the first: `beam`, `terms`, `x_m`, `y_m`, `z_m`, `vx`, `vy`, `vz`, `k1`, `k2_per_m`;
        of the second: `plane`, `nx`, `ny`, `nz`, `b_m`. Then the standard deviation of every
        coordinate, as `x_sigma_m`: infinite where the recording leaves it undetermined, null where
        nothing is known.
        """
        beams, planes = list(self.beams.values()), list(self.planes.values())
        terms = {"terms": [beam.terms for beam in beams]}
        of_beams = _table({"beam": list(self.beams), **terms}, BEAM, beams)
        return of_beams, _table({"plane": list(self.planes)}, PLANE, planes)


def _table(
    first: Mapping[str, object], family: Family, rows: Sequence[Beam | Plane]
) -> "pl.DataFrame":
    """Return a table of its first columns, then of coordinates, then of their standard deviations."""
    import polars as pl

    values, sigmas = {}, {}
    for index, (name, key) in enumerate(zip(family.numbers, family.keys, strict=True)):
        values[key] = [one.coordinates[index] for one in rows]
        known = [None if one.sigma is None else one.sigma[index] for one in rows]
        sigmas[f"{name}_sigma{key.removeprefix(name)}"] = known
    numbers = values | sigmas
    return pl.DataFrame({**first, **numbers}, schema_overrides=dict.fromkeys(numbers, pl.Float64))
