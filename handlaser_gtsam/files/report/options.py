"""What a report states beside the calibration: limits, working distance, and where all came from."""

import hashlib
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path

from ...checks import require_kind, require_number
from ...errors import InputError
from ...planning.route import Plan
from ...quantities import LARGEST_LENGTH
from ...text import shown
from ..logs.bags import METADATA
from ..rig_toml import Rig
from ..writing import readable

BEHIND = "the file behind the calibration"


@dataclass(frozen=True, slots=True)
class ReportOptions:
    """What a report states beside the calibration.

    Attributes
    ----------
    rig : Rig
        Limits to pass, the sensor and robot in the head, and where the next stations may be.
    reading : float, optional
        Working distance at which laser spots are judged [m]; the median reading where not given.
    recording_file, rig_file : Path, optional
        The files behind the calibration: their names and SHA-256 stand in the report.
    beside : paths
        Further files of a log: its readings, or its planes; likewise.
    command : str
        The command line, or the call, that made the calibration.
    plan : Plan, optional
        The next best stations; a few are chosen where not given.

    Raises
    ------
    InputError
        A working distance that no sensor has, a command that is no text, or what is no rig or plan.
    """

    rig: Rig = field(default_factory=Rig)
    reading: float | None = None
    recording_file: Path | str | None = None
    rig_file: Path | str | None = None
    beside: tuple[Path | str, ...] = ()
    command: str = ""
    plan: Plan | None = None

    def __post_init__(self) -> None:
        require_kind("rig", self.rig, Rig)
        if self.reading is not None:
            require_number("a reading of", self.reading, -LARGEST_LENGTH, LARGEST_LENGTH, unit="m")
        if not isinstance(self.command, str):
            raise InputError(f"{shown(self.command)} as a command", "text")
        if self.plan is not None:
            require_kind("plan", self.plan, Plan)
        for name, path in self.sources:
            if not isinstance(path, (str, Path)):
                raise InputError(f"{shown(path)} as {name} file", "the name of a file")

    @property
    def sources(self) -> list[tuple[str, Path | str]]:
        """The files behind the calibration that are known, and what they are."""
        pairs = [("recording", self.recording_file)]
        pairs += [("second", path) for path in self.beside] + [("rig", self.rig_file)]
        return [(kind, path) for kind, path in pairs if path is not None]


def sha256(path: Path | str) -> str:
    """Return the SHA-256 of a file, 64 hexadecimal digits; of all files of a bag that is a folder.

    Raises
    ------
    InputError
        No readable file.
    """
    with readable(Path(path), BEHIND):
        if (Path(path) / METADATA).is_file():
            inside = sorted(one for one in Path(path).iterdir() if one.is_file())
            return hashlib.sha256("\n".join(map(sha256, inside)).encode()).hexdigest()
        with Path(path).open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()


def date_of(options: ReportOptions) -> str:
    """Return the date of the recording behind a report, UTC; empty where it has no file.

    Raises
    ------
    InputError
        No such file.
    """
    if options.recording_file is None:
        return ""
    path = Path(options.recording_file)
    with readable(path, BEHIND):
        changed = datetime.fromtimestamp(path.stat().st_mtime, UTC)
    return f"{changed.date().isoformat()} (of the recording's file)"
