"""Follows the files: asks for a calibration of the newest content, and publishes what comes of it.

Files are looked at several times a second. That finds what a notification of the system does not, such
as changes on network drives, and costs nothing beside a calibration. While one is calibrated, changes
only add up: the next calibration is of the newest content.
"""

import contextlib
import signal
import threading
import time
from collections.abc import Callable, Mapping
from multiprocessing import connection, get_context
from pathlib import Path

from ...text import printable
from ..report.page import line_of_json
from .server import STATUS
from .watched import Fingerprint, Watched
from .worker import FileAnswer, work

LOOK_S = 0.15
"""Seconds from one look at the files to the next: a person sees the page follow at once."""
SETTLED_S = 1.2
"""Seconds after which files that have not changed are taken for whole.

They are read once more then, because a change within one tick of the file system's clock shows in no
time stamp.
"""
Publish = Callable[[Mapping[str, str]], None]


class Worker:
    """The process that calibrates, as it is seen from here."""

    def __init__(self, watched: Watched) -> None:
        context = get_context("spawn")
        self.asked, theirs = context.Pipe()
        self.process = context.Process(target=work, args=(theirs, watched), daemon=True)
        # Ctrl-C goes to all processes of a terminal; this one inherits that it does not get it.
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            self.process.start()
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
        theirs.close()

    def end(self) -> None:
        """End the process, whatever it does."""
        self.process.kill()
        self.process.join()
        self.asked.close()


class Follower:
    """Publishes messages, each one line by topic, and a `status`.

    Parameters
    ----------
    watched : Watched
    publish : callable
        Takes messages by topic.
    """

    def __init__(self, watched: Watched, publish: Publish) -> None:
        self._watched, self._publish = watched, publish
        self._over = threading.Event()
        self._worker: Worker | None = None
        self._beside: tuple[Path, ...] = ()
        self._seen: Fingerprint = ()
        self._changed = 0.0
        self._asked: tuple[Fingerprint, bool, float] | None = None
        self._answered: tuple[Fingerprint, bool] | None = None
        self._refused_since: float | None = None

    def stop(self) -> None:
        """Let `run` return."""
        self._over.set()

    def run(self) -> None:
        """Follow the files until `stop` is called."""
        self._say("reading", "reading")
        try:
            while not self._over.is_set():
                self._look()
                self._listen()
        finally:
            if self._worker is not None:
                self._worker.end()
                self._worker = None

    def _look(self) -> None:
        """Ask for a calibration if the files have changed, and once more when they have settled."""
        seen, now = self._watched.fingerprint(self._beside), time.monotonic()
        if seen != self._seen:
            self._seen, self._changed = seen, now
        if self._asked is not None:
            long = now - self._asked[2] > 0.5  # seconds: shorter words would only flicker
            if self._refused_since is None and long:
                self._say("calibrating", "calibrating")
            return
        settled = now - self._changed >= SETTLED_S
        if self._answered in ((seen, settled), (seen, True)):
            return
        self._asked = (seen, settled, now)
        if self._worker is None or not self._worker.process.is_alive():
            self._worker = Worker(self._watched)
        with contextlib.suppress(OSError):  # it has ended; `_listen` finds out how
            self._worker.asked.send(settled)

    def _listen(self) -> None:
        """Wait for an answer, or until it is time to look again."""
        worker = self._worker
        if worker is None or self._asked is None:
            self._over.wait(LOOK_S)
            return
        if not connection.wait([worker.asked, worker.process.sentinel], LOOK_S):
            return
        try:
            answer = worker.asked.recv()
        except (EOFError, OSError):
            worker.end()
            self._worker = None
            code = worker.process.exitcode or 0
            how = f"signal {-code}" if code < 0 else f"exit code {code}"
            answer = FileAnswer(
                error=f"the calibration ended with {how}; the next change of a file starts it again"
            )
        seen, settled, _ = self._asked
        self._answered, self._asked = (seen, settled), None
        self._tell(answer, settled)

    def _tell(self, answer: FileAnswer, settled: bool) -> None:
        if answer.messages:
            self._publish(answer.messages)
        self._beside = answer.beside
        now = time.monotonic()
        if not answer.error:
            self._refused_since = None
            phase, words = ("waiting",) * 2 if answer.waiting else ("current", "up to date")
            self._say(phase, words, note=answer.note)
            return
        self._refused_since = self._refused_since or now
        if settled or now - self._refused_since >= SETTLED_S:  # before, it may be half written
            self._say("refused", "not readable as it stands", error=answer.error)

    def _say(self, phase: str, words: str, *, error: str = "", note: str = "") -> None:
        changed = self._seen[0][-1] // 1_000_000 if self._seen and len(self._seen[0]) > 1 else None
        content = {
            "file": printable(self._watched.recording.name),
            "phase": phase,
            "words": words,
            "error": error,
            "note": note,
            "changed_ms": changed,
        }
        self._publish({STATUS: line_of_json(content)})
