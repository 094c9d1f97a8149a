"""Tables and facts: text, and the number behind a cell, by which a page sorts.

And the same as plain text of bounded width, for terminals and files.
"""

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from html import escape
from typing import NamedTuple, TypeVar

import numpy as np

from ...arrays import FloatArray
from ...text import count, shortened
from ..lines import decimals, wrapped
from ..messages import MESSAGES, TITLES, said

NONE = "\N{EN DASH}"
NAME_IN_TABLE = 60
"""Characters of a name in a table of many rows; the table of the mounts has all."""
ROWS_ON_PAGE = 200
"""Rows of beams, planes, readings or stations on a page, which more would make slow; the JSON has
all."""
ROWS_ON_SCREEN = 8
"""Rows of a table on the default screen."""
MINUS = "\N{MINUS SIGN}"
Item = TypeVar("Item")
Facts = tuple[tuple[str, str], ...]
"""Pairs of a name and words."""


class Cell(NamedTuple):
    """Text, the number by which it sorts, and a mark: `good`, `care`, `bad`, or none."""

    text: str
    value: float | None = None
    mark: str = ""


class Column(NamedTuple):
    """A title; whether its cells are numbers; whether it gives way where the page is narrow."""

    title: str
    number: bool = True
    wide: bool = False


class Table(NamedTuple):
    """Rows of cells under columns, with a note on what is not shown."""

    name: str
    caption: str
    columns: tuple[Column, ...]
    rows: tuple[tuple[Cell, ...], ...]
    note: str = ""


def number(value: float | None, digits: int, mark: str = "") -> Cell:
    """Return a cell with this number of decimals; a dash where there is no number."""
    if value is None or not math.isfinite(value):
        return Cell(NONE, None, mark)
    return Cell(plain(value, digits), float(value), mark)


def significant(value: float | None, digits: int = 3) -> Cell:
    """Return a cell with this number of significant digits; a dash where there is no number."""
    if value is None or not math.isfinite(value):
        return Cell(NONE)
    return Cell(concise(value, digits), float(value))


def coordinates(
    values: FloatArray, sigmas: FloatArray, digits: int, unknown: str = NONE
) -> tuple[Cell, ...]:
    """Return a cell for each of the values (n,); `unknown` where its sigma (n,) is not finite."""
    open_ = Cell(unknown, None, "care")
    pairs = zip(values.tolist(), np.isfinite(sigmas).tolist(), strict=True)
    return tuple(number(value, digits) if known else open_ for value, known in pairs)


def table_of(name: str, rows: Iterable[tuple[Cell, ...]], note: str = "", **words: str) -> Table:
    """Return a table, with the columns and the caption that `messages.toml` has of this name.

    A colon in the name tells tables apart that are called alike.
    """
    titles = TITLES[name]
    columns = tuple(
        Column(title, title not in titles["words"], title in titles.get("wide", ()))
        for title in titles["titles"]
    )
    caption = said(f"table:{name}", **words) if f"table:{name}" in MESSAGES["sentences"] else ""
    return Table(name.partition(":")[0], caption, columns, tuple(rows), note)


def listed(
    name: str,
    items: Sequence[Item],
    row: Callable[[Item], tuple[Cell, ...]],
    noun: str,
    note: str = "",
    **words: str,
) -> Table:
    """Return a table with a row for each of the first items, a note, and how many more there are."""
    rows = [row(item) for item in items[:ROWS_ON_PAGE]]
    return table_of(name, rows, f"{note} {more(len(items) - len(rows), noun)}".strip(), **words)


def more(left: int, noun: str) -> str:
    """Return how many rows are not listed; empty where all are."""
    words = f"{count(left, f'more {noun}')}: the JSON of the calibration has all."
    return words if left > 0 else ""


def sentence(words: str) -> str:
    """Return words that begin with a capital and end with a full stop."""
    return f"{words[:1].upper()}{words[1:].rstrip('.')}."


def name_cell(name: str) -> Cell:
    """Return a cell with the name of one of many, cut where it is longer than a table has room for."""
    return Cell(shortened(name, NAME_IN_TABLE))


def plain(value: float, digits: int) -> str:
    """Return a number with this many decimals, a true minus, and no minus zero."""
    shown = f"{value:.{digits}f}"
    if float(shown) == 0.0:
        shown = shown.removeprefix("-")
    return shown.replace("-", MINUS)


