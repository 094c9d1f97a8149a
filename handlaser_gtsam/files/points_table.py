"""Points of profilers, scanners, ToF arrays and depth cameras: one row a reading, CSV or Parquet.

Columns, by the kind of the sensor: `station`, and `x, z` (profiler); `angle, reading` (scanner);
`zone, reading` (array); `x, y, z` (points). A unit may stand behind a name: `x_mm`, `z [in]`. Empty
cells and codes for no reading (not finite, or zero) are passed over. An array may have a column `echo`
where a zone has several. Letters of names count in either case.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Literal

import numpy as np
import polars as pl

from ..arrays import FloatArray, IntArray
from ..errors import InputError
from ..text import shown, some
from .logs.columns import plain, unit_of
from .logs.tables import PARQUET
from .recording_csv import known_numbers
from .table import Table

COLUMNS = {
    "profiler": ("x", "z"),
    "scanner": ("angle", "reading"),
    "array": ("zone", "reading"),
    "points": ("x", "y", "z"),
}
"""Columns beside `station`, by the kind of the sensor."""
Echo = Literal["all", "near", "far"]
Points = tuple[IntArray, FloatArray, FloatArray]
"""The station (N,) of each point, from 0, its columns (N, c), and (N,) the nearest reading of the zone
of an array at the station, NaN for that reading itself and for other kinds."""

DECIMAL_COMMA = r"^([-+]?\d*),(\d+(?:[eE][-+]?\d+)?)$"
"""A number with a decimal comma; a name of a station that holds one stays as it is."""


def read_points(
    files: Mapping[str, Path],
    kind: str,
    stations: Sequence[str],
    echo: Echo = "all",
    station_column: str = "",
) -> tuple[Points, dict[str, str]]:
    """Return points as they stand, and the unit in the name of each of their columns, empty for none.

    Parameters
    ----------
    files : mapping of str to Path
        Tables by the station that each is of; by an empty name one of all stations.
    kind : str
    stations : sequence of str
        Names of the stations, as the column `station` has them.
    echo : {"all", "near", "far"}
        Which readings of a zone count, where it has several at a station.
    station_column : str
        What the log of poses calls that column; a table of points may call it so, too.

    Raises
    ------
    InputError
        No such file, a column that is missing, a station that is not there, or no number; columns that
        are in one unit in one file, and in another in the next.
    """
    place = {name: i for i, name in enumerate(stations)}
    parts: list[Points] = []
    units: dict[str, str] = {}
    seen: dict[str, Path] = {}
    for own, path in files.items():
        name = _station_of(own, place)
        if name in seen:
            raise InputError(f"another file of station {name}: {seen[name].name}", "one", path)
        seen[name] = path
        if name and path.is_file() and not path.stat().st_size:
            continue  # the sensor saw nothing there
        points, named = _read_table(path, kind, place, name, echo, station_column)
        if parts and named != units:
            found = f"columns in {_words(named)}, after others in {_words(units)}"
            raise InputError(found, "one unit in all files", path)
        parts.append(points)
        units = named
    if parts:
        station, numbers, before = (np.concatenate(column) for column in zip(*parts, strict=True))
    if not parts or not len(station):
        expected = f"rows with {', '.join(COLUMNS[kind])}"
        raise InputError("no reading at all", expected, next(iter(files.values())))
    return (station, numbers, before), units


def _station_of(name: str, place: Mapping[str, int]) -> str:
    """Return the station that a file is of: of its own name, or of the same number."""
    if name in place or not name.isdigit():
        return name
    return next((one for one in place if one.isdigit() and int(one) == int(name)), name)


def _words(units: Mapping[str, str]) -> str:
    return ", ".join(f"{name} {unit or 'without a unit'}" for name, unit in units.items())


def _read_table(
    path: Path, kind: str, place: Mapping[str, int], name: str, echo: Echo, station_column: str
) -> tuple[Points, dict[str, str]]:
    """Return the points of one table, of the station `name` where that is not empty."""
    wanted = COLUMNS[kind]
    table = read_frame(path, "a table of points, CSV with a header or Parquet")
    names_there = {plain(one) for one in table.frame.columns}
    others = [one for one, columns in COLUMNS.items() if names_there.issuperset(columns)]
    if others and kind not in others:
        found_so = f"columns of kind = {' or '.join(map(shown, others))}: {table.names}"
        raise table.fault(found_so, f"{', '.join(wanted)} of kind = {shown(kind)}", wanted[0])
    found = [_column(table, one) for one in wanted]
    if name:
        names, column = pl.Series([name]).new_from_index(0, len(table.frame)), None
        inside = [one for one in table.frame.columns if plain(one) == "station"]
        for one in table.frame.select(inside).cast(pl.String).unpivot()["value"].unique():
            if one is not None and _station_of(one, place) != name:
                raise InputError(f"station {shown(one)} in the file of {name}", "one", path)
    else:
        column = station_column
        if not column or column not in table.frame.columns:
            column = _column(table, "station")
        names = table.frame[column].cast(pl.String)
        table.refuse(names.is_null().to_numpy(), column, "the name of a station")
    foreign = [shown(one) for one in names.unique(maintain_order=True) if one not in place]
    if foreign:
        expected = f"stations of the recording, such as {some(list(place), 4)}"
        raise InputError(f"station {some(foreign, 4)}", expected, path, None, column)
    station = names.replace_strict(place, return_dtype=pl.Int64).to_numpy()
    numbers = np.column_stack([known_numbers(table, one)[0] for one in found])
    good = np.isfinite(numbers).all(axis=1)
    if kind != "profiler":
        good &= (numbers[:, -1] > 0.0) if kind != "points" else (numbers != 0.0).any(axis=1)
    station, numbers = station[good], numbers[good]
    before = np.full(len(numbers), np.nan)
    if kind == "array" and len(numbers):  # sorted by station, zone and range
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
    units = {one: unit_of(column) for one, column in zip(wanted, found, strict=True)}
    return (station.astype(np.intp), numbers, before), units


def _column(table: Table, name: str) -> str:
    """Return the column of a name, in letters of either case; behind it a unit may stand."""
    alike = [one for one in table.frame.columns if plain(one) == name]
    if name in table.frame.columns or not alike:
        table.require(name)
        return name
    if len(alike) > 1:
        raise table.fault(f"several columns that may be {name}: {', '.join(alike)}", "one")
    return alike[0]


def read_frame(path: Path, expected: str) -> Table:
    """Return a table as it stands: of CSV the texts of the cells, of Parquet what they are.

    It is read by Polars alone, because it may have millions of rows. Semicolons or tabs in the header
    separate the cells; then commas in these are decimal.

    Raises
    ------
    InputError
        No readable file, or no table.
    """
    if not path.is_file():
        raise InputError("no readable file", expected, path)
    try:
        if path.suffix.lower() in PARQUET:
            frame = pl.read_parquet(path)
        else:
            with path.open(encoding="utf-8", errors="replace") as file:
                header = file.readline()
            separator = next((mark for mark in ";\t" if mark in header), ",")
            texts = pl.selectors.all().str.strip_chars()
            if separator != ",":
                texts = texts.str.replace(DECIMAL_COMMA, "${1}.${2}")
            frame = pl.read_csv(path, infer_schema_length=0, separator=separator).select(
                pl.when(texts != "").then(texts)
            )
    except (pl.exceptions.PolarsError, OSError) as error:
        what = str(error).splitlines()[0][:120]
        raise InputError(f"no table ({what})", expected, path) from error
    return Table(frame, path, 1, np.arange(2, len(frame) + 2, dtype=np.intp), False)
