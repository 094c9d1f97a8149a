"""What a verb answers: tables or JSON on stdout, warnings and what went wrong on stderr.

Text is no wider than the screen.
"""

import os
import shutil
import sys
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import typer

from .stopping import INTERRUPTED

NARROWEST = 40
"""Columns below which nothing gets any narrower: tables are unreadable there."""
NO_SCREEN = 1000
"""Columns of what is no screen, a pipe or a file: no table is wider."""


@dataclass(frozen=True, slots=True)
class Answer:
    """What is said once everything is computed.

    Attributes
    ----------
    json : str
        For programs.
    show : callable
        Prints what a person sees.
    warnings : lines
    failure : (int, str) or None
        The exit code of the contract, and what went wrong.
    """

    json: str
    show: Callable[[], None]
    warnings: Iterable[str] = ()
    failure: tuple[int, str] | None = None

    def give(self, *, json: bool, quiet: bool = False) -> None:
        """Print, and leave with the exit code where something went wrong."""
        for line in self.warnings:
            print(line, file=sys.stderr)
        if json:
            sys.stdout.write(self.json)
        elif not quiet:
            self.show()
        if self.failure is not None:
            code, words = self.failure
            if code != INTERRUPTED:  # that is said where Ctrl-C ends up
                with suppress(BrokenPipeError):  # whoever read it has gone; the exit code stays
                    print(f"handlaser: {words}", file=sys.stderr, flush=True)
            raise typer.Exit(code)


def print_wrapped(lines: Iterable[str]) -> None:
    """Print lines no wider than the screen, and than `WIDTH`; nothing once their reader has gone."""
    from ..results.lines import wrapped

    try:
        for line in lines:
            print("\n".join(wrapped(line, None, text_width())))
        sys.stdout.flush()
    except BrokenPipeError:  # as in `handlaser ... | head`: what is left goes nowhere
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def wrote(*paths: Path | None) -> list[str]:
    """Return a line for each file that was written; None where none was asked for."""
    from ..text import printable

    return [f"wrote {printable(str(path))}" for path in paths if path is not None]


def columns() -> int:
    """Return the columns of the terminal or of COLUMNS; `NO_SCREEN` where there is neither."""
    return max(shutil.get_terminal_size((NO_SCREEN, 24)).columns, NARROWEST)


def text_width() -> int:
    """Return the columns of text: as many as the screen has, but at most `WIDTH`."""
    from ..results.lines import WIDTH  # loads NumPy, which the help does without

    return min(columns(), WIDTH)
