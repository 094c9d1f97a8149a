"""Recordings as CSV: one row a station.

Columns: `plane` (label), optional `station` (unique label), `x, y, z, qx, qy, qz, qw` (world_T_hand,
metres), then `range_NAME` for every beam (metres; empty = no reading). The separator is a comma, a
semicolon or a tab. Other columns are ignored, and named in `Recording.ignored_columns`.
"""

import csv
import io
from pathlib import Path

import numpy as np
import polars as pl
from scipy.spatial.transform import Rotation

from ..arrays import FloatArray
from ..errors import InputError
from ..recording import Recording, first_repeated
from .writing import write_text

POSE = ("x", "y", "z", "qx", "qy", "qz", "qw")
PREFIX = "range_"
QUATERNION_TOLERANCE = 1e-3
FIRST_ROW = 2
"""Line of the first station; the header is line 1."""


def read_recording(path: Path | str) -> Recording:
    """Read a recording.

    Raises
    ------
    InputError
        The first fault of the file: its line and column, what was found, what was expected.
    """
    path = Path(path)
    table = _read_table(path)
    beams = _check_header(table, path)
    lines = np.flatnonzero(
        ~table.select(pl.all_horizontal(pl.all().is_null())).to_series().to_numpy()
    )
    if not lines.size:
        raise InputError("a header but no station", "one row a station", path)
    table = table[lines]
    lines = lines + FIRST_ROW
    planes = _labels(table, "plane", path, lines)
    stations = tuple(str(line - 1) for line in lines)
    if "station" in table.columns:
        stations = _labels(table, "station", path, lines)
        _refuse_repeated(stations, path, lines)
    pose = np.column_stack([_numbers(table, name, path, lines, empty=False) for name in POSE])
    ranges = np.column_stack([_ranges(table, PREFIX + beam, path, lines) for beam in beams])
    _refuse_unread(ranges, planes, beams, path, lines)
    used = {"plane", "station", *POSE, *(PREFIX + beam for beam in beams)}
    return Recording(
        _rotations(pose[:, 3:], path, lines),
        pose[:, :3],
        ranges,
        planes,
        tuple(beams),
        stations,
        tuple(name for name in table.columns if name not in used),
    )


def write_recording(path: Path | str, recording: Recording) -> None:
    """Write `recording`; every number reads back as it was."""
    quaternions = Rotation.from_matrix(recording.world_R_hand).as_quat(canonical=True)
    columns: dict[str, pl.Series] = {
        "plane": pl.Series(recording.plane_labels, dtype=pl.String),
        "station": pl.Series(recording.station_names, dtype=pl.String),
    }
    numbers = np.hstack((recording.world_t_hand, quaternions, recording.ranges))
    names = (*POSE, *(PREFIX + beam for beam in recording.beam_names))
    for index, name in enumerate(names):
        columns[name] = pl.Series(numbers[:, index]).fill_nan(None)
    write_text(Path(path), pl.DataFrame(columns).write_csv())


def _read_table(path: Path) -> pl.DataFrame:
    """Return all columns as stripped text; blank rows stay, so that rows are lines."""
    try:
        data = path.read_bytes()
    except OSError as error:
        raise InputError(f"no readable file ({error.strerror})", "a recording", path) from error
    data = data.removeprefix(b"\xef\xbb\xbf")
    header = data.split(b"\n", 1)[0].decode("utf-8", "replace")
    if not data.strip():
        raise InputError("an empty file", "a header and one row a station", path)
    separator = max(",;\t", key=header.count)
    try:
        table = pl.read_csv(data, separator=separator, infer_schema=False, has_header=True)
    except pl.exceptions.PolarsError as error:
        raise _ragged(data, separator, path, error) from error
    text = pl.all().str.strip_chars()
    table = table.select(pl.when(text != "").then(text))
    names = [name.strip() for name in next(csv.reader(io.StringIO(header), delimiter=separator))]
    twice = first_repeated(names)
    if twice is not None:
        raise InputError("the same name twice", "every column once", path, 1, names[twice])
    return table.rename(dict(zip(table.columns, names, strict=True)))


def _ragged(data: bytes, separator: str, path: Path, error: Exception) -> InputError:
    """Find the line that polars could not take."""
    try:
        text = data.decode("utf-8")
    except UnicodeDecodeError as fault:
        line = data.count(b"\n", 0, fault.start) + 1
        return InputError("bytes that are not UTF-8", "a file saved as UTF-8", path, line)
    reader = csv.reader(io.StringIO(text, newline=""), delimiter=separator)
    width = len(next(reader, []))
    for row in reader:
        if len(row) > width:
            return InputError(
                f"{len(row)} fields", f"{width}, as in the header", path, reader.line_num
            )
    return InputError(str(error).splitlines()[0], "a comma-separated table", path)


