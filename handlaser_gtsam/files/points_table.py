"""Points of profilers, scanners, ToF arrays and depth cameras: one row a reading, CSV or Parquet.

Columns, by the kind of the sensor: `station`, and `x, z` (profiler); `angle, reading` (scanner);
`zone, reading` (array); `x, y, z` (points). A unit may stand behind a name: `x_mm`, `z [in]`. Empty
cells and codes for no reading (not finite, zero, or beyond any length) are passed over; distances below
zero, and other numbers that are codes by the rule of `data.screening`, are passed over and counted. An
array may have a column `echo` where a zone has several. Letters of names count in either case.
"""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from decimal import Decimal
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import polars as pl

from ..arrays import FloatArray, IntArray
from ..data.screening import codes_of_shots, shots_code_warning
from ..data.survey import Echo
from ..errors import CalibrationWarning, InputError
from ..model.conventions import plain
from ..quantities import IN_MM, LARGEST_LENGTH
from ..results.messages import Values, warned
from ..text import count, shown, some
from .checked_text import in_file
from .logs.columns import unit_of
from .logs.tables import FOREIGN, PARQUET, table_of_parquet
from .recording_csv import known_numbers
from .table import (
    MOST_TITLES,
    FileTable,
    label_texts,
    table_below_titles,
    table_text,
    without_separator_line,
)

if TYPE_CHECKING:
    from .sensor_tables import SensorTable

COLUMNS = {
    "profiler": ("x", "z"),
    "scanner": ("angle", "reading"),
    "array": ("zone", "reading"),
    "points": ("x", "y", "z"),
}
"""Columns beside `station`, by the kind of the sensor."""
OF_DISTANCES = "scanner", "array"
"""Kinds whose readings are distances, none of which is below zero."""
Points = tuple[IntArray, FloatArray, FloatArray | None]
"""The station (N,) of each point, from 0, its columns (N, c), and (N,) the nearest reading of the zone
of an array at the station, NaN for that reading itself; None where no zone has several."""
A_NUMBER = r"[0-9]+(\.[0-9]+)?"
"""Names of stations that are compared as numbers where they differ as texts."""
AWAITED = "waiting for the poses of"
"""Begins the line that says which stations have points, and no pose yet."""
DECIMAL_COMMA = r"^([-+]?\d*),(\d+(?:[eE][-+]?\d+)?)$"
"""A number with a decimal comma; a name of a station that holds one stays as it is."""


