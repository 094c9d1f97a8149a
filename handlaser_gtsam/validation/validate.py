"""How well a calibration agrees with readings that it has not seen, of single targets or of splits.

A reading that was rejected as an outlier of the whole recording stays rejected. Of a survey the mounts
are found again with the rest alone, from where the whole ended, and what the other shots add to the
sum of squares is compared with what it should be; and SciPy solves its points again, by formulas of its
own (`solvers/reference`).
"""

from dataclasses import replace
from functools import partial

import numpy as np

from ..arrays import BoolArray, FloatArray
from ..checks import require_count, require_kind
from ..data.noise import Noise
from ..data.recording import Recording
from ..data.survey import Survey, normal_label
from ..errors import InputError, SolverError
from ..estimation.dense import spanned
from ..estimation.options import CalibrationOptions
from ..estimation.scales import FIELDS, RANGE
from ..estimation.survey import estimate_survey
from ..model.distributions import squares_sf
from ..model.families import POSE, pose_of
from ..model.sensors.mounted import SENSOR
from ..pipeline import calibrate, calibrate_from
from ..progress import Listener, tell, told_to
from ..results.calibration import Calibration
from ..results.mounts import Mounts
from ..results.spots import radius, spot_of
from ..results.survey import Mount, SurveyCalibration, survey_calibration
from .cross_check import cross_check, fits
from .other_recording import HoldOut, hold_out
from .prediction import Prediction, SurveyPrediction, predict, reconstruction
from .simulate import generator
from .validation import USUAL_SPLITS, Validation, drawn, leave_out


def validate(
    recording: Recording | Survey,
    noise: Noise | None = None,
    options: CalibrationOptions | None = None,
    *,
    splits: int = USUAL_SPLITS,
    rng: np.random.Generator | None = None,
    progress: Listener | None = None,
) -> Validation:
    """Validate the calibration of a recording by leaving parts of it out.

    A survey is solved again by SciPy, too.

    Parameters
    ----------
    recording : Recording or Survey
        Beams before planes; or sensors of many rays, spheres, points and relations (then there are no
        options).
    noise : Noise, optional
    options : CalibrationOptions, optional
    splits : int
        Random 70/30 splits.
    rng : numpy.random.Generator, optional
        Chooses the splits; the same ones each time where not given.
    progress : callable, optional
        Called with a `Progress` before every calibration, and in every phase of each.

    Raises
    ------
    InputError
        No sensible number of splits, or what `calibrate` refuses.
    SolverError
        The whole recording gives no calibration.
    """
    require_count("splits", splits, 0, 10**9)
    rng, noise = generator(rng), Noise() if noise is None else noise
    with told_to(progress):
        if isinstance(recording, Survey):
            if options is not None:
                raise InputError("options with a survey", "its own fields, such as free")
            return validate_survey(recording, noise, splits, rng)
        require_kind("recording", recording, Recording)
        options = CalibrationOptions() if options is None else options
        planes = recording.plane_names if len(recording.plane_names) > 1 else ()
        total = 2 + len(planes) + splits
        tell("leave-out", 0, total, "everything")
        whole = _ended(calibrate(recording, noise, options))
        if whole.status != "converged":
            raise SolverError(f"no calibration to validate: {whole.message}")
        kept = whole.used_in(recording)
        if not options.estimate_noise:  # what the readings contradict, the parts learn, too
            learned = {one.quantity for one in whole.noise_estimate}
            learned |= set() if whole.fit.range_sigma_given else {RANGE}
            covariance = ("pose_covariance",) if learned - {RANGE} else ()
            noise = noise.without((*covariance, *(FIELDS[one] for one in learned)))
        # Errors that are unknowns are taken out of all readings as the whole recording has them.
        keep = replace(options, outliers="keep", free=())

        def rest(out: BoolArray) -> Calibration:
            found = _ended(calibrate(*_part(kept, noise, ~out), keep))
            if found.status != "converged":
                raise SolverError(found.message)
            return found

        def of_plane(out: BoolArray) -> HoldOut:
            others, (held, seen) = rest(out), _part(kept, noise, out)
            seen = others.noise(seen) if others.noise_estimate else seen
            return hold_out(Mounts.of(others), held, seen)

        def of_split(out: BoolArray) -> Prediction:
            return predict(rest(out), *_part(kept, noise, out))

        labels = np.array(kept.plane_labels)
        stations = {plane: labels == plane for plane in planes}
        draws = (drawn(kept.plane_of_station, rng) for _ in range(splits))
        parts = leave_out(stations, draws, of_plane, of_split, total, kind="plane ")
        tell("leave-out", total - 1, total, "without range error")
        bare = _ended(
            calibrate_from(whole.parameters(), kept, noise, replace(keep, range_error="none"))
        )
        chosen, without = (reconstruction(one, kept) for one in (whole, bare))
        both = () if chosen is None or without is None else (chosen, without)
        return Validation(whole, *parts, both)


