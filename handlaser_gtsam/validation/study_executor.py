"""Where the work of a study is done."""

from collections.abc import Callable
from concurrent.futures import Executor, ProcessPoolExecutor
from contextlib import ExitStack
from functools import partial
from importlib import import_module
from typing import Any

from ..checks import require_count
from ..errors import InputError

MOST_JOBS = 1000
"""Processes on one computer: more than any has processors, and fewer than take its memory."""


def executor_of(
    jobs: int | None, scheduler: str | None, ends: ExitStack
) -> Executor | Callable[[], Executor]:
    """Return where the work of a study is done: processes here, or a Dask cluster.

    Parameters
    ----------
    jobs : int, optional
        Processes; one a processor where not given.
    scheduler : str, optional
        Address of the cluster's scheduler, tcp://ADDRESS:PORT.
    ends : ExitStack
        Ends the connection.

    Raises
    ------
    InputError
        Jobs beyond sense, both are given, no dask.distributed, or no scheduler at that address.
    """
    if jobs is not None:
        require_count("jobs", jobs, 1, MOST_JOBS)
    if scheduler is None:
        return partial(ProcessPoolExecutor, jobs)
    if jobs is not None:
        raise InputError("--jobs beside --scheduler", "one of the two")
    try:
        distributed: Any = import_module("distributed")
    except ImportError as error:
        expected = "pip install 'handlaser-gtsam[dask]'"
        raise InputError("no dask.distributed, which --scheduler needs", expected) from error
    try:
        client = ends.enter_context(distributed.Client(scheduler, timeout=10))
    except (OSError, ValueError, TypeError) as error:
        found = f"no scheduler at {scheduler} ({type(error).__name__})"
        raise InputError(found, "the address of a running one, tcp://ADDRESS:PORT") from error
    executor: Executor = client.get_executor(pure=False)
    return executor
