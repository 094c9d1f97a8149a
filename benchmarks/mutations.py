"""Files as they should be, and what befalls files: cuts, quotes, separators, encodings, numbers.

Everything is drawn from one `random.Random`, so that a seed is a file. Mutations of a table work on its
cells or on its bytes; those of TOML and JSON on the text. Those in `HARMLESS` do not change what a file
says: a reader that refuses their result is wrong.
"""

import json
import math
import random
import re
from collections.abc import Callable
from dataclasses import dataclass, field

POSE = ["x", "y", "z", "qx", "qy", "qz", "qw"]
NUMBERS = (
    *(
        "1e308",
        "-1e308",
        "1e999",
        "-1e999",
        "1e-400",
        "4.9e-324",
        "1e300",
        "1000001",
        "0",
        "-0.0",
        "-1",
    ),
    *(
        "nan",
        "NaN",
        "inf",
        "-inf",
        "Infinity",
        "NA",
        "NULL",
        "none",
        "True",
        "0x1p-3",
        "0x10",
        "1_000",
    ),
    *(
        "0,123",
        "1,234.5",
        "1 234",
        "1'234",
        "\u0661.\u0662",
        "\uff11.5",
        "\u00bd",
        "1.2.3",
        "--1",
        "1e",
    ),
    *(
        "1e+",
        "e5",
        ".",
        "+",
        ".5",
        "5.",
        "+.5",
        "1E-3",
        "1d-3",
        "0.1f",
        "12:30",
        "999",
        "65.535",
        "",
    ),
    *(
        "0." + "1" * 400,
        "1" * 400,
        "0." + "0" * 400 + "1",
        " 0.2 ",
        "\u00a00.2",
        "0.2\u200b",
        "\ufeff0.2",
    ),
    *("=1+1", "'0.2", "0.2m", "$0.2", "20%"),
)
"""What may stand where a number should."""
TEXTS = (
    *(
        "A",
        "B",
        "wall",
        "",
        " ",
        "\x1b[31mA",
        "\u202eA",
        "A\u2066",
        "A\u00a0",
        "\u3000A",
        "A" * 201,
    ),
    *(
        "A" * 20_000,
        "\u0000",
        "\x07",
        "\x85",
        "\u2028",
        "\x0b",
        "\x0c",
        "\x1c",
        "\x7f",
        "\ufeff",
        "\ud7ff",
    ),
    *(
        '5"',
        '"',
        '""',
        '"""',
        "a;b",
        "a,b",
        "a\tb",
        "#",
        "//",
        "\\",
        "\U0001f600",
        "e\u0301",
        "\u0410",
    ),
)
"""What may stand where a label should."""
BYTES = (
    *(
        b"\xff",
        b"\xfe\xff",
        b"\xc3",
        b"\xed\xa0\x80",
        b"\xc0\xaf",
        b"\xf5",
        b"\x80",
        b"\x00",
        b"\x1b[2J",
    ),
    *(
        b"\r",
        b"\n",
        b"\r\n",
        b"\n\n",
        b"\xef\xbb\xbf",
        b'"',
        b'""',
        b",",
        b";",
        b"\t",
        b" ",
        b"\x1a",
        b"\x0c",
    ),
    *(
        b"\xe2\x80\xa8",
        b"\xc2\x85",
        b"0",
        b"9",
        b"-",
        b".",
        b"e",
        b"_",
        b"'",
        b"[",
        b"{",
        b"}",
        b"]",
        b":",
    ),
)


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


def mutated_bytes(data: bytes, rng: random.Random) -> bytes:
    """Return the bytes after a cut, an insertion, a deletion, a swap or another encoding."""
    first, second = sorted(rng.randint(0, len(data)) for _ in range(2))
    kind = rng.randrange(6)
    if kind == 0:
        return data[:first]
    if kind == 1:
        return data[:first] + data[min(second, first + 20) :]
    if kind == 2:
        return data[:first] + data[first : first + 1] * 2 + data[first + 1 :]
    if kind == 3:
        other = rng.choice(("utf-16", "utf-16-le", "utf-32", "cp500", "latin-1"))
        return data.decode("utf-8", "replace").encode(other, "replace")
    return data[:first] + rng.choice(BYTES) + data[first + rng.randint(0, 1) :]


def rig_text(rng: random.Random) -> str:
    """Return a rig file."""
    lines = ["[noise]", f"range_sigma_mm = {rng.uniform(0.001, 1.0):.4g}"]
    if rng.random() < 0.7:
        lines.append(f"pose_translation_sigma_mm = {rng.uniform(0.0, 1.0):.4g}")
        lines.append(f"pose_rotation_sigma_deg = {rng.uniform(0.0, 1.0):.4g}")
    else:
        lines.append(f"pose_covariance = {_covariance(6, 1e-4, rng)}")
    lines += ["incidence_sigma_mm = 0.01", "pose_translation_prior_mm = 0.1", "[sensor]"]
    lines += [f"range_mm = [0, {rng.randint(1, 900)}]", "max_incidence_deg = 45"]
    lines += ["linearity_percent = 1.0", "[limits]", "rms_mm = 0.05", "direction_sigma_deg = 0.5"]
    return "\n".join(lines) + "\n"


