"""What a long computation tells its caller while it runs.

The callback travels beside the computation, in a context variable: an algorithm says in one line where
it is, and no function takes the callback as an argument only to hand it on.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from typing import Literal

Phase = Literal[
    "search", "solve", "scales", "tests", "leave-out", "hold-out", "bootstrap", "planes", "report"
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
        unknown standard deviations; `tests`: for systematic errors; `leave-out`, `hold-out`,
        `bootstrap`: the parts of a validation; `planes`: one plane after the other joins a session;
        `report`: what a report shows beside the calibration.
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


Listener = Callable[[Progress], None]
_listener: ContextVar[Listener | None] = ContextVar("handlaser_progress", default=None)


@contextmanager
def told_to(listener: Listener | None) -> Iterator[None]:
    """Let `tell` call `listener` meanwhile; without one, whoever listens already goes on."""
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
    if listener is not None:
        listener(Progress(phase, done, total, name, trial))


def tell_trial(trial: Trial) -> None:
    """Tell of a trial step of the joint solution."""
    tell("solve", trial=trial)
