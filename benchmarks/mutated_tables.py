"""Recordings as they should be, and what befalls tables: cuts, quotes, separators, line ends, numbers.

Everything is drawn from one `random.Random`, so that a seed is a file. The mutations in `HARMLESS` do
not change what a file says: a reader that refuses their result is wrong.
"""

import math
import random
from collections.abc import Callable
from dataclasses import dataclass, field

from .mutated_bytes import mutated_bytes

POSE = ["x", "y", "z", "qx", "qy", "qz", "qw"]
_NUMBER_WORDS = """
1e308 -1e308 1e999 -1e999 1e-400 4.9e-324 1e300 1000001 0 -0.0 -1 nan NaN inf -inf Infinity NA
NULL none True 0x1p-3 0x10 1_000 0,123 1,234.5 1'234 1.2.3 --1 1e 1e+ e5 . + .5 5. +.5 1E-3 1d-3
0.1f 12:30 999 65.535 =1+1 '0.2 0.2m $0.2 20%
"""
NUMBERS = (
    *_NUMBER_WORDS.split(),
    *(
        "",
        "1 234",
        " 0.2 ",
        "\u0661.\u0662",
        "\uff11.5",
        "\u00bd",
        "\u00a00.2",
        "0.2\u200b",
        "\ufeff0.2",
    ),
    *("0." + "1" * 400, "1" * 400, "0." + "0" * 400 + "1"),
)
"""What may stand where a number should."""
TEXTS = (
    *("A", "B", "wall", "", " ", "#", "//", "\\", '5"', '"', '""', '"""', "a;b", "a,b", "a\tb"),
    *(
        f"A{c}"
        for c in "\u00a0\u2066\u202e\u0000\x07\x85\u2028\x0b\x0c\x1c\x7f\ufeff\ud7ff\U0001f600\u0301"
    ),
    *("\x1b[31mA", "\u202eA", "\u3000A", "\u0410", "A" * 201, "A" * 20_000),
)
"""What may stand where a label should."""


@dataclass(slots=True)
class Cells:
    """A table as cells, and how it is to be written."""

    rows: list[list[str]]
    separator: str = ","
    ends: list[str] = field(default_factory=list)
    start: bytes = b""
    last_end: bool = True

    def encoded(self) -> bytes:
        """Return the file."""
        ends = self.ends or ["\n"] * len(self.rows)
        lines = [self.separator.join(row) for row in self.rows]
        text = "".join(line + end for line, end in zip(lines, ends, strict=True))
        text = text if self.last_end else text.removesuffix(ends[-1])
        return self.start + text.encode("utf-8", "surrogatepass")


def table(rng: random.Random) -> Cells:
    """Return a small recording as some program or person writes it."""
    beams, planes = (
        rng.randint(1, 3),
        rng.choice((["A", "B"], ["wall", "table", "door"], ["1", "2"])),
    )
    header = ["plane"] + ["station"] * rng.randint(0, 1) + POSE
    header += [f"range_{b + 1}" for b in range(beams)] + ["note"] * (rng.random() < 0.3)
    digits = rng.choice((3, 6, 9, 17))
    rows = []
    for j in range(rng.randint(2 * len(planes), 12)):
        angle = rng.uniform(-0.5, 0.5)
        quaternion = [f"{math.sin(angle):.6f}", "0", "0", f"{math.cos(angle):.6f}"]
        cells = [planes[j % len(planes)]] + [f"s{j}"] * ("station" in header)
        cells += [_written(rng.uniform(-1.0, 1.0), digits) for _ in range(3)] + quaternion
        keep = [j < len(planes) or rng.random() < 0.9 for _ in range(beams)]
        cells += [_written(rng.uniform(0.02, 0.6), digits) if kept else "" for kept in keep]
        rows.append(cells + ["ok"] * ("note" in header))
    return Cells([header, *rows], rng.choice((",", ",", ";", "\t")))


def _written(number: float, digits: int) -> str:
    return repr(number) if digits == 17 else f"{number:.{digits}f}"


def _place(cells: Cells, rng: random.Random) -> tuple[list[str], int]:
    row = rng.choice(cells.rows)
    return row, rng.randrange(len(row))


def _number(cells: Cells, rng: random.Random) -> None:
    row, column = _place(cells, rng)
    row[column] = rng.choice(NUMBERS)


def _text(cells: Cells, rng: random.Random) -> None:
    row, column = _place(cells, rng)
    row[column] = rng.choice(TEXTS)


def _quote(cells: Cells, rng: random.Random) -> None:
    row, column = _place(cells, rng)
    at = rng.randint(0, len(row[column]))
    row[column] = row[column][:at] + '"' + row[column][at:]


def _two_quotes(cells: Cells, rng: random.Random) -> None:
    """Open quotes in one cell and close them in another, as a note of two lines does."""
    for end in (False, True):
        row, column = _place(cells, rng)
        row[column] = row[column] + '"' if end else '"' + row[column]


def _drop_separator(cells: Cells, rng: random.Random) -> None:
    row, column = _place(cells, rng)
    if column + 1 < len(row):
        row[column : column + 2] = [row[column] + row[column + 1]]