def result_text(rng: random.Random) -> str:
    """Return the part of a result that says where the beams are, and some of the rest."""
    count = rng.randint(1, 3)
    beams = []
    for i in range(count):
        a, b = rng.uniform(-0.3, 0.3), rng.uniform(-0.3, 0.3)
        c = math.sqrt(1.0 - a * a - b * b)
        mount = {"name": f"{i + 1}", "location_m": [rng.uniform(-0.1, 0.1) for _ in range(3)]}
        k = {"k1": rng.uniform(-0.01, 0.01), "k2_per_m": rng.uniform(-0.1, 0.1)}
        beams.append(
            {
                **mount,
                "direction": [a, b, c],
                "range_error": k,
                "range_error_terms": 2,
                "sigma": None,
            }
        )
    record = {
        "format": "handlaser-calibration",
        "version": 1,
        "status": "converged",
        "message": "",
        "warnings": [],
        "beams": beams,
        "beam_covariance": _covariance(8 * count, 1e-5, rng),
        "fit": {"range_sigma_m": 3e-5, "pose_covariance": _covariance(6, 1e-4, rng), "dof": 9},
    }
    return json.dumps(record, indent=rng.choice((None, 2)))


def _covariance(size: int, sigma: float, rng: random.Random) -> list[list[float]]:
    root = [[rng.gauss(0.0, sigma) for _ in range(size)] for _ in range(size)]
    return [[sum(a * b for a, b in zip(p, q, strict=True)) for q in root] for p in root]


VALUES = (
    *(
        "NaN",
        "Infinity",
        "-Infinity",
        "nan",
        "inf",
        "-inf",
        "1e308",
        "-1e308",
        "1e999",
        "1e300",
        "0",
        "-1",
    ),
    *(
        "1" * 5000,
        "1" * 400,
        "true",
        "false",
        "null",
        '"0.1"',
        "'0.1'",
        "[]",
        "{}",
        "[0.1]",
        "[[0.1]]",
        "1e-320",
    ),
    *(
        '"converged"',
        '"\\u001b[31m"',
        '"\\u202e1"',
        '" 1"',
        '""',
        '"\\ud800"',
        f'"{"1" * 201}"',
        "0x10",
        "1_0",
    ),
    *(
        "0.1,",
        "0,1",
        "-",
        "[" * 3000,
        "[" * 100_000,
        '{"a":' * 3000,
        "1979-05-27",
        "+0.1",
        ".1",
        "1.",
    ),
)
TOKEN = re.compile(r'-?\d+\.?\d*(?:e[+-]?\d+)?|"[^"\n]*"|true|false|null')
SCALAR = re.compile(rf"(?<=[:=] )(?:{TOKEN.pattern})")
"""A token that is the whole value of a field: the others stand in lists, of which covariances have many."""
FIELD = re.compile(r'"[a-z_0-9]+":|^[a-z_]+(?= =)|\[[a-z]+\]$', re.MULTILINE)


def mutated_text(text: str, rng: random.Random) -> bytes:
    """Return TOML or JSON after one to three mishaps: values, fields twice or gone, nesting, bytes."""
    for _ in range(rng.choice((1, 1, 2, 3))):
        kind = rng.randrange(8)
        token = rng.choice(list(rng.choice((TOKEN, SCALAR)).finditer(text)) or [None])
        name = rng.choice(list(FIELD.finditer(text)) or [None])
        if kind <= 2 and token is not None:
            text = text[: token.start()] + rng.choice(VALUES) + text[token.end() :]
        elif kind == 3 and token is not None:
            other = rng.choice(list(TOKEN.finditer(text)))
            text = text[: token.start()] + other[0] + text[token.end() :]
        elif kind == 6 and token is not None and token[0][-1:].isdigit():
            text = text[: token.start()] + _other_number(token[0], rng) + text[token.end() :]
        elif kind == 7 and name is not None and name[0].startswith('"'):
            extra = f'"extra": {rng.choice(VALUES)}, '
            text = text[: name.start()] + extra + text[name.start() :]
        elif kind == 4 and name is not None:
            text = text[: name.start()] + _field_again(name[0], rng) + text[name.start() :]
        elif kind == 5 and name is not None:
            text = text[: name.start()] + rng.choice(('"a\\u001bb":', "b", "")) + text[name.end() :]
    data = text.encode("utf-8", "surrogatepass")
    return mutated_bytes(data, rng) if rng.random() < 0.3 else data


def _other_number(number: str, rng: random.Random) -> str:
    """Return a number of nearly the same size, as another program writes it."""
    value = float(number) * rng.choice((1.0, 1.0, 1.0 + 1e-13, 1.5, -1.0))
    return rng.choice((f"{value!r}", f"{value:.3g}", f"{value:.20e}", f"{value:+.6f}"))


def _field_again(name: str, rng: random.Random) -> str:
    """Return a field that stands before its equal, with another value."""
    value = rng.choice(("1", "0.5", "null", '"x"', "[]"))
    if name.startswith('"'):
        return f"{name} {value}, "
    return f"{name}\n" if name.startswith("[") else f"{name} = {value}\n"
