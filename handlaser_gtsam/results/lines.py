"""Text for a screen: lines of bounded width, values with as many digits as their sigma deserves."""

import math
import textwrap

from ..data.noise import LEAST_SIGMA
from ..quantities import IN_MM

WIDTH = 100
"""Columns of the default screen, and of everything that is not printed to a terminal."""
NAMES_IN_LINE = 4
"""Names that a line lists: a fifth would rarely fit, and a long list is not read."""
NAMES_ON_PAGE = 12
"""Names that a row of a page, or a message of its own, lists: about three lines."""
UNDETERMINED = "undetermined"
"""Stands for a number that the recording does not determine."""


def small_mm(value: float) -> str:
    """Return a residual or a standard deviation [m] in millimetres; one of rounding alone is no number.

    No sensor is better than `LEAST_SIGMA`, which is ten thousand times what rounding leaves of a metre.
    """
    return "0 mm (rounding)" if value < LEAST_SIGMA else f"{value * IN_MM:.3g} mm"


def as_many(lines: int, width: int) -> int:
    """Return how many lines of `width` columns hold what `lines` of `WIDTH` columns hold.

    One more than their letters need, for what is lost at the ends of narrower lines.
    """
    return lines if width >= WIDTH else math.ceil(lines * WIDTH / width) + 1


def wrapped(text: str, most: int | None = None, width: int = WIDTH) -> list[str]:
    """Return `text` in lines of at most `width` columns, further ones indented.

    At most `most` lines, if it is given. Words, such as paths, are not broken.
    """
    return [
        line
        for part in text.splitlines()
        for line in textwrap.wrap(
            part,
            width,
            subsequent_indent="  ",
            break_long_words=False,
            break_on_hyphens=False,
            max_lines=most,
            placeholder=" ...",
        )
    ]


def decimals(sigma: float, most: int) -> int:
    """Return the decimals at which a standard deviation has two digits, from 0 to `most`."""
    if not (math.isfinite(sigma) and sigma > 0.0):
        return most
    return min(max(1 - math.floor(math.log10(sigma)), 0), most)
