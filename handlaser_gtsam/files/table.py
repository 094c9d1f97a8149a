"""Tables of text: a header and one row a line, whose cells are taken apart without any guess.

Separator and header are found in the first lines. Every further line that is not blank becomes one
row, and every row has exactly the cells of the header: no parser stands between the two that could
join, drop or pad them. A cell in quotes begins and ends with its quotes on one line, and quotes inside
are doubled; any other quote is refused, since it would swallow what follows it.
"""

import re
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import polars as pl

from ..arrays import BoolArray, FloatArray, IntArray
from ..data.recording import first_repeated
from ..errors import CalibrationWarning, InputError
from ..text import A_NAME, LONGEST_NAME, count, name_fault, shown, some
from .checked_text import read_text

SEPARATORS = ",;\t"
BLANK = " \t"
"""Blanks that are ignored around cells; others, such as a no-break space, belong to the cell."""
UNIT = "\x1f"
"""Stands between cells once quotes are taken away; as a control character it is in no cell."""
CONTROL = re.compile("[\x00-\x08\x0b\x0c\x0e-\x1f\x7f]")
CELLS = {
    separator: re.compile(
        f'(?:^|{separator})(?:[{blanks}]*"((?:[^"]|"")*)"[{blanks}]*(?={separator}|$)'
        f"|([^{separator}]*))"
    )
    for separator, blanks in ((",", BLANK), (";", BLANK), ("\t", " "))
}
"""A cell in quotes, with blanks around it that are no separators, or one without quotes."""
COMMA = re.compile(r"[+-]?\d*,\d+(?:[eE][+-]?\d+)?")
POINT = re.compile(r"[+-]?\d*\.\d+(?:[eE][+-]?\d+)?")
NUMBER = re.compile(rf"(?:{COMMA.pattern}|{POINT.pattern}|[+-]?\d+)")
PLAIN = r"^[!-~]([ -~]{0,198}[!-~])?$"
"""Names of ASCII, which most are, need no closer look."""
STATED = re.compile(r'\A"?sep=([,;\t])"?[ \t]*(?=\n)', re.IGNORECASE)
"""The first line by which a spreadsheet states the separator."""
MOST_LOOKED_AT = 1000
"""Cells of a line that tell whether it is a header, for no log has more columns; and lines in which
separators are counted."""
NANOMETRE_DECIMALS = 9
"""A length that is cut behind this number of decimals is wrong by less than a nanometre."""
MOST_TITLES = 20
"""A header stands behind this number of lines of titles at most."""


@dataclass(frozen=True, slots=True)
class Table:
    """The rows of a file as text without blanks around it, null where a cell is empty.

    Attributes
    ----------
    frame : polars.DataFrame
        Of strings, or of numbers where the file has numbers; its columns have the names of the header.
    path : Path
    header_line : int
    lines : (M,)
        The line of every row in the file, from 1.
    open_ended : bool
        Whether nothing, neither a line end nor a closing quote, follows the last cell.
    warnings : tuple of CalibrationWarning
        What was passed over: titles above the header, cells of a workbook without a value.
    """

    frame: pl.DataFrame
    path: Path
    header_line: int
    lines: IntArray
    open_ended: bool
    warnings: tuple[CalibrationWarning, ...] = ()

    def refuse(
        self, wrong: BoolArray, column: str, expected: str, found: str | None = None
    ) -> None:
        """Raise for the first row that is `wrong`; without `found` the cell is quoted."""
        rows = np.flatnonzero(wrong)
        if rows.size:
            row = int(rows[0])
            found = _cell(self.frame[column][row]) if found is None else found
            raise InputError(found, expected, self.path, int(self.lines[row]), column)

    def fault(self, found: str, expected: str, column: str | None = None) -> InputError:
        """Return the error for a fault of the header, if the file has one."""
        return InputError(found, expected, self.path, self.header_line or None, column)

    @property
    def names(self) -> str:
        """The first names of the header, in words."""
        return some([name[:40] for name in self.frame.columns], 12)

    def require(self, *names: str) -> None:
        """Refuse a header without one of these names.

        Raises
        ------
        InputError
        """
        for name in names:
            if name not in self.frame.columns:
                near = next((one for one in self.frame.columns if one.lower() == name), None)
                found = f"column {near!r}" if near else f"no column {name!r} among {self.names}"
                raise self.fault(found, f"{name!r}", name)

    def refuse_cut(self) -> None:
        """Refuse a last line without a line end, unless its last cell shows that it is whole.

        A file whose end is lost looks the same, and its last number may lack digits.
        """
        name = self.frame.columns[-1]
        column = self.frame[name]
        if not self.open_ended or _whole(column[-1], column[:-1]):
            return
        last = np.arange(len(column)) == len(column) - 1
        cell = _cell(column[-1])
        found = f"a last line without a line end: {cell} may be what is left of a longer one"
        self.refuse(last, name, "a line end; add one if the line is whole", found)