def read_points(
    sensor: "SensorTable",
    files: Mapping[str, Path],
    stations: Sequence[str],
    station_column: str = "",
    *,
    growing: bool = False,
) -> tuple[Points, dict[str, str], list[CalibrationWarning], tuple[str, ...]]:
    """Return points as they stand, the units of their columns, warnings, and what was passed over.

    The unit is that in the name of the column, empty for none.

    Parameters
    ----------
    sensor : SensorTable
    files : mapping of str to Path
        Tables by the station that each is of; by an empty name one of all stations.
    stations : sequence of str
        Names of the stations, as the column `station` has them.
    station_column : str
        What the log of poses calls that column; a table of points may call it so, too.
    growing : bool
        Whether the pose of a station may come after its points: these are passed over until then.

    Raises
    ------
    InputError
        No such file, a column that is missing, a station that is not there, or no number; columns that
        are in one unit in one file, and in another in the next.
    """
    kind, place = sensor.kind, {name: i for i, name in enumerate(stations)}
    station_of = _stations_by_name(stations)
    of_recording = f"of the recording, such as {some(list(place), 4)}"
    parts: list[tuple[IntArray, FloatArray]] = []
    units: dict[str, str] = {}
    seen: dict[str, Path] = {}
    awaited: list[str] = []
    titles: list[str] = []
    if not growing:
        _require_poses(files, stations, station_of)
    for own, path in files.items():
        name = station_of(own)
        if name in seen:
            found = f"another file of station {name} beside {seen[name].name}"
            raise InputError(found, "one file a station: move the other elsewhere", path)
        seen[name] = path
        if name and name not in place:
            awaited.append(name)
            continue
        if name and path.is_file() and not path.stat().st_size:
            continue  # the sensor saw nothing there
        table = _read_table(path, kind, name)
        titles += [one.message for one in table.warnings]
        last = table.frame.columns[-1] if len(table.frame) else ""
        if plain(last) in ("station", *COLUMNS[kind]) or (last and last == station_column):
            table.refuse_cut()
        if name:
            _require_station(table, name, station_of)
            station = np.full(len(table.frame), place[name], dtype=np.intp)
        else:
            column = station_column
            if not column or column not in table.frame.columns:
                column = _column(table, "station")
            table.refuse(table.frame[column].is_null().to_numpy(), column, "the name of a station")
            names = label_texts(table, column)
            called = {one: station_of(one) for one in names.unique().to_list()}
            names = names.replace_strict(called, return_dtype=pl.String)
            foreign = [one for one in names.unique(maintain_order=True) if one not in place]
            if foreign and not (growing and len(foreign) < names.n_unique()):
                found = f"station {some([shown(one) for one in foreign], 4)}"
                wrong = names.is_in(foreign).to_numpy()
                table.refuse(wrong, column, f"stations {of_recording}", found)
            if foreign:
                awaited += foreign
                there = ~names.is_in(foreign)
                table, names = table.where(there.to_numpy()), names.filter(there)
            station = names.replace_strict(place, return_dtype=pl.Int64).to_numpy()
        points, named = _points(table, kind, station)
        if parts and named != units:
            found = f"columns in {_words(named)}, after others in {_words(units)}"
            raise InputError(found, "one unit in all files", path)
        parts.append(points)
        units = named
    warnings: list[CalibrationWarning] = []
    if parts:
        station = np.concatenate([at for at, _ in parts])
        numbers = np.concatenate([points for _, points in parts])
        reading = numbers[:, -1]
        if kind in OF_DISTANCES and reading.min(initial=0.0) < 0.0 >= reading.max():
            found = f"no {COLUMNS[kind][-1]} above zero, and some below it"
            raise InputError(found, "distances: reverse their sign", next(iter(files.values())))
        station, numbers, warnings = believed(sensor, station, numbers, stations)
    if awaited and not parts:
        found = f"points of station {some([shown(one) for one in awaited], 4)} only"
        raise InputError(found, f"some of stations {of_recording}", next(iter(files.values())))
    if not parts or not len(station):
        expected = f"rows with {', '.join(COLUMNS[kind])}"
        raise InputError("no reading at all", expected, next(iter(files.values())))
    lines = []
    if titles:
        more = f", and likewise in {count(len(titles) - 1, 'other table')}" * (len(titles) > 1)
        lines.append(f"{titles[0]}{more}")
    if awaited:
        lines.append(f"{AWAITED} {some(awaited, 4)}, whose points are there")
    if kind == "array":
        return _of_echoes(station, numbers, sensor.echo), units, warnings, tuple(lines)
    return (station, numbers, None), units, warnings, tuple(lines)


def believed(
    sensor: "SensorTable", station: IntArray, numbers: FloatArray, stations: Sequence[str]
) -> tuple[IntArray, FloatArray, list[CalibrationWarning]]:
    """Return stations (N,) and numbers (N, c) of points that are some, each once, with warnings.

    Codes for no reading are left away, and points that stand more than once count once.
    """
    kind, reading = sensor.kind, numbers[:, -1]
    if kind != "profiler":
        good = (numbers != 0.0).any(axis=1) if kind == "points" else reading > 0.0
        station, numbers = station[good], numbers[good]
    station, numbers, doubled = without_copies(station, numbers)
    left = numbers[:, -1]
    codes = codes_of_shots(left, station)
    kept = ~np.isin(left, list(codes))
    station, numbers = station[kept], numbers[kept]
    warnings = []
    if len(doubled):
        values: Values = {"sensor": sensor.name, "stations": len(np.unique(station))}
        values = {**values, "repeated": len(doubled), "first": stations[int(doubled[0])]}
        warnings.append(warned("repeated-stations:points", values))
    what = COLUMNS[kind][-1]
    for code in codes:
        words = f"{what} = {code:.10g}"
        warnings.append(shots_code_warning(words, sensor.name, int((left == code).sum())))
    negative = reading[reading < 0.0] if kind in OF_DISTANCES else reading[:0]
    if len(negative):  # perhaps many different ones
        words = some([f"{code:.10g}" for code in np.unique(negative).tolist()], 4)
        words = f"{what} = {words}"
        warnings.append(shots_code_warning(words, sensor.name, len(negative), negative=True))
    return station, numbers, warnings


