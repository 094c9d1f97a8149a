"""Results of surveys as JSON; SI units, finite numbers only, null for what is undetermined."""

from pathlib import Path

from ..checks import require_kind
from ..results.survey import SurveyCalibration
from ..results.survey_check import SurveyCheck
from ..results.verdict import Verdict
from .calibration_json import MOTION, verdict_record
from .checked_text import WARNING, Record, json_text, record, records
from .writing import path_of, write_text


def survey_text(result: SurveyCalibration, verdict: Verdict | None = None) -> str:
    """Return a result as JSON text, with a verdict: its own where none is given."""
    tested = "code size sigma detectable found spot_shift"
    sensor = (
        "name kind location_sigma_m rotation_sigma_rad covariance reading_sigma_m spot_error_m shots "
        "rejected rotation location_m range_error working_distance_m range_errors_tested"
    )
    beam = (
        "name direction location_sigma_m reading_sigma_m spot_error_m readings rejected covariance "
        "location_m direction_sigma_rad range_error"
    )
    rotation, translation = result.pose_sigma
    whole: Record = {
        "status": result.status,
        "message": result.message,
        "verdict": verdict_record(result.verdict if verdict is None else verdict),
        "warnings": records(result.warnings, WARNING),
        "read": result.read,
        "sensors": [
            record(
                one,
                sensor,
                working_distance_m=one.reading,
                range_errors_tested=records(one.errors, tested),
            )
            for one in result.sensors.values()
        ],
        "beams": records(result.beams.values(), beam),
        "targets": records(result.targets.values(), "label kind values sigma"),
        "pose_sigma": {
            "rotation_rad": rotation,
            "translation_m": translation,
            "estimated": result.pose_sigma_estimated,
        },
        "known": [
            record(one.known, "relation of") | record(one, "p_value contradicted")
            for one in result.relations
        ],
        "without_contradicted": None if result.without is None else _mounts(result.without),
        "rejected": records(result.rejected, "sensor station target reason"),
        **record(result, "undetermined advice chi2 dof"),
    }
    return json_text("survey", whole)


def _mounts(result: SurveyCalibration) -> Record:
    """Return where sensors and beams sit by a result that is not to be read by itself."""
    return {
        "status": result.status,
        "sensors": records(result.sensors.values(), "name rotation location_m"),
        "beams": records(result.beams.values(), "name direction location_m"),
    }


def survey_check_text(check: SurveyCheck, read: tuple[str, ...] = ()) -> str:
    """Return the check of a survey, and lines of how its files were read, as JSON text."""
    of_sensor = "name kind shots points on_target lost location_sigma_m rotation_sigma_rad"
    whole: Record = {
        "sensors": records(check.sensors, of_sensor),
        "targets": records(check.targets, MOTION),
        **record(check, "numbers unknowns undetermined exactly advice misfit"),
        "warnings": records(check.warnings, WARNING),
        "read": read,
    }
    return json_text("survey-check", whole)


def write_survey(path: Path | str, result: SurveyCalibration) -> None:
    """Write a result, whole or not at all.

    Raises
    ------
    InputError
        What is no result of a survey, or a file that cannot be written.
    """
    require_kind("result", result, SurveyCalibration)
    write_text(path_of(path), survey_text(result))
