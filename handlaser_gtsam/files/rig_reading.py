"""Recordings and logs read as a rig file says: what every verb that takes one does."""

from dataclasses import replace
from pathlib import Path

from ..data.survey import Survey, beyond_planes
from ..errors import CalibrationWarning, InputError
from ..model.sensor import Sensor
from ..text import shown
from .logs.format import LogFormat
from .logs.report import LogReport
from .recording_csv import read_recording
from .rig_toml import Rig, as_fields, naming_fields

NOT_A_LOG = "a recording as convert writes it: what is stated of logs does not count"
BEAMS_BEFORE_PLANES = "beams before planes only"
WRITES_IT = "; `handlaser convert LOG --write-log RIG` writes the table [log] of a rig file"


def read_with(rig: Rig, path: Path) -> tuple[LogReport, Rig]:
    """Return what is read from a recording or a log, and the rig with what its scatter says of noise.

    What is said of the options of `convert` names the fields of the table [log] instead.

    Raises
    ------
    InputError
        Also where the rig file has sensors of many rays, cones or relations, or where a target is no
        plane.
    """
    if rig.survey is not None or rig.half_angle:
        found = "sensors of many rays, cones or relations in the rig file"
        raise InputError(found, BEAMS_BEFORE_PLANES, path)
    report, rig = _read_stated(rig, path)
    other = beyond_planes(report.recording.plane_names)
    if other:
        raise InputError(f"the target {shown(other)}, which is no plane", BEAMS_BEFORE_PLANES, path)
    return report, rig


def read_any_kind(rig: Rig, path: Path) -> Survey | tuple[LogReport, Rig]:
    """Do as `read_with`; with sensors of many rays, cones, relations or other targets return a survey.

    Raises
    ------
    InputError
    """
    if rig.survey is not None:
        from .survey_reading import read_survey

        with naming_fields("" if rig.log.stated else WRITES_IT):
            survey = read_survey(path, rig)
        warnings = (*_as_fields(survey.warnings), *_no_cone(rig, survey.beam_names))
        return replace(survey, warnings=warnings)
    report, rig = _read_stated(rig, path)
    if not beyond_planes(report.recording.plane_names) and not rig.half_angle:
        return report, rig
    from .survey_reading import survey_of

    return replace(survey_of(report.recording, rig), lines=report.lines)


def _read_stated(rig: Rig, path: Path) -> tuple[LogReport, Rig]:
    with naming_fields("" if rig.log.stated else WRITES_IT):
        report = read_any(path, rig.log, rig.sensor, rig.noise.range_sigma)
    recording = report.recording
    warnings = (*_as_fields(recording.warnings), *_no_cone(rig, recording.beam_names))
    recording = replace(recording, warnings=warnings)
    report = replace(report, recording=recording, lines=tuple(map(as_fields, report.lines)))
    return report, rig


def _no_cone(rig: Rig, beams: tuple[str, ...]) -> tuple[CalibrationWarning, ...]:
    """Warn of ultrasonic sensors whose readings are taken for readings of beams."""
    if rig.sensor.kind != "ultrasonic" or rig.half_angle or not beams:
        return ()
    words = (
        'kind = "ultrasonic" in [sensor] without half_angle_deg: readings are taken for those along a '
        "beam, where an ultrasonic sensor reads what is nearest in a cone; state half_angle_deg, half "
        "the opening angle of the data sheet"
    )
    return (CalibrationWarning("no-half-angle", words, {"beams": len(beams)}),)


def _as_fields(warnings: tuple[CalibrationWarning, ...]) -> tuple[CalibrationWarning, ...]:
    """Return warnings that name fields of the table [log] in place of options of `convert`."""
    return tuple(replace(one, message=as_fields(one.message)) for one in warnings)


def read_any(
    path: Path, given: LogFormat, sensor: Sensor, range_sigma: float | None = None
) -> LogReport:
    """Read a recording in CSV, or a log; what reads logs is imported only where there is one.

    Raises
    ------
    InputError
    """
    if given.stated or path.suffix.lower() != ".csv":
        from .logs.reading import describe_log, is_log

        if is_log(path, given):
            return describe_log(path, given, sensor, range_sigma)
    try:
        return LogReport(read_recording(path, sensor), lines=(NOT_A_LOG,) if given.stated else ())
    except InputError as error:
        from .logs.reading import missing_columns_hint

        hint = missing_columns_hint(error)
        if not hint:
            raise
        place = error.path, error.line, error.column
        raise InputError(error.found, error.expected + hint, *place) from error
