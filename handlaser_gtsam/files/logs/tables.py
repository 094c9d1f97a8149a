"""Tables of any kind as one: text with separators, workbooks, Parquet.

Workbooks are Office Open XML. An error in a cell (`#DIV/0!`) and a formula that was never calculated
are texts there, which are no numbers.
"""

from datetime import datetime
from itertools import zip_longest
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from ...arrays import IntArray
from ...errors import CalibrationWarning, InputError
from ...text import shown
from ..checked_text import in_file
from ..table import (
    MOST_TITLES,
    Table,
    header_names,
    table_of_text,
    titles_above,
    titles_warning,
)
from .format import LogFormat

WORKBOOKS = (".xlsx", ".xlsm")
VALUES = (*WORKBOOKS, ".parquet", ".pq")
"""Endings of files that are tables of values, and no lines of text."""
REFUSED = (".xls", ".xlsb", ".ods", ".jsonl", ".ndjson")
"""Endings of tables that are not read."""
AS_IT_IS = LogFormat()
"""Nothing is stated of a table."""


def read_table(path: Path, given: LogFormat = AS_IT_IS) -> Table:
    """Read a table; of Parquet, arrays and structures become columns.

    Parameters
    ----------
    path : Path
    given : LogFormat
        What is stated of header, separator, decimal mark and sheet.

    Raises
    ------
    InputError
        No readable file, no table, or one that can be read in several ways.
    """
    suffix = path.suffix.lower()
    if suffix in REFUSED:
        expected = "the workbook saved as .xlsx, or the table as CSV or Parquet"
        raise InputError(f"a {suffix} file, which is not read", expected, path)
    if suffix not in VALUES:
        return table_of_text(path, given)
    if not path.is_file():
        raise InputError("no readable file", "a table", path)
    try:
        with in_file(path):
            if suffix in WORKBOOKS:
                return _sheet(path, given)
            frame = pl.read_parquet(path)
            return _table(frame.get_columns(), path, 0, np.arange(1, len(frame) + 1))
    except (InputError, KeyboardInterrupt, SystemExit, MemoryError):
        raise
    except BaseException as error:  # panics of Polars are no Exception
        what = str(error).strip().splitlines() or [type(error).__name__]
        raise InputError(f"no table ({what[0][:120]})", f"a {suffix} file", path) from error


def _sheet(path: Path, given: LogFormat) -> Table:
    """Return the table of the sheet that is stated, or of the only one."""
    try:
        from openpyxl import load_workbook
    except ImportError as error:
        expected = "pip install 'handlaser-gtsam[excel]', or the sheet saved as CSV"
        raise InputError("a workbook, but no package that reads it", expected, path) from error
    values, formulas = (load_workbook(path, read_only=True, data_only=x) for x in (True, False))
    listed = ", ".join(map(shown, values.sheetnames))
    if given.sheet and given.sheet not in values.sheetnames:
        raise InputError(f"no sheet {shown(given.sheet)}", f"one of {listed}", path)
    if not given.sheet and len(values.sheetnames) > 1:
        found = f"{len(values.sheetnames)} sheets, {listed}"
        raise InputError(found, "one of them: state --sheet", path)
    sheet = given.sheet or values.sheetnames[0]
    rows: list[list[Any]] = []
    lines = []
    for book in (values, formulas):
        book[sheet].reset_dimensions()  # rows end with their last cell, wherever others stand
    both = zip(values[sheet].iter_rows(), formulas[sheet].iter_rows(), strict=True)
    for line, pairs in enumerate(both, 1):
        # A formula without a value has the type of an empty cell, one that says "" that of a text.
        row = [
            formula.value if cell.value is None and cell.data_type == "n" else cell.value
            for cell, formula in zip(*pairs, strict=True)
        ]
        if any(value not in (None, "") for value in row):
            rows.append(row)
            lines.append(line)
    if not rows:
        raise InputError("an empty sheet", "a header and one row a station or a reading", path)
    head = [["" if x is None else str(x).strip() for x in row] for row in rows[: MOST_TITLES + 1]]
    above = titles_above(head)
    warnings = titles_warning([" ".join(filter(None, row)) for row in head[:above]], path)
    below = zip_longest(*rows[above:])  # the columns, with their names first
    columns = [_column(str(cells[0] or "").strip(), list(cells[1:])) for cells in below]
    numbers = np.array(lines[above + 1 :], dtype=np.intp)
    return _table(columns, path, lines[above], numbers, warnings)


def _column(name: str, cells: list[Any]) -> pl.Series:
    """Return cells of numbers or of dates as such, and cells of several kinds as texts."""
    kinds = {type(cell) for cell in cells if cell is not None}
    if kinds <= {int, float}:
        return pl.Series(name, cells, dtype=pl.Float64)
    if kinds == {datetime}:
        return pl.Series(name, cells)
    return pl.Series(name, [None if x is None else str(x) for x in cells], dtype=pl.String)


def _table(
    columns: list[pl.Series],
    path: Path,
    header_line: int,
    lines: IntArray,
    warnings: tuple[CalibrationWarning, ...] = (),
) -> Table:
    """Return the table of columns of any kind, without rows that are empty."""
    flat = [one for column in columns for one in _flat(column)]
    names = header_names([column.name for column in flat], path, header_line)
    frame = pl.DataFrame([column.alias(name) for column, name in zip(flat, names, strict=True)])
    filled = frame.select(pl.any_horizontal(pl.all().is_not_null())).to_series().to_numpy()
    return Table(frame.filter(filled), path, header_line, lines[filled], warnings)


def _flat(column: pl.Series) -> list[pl.Series]:
    """Return a column as columns of numbers and texts."""
    name, kind = column.name, column.dtype
    if isinstance(kind, pl.Struct):
        fields = column.struct.unnest().get_columns()
        return [one for part in fields for one in _flat(part.alias(f"{name}.{part.name}"))]
    if isinstance(kind, (pl.List, pl.Array)):
        values = column.cast(pl.List(kind.inner))
        longest = values.list.len().max()
        count = longest if isinstance(longest, int) else 0
        parts = [values.list.get(i, null_on_oob=True).alias(f"{name}[{i}]") for i in range(count)]
        return [one for part in parts for one in _flat(part)]
    if kind.is_float() or kind.is_decimal():
        return [column.cast(pl.Float64).fill_nan(None)]
    if kind == pl.Binary:
        expected = "numbers or texts; leave the column out"
        raise InputError("a column of binary values", expected, None, None, shown(name)[1:-1])
    if kind.is_numeric():
        return [column]
    if isinstance(kind, (pl.Datetime, pl.Date)):
        return [column.cast(pl.Datetime("ns")).to_physical().cast(pl.Float64) * 1e-9]
    if isinstance(kind, pl.Duration):
        return [column.dt.total_nanoseconds().cast(pl.Float64) * 1e-9]
    text = column.cast(pl.String, strict=False).str.strip_chars(" \t")
    return [text.replace("", None)]
