"""What stands in the files at one moment: whole lines only, whoever is writing to them meanwhile."""

import stat
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from ...errors import InputError
from ..logs.report import LogReport
from ..logs.tables import BOOKS
from ..rig_reading import read_with
from ..rig_toml import Rig

LARGEST_FILE = 200_000_000
"""Bytes of a followed file at most: a larger one is no recording, or nothing for a page."""


@dataclass(frozen=True, slots=True)
class FileContent:
    """A file at one moment.

    Attributes
    ----------
    path : Path
    lines : bytes
        The lines that have a line end; all of a file that has no lines.
    rest : bytes
        What stands after them: a line that may not be whole yet.
    """

    path: Path
    lines: bytes
    rest: bytes

    def rows(self, rest: bytes = b"") -> int:
        """Return how many lines are not blank, with or without the rest after them."""
        return sum(1 for line in (self.lines + rest).splitlines() if line.strip())

    @property
    def last_line(self) -> int:
        """The number of the line that may not be whole."""
        return len(self.lines.splitlines()) + 1


def file_content(path: Path) -> FileContent:
    """Return what stands in the recording or log, or in a file beside it, at this moment.

    Raises
    ------
    InputError
        No readable file.
    """
    data = content(path, "a recording or a log")
    if path.suffix.lower() in BOOKS:
        return FileContent(path, data, b"")
    cut = data.rfind(b"\n" if b"\n" in data else b"\r") + 1
    return FileContent(path, data[:cut], data[cut:])


def read_contents(
    parts: Sequence[FileContent], rests: Sequence[bytes], rig: Rig
) -> tuple[LogReport, Rig]:
    """Read what the lines of the files hold, and rests after them; faults name the files themselves.

    Parameters
    ----------
    parts : sequence of FileContent
        The recording or log, and the files beside it that its format names.
    rests : sequence of bytes
    rig : Rig

    Raises
    ------
    InputError
        As `read_with`.
    """
    with tempfile.TemporaryDirectory(prefix="handlaser-") as folder:
        copies = {}
        for number, (part, rest) in enumerate(zip(parts, rests, strict=True)):
            copy = Path(folder) / str(number) / part.path.name
            copy.parent.mkdir()
            copy.write_bytes(part.lines + rest)
            copies[copy] = part.path
        there = {original: copy for copy, original in copies.items()}
        log = replace(
            rig.log,
            readings=there.get(rig.log.readings),  # type: ignore[arg-type]  # None is none
            plane_file=there.get(rig.log.plane_file),  # type: ignore[arg-type]
        )
        try:
            return read_with(replace(rig, log=log), next(iter(copies)))
        except InputError as error:
            place = None if error.path is None else copies.get(error.path, error.path)
            found = InputError(error.found, error.expected, place, error.line, error.column)
            raise found from error


def content(path: Path, expected: str) -> bytes:
    """Return the bytes of a regular file of bounded size.

    Raises
    ------
    InputError
        There is none.
    """
    try:
        found = path.stat()
        if not stat.S_ISREG(found.st_mode):
            raise InputError("no regular file there", expected, path)
        if found.st_size > LARGEST_FILE:
            raise InputError(f"{found.st_size} bytes", f"at most {LARGEST_FILE}", path)
        return path.read_bytes()
    except OSError as error:
        raise InputError(f"no readable file ({error.strerror})", expected, path) from error
