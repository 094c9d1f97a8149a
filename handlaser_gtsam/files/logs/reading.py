"""Logs as recordings: what a user calls."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from ...checks import require_kind
from ...data.recording import Recording
from ...errors import InputError
from ...model.sensor_limits import Sensor
from ...text import shown
from ..checked_text import in_file
from ..recording_csv import POSE
from ..table import read_table
from ..writing import path_of
from .assembling import assembled
from .bags import METADATA, BeamTopics, is_bag, read_messages
from .columns import columns_of, formats_in, names_ranges
from .format import LogFormat, LogReport
from .joining import (
    JoinedStations,
    by_station,
    by_time,
    one_table,
    refuse_other_units,
    refuse_twice,
)
from .rows import rows_of
from .tables import FOREIGN, WORKBOOKS, read_log_table

OF_TABLES = (
    *("pose_format", "rotation", "units", "angles", "pose_columns", "plane_column"),
    *("station_column", "time_column", "beam_column", "range_column", "header", "delimiter"),
    *("decimal", "sheet", "readings", "readings_station_column", "readings_time_column"),
    *("time_units", "readings_time_units"),
)
"""Fields that say nothing of a bag."""
OF_SCATTER = ("range_sigma_from_scatter",)
"""Fields that say nothing of surveys, whose sigmas are learned."""
OF_READINGS = ("range_columns", "range_units", "average", *OF_SCATTER)
"""Fields that say nothing of sensors of many rays."""
OF_BAGS = ("pose_topic", "frames", "receive_time")
"""Fields that say nothing of a table."""
OF_READINGS_APART = ("readings_station_column", "readings_time_column", "readings_time_units")
"""Fields that say nothing of one table with poses and readings."""
OF_TIMES = ("tolerance_s",)
"""Fields that say nothing where poses and readings are of the same rows or names."""
OF_STANDS = ("stand_mm", "stand_deg", "stand_s")
"""Fields that say nothing where no moments are looked for at which the hand stands."""


def read_log(
    path: Path | str, given: LogFormat | None = None, sensor: Sensor | None = None
) -> Recording:
    """Read a log of a robot controller, a spreadsheet or a bag.

    Parameters
    ----------
    path : Path or str
        A table: text with separators, XLSX, Parquet, JSON Lines. Or a bag: ROS 1, ROS 2, MCAP.
    given : LogFormat, optional
        How it is written; as `read_recording` reads it where nothing is stated.
    sensor : Sensor, optional
        Its range, where it is stated, tells codes for "no reading" from readings.

    Raises
    ------
    InputError
        What cannot be read, or would fit far better if it were read another way.
    """
    return describe_log(path, given, sensor).recording


def describe_log(
    path: Path | str,
    given: LogFormat | None = None,
    sensor: Sensor | None = None,
    range_sigma: float | None = None,
) -> LogReport:
    """Read a log as `read_log` does, and say how: the scatter of repeated readings, the lag.

    Parameters
    ----------
    path, given, sensor
        As of `read_log`.
    range_sigma : float, optional
        Standard deviation of a reading, if it is known [m]: what of it repeated readings do not show is
        common to all of them, and their mean is worth less.

    Raises
    ------
    InputError
    """
    path = path_of(path)
    given = LogFormat() if given is None else given
    sensor = Sensor() if sensor is None else sensor
    require_kind("given", given, LogFormat)
    require_kind("sensor", sensor, Sensor)
    if not path.exists():
        raise InputError("no such file", "a log", path)
    with in_file(path):
        if is_bag(path):
            refuse_of_a_bag(given, path)
            beams = BeamTopics(given)
            poses = read_messages(path, given, beams.readers)
            in_time = replace(given, stands=not given.interpolate)
            stations = by_time(poses, beams.rows(path), in_time)
        else:
            stations = joined_tables(path, given, sensor)
        return assembled(stations, given, sensor, range_sigma)


def is_log(path: Path, given: LogFormat, *, readings: bool = True) -> bool:
    """Tell whether a file is read as a log: where anything is stated, or it is no CSV file.

    A file without the columns that are stated, but with the header of a recording, is a recording all
    the same: what `convert` has written is calibrated with the rig file of the log. Without `readings`
    it has poses only, as of a survey.
    """
    foreign = is_bag(path) or path.suffix.lower() in FOREIGN
    readings = readings and given.readings is None
    return foreign or (given.stated and not _is_recording(path, given, readings=readings))


def _is_recording(path: Path, given: LogFormat, *, readings: bool) -> bool:
    """Tell whether a file has the header of a recording, and not the columns that are stated."""
    if not path.is_file():  # a pipe can be read only once
        return False
    try:
        table = read_table(path, ("plane", *POSE))
    except InputError:
        return False
    names = set(table.frame.columns)
    if not names.issuperset(("plane", *POSE)):
        return False
    try:
        columns_of(table, given, readings=readings)
    except InputError:
        return True
    return False


def missing_columns_hint(error: InputError) -> str:
    """Return what to state where a header lacks the columns of a recording."""
    lacking = error.found.startswith(("no column", "column "))
    if error.column not in ("plane", *POSE) or error.path is None or not lacking:
        return ""
    try:
        names = read_log_table(error.path, LogFormat()).frame.columns
    except InputError:
        return ""
    formats = formats_in(names)
    if error.column == "plane" and "ros" in formats:
        return "; or --plane NAME if all stations look at one plane"
    return f"; or --pose-format {'|'.join(formats)}, whose columns are there" if formats else ""


def joined_tables(
    path: Path, given: LogFormat, sensor: Sensor, *, needed: bool = True
) -> JoinedStations:
    """Return the stations of a table, or of two, with their poses and readings.

    Parameters
    ----------
    path, given, sensor
        As of `read_log`.
    needed : bool
        Whether there must be columns of ranges, also where none are stated or named so.

    Raises
    ------
    InputError
    """
    refuse_stated(given, OF_BAGS, "a table", path)
    books = [one for one in (path, given.readings) if one and one.suffix.lower() in WORKBOOKS]
    refuse_stated(given, () if books else ("sheet",), "a file that is no workbook", path)
    if not given.stands:
        refuse_stated(given, OF_STANDS, "a log without --stands", path)
    table = read_log_table(path, given)
    here = given.readings is None and (needed or names_ranges(given, table.frame.columns))
    columns = columns_of(table, given, readings=here)
    if given.readings is None:
        in_time = bool(given.stands or given.interpolate or given.lag_s or given.estimate_lag)
        refuse_stated(given, OF_READINGS_APART, "a log without --readings", path)
        if not in_time:
            refuse_stated(given, OF_TIMES, "one table that is read row by row", path)
        rows = rows_of(table, columns, given, sensor, in_time=in_time)
        if not (here or in_time):
            refuse_twice(rows)
        return by_time(rows, rows, given) if in_time else one_table(rows, given)
    # The second file has no poses: what is stated of these says nothing of its header.
    second = replace(
        given,
        header=() if given.pose_format == "tum" else given.header,
        pose_format="",
        rotation="",
        time_units=given.readings_time_units or given.time_units,
    )
    other = read_log_table(given.readings, second)
    others = columns_of(other, second, poses=False)
    if given.plane_column and not (columns.plane or others.plane):
        expected = "the name of a column of either, as its header has it"
        raise InputError(f"no column {shown(given.plane_column)} in both files", expected, path)
    in_time = bool(given.stands or not (columns.station and others.station))
    poses = rows_of(table, columns, given, sensor, in_time=in_time)
    readings = rows_of(other, others, second, sensor, in_time=in_time)
    if not in_time:
        refuse_stated(given, OF_TIMES, "tables that are joined by station", path)
        return by_station(poses, readings)
    refuse_other_units(poses, readings, given)
    return by_time(poses, readings, given)


def refuse_of_a_bag(given: LogFormat, path: Path, more: Sequence[str] = ()) -> None:
    """Refuse what is stated and says nothing of a bag, as fields of tables, and some more fields.

    Raises
    ------
    InputError
    """
    if not path.is_dir() or (path / METADATA).is_file():  # any other folder is refused as none
        refuse_stated(given, (*OF_TABLES, *more), "a bag", path)


def refuse_stated(given: LogFormat, names: Sequence[str], what: str, path: Path) -> None:
    """Refuse fields that are stated and say nothing of a kind of log."""
    plain = LogFormat()
    for name in names:
        if getattr(given, name) != getattr(plain, name):
            option = f"--{name.replace('_', '-')}"
            raise InputError(f"{option}, which says nothing of {what}", "a log without it", path)
