"""Planes and stations held out of a calibration and predicted, without another calibration.

`validate` calibrates from nothing for every part that it holds out. Here the calibration is
the start: its choice of readings, its noise and its prior of range errors stay as they are, and a few
Gauss-Newton steps lead to the solution without that part. That takes milliseconds a plane, and is the
same solution where noise and prior are given. Where they were learned from everything, the part that is
held out has contributed to them.
"""

from dataclasses import replace

import numpy as np

from ..arrays import BoolArray, evenly
from ..checks import require_kind
from ..data.noise import Noise
from ..data.parameters import Parameters
from ..data.readings import Readings
from ..data.recording import Recording
from ..errors import SolverError
from ..estimation.solution import covariance_of_determined
from ..model.joint import JointCovariance
from ..model.losses import GAUSSIAN
from ..model.weighting import Variances, Whitening, weighed
from ..observability.rank import Observability, observability
from ..quantities import MOST_ROUNDS, NEGLIGIBLE
from ..results.calibration import Calibration
from ..results.mounts import Mounts
from ..solvers.beam_problem import newton_step
from .other_recording import HoldOut, hold_out
from .prediction import Prediction, predicted
from .validation import USUAL_SPLITS, Validation, drawn, leave_out


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

    Raises
    ------
    SolverError
        A calibration that did not converge, does not hold its recording, has a robust loss, or differs
        in its range-error terms from beam to beam.
    """

    def __init__(self, calibration: Calibration) -> None:
        recording, fit = calibration.recording, calibration.fit
        terms = {beam.terms for beam in calibration.beams.values()}
        if calibration.status != "converged" or recording is None:
            raise SolverError("no calibration that holds its recording")
        if fit.loss != GAUSSIAN.name or len(terms) > 1:
            raise SolverError(f"a {fit.loss} loss, or beams of different range errors")
        self.recording, self.terms = calibration.used_in(recording), terms.pop()
        if self.recording.beam_names != recording.beam_names:
            raise SolverError("a beam that lost all its readings")
        scaled = calibration.at_scales
        self.at = calibration.parameters() if scaled is None else scaled.parameters
        self.variances, self.prior = calibration.reading_variances, calibration.range_error_prior

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

    def known_by(
        self, chosen: BoolArray, *, solve: bool = False
    ) -> tuple[Parameters, JointCovariance]:
        """Return beams and planes as the `chosen` (M,) stations alone know them, world frame.

        They stay where they stand unless these stations are to `solve` for them.

        Raises
        ------
        SolverError
            They leave something undetermined, or no solution is near.
        InputError
            Nothing was read there.
        GrazingBeamError
        """
        part, variances = self.stations(chosen)
        beams = [self.recording.beam_names.index(name) for name in part.beam_names]
        planes = [self.recording.plane_names.index(name) for name in part.plane_names]
        readings, prior = part.readings(), self.prior
        origins = readings.plane_means(readings.world_t_hand)
        readings, at = readings.seen_from(origins), self.at.part(beams, planes).seen_from(origins)
        prior = None if prior is None else prior.part(beams)

        def seen(at: Parameters) -> tuple[Observability, Readings, Whitening]:
            corrected, how = weighed(readings, at, variances, self.terms)
            found = observability(at, corrected, self.terms, how.sigma, whitening=how, prior=prior)
            if not found.full:
                lost = found.unknowns - found.rank
                raise SolverError(f"{lost} of {found.unknowns} unknowns are undetermined")
            return found, corrected, how

        found, corrected, how = seen(at)
        if solve:
            for _ in range(MOST_ROUNDS):  # about five
                at, length = newton_step(at, corrected, self.terms, how, prior)
                if length < NEGLIGIBLE:  # in standard deviations
                    break
                corrected, how = weighed(readings, at, variances, self.terms)
            else:
                raise SolverError("no solution was found near the whole one")
            found, _, how = seen(at)
        joint = covariance_of_determined(found, at, how.sigma, origins)
        named = joint.arranged(
            [(name, i) for i, name in enumerate(part.beam_names)],
            [(name, p) for p, name in enumerate(part.plane_names)],
        )
        return at.seen_from(-origins), named


def held_out(calibration: Calibration) -> Validation:
    """Predict every plane, and 30 % of all stations several times, from the rest of the recording.

    Of many planes only some are held out, evenly spread: as many as take a second or two. The splits
    are the same each time.

    Raises
    ------
    InputError
        What is no calibration.
    SolverError
        `WholeSolution` knows of nothing to hold out.
    """
    require_kind("calibration", calibration, Calibration)
    whole = WholeSolution(calibration)
    fit, planes = calibration.fit, whole.recording.plane_names
    known = fit.range_sigma_given or bool(calibration.noise_estimate)
    sigma = fit.range_sigma if known else None

    def of_plane(out: BoolArray) -> HoldOut:
        at, joint = whole.known_by(~out, solve=True)
        held, variances = whole.stations(out)
        exact = 0.0 if variances.pose is None else None
        noise = Noise(sigma, exact, exact, variances.incidence_sigma, variances.pose)
        S = joint.matrix(planes=[])
        mounts = Mounts(joint.beam_names, *at.beams, joint.terms, S, variances.range_sigma)
        return hold_out(mounts, held, noise, each_beam=False)

    def of_split(out: BoolArray) -> Prediction:
        at, joint = whole.known_by(~out, solve=True)
        return predicted(at, joint, *whole.stations(out))

    # The cost of one plane that is held out is linear in the number of planes.
    count = len(planes)
    most = 0 if count < 2 else max(2000 // count, 10)
    of = whole.recording.plane_of_station
    stations = {planes[p]: of == p for p in evenly(count, most)}
    rng = np.random.default_rng(0)
    draws = (drawn(of, rng) for _ in range(USUAL_SPLITS))
    total = 1 + len(stations) + USUAL_SPLITS
    parts = leave_out(stations, draws, of_plane, of_split, total, kind="plane ")
    return Validation(calibration, *parts)
