"""Tables of any kind as one: text with separators, workbooks, Parquet, JSON Lines.

A table of text is taken apart by `files.table`, without any guess. Its separator and its decimal mark
are recognised where only one of each is possible; else they must be stated.

Workbooks are Office Open XML. The library that reads them allocates the whole rectangle between the
outermost cells, and gives back errors and formulas that were never calculated as empty cells. Both are
looked for in the XML of the sheet first, which is streamed.
"""

import logging
import os
import re
import xml.etree.ElementTree as ET
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import reduce
from pathlib import Path
from string import ascii_uppercase
from typing import IO

import numpy as np
import polars as pl

from ...checks import imported
from ...errors import CalibrationWarning, InputError
from ...model.conventions import TIME_UNITS
from ...results.messages import Values, warned
from ...text import count, shown, some
from ..checked_text import in_file, json_value
from ..table import (
    COMMA,
    MOST_LOOKED_AT,
    MOST_TITLES,
    POINT,
    SEPARATORS,
    FileTable,
    require_columns,
    table_below_titles,
    table_of,
    table_text,
    titles_above,
    titles_warning,
    without_separator_line,
)
from .format import LogFormat
from .format_checks import DELIMITERS
from .packed import refuse_zip_bomb

WORKBOOKS = (".xlsx", ".xlsm")
OLD_BOOKS = (".xls", ".xlsb", ".ods")
"""Workbooks whose cells look the same with an error as when empty: they are refused."""
PARQUET, LINES = (".parquet", ".pq"), (".jsonl", ".ndjson")
BOOKS = (*WORKBOOKS, *OLD_BOOKS, *PARQUET)
"""Endings of files that are no lines of text."""
FOREIGN = (*BOOKS, *LINES)
"""Endings of files that are no text with separators."""
MOST_CELLS = 100_000_000
"""More cells of a Parquet file do not fit into memory, at eight bytes each and several copies."""
THOUSANDS = re.compile(r"[+-]?[1-9]\d{0,2},\d{3}")
"""May be 1234, or 1 and 234 thousandths."""
GROUPED = re.compile(r"[+-]?[1-9]\d{0,2}(?:\.\d{3})+(?:,\d+)?")
"""Has points between thousands where the decimal mark is stated to be a comma."""
PLACE = re.compile(r"([A-Z]{1,3})(\d{1,7})")


def read_log_table(path: Path, given: LogFormat) -> FileTable:
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
        if suffix in OLD_BOOKS:
            expected = "the workbook saved as .xlsx, or the sheet as CSV"
            raise InputError(f"a {suffix} file, which is not read", expected, path)
        table = _foreign(path, given)
    else:
        table = _of_text(path, given)
    if not len(table.frame):
        raise InputError("a header but no row", "one row a station or a reading", path)
    return table


# --- text --------------------------------------------------------------------------------------


def _of_text(path: Path, given: LogFormat) -> FileTable:
    text, names = table_text(path), given.header_given
    if names:
        text = re.sub(r"(?m)^[ \t]*#.*$", "", text)
    text, stated = without_separator_line(text)
    stated = DELIMITERS.get(given.delimiter) or stated
    if given.pose_format == "tum" and not given.header:
        first = text.lstrip().partition("\n")[0]
        if re.match('["A-Za-z]', first):  # a header: any table with such quaternions
            names = ()
        elif stated is None and len(first.split()) > 1 and not re.search("[,;][ \t]", first):
            stated = " "
    separator = stated or _separator(text, path)
    if separator == " ":
        text = "\n".join("\t".join(line.split()) for line in text.split("\n"))
        separator = "\t"
    if names:
        table = table_of(separator.join(names) + "\n" + text, path, separator)
        table = replace(table, header_line=0, lines=table.lines - 1)
    else:
        table = table_below_titles(text, path, separator)
    if '"' in text or given.decimal == "comma" or (separator != "," and "," in text):
        table = _with_points(table, given)
    table.refuse_cut()
    return table


