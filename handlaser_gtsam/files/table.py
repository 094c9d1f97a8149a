"""Tables: the rows of a file of any kind (`logs.tables`), and how those of text are taken apart.

Every line that is not blank becomes one row, and every row has exactly the cells of the
header: no parser stands between the two that could join, drop or pad them. A cell in quotes begins and
ends with its quotes on one line, and quotes inside are doubled. Separator and decimal mark are
recognised where only one of each is possible; else they must be stated.
"""

import csv
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import polars as pl

from ..arrays import BoolArray, FloatArray, IntArray
from ..data.recording import first_repeated
from ..errors import CalibrationWarning, InputError
from ..text import A_NAME, LONGEST_NAME, count, name_fault, shown, some
from .checked_text import read_text
from .logs.format import LogFormat

SEPARATORS = ",;\t"
DELIMITERS = {"comma": ",", "semicolon": ";", "tab": "\t", "space": " "}
BLANK = " \t"
"""Blanks that are ignored around cells; others, such as a no-break space, belong to the cell."""
UNIT = "\x1f"
"""Stands between cells once quotes are taken away; as a control character it is in no cell."""
CONTROL = re.compile("[\x00-\x08\x0b-\x1f\x7f]")
COMMA = re.compile(r"[+-]?\d*,\d+(?:[eE][+-]?\d+)?")
POINT = re.compile(r"[+-]?\d*\.\d+(?:[eE][+-]?\d+)?")
NUMBER = re.compile(rf"(?:{COMMA.pattern}|{POINT.pattern}|[+-]?\d+)")
THOUSANDS = re.compile(r"[+-]?[1-9]\d{0,2},\d{3}")
"""May be 1234, or 1 and 234 thousandths."""
GROUPED = re.compile(r"[+-]?[1-9]\d{0,2}(?:\.\d{3})+(?:,\d+)?")
"""Has points between thousands where the decimal mark is stated to be a comma."""
STATED = re.compile(r'\A"?sep=([,;\t])"?[ \t]*(?=\n)', re.IGNORECASE)
"""The first line by which a spreadsheet states the separator."""
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
    warnings : tuple of CalibrationWarning
        That titles above the header were passed over.
    """

    frame: pl.DataFrame
    path: Path
    header_line: int
    lines: IntArray
    warnings: tuple[CalibrationWarning, ...] = ()

    def refuse(
        self, wrong: BoolArray, column: str, expected: str, found: str | None = None
    ) -> None:
        """Raise for the first row that is `wrong`; without `found` the cell is quoted."""
        rows = np.flatnonzero(wrong)
        if rows.size:
            row = int(rows[0])
            if found is None:
                content = self.frame[column][row]
                found = "an empty cell" if content is None else shown(content)
            raise InputError(found, expected, self.path, int(self.lines[row]), column)

    def where(self, kept: BoolArray) -> "Table":
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
                raise self.fault(f"no column {name!r} among {self.names}", f"{name!r}", name)

    def require_rows(self) -> None:
        """Refuse a table without a row.

        Raises
        ------
        InputError
        """
        if not len(self.frame):
            raise InputError("a header but no row", "one row a station or a reading", self.path)


def table_of_text(path: Path, given: LogFormat) -> Table:
    """Read a table of text; its numbers have a decimal point then.

    Raises
    ------
    InputError
        No readable file, no table, or one that can be read in several ways.
    """
    text, header = table_text(path), given.header_given
    if header:
        text = re.sub(r"(?m)^[ \t]*#.*$", "", text)
    stated = STATED.match(text)
    text = text if stated is None else text[stated.end() :]
    separator = DELIMITERS.get(given.delimiter or "") or (stated[1] if stated else "")
    if given.pose_format == "tum":
        separator = separator or " "
    separator = separator or _separator([line for line in text.split("\n") if line.strip()], path)
    if separator == " ":
        text = "\n".join("\t".join(line.split()) for line in text.split("\n"))
        separator = "\t"
    table = _taken_apart(text, path, separator, header)
    if '"' in text or given.decimal == "comma" or (separator != "," and "," in text):
        table = _with_points(table, given)
    if not text.endswith("\n"):
        _refuse_cut(table, text)
    return table


def table_text(path: Path) -> str:
    """Return the text of a file, whose lines end with a line feed.

    Raises
    ------
    InputError
        No readable file, bytes that are no UTF-8, or control characters.
    """
    text = read_text(path, "a table").removeprefix("\ufeff").replace("\r\n", "\n")
    if "\n" not in text:
        text = text.replace("\r", "\n")  # line ends of an old Mac
    wrong = CONTROL.search(text)
    if wrong is not None:
        line = text.count("\n", 0, wrong.start()) + 1
        found = f"the control character {shown(wrong[0])}"
        raise InputError(found, "text with line ends of one kind", path, line)
    return text


def _separator(lines: Sequence[str], path: Path) -> str:
    """Return the only separator at which the lines have equally many cells, two or more.

    Where there is none, it is that at which the first line has most; where there are several, it must
    be stated.
    """
    # Separators in quotes are none.
    bare = [re.sub('"[^"]*"', "", line) for line in lines[:1000]]  # which are enough to tell
    cells = {one: [line.count(one) + 1 for line in bare] for one in SEPARATORS}
    for begin in (0, len(bare) // 2):  # titles above the header are never half of the lines
        even = [one for one in SEPARATORS if len(set(cells[one][begin:])) == 1]
        possible = [one for one in even if cells[one][-1] > 1]
        if begin == 0 and len(possible) > 1:
            words = {value: name for name, value in DELIMITERS.items()}
            both = " and ".join(words[one] for one in possible)
            expected = "one of them as separator: state --delimiter"
            raise InputError(f"lines that {both} divide alike", expected, path)
        if len(possible) == 1:
            return possible[0]
    if lines and not any(one in lines[0] for one in SEPARATORS):
        return " " if all(len(line.split()) > 1 for line in lines) else ","
    return max(SEPARATORS, key=lambda one: cells[one][:1])


def _taken_apart(text: str, path: Path, separator: str, header: Sequence[str]) -> Table:
    """Return the lines of a text as rows of cells; the first is the header, unless one is given."""
    lines = pl.Series([text]).str.split("\n").explode()
    filled = lines.str.strip_chars(BLANK + separator) != ""
    numbers, rows = np.flatnonzero(filled.to_numpy()) + 1, lines.filter(filled)
    if not len(rows):
        raise InputError("an empty file", "a header and one row a station", path)
    warnings: tuple[CalibrationWarning, ...] = ()
    if not header:
        head = [line.split(separator) for line in rows[: MOST_TITLES + 1]]
        above = titles_above([[cell.strip(f'{BLANK}"') for cell in line] for line in head])
        titles = [line.strip(BLANK + separator) for line in rows[:above]]
        warnings = titles_warning(titles, path)
        numbers, rows = numbers[above:], rows[above:]
    mark = separator
    if '"' in text:
        mark = UNIT
        both = zip(rows, numbers.tolist(), strict=True)
        rows = pl.Series([_unquoted(row, separator, path, number) for row, number in both])
    names = list(header) or [cell.strip(BLANK) for cell in rows[0].split(mark)]
    values = [cell for cell in names if NUMBER.fullmatch(cell)]
    if len(values) > 1 and len(names) - len(values) < 2:  # numbers, and no two names: no header
        found = f"numbers in the first line ({shown(values[0])[1:-1]}, ...)"
        expected = "names of columns in the first line, or of a log from --header NAMES"
        raise InputError(found, expected, path, int(numbers[0]))
    counts = rows.str.count_matches(mark, literal=True).to_numpy() + 1
    wrong = np.flatnonzero(counts != len(names))
    if wrong.size:
        row = int(wrong[0])
        is_cut = numbers[row] == len(lines) and counts[row] < len(names)
        found = f"{counts[row]} fields{' in a last line that is cut' if is_cut else ''}"
        more = counts[row] > len(names) and separator == ","
        hint = "; decimal commas need another separator than commas" if more else ""
        raise InputError(found, f"{len(names)}, as in the header{hint}", path, int(numbers[row]))
    line = 0 if header else int(numbers[0])
    names = header_names(names, path, line)
    begin = 0 if header else 1
    split = rows[begin:].str.split_exact(mark, len(names) - 1)
    cells = pl.all().str.strip_chars(BLANK)
    frame = split.struct.rename_fields(names).struct.unnest()
    frame = frame.select(pl.when(cells != "").then(cells))
    return Table(frame, path, line, numbers[begin:], warnings)


def _unquoted(line: str, separator: str, path: Path, number: int) -> str:
    """Return a line with `UNIT` between its cells and without the quotes around them."""
    if '"' not in line:
        return line.replace(separator, UNIT)
    try:
        (cells,) = csv.reader([line], delimiter=separator, strict=True, skipinitialspace=True)
    except csv.Error as error:
        expected = "no quotes, or quotes around a whole cell on one line with those inside doubled"
        raise InputError(f"a stray quote ({error})", expected, path, number) from error
    return UNIT.join(cells)


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
    """Return the warning that lines above the header were passed over, if there are any."""
    if not titles:
        return ()
    words = (
        f"{path.name}: passed over {count(len(titles), 'line')} above the header: "
        f"{shown(titles[0])}{', ...' if len(titles) > 1 else ''}"
    )
    return (CalibrationWarning("title-lines", words, {"lines": len(titles)}),)


def header_names(names: Sequence[str], path: Path, line: int | None) -> list[str]:
    """Return the names of columns, a number for one without a name.

    Raises
    ------
    InputError
        Names that cannot be printed, or stand twice.
    """
    names = [name or f"(column {i + 1} without a name)" for i, name in enumerate(names)]
    for fault in filter(None, map(name_fault, names)):
        expected = f"printable names of at most {LONGEST_NAME} characters in the header"
        raise InputError(fault, expected, path, line or None)
    twice = first_repeated(names)
    if twice is not None:
        found = "the same name twice"
        raise InputError(found, "every column once", path, line or None, names[twice])
    return names


def _with_points(table: Table, given: LogFormat) -> Table:
    """Return the table with points for decimal commas.

    Raises
    ------
    InputError
        Numbers with commas and numbers with points, or commas that may stand between thousands.
    """
    frame = table.frame
    if given.decimal == "comma":
        whole = pl.all().str.replace_all(".", "", literal=True)
        frame = frame.select(pl.when(_matches(pl.all(), GROUPED)).then(whole).otherwise(pl.all()))
        table = replace(table, frame=frame)
    commas = frame.select(_matches(pl.all(), COMMA).fill_null(value=False))
    name = next((one.name for one in commas if one.any()), None)
    if given.decimal == "point" or name is None:
        return table
    cells = pl.concat([frame[one.name].filter(one).alias("") for one in commas])
    if given.decimal is None and cells.str.contains(f"^{THOUSANDS.pattern}$").all():
        expected = "a decimal comma or a separator of thousands? state --decimal comma"
        table.refuse(commas[name].to_numpy(), name, f"{expected}, or leave it out")
    for points in frame.select(_matches(pl.all(), POINT).fill_null(value=False)):
        expected = "decimal commas, as in other cells; or state --decimal point"
        table.refuse(points.to_numpy(), points.name, expected)
    changed = pl.all().str.replace(",", ".", literal=True)
    changed = pl.when(_matches(pl.all(), COMMA)).then(changed).otherwise(pl.all())
    return replace(table, frame=frame.select(changed))


def _matches(cells: pl.Expr, pattern: re.Pattern[str]) -> pl.Expr:
    """Return which cells are of a pattern as a whole."""
    return cells.str.contains(f"^{pattern.pattern}$")


def _refuse_cut(table: Table, text: str) -> None:
    """Refuse a last line without a line end, unless its last cell shows that it is whole.

    A file whose end is lost looks the same, and its last number may lack digits. A whole one has as
    many decimals as any other of its column, or is given to a nanometre; or its quotes are closed.
    """
    name = table.frame.columns[-1]
    cells = table.frame[name].cast(pl.String)
    decimals = cells.str.extract(r"^[+-]?\d+\.(\d+)$").str.len_chars().fill_null(0).to_numpy()
    if not len(cells) or text.endswith('"') or 0 < min(decimals.max(), 9) <= decimals[-1]:
        return
    cell = "an empty cell" if cells[-1] is None else shown(cells[-1])
    found = f"a last line without a line end: {cell} may be what is left of a longer one"
    last = np.arange(len(cells)) == len(cells) - 1
    table.refuse(last, name, "a line end; add one if the line is whole", found)


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


def label_texts(table: Table, column: str) -> pl.Series:
    """Return the cells of a column of labels as text, numbers without decimals as whole ones.

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
    faults = {name: name_fault(name) for name in text.unique()}
    rows = text.is_in([name for name, fault in faults.items() if fault]).to_numpy()
    if rows.any():
        table.refuse(rows, column, A_NAME, faults[text[int(rows.argmax())]])
    return text


def labels(table: Table, column: str) -> tuple[str, ...]:
    """Return the labels in a column, numbers as text; raises InputError as `label_texts`."""
    return tuple(label_texts(table, column).to_list())
