"""Workbooks (Office Open XML): the rows of one sheet, and what its cells fail to say.

The library that reads workbooks allocates the whole rectangle between the outermost cells, and gives
back errors and formulas that were never calculated as empty cells. Both are looked for in the XML of
the sheet first, which is streamed.
"""

import re
import xml.etree.ElementTree as ET
import zipfile
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO, cast

import polars as pl

from ...data.recording import first_repeated
from ...errors import CalibrationWarning, InputError
from ...text import count, shown, some
from ..table import titles_above, titles_warning
from .format import LogFormat
from .packed import A_PART, refuse_zip_bomb

EMPTY_CELLS = 2_000_000
"""Empty cells that a sheet may have between others, at some 70 bytes each in memory."""
CELL = re.compile(rb'<(?:\w+:)?c\b[^>]*?\br="([A-Z]{1,3})(\d{1,7})"[^>/]*>')
"""A cell that is not empty."""
ERROR = re.compile(
    rb'<(?:\w+:)?c\b(?=[^>]*\bt="e")[^>]*?\br="([A-Z]+\d+)"[^>]*>.*?<(?:\w+:)?v>([^<]*)<', re.S
)
UNCALCULATED = re.compile(
    rb'<(?:\w+:)?c\b(?![^>]*\bt="str")[^>]*?\br="([A-Z]+\d+)"[^>]*>\s*'
    rb"<(?:\w+:)?f\b(?:[^>]*/>|[^>]*>[^<]*</(?:\w+:)?f>)\s*"
    rb"(?:<(?:\w+:)?v\s*/>|<(?:\w+:)?v>\s*</(?:\w+:)?v>)?\s*</(?:\w+:)?c>"
)
"""A formula without a value; a text may be empty."""
BEGIN = re.compile(rb"<((?:\w+:)?)(row|c)\b([^>]*)")
PLACE = re.compile(rb'\br="([A-Z]*)(\d+)"')
WITHOUT_PLACE = re.compile(rb'<(?:\w+:)?c\b(?![^>]*\br=")')
"""A cell that stands where it stands: after the one before, as some programs write all of them."""


@dataclass(slots=True)
class _Scan:
    """What the XML of a sheet says: cells, the rectangle around them, and cells without a value."""

    cells: int = 0
    columns: set[bytes] = field(default_factory=set)
    first: int = 1 << 30
    last: int = 0
    row: int = 0
    column: int = 0
    failed: dict[str, list[str]] = field(default_factory=dict)

    def add(self, part: bytes) -> None:
        """Look through whole rows."""
        if WITHOUT_PLACE.search(part):
            self.row = max(self.row, self.last)
            part = BEGIN.sub(self._placed, part)
        found = CELL.findall(part)
        rows = {int(row) for _, row in found}
        self.cells += len(found)
        self.columns |= {column for column, _ in found}
        self.first, self.last = min((self.first, *rows)), max((self.last, *rows))
        for place, error in ERROR.findall(part):
            self.failed.setdefault(error.decode("ascii", "replace"), []).append(place.decode())
        for (place,) in (one.groups() for one in UNCALCULATED.finditer(part)):
            self.failed.setdefault("formula without a value", []).append(place.decode())

    def _placed(self, tag: re.Match[bytes]) -> bytes:
        """Return the beginning of a row or a cell, of a cell with its place."""
        prefix, kind, rest = tag.groups()
        place = PLACE.search(rest)
        if kind == b"row":
            self.row, self.column = int(place[2]) if place else self.row + 1, 0
            return tag[0]
        self.column = _number(place[1]) if place else self.column + 1
        if place:
            return tag[0]
        return b'<%sc r="%s%d"%s' % (prefix, _letters(self.column), self.row, rest)


@dataclass(frozen=True, slots=True, eq=False)
class Sheet:
    """The rows of a sheet below its header, the line of that, and what was passed over."""

    rows: pl.DataFrame
    header_line: int
    warnings: tuple[CalibrationWarning, ...]


