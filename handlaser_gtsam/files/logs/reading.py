"""Logs as recordings: what a user calls."""

from dataclasses import replace
from pathlib import Path

from ...arrays import BoolArray
from ...checks import require_kind
from ...data.recording import Recording
from ...errors import CalibrationWarning, InputError
from ...model.sensor import Sensor
from ...text import shown
from ..recording_csv import POSE, read_recording
from ..table import read_table
from ..writing import path_of
from .assembling import Known, Stationed, assembled
from .bags import OF_BAGS, describe_bag, is_bag, refuse_stated
from .columns import columns_of, formats_in
from .format import LogFormat
from .format_checks import convention_of
from .joining import Joined, by_station, one_table
from .joining_time import by_time, lag_of_tables, refuse_other_units
from .report import LogReport
from .rows import LogRows, rows_of
from .suspicion import Raw
from .tables import FOREIGN, WORKBOOKS, read_log_table

NOT_A_LOG = "a recording as convert writes it: what is stated of logs does not count"


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
    require_kind("given", given, LogFormat)
    if sensor is not None:
        require_kind("sensor", sensor, Sensor)
    known = Known(sensor or Sensor(), range_sigma)
    if not path.exists():
        raise InputError("no such file", "a log", path)
    try:
        if is_bag(path):
            return describe_bag(path, given, known)
        refuse_stated(given, OF_BAGS, "a table", path)
        books = [one for one in (path, given.readings) if one and one.suffix.lower() in WORKBOOKS]
        refuse_stated(given, () if books else ("sheet",), "a file that is no workbook", path)
        return _of_tables(path, given, known)
    except InputError as error:
        if error.path is not None:
            raise
        raise InputError(error.found, error.expected, path) from error


def read_any(
    path: Path, given: LogFormat, sensor: Sensor, range_sigma: float | None = None
) -> LogReport:
    """Read a recording in CSV, or a log: where anything is stated, or the file is of another kind.

    A file without the columns that are stated, but with the header of a recording, is one all the same:
    what `convert` has written is calibrated with the rig file of the log.

    Raises
    ------
    InputError
    """
    foreign = is_bag(path) or path.suffix.lower() in FOREIGN
    if foreign or (given.stated and not _is_recording(path, given)):
        return describe_log(path, given, sensor, range_sigma)
    try:
        return LogReport(read_recording(path, sensor), lines=(NOT_A_LOG,) if given.stated else ())
    except InputError as error:
        hint = _hint(error)
        if not hint:
            raise
        raise InputError(
            error.found, error.expected + hint, error.path, error.line, error.column
        ) from error


def _is_recording(path: Path, given: LogFormat) -> bool:
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
        columns_of(table, given, readings=given.readings is None)
    except InputError:
        return True
    return False


def _hint(error: InputError) -> str:
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


def _of_tables(path: Path, given: LogFormat, known: Known) -> LogReport:
    both = given.readings is None
    poses = rows_of(read_log_table(path, given), given, known.sensor, readings=both)
    if both and not (given.stands or given.interpolate or given.lag_s or given.estimate_lag):
        return _report(path, poses, poses, one_table(poses, given), given, known, (0.0, None))
    if both:
        rows = poses.in_time()
        return _in_time(path, rows, rows, given, known)
    second = replace(given, header=()) if given.pose_format == "tum" or given.header else given
    second = replace(
        second,
        pose_format="",
        rotation="",
        time_units=given.readings_time_units or given.time_units,
    )
    table = read_log_table(given.readings or path, second)
    timed = replace(given, time_units=second.time_units)
    readings = rows_of(table, timed, known.sensor, poses=False)
    if given.plane_column and not (poses.columns.plane or readings.columns.plane):
        expected = "the name of a column of either, as its header has it"
        raise InputError(f"no column {shown(given.plane_column)} in both files", expected, path)
    if poses.stations is not None and readings.stations is not None and not given.stands:
        joined = by_station(poses, readings)
        return _report(path, poses, readings, joined, given, known, (0.0, None))
    return _in_time(path, poses.in_time(), readings.in_time(), given, known)


def _in_time(
    path: Path, poses: LogRows, readings: LogRows, given: LogFormat, known: Known
) -> LogReport:
    refuse_other_units(poses, readings, given)
    lag: tuple[float, float | None] = (given.lag_s, None)
    if given.estimate_lag:
        found = lag_of_tables(poses, readings, given)
        lag = found.value, found.sigma
    return _report(
        path, poses, readings, by_time(poses, readings, given, lag[0]), given, known, lag
    )


def _report(
    path: Path,
    poses: LogRows,
    readings: LogRows,
    joined: Joined,
    given: LogFormat,
    known: Known,
    lag: tuple[float, float | None],
) -> LogReport:
    assert poses.poses is not None
    both = (poses,) if readings is poses else (poses, readings)

    def codes(chosen: BoolArray) -> tuple[CalibrationWarning, ...]:
        assert readings.codes is not None
        counted = (joined.station >= 0) & chosen[joined.station]
        return readings.codes.warnings(counted)

    log = Stationed(
        path,
        Raw(poses.poses, convention_of(given), given.inverted, joined.way),
        joined.names,
        joined.planes,
        joined.times,
        0.0 if poses.times is None else float(poses.times.min()),
        readings.beams,
        joined.samples,
        codes,
        tuple(dict.fromkeys(name for rows in both for name in rows.ignored)),
        (*(warning for rows in both for warning in rows.warnings), *joined.warnings),
        tuple(line for line in (_words(given), joined.words) if line),
    )
    return assembled(log, given, known, lag)


def _words(given: LogFormat) -> str:
    name = given.pose_format or given.rotation or "ros"
    text = f"poses of {name}: {convention_of(given).words}"
    text += ", inverted" if given.inverted else ""
    if given.tool:
        text += "; the hand is the flange, for the tool is taken off"
    if given.base:
        text += "; the world is the robot's frame, for the base is added"
    return text
