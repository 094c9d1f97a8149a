"""Validation of surveys: does an independent solver agree, and are parts predicted by the rest.

Two tests. SciPy solves the same points again, by formulas of its own (`solvers/reference`).
And every target, and random parts of the stations, are predicted by the rest: the mounts are found
again with the rest alone, and what the other shots add to the sum of squares is compared with what it
should be.
"""

from dataclasses import replace
from functools import partial

import numpy as np

from ..arrays import BoolArray, FloatArray
from ..data.noise import Noise
from ..data.survey import Survey, normal_label
from ..errors import SolverError
from ..estimation.survey import estimate_survey
from ..model.distributions import chi2_sf, f_sf
from ..model.families import POSE
from ..pipeline import calibrate
from ..progress import tell
from ..quantities import SINGULAR
from ..results.spots import spot_of
from ..results.survey import SurveyCalibration, survey_calibration
from .cross_check import cross_check_survey, fits
from .leave_out import drawn, leave_out
from .prediction import SurveyPrediction
from .validation import Validation


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
    reference = cross_check_survey(calibration)
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
    test = [item for item, used in zip(whole.rows.items, whole.used, strict=True) if used]
    test = [item for item in test if out[item.station]]
    survey = whole.rows.survey
    rest = survey.part(~out) if (survey.stations_read() & ~out).any() else None
    if not test or rest is None or len(rest.shots) + len(rest.beam_names) < len(calibration.mounts):
        raise SolverError("nothing is left")
    found = estimate_survey(rest, whole.given)
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
    both, rank = _squares(J, e)
    known, known_rank = _squares(J[~predicted], e[~predicted])
    dof = int(predicted.sum()) - (rank - known_rank)
    squares = both - known
    if dof <= 0:
        raise SolverError("it says nothing about the mounts")
    redundancy = int((~predicted).sum()) - known_rank
    learned = bool(np.isnan([*whole.stated.sigma, *whole.stated.pose]).any())
    p = f_sf(squares / dof, dof, max(redundancy, 1)) if learned else chi2_sf(squares, dof)
    # By how much spots at working distance move at most.
    rest_of, shifts = survey_calibration(found), [0.0]
    for own, sensor in calibration.sensors.items():
        other, spot = rest_of.sensors[own], sensor.spot
        there = other.rotation @ spot + other.location
        shifts.append(float(np.linalg.norm(sensor.rotation @ spot + sensor.location - there)))
    for own, beam in calibration.beams.items():
        spots = [
            spot_of(np.concatenate((one.location, one.direction, one.range_error)), beam.reading)[0]
            for one in (beam, rest_of.beams[own])
        ]
        shifts.append(float(np.linalg.norm(spots[1] - spots[0])))
    return SurveyPrediction(len(test), squares, dof, float(p), max(shifts))


def _squares(J: FloatArray, e: FloatArray) -> tuple[float, int]:
    """Return the least sum of squares of linear rows, and their rank."""
    scale = np.linalg.norm(J, axis=0)
    U, size, _ = np.linalg.svd(J / np.where(scale > 0.0, scale, 1.0), full_matrices=False)
    U = U[:, size > SINGULAR**0.5 * size.max()]
    return float(e @ e - ((U.T @ e) ** 2).sum()), U.shape[1]
