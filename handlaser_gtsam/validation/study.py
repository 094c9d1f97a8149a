"""Monte-Carlo studies: many draws of scenes, solved in several ways, in one table with a row a run.

The seed of a run is made of the seed of the study, the number of its scene and the number of the run.
Its row is therefore the same to the last bit whatever the number of workers, their order, and how often
one is lost; and all treatments of a scene get the same recordings.

Work is done in blocks on processes or on a Dask cluster; a block whose worker was lost is done again.
"""

import hashlib
import multiprocessing
import pickle
import time
import traceback
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import Executor, Future, ProcessPoolExecutor, as_completed
from contextlib import closing, contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TypeVar

import numpy as np
import polars as pl

from ..checks import imported, require_count
from ..data.parameters import Parameters
from ..data.recording import Recording
from ..errors import HandlaserError, InputError, SolverError
from ..progress import Listener, tell, told_to
from .runs import RUN_SCHEMA, Estimated, run_row

BLOCK = 20
"""Runs that a worker solves at once: enough to gain from solving them together, and few enough that an
interrupted study loses seconds."""

Draw = Callable[[np.random.Generator], tuple[Recording, Parameters]]
"""Draws a recording, and the truth behind it with the beams in the order of the recording."""
Solve = Callable[[Sequence[Recording]], Sequence[Estimated | HandlaserError]]
"""Returns an estimate for each recording, or the error that refuses it."""
Result = TypeVar("Result")
CONNECTS_WITHIN = 10.0
"""Seconds after which there is no scheduler at an address."""
ATTEMPTS = 4
"""Losses of workers one after the other, without a result between them, after which work is given up:
a single loss may be chance, and work that needs too much memory loses every worker."""
LOST = ("BrokenProcessPool", "CancelledError", "CommClosedError", "KilledWorker")
"""Names of the errors by which executors, also executors of Dask, say that a worker was lost."""


@dataclass(frozen=True, slots=True)
class Case:
    """A scene with a treatment: functions that can be pickled, as they go to other processes.

    Attributes
    ----------
    scene, treatment : str
        Their names.
    draw : callable
        Draws a recording by a generator, and the truth behind it with the beams in its order: a
        `partial` of `draw_scene`, or a function of your own.
    solve : callable
        Returns an estimate for each of many recordings, or the error that refuses it: a `partial` of
        `calibrate_each` or `reduce_together`, or a function of your own.
    """

    scene: str
    treatment: str
    draw: Draw
    solve: Solve


@dataclass(frozen=True, slots=True)
class Study:
    """What a study draws and solves.

    Attributes
    ----------
    cases : sequence of Case
        Cases of one scene, by name, get the same recordings.
    runs : int
        Of every case.
    seed : int

    Raises
    ------
    InputError
        No cases, a scene and treatment twice, or numbers that cannot be.
    """

    cases: Sequence[Case]
    runs: int = 100
    seed: int = 0

    def __post_init__(self) -> None:
        require_count("runs", self.runs, 1, 10**9)
        require_count("seed", self.seed, 0, 2**63)
        names = [(case.scene, case.treatment) for case in self.cases]
        if not names or len(set(names)) < len(names):
            raise InputError(f"cases {names}", "one or more, each scene and treatment once")


def processes(jobs: int | None = None) -> Executor:
    """Return an executor of processes that begin afresh, not as copies of this one.

    A copy of a process with threads may wait for ever for a lock that one of them holds, as where a
    function of a scene reads a file with polars.

    Parameters
    ----------
    jobs : int, optional
        How many; one a processor where not given.
    """
    afresh = "forkserver" if "forkserver" in multiprocessing.get_all_start_methods() else "spawn"
    return ProcessPoolExecutor(jobs, multiprocessing.get_context(afresh))