def _add_separator(cells: Cells, rng: random.Random) -> None:
    row, column = _place(cells, rng)
    at = rng.randint(0, len(row[column]))
    row[column : column + 1] = [row[column][:at], row[column][at:]]


def _drop_cell(cells: Cells, rng: random.Random) -> None:
    row, column = _place(cells, rng)
    del row[column]


def _cut_row(cells: Cells, rng: random.Random) -> None:
    row, column = _place(cells, rng)
    del row[max(column, 1) :]


def _swap_cells(cells: Cells, rng: random.Random) -> None:
    row, column = _place(cells, rng)
    other = rng.randrange(len(row))
    row[column], row[other] = row[other], row[column]


def _duplicate_column(cells: Cells, rng: random.Random) -> None:
    column = rng.randrange(min(len(row) for row in cells.rows) or 1)
    renamed = rng.random() < 0.5
    for row in cells.rows:
        row.append(row[column] if column < len(row) else "")
    if renamed:
        cells.rows[0][-1] += rng.choice(("", " ", "_2", "\u00a0", "2"))


def _swap_columns(cells: Cells, rng: random.Random) -> None:
    first, second = (rng.randrange(min(len(row) for row in cells.rows) or 1) for _ in range(2))
    for row in cells.rows[rng.randint(0, 1) :]:
        if max(first, second) < len(row):
            row[first], row[second] = row[second], row[first]


def _repeat_row(cells: Cells, rng: random.Random) -> None:
    cells.rows.insert(rng.randint(0, len(cells.rows)), list(rng.choice(cells.rows)))


def _other_separator(cells: Cells, rng: random.Random) -> None:
    row = rng.choice(cells.rows)
    row[:] = [rng.choice((",", ";", "\t", " ", "|")).join(row)]


def _decimal_commas(cells: Cells, rng: random.Random) -> None:
    for row in cells.rows[1:]:
        row[:] = [cell.replace(".", ",") for cell in row]
    cells.separator = rng.choice((cells.separator, ";"))


def _no_last_end(cells: Cells, _rng: random.Random) -> None:
    cells.last_end = False


def _mixed_ends(cells: Cells, rng: random.Random) -> None:
    cells.ends = [rng.choice(("\n", "\r\n", "\r", "\n\r", "\r\r\n")) for _ in cells.rows]


CELL_MUTATIONS: tuple[Callable[[Cells, random.Random], None], ...] = (
    *(_number, _number, _text, _quote, _quote, _two_quotes, _drop_separator, _add_separator),
    *(_drop_cell, _cut_row, _swap_cells, _duplicate_column, _swap_columns, _repeat_row),
    *(_other_separator, _decimal_commas, _no_last_end, _mixed_ends),
)


def _line_ends(cells: Cells, rng: random.Random) -> None:
    cells.ends = [rng.choice(("\n", "\r\n")) for _ in cells.rows]


def _old_mac(cells: Cells, _rng: random.Random) -> None:
    cells.ends = ["\r"] * len(cells.rows)


def _mark(cells: Cells, _rng: random.Random) -> None:
    cells.start = b"\xef\xbb\xbf"


def _blanks(cells: Cells, rng: random.Random) -> None:
    row, column = _place(cells, rng)
    blank = "  " if cells.separator == "\t" else rng.choice((" ", "\t", "  "))
    row[column] = blank + row[column] + blank


def _quoted_cell(cells: Cells, rng: random.Random) -> None:
    row, column = _place(cells, rng)
    row[column] = '"' + row[column].replace('"', '""') + '"'


def _quoted_note(cells: Cells, rng: random.Random) -> None:
    for row in cells.rows:
        row.append(rng.choice(('"a, b; c"', '"he said ""stop"""', "", "ok")))
    cells.rows[0][-1] = f"remark {len(cells.rows[0])}"


def _blank_line(cells: Cells, rng: random.Random) -> None:
    blank = rng.choice(([""], [" "], [""] * len(cells.rows[0])))
    cells.rows.insert(rng.randint(1, len(cells.rows)), blank)


HARMLESS: tuple[Callable[[Cells, random.Random], None], ...] = (
    *(_mark, _blanks, _quoted_cell, _quoted_note, _blank_line, _line_ends, _old_mac),
)


def harmless_recording(rng: random.Random) -> bytes:
    """Return a recording written in an unusual way that says the same."""
    cells = table(rng)
    rng.choice(HARMLESS)(cells, rng)
    return cells.encoded()


def mutated_recording(rng: random.Random) -> bytes:
    """Return a recording after one to three mishaps."""
    cells = table(rng)
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        mutation = rng.choice((*CELL_MUTATIONS, *HARMLESS))
        if min(len(row) for row in cells.rows) and len(cells.ends) in (0, len(cells.rows)):
            mutation(cells, rng)
        if len(cells.ends) != len(cells.rows):
            cells.ends = []
    data = cells.encoded()
    return mutated_bytes(data, rng) if rng.random() < 0.3 else data


def cut_recording(rng: random.Random) -> tuple[bytes, bytes]:
    """Return a recording, and what is left of it after its end was lost."""
    data = table(rng).encoded()
    return data, data[: rng.randrange(data.index(b"\n"), len(data))]
