"""What is followed: the files, how they are calibrated, whether they change, and what is in them.

Only whole lines count at one moment, whoever is writing to the files meanwhile.
"""

import stat
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from ...data.survey import Survey
from ...errors import InputError
from ...estimation.options import CalibrationOptions
from ..input_reading import read_any_kind
from ..logs.bags import BAGS, METADATA
from ..logs.format import LogReport
from ..logs.tables import BOOKS
from ..rig_toml import Rig
from ..writing import RECORDING, RIG, path_of, readable

LARGEST_FILE = 200_000_000
"""Bytes of a followed file at most: a larger one is no recording, or nothing for a page."""
Fingerprint = tuple[tuple[int, ...], ...]


@dataclass(frozen=True, slots=True)
class Watched:
    """The files that are followed, and how they are calibrated.

    Attributes
    ----------
    recording : Path
        It may come, go, grow and be replaced.
    rig : Path or None
    rig_needed : bool
        Whether the rig file was asked for; one that lies in the folder may be missing.
    given : mapping
        What counts instead of fields of the rig file, as `rig_toml.known_rig` takes it.
    options : CalibrationOptions
        Their sensor comes from the rig file.
    reading : float or None
        Working distance at which laser spots are judged [m].
    """

    recording: Path
    rig: Path | None = None
    rig_needed: bool = False
    given: Mapping[str, object] = field(default_factory=dict)
    options: CalibrationOptions = field(default_factory=CalibrationOptions)
    reading: float | None = None

    def fingerprint(self, beside: tuple[Path, ...] = ()) -> Fingerprint:
        """Return what is another thing once a file was written to, replaced or taken away."""
        paths = (self.recording, self.rig, *beside)
        return tuple(_seen(path) for path in paths if path is not None)


def watched_files(path: Path | str, rig: Path | None = None) -> tuple[Path, Path | None]:
    """Return the recording and the rig file behind a folder, or behind a recording and its rig file.

    Raises
    ------
    InputError
        Neither a folder nor a file, nor the name of a file that may yet come; no such rig file.
    """
    path = path_of(path)
    try:
        if rig is not None and not rig.is_file():
            raise InputError("no such file", "a rig file, TOML", rig)
        if path.suffix.lower() in BAGS or (path / METADATA).is_file():
            expected = "a recording or a table; `handlaser convert` reads a bag once it is closed"
            raise InputError("a bag, which cannot be read while it grows", expected, path)
        if path.is_dir():
            return path / RECORDING, path / RIG if rig is None else rig
        if path.is_file():
            return path, rig
        if path.exists():
            expected = "a recording, or the folder of one"
            raise InputError("neither a file nor a folder", expected, path)
        if not path.suffix or not path.parent.is_dir():
            expected = "one of them, or the name of a file to come in a folder that exists"
            raise InputError("neither a folder nor a file", expected, path)
    except OSError as error:
        expected = "a recording, or the folder of one"
        raise InputError(f"no way to look there ({error.strerror})", expected, path) from error
    return path, rig


def _seen(path: Path) -> tuple[int, ...]:
    try:
        found = path.stat()
    except OSError as error:
        return (-(error.errno or 1),)
    where = (found.st_dev, found.st_ino, found.st_mode, found.st_size)
    return *where, found.st_ctime_ns, found.st_mtime_ns


FileContent = tuple[Path, bytes, bytes]
"""A file at one moment: its lines that have a line end, or all of a file that has no lines, and what
stands after them, which may be a line that is not whole yet."""


def file_content(path: Path) -> FileContent:
    """Return what stands in the recording or log, or in a file beside it, at this moment.

    Raises
    ------
    InputError
        No readable file.
    """
    data = content(path, "a recording or a log")
    if path.suffix.lower() in BOOKS:
        return path, data, b""
    cut = data.rfind(b"\n" if b"\n" in data else b"\r") + 1
    return path, data[:cut], data[cut:]


def read_contents(
    parts: Sequence[FileContent], rests: Sequence[bytes], rig: Rig
) -> tuple[Survey | LogReport, Rig]:
    """Read what the lines of the files hold, and rests after them; faults name the files themselves.

    Parameters
    ----------
    parts : sequence of FileContent
        The recording or log, and the files beside it: of its format, and tables of points.
    rests : sequence of bytes
    rig : Rig

    Raises
    ------
    InputError
        As `read_any_kind`.
    """
    with tempfile.TemporaryDirectory(prefix="handlaser-") as folder:
        copies = {}
        for number, ((path, lines, _), rest) in enumerate(zip(parts, rests, strict=True)):
            copy = Path(folder) / str(number) / path.name
            copy.parent.mkdir()
            copy.write_bytes(lines + rest)
            copies[copy] = path
        there = {original: copy for copy, original in copies.items()}
        log = replace(
            rig.log,
            readings=there.get(rig.log.readings),  # type: ignore[arg-type]  # None is none
            plane_file=there.get(rig.log.plane_file),  # type: ignore[arg-type]
        )
        survey = None if rig.survey is None else replace(rig.survey, copies=there)
        try:
            return read_any_kind(replace(rig, log=log, survey=survey), next(iter(copies)))
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
    with readable(path, expected):
        found = path.stat()
        if not stat.S_ISREG(found.st_mode):
            raise InputError("no regular file there", expected, path)
        if found.st_size > LARGEST_FILE:
            raise InputError(f"{found.st_size} bytes", f"at most {LARGEST_FILE}", path)
        return path.read_bytes()
