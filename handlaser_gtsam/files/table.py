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
from ..results.messages import Values, warned
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
MOST_TITLES = 20
"""A header stands behind this number of lines of titles at most."""
MOST_CHARACTERS = 10**9
"""Polars has texts of less than 2^32 bytes, and a character has four of them at most."""
A_HEADER = "names of columns in the first line, or from `handlaser convert LOG --header NAMES`"


@dataclass(frozen=True, slots=True)
class FileTable:
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

    def where(self, kept: BoolArray) -> "FileTable":
        """Return the table of the rows (M,) that are `kept`."""
        return replace(self, frame=self.frame.filter(kept), lines=self.lines[kept])

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


def read_table(path: Path, known: Collection[str] = ()) -> FileTable:
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
    return table_below_titles(text, path, separator)


def without_separator_line(text: str) -> tuple[str, str | None]:
    """Return a text whose first line `sep=;` is empty, and the separator that it stated."""
    stated = STATED.match(text)
    return (text, None) if stated is None else (text[stated.end() :], stated[1])


def table_below_titles(
    text: str, path: Path, separator: str, *, header: str = A_HEADER, may_be_empty: bool = False
) -> FileTable:
    """Take a text apart as `table_of` does, without the titles above its header, of which it warns.

    Raises
    ------
    InputError
    """
    lines = text.split("\n", MOST_TITLES + 1)
    first = lines[: MOST_TITLES + 1]
    above = titles_above([first_cells(line, separator) for line in first])
    titles = [line.strip(BLANK + separator) for line in lines[:above]]
    if any(titles):
        text = "\n".join([""] * above + lines[above:])
    table = table_of(text, path, separator, header=header, may_be_empty=may_be_empty)
    return replace(table, warnings=titles_warning(titles, path)) if any(titles) else table


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
    values: Values = {"file": path.name, "lines": len(there), "first": there[0]}
    words = {"shown": shown(there[0]), "more": ", ..." if len(there) > 1 else ""}
    return (warned("title-lines", values, count=count(len(there), "line"), **words),)


def table_of(
    text: str, path: Path, separator: str, *, header: str = A_HEADER, may_be_empty: bool = False
) -> FileTable:
    """Take a text apart as `read_table` does, at a separator.

    Parameters
    ----------
    text : str
        As `table_text` returns it.
    path : Path
    separator : str
    header : str
        What the first line has, in words, for one that is no header.
    may_be_empty : bool
        Whether there may be a header, and no row.

    Raises
    ------
    InputError
    """
    lines = pl.Series([text]).str.split("\n").explode()
    filled = lines.str.strip_chars(BLANK + separator) != ""
    numbers, rows = np.flatnonzero(filled.to_numpy()) + 1, lines.filter(filled)
    if not len(rows):
        raise InputError("an empty file", "a header and one row a station", path)
    first = first_cells(rows[0], separator)
    values = [cell for cell in first if NUMBER.fullmatch(cell)]
    if len(values) > 1 and len(first) - len(values) < 2:  # numbers, and no two names: no header
        found = f"numbers in the first line ({shown(values[0])[1:-1]}, ...)"
        raise InputError(found, header, path, int(numbers[0]))
    if len(rows) < 2 and not may_be_empty:
        raise InputError("a header but no station", "one row a station", path)
    ended, last = numbers[-1] < len(lines), rows[-1]
    mark, fault = separator, None
    if '"' in text:
        mark = UNIT
        rows, fault = _unquoted(rows, separator, path, numbers)
    counts = rows.str.count_matches(mark, literal=True).to_numpy() + 1
    width = int(counts[0]) if len(rows) else 0
    wrong = np.flatnonzero(counts != width)
    if wrong.size:
        row = int(wrong[0])
        is_cut = row == len(numbers) - 1 and not ended and counts[row] < width
        cut = " in a last line that is cut" if is_cut else ""
        undo = "; take it away, or copy the whole file again" if is_cut else ""
        hint = "; decimal commas need another separator than commas"
        hint = hint if counts[row] > width and separator == "," else ""
        expected = f"{width}, as in the header{hint}{undo}"
        found = f"{count(int(counts[row]), 'field')}{cut}"
        raise InputError(found, expected, path, int(numbers[row]))
    if fault is not None:
        raise fault
    names = [cell.strip(BLANK) for cell in rows[0].split(mark)]
    names = [name or f"(column {i + 1} without a name)" for i, name in enumerate(names)]
    require_columns(names, path, int(numbers[0]))
    split = rows[1:].str.split_exact(mark, width - 1)
    frame = split.struct.rename_fields(names).struct.unnest()
    cells = pl.all()
    if any(one in text for one in BLANK):  # with millions of rows it takes a while
        cells = cells.str.strip_chars(BLANK)
    frame = frame.select(pl.when(cells != "").then(cells))
    open_ended = not ended and not last.rstrip(BLANK).endswith('"')
    return FileTable(frame, path, int(numbers[0]), numbers[1:], open_ended)


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
    table: FileTable, name: str, *, empty: bool = False, but: BoolArray | None = None
) -> FloatArray:
    """Return a column as floats, finite except at `but`; NaN where a cell is empty and may be."""
    cells = table.frame[name]
    values = cells.cast(pl.Float64, strict=False).to_numpy().astype(np.float64)
    wrong = ~np.isfinite(values)
    if but is not None:
        wrong &= ~but
    if empty:
        wrong &= ~cells.is_null().to_numpy()
    expected = "a finite number" + (" or an empty cell" if empty else "")
    first = str(cells[int(wrong.argmax())]) if wrong.any() else ""
    if "," in first:
        remedy = "remove separators of thousands" if "." in first else "write decimals with a point"
        expected += f"; {remedy}"
    table.refuse(wrong, name, expected)
    return values


