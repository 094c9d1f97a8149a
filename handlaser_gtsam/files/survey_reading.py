"""Surveys read from files: stations with their targets, tables of points, and a rig file."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ..arrays import FloatArray
from ..data.recording import Recording
from ..data.station_list import StationList
from ..data.survey import Survey
from ..errors import InputError
from ..model.sensor import Sensor
from .logs.bags import is_bag
from .logs.columns import columns_of
from .logs.format import LogFormat
from .logs.motion import Way
from .logs.poses import hand_poses
from .logs.reading import OF_READINGS, is_log, refuse_of_a_bag
from .logs.rows import LogRows, rows_of
from .logs.survey_suspicion import refuse_wrong_poses
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

    Raises
    ------
    InputError
        Also a log of poses that would fit far better if it were read another way.
    """
    path = path_of(path)
    rig = rig if isinstance(rig, Rig) else read_rig(rig)
    if rig.survey is None:
        if rig.half_angle:
            return survey_of(read_recording(path, rig.sensor), rig)
        expected = "one of them in the rig file, or half_angle_deg in [sensor]"
        raise InputError("no table [[sensors]] or [[known]]", expected, path)
    known = rig.survey.known
    if is_bag(path):
        refuse_of_a_bag(rig.log, path, OF_READINGS)
        stations, shots = rig.survey.bag(path, rig.log)
        return Survey(stations, shots, known=known, **_of_beams(rig, (), path))
    if is_log(path, rig.log, readings=False):
        stations, numbers, way, written = _of_log(path, rig.log)
        shots, lines = rig.survey.shots(stations.station_names, rig.log.station_column)
        more = {"lines": (written.words, *lines), **_of_beams(rig, (), path)}
        survey = Survey(stations, shots, known=known, **more)
        doubts = refuse_wrong_poses(survey, numbers, way, rig.log, path) if shots else ()
        return replace(survey, warnings=(*written.warnings, *doubts))
    stations, ranges, beams = _of_recording(path, rig)
    shots, lines = rig.survey.shots(stations.station_names)
    more = {"lines": lines, **_of_beams(rig, beams, path)}
    return Survey(stations, shots, ranges, beams, known, **more)


def survey_of(recording: Recording, rig: Rig) -> Survey:
    """Return a recording of single beams, before targets some of which are no planes, as a survey."""
    stations = StationList(
        recording.world_R_hand,
        recording.world_t_hand,
        recording.plane_labels,
        recording.station_names,
    )
    ranges = _within(recording.ranges, rig)
    beams = recording.beam_names
    more = {"warnings": recording.warnings, **_of_beams(rig, beams)}
    return Survey(stations, (), ranges, beams, **more)


def _of_beams(rig: Rig, beams: Sequence[str], path: Path | None = None) -> dict[str, Any]:
    """Return what a rig file says of single beams, as arguments of `Survey`.

    Raises
    ------
    InputError
        A cone, and no beam that reads what is nearest in it.
    """
    if rig.half_angle and not beams:
        found = "half_angle_deg in [sensor], and no single beam that it would count for"
        expected = (
            "columns range_NAME of single beams in the table of stations, or no half_angle_deg"
        )
        raise InputError(found, expected, path)
    return {"half_angle": rig.half_angle, "linearity": rig.sensor.linearity}


def _within(ranges: FloatArray, rig: Rig) -> FloatArray:
    """Return ranges without those that the sensor cannot give."""
    return np.where(rig.sensor.can_read(ranges), ranges, np.nan)


def _of_recording(path: Path, rig: Rig) -> tuple[StationList, FloatArray | None, tuple[str, ...]]:
    """Return stations, ranges (M, B) of beams, and the names of these."""
    table = read_table(path, ("plane", *POSE))
    stations = stations_of(table)
    columns = [name for name in table.frame.columns if name.startswith(PREFIX)]
    if not columns:
        return stations, None, ()
    ranges, _ = range_numbers(table, columns, rig.sensor)
    return stations, _within(ranges, rig), tuple(name.removeprefix(PREFIX) for name in columns)


def _of_log(path: Path, given: LogFormat) -> tuple[StationList, FloatArray, Way, LogRows]:
    """Return the stations of a log of poses that has labels, or one target for all.

    The other results are its numbers (M, k), how stations get their poses from these, and its rows.
    """
    table = read_log_table(path, given)
    rows = rows_of(table, columns_of(table, given, readings=False), given, Sensor())
    assert rows.poses is not None
    way = Way.of_groups(np.arange(len(rows.poses)))
    R, t = hand_poses(rows.poses, way, given)
    labels = rows.planes if rows.planes is not None else [given.plane] * len(R)
    if not all(labels):
        expected = "a column plane, --plane-column NAME, or one label for all by --plane"
        raise InputError("no target of the stations", expected, path)
    return StationList(R, t, tuple(labels), tuple(rows.names)), rows.poses, way, rows
