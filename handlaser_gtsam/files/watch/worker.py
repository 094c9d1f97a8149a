"""The process that reads and calibrates: the server answers meanwhile, whatever becomes of it."""

import contextlib
import hashlib
import json
import os
import signal
import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from multiprocessing import connection, parent_process
from multiprocessing.connection import Connection
from pathlib import Path

from ...data.survey import Survey
from ...errors import HandlaserError, InputError
from ...estimation.options import CalibrationOptions
from ...pipeline import calibrate
from ...text import printable
from ..calibration_writing import calibration_text
from ..checked_text import decoded
from ..logs.format import LogReport
from ..logs.tables import BOOKS
from ..points_table import AWAITED
from ..report.figure import Figure
from ..report.options import ReportOptions
from ..report.page import LIVE_SECTIONS, content_of, line_of_json, safe_json
from ..report.subject import subject_of
from ..report.survey import survey_content
from ..rig_toml import Rig, known_rig
from .watched import FileContent, Watched, content, file_content, read_contents


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
        self._last: tuple[tuple[bytes, ...], bytes, tuple[bytes, ...]] | None = None
        self._answer = FileAnswer()

    def answer(self, settled: bool) -> FileAnswer:
        """Calibrate.

        Parameters
        ----------
        settled : bool
            Whether the files have rested for a while, so that a last line without a line end is all
            that will come of it.
        """
        watched, beside = self._watched, tuple[Path, ...]()
        paths: tuple[Path, ...] = (watched.recording,)
        try:
            known = watched.rig
            if known is not None and not watched.rig_needed and not os.path.lexists(known):
                known = None
            mark = b"" if known is None else content(known, "a rig file, TOML")
            rig = known_rig(known, watched.given)
            paths += tuple(path for path in rig.log.files if path is not None)
            folders, awaited = tuple[Path, ...](), tuple[Path, ...]()
            if rig.survey is not None:
                awaited, folders = rig.survey.awaited, rig.survey.folders
                paths += rig.survey.files
            beside = (*paths[1:], *folders)
            if awaited:
                note = f"waiting for {printable(awaited[0].name)}, of which there is none"
                return FileAnswer(note=note, waiting=True, beside=beside)
            parts = tuple(file_content(path) for path in paths)
        except InputError as error:
            self._last = None
            missing = isinstance(error.__cause__, FileNotFoundError)
            if missing and error.path in paths:
                note = f"waiting for {printable(error.path.name)}, which is not there"
                return FileAnswer(note=note, waiting=True, beside=beside)
            return FileAnswer(error=str(error), beside=beside)
        rests = tuple(rest if settled else b"" for *_, rest in parts)
        last = (tuple(hashlib.sha256(lines).digest() for _, lines, _ in parts), mark, rests)
        answer = replace(self._answer, messages={})
        if last != self._last:
            self._answer = answer = self._calibrated(parts, rests, rig)
            self._last = last
        answer = replace(answer, beside=beside)
        for path, lines, rest in parts:
            if rest.strip() and not settled and not answer.error:
                number = len(lines.splitlines()) + 1
                of = "" if path == paths[0] else f" of {printable(path.name)}"
                return replace(answer, note=f"line {number}{of} is not whole yet")
        return answer

    def _calibrated(
        self, parts: Sequence[FileContent], rests: tuple[bytes, ...], rig: Rig
    ) -> FileAnswer:
        heads = 0 if rig.log.header_given else 1
        path, lines, _ = parts[0]
        try:
            if _rows(lines + rests[0]) <= heads:
                if path.suffix.lower() not in BOOKS:
                    decoded(lines + rests[0], path)
                return FileAnswer(note="waiting for the first station", waiting=True)
            try:
                note = ""
                read, rig = read_contents(parts, rests, rig)
            except InputError as error:
                if not any(rest.strip() for rest in rests) or _rows(lines) <= heads:
                    raise
                read, rig = read_contents(parts, [b""] * len(parts), rig)
                note = f"not used: {error}"
            if isinstance(read, Survey):
                note = note or next((one for one in read.lines if one.startswith(AWAITED)), "")
                return FileAnswer(self._of_survey(read, rig), note=printable(note))
            return FileAnswer(self._messages(read, rig), note=note)
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
        return messages_of(subject.verdict.opening, *content_of(subject))

    def _of_survey(self, survey: Survey, rig: Rig) -> Mapping[str, str]:
        plain = CalibrationOptions(sensor=self._watched.options.sensor)
        if (self._watched.options, self._watched.reading) != (plain, None):
            stated = "options of how beams before planes are calibrated, with a survey"
            raise InputError(stated, "none of them")
        found = calibrate(survey, rig.noise)
        source, judged = self._watched.recording.name, found.judged(rig.limits)
        opening, sections, figures = survey_content(found, judged, source)
        empty = dict.fromkeys(LIVE_SECTIONS, "")
        result = safe_json(json.loads(calibration_text(found, judged)))
        return messages_of(opening, empty | sections, figures, result)


def messages_of(
    opening: str, sections: Mapping[str, str], figures: Mapping[str, Figure], result: str
) -> dict[str, str]:
    """Return messages by topic, each one line: an event's name, and after a colon what it is about.

    Sections are HTML that the templates of the report have escaped; figures escape names as plotly.js
    wants it. What has not changed is the same text, and is sent to nobody again.
    """
    found = {
        f"figure:{name}": line_of_json({"name": name, "figure": figure.json()})
        for name, figure in figures.items()
    }
    found |= {
        f"section:{name}": line_of_json({"name": name, "html": html})
        for name, html in sections.items()
    }
    found["result"] = result or "null"
    digest = hashlib.sha256("\n".join(found.values()).encode()).hexdigest()
    return found | {"state": line_of_json({"opening": opening, "digest": digest})}


def _rows(lines: bytes) -> int:
    """Return how many lines are not blank."""
    return sum(1 for line in lines.splitlines() if line.strip())


def work(asked: "Connection[FileAnswer, bool]", watched: Watched) -> None:
    """Answer whoever asks, until nobody does."""
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
