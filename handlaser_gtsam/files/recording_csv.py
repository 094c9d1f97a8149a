"""Recordings as CSV: one row a station.

Columns: `plane` (label), optional `station` (unique label), `x, y, z, qx, qy, qz, qw` (world_T_hand,
metres), then `range_NAME` for every beam (metres; empty = no reading), and optional `samples_NAME`
where readings are means: how many independent readings each is worth. The separator is a comma, a
semicolon or a tab. Other columns are ignored, and named in `Recording.ignored_columns`. How lines
become rows stands in `table`.

Stations to drive to are a recording without readings: `plane`, `station`, `x, y, z, qx, qy, qz, qw`,
and with an arm `joint_NAME` for each of its joints (radians; metres where it slides). Columns of
ranges are ignored where stations are read. With `range_NAME` filled in for every beam the same file is
a recording.

Cells of ranges are readings, or say that there is none: by words, or by numbers that no range has.
"""

import re
from collections.abc import Mapping, Sequence
from difflib import SequenceMatcher
from itertools import permutations
from pathlib import Path

import numpy as np
import polars as pl
from scipy.spatial.transform import Rotation

from ..arrays import BoolArray, FloatArray
from ..checks import require_kind
from ..data.recording import Recording, first_repeated
from ..data.screening import BY_CHANCE, code_warning, coded_numbers
from ..data.station_list import StationList
from ..errors import CalibrationWarning, InputError
from ..model.conventions import LENGTHS, UNIT_WORDS
from ..model.sensor_limits import Sensor
from ..quantities import IN_MM, LARGEST_LENGTH, MAJORITY, MM
from ..results.messages import warned
from ..text import A_NAME, name_fault
from .table import FileTable, column_numbers, labels, read_table
from .writing import path_of, write_text

POSE = ("x", "y", "z", "qx", "qy", "qz", "qw")
PREFIX, SAMPLES = "range_", "samples_"
ROTATION_TOLERANCE = 1e-3
"""Largest difference of a quaternion's length from 1, and of an entry of R'R from the identity: the
nearest rotation is taken, since controllers write six digits or fewer."""
MISSPELT = 0.75
"""Likeness to `range` (difflib) above which the name of a column is a misspelt beam and not ignored."""
JOINT = "joint_"
"""Before the names of joints; a recording ignores such columns."""
NO_READING = (
    r"^(nan(ind)?|1[qs]nan|1ind|1?inf|infinity|notanumber|none|null|nil|na|over(flow|range)?|ovf|ol"
    r"|outofrange|under(range)?|hi|lo|err(or)?|fehler|invalid|ung\u00fcltig|no(echo|reading|target))$"
)
"""Words by which sensors, programs and spreadsheets say that there is no reading, in lower case and
without `NO_LETTERS`."""
NO_LETTERS = r"[\s+._,#/()!-]"
"""What these words may be written with."""
NO_NUMBER = r"(?i)^([-\u2013\u2014*?]+|#[^0-9.,+-].*|[<>].*|err:\d+)$"
"""Cells of nothing but dashes, asterisks or question marks say it, too, and errors of spreadsheets
(`#N/A`, `#WERT!`, `Err:502`), and what is only known to lie beyond a limit (`>130`): no number is
written so."""


