"""What is to be solved; what a solver found, by the names of beams and planes; and how well it fits."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from ..arrays import BoolArray, FloatArray, IntArray, frozen
from ..data.noise import Noise
from ..data.parameters import Parameters
from ..data.recording import Order, Readings, Recording, typical_range
from ..estimation.options import ChosenPoses
from ..estimation.selection import Selection
from ..estimation.solution import Solution
from ..model.equation import residuals, scene
from ..model.families import BEAM, PLANE
from ..model.joint import JointCovariance
from ..model.losses import GAUSSIAN, LossName
from ..model.sensor_limits import FLAT, OUTSIDE, Rejected, Sensor
from ..model.weighting import Variances, reading_sigmas, whitening
from ..observability.wording import BeamAndPlaneNames
from ..outliers.reasons import Reasons, reasons
from .calibration_data import Beam, Fit, Plane
from .projection import FreedColumns, LinearRows


class Problem(NamedTuple):
    """Readings in the order of a solver, and the recording that names them.

    Attributes
    ----------
    recording : Recording
    readings : Readings
        All of them, in the world frame.
    order : Order
        From numbers in the readings to numbers in the recording.
    origins : (P, 3)
        Origin of the frame in which each plane is solved, in the world [m]; axes are the world's.
    noise : Noise
    sensor : Sensor
    more : int
        Unknowns beside beams and planes, as many as the readings determine: freed systematic errors.
    """

    recording: Recording
    readings: Readings
    order: Order
    origins: FloatArray
    noise: Noise
    sensor: Sensor
    more: int = 0

    @property
    def names(self) -> BeamAndPlaneNames:
        """Beams and planes with their numbers in the readings, in the order of the recording."""
        return BeamAndPlaneNames.of(self.recording, self.order)

    def chosen(self, rows: BoolArray) -> Readings:
        """Return some readings, every plane in its own frame."""
        return self.readings.subset(np.flatnonzero(rows)).seen_from(self.origins)

    def in_world(self, at: Parameters) -> Parameters:
        """Return a solution in the world frame, in the order of the recording."""
        in_world = at.seen_from(-self.origins)
        return in_world.part(np.argsort(self.order.beams), np.argsort(self.order.planes))


def named_estimates(
    beams: tuple[str, ...],
    planes: tuple[str, ...],
    at: Parameters,
    terms: tuple[int, ...],
    joint: JointCovariance | None,
    undetermined: tuple[BoolArray, BoolArray] | None = None,
) -> tuple[Mapping[str, Beam], Mapping[str, Plane]]:
    """Return the beams and planes of a solution by name; arrays in the order of the names.

    Parameters
    ----------
    beams, planes : tuple of str
    at : Parameters
        In the world frame.
    terms : tuple of int
        Range-error terms of each beam.
    joint : JointCovariance or None
        Of what is determined; None where standard deviations would mean nothing.
    undetermined : (B, 8) and (P, 4) of bool, optional
        Coordinates that have no standard deviation; all have one where not given.
    """
    masks = undetermined or (
        np.zeros((len(beams), BEAM.size), bool),
        np.zeros((len(planes), len(PLANE.numbers)), bool),
    )
    of_beams = _known(None if joint is None else joint.all_beams(), masks[0])
    of_planes = _known(None if joint is None else joint.all_planes(), masks[1])
    rows = zip(beams, *at.beams, terms, of_beams, strict=True)
    faces = zip(planes, at.normals, at.offsets.tolist(), of_planes, strict=True)
    return (
        MappingProxyType({name: Beam(name, r, v, k, n, *own) for name, r, v, k, n, own in rows}),
        MappingProxyType({name: Plane(name, n, b, *own) for name, n, b, own in faces}),
    )


def _known(
    covariances: Sequence[FloatArray] | FloatArray | None, undetermined: BoolArray
) -> list[tuple[FloatArray | None, FloatArray | None]]:
    """Return covariances, where all coordinates are determined, and standard deviations."""
    if covariances is None:
        return [(None, None)] * len(undetermined)
    every = frozen(covariances)
    variances = np.maximum(np.diagonal(every, axis1=1, axis2=2), 0.0)
    sigmas = frozen(np.where(undetermined, np.inf, np.sqrt(variances)))
    opened: list[bool] = np.asarray(undetermined.any(axis=1)).tolist()
    return [
        (None if is_open else covariance, sigma)
        for covariance, sigma, is_open in zip(every, sigmas, opened, strict=True)
    ]


def fit_of_rows(
    names: tuple[Sequence[str], Sequence[str]],
    at: tuple[IntArray, IntArray],
    e: FloatArray,
    standardized: FloatArray,
    ranges: FloatArray,
    *,
    chi2: float,
    dof: int,
    range_sigma: float,
    given: bool,
    poses: ChosenPoses,
    loss: LossName,
) -> Fit:
    """Return the fit of residuals e (N,) [m], of which nothing is rejected; see `Fit` for the rest.

    `names` name the stations and the beams, the rows and columns of the table of residuals,
    and `at` says where in it each residual stands. `standardized` are residuals in units of their own
    standard deviations, and `ranges` the readings [m], NaN where they are not known.
    """
    far, known = np.abs(standardized), ranges[~np.isnan(ranges)]
    tables = np.full((2, len(names[0]), len(names[1])), np.nan)
    tables[:, *at] = e, standardized
    worst, farthest = int(np.abs(e).argmax()), int(far.argmax())
    pairs = [(int(at[0][row]), int(at[1][row])) for row in (worst, farthest)]
    places = [(names[0][station], names[1][beam]) for station, beam in pairs]
    return Fit(
        readings=len(e),
        rms=float(np.sqrt(float(e @ e) / len(e))),
        max_residual=float(np.abs(e[worst])),
        max_residual_at=places[0],
        chi2=chi2,
        dof=dof,
        sigma0=_sigma0(chi2, dof),
        range_sigma=range_sigma,
        range_sigma_given=given,
        poses=poses,
        loss=loss,
        median_reading=float(np.median(known)) if known.size else np.nan,
        typical_range=typical_range(known) if known.size else np.nan,
        max_standardized_residual=float(far[farthest]),
        max_standardized_residual_at=places[1],
        residuals=tables[0],
        standardized=tables[1],
        rejected=(),
    )


def linear_rows(
    problem: Problem, selection: Selection, freed: FreedColumns | None = None
) -> LinearRows:
    """Return the linear problem at a solution, with the systematic errors that are unknowns."""
    solution, used = selection.solution, problem.chosen(selection.used)
    how, at = solution.whitening, solution.parameters
    if how is None:
        equal = Variances(np.full(used.beams, solution.at.sigma))
        how = replace(whitening(at, used, equal), sigma=unit_sigma(problem, solution))
    prior = np.where(np.arange(2) < solution.terms, np.inf, 0.0)
    prior = np.tile(prior, (used.beams, 1)) if solution.prior is None else solution.prior.sigma
    position = problem.order.stations[used.station]
    readings = solution.at.readings
    return LinearRows(at, readings, how, prior, position, problem.order.beams, freed)


def _chi2_of(problem: Problem, solution: Solution) -> tuple[float, int]:
    """Return chi2 and its degrees of freedom."""
    chi2 = solution.chi2
    if problem.noise.range_sigma is None and not solution.scales_estimated:
        chi2 *= solution.at.sigma**2
    return chi2, solution.dof - problem.more


def fit_of(problem: Problem, selection: Selection) -> tuple[Fit, Reasons]:
    """Return the fit, and the reasons for what was rejected, in the order of the recording."""
    solution, recording, order = selection.solution, problem.recording, problem.order
    used = problem.chosen(selection.used)
    e = solution.at.residual
    if solution.posterior is not None and not solution.at.estimates_poses:
        e = residuals(scene(solution.best, used), used.distance)
    at, (chi2, dof) = solution.parameters, _chi2_of(problem, solution)
    sigma = unit_sigma(problem, solution)
    if solution.variances is not None:
        sigma *= float(np.median(solution.variances.range_sigma)) / solution.at.sigma
    standardized = np.zeros(len(e))  # of an exact fit
    if solution.variances is not None:
        variances = solution.variances
        if solution.at.estimates_poses:  # what is left once the poses have moved
            variances = variances.without_poses()
        standardized = e / reading_sigmas(at, used, variances)
    elif sigma > 0.0:
        standardized = e / sigma
    fit = fit_of_rows(
        (recording.station_names, recording.beam_names),
        (order.stations[used.station], order.beams[used.beam]),
        e,
        standardized,
        used.distance,
        chi2=chi2,
        dof=dof,
        range_sigma=sigma,
        given=problem.noise.range_sigma is not None,
        poses=solution.poses,
        loss=solution.at.loss.name,
    )
    in_world = solution.best.seen_from(-problem.origins)
    fitted = max(sigma, float(np.sqrt(float(e @ e) / max(fit.dof, 1))))
    kept = ~selection.outliers()
    why = reasons(problem.readings, kept, in_world, fitted, problem.names)
    return replace(fit, rejected=_rejected(problem, selection, why)), why


def _sigma0(chi2: float, dof: int) -> float:
    return float(np.sqrt(chi2 / dof)) if dof > 0 else 0.0


def unit_sigma(problem: Problem, solution: Solution) -> float:
    """Return the sigma [m] of a residual of weight 1 behind the covariances.

    Of a robust loss it is its scale: outliers would spoil what is estimated from residuals.
    """
    given = problem.noise.range_sigma is not None
    known = given or solution.scales_estimated or solution.at.loss != GAUSSIAN
    return solution.at.sigma if known else _sigma0(*_chi2_of(problem, solution))


def _rejected(problem: Problem, selection: Selection, why: Reasons) -> tuple[Rejected, ...]:
    """Name what was rejected, in the order of the recording."""
    recording, readings, order = problem.recording, problem.readings, problem.order
    words = np.full(len(readings), "", dtype=object)
    words[selection.outliers()] = why.words
    words[selection.flat] = FLAT
    words[selection.outside] = OUTSIDE
    station, beam = order.stations[readings.station], order.beams[readings.beam]
    rows = np.flatnonzero(~selection.used)
    rows = rows[np.lexsort((beam[rows], station[rows]))]
    known = np.isfinite(why.residual) & ~selection.outside
    return tuple(
        Rejected(
            recording.station_names[station[row]],
            recording.beam_names[beam[row]],
            recording.plane_labels[station[row]],
            str(words[row]),
            float(why.residual[row]) if known[row] else None,
        )
        for row in rows
    )
