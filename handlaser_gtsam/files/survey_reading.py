"""Surveys read from files: stations with their targets, tables of points, and a rig file."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from ..arrays import FloatArray
from ..data.recording import Recording
from ..data.station_list import StationList
from ..data.survey import Shots, Survey
from ..errors import InputError
from ..model.conventions import UNIT_WORDS, numbers_of
from ..text import some
from .checked_text import in_file
from .logs.assembling import (
    SurveyStations,
    averaged,
    how_joined,
    odd_readings,
    stations_before,
    targets_of,
)
from .logs.bags import is_bag
from .logs.columns import names_ranges
from .logs.format import NO_HALF_ANGLE, LogFormat
from .logs.format_checks import convention_of
from .logs.reading import (
    OF_READINGS,
    OF_SCATTER,
    is_log,
    joined_tables,
    refuse_of_a_bag,
    refuse_stated,
)
from .logs.survey_conventions import refuse_wrong_reading
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
        recording; `range_NAME` of single beams may stand there, too. Or a log of poses, and of single
        beams, where the rig file says how it is written. Or a bag with the poses and the topics of the
        sensors.
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
    numbers: FloatArray | None = None  # of poses, where these may mean something else
    if is_bag(path):
        refuse_of_a_bag(log, path, OF_SCATTER if log.range_columns else OF_READINGS)
        of_bag = tables.bag(path, log)
        stations, shots, ranges = of_bag.stations, of_bag.shots, of_bag.ranges
        beams, lines, coded = of_bag.beam_names, of_bag.lines, of_bag.warnings
    elif is_log(path, log, readings=names_ranges(log)):
        of_log, numbers, log = _of_log(path, rig)
        stations, ranges, beams, lines, coded = of_log
        shots, more, of_shots = tables.shots(stations.station_names, log.station_column)
        lines, coded = (*lines, *more), (*coded, *of_shots)
    else:
        table = read_table(path, ("plane", *POSE))
        stations = StationList(*stations_of(table, PREFIX))
        columns = [name for name in table.frame.columns if name.startswith(PREFIX)]
        beams = tuple(name.removeprefix(PREFIX) for name in columns)
        ranges = range_numbers(table, columns, rig.sensor)[0] if columns else None
        shots, lines, coded = tables.shots(stations.station_names)
        lines = (*(one.message for one in table.warnings), *lines)
        at = stations.world_R_hand, stations.world_t_hand
        numbers = numbers_of(*at, convention_of(log))
    if rig.half_angle and not beams:
        found = "half_angle_deg in [sensor], and no single beam that it would count for"
        where = "columns range_NAME of single beams in the table of stations"
        if is_bag(path):
            where = 'range_columns = ["NAME=/topic"] of single beams in [log]'
        expected = f"{where}, or no half_angle_deg"
        raise InputError(found, expected, path)
    with in_file(path):
        survey = _survey(stations, shots, ranges, beams, rig)
    cones = np.count_nonzero(survey.cones)
    coded = tuple(one for one in coded if one.code != NO_HALF_ANGLE or cones < one.values["beams"])
    if numbers is not None:
        with in_file(path):
            coded += refuse_wrong_reading(survey, numbers, log)
    return replace(survey, lines=lines, warnings=coded)


def survey_of(recording: Recording, rig: Rig) -> Survey:
    """Return a recording of single beams, before targets some of which are no planes, as a survey."""
    stations = StationList(
        recording.world_R_hand,
        recording.world_t_hand,
        recording.plane_labels,
        recording.station_names,
    )
    survey = _survey(stations, (), recording.ranges, recording.beam_names, rig)
    return replace(survey, warnings=recording.warnings)


def _survey(
    stations: StationList,
    shots: tuple[Shots, ...],
    ranges: FloatArray | None,
    beams: tuple[str, ...],
    rig: Rig,
) -> Survey:
    """Return a survey of shots, and of single beams that are as a rig file says."""
    if ranges is not None:  # without those that the sensor cannot give
        ranges = np.where(rig.sensor.can_read(ranges), ranges, np.nan)
    half_angle, range_sigma = rig.of_beams(beams)
    return Survey(
        stations,
        shots=shots,
        ranges=ranges,
        beam_names=beams,
        known=() if rig.survey is None else rig.survey.known,
        aiming_sigma=rig.aiming_sigma,
        half_angle=half_angle,
        range_sigma=range_sigma,
        linearity=rig.sensor.linearity,
    )


def _of_log(path: Path, rig: Rig) -> tuple[SurveyStations, FloatArray, LogFormat]:
    """Return the stations of a log, and what single beams read there, if it has columns of ranges.

    Readings of one beam that repeat at a station are averaged, and count as one.

    Returns
    -------
    stations : SurveyStations
    numbers : (S, k)
        The pose of each as the log has it.
    log : LogFormat
        How the log is written, with the columns of its poses.
    """
    given = rig.log
    refuse_stated(given, OF_SCATTER, "sensors of many rays", path)
    if given.estimate_lag:
        expected = "--lag-s, how late they are, as estimated of single beams without [[sensors]]"
        raise InputError("--estimate-lag with sensors of many rays", expected, path)
    with in_file(path):
        log = joined_tables(path, given, rig.sensor, needed=False)
        labels, chosen, warnings = targets_of(log, given)
        named = replace(given, pose_columns=log.poses.columns.pose)
        stations, station = stations_before(log, named, labels, chosen)
    poses, readings = log.poses, log.readings
    ranges, _, _, repeated = averaged(readings.ranges, station, len(stations), given.average)
    lines = how_joined(log, given, repeated)
    if readings.beams:
        lines += (f"{some(readings.beams, 4)} in {UNIT_WORDS[given.range_units]}",)
        warnings = (
            *readings.code_warnings(station >= 0),
            *warnings,
            *odd_readings(readings.ranges, station, stations.station_names, given.average),
        )
    of_rows = poses.warnings if readings is poses else (*poses.warnings, *readings.warnings)
    found = SurveyStations(
        stations,
        ranges if readings.beams else None,
        readings.beams,
        lines,
        (*of_rows, *log.warnings, *warnings),
    )
    numbers = poses.posed[log.way.row[log.way.start]][chosen]
    return found, numbers, named
