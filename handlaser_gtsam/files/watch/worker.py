"""The process that reads and calibrates: the server answers meanwhile, whatever becomes of it."""

import contextlib
import os
import signal
import threading
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from multiprocessing import connection, parent_process
from multiprocessing.connection import Connection
from pathlib import Path

from ...errors import HandlaserError, InputError
from ...pipeline import calibrate
from ...text import printable
from ..logs.report import LogReport
from ..report.options import ReportOptions
from ..report.subject import subject_of
from ..rig_toml import Rig, known_rig
from .messages import messages_of
from .snapshot import Snapshot, content, snapshot
from .watched import Watched


@dataclass(frozen=True, slots=True)
class FileAnswer:
    """What became of the files.

    Attributes
    ----------
    messages : mapping of str to str
        What is shown of a calibration; empty where nothing was calibrated, or nothing else than
        before.
    error : str
        Why there is no calibration of what stands in the files: one line, or empty.
    note : str
        What is to be known beside: one line, or empty.
    waiting : bool
        Whether there is no station yet.
    beside : tuple of Path
        Files that count beside the recording and the rig file.
    """

    messages: Mapping[str, str] = field(default_factory=dict)
    error: str = ""
    note: str = ""
    waiting: bool = False
    beside: tuple[Path, ...] = ()


class Calibrator:
    """Calibrates what stands in the files, and remembers the last of it."""

    def __init__(self, watched: Watched) -> None:
        self._watched = watched
        self._last: tuple[str, bytes, tuple[bytes, ...]] | None = None
        self._answer = FileAnswer()

    def answer(self, settled: bool) -> FileAnswer:
        """Calibrate.

        Parameters
        ----------
        settled : bool
            Whether the files have rested for a while, so that a last line without a line end is all
            that will come of it.
        """
        try:
            rig, mark = self._rig()
        except InputError as error:
            self._last = None
            return FileAnswer(error=str(error))
        beside = tuple(path for path in rig.log.files if path is not None)
        return replace(self._of_files(rig, mark, beside, settled), beside=beside)

    def _rig(self) -> tuple[Rig, bytes]:
        """Return what is known of sensors and logs, and what is another thing once it changes."""
        path, watched = self._watched.rig, self._watched
        if path is not None and not watched.rig_needed and not os.path.lexists(path):
            path = None
        mark = b"" if path is None else content(path, "a rig file, TOML")
        return known_rig(path, watched.given), mark

    def _of_files(
        self, rig: Rig, mark: bytes, beside: tuple[Path, ...], settled: bool
    ) -> FileAnswer:
        paths = (self._watched.recording, *beside)
        try:
            found = snapshot(paths)
        except InputError as error:
            self._last = None
            missing = isinstance(error.__cause__, FileNotFoundError)
            if missing and error.path in paths:
                name = printable(error.path.name)
                return FileAnswer(note=f"waiting for {name}, which is not there", waiting=True)
            return FileAnswer(error=str(error))
        rests = found.rests if settled else tuple(b"" for _ in found.parts)
        last = (found.digest, mark, rests)
        if last != self._last:
            self._answer, self._last = self._calibrated(found, rests, rig), last
            return _noted(self._answer, found, settled)
        return _noted(replace(self._answer, messages={}), found, settled)

    def _calibrated(self, found: Snapshot, rests: tuple[bytes, ...], rig: Rig) -> FileAnswer:
        heads = 0 if rig.log.header_given else 1
        first, rest = found.parts[0], rests[0]
        if first.rows(rest) <= heads:
            return FileAnswer(note="waiting for the first station", waiting=True)
        try:
            try:
                (report, rig), note = found.read(rig, rests), ""
            except InputError as error:
                whole = tuple(b"" for _ in rests)
                if not any(rest.strip() for rest in rests) or first.rows() <= heads:
                    raise
                (report, rig), note = found.read(rig, whole), f"not used: {error}"
            return FileAnswer(self._messages(report, rig), note=note)
        except HandlaserError as error:
            return FileAnswer(error=printable(str(error)))
        except Exception as error:  # the page goes on with the next station
            words = " ".join(str(error).split())[:200]
            fault = f"a fault of handlaser, please report it: {type(error).__name__}: {words}"
            return FileAnswer(error=printable(fault))

    def _messages(self, report: LogReport, rig: Rig) -> Mapping[str, str]:
        options = replace(self._watched.options, sensor=rig.sensor)
        calibration = calibrate(report.recording, rig.noise, options)
        subject = subject_of(calibration, ReportOptions(rig, self._watched.reading))
        return messages_of(subject)


def _noted(answer: FileAnswer, found: Snapshot, settled: bool) -> FileAnswer:
    """Return an answer that says which line is not whole yet."""
    for part in found.parts:
        if part.rest.strip() and not settled and not answer.error:
            return replace(answer, note=f"line {part.last_line} is not whole yet")
    return answer


def work(asked: "Connection[FileAnswer, bool]", watched: Watched) -> None:
    """FileAnswer whoever asks, until nobody does."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent ends this process
    os.nice(5)  # the process that moves the robot and records comes first
    threading.Thread(target=_end_with_parent, daemon=True).start()
    calibrator = Calibrator(watched)
    with contextlib.suppress(EOFError, BrokenPipeError, ConnectionResetError):
        while True:
            asked.send(calibrator.answer(asked.recv()))


def _end_with_parent() -> None:
    parent = parent_process()
    if parent is not None:
        connection.wait([parent.sentinel])
        os._exit(0)