def run_study(
    study: Study,
    executor: Callable[[], Executor] = processes,
    kept: pl.DataFrame | None = None,
    keep: Callable[[pl.DataFrame], None] | None = None,
    progress: Listener | None = None,
) -> pl.DataFrame:
    """Draw and solve all runs of a study; return their table, by case and number of the run.

    Parameters
    ----------
    study : Study
    executor : callable
        Makes the executor that works: a process for every processor where not given,
        `partial(processes, 4)`, or `client.get_executor` of a Dask client.
    kept : polars.DataFrame, optional
        Table of an interrupted study, or of one with fewer runs: its runs are not done again.
    keep : callable, optional
        Takes the table every few seconds, and at the end of a study that is interrupted, too.
    progress : callable, optional
        Called with a `Progress` whenever runs are finished.

    Returns
    -------
    polars.DataFrame
        With the columns of `RUN_SCHEMA`.

    Raises
    ------
    InputError
        A table of another study, or a case that cannot be pickled.
    SolverError
        Workers were lost again and again.
    """
    digest = _digest(study)
    table = pl.DataFrame(schema=RUN_SCHEMA) if kept is None else kept
    if (table["study"] != digest).any():
        expected = "the table of the same cases and seed, or a file that is not there yet"
        raise InputError("a table with runs of another study", expected)
    blocks: list[tuple[Case, tuple[int, int], list[int]]] = []
    scenes = list(dict.fromkeys(case.scene for case in study.cases))
    for case in study.cases:
        done = set(_of_case(table, case)["run"])
        left = [run for run in range(study.runs) if run not in done]
        key = (study.seed, scenes.index(case.scene))
        blocks += [(case, key, left[i : i + BLOCK]) for i in range(0, len(left), BLOCK)]
    total = study.runs * len(study.cases)
    finished = total - sum(len(runs) for *_, runs in blocks)
    written = time.monotonic()
    with told_to(progress), closing(run_blocks(solve_runs, blocks, executor)) as results:
        tell("study")
        tell("study", finished, total, "runs")
        try:
            for rows in results:
                table = table.vstack(rows.with_columns(study=pl.lit(digest)))
                finished += rows.height
                tell("study", finished, total, "runs")
                # Seconds from one writing of the table to the next: what a killed study loses at
                # most, and far more than the writing takes.
                if keep is not None and time.monotonic() - written > 2.0:
                    keep(table)
                    written = time.monotonic()
        finally:
            if keep is not None:
                keep(table)
    table = table.filter(pl.col("run") < study.runs)
    return pl.concat(_of_case(table, case).sort("run") for case in study.cases)


def _of_case(table: pl.DataFrame, case: Case) -> pl.DataFrame:
    return table.filter(scene=case.scene, treatment=case.treatment)


def solve_runs(case: Case, key: tuple[int, int], runs: Sequence[int]) -> pl.DataFrame:
    """Draw and solve some runs of a case; return their rows of the table.

    Parameters
    ----------
    case : Case
    key : ints
        Seed of the study and number of the scene: with the number of a run, they are its seed.
    runs : ints
    """
    drawn = []
    for run in runs:
        with _of_the_user(case.draw, f"run {run} of the scene {case.scene}"):
            drawn.append(case.draw(np.random.default_rng((*key, run))))
    for pair in drawn:
        kinds = [type(part) for part in pair] if isinstance(pair, tuple) else [type(pair)]
        if kinds != [Recording, Parameters]:
            found = f"the scene {case.scene} draws {', '.join(kind.__name__ for kind in kinds)}"
            raise InputError(found, "a Recording, and the Parameters that are true")
    with _of_the_user(case.solve, f"runs {runs[0]} to {runs[-1]} of {case.treatment}"):
        estimates = case.solve([recording for recording, _ in drawn])
    rows = [
        {"scene": case.scene, "treatment": case.treatment, "run": run, **run_row(estimate, truth)}
        for run, (_, truth), estimate in zip(runs, drawn, estimates, strict=True)
    ]
    return pl.DataFrame(rows, schema=RUN_SCHEMA)


