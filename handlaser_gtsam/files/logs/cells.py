"""Columns of a log as arrays: poses, times, labels."""

from collections.abc import Sequence

import numpy as np
import polars as pl

from ...arrays import FloatArray
from ...errors import CalibrationWarning
from ...model.conventions import TIME_UNITS, Convention
from ...quantities import LARGEST_LENGTH
from ...text import A_NAME, name_fault
from ..table import NUMBER, Table, column_numbers
from .format import LogFormat
from .format_checks import convention_of
from .poses import faults

GERMAN = ("%d.%m.%Y %H:%M:%S%.f", "%d.%m.%YT%H:%M:%S%.f", "%d.%m.%Y %H:%M")
"""Dates with points begin with the day everywhere."""
PLAIN = r"^[!-~]([ -~]{0,198}[!-~])?$"
"""Names of ASCII, which most are, need no closer look."""


def pose_numbers(
    table: Table, columns: tuple[str, ...], given: LogFormat
) -> tuple[FloatArray, tuple[CalibrationWarning, ...]]:
    """Return the numbers (M, k) of poses, and what was doubtful of them but stated.

    Raises
    ------
    InputError
        A cell that is no number, or numbers that can hardly be under the convention.
    """
    x = np.column_stack([column_numbers(table, name) for name in columns])
    for i, name in enumerate(columns):
        table.refuse(np.abs(x[:, i]) > 1e3 * LARGEST_LENGTH, name, "a number of a pose")
    return x, doubts(table, x, columns, convention_of(given), as_stated=given.as_stated)


def refuse_thousands(table: Table, columns: Sequence[str]) -> None:
    """Refuse columns in which points may stand between thousands: 1.404 beside 970.

    Of 1.404 alone the point is decimal, for such a column has as many decimals everywhere.

    Raises
    ------
    InputError
    """
    for name in columns:
        cells = table.frame[name]
        if cells.dtype != pl.String:
            continue
        pointed = cells.str.contains(".", literal=True).fill_null(value=False)
        grouped = cells.str.contains(r"^[+-]?[1-9]\d{0,2}\.\d{3}$").fill_null(value=False)
        below = cells.str.contains(r"^[+-]?\d{3}$").fill_null(value=False)
        if pointed.any() and below.any() and (pointed == grouped).all():
            expected = (
                "decimals, or points between thousands? state --decimal point, or --decimal comma"
            )
            table.refuse(grouped.to_numpy(), name, expected)


def doubts(
    table: Table,
    x: FloatArray,
    columns: tuple[str, ...],
    convention: Convention,
    *,
    as_stated: bool,
) -> tuple[CalibrationWarning, ...]:
    """Refuse numbers x (M, k) of poses that cannot be; warn of those that are doubtful but stated."""
    found = []
    for fault in faults(x, convention):
        if not fault.wrong.any():
            continue
        if not (fault.doubt and as_stated):
            names = columns[fault.numbers]
            where = names[0] if len(names) == 1 else f"{names[0]} to {names[-1]}"
            insist = "; or --as-stated if it is right" if fault.doubt else ""
            table.refuse(fault.wrong, where, fault.expected + insist, fault.found)
        words = f"{fault.found}, as stated; expected {fault.expected}"
        found.append(CalibrationWarning("pose-convention", words))
    return tuple(found)


def times(table: Table, column: str, given: LogFormat) -> FloatArray:
    """Return times (M,) [s]; text in the form of ISO 8601 is read, too.

    Raises
    ------
    InputError
    """
    cells = table.frame[column]
    unit = TIME_UNITS[given.time_units]
    if cells.dtype == pl.String:
        dates = _dates(cells)
        if dates is not None:
            return dates
    return np.asarray(unit * column_numbers(table, column))


def _dates(cells: pl.Series) -> FloatArray | None:
    """Return texts as times [s]; None where they are no dates."""
    first = cells.drop_nulls().head(1)
    if not len(first) or NUMBER.fullmatch(first[0]):  # to try all rows as dates takes long
        return None
    points = cells.str.replace(r",(\d+)", ".$1")  # fractions of seconds behind a comma
    for form in (None, *GERMAN):
        try:
            dates = points.str.to_datetime(form, time_unit="ns", time_zone="UTC")
        except pl.exceptions.PolarsError:
            continue
        if not dates.is_null().any():
            return np.asarray(dates.to_physical().to_numpy() * 1e-9)
    return None


def labels(table: Table, column: str) -> list[str]:
    """Return the labels in a column, numbers as text.

    Raises
    ------
    InputError
        An empty cell, or what cannot be a name.
    """
    cells = table.frame[column]
    table.refuse(cells.is_null().to_numpy(), column, "a label")
    text = _text(cells)
    strange = text.filter(~text.str.contains(PLAIN))
    faults = {name: name_fault(name) for name in strange.unique().to_list()}
    wrong = {name: fault for name, fault in faults.items() if fault}
    if wrong:
        rows = text.is_in(list(wrong)).to_numpy()
        first = text[int(rows.argmax())]
        table.refuse(rows, column, A_NAME, wrong[first].rstrip(","))
    return list(text.to_list())


def _text(cells: pl.Series) -> pl.Series:
    """Return labels as text: 3.0 of a workbook is 3."""
    if cells.dtype == pl.String:
        return cells
    if cells.dtype.is_float() and (cells == cells.round()).all():
        whole = cells.cast(pl.Int64, strict=False)
        if not whole.is_null().any():
            return whole.cast(pl.String)
    return cells.cast(pl.String)