def _cell(content: object) -> str:
    return "an empty cell" if content is None else shown(content)


def read_table(path: Path, known: Collection[str] = ()) -> Table:
    """Read a table from a file; columns of the `known` names tell its separator.

    Raises
    ------
    InputError
        No readable file, bytes that are no UTF-8, control characters, a stray quote, a row that has not
        as many cells as the header, or a header whose names cannot be printed or stand twice.
    """
    text, separator = without_separator_line(table_text(path))
    if separator is None:
        # That of the first line with most known names; where these are as many, with most cells.
        lines = text.split("\n", MOST_TITLES + 1)[: MOST_TITLES + 1]
        fits = [(0, 0, 0, ",")]
        for number, line in enumerate(line for line in lines if line.strip()):
            for one in SEPARATORS:
                names = first_cells(line, one)
                fits.append((len(set(known) & set(names)), -number, len(names), one))
        separator = max(fits, key=lambda fit: fit[:3])[-1]
    text, warnings = without_titles(text, separator, path)
    return replace(table_of(text, path, separator), warnings=warnings)


def without_separator_line(text: str) -> tuple[str, str | None]:
    """Return a text whose first line `sep=;` is empty, and the separator that it stated."""
    stated = STATED.match(text)
    return (text, None) if stated is None else (text[stated.end() :], stated[1])


def without_titles(
    text: str, separator: str, path: Path
) -> tuple[str, tuple[CalibrationWarning, ...]]:
    """Return a text without the titles above its header, whose lines stay, empty; and a warning."""
    lines = text.split("\n", MOST_TITLES + 1)
    first = lines[: MOST_TITLES + 1]
    above = titles_above([first_cells(line, separator) for line in first])
    titles = [line.strip(BLANK + separator) for line in lines[:above]]
    if not any(titles):
        return text, ()
    return "\n".join([""] * above + lines[above:]), titles_warning(titles, path)


def first_cells(line: str, separator: str) -> list[str]:
    """Return the first `MOST_LOOKED_AT` cells of a line, without blanks and quotes around them."""
    cells = line.split(separator, MOST_LOOKED_AT)[:MOST_LOOKED_AT]
    return [cell.strip(f'{BLANK}"') for cell in cells]


def titles_above(rows: Sequence[Sequence[str]]) -> int:
    """Return how many of the first rows of a table stand above its header.

    The header is the first row with more than half as many filled cells as the fullest row. Where a
    cell of it is a number it is none, and nothing is passed over.
    """
    filled = [[cell for cell in row if cell] for row in rows]
    most = max(map(len, filled), default=0)
    header = next((i for i, cells in enumerate(filled) if 2 * len(cells) > most), 0)
    return 0 if any(NUMBER.fullmatch(cell) for cell in filled[header]) else header


def titles_warning(titles: Sequence[str], path: Path) -> tuple[CalibrationWarning, ...]:
    """Return the warning that lines above the header were passed over."""
    there = [title for title in titles if title]
    words = (
        f"{path.name}: passed over {count(len(there), 'line')} above the header: {shown(there[0])}"
    )
    words += ", ..." if len(there) > 1 else ""
    return (CalibrationWarning("title-lines", words, {"lines": len(there)}),)


def table_of(text: str, path: Path, separator: str) -> Table:
    """Take a text apart as `read_table` does, at a separator.

    Raises
    ------
    InputError
    """
    lines = text.split("\n")
    numbers = [i for i, line in enumerate(lines, 1) if line.strip(BLANK + separator)]
    if not numbers:
        raise InputError("an empty file", "a header and one row a station", path)
    first = first_cells(lines[numbers[0] - 1], separator)
    values = [cell for cell in first if NUMBER.fullmatch(cell)]
    if len(values) > 1 and len(first) - len(values) < 2:  # numbers, and no two names: no header
        found = f"numbers in the first line ({shown(values[0])[1:-1]}, ...)"
        expected = "names of columns; state them by --header where the file has none"
        raise InputError(found, expected, path, numbers[0])
    if len(numbers) < 2:
        raise InputError("a header but no station", "one row a station", path)
    cells, ended = [], numbers[-1] < len(lines)
    for number in numbers:
        row = _split(lines[number - 1], separator, path, number)
        cells.append(row)
        width, count = cells[0].count(UNIT) + 1, row.count(UNIT) + 1
        if count != width:
            is_cut = number == numbers[-1] and not ended and count < width
            cut = " in a last line that is cut" if is_cut else ""
            hint = "; decimal commas need another separator than commas"
            hint = hint if count > width and separator == "," else ""
            expected = f"{width}, as in the header{hint}"
            raise InputError(f"{count} fields{cut}", expected, path, number)
    names = [cell.strip(BLANK) for cell in cells[0].split(UNIT)]
    names = [name or f"(column {i + 1} without a name)" for i, name in enumerate(names)]
    require_columns(names, path, numbers[0])
    split = pl.Series(cells[1:], dtype=pl.String).str.split_exact(UNIT, width - 1)
    frame = split.struct.rename_fields(names).struct.unnest()
    stripped = pl.all().str.strip_chars(BLANK)
    frame = frame.select(pl.when(stripped != "").then(stripped))
    open_ended = not ended and not lines[numbers[-1] - 1].rstrip(BLANK).endswith('"')
    return Table(frame, path, numbers[0], np.array(numbers[1:], dtype=np.intp), open_ended)