def _separator(text: str, path: Path) -> str:
    """Return the only separator at which the lines have equally many cells, two or more."""
    lines = [line for line in text.split("\n") if line.strip(" \t,;")][:MOST_LOOKED_AT]
    # Separators in quotes are none.
    bare = [re.sub('"[^"]*"', "", line) for line in lines]
    cells = {one: [line.count(one) + 1 for line in bare] for one in SEPARATORS}
    half, possible = len(lines) // 2, list[str]()
    for begin in (0, half):  # titles above the header are never half of the lines
        even = [one for one, counts in cells.items() if len(set(counts[begin:])) == 1]
        possible = possible or [one for one in even if cells[one][-1] > 1]
        if begin == 0 and len(possible) > 1:
            words = {value: name for name, value in DELIMITERS.items()}
            both = " and ".join(words[one] for one in possible)
            expected = "one of them as separator: state --delimiter"
            raise InputError(f"lines that {both} divide alike", expected, path)
    if len(possible) == 1 or not lines:
        return possible[0] if lines else ","
    blanks = all(len(line.split()) > 1 for line in lines)
    if blanks and not any(one in lines[0] for one in SEPARATORS):
        return " "
    return max(SEPARATORS, key=lambda one: cells[one][0])


def _with_points(
    table: FileTable, given: LogFormat, *, numbers_have_points: bool = False
) -> FileTable:
    """Return the table with points for decimal commas; the numbers of a workbook have points.

    Raises
    ------
    InputError
        Numbers with commas and numbers with points, or commas that may stand between thousands.
    """
    texts = table.frame.select(pl.selectors.string())
    if given.decimal == "comma" and not numbers_have_points:
        grouped = pl.all().str.contains(f"^{GROUPED.pattern}$")
        whole = pl.all().str.replace_all(".", "", literal=True)
        texts = texts.select(pl.when(grouped).then(whole).otherwise(pl.all()))
        table = replace(table, frame=table.frame.with_columns(texts))
    for name in texts.columns if given.decimal is None and not numbers_have_points else ():
        both = _match(texts[name], GROUPED) & texts[name].str.contains(",", literal=True)
        expected = "a number; state --decimal comma if points stand between thousands"
        table.refuse(both.fill_null(value=False).to_numpy(), name, expected)
    commas = {name: _match(texts[name], COMMA) for name in texts.columns}
    commas = {name: mask for name, mask in commas.items() if mask.any()}
    if given.decimal == "point" or not commas:
        return table
    cells = pl.concat([texts[name].filter(mask).alias("") for name, mask in commas.items()])
    if given.decimal is None and _match(cells, THOUSANDS).all():
        name, mask = next(iter(commas.items()))
        expected = "a decimal comma or a separator of thousands? state --decimal comma"
        table.refuse(mask.to_numpy(), name, f"{expected}, or leave it out")
    for name in () if numbers_have_points else texts.columns:
        points = _match(texts[name], POINT).to_numpy()
        table.refuse(points, name, "decimal commas, as in other cells; or state --decimal point")
    changed = [
        pl.when(mask).then(pl.col(name).str.replace(",", ".", literal=True)).otherwise(name)
        for name, mask in commas.items()
    ]
    return replace(table, frame=table.frame.with_columns(changed))


def _match(column: pl.Series, pattern: re.Pattern[str]) -> pl.Series:
    """Return which cells of a column are of a pattern."""
    return column.str.contains(rf"^{pattern.pattern}$").fill_null(value=False)


# --- tables of values -----------------------------------------------------------------------------


def _foreign(path: Path, given: LogFormat) -> FileTable:
    """Return a table of another kind."""
    suffix = path.suffix.lower()
    try:
        with _silent(), in_file(path):
            if suffix in WORKBOOKS:
                rows, header, warnings = read_sheet(path, given)
                table = table_of_values(rows, path)
                lines = table.lines + header
                table = replace(table, header_line=header, lines=lines, warnings=warnings)
                return _with_points(table, given, numbers_have_points=True)
            if suffix in PARQUET:
                return table_of_parquet(path)
            text = table_text(path)
            if not text.strip():
                raise InputError("an empty file", "an object a line")
            _refuse_bad_line(text, path)
            return table_of_values(pl.read_ndjson(text.encode(), infer_schema_length=None), path)
    except (InputError, KeyboardInterrupt, SystemExit, MemoryError):
        raise
    except BaseException as error:  # panics of Polars and its readers are no Exception
        what = str(error).strip().splitlines() or [type(error).__name__]
        raise InputError(f"no table ({what[0][:120]})", f"a {suffix} file", path) from error


