"""What the studies of this folder share: a function mapped over seeds, on processes or a Dask cluster.

Whatever the number of workers and their order, and however often one of them is lost, every run counts
once, and its result follows from its argument alone. `--jobs` says how many processes work,
`--scheduler tcp://ADDRESS:PORT` names a Dask cluster instead, and `--rows FOLDER` keeps finished runs,
from which the same command goes on. Studies are told apart by their arguments, not by the code that
runs: take another folder when that has changed.
"""

import argparse
import hashlib
import os
import pickle
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Self, TypeVar

from rich.progress import Progress

from handlaser_gtsam.validation.study import run_blocks, workers

PARTS = 200
"""Most parts of a study that are handed to workers, and written, by themselves."""

Argument = TypeVar("Argument")
Result = TypeVar("Result")


class Studies:
    """A context in which studies run, with a progress bar.

    Parameters
    ----------
    jobs : int, optional
        Processes; one a processor where not given.
    scheduler : str, optional
        Address of a Dask cluster, instead of processes.
    rows : path, optional
        Folder that keeps finished runs.
    """

    def __init__(
        self, jobs: int | None = None, scheduler: str | None = None, rows: Path | None = None
    ) -> None:
        self._jobs, self._scheduler, self._rows = jobs, scheduler, rows
        self._ends, self._bar = ExitStack(), Progress()

    @classmethod
    def of(cls, arguments: argparse.Namespace) -> Self:
        """Return the context that the options of `add_options` ask for."""
        return cls(arguments.jobs, arguments.scheduler, arguments.rows)

    def __enter__(self) -> Self:
        """Show the bar, and connect to the cluster."""
        jobs = None if self._scheduler else self._jobs
        self._executor = self._ends.enter_context(workers(jobs, self._scheduler))
        self._ends.enter_context(self._bar)
        return self

    def __exit__(self, *_: object) -> None:
        """End what was begun."""
        self._ends.close()

    def each(
        self, name: str, run: Callable[[Argument], Result], arguments: Sequence[Argument]
    ) -> list[Result]:
        """Return run(argument) for every argument, in their order, and show how many are done."""
        kept, results = None, dict[int, Result]()
        if self._rows is not None:
            content = pickle.dumps((run, list(arguments)), protocol=5)
            kept = self._rows / f"{hashlib.sha256(content).hexdigest()[:16]}.pickle"
            self._rows.mkdir(parents=True, exist_ok=True)
        if kept is not None and kept.exists():
            results = pickle.loads(kept.read_bytes())
        task = self._bar.add_task(name, total=len(arguments), completed=len(results))
        left = [number for number in range(len(arguments)) if number not in results]
        share = max(len(arguments) // PARTS, 1)
        blocks = [
            (run, {number: arguments[number] for number in left[first : first + share]})
            for first in range(0, len(left), share)
        ]
        for part in run_blocks(_run_part, blocks, self._executor):
            results |= part
            self._bar.update(task, completed=len(results))
            if kept is not None:
                beside = kept.with_suffix(".part")
                beside.write_bytes(pickle.dumps(results))
                beside.replace(kept)
        self._bar.remove_task(task)
        return [results[number] for number in range(len(arguments))]

    def show(self, text: str) -> None:
        """Print a line above the progress bar."""
        self._bar.console.print(text, soft_wrap=True, highlight=False, markup=False)


def _run_part(
    run: Callable[[Argument], Result], arguments: dict[int, Argument]
) -> dict[int, Result]:
    return {number: run(argument) for number, argument in arguments.items()}


def add_options(parser: argparse.ArgumentParser, jobs: int | None = None) -> None:
    """Add the options that say where a study runs; `jobs` where they say nothing."""
    parser.add_argument("--jobs", type=int, default=jobs or os.cpu_count())
    parser.add_argument("--scheduler", help="Dask cluster to run on, tcp://ADDRESS:PORT")
    parser.add_argument("--rows", type=Path, help="folder that keeps finished runs, to go on from")
