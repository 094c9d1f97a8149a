"""How wide the screen is."""

import shutil

NARROWEST = 40
"""Columns below which nothing gets any narrower: tables are unreadable there."""
NO_SCREEN = 1000
"""Columns of what is no screen, a pipe or a file: no table is wider."""


def columns() -> int:
    """Return the columns of the terminal or of COLUMNS; `NO_SCREEN` where there is neither."""
    return max(shutil.get_terminal_size((NO_SCREEN, 24)).columns, NARROWEST)


def text_width() -> int:
    """Return the columns of text: as many as the screen has, but at most `WIDTH`."""
    from ..results.lines import WIDTH  # loads NumPy, which the help does without

    return min(columns(), WIDTH)
