"""What the studies of this folder share: a function mapped over seeds, by the engine of `hl.study`.

Whatever the number of workers and their order, and however often one of them is lost, every run counts
once, and its result follows from its argument alone. `--jobs` says how many processes work,
`--scheduler tcp://ADDRESS:PORT` names a Dask cluster instead, and `--rows FOLDER` keeps finished runs,
from which the same command goes on. It tells studies apart by their arguments, not by the code that
runs: take another folder when that has changed.
"""

import argparse
import hashlib
import os
import pickle
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Generic, Self, TypeVar

from rich.progress import Progress

from handlaser_gtsam.validation.study_executor import executor_of
from handlaser_gtsam.validation.study_tasks import run_each

PARTS = 200
"""Most parts of a study that are handed over and kept by themselves."""

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
        self._executor = executor_of(jobs, self._scheduler, self._ends)
        self._ends.enter_context(self._bar)
        return self

    def __exit__(self, *_: object) -> None:
        """End what was begun."""
        self._ends.close()

    def each(
        self, name: str, run: Callable[[Argument], Result], arguments: Sequence[Argument]
    ) -> list[Result]:
        """Return run(argument) for every argument, in their order, and show how many are done."""
        task = self._bar.add_task(name, total=len(arguments))
        store = None if self._rows is None else _Kept[Result].of(self._rows, run, arguments)
        found = run_each(
            run,
            arguments,
            self._executor,
            store,
            lambda done: self._bar.update(task, completed=done),
            max(len(arguments) // PARTS, 1),
        )
        self._bar.remove_task(task)
        return found

    def show(self, text: str) -> None:
        """Print a line above the progress bar."""
        self._bar.console.print(text, soft_wrap=True, highlight=False, markup=False)


def add_options(parser: argparse.ArgumentParser, jobs: int | None = None) -> None:
    """Add the options that say where a study runs; `jobs` where they say nothing."""
    parser.add_argument("--jobs", type=int, default=jobs or os.cpu_count())
    parser.add_argument("--scheduler", help="Dask cluster to run on, tcp://ADDRESS:PORT")
    parser.add_argument("--rows", type=Path, help="folder that keeps finished runs, to go on from")


class _Kept(Generic[Result]):
    """Finished parts of one study in a folder of its own, pickled: a store that nobody else reads."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    @classmethod
    def of(cls, rows: Path, run: object, arguments: Sequence[object]) -> Self:
        """Return the store of a function with its arguments."""
        content = pickle.dumps((run, list(arguments)), protocol=5)
        folder = rows / hashlib.sha256(content).hexdigest()[:16]
        folder.mkdir(parents=True, exist_ok=True)
        return cls(folder)

    def begin(self, _identity: str) -> None:
        """Take the folder, whose name is the identity."""

    def kept(self, name: str) -> list[Result] | None:
        """Return the results of a part."""
        path = self.folder / name
        found: list[Result] | None = pickle.loads(path.read_bytes()) if path.exists() else None
        return found

    def keep(self, name: str, part: list[Result]) -> None:
        """Write a part, whole or not at all."""
        beside = self.folder / f".{name}"
        beside.write_bytes(pickle.dumps(part))
        beside.replace(self.folder / name)