def _ended(calibration: Calibration) -> Calibration:
    """Return a calibration; Ctrl-C in it ends everything."""
    if calibration.interrupted:
        raise KeyboardInterrupt
    return calibration


def _part(recording: Recording, noise: Noise, stations: BoolArray) -> tuple[Recording, Noise]:
    """Return some stations, with their beams that read anything, and their noise."""
    rows = np.flatnonzero(stations & ~np.isnan(recording.ranges).all(axis=1))
    S = noise.pose_covariance
    seen = noise if S is None or S.ndim == 2 else replace(noise, pose_covariance=S[rows])
    return recording.part(rows), seen


def validate_survey(
    survey: Survey, noise: Noise, splits: int, rng: np.random.Generator
) -> Validation:
    """Calibrate a survey, solve it again with SciPy, and predict its parts from the rest.

    Raises
    ------
    InputError
        What `calibrate` refuses.
    SolverError
        A survey that has no minimum, or more than one.
    """
    labels = np.array([normal_label(label) for label in survey.stations.plane_labels])
    different = sorted(set(labels.tolist()))
    targets = {label: labels == label for label in different if len(different) > 1}
    total = 1 + len(targets) + splits
    tell("leave-out", 0, total, "everything")
    calibration = calibrate(survey, noise)
    if not fits(calibration):
        raise SolverError(calibration.verdict.sentence)
    reference = cross_check(calibration)
    predict = partial(_predicted, calibration)
    # Stations of one stop share the error of the hand, and go together.
    _, stop = np.unique(survey.stations.stops(*noise.standstill), return_inverse=True)
    every = np.zeros(int(stop.max()) + 1, np.intp)
    draws = (drawn(every, rng)[stop] for _ in range(splits))
    parts = leave_out(targets, draws, predict, predict, total)
    return Validation(calibration, *parts, reference=reference)


def _predicted(calibration: SurveyCalibration, out: BoolArray) -> SurveyPrediction:
    """Predict the shots of some stations (M,) from the rest of the survey.

    Raises
    ------
    HandlaserError
        The rest has no calibration, or says nothing about these shots.
    """
    whole = calibration._found
    test = [item for item in whole.rows.counted(whole.used) if out[item.station]]
    survey = whole.rows.survey
    rest = survey.part(~out) if (survey.stations_read() & ~out).any() else None
    if not test or rest is None or len(rest.shots) + len(rest.beam_names) < len(calibration.mounts):
        raise SolverError("nothing is left")
    found = estimate_survey(rest, whole.given, whole)
    if found.estimate.status != "converged":
        raise SolverError(survey_calibration(found).message)
    # The whole has the values of what the rest has not seen.
    values = {kind: x[None].copy() for kind, x in whole.estimate.values.items()}
    for kind, x in found.estimate.values.items():
        if kind in found.rows.targets:
            labels = whole.rows.targets[kind]
            values[kind][0, [labels.index(label) for label in found.rows.targets[kind]]] = x
        elif kind != POSE.name:
            values[kind][0, : len(x)] = x
    state = replace(whole.ended(found.noise), values=values)
    rows, owner = state.dense()
    J, e = rows.whitened()
    predicted = (owner >= 0) & out[state.stations(owner)]
    every, rank, covariance = _least_squares(J, e)
    known, known_rank, covariance_known = _least_squares(J[~predicted], e[~predicted])
    dof = int(predicted.sum()) - (rank - known_rank)
    squares = every - known
    if dof <= 0:
        raise SolverError("it says nothing about the mounts")
    redundancy = int((~predicted).sum()) - known_rank
    learned = bool(np.isnan([*whole.stated.sigma, *whole.stated.pose]).any())
    p = squares_sf(squares, dof, max(redundancy, 1) if learned else np.inf)
    # How far spots at working distance move; an estimate from a part errs beside that from the whole
    # by the difference of their covariances.
    added, place = covariance_known - covariance, state.problem()[0].places().place
    shifts = []
    for (family, number), name in whole.rows.mounts.items():
        both = [one[family][0, number] for one in (whole.values, values)]
        mount: Mount
        if family == SENSOR.name:
            mount = calibration.sensors[name]
            places = [R @ mount.spot + t for R, t in map(pose_of, both)]
        else:
            mount = calibration.beams[name]
            places = [spot_of(x, mount.reading)[0] for x in both]
        by = mount.spot_by()
        own = place[family][number] + np.arange(by.shape[1])
        chance = radius(by @ added[np.ix_(own, own)] @ by.T)
        shifts.append((float(np.linalg.norm(places[1] - places[0])), chance))
    largest = max(shifts, key=lambda one: one[0])
    return SurveyPrediction(len(test), squares, dof, float(p), *largest)


def _least_squares(J: FloatArray, e: FloatArray) -> tuple[float, int, FloatArray]:
    """Return the least sum of squares of linear rows, their rank, and the covariance of unknowns."""
    known, inverse, _ = spanned(J)
    squares = e @ e - ((known.T @ e) ** 2).sum()
    return float(squares), known.shape[1], inverse @ inverse.T
