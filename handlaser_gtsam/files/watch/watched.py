"""What is followed: the files, how they are calibrated, and whether they have changed."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from ...errors import InputError
from ...estimation.options import CalibrationOptions
from ..logs.bags import BAGS, METADATA
from ..writing import path_of

RECORDING, RIG = "recording.csv", "rig.toml"
"""What is followed in a folder."""
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
