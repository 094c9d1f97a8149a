"""How well a calibration predicts parts of its recording when it does not see them.

The calibration is the start: its choice of readings, its noise and its prior of range errors stay as
they are, and a few Gauss-Newton steps lead to the solution without that part. That takes milliseconds a
plane, and is the solution of a calibration without that part where noise and prior are given. Where
they were learned from everything, the part that is held out has contributed to them.
"""

from contextlib import suppress
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from ..arrays import BoolArray, evenly
from ..checks import require_count, require_kind
from ..data.noise import Noise
from ..data.parameters import Parameters, RangeErrorPrior
from ..data.readings import Readings
from ..data.recording import Recording
from ..data.value import Value
from ..errors import GrazingBeamError, InputError, SolverError
from ..estimation.options import CalibrationOptions
from ..estimation.posterior import covariance_of_determined
from ..model.distributions import chance, contradicted
from ..model.errors_in_variables import weighed
from ..model.joint import JointCovariance
from ..model.losses import GAUSSIAN
from ..model.weighting import Variances, Whitening
from ..observability.rank import Observability, observability
from ..pipeline import calibrate, calibrate_from
from ..progress import Listener, tell, told_to
from ..quantities import MOST_ROUNDS, NEGLIGIBLE
from ..results.calibration import Calibration
from ..results.limits import Limits, rms_checked
from ..results.lines import NAMES_IN_LINE
from ..results.mounts import Mounts
from ..results.verdict import Verdict, failures, verdict
from ..solvers.beam_problem import newton_step
from ..text import some
from .hold_out import HoldOut, hold_out
from .prediction import Prediction, predicted, reconstruction
from .simulate import generator

PART_LEFT_OUT = 0.3
"""Part of the stations that a random split predicts; in recordings, of the stations of every plane."""
USUAL_SPLITS = 5
"""Random splits of the stations: enough to see how predictions scatter."""
UNSOLVED = (InputError, SolverError, GrazingBeamError)
"""What a part of a recording ends in that does not determine a solution near the whole one."""


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class PlaneLeftOut(Value):
    """What was found without one plane, and how its beams fit that plane; None where it failed."""

    plane: str
    result: HoldOut | None
    message: str


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Validation(Value):
    """What a recording says about its own calibration.

    Attributes
    ----------
    calibration : Calibration
        From everything.
    planes : tuple of PlaneLeftOut
        Empty where there is one plane only; some of more than forty.
    splits : tuple of Prediction
        30 % of the stations of every plane, predicted from the others.
    reconstruction, without_range_error : Prediction or None
        The plane reconstructed from all beams at one station predicts the ranges at the others
        (section 3.2 of Wei and Hirzinger), with the range errors chosen and, by `validate`, with none;
        None where no station has three beams that span a plane.
    message : str
        Why nothing was held out; empty where something was.
    """

    calibration: Calibration
    planes: tuple[PlaneLeftOut, ...] = ()
    splits: tuple[Prediction, ...] = ()
    reconstruction: Prediction | None = None
    without_range_error: Prediction | None = None
    message: str = ""


def validate(
    recording: Recording,
    noise: Noise | None = None,
    options: CalibrationOptions | None = None,
    *,
    splits: int = USUAL_SPLITS,
    rng: np.random.Generator | None = None,
    progress: Listener | None = None,
) -> Validation:
    """Calibrate a recording, and validate that by leaving parts of it out.

    Parameters
    ----------
    recording : Recording
    noise : Noise, optional
    options : CalibrationOptions, optional
    splits : int
        Random 70/30 splits.
    rng : numpy.random.Generator, optional
        Chooses the splits; the same ones each time where not given.
    progress : callable, optional
        Called with a `Progress` in every phase of the calibration, and before every part left out.

    Raises
    ------
    InputError
        No sensible number of splits, or what `calibrate` refuses.
    SolverError
        The whole recording gives no calibration.
    """
    require_count("splits", splits, 0, 10**9)
    rng, noise = generator(rng), Noise() if noise is None else noise
    of_surveys = "a Recording; hl.validation.validate_survey takes a Survey"
    require_kind("recording", recording, Recording, of_surveys)
    options = CalibrationOptions() if options is None else options
    with told_to(progress):
        whole = calibrate(recording, noise, options)
        if whole.interrupted:  # Ctrl-C ends everything
            raise KeyboardInterrupt
        if whole.status != "converged":
            raise SolverError(f"no calibration to validate: {whole.message}")
        found, kept = validated(whole, splits, rng), whole.used_in(recording)
        plain = replace(options, range_error="none", outliers="keep", free=())
        bare = calibrate_from(whole.parameters(), kept, noise, plain)
        if bare.interrupted:
            raise KeyboardInterrupt
        bare_error = reconstruction(bare.parameters().beams, kept)
        return replace(found, without_range_error=bare_error)


