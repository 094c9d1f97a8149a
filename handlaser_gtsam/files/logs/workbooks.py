"""Workbooks (Office Open XML): the rows of one sheet, and what its cells fail to say.

The library that reads workbooks allocates the whole rectangle between the outermost cells, and gives
back errors and formulas that were never calculated as empty cells. Both are looked for in the XML of
the sheet first, which is streamed.
"""

import re
import xml.etree.ElementTree as ET
import zipfile
from pathlib import Path
from typing import IO

import polars as pl

from ...data.recording import first_repeated
from ...errors import CalibrationWarning, InputError
from ...text import count, shown, some
from ..table import MOST_TITLES, titles_above, titles_warning
from .format import LogFormat
from .packed import refuse_zip_bomb

EMPTY_CELLS = 2_000_000
"""Empty cells that a sheet may have between others, at some 70 bytes each in memory."""
PLACE = re.compile(r"([A-Z]{1,3})(\d{1,7})")


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
    try:
        import fastexcel
    except ImportError as error:
        raise InputError(
            "a workbook, but no package that reads it",
            "pip install 'handlaser-gtsam[excel]', or the sheet saved as CSV",
            path,
        ) from error
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
    head = [
        ["" if x is None else str(x).strip() for x in row]
        for row in texts.head(MOST_TITLES + 1).rows()
    ]
    above = titles_above(head)
    if above:
        titles = [" ".join(filter(None, row)) for row in head[:above]]
        warnings += titles_warning(titles, path)
    line = above + first
    named = [one for one in head[above] if one]
    twice = first_repeated(named)
    if twice is not None:
        raise InputError("the same name twice", "every column once", path, line, named[twice])
    names = [one or f"(column {i + 1} without a name)" for i, one in enumerate(head[above])]
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
    book = ET.fromstring(archive.read("xl/workbook.xml"))
    found = {}
    for one in book.iter():
        if _tag(one) == "sheet":
            identity = next((value for name, value in one.items() if name.endswith("}id")), None)
            part = target[identity]
            found[str(one.get("name"))] = part[1:] if part.startswith("/") else f"xl/{part}"
    return found


def _tag(element: ET.Element) -> str:
    """Return the name of an element without its namespace."""
    return element.tag.rpartition("}")[2]


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
        tag = _tag(element)
        if tag == "row" and event == "start":  # what has no place stands after the one before
            row, column = int(element.get("r", row + 1)), 0
        elif tag == "row":
            element.clear()
        elif tag == "c" and event == "end":
            place = PLACE.fullmatch(element.get("r", ""))
            column += 1
            if place:  # A is 1, AA is 27
                column = 0
                for letter in place[1]:
                    column = 26 * column + ord(letter) - ord("A") + 1
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
    if width * height > max(EMPTY_CELLS, 2 * cells):
        found = (
            f"a sheet of {width} columns and {height} rows, up to column {_letters(max(columns))} and "
            f"row {max(rows)}, in which only {cells} cells hold anything"
        )
        raise InputError(found, "one table: delete the cells that stand far from it", path)
    warnings = []
    for what, places in failed.items():
        words = (
            f"{path.name}: {count(len(places), 'cell')} of {shown(what)} ({some(places, 4)}) taken as "
            "empty; calculate the workbook again and save it, or mend them"
        )
        warnings.append(CalibrationWarning("cells-without-value", words, {"cells": len(places)}))
    return min(rows), tuple(warnings)


def _problem(cell: ET.Element) -> str:
    """Return the error of a cell, or that its formula has no value; empty where it has one."""
    parts = {_tag(one): one for one in cell}
    value = (parts["v"].text or "").strip() if "v" in parts else ""
    if cell.get("t") == "e":
        return value
    if "f" in parts and not value and cell.get("t") != "str":  # a text may be empty
        return "formula without a value"
    return ""


def _letters(number: int) -> str:
    """Return the letters of a column from its number."""
    letters = ""
    while number:
        number, letter = divmod(number - 1, 26)
        letters = chr(ord("A") + letter) + letters
    return letters