def read_recording(path: Path | str, sensor: Sensor | None = None) -> Recording:
    """Read a recording.

    Cells of ranges that hold a code for "no reading" instead of a distance count as empty, and
    `Recording.warnings` says which: words such as `nan` or `overflow`, and numbers that no range has
    where they stand several times, or where the stated range of the sensor excludes them.

    Parameters
    ----------
    path : Path or str
    sensor : Sensor, optional
        Its range, where it is stated, tells codes from readings. Negative readings are legal where that
        range has them.

    Raises
    ------
    InputError
        The first fault of the file: its line and column, what was found, what was expected.
    """
    if sensor is not None:
        require_kind("sensor", sensor, Sensor)
    table = read_table(path_of(path), ("plane", *POSE))
    beams = _check_header(table)
    samples = [SAMPLES + beam for beam in beams if SAMPLES + beam in table.frame.columns]
    R, t, planes, names = stations_of(table, PREFIX, *samples)
    columns = [PREFIX + beam for beam in beams]
    ranges, coded = range_numbers(table, columns, sensor or Sensor())
    whose = {PREFIX + beam: [beam] for beam in beams}
    warnings = (*table.warnings, *code_warnings(table, whose, coded))
    seen = ~np.isnan(ranges)
    for name in (PREFIX + beams[index] for index in np.flatnonzero(~seen.any(axis=0))):
        expected = "at least one reading of every beam, or no such column"
        raise InputError("no reading at all", expected, table.path, None, name)
    read = {planes[row] for row in np.flatnonzero(seen.any(axis=1))}
    unread = np.array([plane not in read for plane in planes])
    found = f"plane {planes[unread.argmax()]!r} without any reading"
    table.refuse(unread, "plane", "at least one reading of every plane", found)
    empty = int((~(seen | coded).any(axis=1)).sum())  # of codes it is said already
    if empty:
        left_out = {"stations": empty, "total": len(seen)}
        warnings = (*warnings, warned("stations-left-out", left_out, nothing=""))
    return Recording(
        R,
        world_t_hand=t,
        ranges=ranges,
        plane_labels=planes,
        beam_names=tuple(beams),
        station_names=names,
        ignored_columns=tuple(
            x for x in table.frame.columns if not _used(x, PREFIX) and x not in samples
        ),
        samples=_samples(table, beams, ranges) if samples else None,
        warnings=warnings,
        range_min=min(0.0, (sensor or Sensor()).range_min),
    )


def write_recording(path: Path | str, recording: Recording) -> None:
    """Write `recording`; every number reads back as it was."""
    require_kind("recording", recording, Recording)
    beams = recording.beam_names
    more = (PREFIX, beams, recording.ranges), (SAMPLES, beams, recording.samples)
    write_columns(path_of(path), recording, *more)


def write_columns(
    path: Path,
    stations: Recording | StationList,
    *more: tuple[str, Sequence[str], FloatArray | None],
) -> None:
    """Write stations and, if they are there, more columns (M, n): a prefix, n names, and numbers."""
    labels = {"plane": stations.plane_labels, "station": stations.station_names}
    quaternions = Rotation.from_matrix(stations.world_R_hand).as_quat(canonical=True)
    numbers = np.hstack((stations.world_t_hand, quaternions))
    table = pl.DataFrame(labels, schema=dict.fromkeys(labels, pl.String))
    table = table.hstack(pl.DataFrame(numbers, schema=list(POSE), orient="row"))
    for prefix, names, values in more:
        if values is not None:
            columns = [prefix + name for name in names]
            own = pl.DataFrame(values, schema=columns, orient="row")
            table = table.hstack(own.fill_nan(None))
    write_text(path, table.write_csv())


def stations_of(
    table: FileTable, *prefixes: str
) -> tuple[FloatArray, FloatArray, tuple[str, ...], tuple[str, ...]]:
    """Return rotations and positions of the hand, plane labels and station names of the rows.

    Columns whose names begin with one of the `prefixes` are read elsewhere; is one of them the last, it
    must not be cut.

    Raises
    ------
    InputError
        A column that is missing, or a cell that is not what its column holds.
    """
    table.require("plane", *POSE)
    if _used(table.frame.columns[-1], *prefixes):
        table.refuse_cut()
    planes = labels(table, "plane")
    stations = tuple(str(line - table.header_line) for line in table.lines)
    if "station" in table.frame.columns:
        stations = labels(table, "station")
        twice = first_repeated(stations)
        if twice is not None:
            first = table.lines[stations.index(stations[twice])]
            wrong = np.arange(len(stations)) == twice
            found = f"station {stations[twice]!r} again (first at line {first})"
            table.refuse(wrong, "station", "every station label once", found)
    x = np.column_stack([column_numbers(table, name) for name in POSE])
    for index, name in enumerate(POSE[:3]):
        too_far = np.abs(x[:, index]) > LARGEST_LENGTH
        table.refuse(too_far, name, f"a position in metres, at most {LARGEST_LENGTH:.0f}")
    length, wrong = off_unit(x[:, 3:])
    off = length[wrong.argmax()]
    found = f"a quaternion of length {off:.6g}, {abs(off - 1.0):.2g} off"
    expected = f"length 1 within {ROTATION_TOLERANCE:g}, in the order qx, qy, qz, qw"
    table.refuse(wrong, "qx, qy, qz, qw", expected, found)
    return Rotation.from_quat(x[:, 3:]).as_matrix(), x[:, :3], planes, stations


