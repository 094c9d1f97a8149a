"""--log-level: what the package logs goes to stderr, a line each; without the option nothing does."""

import logging
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from enum import StrEnum
from typing import Annotated

import typer

from ..progress import LOGGER
from .stopping import CLEAR

LogLevel = StrEnum("LogLevel", "debug info warning error")
LogLevelOption = Annotated[
    LogLevel | None,
    typer.Option(help="Log to stderr: info, the stages; debug, every step of the solver, too."),
]


class _Lines(logging.Formatter):
    """Time since the beginning, level, and what is said, as one printable line.

    On a terminal, behind what takes away the sign of life that may stand in the line.
    """

    def __init__(self) -> None:
        super().__init__()
        self._began = time.time()
        self._clear = CLEAR if sys.stderr.isatty() else ""

    def format(self, record: logging.LogRecord) -> str:
        from ..text import printable

        elapsed = max(record.created - self._began, 0.0)
        line = f"{elapsed:9.3f} s {record.levelname.lower():7} {record.getMessage()}"
        return self._clear + printable(line)


@contextmanager
def logging_at(level: LogLevel | None) -> Iterator[None]:
    """Log to stderr meanwhile."""
    if level is None or sys.stderr is None:
        yield
        return
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(_Lines())
    before = LOGGER.level
    LOGGER.addHandler(handler)
    LOGGER.setLevel(level.value.upper())
    try:
        yield
    finally:
        LOGGER.removeHandler(handler)
        LOGGER.setLevel(before)
