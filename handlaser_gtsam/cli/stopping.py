"""How the command ends: its exit codes, of which 0 is good, and Ctrl-C.

Ctrl-C ends it with one line and exit code 130, whenever it comes. It raises KeyboardInterrupt as ever,
so that a solver hands over what it has and a file that is not whole is taken away. In the midst of an
import it ends the process at once instead: nothing is to be tidied there, and the import of a compiled
library turns the exception into any other.
"""

import atexit
import os
import signal
import threading
from enum import IntEnum
from types import FrameType


class Exit(IntEnum):
    """How the command ends where it is not good; shells use the first and the last likewise."""

    BAD_INPUT = 2
    """Input, options or files that were refused."""
    UNDETERMINED = 3
    """No calibration: the recording does not determine what was asked, its readings do not fit each
    other, or are not what is stated of them, no solver converged, or another solver disagrees."""
    NOT_USABLE = 4
    """A calibration that is not to be used."""
    INTERRUPTED = 128 + signal.SIGINT
    """Stopped by Ctrl-C."""


WORDS = "stopped by Ctrl-C"
CLEAR = "\r\x1b[K"
"""Clears the line of a terminal."""
IMPORTING = "<frozen importlib._bootstrap>"


class CtrlC:
    """A context in which Ctrl-C is noticed, whatever becomes of the KeyboardInterrupt.

    Attributes
    ----------
    asked : bool
        Whether the command is to stop; there is one command in a process.
    """

    asked = False

    def __init__(self) -> None:
        # A process in the background may have to ignore the signal; other threads do not get it.
        here = threading.current_thread() is threading.main_thread()
        self._mine = here and signal.getsignal(signal.SIGINT) is signal.default_int_handler

    def __enter__(self) -> "CtrlC":
        CtrlC.asked = False
        if self._mine:
            signal.signal(signal.SIGINT, self._stop)
        return self

    def __exit__(self, *raised: object) -> None:
        if self._mine:
            # Run first of all that is run at the end of the process: its exit code stands by now.
            atexit.register(signal.signal, signal.SIGINT, signal.SIG_IGN)
            signal.signal(signal.SIGINT, signal.default_int_handler)

    def _stop(self, _number: int, frame: FrameType | None) -> None:
        CtrlC.asked = True
        while frame is not None and frame.f_code.co_filename != IMPORTING:
            frame = frame.f_back
        if frame is None:  # no import is under way
            raise KeyboardInterrupt
        clear = CLEAR if os.isatty(2) else ""
        os.write(2, f"{clear}handlaser: {WORDS}\n".encode())
        os._exit(Exit.INTERRUPTED)
