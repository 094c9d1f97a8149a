"""Texts from the templates of this folder, one a format, and how these write numbers and names."""

import shlex
import textwrap
from collections.abc import Iterable
from xml.sax.saxutils import quoteattr

from ...quantities import IN_DEG, IN_MM
from .names import literal

REMARK = 30
"""Characters of a remark in a FANUC program; the name of a station has two thirds of them."""


def number(value: float) -> str:
    """Return a number with all its digits, and a point, which YAML and structured text want."""
    text = repr(float(value) + 0.0)
    return text.replace("e", ".0e") if "e" in text and "." not in text else text


def fixed(value: float, digits: int = 9) -> str:
    """Return a number with a fixed number of decimals, never "-0"."""
    return f"{round(value, digits) + 0.0:.{digits}f}"


def rendered(template: str, **values: object) -> str:
    """Return the text of a template."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=PackageLoader(__package__),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        autoescape=False,
    )
    environment.filters |= {
        "number": number,
        "numbers": lambda values, between: between.join(map(number, values)),
        "mm": lambda values: [fixed(value * IN_MM) for value in values],
        "deg": lambda values: [fixed(value * IN_DEG) for value in values],
        "unit": lambda values: [fixed(value, 12) for value in values],
        "literal": literal,
        "shell": shlex.quote,
        "attribute": quoteattr,
        "remarks": lambda text: "\n".join(f"!{line}" for line in textwrap.wrap(text, REMARK)),
        "steps": _steps,
    }
    return environment.get_template(f"{template}.j2").render(**values)


def _steps(text: str) -> str:
    """Return the lines of a FANUC program, numbered."""
    lines: Iterable[tuple[int, str]] = enumerate(text.strip("\n").splitlines(), 1)
    return "".join(f"{at:4d}:  {line} ;\n" for at, line in lines)
