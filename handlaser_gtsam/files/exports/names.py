"""Names of beams in other languages: identifiers, comments and literals that no name breaks out of.

A beam may have any printable name. Each format gets an identifier made of it; the name itself stands in
a comment beside it, where every character that could end a comment is replaced by its code point.
"""

import re
from collections.abc import Sequence

from ...data.recording import first_repeated
from ...errors import InputError

LONGEST_IDENTIFIER = 24
"""What KUKA's KRL takes, the shortest of the formats; a beam has one identifier in all of them."""
PREFIX = "laser"
"""Begins every identifier: none begins with a digit, and none is a word of a language."""
HARMLESS = re.compile(r"[A-Za-z0-9 _.+-]")
"""Characters of a name that mean nothing in a comment of any format."""


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
        raise InputError(
            f"beams whose names make the same identifier {found[twice]}",
            "names that differ by letters or digits",
        )
    return tuple(found)


def _identifier(name: str) -> str:
    spelt = "".join(
        c.lower() if c.isascii() and c.isalnum() else f"u{ord(c):04x}" if c.isalnum() else "_"
        for c in name
    )
    spelt = re.sub("_+", "_", spelt).strip("_")
    return spelt if re.match(rf"{PREFIX}([^a-z]|$)", spelt) else f"{PREFIX}_{spelt}".rstrip("_")


def comment_text(name: str) -> str:
    """Return a name as it stands in a comment: ASCII, and nothing that could end the comment."""
    spelt = "".join(c if HARMLESS.fullmatch(c) else f"[U+{ord(c):04X}]" for c in name)
    return spelt.replace("--", "-[U+002D]")


def literal(text: str) -> str:
    """Return printable text as a literal in double quotes, ASCII, as Python and YAML read it."""
    return '"' + "".join(_spelt(c) for c in text) + '"'


def _spelt(c: str) -> str:
    if c in '"\\':
        return "\\" + c
    if " " <= c <= "~":
        return c
    return f"\\u{ord(c):04x}" if ord(c) <= 0xFFFF else f"\\U{ord(c):08x}"
