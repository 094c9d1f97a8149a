"""Points of profilers, scanners, ToF arrays and depth cameras: one row a reading, CSV or Parquet.

Columns, by the kind of the sensor: `station`, and `x, z` (profiler); `angle, reading` (scanner);
`zone, reading` (array); `x, y, z` (points). Empty cells and codes for no reading (not finite, or zero)
are passed over. An array may have a column `echo` where a zone has several.
"""

from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np
import polars as pl

from ..arrays import BoolArray, FloatArray, IntArray
from ..errors import InputError
from ..text import shown, some
from .logs.tables import PARQUET

if TYPE_CHECKING:
    from collections.abc import Sequence

COLUMNS = {
    "profiler": ("x", "z"),
    "scanner": ("angle", "reading"),
    "array": ("zone", "reading"),
    "points": ("x", "y", "z"),
}
"""Columns beside `station`, by the kind of the sensor."""
Echo = Literal["all", "near", "far"]


def read_points(
    path: Path, kind: str, stations: "Sequence[str]", *, echo: Echo = "all"
) -> tuple[IntArray, FloatArray]:
    """Return the station (N,) of each point, from 0, and its columns (N, c) as they stand.

    Parameters
    ----------
    path : Path
    kind : str
    stations : sequence of str
        Names of the stations, as the column `station` has them.
    echo : {"all", "near", "far"}
        Which readings of a zone count, where it has several at a station.

    Raises
    ------
    InputError
        No such file, a column that is missing, a station that is not there, or no number.
    """
    wanted = COLUMNS[kind]
    table = _table(path, ("station", *wanted))
    place = {name: i for i, name in enumerate(stations)}
    names = table["station"]
    different = names.unique()
    foreign = [name for name in different.to_list() if name not in place]
    if foreign:
        raise InputError(
            f"station {some([shown(name) for name in foreign], 4)}",
            f"stations of the recording, such as {some(list(stations), 4)}",
            path,
            None,
            "station",
        )
    station = names.replace_strict(place, return_dtype=pl.Int64).to_numpy()
    numbers = np.column_stack([frame_numbers(table, name, path) for name in wanted])
    good = np.isfinite(numbers).all(axis=1)
    if kind != "profiler":
        good &= (numbers[:, -1] > 0.0) if kind != "points" else (numbers != 0.0).any(axis=1)
    station, numbers = station[good], numbers[good]
    if not len(station):
        raise InputError("no reading at all", f"rows with {', '.join(wanted)}", path)
    if echo != "all":
        kept = _one_echo(station, numbers, far=echo == "far")
        station, numbers = station[kept], numbers[kept]
    return station.astype(np.intp), numbers


def read_frame(path: Path, expected: str, *, text: bool = False) -> pl.DataFrame:
    """Return a table as it stands; of CSV all cells as `text`, or as what they look like.

    Raises
    ------
    InputError
        No readable file, or no table.
    """
    if not path.is_file():
        raise InputError("no readable file", expected, path)
    try:
        if path.suffix.lower() in PARQUET:
            return pl.read_parquet(path)
        return pl.read_csv(path, infer_schema_length=0 if text else 100)
    except (pl.exceptions.PolarsError, OSError) as error:
        what = str(error).splitlines()[0][:120]
        raise InputError(f"no table ({what})", expected, path) from error


def _table(path: Path, wanted: "Sequence[str]") -> pl.DataFrame:
    table = read_frame(path, "a table of points, CSV with a header or Parquet", text=True)
    missing = [name for name in wanted if name not in table.columns]
    if missing:
        found = f"no column {missing[0]!r} among {some(table.columns, 8)}"
        raise InputError(found, ", ".join(wanted), path, 1, missing[0])
    table = table.select(wanted)
    empty = table["station"].is_null()
    if empty.any():
        line = int(empty.arg_max() or 0) + 2
        raise InputError("an empty cell", "the name of a station", path, line, "station")
    return table.with_columns(pl.col("station").cast(pl.String).str.strip_chars())


def frame_numbers(table: pl.DataFrame, name: str, path: Path) -> FloatArray:
    """Return a column as numbers; NaN where a cell is empty, or a word says that it is none.

    Raises
    ------
    InputError
    """
    column = table[name]
    if column.dtype == pl.String:
        text = column.str.strip_chars().str.to_lowercase()
        number = text.cast(pl.Float64, strict=False)
        wrong = number.is_null() & text.is_not_null() & (text != "") & (text != "null")
        if wrong.any():
            row = int(wrong.arg_max() or 0)
            raise InputError(shown(column[row]), "a number, or nothing", path, row + 2, name)
        column = number
    try:
        return column.cast(pl.Float64).fill_null(np.nan).to_numpy()
    except pl.exceptions.PolarsError as error:
        raise InputError(f"cells of type {column.dtype}", "numbers", path, None, name) from error


def _one_echo(station: IntArray, numbers: FloatArray, *, far: bool) -> BoolArray:
    """Tell which readings are the farthest, or the nearest, of their zone at their station."""
    zone, reading = numbers[:, 0], numbers[:, -1]
    order = np.lexsort((reading if far else -reading, zone, station))
    last = np.ones(len(order), dtype=bool)
    same = (np.diff(station[order]) == 0) & (np.diff(zone[order]) == 0.0)
    last[:-1] = ~same
    kept = np.zeros(len(order), dtype=bool)
    kept[order] = last
    return kept
