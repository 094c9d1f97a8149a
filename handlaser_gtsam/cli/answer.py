"""What a verb says: a sign of life on the terminal while it computes, and then its answer.

That is tables or JSON on stdout, warnings and what went wrong on stderr. Text is no wider than the
screen.
"""

import os
import shutil
import sys
import threading
import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

import typer

from ..progress import Progress, told_to
from .stopping import CLEAR, CtrlC, Exit

NO_SCREEN = 1000
"""Columns of what is no screen, a pipe or a file: no table is wider."""
QUIET_S = 1.0
"""Seconds until the sign appears: what is done sooner needs none."""
PHASES = {
    "search": "looking for a start",
    "solve": "solving",
    "scales": "estimating the noise",
    "tests": "testing for systematic errors",
    "hold-out": "testing the calibration",
    "leave-out": "leaving out",
    "planes": "adding planes",
    "read": "reading the log",
    "report": "making the report",
    "study": "drawing and solving",
}


@dataclass(frozen=True, slots=True)
class Answer:
    """What is said once everything is computed.

    Attributes
    ----------
    json : str
        For programs.
    lines : lines
        What a person sees; they are made when they are printed.
    warnings : lines, or warnings of a result
    failure : (int, str) or None
        The exit code of the contract, and what went wrong.
    """

    json: str
    lines: Iterable[str]
    warnings: Iterable[object] = ()
    failure: tuple[int, str] | None = None

    def give(self, *, json: bool, quiet: bool = False) -> None:
        """Print, and leave with the exit code where something went wrong."""
        said = "" if self.failure is None else self.failure[1]
        for one in self.warnings:
            if str(one).rstrip(". ").removeprefix("WARNING: ") not in said:
                print(one if isinstance(one, str) else f"WARNING: {one}", file=sys.stderr)
        if json:
            sys.stdout.write(self.json)
        elif not quiet:
            from ..results.lines import wrapped

            try:
                for line in self.lines:
                    print("\n".join(wrapped(line, None, text_width())))
                sys.stdout.flush()
            except BrokenPipeError:  # as in `handlaser ... | head`: what is left goes nowhere
                os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        if self.failure is not None:
            code, words = self.failure
            if code != Exit.INTERRUPTED:  # that is said where Ctrl-C ends up
                with suppress(BrokenPipeError):  # whoever read it has gone; the exit code stays
                    print(f"handlaser: {words}", file=sys.stderr, flush=True)
            raise typer.Exit(code)


def wrote(*paths: Path | None) -> list[str]:
    """Return a line for each file that was written; None where none was asked for."""
    from ..text import printable

    return [f"wrote {printable(str(path))}" for path in paths if path is not None]


def lines_read(called: str, lines: Sequence[str]) -> list[str]:
    """Return how files were read, in one line; none where there is nothing to say."""
    from ..text import printable

    return [f"{called}: {printable('; '.join(lines))}"] if lines else []


def columns() -> int:
    """Return the columns of the terminal or of COLUMNS; `NO_SCREEN` where there is neither."""
    # Tables are unreadable in fewer than 40 columns, so that nothing gets any narrower.
    return max(shutil.get_terminal_size((NO_SCREEN, 24)).columns, 40)


def text_width() -> int:
    """Return the columns of text: as many as the screen has, but at most `WIDTH`."""
    from ..results.lines import WIDTH  # loads NumPy, which the help does without

    return min(columns(), WIDTH)


@contextmanager
def working() -> Iterator[None]:
    """Show meanwhile what is computed, in one line of stderr; only where that is a terminal.

    It listens to the progress of all that is computed in it. The line is gone at the end.
    """
    began, over, part, phase = time.monotonic(), threading.Event(), "", "starting"

    def listen(progress: Progress) -> None:
        nonlocal part, phase
        if progress.total and CtrlC.asked:  # a part was stopped: no other one begins
            raise KeyboardInterrupt
        words = PHASES.get(progress.phase, progress.phase)
        if progress.total:
            number = min(progress.done + 1, progress.total)
            part = f"{progress.name or words} ({number} of {progress.total}): "
        else:
            phase = words

    def show() -> None:
        wait = QUIET_S
        while not over.wait(wait):
            line = f"handlaser: {part}{phase}, {time.monotonic() - began:.0f} s"
            width = shutil.get_terminal_size().columns - 1
            print(CLEAR + line[:width], end="", file=sys.stderr, flush=True)
            wait = 0.2  # the seconds that it counts look steady
        if wait < QUIET_S:
            print(CLEAR, end="", file=sys.stderr, flush=True)

    on_terminal = sys.stderr is not None and sys.stderr.isatty()
    shown = threading.Thread(target=show, daemon=True)
    if on_terminal:
        shown.start()
    try:
        with told_to(listen):
            yield
    finally:
        over.set()
        if on_terminal:
            shown.join()