def _check_header(table: FileTable) -> list[str]:
    """Return the beam names; refuse a header without all columns, or with a misspelt beam."""
    columns = table.frame.columns
    table.require("plane", *POSE)
    for column in columns:
        start, number = re.fullmatch(r"(.*?)_?(\d*)", column).groups()  # type: ignore[union-attr]
        likeness = SequenceMatcher(None, start.lower(), "range").ratio()
        alike = start[:1] in ("r", "R") and likeness > MISSPELT
        if alike and not column.startswith(PREFIX):
            expected = f"'{PREFIX}{number or 'NAME'}' for a beam, or a name less like it"
            raise table.fault(f"column {column!r}", expected, column)
    beams = [column.removeprefix(PREFIX) for column in columns if column.startswith(PREFIX)]
    for beam in beams:
        fault = name_fault(beam)
        if fault:
            raise table.fault(f"{fault} of a beam", f"range_NAME: {A_NAME}", PREFIX + beam)
    if not beams:
        found = f"no column of ranges among {table.names}"
        expected = "range_NAME for every beam, in metres; where tables of points have the "
        expected += "readings, --rig with these tables in [[sensors]]"
        raise table.fault(found, expected, "range_NAME")
    return beams


def _used(column: str, *prefixes: str) -> bool:
    """Tell whether a column is read, by its name or the beginning of it."""
    return column in ("plane", "station", *POSE) or column.startswith(prefixes)


def _samples(table: FileTable, beams: list[str], ranges: FloatArray) -> FloatArray:
    """Return how many readings each is worth: one where the cell or the column is missing."""
    found = np.ones(ranges.shape)
    for i, name in enumerate(SAMPLES + beam for beam in beams):
        if name in table.frame.columns:
            number = column_numbers(table, name, empty=True)
            wrong = (number < 1.0) | (number > LARGEST_LENGTH)
            table.refuse(wrong, name, "how many readings the range is worth, from 1")
            found[:, i] = np.where(np.isnan(number), 1.0, number)
    return found


