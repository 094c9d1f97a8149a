"""Tables of any kind as one: text with separators, workbooks, Parquet, JSON Lines.

A table of text is taken apart by `files.table`, without any guess. Its separator and its decimal mark
are recognised where only one of each is possible; else they must be stated.
"""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import polars as pl

from ...errors import InputError
from ...text import LONGEST_NAME, name_fault, shown
from ..table import SEPARATORS, Table, table_of, table_text
from .format import DELIMITERS, LogFormat

WORKBOOKS = (".xlsx", ".xlsm", ".xlsb", ".xls", ".ods")
PARQUET, LINES = (".parquet", ".pq"), (".jsonl", ".ndjson")
FOREIGN = (*WORKBOOKS, *PARQUET, *LINES)
"""Endings of files that are no text with separators."""
FIRST_LINES = 200
"""So many lines tell separators apart."""
COMMA = re.compile(r"[+-]?\d*,\d+(?:[eE][+-]?\d+)?")
POINT = re.compile(r"[+-]?\d*\.\d+(?:[eE][+-]?\d+)?")
THOUSANDS = re.compile(r"[+-]?[1-9]\d{0,2},\d{3}")
"""May be 1234, or 1 and 234 thousandths."""


def read_log_table(path: Path, given: LogFormat) -> Table:
    """Read a table; numbers of text have a decimal point then.

    Raises
    ------
    InputError
        No such file, no table, or one that can be read in several ways.
    """
    suffix = path.suffix.lower()
    if suffix in FOREIGN:
        if not path.is_file():
            raise InputError("no readable file", "a table", path)
        frame = _foreign(path, given)
        table = _of_values(frame, path, 2 if suffix in WORKBOOKS else 1)
    else:
        table = _of_text(path, given)
    if not len(table.frame):
        raise InputError("a header but no row", "one row a station or a reading", path)
    return table


# --- text --------------------------------------------------------------------------------------


def _of_text(path: Path, given: LogFormat) -> Table:
    text, names, offset = table_text(path), given.header_given, 0
    if names:
        text = re.sub(r"(?m)^[ \t]*#.*$", "", text)
    tum = given.pose_format == "tum" and not given.delimiter
    separator = " " if tum else DELIMITERS.get(given.delimiter) or _separator(text, path)
    if separator == " ":
        text = "\n".join("\t".join(line.split()) for line in text.split("\n"))
        separator = "\t"
    if names:
        text, offset = separator.join(names) + "\n" + text, 1
    table = table_of(text, path, (), separator)
    if offset:
        table = replace(table, header_line=0, lines=table.lines - offset)
    if '"' in text or (separator != "," and "," in text):
        table = _with_points(table, given)
    table.refuse_cut()
    return table


def _separator(text: str, path: Path) -> str:
    """Return the only separator at which the lines have equally many cells, two or more."""
    lines = [line for line in text.split("\n") if line.strip(" \t,;")][:FIRST_LINES]
    counts = {one: {_cells(line, one) for line in lines} for one in SEPARATORS}
    possible = [one for one, found in counts.items() if len(found) == 1 and min(found) > 1]
    if len(possible) > 1:
        words = {value: name for name, value in DELIMITERS.items()}
        both = " and ".join(words[one] for one in possible)
        raise InputError(
            f"lines that {both} divide alike", "one of them as separator: state --delimiter", path
        )
    if possible:
        return possible[0]
    if (
        lines
        and all(len(line.split()) > 1 for line in lines)
        and not any(one in lines[0] for one in SEPARATORS)
    ):
        return " "
    return max(SEPARATORS, key=lambda one: _cells(lines[0], one)) if lines else ","


def _cells(line: str, separator: str) -> int:
    """Return how many cells a line has; separators in quotes are none."""
    return re.sub('"[^"]*"', "", line).count(separator) + 1


def _with_points(table: Table, given: LogFormat) -> Table:
    """Return the table with points for decimal commas.

    Raises
    ------
    InputError
        Numbers with commas and numbers with points, or commas that may stand between thousands.
    """
    cells = [table.frame[name] for name in table.frame.columns]
    commas = [column.str.contains(rf"^{COMMA.pattern}$").fill_null(value=False) for column in cells]
    if given.decimal == "point" or not any(mask.any() for mask in commas):
        return table
    if given.decimal is None:
        _refuse_ambiguous(table, commas)
    for name, column in zip(table.frame.columns, cells, strict=True):
        points = column.str.contains(rf"^{POINT.pattern}$").fill_null(value=False).to_numpy()
        table.refuse(points, name, "decimal commas, as in other cells; or state --decimal point")
    changed = [
        pl.when(mask).then(column.str.replace(",", ".", literal=True)).otherwise(column).alias(name)
        for name, column, mask in zip(table.frame.columns, cells, commas, strict=True)
    ]
    return replace(table, frame=table.frame.select(changed))


