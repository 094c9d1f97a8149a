"""Results of surveys as JSON; SI units, finite numbers only, null for what is undetermined."""

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from ..checks import require_kind
from ..results.survey import SurveyCalibration
from ..results.survey_check import SurveyCheck
from ..results.verdict import Verdict
from ..validation.survey import SurveyValidation
from .calibration_file import Known, Many, Numbers, Vector, Version, WarningRecord
from .calibration_json import verdict_record
from .checked_text import FileRecord, Record, json_text, json_value, read_checked, record
from .writing import path_of, write_text

Matrix = Annotated[Many[Numbers], Field(min_length=3, max_length=3)]


class SensorRecord(FileRecord, extra="ignore"):
    """What exports need of a sensor of many rays."""

    name: str
    kind: str
    rotation: Matrix
    location_m: Vector
    location_sigma_m: Known
    rotation_sigma_rad: Known


class BeamRecord(FileRecord, extra="ignore"):
    """What exports need of a single beam."""

    name: str
    location_m: Vector
    direction: Vector
    range_error: Numbers
    location_sigma_m: Known


class SurveyFile(FileRecord, extra="ignore"):
    """The result of a survey, as exports read it."""

    format: Literal["handlaser-survey"]
    version: Version
    status: str
    message: str
    sensors: Many[SensorRecord]
    beams: Many[BeamRecord]
    warnings: Many[WarningRecord]


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
        "warnings": [record(one, WarningRecord) for one in result.warnings],
        "read": result.read,
        "sensors": [
            record(
                one,
                sensor,
                working_distance_m=one.reading,
                range_errors_tested=[record(error, tested) for error in one.errors],
            )
            for one in result.sensors.values()
        ],
        "beams": [
            record(one, beam, working_distance_m=one.reading) for one in result.beams.values()
        ],
        "targets": [record(one, "label kind values sigma") for one in result.targets.values()],
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
        "rejected": [record(one, "sensor station target reason") for one in result.rejected],
        **record(result, "undetermined advice chi2 dof"),
    }
    return json_text("survey", whole)


def _mounts(result: SurveyCalibration) -> Record:
    """Return where sensors and beams sit by a result that is not to be read by itself."""
    return {
        "status": result.status,
        "sensors": [record(one, "name rotation location_m") for one in result.sensors.values()],
        "beams": [record(one, "name direction location_m") for one in result.beams.values()],
    }


def survey_validation_text(result: SurveyValidation) -> str:
    """Return a validation of a survey as JSON text."""
    left_out = "name shots chi2 dof p_value shift_m message"
    whole: Record = {
        "verdict": verdict_record(result.verdict),
        "reference": record(result.reference, "largest parameter largest_sigma sigma_parameter"),
        "targets_left_out": [record(one, left_out) for one in result.targets],
        "splits": [record(one, left_out) for one in result.splits],
        "contradicted": [one.name for one in result.contradicted],
        "read": result.calibration.read,
    }
    return json_text("survey-validation", whole)


def survey_check_text(check: SurveyCheck, read: tuple[str, ...] = ()) -> str:
    """Return the check of a survey, and lines of how its files were read, as JSON text."""
    of_sensor = "name kind shots points on_target lost location_sigma_m rotation_sigma_rad"
    of_target = "name stations orientations translations translating axes readings"
    whole: Record = {
        "sensors": [record(one, of_sensor) for one in check.sensors],
        "targets": [record(one, of_target) for one in check.targets],
        **record(check, "numbers unknowns undetermined exactly advice misfit"),
        "warnings": [record(one, WarningRecord) for one in check.warnings],
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


def read_survey_result(path: Path | str) -> SurveyFile:
    """Read what exports need of a result that was written.

    Raises
    ------
    InputError
    """
    return read_checked(path, SurveyFile, json_value, "a result of handlaser, JSON")


def is_survey_result(path: Path) -> bool:
    """Tell whether a file holds the result of a survey."""
    try:
        return b'"handlaser-survey"' in path.read_bytes()[:200]
    except OSError:
        return False
