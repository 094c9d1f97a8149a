"""Recordings and logs read as a rig file says: what every verb that takes one does."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from ..data.recording import beyond_planes
from ..data.survey import Survey, kind_of
from ..errors import CalibrationWarning, InputError
from ..model.sensor_limits import Sensor
from ..results.messages import warned
from ..text import shown
from .logs.format import NO_HALF_ANGLE, LogFormat, LogReport
from .recording_csv import read_recording
from .rig_toml import Rig, as_fields, naming_fields

NOT_A_LOG = "a recording as convert writes it: what is stated of logs does not count"
WRITES_IT = "; `handlaser convert LOG --write-log RIG` writes the table [log] of a rig file"


def read_with(rig: Rig, path: Path) -> tuple[LogReport, Rig]:
    """Do as `read_any_kind` with beams before planes, and refuse all else.

    Raises
    ------
    InputError
        Also where the rig file has sensors of many rays, cones or relations, or where a target is no
        plane.
    """
    read, known = read_any_kind(rig, path)
    if isinstance(read, Survey):
        found = "sensors of many rays, cones or relations in the rig file"
        if rig.survey is None and not rig.half_angle:
            other = beyond_planes(read.stations.plane_labels)
            found = f"the target {shown(other)}, which is no plane"
        raise InputError(found, "beams before planes only", path)
    return read, known


def read_any_kind(rig: Rig, path: Path) -> tuple[Survey | LogReport, Rig]:
    """Return what is read from a recording or a log, and the rig, with the noise that a log shows.

    With sensors of many rays, cones, relations or other targets than planes that is a survey. What is
    said of the options of `convert` names the fields of the table [log] instead.

    Raises
    ------
    InputError
    """
    with naming_fields("" if rig.log.stated else WRITES_IT):
        if rig.many_rays:
            from .survey_reading import read_survey

            survey = read_survey(path, rig)
            _require_points(rig, survey.stations.plane_labels, path)
            warnings = _warnings(rig, survey.warnings, survey.beam_names)
            return replace(survey, warnings=warnings), rig
        report = read_any(path, rig.log, rig.sensor, rig.noise.range_sigma)
    recording = report.recording
    _require_points(rig, recording.plane_names, path)
    warnings = _warnings(rig, recording.warnings, recording.beam_names)
    recording = replace(recording, warnings=warnings)
    lines = tuple(map(as_fields, report.lines))
    if beyond_planes(recording.plane_names) or rig.half_angle or rig.survey is not None:
        from .survey_reading import survey_of

        return replace(survey_of(recording, rig), lines=lines), rig
    if rig.log.range_sigma_from_scatter and rig.noise.range_sigma is None:
        rig = replace(rig, noise=replace(rig.noise, range_sigma=report.scatter))
    return replace(report, recording=recording, lines=lines), rig


def _require_points(rig: Rig, labels: Sequence[str], path: Path) -> None:
    """Refuse a standard deviation of the aiming where no target is a point; raises InputError."""
    if rig.aiming_sigma is not None and "point" not in map(kind_of, labels):
        found = "aiming_sigma_mm in [noise], and no target that is a point"
        raise InputError(found, "stations with the label point:NAME, or no aiming_sigma_mm", path)


def _warnings(
    rig: Rig, read: tuple[CalibrationWarning, ...], beams: tuple[str, ...]
) -> tuple[CalibrationWarning, ...]:
    """Return what was warned of, in fields of the table [log] in place of options of `convert`.

    Ultrasonic sensors are added whose readings are taken for readings of beams.

    Raises
    ------
    InputError
        A bag that says of itself that it has such readings, where nothing is stated of them.
    """
    kind, cones = rig.sensor.kind, np.count_nonzero(rig.of_beams(beams)[0]) if beams else 0
    warnings = tuple(replace(one, message=as_fields(one.message)) for one in read)
    for one in warnings:
        unstated = one.code == NO_HALF_ANGLE and cones < float(one.values["beams"])
        if unstated and kind in (None, "ultrasonic"):
            found, _, expected = one.message.partition("; expected ")
            raise InputError(found, expected)
    warnings = tuple(one for one in warnings if one.code != NO_HALF_ANGLE)
    if kind != "ultrasonic" or cones or not beams:
        return warnings
    return (*warnings, warned(NO_HALF_ANGLE, {"beams": len(beams)}))


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
