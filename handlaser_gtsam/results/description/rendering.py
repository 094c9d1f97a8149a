"""Tables and sentences as plain text of bounded width, for terminals and files; and for notebooks."""

from collections.abc import Iterator
from html import escape

from ...text import shortened
from ..lines import wrapped
from .description import Description
from .tables import MINUS, NONE, Table

PLAIN = str.maketrans({MINUS: "-", NONE: "-", "±": "+-", "²": "^2", "·": "."})
"""Letters that not every terminal shows."""
GAPS = ("  ", " ")
"""Between columns: the narrow one where a table then fits."""
NAME = 0.25
"""Part of the width that the first column has where the table stands in parts, before each of them."""


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
    # A name of less than eight characters does not tell one from another.
    longest = room if room >= 8 else int(NAME * width)
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


def full_table(title: str, table: Table, width: int) -> list[str]:
    """Return a table with its title, caption and note, and a blank line after it."""
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


def notebook_html(described: Description) -> str:
    """Return the verdict, the sizes and the table of the beams as HTML; names are escaped."""
    html = f"<p><b>{escape(described.verdict.sentence)}</b></p><p>{escape(described.sizes)}</p>"
    beams = described.beams
    if beams is None:
        return html
    head = "".join(f"<th>{escape(column.title)}</th>" for column in beams.columns)
    rows = (
        "<tr>" + "".join(f"<td>{escape(cell.text)}</td>" for cell in row) + "</tr>"
        for row in beams.rows
    )
    html += f"<p>{escape(beams.caption)}</p><table><thead><tr>{head}</tr></thead>"
    html += f"<tbody>{''.join(rows)}</tbody></table>"
    return html + (f"<p>{escape(beams.note)}</p>" if beams.note else "")
