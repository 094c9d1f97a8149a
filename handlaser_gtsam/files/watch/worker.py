"""The process that reads and calibrates: the server answers meanwhile, whatever becomes of it."""

import contextlib
import os
import signal
import threading
from dataclasses import dataclass, replace
from multiprocessing import connection, parent_process
from multiprocessing.connection import Connection

from ...data.recording import Recording
from ...errors import HandlaserError, InputError
from ...pipeline import calibrate
from ...text import printable
from ..report.options import ReportOptions
from ..report.subject import subject_of
from ..rig_toml import Rig, known_rig
from .snapshot import Snapshot, recording_in, snapshot
from .state import state_text
from .watched import Watched

GIVING_WAY = 5
"""Added to the niceness: whoever moves the robot and records comes first."""


@dataclass(frozen=True, slots=True)
class Answer:
    """What became of the files.

    Attributes
    ----------
    state : str
        What is shown of a calibration, JSON; empty where nothing was calibrated, or nothing else than
        before.
    error : str
        Why there is no calibration of what stands in the files: one line, or empty.
    note : str
        What is to be known beside: one line, or empty.
    waiting : bool
        Whether there is no station yet.
    """

    state: str = ""
    error: str = ""
    note: str = ""
    waiting: bool = False


class Calibrator:
    """Calibrates what stands in the files, and remembers the last of it."""

    def __init__(self, watched: Watched) -> None:
        self._watched = watched
        self._last: tuple[str, bytes] | None = None
        self._answer = Answer()

    def answer(self, settled: bool) -> Answer:
        """Calibrate.

        Parameters
        ----------
        settled : bool
            Whether the files have rested for a while, so that a last line without a line end is all
            that will come of it.
        """
        name = self._watched.recording.name
        try:
            found = snapshot(self._watched)
        except InputError as error:
            self._last = None
            missing = isinstance(error.__cause__, FileNotFoundError)
            if missing and error.path == self._watched.recording:
                return Answer(
                    note=f"waiting for {printable(name)}, which is not there", waiting=True
                )
            return Answer(error=str(error))
        rest = found.rest if settled else b""
        if (found.digest, rest) != self._last:
            self._answer = self._calibrated(found, rest)
            self._last = (found.digest, rest)
            return self._noted(self._answer, found, settled)
        return self._noted(replace(self._answer, state=""), found, settled)

    def _noted(self, answer: Answer, found: Snapshot, settled: bool) -> Answer:
        if found.rest.strip() and not settled and not answer.error:
            return replace(answer, note=f"line {found.last_line} is not whole yet")
        return answer

    def _calibrated(self, found: Snapshot, rest: bytes) -> Answer:
        if not found.has_stations(rest):
            return Answer(note="waiting for the first station", waiting=True)
        try:
            rig = known_rig(found.rig, self._watched.given)
            recording, note = self._recording(found, rest, rig)
            return Answer(self._state(recording, rig), note=note)
        except HandlaserError as error:
            return Answer(error=printable(str(error)))
        except Exception as error:  # the page goes on with the next station
            words = " ".join(str(error).split())[:200]
            fault = f"a fault of handlaser, please report it: {type(error).__name__}: {words}"
            return Answer(error=printable(fault))

    def _recording(self, found: Snapshot, rest: bytes, rig: Rig) -> tuple[Recording, str]:
        """Return the recording, and what is to be known of its last line."""
        path, sensor = self._watched.recording, rig.sensor
        if rest.strip():
            try:
                return recording_in(found.lines + rest, path, sensor), ""
            except InputError as error:
                if not found.has_stations():
                    raise
                whole, note = recording_in(found.lines, path, sensor), f"not used: {error}"
                return whole, note
        return recording_in(found.lines, path, sensor), ""

    def _state(self, recording: Recording, rig: Rig) -> str:
        options = replace(self._watched.options, sensor=rig.sensor)
        calibration = calibrate(recording, rig.noise, options)
        return state_text(subject_of(calibration, ReportOptions(rig, self._watched.reading)))


def work(asked: "Connection[Answer, bool]", watched: Watched) -> None:
    """Answer whoever asks, until nobody does."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent ends this process
    os.nice(GIVING_WAY)
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
