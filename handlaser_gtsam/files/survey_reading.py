"""Surveys read from files: stations with their targets, tables of points, and a rig file."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ..arrays import FloatArray
from ..data.recording import Recording
from ..data.station_list import StationList
from ..data.survey import Survey
from ..errors import InputError
from ..model.conventions import numbers_of
from ..model.sensor_limits import Sensor
from .checked_text import in_file
from .logs.bags import is_bag
from .logs.columns import columns_of
from .logs.format import NO_HALF_ANGLE, LogFormat
from .logs.format_checks import convention_of
from .logs.motion import Way
from .logs.poses import hand_poses
from .logs.reading import OF_READINGS, OF_SCATTER, is_log, refuse_of_a_bag
from .logs.rows import LogRows, rows_of
from .logs.survey_conventions import refuse_wrong_reading
from .logs.tables import read_log_table
from .recording_csv import POSE, PREFIX, range_numbers, read_recording, stations_of
from .rig_toml import Rig, read_rig
from .table import read_table
from .writing import path_of


def read_survey(path: Path | str, rig: Rig | Path | str) -> Survey:
    """Read stations, and what the sensors of a rig file read there.

    Parameters
    ----------
    path : Path or str
        CSV with `plane` (labels such as `plane:A` or `sphere:S1`), `station` and poses, as a
        recording; `range_NAME` of single beams may stand there, too. Or a log of poses, where the rig
        file says how it is written. Or a bag with the poses and the topics of the sensors.
    rig : Rig, Path or str
        Its `noise` is no part of a survey: `hl.calibrate(survey, rig.noise)` counts it.

    Raises
    ------
    InputError
        Also a log of poses that would fit far better if it were read another way.
    """
    path = path_of(path)
    rig = rig if isinstance(rig, Rig) else read_rig(rig)
    if rig.survey is None or not rig.many_rays:
        if rig.survey is not None or rig.half_angle:
            return survey_of(read_recording(path, rig.sensor), rig)
        expected = "one of them in the rig file, or half_angle_deg in [sensor]"
        raise InputError("no table [[sensors]] or [[known]]", expected, path)
    tables, log = rig.survey, rig.log
    ranges: FloatArray | None = None
    rows: LogRows | None = None
    beams, lines = tuple[str, ...](), tuple[str, ...]()
    if is_bag(path):
        refuse_of_a_bag(log, path, OF_SCATTER if log.range_columns else OF_READINGS)
        read = tables.bag(path, log)
        stations, shots, lines, coded = read.stations, read.shots, read.lines, read.warnings
        ranges, beams = read.ranges, read.beam_names
    elif is_log(path, log, readings=False):
        stations, rows = _of_log(path, log)
        shots, lines, coded = tables.shots(stations.station_names, log.station_column)
        lines = (rows.words, *lines)
    else:
        table = read_table(path, ("plane", *POSE))
        stations = StationList(*stations_of(table, PREFIX))
        columns = [name for name in table.frame.columns if name.startswith(PREFIX)]
        beams = tuple(name.removeprefix(PREFIX) for name in columns)
        ranges = range_numbers(table, columns, rig.sensor)[0] if columns else None
        shots, lines, coded = tables.shots(stations.station_names)
        lines = (*(one.message for one in table.warnings), *lines)
    if rig.half_angle and not beams:
        found = "half_angle_deg in [sensor], and no single beam that it would count for"
        where = "columns range_NAME of single beams in the table of stations"
        if is_bag(path):
            where = 'range_columns = ["NAME=/topic"] of single beams in [log]'
        expected = f"{where}, or no half_angle_deg"
        raise InputError(found, expected, path)
    with in_file(path):
        survey = _survey(stations, ranges, beams, rig, shots=shots, lines=lines)
    cones = np.count_nonzero(survey.cones)
    coded = tuple(one for one in coded if one.code != NO_HALF_ANGLE or cones < one.values["beams"])
    warnings = coded if rows is None else (*rows.warnings, *coded)
    if shots and not is_bag(path):
        with in_file(path):
            at = stations.world_R_hand, stations.world_t_hand
            numbers = numbers_of(*at, convention_of(log)) if rows is None else rows.posed
            warnings += refuse_wrong_reading(survey, numbers, log)
    return replace(survey, warnings=warnings)


def survey_of(recording: Recording, rig: Rig) -> Survey:
    """Return a recording of single beams, before targets some of which are no planes, as a survey."""
    stations = StationList(
        recording.world_R_hand,
        recording.world_t_hand,
        recording.plane_labels,
        recording.station_names,
    )
    beams, warnings = recording.beam_names, recording.warnings
    return _survey(stations, recording.ranges, beams, rig, warnings=warnings)


def _survey(
    stations: StationList, ranges: FloatArray | None, beams: tuple[str, ...], rig: Rig, **more: Any
) -> Survey:
    """Return a survey of single beams that are as a rig file says, and more."""
    if ranges is not None:  # without those that the sensor cannot give
        ranges = np.where(rig.sensor.can_read(ranges), ranges, np.nan)
    more["half_angle"], more["range_sigma"] = rig.of_beams(beams)
    more |= {"linearity": rig.sensor.linearity, "aiming_sigma": rig.aiming_sigma}
    more["known"] = () if rig.survey is None else rig.survey.known
    return Survey(stations, ranges=ranges, beam_names=beams, **more)


def _of_log(path: Path, given: LogFormat) -> tuple[StationList, LogRows]:
    """Return the stations of a log of poses that has labels, or one target for all; and its rows."""
    table = read_log_table(path, given)
    rows = rows_of(table, columns_of(table, given, readings=False), given, Sensor())
    R, t = hand_poses(rows.posed, Way.of_groups(np.arange(len(rows.posed))), given)
    labels = rows.planes if rows.planes is not None else [given.plane] * len(R)
    if not all(labels):
        expected = "a column plane, --plane-column NAME, or one label for all by --plane"
        raise InputError("no target of the stations", expected, path)
    return StationList(R, t, tuple(labels), tuple(rows.names)), rows