def read_sheet(path: Path, given: LogFormat) -> Sheet:
    """Read a sheet.

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
        if given.sheet and given.sheet not in sheets:
            expected = f"one of {', '.join(map(shown, sheets))}"
            raise InputError(f"no sheet {shown(given.sheet)}", expected, path)
        if not given.sheet and len(sheets) > 1:
            listed = ", ".join(map(shown, sheets))
            raise InputError(f"{len(sheets)} sheets, {listed}", "one of them: state --sheet", path)
        name = given.sheet or next(iter(sheets))
        with archive.open(sheets[name]) as file:
            scan = _scanned(cast(BinaryIO, file))
    _refuse_stray(scan, path)
    book, warnings = fastexcel.read_excel(path), _warnings(scan, path)
    texts: pl.DataFrame = book.load_sheet(name, header_row=None, dtypes="string").to_polars()
    if not len(texts):
        raise InputError("an empty sheet", "a header and one row a station or a reading", path)
    head = [["" if x is None else str(x).strip() for x in row] for row in texts.head(21).rows()]
    above = titles_above(head)
    if above:
        titles = [" ".join(filter(None, row)) for row in head[:above]]
        warnings += titles_warning(titles, path)
    line = above + (scan.first if scan.cells else 1)
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
    return Sheet(found.with_columns(texts[one] for one in truths), line, tuple(warnings))


def _sheets(archive: zipfile.ZipFile) -> dict[str, str]:
    """Return the part of every sheet by its name."""
    links = ET.fromstring(archive.read("xl/_rels/workbook.xml.rels"))
    target = {one.get("Id"): str(one.get("Target")) for one in links}
    book = ET.fromstring(archive.read("xl/workbook.xml"))
    found = {}
    for one in book.iter():
        if one.tag.rpartition("}")[2] == "sheet":
            identity = next((value for name, value in one.items() if name.endswith("}id")), None)
            part = target[identity]
            found[str(one.get("name"))] = part[1:] if part.startswith("/") else f"xl/{part}"
    return found


def _scanned(file: BinaryIO) -> _Scan:
    scan, rest = _Scan(), b""
    while part := file.read(A_PART):
        rest += part
        end = rest.rfind(b"row>") + len(b"row>")
        if end > len(b"row>"):
            scan.add(rest[:end])
            rest = rest[end:]
    scan.add(rest)
    return scan


def _refuse_stray(scan: _Scan, path: Path) -> None:
    """Refuse a sheet most of whose cells are empty: one cell far away makes it so."""
    if not scan.cells:
        return
    last = max(scan.columns, key=lambda one: (len(one), one))
    numbers = [_number(one) for one in scan.columns]
    width, height = max(numbers) - min(numbers) + 1, scan.last - scan.first + 1
    if width * height > max(EMPTY_CELLS, 2 * scan.cells):
        found = (
            f"a sheet of {width} columns and {height} rows, up to column {last.decode()} and row "
            f"{scan.last}, in which only {scan.cells} cells hold anything"
        )
        raise InputError(found, "one table: delete the cells that stand far from it", path)


def _number(column: bytes) -> int:
    """Return the number of a column from its letters: A is 1, AA is 27."""
    number = 0
    for letter in column:
        number = 26 * number + letter - ord("A") + 1
    return number


def _letters(number: int) -> bytes:
    """Return the letters of a column from its number."""
    letters = b""
    while number:
        number, letter = divmod(number - 1, 26)
        letters = bytes([ord("A") + letter]) + letters
    return letters


def _warnings(scan: _Scan, path: Path) -> list[CalibrationWarning]:
    found = []
    for what, places in scan.failed.items():
        words = (
            f"{path.name}: {count(len(places), 'cell')} of {shown(what)} ({some(places, 4)}) taken as "
            "empty; calculate the workbook again and save it, or mend them"
        )
        found.append(CalibrationWarning("cells-without-value", words, {"cells": len(places)}))
    return found
