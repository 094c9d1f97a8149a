"""Calibrations and checks of both kinds, and the truth of a simulation, as JSON.

SI units, finite numbers only; null is what is undetermined. What only surveys need is imported where
there is one.
"""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from ..checks import require_kind, require_number
from ..data.parameters import Parameters
from ..data.recording import Recording
from ..model.families import BEAM, OF_RANGE_ERROR
from ..observability.motion import MotionCheck
from ..quantities import LARGEST_LENGTH
from ..results.calibration import Calibration
from ..results.calibration_data import Beam
from ..results.limits import Limits
from ..results.result import Result
from ..results.spots import spot
from ..results.verdict import Verdict
from .checked_text import WARNING, Record, json_text, record, records
from .writing import path_of, write_text

if TYPE_CHECKING:
    from ..results.survey import SurveyCalibration
    from ..results.survey_check import SurveyCheck

RANGE_ERROR = " ".join(BEAM.keys[OF_RANGE_ERROR])
MOTION = "name stations orientations translations translating axes readings"
"""What is said of the stations before a plane, or another target."""


def calibration_text(
    calibration: "Calibration | SurveyCalibration", verdict: Verdict | None = None
) -> str:
    """Return a calibration, of beams before planes or of a survey, as JSON text with a verdict on it.

    Where no verdict is given, it is `calibration.verdict`. Laser spots of beams before planes are those
    at its working distance.

    Where the recording does not determine the calibration (`status` "unobservable" or "undetermined"),
    numbers of standard deviations and covariances are null for what is undetermined: its value is one
    of many solutions.
    """
    verdict = calibration.verdict if verdict is None else verdict
    whole: Record = {
        "status": calibration.status,
        "message": calibration.message,
        "verdict": verdict_record(verdict),
        "warnings": records(calibration.warnings, WARNING),
    }
    if isinstance(calibration, Calibration):
        return json_text("calibration", whole | _of_beams(calibration, verdict.reading))
    return json_text("survey", whole | _of_survey(calibration))


def _of_beams(calibration: Calibration, reading: float) -> Record:
    """Return what is said of beams before planes, with the laser spots at a reading [m]."""
    joint, fit = calibration.covariance, calibration.fit
    seen, learned = calibration.observability, calibration.learned
    scales = None if learned is None else learned.range_error_sigma
    return {
        "beams": [
            _beam(beam, sigma, calibration, reading)
            for beam, sigma in zip(
                calibration.beams.values(), calibration.reading_variances.range_sigma, strict=True
            )
        ],
        "beam_covariance": None if joint is None else joint.matrix(planes=[]),
        "planes": [
            record(
                plane,
                "name normal offset_m sigma",
                sigma=None
                if plane.sigma is None
                else {"normal_rad": plane.normal_sigma, "offset_m": plane.offset_sigma},
            )
            for plane in calibration.planes.values()
        ],
        "fit": record(
            fit,
            "readings rms_m max_m max_at chi2 dof sigma0 range_sigma_m range_sigma_given poses "
            "pose_covariance noise_estimate errors_by_pose rejected",
            max_m=fit.max_residual,
            max_at=record(fit.max_residual_at, "station beam"),
            pose_covariance=calibration.pose_covariance,
            noise_estimate=records(calibration.noise_estimate, "name sigma error prior_carries"),
            errors_by_pose=_by_pose(calibration),
            rejected=[
                record(one, "station beam target reason residual_m", beam=one.sensor)
                for one in fit.rejected
            ],
        ),
        "observability": record(
            seen,
            "rank unknowns condition undetermined advice weakest indices",
            weakest=seen.weakest or None,
            indices=None if seen.indices is None else record(seen.indices, "O1 O2 O3 O4"),
        ),
        "correlations": [
            record(
                one, "first second coefficient advice", first=str(one.first), second=str(one.second)
            )
            for one in calibration.correlations
        ],
        "range_error_scales": None
        if learned is None or scales is None
        else record((*scales.tolist(), learned.linearity), f"{RANGE_ERROR} linearity"),
        "systematic": [
            record(
                one,
                "code subject unit size sigma p_value found explained_by confounded detectable alike "
                "location_shift_m direction_shift_rad location_error_m direction_error_rad message "
                "remedy plausible spot_shift_m",
                explained_by=one.explained_by or None,
                spot_shift_m=one.spots(reading, unnoticed=True),
            )
            for one in calibration.systematic
        ],
        "start": {
            "method": calibration.start.method,
            "tried": records(calibration.start.tried, "method rms_m"),
        },
        "iterations": calibration.iterations,
        "effects": records(
            calibration.effects, "code subject unit size sigma prior_sigma determined"
        ),
    }


def _of_survey(result: "SurveyCalibration") -> Record:
    """Return what is said of sensors, beams, targets and relations of a survey."""
    tested = "code size sigma detectable found spot_shift"
    sensor = (
        "name kind location_sigma_m rotation_sigma_rad covariance reading_sigma_m spot_error_m shots "
        "rejected rotation location_m range_error working_distance_m range_errors_tested"
    )
    beam = (
        "name direction location_sigma_m reading_sigma_m spot_error_m readings rejected covariance "
        "location_m direction_sigma_rad range_error working_distance_m"
    )
    rotation, translation = result.pose_sigma
    without: Record | None = None
    if result.without is not None:  # a result that is not to be read by itself
        without = {
            "status": result.without.status,
            "sensors": records(result.without.sensors.values(), "name rotation location_m"),
            "beams": records(result.without.beams.values(), "name direction location_m"),
        }
    return {
        "read": result.read,
        "sensors": [
            record(
                one,
                sensor,
                working_distance_m=one.reading,
                range_errors_tested=[
                    record(error, tested, code=code) for code, error in one.errors.items()
                ],
            )
            for one in result.sensors.values()
        ],
        "beams": [
            record(one, beam, working_distance_m=one.reading) for one in result.beams.values()
        ],
        "targets": records(result.targets.values(), "label kind values sigma"),
        "pose_sigma": {
            "rotation_rad": rotation,
            "translation_m": translation,
            "estimated": result.pose_sigma_estimated,
        },
        "errors_by_pose": _by_pose(result),
        "known": [
            record(one.known, "relation of") | record(one, "p_value contradicted")
            for one in result.relations
        ],
        "without_contradicted": without,
        "rejected": records(result.rejected, "sensor station target reason"),
        **record(result, "undetermined advice chi2 dof"),
    }