def _refuse_ambiguous(table: Table, commas: list[pl.Series]) -> None:
    """Refuse commas every one of which may stand between thousands."""
    first = None
    for name, mask in zip(table.frame.columns, commas, strict=True):
        column = table.frame[name].filter(mask)
        thousands = column.str.contains(rf"^{THOUSANDS.pattern}$")
        if not thousands.all():
            return
        if first is None and len(column):
            first = name, mask.to_numpy()
    if first is not None:
        expected = (
            "a decimal comma or a separator of thousands? state --decimal comma, or leave it out"
        )
        table.refuse(first[1], first[0], expected)


# --- tables of values -----------------------------------------------------------------------------


def _foreign(path: Path, given: LogFormat) -> pl.DataFrame:
    """Return a table of another kind as Polars reads it."""
    suffix = path.suffix.lower()
    try:
        if suffix in WORKBOOKS:
            return _workbook(path, given)
        if suffix in PARQUET:
            return pl.read_parquet(path)
        return pl.read_ndjson(path, infer_schema_length=None)
    except InputError:
        raise
    except Exception as error:  # Polars and its readers have no common root
        if suffix in LINES:
            _refuse_bad_line(path)
        what = (
            str(error).strip().splitlines()[0][:120] if str(error).strip() else type(error).__name__
        )
        raise InputError(f"no table ({what})", f"a {suffix} file", path) from error


def _workbook(path: Path, given: LogFormat) -> pl.DataFrame:
    try:
        import fastexcel
    except ImportError as error:
        raise InputError(
            "a workbook, but no package that reads it",
            "pip install 'handlaser-gtsam[excel]', or the sheet saved as CSV",
            path,
        ) from error
    sheets = fastexcel.read_excel(path).sheet_names
    if given.sheet and given.sheet not in sheets:
        expected = f"one of {', '.join(map(shown, sheets))}"
        raise InputError(f"no sheet {shown(given.sheet)}", expected, path)
    if not given.sheet and len(sheets) > 1:
        names = ", ".join(map(shown, sheets))
        raise InputError(f"{len(sheets)} sheets, {names}", "one of them: state --sheet", path)
    return pl.read_excel(
        path,
        sheet_name=given.sheet or sheets[0],
        infer_schema_length=None,
        drop_empty_rows=False,
        raise_if_empty=False,
    )


def _refuse_bad_line(path: Path) -> None:
    """Name the line of JSON Lines that is none."""
    with path.open("rb") as file:
        for number, line in enumerate(file, 1):
            if not line.strip():
                continue
            try:
                fields = json.loads(line)
            except ValueError as error:
                found = f"no JSON ({str(error)[:80]})"
                raise InputError(found, "an object a line", path, number) from error
            if not isinstance(fields, dict):
                raise InputError(shown(fields), "an object a line", path, number)


def _of_values(frame: pl.DataFrame, path: Path, first: int) -> Table:
    """Return a frame as a table of numbers and texts: arrays and structures become columns."""
    lines = np.arange(first, first + len(frame), dtype=np.intp)
    flat: list[pl.Series] = []
    for column in frame.get_columns():
        flat += _flat(column)
    for column in flat:
        fault = name_fault(column.name).rstrip(",")
        if fault:
            expected = f"printable names of at most {LONGEST_NAME} characters"
            raise InputError(fault, expected, path)
    table = pl.DataFrame(flat)
    empty = np.ones(len(table), dtype=bool)
    for column in flat:
        empty &= column.is_null().to_numpy()
    keep = np.flatnonzero(~empty)
    return Table(table[keep], path, 1 if first == 2 else 0, lines[keep], False)


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
    if kind.is_float():
        return [column.cast(pl.Float64).fill_nan(None)]
    if kind.is_numeric():
        return [column]
    if isinstance(kind, (pl.Datetime, pl.Date)):
        return [column.cast(pl.Datetime("ns")).to_physical().cast(pl.Float64) * 1e-9]
    text = column.cast(pl.String, strict=False).str.strip_chars(" \t")
    return [text.replace("", None)]
