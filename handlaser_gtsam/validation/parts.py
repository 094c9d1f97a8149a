"""The solution of a calibration from some of its stations only, in milliseconds.

The readings that were used, the noise and the prior of range errors stay as they were found from
everything; only beams and planes are solved for, by Gauss-Newton steps from where they stood. It is
the same solution as `calibrate` where noise and prior are given.
"""

from dataclasses import dataclass, replace

import numpy as np

from ..arrays import BoolArray, FloatArray
from ..data.parameters import Parameters, RangeErrorPrior
from ..data.readings import Readings
from ..data.recording import Recording
from ..errors import SolverError
from ..estimation.covariance import covariance_of_determined
from ..model.errors_in_variables import weighed
from ..model.joint import JointCovariance
from ..model.losses import GAUSSIAN
from ..model.weighting import Variances
from ..observability.rank import Observability, observability
from ..results.calibration import Calibration
from ..solvers.beam_problem import newton_step

MOST_NEWTON_STEPS = 30
"""Steps to the solution of a part at most; it takes about five."""
SHORT_STEP = 1e-6
"""A step that is shorter, in standard deviations, ends the iteration."""


@dataclass(frozen=True, slots=True)
class PartSolution:
    """Beams and planes as some stations alone know them.

    Attributes
    ----------
    recording : Recording
        These stations.
    at : Parameters
        In its order, world frame.
    joint : JointCovariance
    """

    recording: Recording
    at: Parameters
    joint: JointCovariance


@dataclass(frozen=True, slots=True)
class WholeSolution:
    """What stays as it was found from everything.

    Attributes
    ----------
    recording : Recording
        The readings that were used.
    at : Parameters
        The solution, at the most probable scales where scales were integrated over.
    terms : int
        Range-error terms of every beam.
    variances : Variances
        Of the readings, by beam and station of the recording.
    prior : RangeErrorPrior or None
    """

    recording: Recording
    at: Parameters
    terms: int
    variances: Variances
    prior: RangeErrorPrior | None

    @classmethod
    def of(cls, calibration: Calibration) -> "WholeSolution":
        """Return what stays of a calibration.

        Raises
        ------
        SolverError
            It did not converge, does not hold its recording, has a robust loss, or differs in its
            range-error terms from beam to beam.
        """
        recording, fit = calibration.recording, calibration.fit
        terms = {beam.terms for beam in calibration.beams.values()}
        if calibration.status != "converged" or recording is None:
            raise SolverError("no calibration that holds its recording")
        if fit.loss != GAUSSIAN.name or len(terms) > 1:
            raise SolverError(f"a {fit.loss} loss, or beams of different range errors")
        used, variances = calibration.used_in(recording), calibration.variances
        if used.beam_names != recording.beam_names:
            raise SolverError("a beam that lost all its readings")
        scaled = calibration.at_scales
        at = calibration.parameters() if scaled is None else scaled.parameters
        if variances is None:
            variances = Variances(np.full(len(calibration.beams), fit.range_sigma))
        return cls(used, at, terms.pop(), variances, calibration.range_error_prior)

    def stations(self, chosen: BoolArray) -> tuple[Recording, Variances]:
        """Return the `chosen` (M,) stations, with the beams that read anything there, and their noise.

        Raises
        ------
        InputError
            Nothing was read there.
        """
        rows = np.flatnonzero(chosen & ~np.isnan(self.recording.ranges).all(axis=1))
        part, pose = self.recording.part(rows), self.variances.pose
        beams = [self.recording.beam_names.index(name) for name in part.beam_names]
        sigma = self.variances.range_sigma[beams]
        pose = None if pose is None else pose[rows]
        return part, replace(self.variances, range_sigma=sigma, pose=pose)

    def known_by(self, chosen: BoolArray) -> PartSolution:
        """Return beams and planes where they stand, with what the `chosen` stations know of them.

        Raises
        ------
        SolverError
            They leave something undetermined.
        InputError
            Nothing was read there.
        GrazingBeamError
        """
        problem = _Problem.of(self, chosen)
        return problem.solved(problem.at)

    def solved_from(self, chosen: BoolArray) -> PartSolution:
        """Return the solution from the `chosen` (M,) stations.

        Raises
        ------
        SolverError
            They leave something undetermined, or no solution is near.
        InputError
            Nothing was read there.
        GrazingBeamError
        """
        problem = _Problem.of(self, chosen)
        problem.determined(problem.at)
        at = problem.at
        for _ in range(MOST_NEWTON_STEPS):
            readings, how = weighed(problem.readings, at, problem.variances, self.terms)
            at, length = newton_step(at, readings, self.terms, how, problem.prior)
            if length < SHORT_STEP:
                return problem.solved(at)
        raise SolverError("no solution was found near the whole one")


@dataclass(frozen=True, slots=True)
class _Problem:
    """Some stations: their readings in the frames of the planes, and where beams and planes stood."""

    whole: WholeSolution
    recording: Recording
    readings: Readings
    origins: FloatArray
    at: Parameters
    variances: Variances
    prior: RangeErrorPrior | None

    @classmethod
    def of(cls, whole: WholeSolution, chosen: BoolArray) -> "_Problem":
        part, variances = whole.stations(chosen)
        beams = [whole.recording.beam_names.index(name) for name in part.beam_names]
        planes = [whole.recording.plane_names.index(name) for name in part.plane_names]
        readings, prior = part.readings(), whole.prior
        origins = readings.plane_means(readings.world_t_hand)
        if prior is not None:
            mean = None if prior.mean is None else prior.mean[beams]
            prior = RangeErrorPrior(prior.sigma[beams], mean)
        at = whole.at.part(beams, planes).seen_from(origins)
        return cls(whole, part, readings.seen_from(origins), origins, at, variances, prior)

    def determined(self, at: Parameters) -> tuple[Observability, float]:
        """Return what the readings say of everything, and the sigma of a whitened residual [m]."""
        terms, prior = self.whole.terms, self.prior
        readings, how = weighed(self.readings, at, self.variances, terms)
        found = observability(at, readings, terms, how.sigma, whitening=how, prior=prior)
        if not found.full:
            words = f"{found.unknowns - found.rank} of {found.unknowns} unknowns are undetermined"
            raise SolverError(words)
        return found, how.sigma

    def solved(self, at: Parameters) -> PartSolution:
        found, sigma = self.determined(at)
        joint = covariance_of_determined(found, at, sigma, self.origins)
        named = joint.arranged(
            [(name, i) for i, name in enumerate(self.recording.beam_names)],
            [(name, p) for p, name in enumerate(self.recording.plane_names)],
        )
        return PartSolution(self.recording, at.seen_from(-self.origins), named)