def validated(
    calibration: Calibration, splits: int = USUAL_SPLITS, rng: np.random.Generator | None = None
) -> Validation:
    """Predict every plane, and 30 % of all stations several times, from the rest of the recording.

    Of many planes only some are held out, evenly spread: as many as take a second or two. Arguments
    are as `validate` has them.

    Returns
    -------
    Validation
        With nothing but the reason where `WholeSolution.of` knows of nothing to hold out.

    Raises
    ------
    InputError
        What is no calibration.
    """
    require_kind("calibration", calibration, Calibration)
    rng = generator(rng)
    try:
        whole = WholeSolution.of(calibration)
    except SolverError as error:
        return Validation(calibration, message=str(error))
    recording, fit = whole.recording, calibration.fit
    known = fit.range_sigma_given or bool(calibration.noise_estimate)
    # The cost of one plane that is held out is linear in the number of planes.
    count = len(recording.plane_names)
    held_out = evenly(count, 0 if count < 2 else max(2000 // count, 10)).tolist()
    total = len(held_out) + splits
    left_out, predictions = [], []
    for number, p in enumerate(held_out):
        tell("leave-out", number, total, f"without plane {recording.plane_names[p]}")
        mine = recording.plane_of_station == p
        try:
            at, joint = whole.known_by(~mine, solve=True)
            held, variances = whole.stations(mine)
            exact = 0.0 if variances.pose is None else None
            sigma = fit.range_sigma if known else None
            noise = Noise(sigma, exact, exact, variances.incidence_sigma, variances.pose)
            typical, S = float(np.median(variances.range_sigma)), joint.matrix(planes=[])
            mounts = Mounts(joint.beam_names, *at.beams, joint.terms, S, typical)
            result, message = hold_out(mounts, held, noise, each_beam=False), ""
        except UNSOLVED as error:
            result, message = None, str(error)
        left_out.append(PlaneLeftOut(recording.plane_names[p], result, message))
    for number in range(splits):
        tell("leave-out", len(held_out) + number, total, f"split {number + 1}")
        training = np.zeros(len(recording.plane_labels), dtype=bool)
        for p in range(count):
            rows = np.flatnonzero(recording.plane_of_station == p)
            most = int(np.ceil((1.0 - PART_LEFT_OUT) * len(rows)))
            training[rng.permutation(rows)[:most]] = True
        # Where the training stations do not suffice there is no prediction.
        with suppress(*UNSOLVED):
            at, joint = whole.known_by(training, solve=True)
            predictions.append(predicted(at, joint, *whole.stations(~training)))
    shown = reconstruction(calibration.parameters().beams, recording)
    return Validation(calibration, tuple(left_out), tuple(predictions), shown)


class WholeSolution(NamedTuple):
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
        if prior is not None:
            mean = None if prior.mean is None else prior.mean[beams]
            prior = RangeErrorPrior(prior.sigma[beams], mean)

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


def verdict_of_validation(validation: Validation, limits: Limits | None = None) -> Verdict:
    """Return the verdict on a calibration that was validated by holding planes out.

    Beside the verdict on the calibration itself: the rms limit holds for planes held out, too, and
    none of them contradicts the beams found without it.
    """
    found = verdict(validation.calibration, limits)
    left_out = {one.plane: one.result for one in validation.planes if one.result is not None}
    checks = tuple(
        check
        for plane, result in left_out.items()
        for check in rms_checked(f"without plane {plane}", result.rms, limits or Limits())
    )
    p_values = {plane: result.p_value for plane, result in left_out.items()}
    against, last = contradicted(p_values), found.best.clause
    found = replace(found, limits=(*found.limits, *checks), contradicted_by=against)
    if not found.usable:
        return found
    if against:
        rarest = chance(min(p_values[plane] for plane in against))
        words = f"planes {some(against, NAMES_IN_LINE)} contradict"
        if len(against) == 1:
            words = f"plane {against[0]} contradicts"
        words = f"{words} the beams found without it (by chance {rarest} recordings)"
        return replace(found, code="contradicted", findings=(words, last))
    if found.exceeded:
        return replace(found, code="outside-limits", findings=(failures(found.limits), last))
    return replace(found, confirmed_by=len(p_values))
