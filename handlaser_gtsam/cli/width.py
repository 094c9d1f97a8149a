"""How wide the screen is."""

import shutil

LEAST = 40
"""Columns below which nothing gets any narrower."""
ENDLESS = 1000
"""Columns of what is no screen: a pipe or a file."""


def columns() -> int:
    """Return the columns of the terminal, or COLUMNS where that is set; `ENDLESS` where neither is."""
    return max(shutil.get_terminal_size((ENDLESS, 24)).columns, LEAST)


def text_width() -> int:
    """Return the columns of text: as many as the screen has, but at most `WIDTH`."""
    from ..results.lines import WIDTH  # loads NumPy, which the help does without

    return min(columns(), WIDTH)