def require_columns(names: Sequence[str], path: Path, line: int | None) -> None:
    """Refuse columns whose names cannot be printed, or stand twice in the line of a header.

    Raises
    ------
    InputError
    """
    for fault in filter(None, map(name_fault, names)):
        expected = f"printable names of at most {LONGEST_NAME} characters in the header"
        raise InputError(fault, expected, path, line)
    twice = first_repeated(names)
    if twice is not None:
        raise InputError("the same name twice", "every column once", path, line, names[twice])


def column_numbers(
    table: Table, name: str, *, empty: bool = False, but: BoolArray | None = None
) -> FloatArray:
    """Return a column as finite floats, `but` some; NaN where a cell is empty and may be."""
    cells = table.frame[name]
    values = cells.cast(pl.Float64, strict=False).to_numpy().astype(np.float64)
    wrong = ~np.isfinite(values)
    if but is not None:
        wrong &= ~but
    if empty:
        wrong &= ~cells.is_null().to_numpy()
    expected = "a finite number" + (" or an empty cell" if empty else "")
    if wrong.any() and "," in str(cells[int(wrong.argmax())]):
        expected += "; write decimals with a point"
    table.refuse(wrong, name, expected)
    return values


def labels(table: Table, column: str) -> tuple[str, ...]:
    """Return the labels in a column, numbers as text.

    Raises
    ------
    InputError
        An empty cell, or what cannot be a name.
    """
    cells = table.frame[column]
    table.refuse(cells.is_null().to_numpy(), column, "a label")
    if cells.dtype.is_float() and (cells == cells.round()).all():  # 3.0 of a workbook is 3
        whole = cells.cast(pl.Int64, strict=False)
        cells = cells if whole.is_null().any() else whole
    text = cells.cast(pl.String)
    strange = text.filter(~text.str.contains(PLAIN))
    faults = {name: name_fault(name) for name in strange.unique().to_list()}
    rows = text.is_in([name for name, fault in faults.items() if fault]).to_numpy()
    if rows.any():
        table.refuse(rows, column, A_NAME, faults[text[int(rows.argmax())]])
    return tuple(text.to_list())


def table_text(path: Path) -> str:
    """Return the text of a file, whose lines end with a line feed.

    Raises
    ------
    InputError
        No readable file, bytes that are no UTF-8, or control characters.
    """
    text = read_text(path, "a recording")
    text = text.removeprefix("\ufeff").replace("\r\n", "\n")
    if "\n" not in text:
        text = text.replace("\r", "\n")  # line ends of an old Mac
    wrong, stray = CONTROL.search(text), text.find("\r")
    if wrong is not None and not 0 <= stray < wrong.start():
        line = text.count("\n", 0, wrong.start()) + 1
        raise InputError(f"the control character {shown(wrong[0])}", "text", path, line)
    if stray >= 0:
        expected = "line ends of one kind: LF or CR LF, or CR throughout"
        line = text.count("\n", 0, stray) + 1
        raise InputError("a carriage return within a line", expected, path, line)
    return text


def _split(line: str, separator: str, path: Path, number: int) -> str:
    """Return a line with `UNIT` between its cells and without the quotes around them."""
    cells = CELLS[separator].findall(line) if '"' in line else ()
    for _, plain in cells:
        if '"' in plain:
            found = f"a stray quote in {shown(plain.strip(BLANK))}"
            expected = (
                "no quotes, or quotes around a whole cell on one line with those inside doubled"
            )
            raise InputError(found, expected, path, number)
    whole = [plain or quoted.replace('""', '"') for quoted, plain in cells]
    return UNIT.join(whole) if cells else line.replace(separator, UNIT)


def _whole(cell: str | None, others: pl.Series) -> bool:
    """Tell whether a number has all its digits, as far as the numbers above it in its column show.

    It has as many decimals as any of them, up to where further ones do not matter, or an exponent.
    """
    if cell is None:
        return False
    if re.fullmatch(r"[+-]?[\d.]+[eE][+-]?\d\d+", cell):
        return True
    number = re.fullmatch(r"[+-]?(\d+)\.(\d+)", cell)
    if number is None or others.str.contains("[eE]").any():
        return False
    decimals = len(number[2])
    if number[1] == "0" and decimals >= NANOMETRE_DECIMALS:
        return True
    most = others.str.extract(r"\.(\d+)$").str.len_chars().max()
    return isinstance(most, int) and decimals >= most
