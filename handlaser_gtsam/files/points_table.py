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
from .range_cells import known_numbers
from .table import Table

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
) -> tuple[IntArray, FloatArray, FloatArray]:
    """Return the station (N,) of each point, from 0, and its columns (N, c) as they stand.

    The third result (N,) is the nearest reading of the zone of an array at the station, NaN for that
    reading itself and for other kinds.

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
    table = read_frame(path, "a table of points, CSV with a header or Parquet")
    table.require("station", *wanted)
    names = table.frame["station"].cast(pl.String)
    table.refuse(names.is_null().to_numpy(), "station", "the name of a station")
    place = {name: i for i, name in enumerate(stations)}
    foreign = [name for name in names.unique().to_list() if name not in place]
    if foreign:
        raise InputError(
            f"station {some([shown(name) for name in foreign], 4)}",
            f"stations of the recording, such as {some(list(stations), 4)}",
            path,
            None,
            "station",
        )
    station = names.replace_strict(place, return_dtype=pl.Int64).to_numpy()
    numbers = np.column_stack([known_numbers(table, name)[0] for name in wanted])
    good = np.isfinite(numbers).all(axis=1)
    if kind != "profiler":
        good &= (numbers[:, -1] > 0.0) if kind != "points" else (numbers != 0.0).any(axis=1)
    station, numbers = station[good], numbers[good]
    if not len(station):
        raise InputError("no reading at all", f"rows with {', '.join(wanted)}", path)
    before = np.full(len(numbers), np.nan)
    if kind == "array":
        order, first = _by_zone(station, numbers)
        nearest = numbers[order, -1][first][np.cumsum(first) - 1]
        before[order] = np.where(first, np.nan, nearest)
        if echo != "all":
            # Each zone begins with its nearest reading, and ends with its farthest.
            one = first if echo == "near" else np.roll(first, -1)
            kept = np.sort(order[one])
            station, numbers, before = station[kept], numbers[kept], before[kept]
    return station.astype(np.intp), numbers, before


def read_frame(path: Path, expected: str) -> Table:
    """Return a table as it stands: of CSV the texts of the cells, of Parquet what they are.

    It is read by Polars alone, because it may have millions of rows.

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
            texts = pl.selectors.all().str.strip_chars()
            frame = pl.read_csv(path, infer_schema_length=0).select(
                pl.when(texts != "").then(texts)
            )
    except (pl.exceptions.PolarsError, OSError) as error:
        what = str(error).splitlines()[0][:120]
        raise InputError(f"no table ({what})", expected, path) from error
    return Table(frame, path, 1, np.arange(2, len(frame) + 2, dtype=np.intp), False)


def _by_zone(station: IntArray, numbers: FloatArray) -> tuple[IntArray, BoolArray]:
    """Return the order of readings by station, zone and range, and which of them begin a zone."""
    zone, reading = numbers[:, 0], numbers[:, -1]
    order = np.lexsort((reading, zone, station))
    first = np.ones(len(order), dtype=bool)
    first[1:] = (np.diff(station[order]) != 0) | (np.diff(zone[order]) != 0.0)
    return order, first
