"""What stands in the files at one moment: whole lines only, whoever is writing to them meanwhile."""

import hashlib
import os
import stat
import tempfile
from dataclasses import dataclass
from pathlib import Path

from ...data.recording import Recording
from ...errors import InputError
from ...model.sensor import Sensor
from ..recording_csv import read_recording
from .watched import Watched

MOST_BYTES = 200_000_000
"""A recording that is larger is none, or nothing for a page."""


@dataclass(frozen=True, slots=True)
class Snapshot:
    """The files at one moment.

    Attributes
    ----------
    lines : bytes
        The lines of the recording that have a line end.
    rest : bytes
        What stands after them: a line that may not be whole yet.
    rig : Path or None
        The rig file, if there is one.
    digest : str
        Of the two files, `rest` left out.
    """

    lines: bytes
    rest: bytes
    rig: Path | None
    digest: str

    def has_stations(self, rest: bytes = b"") -> bool:
        """Tell whether anything follows the header, in the whole lines or in the rest after them."""
        return sum(1 for line in (self.lines + rest).splitlines() if line.strip()) > 1

    @property
    def last_line(self) -> int:
        """The number of the line that may not be whole."""
        return len(self.lines.splitlines()) + 1


def snapshot(watched: Watched) -> Snapshot:
    """Read the files.

    Raises
    ------
    InputError
        No readable file.
    """
    data = _content(watched.recording, "a recording")
    end = b"\n" if b"\n" in data else b"\r"
    cut = data.rfind(end) + 1
    rig, content = watched.rig, b""
    if rig is not None and not watched.rig_needed and not os.path.lexists(rig):
        rig = None
    if rig is not None:
        content = _content(rig, "a rig file, TOML")
    digest = hashlib.sha256(hashlib.sha256(data[:cut]).digest())
    digest.update(b"" if rig is None else hashlib.sha256(content).digest())
    return Snapshot(data[:cut], data[cut:], rig, digest.hexdigest())


def recording_in(data: bytes, path: Path, sensor: Sensor) -> Recording:
    """Read a recording out of the content of a file; faults name its `path`.

    Raises
    ------
    InputError
        As `read_recording`.
    """
    handle, name = tempfile.mkstemp(prefix="handlaser-", suffix=".csv")
    copy = Path(name)
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(data)
        return read_recording(copy, sensor)
    except InputError as error:
        place = path if error.path == copy else error.path
        raise InputError(error.found, error.expected, place, error.line, error.column) from error
    finally:
        copy.unlink(missing_ok=True)


def _content(path: Path, expected: str) -> bytes:
    """Return the bytes of a regular file of bounded size."""
    try:
        found = path.stat()
        if not stat.S_ISREG(found.st_mode):
            raise InputError("no regular file there", expected, path)
        if found.st_size > MOST_BYTES:
            raise InputError(f"{found.st_size} bytes", f"at most {MOST_BYTES}", path)
        return path.read_bytes()
    except OSError as error:
        raise InputError(f"no readable file ({error.strerror})", expected, path) from error