@contextmanager
def _of_the_user(function: Callable[..., object], what: str) -> Iterator[None]:
    """Refuse what a function raises that is not of this package, with where it did so."""
    called = function.func if isinstance(function, partial) else function
    module = getattr(called, "__module__", None) or ""
    name = f"{module}:{getattr(called, '__qualname__', called)}"
    try:
        yield
    except HandlaserError:
        raise
    except Exception as error:
        if name.startswith(f"{__package__.partition('.')[0]}."):
            raise
        place = traceback.extract_tb(error.__traceback__)[-1]
        where = f"{Path(place.filename).name}, line {place.lineno}"
        found = f"{type(error).__name__} in {name}, {what}: {error} ({where})"
        raise InputError(found, "a function that returns") from error


def _digest(study: Study) -> str:
    """Return a digest that differs for other cases or another seed."""
    try:
        content = pickle.dumps((tuple(study.cases), study.seed), protocol=5)
    except (pickle.PicklingError, AttributeError, TypeError) as error:
        found = f"a case that cannot be pickled ({error})"
        raise InputError(found, "functions of a module, and values") from error
    return hashlib.sha256(content).hexdigest()[:16]


@contextmanager
def workers(jobs: int | None, scheduler: str | None) -> Iterator[Callable[[], Executor]]:
    """Yield a function that makes an executor: of processes here, or of a Dask cluster.

    Parameters
    ----------
    jobs : int, optional
        Processes; one a processor where not given.
    scheduler : str, optional
        Address of the cluster's scheduler, tcp://ADDRESS:PORT.

    Raises
    ------
    InputError
        Jobs beyond sense, both are given, no dask.distributed, or no scheduler at that address.
    """
    if jobs is not None:
        require_count("jobs", jobs, 1, 1000)  # more than any computer has processors
    if scheduler is None:
        yield partial(processes, jobs)
        return
    if jobs is not None:
        raise InputError("--jobs beside --scheduler", "one of the two")
    missing = "no dask.distributed, which --scheduler needs"
    distributed = imported("distributed", "dask", missing)
    try:
        client = distributed.Client(scheduler, timeout=CONNECTS_WITHIN)
    except (OSError, ValueError, TypeError) as error:
        found = f"no scheduler at {scheduler} ({type(error).__name__})"
        raise InputError(found, "the address of a running one, tcp://ADDRESS:PORT") from error
    with client:
        yield partial(client.get_executor, pure=False)


def run_blocks(
    function: Callable[..., Result],
    blocks: Sequence[tuple[object, ...]],
    executor: Callable[[], Executor],
) -> Generator[Result]:
    """Yield function(*block) of every block once, in the order in which the results arrive.

    Parameters
    ----------
    function : callable
        Of a module, or a `partial` of one: it goes to other processes. What it draws at random must
        follow from its arguments, such as a seed.
    blocks : sequence of tuples
        Arguments of the calls.
    executor : callable
        Makes the executor, and another one when a worker was lost.

    Raises
    ------
    SolverError
        Workers were lost again and again.
    """
    left, losses = dict(enumerate(blocks)), 0
    while left:
        pool, finished = executor(), False
        futures: dict[Future[Result], int] = {}
        try:
            for number, block in left.items():
                futures[pool.submit(function, *block)] = number
            for future in as_completed(futures):
                error = future.exception()
                # They arrive in no order: what others have finished is not lost with one that failed.
                for one in [future] if error is None else futures:
                    if not one.done() or one.cancelled() or one.exception() is not None:
                        continue
                    if left.pop(futures[one], None) is not None:
                        losses = 0
                        yield one.result()
                if error is not None:
                    raise error
            finished = True
        except BaseException as error:
            if type(error).__name__ not in LOST:
                raise
            losses += 1
            if losses == ATTEMPTS:
                raise SolverError(
                    f"a worker lost {ATTEMPTS} times without a result ({type(error).__name__}); "
                    "expected workers that live as long as the study, with enough memory"
                ) from error
        finally:
            # Work that nobody waits for any more, as after Ctrl-C, would keep Python from ending. Its
            # futures fail with the processes: the pool cannot end those that are cancelled before.
            working = {} if finished else dict(getattr(pool, "_processes", None) or {})
            for future in () if working else futures:
                future.cancel()
            pool.shutdown(wait=False)
            for process in working.values():
                process.terminate()