@contextmanager
def _silent() -> Iterator[None]:
    """Keep what libraries log, or write to stderr in a panic, to themselves: it is refused."""
    logger = logging.getLogger("fastexcel")
    before, logger.disabled = logger.disabled, True
    kept, null = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    os.dup2(null, 2)
    try:
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(null)
        logger.disabled = before


JSON_KINDS = {bool: "a truth value", str: "a text", list: "an array", dict: "an object"}
JSON_KINDS |= dict.fromkeys((int, float), "a number")


def _refuse_bad_line(text: str, path: Path) -> None:
    """Refuse a line of JSON Lines that is none, or has another kind of value than those before."""
    kinds: dict[str, tuple[str, int]] = {}
    for number, line in enumerate(text.split("\n"), 1):
        if not line.strip():
            continue
        try:
            fields = json_value(line, parse_constant=_refuse_constant)
        except InputError as error:
            raise InputError(error.found, error.expected, path, number) from error
        except (ValueError, RecursionError) as error:
            deep = isinstance(error, RecursionError)
            found = "too deep nesting" if deep else f"no JSON ({str(error)[:80]})"
            raise InputError(found, "an object a line", path, number) from error
        if not isinstance(fields, dict):
            raise InputError(shown(fields), "an object a line", path, number)
        for name, value in fields.items():
            if value is None:
                continue
            kind = JSON_KINDS[type(value)]
            first, there = kinds.setdefault(name, (kind, number))
            if kind != first:
                expected = f"{first}, as in line {there}"
                raise InputError(kind, expected, path, number, shown(name)[1:-1])


def _refuse_constant(name: str) -> None:
    raise ValueError(f"{name}, which JSON has not; null is no reading")


def table_of_parquet(path: Path) -> FileTable:
    """Return the table of a Parquet file; what Polars says against it is raised as it is.

    Raises
    ------
    InputError
        Too many cells: equal values are packed so well that the size of the file says nothing.
    """
    lazy = pl.scan_parquet(path)
    height, width = lazy.select(pl.len()).collect().item(), len(lazy.collect_schema())
    if height * width > MOST_CELLS:
        raise InputError(f"{height} rows of {width} columns", f"at most {MOST_CELLS} cells")
    return table_of_values(lazy.collect(), path)


def table_of_values(frame: pl.DataFrame, path: Path) -> FileTable:
    """Return a frame as a table of numbers and texts: arrays and structures become columns."""
    flat = [one for column in frame.get_columns() for one in _flat(column)]
    require_columns([column.name for column in flat], path, None)
    table = pl.DataFrame(flat)
    filled = table.select(pl.any_horizontal(pl.all().is_not_null())).to_series().to_numpy()
    rows = np.flatnonzero(filled)
    return FileTable(table[rows], path, 0, rows + 1, False)


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
        return [column.cast(pl.Datetime("ns")).to_physical().cast(pl.Float64) * TIME_UNITS["ns"]]
    if isinstance(kind, pl.Duration):
        return [column.dt.total_nanoseconds().cast(pl.Float64) * TIME_UNITS["ns"]]
    text = column.cast(pl.String, strict=False).str.strip_chars(" \t")
    return [text.replace("", None)]


def read_sheet(
    path: Path, given: LogFormat
) -> tuple[pl.DataFrame, int, tuple[CalibrationWarning, ...]]:
    """Return the rows of a sheet below its header, the line of that, and what was passed over.

    Raises
    ------
    InputError
        No package that reads workbooks, no such sheet, several of which none is stated, an empty one, a
        cell far from all others, a name twice, or an archive that unpacks to too much.
    """
    missing = "a workbook, but no package that reads it"
    fastexcel = imported("fastexcel", "excel", missing, path, ", or the sheet saved as CSV")
    refuse_zip_bomb(path)
    with zipfile.ZipFile(path) as archive:
        sheets = _sheets(archive)
        listed = ", ".join(map(shown, sheets))
        if given.sheet and given.sheet not in sheets:
            raise InputError(f"no sheet {shown(given.sheet)}", f"one of {listed}", path)
        if not given.sheet and len(sheets) > 1:
            raise InputError(f"{len(sheets)} sheets, {listed}", "one of them: state --sheet", path)
        name = given.sheet or next(iter(sheets))
        with archive.open(sheets[name]) as file:
            first, warnings = _scanned(file, path)
    book = fastexcel.read_excel(path)
    texts: pl.DataFrame = book.load_sheet(name, header_row=None, dtypes="string").to_polars()
    if not len(texts):
        raise InputError("an empty sheet", "a header and one row a station or a reading", path)
    head = [[str(x or "").strip() for x in row] for row in texts.head(MOST_TITLES + 1).rows()]
    above = titles_above(head)
    if above:
        warnings += titles_warning([" ".join(filter(None, row)) for row in head[:above]], path)
    line = above + first
    names = [one or f"(column {i + 1} without a name)" for i, one in enumerate(head[above])]
    require_columns(names, path, line)
    texts = texts[above + 1 :]
    texts.columns = names
    found: pl.DataFrame = book.load_sheet(
        name, header_row=line - 1, schema_sample_rows=None
    ).to_polars()
    found.columns = names
    # Texts have nine decimals of a number at most, and numbers take true and false for 1 and 0.
    truths = [one for one in names if texts[one].is_in(["true", "false"]).any()]
    return found.with_columns(texts[one] for one in truths), line, warnings