def concise(value: float, digits: int = 3) -> str:
    """Return a number of this many significant digits, a true minus."""
    if value == 0.0:
        return "0"
    if 1e-4 <= abs(value) < 1e6:
        return plain(value, max(digits - 1 - math.floor(math.log10(abs(value))), 0))
    return f"{value:.{digits - 1}e}".replace("-", MINUS)


def digits_of(sigmas: Iterable[float], most: int) -> int:
    """Return the decimals that show two digits of the smallest standard deviation."""
    finite = [sigma for sigma in sigmas if math.isfinite(sigma) and sigma > 0.0]
    return decimals(min(finite), most) if finite else most


PLAIN = str.maketrans({MINUS: "-", NONE: "-", "±": "+-", "²": "^2", "·": "."})
"""Letters that not every terminal shows."""
GAPS = ("  ", " ")
"""Between columns: the narrow one where a table then fits."""


def text_table(table: Table, width: int, most_rows: int | None = None) -> list[str]:
    """Return a table as lines of at most `width` columns.

    Where it is wider, its columns stand in several parts below each other, each with the first column.
    A cell that is wider than the screen is wrapped.

    Parameters
    ----------
    table : Table
    width : int
    most_rows : int, optional
        Rows that are shown; how many more there are is said.
    """
    shown = table.rows[:most_rows]
    columns = [
        [column.title.translate(PLAIN), *(row[i].text.translate(PLAIN) for row in shown)]
        for i, column in enumerate(table.columns)
    ]
    sizes = [max(map(len, column)) for column in columns]
    room = width - sum(sizes[1:]) - len(GAPS[1]) * (len(sizes) - 1)
    # A name of less than eight characters does not tell one from another: then the table stands in
    # parts, and the first column has a quarter of the width before each of them.
    longest = room if room >= 8 else width // 4
    columns[0] = [shortened(cell, longest) for cell in columns[0]]
    sizes[0] = max(map(len, columns[0]))
    right = [column.number for column in table.columns]
    lines: list[str] = []
    wide, narrow = (sum(sizes) + len(gap) * (len(sizes) - 1) for gap in GAPS)
    gap = GAPS[1] if narrow <= width < wide else GAPS[0]
    for part in _parts(sizes, len(gap), width):
        for cells in zip(*(columns[i] for i in part), strict=True):
            padded = (
                cell.rjust(sizes[i]) if right[i] else cell.ljust(sizes[i])
                for i, cell in zip(part, cells, strict=True)
            )
            lines += wrapped(gap.join(padded), None, width)
    if len(shown) < len(table.rows):
        lines.append(f"and {len(table.rows) - len(shown)} more: --verbose")
    return lines


def _parts(sizes: list[int], gap: int, width: int) -> Iterator[list[int]]:
    """Yield the columns of every part, the first column always among them."""
    part, used = [0], sizes[0]
    for i, size in enumerate(sizes[1:], 1):
        if used + gap + size > width and len(part) > 1:
            yield part
            part, used = [0], sizes[0]
        part.append(i)
        used += gap + size
    yield part


def full_table(title: str, table: Table | None, width: int) -> list[str]:
    """Return a table with its title, caption and note, and a blank line after it; nothing of none."""
    if table is None:
        return []
    caption = [f"{title}. {table.caption}".rstrip() if table.caption else title]
    note = [table.note] if table.note else []
    return [
        *text_lines(caption, width),
        *text_table(table, width),
        *text_lines(note, width),
        "",
    ]


def text_lines(sentences: list[str], width: int) -> list[str]:
    """Return sentences as lines of at most `width` columns."""
    return [line for words in sentences for line in wrapped(words.translate(PLAIN), None, width)]


def as_html(verdict: str, sizes: str, tables: Iterable[Table]) -> str:
    """Return two sentences and tables as HTML; names are escaped."""
    html = f"<p><b>{escape(verdict)}</b></p><p>{escape(sizes)}</p>"
    for table in tables:
        head = "".join(f"<th>{escape(column.title)}</th>" for column in table.columns)
        rows = (
            "<tr>" + "".join(f"<td>{escape(cell.text)}</td>" for cell in row) + "</tr>"
            for row in table.rows
        )
        html += f"<p>{escape(table.caption)}</p><table><thead><tr>{head}</tr></thead>"
        html += f"<tbody>{''.join(rows)}</tbody></table>"
        html += f"<p>{escape(table.note)}</p>" if table.note else ""
    return html