def off_unit(q: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Return the length (M,) of quaternions (M, 4), and which of them are not of unit length."""
    with np.errstate(over="ignore"):  # an infinite length is refused like any other
        length = np.linalg.norm(q, axis=1)
    return length, ~(np.abs(length - 1.0) <= ROTATION_TOLERANCE)


def write_stations(path: Path | str, stations: StationList) -> None:
    """Write stations; every number reads back as it was.

    Raises
    ------
    InputError
        What is no `StationList`, or a file that cannot be written.
    """
    require_kind("stations", stations, StationList)
    write_columns(path_of(path), stations, (JOINT, stations.joint_names, stations.joints))


def read_stations(path: Path | str) -> StationList:
    """Read the stations of a file, in their order; a recording is such a file, too.

    Raises
    ------
    InputError
        The first fault of the file: its line and column, what was found, what was expected.
    """
    table = read_table(path_of(path), ("plane", *POSE))
    stations = stations_of(table, JOINT)
    columns = [name for name in table.frame.columns if name.startswith(JOINT)]
    each = [column_numbers(table, name) for name in columns]
    names = tuple(name.removeprefix(JOINT) for name in columns)
    return StationList(*stations, np.stack(each, axis=1) if each else None, names)


def range_numbers(
    table: FileTable, columns: Sequence[str], sensor: Sensor, unit: float = 1.0
) -> tuple[FloatArray, BoolArray]:
    """Return the ranges (M, C) of columns [m], NaN where there is no reading, and which were codes.

    Parameters
    ----------
    table : FileTable
    columns : C names
    sensor : Sensor
        Its range, where it is stated, tells codes from readings.
    unit : float
        Of the cells [m].

    Raises
    ------
    InputError
        A cell that is neither a range nor a code.
    """
    each, coded_by_words = zip(*(known_numbers(table, name) for name in columns), strict=True)
    d, words = np.column_stack(each), np.column_stack(coded_by_words)
    if unit != 1.0:
        d = unit * d
    with np.errstate(invalid="ignore"):
        impossible = ~sensor.can_read(d) & ~np.isnan(d) if sensor.range_stated else d <= 0.0
        impossible = (impossible & (d <= 0.0)) | (np.abs(d) > LARGEST_LENGTH)
    for i, name in enumerate(columns):
        _refuse_other_unit(table, name, d[:, i], sensor)
    coded = impossible & sensor.range_stated
    coded |= coded_numbers(d, impossible)
    least = "a range" if sensor.range_min < 0.0 else "a positive range"
    units = "millimetres" if unit == MM else "metres"
    expected = (
        f"{least} in {units} up to {LARGEST_LENGTH / unit:.0f}, or an empty cell for no reading; "
        "if the sensor can read this, or says so that it reads nothing, state its range: "
        "--range-mm MIN MAX, or range_mm in the rig file"
    )
    for i, name in enumerate(columns):
        table.refuse((impossible & ~coded)[:, i], name, expected)
    d[coded] = np.nan
    return d, np.asarray(coded | words)


def _refuse_other_unit(table: FileTable, name: str, d: FloatArray, sensor: Sensor) -> None:
    """Refuse readings (M,) [m] that are all beyond the stated range, and mostly within in another unit.

    Raises
    ------
    InputError
    """
    d = d[d > 0.0]
    if not len(d) or not sensor.range_stated or sensor.can_read(d).any():
        return
    for one, other in permutations(LENGTHS, 2):
        if sensor.can_read(d * LENGTHS[other] / LENGTHS[one]).mean() > MAJORITY:
            ends = f"{sensor.range_min * IN_MM:g} to {sensor.range_max * IN_MM:g} mm"
            found = (
                f"readings of some {np.median(d) * IN_MM:.3g} mm, and a sensor's range of {ends}"
            )
            expected = (
                f"both in the units that are stated: one of them looks like {UNIT_WORDS[other]} "
                f"taken for {UNIT_WORDS[one]}, or the other way round"
            )
            raise table.fault(found, expected, name)


def known_numbers(table: FileTable, name: str) -> tuple[FloatArray, BoolArray]:
    """Return a column as numbers (M,), NaN where there is none, and where a word says so.

    Raises
    ------
    InputError
        A cell that is no number, not empty, and none of the words for "no reading".
    """
    words = _word_codes(table.frame[name])
    numbers = column_numbers(table, name, empty=True, but=words)
    numbers[words] = np.nan
    return numbers, words


def code_warnings(
    table: FileTable, whose: Mapping[str, Sequence[str]], coded: BoolArray
) -> tuple[CalibrationWarning, ...]:
    """Return a warning for every code, as it is written, with its beams and its count.

    Numbers that are no codes, and no distances because the stated range excludes them, share one.

    Parameters
    ----------
    table : FileTable
    whose : {column: names}
        The beams of each of C columns: of every cell, or one that holds for the column.
    coded : (M, C)
    """
    found: dict[str, list[str]] = {}
    for i, (column, names) in enumerate(whose.items()):
        for row in np.flatnonzero(coded[:, i]).tolist():
            beam = names[row if len(names) > 1 else 0]
            found.setdefault(str(table.frame[column][row]), []).append(beam)
    # Numbers that stand too seldom for codes of their own.
    rare = pl.Series(
        [cell for cell, every in found.items() if len(every) < BY_CHANCE], dtype=pl.String
    )
    outside = rare.filter(rare.cast(pl.Float64, strict=False).is_finite()).to_list()
    outside.sort(key=float)
    codes = {cell: every for cell, every in found.items() if cell not in outside}
    warnings = [code_warning(f"{cell[:40]!r}", every) for cell, every in codes.items()]
    if outside:
        ends = [f"{cell[:40]!r}" for cell in dict.fromkeys((outside[0], outside[-1]))]
        every = [beam for cell in outside for beam in found[cell]]
        warnings.append(code_warning(" to ".join(ends), every, stated=True))
    return tuple(warnings)


def _word_codes(column: pl.Series) -> BoolArray:
    """Return which cells say in a word, or as no finite number, that there is no reading."""
    if column.dtype != pl.String:
        return np.asarray((~column.is_finite()).fill_null(value=False).to_numpy(), dtype=bool)
    found = ~column.cast(pl.Float64, strict=False).is_finite().fill_null(value=False).to_numpy()
    cells = column.filter(found)
    word = cells.str.to_lowercase().str.replace_all(NO_LETTERS, "")
    said = word.str.contains(NO_READING) | cells.str.contains(NO_NUMBER)
    found[found] = said.fill_null(value=False).to_numpy()
    return np.asarray(found, dtype=bool)
