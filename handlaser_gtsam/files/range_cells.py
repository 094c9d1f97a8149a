"""Cells of ranges as numbers: which are readings, and which say that there is none."""

import math
from collections.abc import Mapping, Sequence

import numpy as np
import polars as pl

from ..arrays import BoolArray, FloatArray
from ..data.screen import BY_CHANCE, code_warning, coded_numbers
from ..errors import CalibrationWarning
from ..model.sensor import Sensor
from ..quantities import LARGEST_LENGTH, MM
from .table import Table, column_numbers

NO_READING = ("nan", "inf", "infinity", "overflow", "ovf", "na", "n/a", "none", "null")
"""Words, with a sign or without, by which sensors and programs say that there is no reading."""


def range_numbers(
    table: Table, columns: Sequence[str], sensor: Sensor, unit: float = 1.0
) -> tuple[FloatArray, BoolArray]:
    """Return the ranges (M, C) of columns [m], NaN where there is no reading, and which were codes.

    Parameters
    ----------
    table : Table
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


def known_numbers(table: Table, name: str) -> tuple[FloatArray, BoolArray]:
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
    table: Table, whose: Mapping[str, Sequence[str]], coded: BoolArray
) -> tuple[CalibrationWarning, ...]:
    """Return a warning for every code, as it is written, with its beams and its count.

    Numbers that are no codes, and no distances because the stated range excludes them, share one.

    Parameters
    ----------
    table : Table
    whose : {column: names}
        The beams of each of C columns: of every cell, or one that holds for the column.
    coded : (M, C)
    """
    found: dict[str, list[str]] = {}
    for i, (column, names) in enumerate(whose.items()):
        for row in np.flatnonzero(coded[:, i]).tolist():
            beam = names[row if len(names) > 1 else 0]
            found.setdefault(str(table.frame[column][row]), []).append(beam)
    outside = sorted((cell for cell in found if _is_rare_number(cell, found)), key=float)
    warnings = [
        code_warning(f"{cell[:40]!r}", list(dict.fromkeys(every)), len(every))
        for cell, every in found.items()
        if cell not in outside
    ]
    if outside:
        ends = [f"{cell[:40]!r}" for cell in dict.fromkeys((outside[0], outside[-1]))]
        every = [beam for cell in outside for beam in found[cell]]
        named = list(dict.fromkeys(every))
        warnings.append(code_warning(" to ".join(ends), named, len(every), stated=True))
    return tuple(warnings)


def _is_rare_number(cell: str, found: Mapping[str, Sequence[str]]) -> bool:
    """Tell whether a cell is a number that stands too seldom for a code of its own."""
    try:
        return math.isfinite(float(cell)) and len(found[cell]) < BY_CHANCE
    except ValueError:
        return False


def _word_codes(column: pl.Series) -> BoolArray:
    """Return which cells say in a word, or as no finite number, that there is no reading."""
    if column.dtype != pl.String:
        return np.asarray((~column.is_finite()).fill_null(value=False).to_numpy(), dtype=bool)
    word = column.str.to_lowercase().str.strip_chars_start("+-")
    return np.asarray(word.is_in(NO_READING).fill_null(value=False).to_numpy(), dtype=bool)