def label_texts(table: FileTable, column: str) -> pl.Series:
    """Return the cells of a column of labels as text, numbers without decimals as whole ones.

    Raises
    ------
    InputError
        An empty cell.
    """
    cells = table.frame[column]
    table.refuse(cells.is_null().to_numpy(), column, "a label")
    if cells.dtype.is_float() and (cells == cells.round()).all():  # 3.0 of a workbook is 3
        whole = cells.cast(pl.Int64, strict=False)
        cells = cells if whole.is_null().any() else whole
    return cells.cast(pl.String)


def labels(table: FileTable, column: str) -> tuple[str, ...]:
    """Return the labels in a column, numbers as text.

    Raises
    ------
    InputError
        An empty cell, or what cannot be a name.
    """
    text = label_texts(table, column)
    strange = text.filter(~text.str.contains(PLAIN))
    faults = {name: name_fault(name) for name in strange.unique().to_list()}
    rows = text.is_in([name for name, fault in faults.items() if fault]).to_numpy()
    if rows.any():
        table.refuse(rows, column, A_NAME, faults[text[int(rows.argmax())]])
    return tuple(text.to_list())


def table_text(path: Path, expected: str = "a recording") -> str:
    """Return the text of a file, whose lines end with a line feed.

    Raises
    ------
    InputError
        No readable file, bytes that are no UTF-8, control characters, or a file that is too long.
    """
    text = read_text(path, expected)
    text = text.removeprefix("\ufeff").replace("\r\n", "\n")
    if "\n" not in text:
        text = text.replace("\r", "\n")  # line ends of an old Mac
    if len(text) > MOST_CHARACTERS:
        expected = f"at most {MOST_CHARACTERS}, in several files or as Parquet"
        raise InputError(f"{len(text)} characters", expected, path)
    wrong, stray = CONTROL.search(text), text.find("\r")
    if wrong is not None and not 0 <= stray < wrong.start():
        line = text.count("\n", 0, wrong.start()) + 1
        raise InputError(f"the control character {shown(wrong[0])}", "text", path, line)
    if stray >= 0:
        expected = "line ends of one kind: LF or CR LF, or CR throughout"
        line = text.count("\n", 0, stray) + 1
        raise InputError("a carriage return within a line", expected, path, line)
    return text


def _unquoted(
    rows: pl.Series, separator: str, path: Path, numbers: IntArray
) -> tuple[pl.Series, InputError | None]:
    """Return rows with `UNIT` between their cells, without the quotes around these.

    A stray quote ends them; its fault comes with the rows before it, of which one may be wrong, too.
    """
    whole, fault = list[str](), None
    expected = "no quotes, or quotes around a whole cell on one line with those inside doubled"
    for row, number in zip(rows, numbers.tolist(), strict=True):
        cells = CELLS[separator].findall(row) if '"' in row else ()
        stray = [plain for _, plain in cells if '"' in plain]
        if stray:
            found = f"a stray quote in {shown(stray[0].strip(BLANK))}"
            fault = InputError(found, expected, path, number)
            break
        bare = UNIT.join(plain or quoted.replace('""', '"') for quoted, plain in cells)
        whole.append(bare if cells else row.replace(separator, UNIT))
    return pl.Series(whole, dtype=pl.String), fault


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
    # A length that is cut behind this number of decimals is wrong by less than a nanometre.
    if number[1] == "0" and decimals >= 9:
        return True
    most = others.str.extract(r"\.(\d+)$").str.len_chars().max()
    return isinstance(most, int) and decimals >= most
