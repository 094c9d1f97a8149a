"""handlaser study: many draws of scenes, solved in several ways."""

import sys
from collections.abc import Callable
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .answer import Answer, print_wrapped
from .options import JsonOption, QuietOption

if TYPE_CHECKING:
    from ..validation.study import Study

COLUMNS = (
    ("scene", "{}"),
    ("treatment", "{}"),
    ("runs", "{}"),
    ("converged", "{:.1f}"),
    ("refused", "{:.1f}"),
    ("location_mm", "{:.4f}"),
    ("direction_deg", "{:.4f}"),
    ("nees", "{:.3f}"),
    ("standard_error", "{:.3f}"),
    ("nees_with_k", "{:.3f}"),
    ("coverage", "{:.1f}"),
    ("beyond_5", "{}"),
    ("iterations", "{:.0f}"),
    ("warned", "{:.1f}"),
)
TITLES = {
    "converged": "solved %",
    "refused": "refused %",
    "location_mm": "rms r mm",
    "direction_deg": "rms v deg",
    "nees": "NEES",
    "standard_error": "+-",
    "nees_with_k": "with k",
    "coverage": "95 % holds",
    "beyond_5": "> 5 sigma",
    "warned": "warned %",
}


def study(
    file: Annotated[
        Path, typer.Argument(help="Declaration of the study, TOML.", show_default=False)
    ],
    out: Annotated[
        Path | None,
        typer.Option(help="Folder for the rows; the study goes on from there if interrupted."),
    ] = None,
    runs: Annotated[int | None, typer.Option(min=1, help="Instead of those declared.")] = None,
    seed: Annotated[int | None, typer.Option(min=0, help="Instead of the one declared.")] = None,
    jobs: Annotated[
        int | None, typer.Option(min=1, help="Processes; default: one a processor.")
    ] = None,
    scheduler: Annotated[
        str | None, typer.Option(help="Dask cluster to run on, tcp://ADDRESS:PORT.")
    ] = None,
    picture: Annotated[
        Path | None, typer.Option(help="Draw the summary to this PNG, SVG or PDF file.")
    ] = None,
    json_: JsonOption = False,
    quiet: QuietOption = False,
) -> None:
    """Draw and solve many recordings as FILE declares, and compare with the truth.

    Exit codes: 0 done; 2 bad input; 130 stopped by Ctrl-C: with --out the same command goes on.
    """
    from ..files.study_folder import StudyFolder
    from ..files.study_picture import write_study_picture
    from ..files.study_toml import read_study
    from ..validation.study import study as draw
    from ..validation.study_executor import executor_of

    declared = read_study(file)
    runs, seed = runs or declared.runs, declared.seed if seed is None else seed
    store = None if out is None else StudyFolder(out)
    with ExitStack() as ends:
        where = executor_of(jobs, scheduler, ends)
        found = draw(declared.cases, runs, seed, where, store, _bar(ends))
    summary = found.summary()
    if picture is not None:
        write_study_picture(picture, summary)
    Answer(_json(found), partial(_show, found)).give(json=json_, quiet=quiet)


def _bar(ends: ExitStack) -> Callable[[int, int], None] | None:
    """Return what shows the progress and the time left; nothing where stderr is no terminal."""
    if sys.stderr is None or not sys.stderr.isatty():
        return None
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TimeRemainingColumn

    columns = (BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    bar = ends.enter_context(Progress(*columns, console=Console(stderr=True), transient=True))
    task = bar.add_task("runs", total=None)

    def told(done: int, total: int) -> None:
        bar.update(task, completed=done, total=total)

    return told


def _show(found: "Study") -> None:
    from ..results.description.rendering import text_table
    from ..results.description.tables import Column, Table, text
    from .width import columns

    titles = tuple(
        Column(TITLES.get(name, name), number=name not in ("scene", "treatment"))
        for name, _ in COLUMNS
    )
    rows = tuple(
        tuple(text("-" if row[name] is None else form.format(row[name])) for name, form in COLUMNS)
        for row in found.summary().iter_rows(named=True)
    )
    print_wrapped(text_table(Table("study", "", titles, rows), columns()))
    print_wrapped(
        f"{row['scene']}, {row['treatment']}: {row['code']} in {row['percent']:.1f} %"
        for row in found.power().iter_rows(named=True)
    )


def _json(found: "Study") -> str:
    import json

    content = {"summary": found.summary().to_dicts(), "warnings": found.power().to_dicts()}
    return json.dumps(content, indent=2) + "\n"
