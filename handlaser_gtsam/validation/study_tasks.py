"""Tasks on an executor: each result counts once, whatever workers do; finished ones are kept."""

from collections.abc import Callable, Mapping, Sequence, Sized
from concurrent.futures import (
    FIRST_COMPLETED,
    BrokenExecutor,
    Executor,
    Future,
    ProcessPoolExecutor,
    wait,
)
from functools import partial
from typing import Generic, Protocol, TypeVar

from ..errors import HandlaserError, SolverError

Part = TypeVar("Part", bound=Sized)
"""What a task returns: the results of some runs, such as a table of rows or a list."""
Argument = TypeVar("Argument")
Result = TypeVar("Result")
ATTEMPTS = 4
"""A task whose worker was lost so often is given up."""
LOST = ("KilledWorker", "CancelledError", "CommClosedError")
"""Names of the errors with which executors of other packages say that a worker was lost."""


class Store(Protocol[Part]):
    """Keeps finished tasks."""

    def begin(self, identity: str) -> None:
        """Refuse, by an InputError, what belongs to another study than this."""

    def kept(self, name: str) -> Part | None:
        """Return the results of a task that was kept."""

    def keep(self, name: str, part: Part, /) -> None:
        """Keep the results of a task."""


def run_each(
    function: Callable[[Argument], Result],
    arguments: Sequence[Argument],
    executor: Executor | Callable[[], Executor] = ProcessPoolExecutor,
    store: Store[list[Result]] | None = None,
    progress: Callable[[int], None] | None = None,
    share: int = 1,
) -> list[Result]:
    """Return function(argument) of every argument, in their order; results are what counts as runs.

    Parameters
    ----------
    function : callable
        Of a module, or a `partial` of one: it goes to other processes. What it draws must follow from
        its argument alone, such as a seed.
    arguments : sequence
    executor : Executor, or a function that makes one
    store : Store, optional
        Keeps finished parts, to go on from; it has to tell studies apart.
    progress : callable, optional
        Called with the number of finished runs.
    share : int
        Runs of a task.

    Raises
    ------
    SolverError
        A worker was lost again and again on the same task.
    """
    tasks = {
        f"{first:08d}-{share}": partial(_each, function, arguments[first : first + share])
        for first in range(0, len(arguments), share)
    }
    found = run_tasks(tasks, executor, store, progress)
    return [one for name in tasks for one in found[name]]


def _each(function: Callable[[Argument], Result], arguments: Sequence[Argument]) -> list[Result]:
    return [function(one) for one in arguments]


def run_tasks(
    tasks: Mapping[str, Callable[[], Part]],
    executor: Executor | Callable[[], Executor],
    store: Store[Part] | None = None,
    progress: Callable[[int], None] | None = None,
) -> dict[str, Part]:
    """Return the results of every task; those that are kept are not worked on again.

    Raises
    ------
    SolverError
        A worker was lost again and again on the same task.
    """
    found: dict[str, Part] = {}
    if store is not None:
        there = {name: store.kept(name) for name in tasks}
        found = {name: part for name, part in there.items() if part is not None}
    done = sum(len(part) for part in found.values())
    if progress is not None:
        progress(done)
    pool = _Pool[Part](executor)
    lost: dict[str, int] = {}
    try:
        waiting = pool.submitted({name: task for name, task in tasks.items() if name not in found})
        while waiting:
            ended, _ = wait(waiting, return_when=FIRST_COMPLETED)
            again: dict[str, Callable[[], Part]] = {}
            for future in ended:
                name = waiting.pop(future)
                part = _result(future, name, lost)
                if part is None:
                    again[name] = tasks[name]
                    continue
                found[name] = part
                if store is not None:
                    store.keep(name, part)
                done += len(part)
                if progress is not None:
                    progress(done)
            if again:
                waiting = pool.resubmitted(again, waiting, tasks)
    finally:
        pool.close()
    return found


def _result(future: "Future[Part]", name: str, lost: dict[str, int]) -> Part | None:
    """Return the results of a task, or None where its worker was lost."""
    try:
        return future.result()
    except HandlaserError:
        raise
    except BaseException as error:
        if not isinstance(error, BrokenExecutor) and type(error).__name__ not in LOST:
            raise
        lost[name] = lost.get(name, 0) + 1
        if lost[name] >= ATTEMPTS:
            raise SolverError(
                f"a worker lost {ATTEMPTS} times on part {name} ({type(error).__name__}); "
                "expected workers that live as long as the study, with enough memory"
            ) from error
        return None


class _Pool(Generic[Part]):
    """An executor that is made anew when it breaks, if it was made here."""

    def __init__(self, executor: Executor | Callable[[], Executor]) -> None:
        self.make = None if isinstance(executor, Executor) else executor
        self.executor = executor if isinstance(executor, Executor) else executor()

    def submitted(self, tasks: Mapping[str, Callable[[], Part]]) -> "dict[Future[Part], str]":
        """Hand tasks over."""
        return {self.executor.submit(task): name for name, task in tasks.items()}

    def resubmitted(
        self,
        again: dict[str, Callable[[], Part]],
        waiting: "dict[Future[Part], str]",
        tasks: Mapping[str, Callable[[], Part]],
    ) -> "dict[Future[Part], str]":
        """Hand tasks over again, with all that waits where the executor has to be made anew."""
        try:
            return {**waiting, **self.submitted(again)}
        except BrokenExecutor:
            if self.make is None:
                raise
        self.executor.shutdown(wait=False, cancel_futures=True)
        self.executor = self.make()
        alive = {future: name for future, name in waiting.items() if future.done()}
        lost = [name for future, name in waiting.items() if future not in alive]
        return {**alive, **self.submitted({**again, **{name: tasks[name] for name in lost}})}

    def close(self) -> None:
        """Shut down what was made here."""
        if self.make is not None:
            self.executor.shutdown(wait=False, cancel_futures=True)
