"""Tasks on an executor: each result counts once, whatever workers do; finished ones are kept."""

from collections.abc import Callable, Mapping
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Executor, Future, wait
from typing import Protocol

import polars as pl

from ..errors import HandlaserError, SolverError
from .study_rows import frame_of

Rows = list[dict[str, object]]
Task = Callable[[], Rows]
ATTEMPTS = 4
"""A task whose worker was lost so often is given up."""
LOST = ("KilledWorker", "CancelledError", "CommClosedError")
"""Names of the errors with which executors of other packages say that a worker was lost."""


class Store(Protocol):
    """Keeps finished tasks."""

    def begin(self, identity: str) -> None:
        """Refuse, by an InputError, what belongs to another study than this."""

    def kept(self, name: str) -> pl.DataFrame | None:
        """Return the rows of a task that was kept."""

    def keep(self, name: str, rows: pl.DataFrame) -> None:
        """Keep the rows of a task."""


def run_tasks(
    tasks: Mapping[str, Task],
    executor: Executor | Callable[[], Executor],
    store: Store | None = None,
    progress: Callable[[int], None] | None = None,
) -> dict[str, pl.DataFrame]:
    """Return the rows of every task; those that are kept are not worked on again.

    Raises
    ------
    SolverError
        A worker was lost again and again on the same task.
    """
    found: dict[str, pl.DataFrame] = {}
    if store is not None:
        there = {name: store.kept(name) for name in tasks}
        found = {name: rows for name, rows in there.items() if rows is not None}
    done = sum(len(rows) for rows in found.values())
    if progress is not None:
        progress(done)
    pool = _Pool(executor)
    lost: dict[str, int] = {}
    try:
        waiting = pool.submitted({name: task for name, task in tasks.items() if name not in found})
        while waiting:
            ended, _ = wait(waiting, return_when=FIRST_COMPLETED)
            again: dict[str, Task] = {}
            for future in ended:
                name = waiting.pop(future)
                rows = _result(future, name, lost)
                if rows is None:
                    again[name] = tasks[name]
                    continue
                found[name] = frame_of(rows)
                if store is not None:
                    store.keep(name, found[name])
                done += len(rows)
                if progress is not None:
                    progress(done)
            if again:
                waiting = pool.resubmitted(again, waiting, tasks)
    finally:
        pool.close()
    return found


def _result(future: "Future[Rows]", name: str, lost: dict[str, int]) -> Rows | None:
    """Return the rows of a task, or None where its worker was lost."""
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


class _Pool:
    """An executor that is made anew when it breaks, if it was made here."""

    def __init__(self, executor: Executor | Callable[[], Executor]) -> None:
        self.make = None if isinstance(executor, Executor) else executor
        self.executor = executor if isinstance(executor, Executor) else executor()

    def submitted(self, tasks: Mapping[str, Task]) -> "dict[Future[Rows], str]":
        """Hand tasks over."""
        return {self.executor.submit(task): name for name, task in tasks.items()}

    def resubmitted(
        self,
        again: dict[str, Task],
        waiting: "dict[Future[Rows], str]",
        tasks: Mapping[str, Task],
    ) -> "dict[Future[Rows], str]":
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
