"""Texts from templates, in `templates/`, and how these write numbers and names.

A beam may have any printable name. Each format gets an identifier made of it; the name itself stands in
a comment beside it, where every character that could end a comment is replaced by its code point.
"""

import re
import shlex
import textwrap
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING
from xml.sax.saxutils import quoteattr

from ...data.recording import first_repeated
from ...errors import InputError
from ...quantities import IN_DEG, IN_MM

if TYPE_CHECKING:
    from jinja2 import Environment

REMARK = 30
"""Characters of a remark in a FANUC program; the name of a station has two thirds of them."""
LONGEST_IDENTIFIER = 24
"""What KUKA's KRL takes, the shortest of the formats; a beam has one identifier in all of them."""
PREFIX = "laser"
"""Begins every identifier: none begins with a digit, and none is a word of a language."""
HARMLESS = re.compile(r"[A-Za-z0-9 _.+-]")
"""Characters of a name that mean nothing in a comment of any format."""


def number(value: float) -> str:
    """Return a number with all its digits, and a point, which YAML and structured text want."""
    text = repr(float(value) + 0.0)
    return text.replace("e", ".0e") if "e" in text and "." not in text else text


def fixed(value: float, digits: int = 9) -> str:
    """Return a number with a fixed number of decimals, never "-0"."""
    return f"{round(value, digits) + 0.0:.{digits}f}"


def environment(
    package: str, folder: str = "templates", *, html: bool = False, **filters: Callable[..., object]
) -> "Environment":
    """Return the templates in a folder of a package, which may use some filters; no name is missing.

    Of HTML all text is escaped, and the end of the last line is no part of a template.
    """
    from jinja2 import Environment, PackageLoader, StrictUndefined

    found = Environment(
        loader=PackageLoader(package, folder),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=not html,
        autoescape=html,
    )
    found.filters |= filters
    return found


def rendered(template: str, **values: object) -> str:
    """Return the text of a template."""
    templates = environment(
        __package__,
        number=number,
        numbers=lambda values, between: between.join(map(number, values)),
        mm=lambda values: [fixed(value * IN_MM) for value in values],
        deg=lambda values: [fixed(value * IN_DEG) for value in values],
        unit=lambda values: [fixed(value, 12) for value in values],
        literal=literal,
        shell=shlex.quote,
        attribute=quoteattr,
        remarks=lambda text: "\n".join(f"!{line}" for line in textwrap.wrap(text, REMARK)),
        # The lines of a FANUC program are numbered.
        steps=lambda text: "".join(
            f"{at:4d}:  {line} ;\n" for at, line in enumerate(text.strip("\n").splitlines(), 1)
        ),
    )
    return templates.get_template(f"{template}.j2").render(**values)


def identifiers(names: Sequence[str]) -> tuple[str, ...]:
    """Return one identifier for each name: lower-case letters, digits and underscores.

    A beam "1" is `laser_1`. A character that is no ASCII letter or digit becomes an underscore, or
    `uXXXX` by its code point if it is a letter or digit of another script. An identifier that would
    be too long, or the same as another, is cut and ends with the number of its beam.

    Raises
    ------
    InputError
        Two names whose identifiers are the same all the same.
    """
    whole = [_identifier(name) for name in names]
    found = []
    for number, one in enumerate(whole, 1):
        if len(one) > LONGEST_IDENTIFIER or whole.count(one) > 1:
            end = f"_{number}"
            one = one[: LONGEST_IDENTIFIER - len(end)].rstrip("_") + end
        found.append(one)
    twice = first_repeated(found)
    if twice is not None:
        expected = "names that differ by letters or digits"
        raise InputError(f"beams whose names make the same identifier {found[twice]}", expected)
    return tuple(found)


def _identifier(name: str) -> str:
    spelt = "".join(
        c.lower() if c.isascii() and c.isalnum() else f"u{ord(c):04x}" if c.isalnum() else "_"
        for c in name
    )
    spelt = re.sub("_+", "_", spelt).strip("_")
    return spelt if re.match(rf"{PREFIX}([^a-z]|$)", spelt) else f"{PREFIX}_{spelt}".rstrip("_")


def comment_text(name: str, colon: str = "[U+003A]") -> str:
    """Return a name as it stands in a comment: ASCII, and nothing that could end the comment.

    A `colon` becomes what the comments of a format allow for it.
    """
    spelt = "".join(c if HARMLESS.fullmatch(c) else f"[U+{ord(c):04X}]" for c in name)
    spelt = spelt.replace("[U+003A]", colon)
    return spelt.replace("--", "-[U+002D]")


def literal(text: str) -> str:
    """Return printable text as a literal in double quotes, ASCII, as Python and YAML read it."""
    quoted = text.replace("\\", r"\\").replace('"', r"\"")
    return f'"{quoted.encode("ascii", "backslashreplace").decode()}"'
