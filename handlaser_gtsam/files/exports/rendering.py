"""Texts from the templates of this folder, one a format, and how these write numbers and names."""

import shlex
import textwrap
from collections.abc import Iterable
from typing import TYPE_CHECKING
from xml.sax.saxutils import quoteattr

from ... import __version__
from ...quantities import IN_DEG, IN_MM
from .names import literal

if TYPE_CHECKING:
    from jinja2 import Environment

REMARK = 30
"""Characters of a remark in a FANUC program; the name of a station has two thirds of them."""
ABOUT = (
    f"Laser beams calibrated by handlaser {__version__}, in the hand frame: "
    "the frame that the recorded poses describe."
)
ROLL = "The roll about the beam is free; it is that of the smallest rotation from the hand frame."

ABOUT_SENSORS = (
    f"Sensors calibrated by handlaser {__version__}, in the hand frame: "
    "the frame that the recorded poses describe."
)
OWN_FRAMES = (
    "Each frame of a sensor is its own, in which its points are; x of a beam's lies along it."
)
OWN = "The roll of a beam is free; it is that of the smallest rotation from the hand frame."


def number(value: float) -> str:
    """Return a number with all its digits, and a point, which YAML and structured text want."""
    text = repr(float(value) + 0.0)
    return text.replace("e", ".0e") if "e" in text and "." not in text else text


def fixed(value: float, digits: int = 9) -> str:
    """Return a number with a fixed number of decimals, never "-0"."""
    return f"{round(value, digits) + 0.0:.{digits}f}"


def rendered(template: str, **values: object) -> str:
    """Return the text of a template."""
    return _environment().get_template(f"{template}.j2").render(**values)


def _environment() -> "Environment":
    from jinja2 import Environment, PackageLoader, StrictUndefined

    found = Environment(
        loader=PackageLoader(__package__),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        autoescape=False,
    )
    found.filters |= {
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
    return found


def _steps(text: str) -> str:
    """Return the lines of a FANUC program, numbered."""
    lines: Iterable[tuple[int, str]] = enumerate(text.strip("\n").splitlines(), 1)
    return "".join(f"{at:4d}:  {line} ;\n" for at, line in lines)