def _check_header(table: pl.DataFrame, path: Path) -> list[str]:
    """Return the beam names; refuse a header without all columns."""
    for name in ("plane", *POSE):
        if name not in table.columns:
            near = next((c for c in table.columns if c.lower() == name), None)
            found = (
                f"column {near!r}" if near else f"no column {name!r} among {_short(table.columns)}"
            )
            raise InputError(found, f"{name!r}", path, 1, name)
    beams = [c.removeprefix(PREFIX) for c in table.columns if c.startswith(PREFIX) and c != PREFIX]
    if not beams:
        found = f"no column of ranges among {_short(table.columns)}"
        raise InputError(found, "range_NAME for every beam, in metres", path, 1, "range_NAME")
    return beams


def _labels(table: pl.DataFrame, name: str, path: Path, lines: np.ndarray) -> tuple[str, ...]:
    column = table[name]
    empty = column.is_null().to_numpy().nonzero()[0]
    if empty.size:
        raise InputError(
            "an empty cell", f"the label of the {name}", path, int(lines[empty[0]]), name
        )
    return tuple(column.to_list())


def _numbers(
    table: pl.DataFrame, name: str, path: Path, lines: np.ndarray, *, empty: bool
) -> FloatArray:
    """Return a column as finite floats; NaN where a cell is empty and may be."""
    text = table[name]
    numbers = text.cast(pl.Float64, strict=False)
    absent = text.is_null().to_numpy()
    values = numbers.to_numpy().astype(np.float64)
    wrong = (
        np.flatnonzero(~absent & ~np.isfinite(values))
        if empty
        else np.flatnonzero(~np.isfinite(values))
    )
    if wrong.size:
        row = int(wrong[0])
        found = "an empty cell" if absent[row] else repr(text[row])
        hint = "; write decimals with a point" if "," in (text[row] or "") else ""
        expected = "a finite number" + (" or an empty cell" if empty else "") + hint
        raise InputError(found, expected, path, int(lines[row]), name)
    return values


def _ranges(table: pl.DataFrame, name: str, path: Path, lines: np.ndarray) -> FloatArray:
    d = _numbers(table, name, path, lines, empty=True)
    wrong = np.flatnonzero(d <= 0.0)
    if wrong.size:
        row = int(wrong[0])
        expected = "a positive range in metres, or an empty cell for no reading"
        raise InputError(f"range {d[row]:g}", expected, path, int(lines[row]), name)
    return d


def _rotations(quaternions: FloatArray, path: Path, lines: np.ndarray) -> FloatArray:
    length = np.linalg.norm(quaternions, axis=1)
    wrong = np.flatnonzero(~(np.abs(length - 1.0) <= QUATERNION_TOLERANCE))
    if wrong.size:
        row = int(wrong[0])
        found = f"a quaternion of length {length[row]:.6g}, {abs(length[row] - 1.0):.2g} off"
        expected = f"length 1 within {QUATERNION_TOLERANCE:g}, in the order qx, qy, qz, qw"
        raise InputError(found, expected, path, int(lines[row]), "qx, qy, qz, qw")
    return Rotation.from_quat(quaternions).as_matrix()


def _refuse_repeated(stations: tuple[str, ...], path: Path, lines: np.ndarray) -> None:
    twice = first_repeated(stations)
    if twice is not None:
        first = lines[stations.index(stations[twice])]
        found = f"station {stations[twice]!r} again (first at line {first})"
        raise InputError(found, "every station label once", path, int(lines[twice]), "station")


def _refuse_unread(
    ranges: FloatArray, planes: tuple[str, ...], beams: list[str], path: Path, lines: np.ndarray
) -> None:
    seen = ~np.isnan(ranges)
    for index in np.flatnonzero(~seen.any(axis=0)):
        expected = "at least one reading of every beam, or no such column"
        raise InputError("no reading at all", expected, path, None, PREFIX + beams[index])
    read = {planes[row] for row in np.flatnonzero(seen.any(axis=1))}
    for row, plane in enumerate(planes):
        if plane not in read:
            found = f"plane {plane!r} without any reading"
            raise InputError(
                found, "at least one reading of every plane", path, int(lines[row]), "plane"
            )


def _short(names: list[str]) -> str:
    return ", ".join(names[:12]) + (", ..." if len(names) > 12 else "")
