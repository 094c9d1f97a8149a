"""Work in blocks on processes or on a Dask cluster; a block whose worker was lost is done again."""

from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import Executor, Future, ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from functools import partial
from importlib import import_module
from typing import Any, TypeVar

from ..checks import require_count
from ..errors import InputError, SolverError

Result = TypeVar("Result")
MOST_JOBS = 1000
"""Processes on one computer: more than any has processors, and fewer than take its memory."""
CONNECTS_WITHIN = 10.0
"""Seconds after which there is no scheduler at an address."""
ATTEMPTS = 4
"""Losses of workers one after the other, without a result between them, after which work is given up:
a single loss may be chance, and work that needs too much memory loses every worker."""
LOST = ("BrokenProcessPool", "CancelledError", "CommClosedError", "KilledWorker")
"""Names of the errors by which executors, also executors of Dask, say that a worker was lost."""


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
        require_count("jobs", jobs, 1, MOST_JOBS)
    if scheduler is None:
        yield partial(ProcessPoolExecutor, jobs)
        return
    if jobs is not None:
        raise InputError("--jobs beside --scheduler", "one of the two")
    try:
        distributed: Any = import_module("distributed")
    except ImportError as error:
        expected = "pip install 'handlaser-gtsam[dask]'"
        raise InputError("no dask.distributed, which --scheduler needs", expected) from error
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
        pool = executor()
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
            for future in futures:
                future.cancel()
            pool.shutdown(wait=False)