def _sheets(archive: zipfile.ZipFile) -> dict[str, str]:
    """Return the part of every sheet by its name."""
    links = ET.fromstring(archive.read("xl/_rels/workbook.xml.rels"))
    target = {one.get("Id"): str(one.get("Target")) for one in links}
    found = {}
    for one in ET.fromstring(archive.read("xl/workbook.xml")).iterfind(".//{*}sheet"):
        part = target[next((value for name, value in one.items() if name.endswith("}id")), None)]
        found[str(one.get("name"))] = part[1:] if part.startswith("/") else f"xl/{part}"
    return found


def _scanned(file: IO[bytes], path: Path) -> tuple[int, tuple[CalibrationWarning, ...]]:
    """Return the first row of a sheet, and a warning for each kind of cell without a value.

    Raises
    ------
    InputError
        Most of the rectangle around its cells is empty: one cell far away makes it so.
    """
    rows, columns, cells = set[int](), set[int](), 0
    failed: dict[str, list[str]] = {}
    row = column = 0
    for event, element in ET.iterparse(file, ("start", "end")):
        tag = element.tag.rpartition("}")[2]  # without its namespace
        if tag == "row" and event == "start":  # what has no place stands after the one before
            row, column = int(element.get("r", row + 1)), 0
        elif tag == "row":
            element.clear()
        elif tag == "c" and event == "end":
            place = PLACE.fullmatch(element.get("r", ""))
            column += 1
            if place:  # A is 1, AA is 27
                column = reduce(
                    lambda n, letter: 26 * n + ascii_uppercase.index(letter) + 1, place[1], 0
                )
            if len(element):
                cells += 1
                rows.add(row)
                columns.add(column)
                problem = _problem(element)
                if problem:
                    failed.setdefault(problem, []).append(f"{_letters(column)}{row}")
            element.clear()
    if not cells:
        return 1, ()
    width, height = max(columns) - min(columns) + 1, max(rows) - min(rows) + 1
    # Empty cells that a sheet may have between others, at some 70 bytes each in memory.
    if width * height > max(2_000_000, 2 * cells):
        found = (
            f"a sheet of {width} columns and {height} rows, up to column {_letters(max(columns))} and "
            f"row {max(rows)}, in which only {cells} cells hold anything"
        )
        raise InputError(found, "one table: delete the cells that stand far from it", path)
    warnings = []
    for what, places in failed.items():
        values: Values = {
            "file": path.name,
            "cells": len(places),
            "value": what,
            "places": some(places, 4),
        }
        words = {"count": count(len(places), "cell"), "shown": shown(what)}
        warnings.append(warned("cells-without-value", values, **words))
    return min(rows), tuple(warnings)


def _problem(cell: ET.Element) -> str:
    """Return the error of a cell, or that its formula has no value; empty where it has one."""
    value = cell.findtext("{*}v", "").strip()
    if cell.get("t") == "e":
        return value
    # A text may be empty.
    if cell.find("{*}f") is not None and not value and cell.get("t") != "str":
        return "formula without a value"
    return ""


def _letters(number: int) -> str:
    """Return the letters of a column from its number."""
    letters = ""
    while number:
        number, letter = divmod(number - 1, 26)
        letters = ascii_uppercase[letter] + letters
    return letters
