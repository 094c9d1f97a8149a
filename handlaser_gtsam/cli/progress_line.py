"""A sign of life on the terminal while a verb computes."""

import shutil
import sys
import threading
import time

from ..progress import Progress, told_to
from .stopping import CLEAR, CtrlC

QUIET_S = 1.0
"""Seconds until the sign appears: what is done sooner needs none."""
REFRESH_S = 0.2
"""Seconds from one sign to the next: the seconds that it counts look steady."""
PHASES = {
    "search": "looking for a start",
    "solve": "solving",
    "scales": "estimating the noise",
    "tests": "testing for systematic errors",
    "hold-out": "testing the calibration",
    "leave-out": "leaving out",
    "planes": "adding planes",
    "read": "reading the log",
    "report": "making the report",
    "study": "drawing and solving",
}


class Working:
    """A context that shows what is computed, in one line of stderr; only where that is a terminal.

    It listens to the progress of all that is computed in it. The line is gone when the context ends.
    """

    def __init__(self) -> None:
        self._part, self._phase, self._shown = "", "starting", False
        self._over = threading.Event()
        self._thread: threading.Thread | None = None
        self._listening = told_to(self._listen)

    def __enter__(self) -> None:
        self._listening.__enter__()
        if sys.stderr is not None and sys.stderr.isatty():
            self._thread = threading.Thread(
                target=self._show, args=(time.monotonic(),), daemon=True
            )
            self._thread.start()

    def __exit__(self, *raised: object) -> None:
        self._listening.__exit__(None, None, None)
        self._over.set()
        if self._thread is not None:
            self._thread.join()
        if self._shown:
            print(CLEAR, end="", file=sys.stderr, flush=True)

    def _listen(self, progress: Progress) -> None:
        if progress.total and CtrlC.asked:  # a part was stopped: no other one begins
            raise KeyboardInterrupt
        words = PHASES.get(progress.phase, progress.phase)
        if progress.total:
            number = min(progress.done + 1, progress.total)
            self._part = f"{progress.name or words} ({number} of {progress.total}): "
        else:
            self._phase = words

    def _show(self, began: float) -> None:
        wait = QUIET_S
        while not self._over.wait(wait):
            line = f"handlaser: {self._part}{self._phase}, {time.monotonic() - began:.0f} s"
            width = shutil.get_terminal_size().columns - 1
            print(CLEAR + line[:width], end="", file=sys.stderr, flush=True)
            self._shown, wait = True, REFRESH_S
