"""What a long computation tells its caller while it runs.

The callback travels beside the computation, in a context variable: an algorithm says in one line where
it is, and no function takes the callback as an argument only to hand it on. Progress is logged, too:
the stages as information, and the trial steps for debugging. Nobody sees that unless logging is set up.
"""

import logging
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from typing import Literal

from .errors import InputError
from .text import shown

Phase = Literal[
    "search",
    "solve",
    "scales",
    "tests",
    "leave-out",
    "hold-out",
    "planes",
    "read",
    "report",
    "study",
]


@dataclass(frozen=True, slots=True)
class Trial:
    """One trial step: cost (half the weighted sum of squares) after it, and its fate."""

    number: int
    cost: float
    damping: float
    step: float
    accepted: bool


@dataclass(frozen=True, slots=True)
class Progress:
    """Where a computation is.

    Attributes
    ----------
    phase : str
        `search`: of a start and of the readings that agree; `solve`: the joint solution; `scales`:
        unknown standard deviations; `tests`: for systematic errors; `leave-out`, `hold-out`: the
        parts of a validation; `planes`: one plane after the other joins a session; `read`: the messages
        of a bag; `report`: what a report shows beside the calibration; `study`: the runs of a study.
    done, total : int
        Parts that are finished, and all of them; zero where they are not counted.
    name : str
        The part that begins now; empty where it has no name.
    trial : Trial or None
        The step that the solver has tried, in the phase `solve`.
    """

    phase: Phase
    done: int = 0
    total: int = 0
    name: str = ""
    trial: Trial | None = None


LOGGER = logging.getLogger("handlaser_gtsam")
"""The one logger of the package."""
LOGGER.addHandler(logging.NullHandler())  # else Python itself would print what is a warning
Listener = Callable[[Progress], None]
_listener: ContextVar[Listener | None] = ContextVar("handlaser_progress", default=None)
_stage: ContextVar[str] = ContextVar("handlaser_stage", default="")


def require_progress(listener: object) -> None:
    """Refuse what is neither None nor can be called."""
    if listener is not None and not callable(listener):
        given = f"{shown(listener)} of type {type(listener).__name__} as progress"
        raise InputError(given, "a function of one argument")


@contextmanager
def told_to(listener: Listener | None) -> Iterator[None]:
    """Let `tell` call `listener` meanwhile; without one, whoever listens already goes on."""
    require_progress(listener)
    if listener is None:
        yield
        return
    token = _listener.set(listener)
    try:
        yield
    finally:
        _listener.reset(token)


def tell(
    phase: Phase,
    done: int = 0,
    total: int = 0,
    name: str = "",
    trial: Trial | None = None,
) -> None:
    """Tell whoever listens where the computation is."""
    listener = _listener.get()
    if trial is None and LOGGER.isEnabledFor(logging.INFO):
        words = f"stage: {phase}" + (f", {done + 1} of {total} {name}".rstrip() if total else "")
        again = words == _stage.get()  # a phase that goes on
        LOGGER.log(logging.DEBUG if again else logging.INFO, "%s", words)
        _stage.set(words)
    if listener is not None:
        listener(Progress(phase, done, total, name, trial))


def tell_trial(trial: Trial) -> None:
    """Tell of a trial step of the joint solution."""
    LOGGER.debug(
        "step %d: cost %.6g, damping %.1e, step %.1e, %s",
        trial.number,
        trial.cost,
        trial.damping,
        trial.step,
        "accepted" if trial.accepted else "rejected",
    )
    tell("solve", trial=trial)