def _by_pose(result: "Calibration | SurveyCalibration") -> Record | None:
    """Return errors of the hand that change with its pose; None where it does not err."""
    return None if result.errors_by_pose is None else result.errors_by_pose._asdict()


def write_calibration(
    path: Path | str,
    calibration: "Calibration | SurveyCalibration",
    reading: float | None = None,
    limits: Limits | None = None,
) -> None:
    """Write the calibration to a JSON file, whole or not at all.

    Parameters
    ----------
    path : Path or str
    calibration : Calibration or SurveyCalibration
    reading : float, optional
        Working distance at which laser spots are judged [m]; the median where not given. A graph that
        does not tell its readings has none; each sensor and beam of a survey has its own.
    limits : Limits, optional
        What its user demands: the verdict says whether it holds.

    Raises
    ------
    InputError
        What is no calibration, a reading beside a survey, or a file that cannot be written.
    """
    require_kind("calibration", calibration, Result, "handlaser_gtsam.Calibration(...)")
    if reading is not None:
        require_number("a reading of", reading, -LARGEST_LENGTH, LARGEST_LENGTH, unit="m")
    judged = calibration.judged(limits, reading)
    write_text(path_of(path), calibration_text(calibration, judged))


def check_text(check: "MotionCheck | SurveyCheck", read: Sequence[str] = ()) -> str:
    """Return a check as JSON text; of a survey with lines of how its files were read."""
    if isinstance(check, MotionCheck):
        planes = records(check.planes, MOTION)
        fields = "readings unknowns planes undetermined advice"
        return json_text("check", record(check, fields, planes=planes))
    of_sensor = "name kind shots points on_target lost location_sigma_m rotation_sigma_rad"
    whole: Record = {
        "sensors": records(check.sensors, of_sensor),
        "targets": records(check.targets, MOTION),
        **record(check, "numbers unknowns undetermined exactly advice misfit"),
        "warnings": records(check.warnings, WARNING),
        "read": read,
    }
    return json_text("survey-check", whole)


def write_truth(path: Path | str, truth: Parameters, recording: Recording) -> None:
    """Write the true beams and planes behind a simulated recording."""
    mounts = zip(
        recording.beam_names, truth.locations, truth.directions, truth.range_errors, strict=True
    )
    content: Record = {
        "beams": [
            record((name, r, v, record(k, RANGE_ERROR)), "name location_m direction range_error")
            for name, r, v, k in mounts
        ],
        "planes": records(
            zip(recording.plane_names, truth.normals, truth.offsets, strict=True),
            "name normal offset_m",
        ),
    }
    write_text(path_of(path), json_text("truth", content))


def _beam(beam: Beam, sigma: float, calibration: Calibration, reading: float) -> Record:
    k, found = beam.range_error_sigma, calibration.intervals(beam.name)
    sigmas = excludes = intervals = place = None
    if k is not None:
        of_beam = beam.location_sigma, beam.direction_sigma, *k
        sigmas = record(of_beam, f"location_m direction_rad {RANGE_ERROR}")
    if found is not None:
        of_beam = found[:3], found[3:6], *found[6:]
        intervals = record(of_beam, f"location_m direction {RANGE_ERROR}")
        ends = zip(RANGE_ERROR.split()[: beam.terms], found[6:], strict=False)
        excludes = {name: bool(low > 0.0 or high < 0.0) for name, (low, high) in ends}
    # A graph does not tell its readings.
    if calibration.covariance is not None and not math.isnan(reading):
        at = spot(calibration, beam.name, reading)
        place = record(
            at,
            "reading_m position_m along_sigma_m across_sigma_m direction_sigma_rad reading_sigma_m",
            reading_m=reading,
            along_sigma_m=at.along,
            across_sigma_m=at.across,
        )
    return record(
        beam,
        "name location_m direction range_error range_error_terms range_error_excludes_zero "
        "range_sigma_m sigma interval_95 covariance spot",
        range_sigma_m=sigma,
        range_error=record(beam.range_error, RANGE_ERROR),
        range_error_terms=beam.terms,
        range_error_excludes_zero=excludes,
        sigma=sigmas,
        interval_95=intervals,
        spot=place,
    )


def verdict_record(verdict: Verdict) -> Record:
    """Return a verdict as the JSON of calibrations, and of surveys, holds it."""
    hidden, best, spot_error, may_hide = verdict.hidden, verdict.best, None, None
    if verdict.spot_error is not None:
        at = verdict.spot_beam, verdict.reading, verdict.spot_error
        spot_error = record(at, "beam reading_m radius_m")
    if hidden is not None:
        by = hidden.code, hidden.unnoticed, hidden.unit, verdict.hidden_error
        may_hide = record(by, "code size unit spot_shift_m")
    return record(
        verdict,
        "code usable sentence spot may_hide causes remedies",
        spot=spot_error,
        may_hide=may_hide,
        causes=records(verdict.causes, WARNING),
        remedies=records([(best.code, best.words, best.number)], "code message number"),
    )