def without_copies(station: IntArray, numbers: FloatArray) -> tuple[IntArray, FloatArray, IntArray]:
    """Return stations (N,) and numbers (N, c) of points without copies, and whose had some (K,).

    All points of a station stand several times, to the last digit, one list after the other or each row
    several times in succession. Rows of different rays that are equal are no copies, and neither are
    some rows that repeat among others that do not.
    """
    order = np.argsort(station, kind="stable")
    names, first = np.unique(station[order], return_index=True)
    doubled, kept = [], []
    for name, rows in zip(names.tolist(), np.split(order, first)[1:], strict=True):
        once = _first_copies(numbers[rows])
        if len(once) < len(rows):
            doubled.append(name)
        kept.append(rows[once])
    if doubled:
        each = np.sort(np.concatenate(kept))
        station, numbers = station[each], numbers[each]
    return station, numbers, np.array(doubled, dtype=np.intp)


def _first_copies(rows: FloatArray) -> IntArray:
    """Return which rows (n, c) stand for all of them: all, if they are no copies of each other."""
    kept = np.arange(len(rows))
    alike = int((rows == rows[0]).all(axis=1).sum())
    for times in range(alike, 1, -1):
        if alike % times or len(rows) % times:
            continue
        lists = rows.reshape(times, -1, rows.shape[1])
        if (lists == lists[0]).all():
            kept = kept[: len(rows) // times]
        elif (rows == np.repeat(rows[::times], times, axis=0)).all():
            kept = kept[::times]
        else:
            continue
        return kept[_first_copies(rows[kept])]
    return kept


def _stations_by_name(stations: Sequence[str]) -> Callable[[str], str]:
    """Return what finds the station of a name: its own, or else of one that is an equal number.

    A name of which there is no station, or of which there are several, stays as it is.
    """
    numbered: dict[Decimal, list[str]] = {}
    for name in stations:
        if re.fullmatch(A_NUMBER, name):
            numbered.setdefault(Decimal(name), []).append(name)
    there = set(stations)

    def station_of(name: str) -> str:
        if name in there or not re.fullmatch(A_NUMBER, name):
            return name
        same = numbered.get(Decimal(name), [])
        return same[0] if len(same) == 1 else name

    return station_of


def _require_poses(
    files: Mapping[str, Path], stations: Sequence[str], station_of: Callable[[str], str]
) -> None:
    """Refuse files of stations without a pose."""
    foreign = [one for one in files if one and station_of(one) not in stations]
    if not foreign:
        return
    names = some([shown(one) for one in foreign], 4)
    found = f"points of station {names}, by the name of the file, and no such pose"
    if len(foreign) < len(files):
        expected = f"all points with a pose: add that of {names}, or remove "
        expected += some([files[one].name for one in foreign], 4)
    else:
        found += f" among {some(stations, 4)}"
        expected = (
            "the same names, or equal numbers (1, 001, 1.0): what stands for the * in the name of a "
            "file is compared with the names of the stations; rename the ones or the others"
        )
    raise InputError(found, expected, files[foreign[0]])


def _words(units: Mapping[str, str]) -> str:
    return ", ".join(f"{name} {unit or 'without a unit'}" for name, unit in units.items())


def _read_table(path: Path, kind: str, name: str) -> FileTable:
    """Return a table of points, of the station `name` where that is not empty."""
    wanted = COLUMNS[kind]
    expected = "a table of points, CSV with a header or Parquet"
    table = read_frame(path, expected, ", ".join(wanted if name else ("station", *wanted)))
    names_there = {plain(one) for one in table.frame.columns}
    others = [one for one, columns in COLUMNS.items() if names_there.issuperset(columns)]
    if others and kind not in others:
        found_so = f"columns of kind = {' or '.join(map(shown, others))}: {table.names}"
        raise table.fault(found_so, f"{', '.join(wanted)} of kind = {shown(kind)}", wanted[0])
    return table


def _require_station(table: FileTable, name: str, station_of: Callable[[str], str]) -> None:
    """Refuse a table of one station in whose rows another one is named."""
    for column in [one for one in table.frame.columns if plain(one) == "station"]:
        cells = table.frame[column].cast(pl.String)
        others = [one for one in cells.unique() if one is not None and station_of(one) != name]
        expected = f"rows of {name} only, as the name of the file has it, or no column {column}"
        table.refuse(cells.is_in(others).fill_null(value=False).to_numpy(), column, expected)


def _points(
    table: FileTable, kind: str, station: IntArray
) -> tuple[tuple[IntArray, FloatArray], dict[str, str]]:
    """Return stations and numbers of the points of a table, and the units of its columns."""
    wanted = COLUMNS[kind]
    found = [_column(table, one) for one in wanted]
    numbers = np.column_stack([known_numbers(table, one)[0] for one in found])
    # No unit of a reading is smaller than a millimetre; a code may be 3.4e38.
    good = (np.abs(numbers) < IN_MM * LARGEST_LENGTH).all(axis=1)
    units = {one: unit_of(column) for one, column in zip(wanted, found, strict=True)}
    return (station[good].astype(np.intp), numbers[good]), units


def _of_echoes(station: IntArray, numbers: FloatArray, echo: Echo) -> Points:
    """Return the points of an array that count, with the nearest reading of the zone of each."""
    before = np.empty(len(numbers))
    order = np.lexsort((numbers[:, 1], numbers[:, 0], station))
    zones = np.column_stack((station, numbers[:, 0]))[order]
    first = np.append(True, (np.diff(zones, axis=0) != 0.0).any(axis=1))
    nearest = numbers[order, -1][first][np.cumsum(first) - 1]
    before[order] = np.where(first, np.nan, nearest)
    if echo != "all":
        # Each zone begins with its nearest reading, and ends with its farthest.
        one_a_zone = first if echo == "near" else np.roll(first, -1)
        kept = np.sort(order[one_a_zone])
        station, numbers, before = station[kept], numbers[kept], before[kept]
    return station, numbers, before if np.isfinite(before).any() else None


def _column(table: FileTable, name: str) -> str:
    """Return the column of a name, in letters of either case; behind it a unit may stand."""
    alike = [one for one in table.frame.columns if plain(one) == name]
    if not alike:
        table.require(name)
    if len(alike) > 1:
        found = f"several columns that may be {name}: {', '.join(alike)}"
        raise table.fault(found, "one of them, and other names for the others")
    return alike[0]


def read_frame(path: Path, expected: str, header: str) -> FileTable:
    """Return a table as it stands: of CSV the texts of the cells, of Parquet what they are.

    Semicolons or tabs in most of its first lines separate the cells; then commas in these are decimal.

    Parameters
    ----------
    path : Path
    expected : str
        What kind of file it is.
    header : str
        The names of its columns, in words.

    Raises
    ------
    InputError
        No readable file, or no table.
    """
    suffix = path.suffix.lower()
    if suffix in PARQUET:
        if not path.is_file():
            raise InputError("no readable file", expected, path)
        try:
            with in_file(path):
                return table_of_parquet(path)
        except (pl.exceptions.PolarsError, OSError) as error:
            what = str(error).splitlines()[0][:120]
            raise InputError(f"no table ({what})", expected, path) from error
    if suffix in FOREIGN:
        raise InputError(f"a {suffix} file, which is not read", expected, path)
    text, stated = without_separator_line(table_text(path, expected))
    first = [line for line in text.split("\n", MOST_TITLES)[:MOST_TITLES] if line.strip()]
    often = [one for one in ";\t" if 2 * sum(one in line for line in first) > len(first)]
    separator = stated or (often[0] if often else ",")
    names = f"a header with {header}"
    table = table_below_titles(text, path, separator, header=names, may_be_empty=True)
    if separator == "," or "," not in text:
        return table
    points = pl.all().str.replace(DECIMAL_COMMA, "${1}.${2}")
    return replace(table, frame=table.frame.select(points))
