"""Monte-Carlo studies: many draws of scenes, solved in several ways, on any executor.

The runs are parted into tasks that do not depend on who works on them. The seed of a run is that of the
study, the number of its scene and its own number: the rows are the same to the last bit whatever the
number of workers, their order, or how often one of them was lost.
"""

import hashlib
import pickle
from collections.abc import Callable, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial

import polars as pl

from ..checks import require_count
from ..errors import InputError
from .study_cases import Case, solve_runs
from .study_rows import found_codes, summarized
from .study_tasks import Store, run_tasks

SHARE = 20
"""Runs of a task."""


@dataclass(frozen=True, slots=True)
class Study:
    """The rows of a study.

    Attributes
    ----------
    rows : polars.DataFrame
        One a run, by scene, treatment and number; see `KINDS`.
    """

    rows: pl.DataFrame

    def summary(self) -> pl.DataFrame:
        """Return a line for every scene and treatment."""
        return summarized(self.rows)

    def power(self) -> pl.DataFrame:
        """Return in how many of the runs [%] each warning was given."""
        return found_codes(self.rows)


def study(
    cases: Sequence[Case],
    runs: int,
    seed: int = 0,
    executor: Executor | Callable[[], Executor] | None = None,
    store: Store[pl.DataFrame] | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Study:
    """Draw and solve `runs` recordings of every case.

    Parameters
    ----------
    cases : sequence of Case
        Cases of one scene, by name, get the same recordings.
    runs : int
    seed : int
    executor : Executor, or a function that makes one, optional
        Where the work is done; a process for every processor where not given. One that is made here is
        shut down here, and made again when a worker of it dies.
    store : Store, optional
        Keeps finished parts: a `StudyFolder`, from which a study that was interrupted goes on.
    progress : callable, optional
        Called with the numbers of finished and of all runs.

    Raises
    ------
    InputError
        No cases, a scene and treatment twice, or a store with the parts of another study.
    SolverError
        A worker was lost again and again on the same runs.
    """
    require_count("runs", runs, 1, 10**9)
    require_count("seed", seed, 0, 2**63)
    tasks = _tasks(cases, runs, seed)
    identity = _identity(cases, seed)
    if store is not None:
        store.begin(identity)
    make = ProcessPoolExecutor if executor is None else executor
    told = None if progress is None else partial(_tell, progress, runs * len(cases))
    found = run_tasks(tasks, make, store, told)
    return Study(pl.concat([found[name] for name in tasks]))


def _tell(progress: Callable[[int, int], None], total: int, done: int) -> None:
    progress(done, total)


def _tasks(cases: Sequence[Case], runs: int, seed: int) -> dict[str, Callable[[], pl.DataFrame]]:
    """Return the tasks by name, in the order of their rows."""
    names = [(case.scene, case.treatment) for case in cases]
    if not names or len(set(names)) < len(names):
        raise InputError(f"cases {names}", "one or more, each scene and treatment once")
    scenes = list(dict.fromkeys(case.scene for case in cases))
    found: dict[str, Callable[[], pl.DataFrame]] = {}
    for number, case in enumerate(cases):
        key = (seed, scenes.index(case.scene))
        for first in range(0, runs, SHARE):
            some = range(first, min(first + SHARE, runs))
            found[f"{number:03d}-{first:08d}-{len(some)}"] = partial(solve_runs, case, key, some)
    return found


def _identity(cases: Sequence[Case], seed: int) -> str:
    """Return what tells one study from another: its cases and its seed."""
    try:
        content = pickle.dumps((list(cases), seed), protocol=5)
    except (pickle.PicklingError, AttributeError, TypeError) as error:
        found = f"a case that cannot be pickled ({error})"
        raise InputError(found, "functions of a module, and values") from error
    return hashlib.sha256(content).hexdigest()
