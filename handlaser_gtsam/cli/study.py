"""handlaser study: many draws of scenes, solved in several ways."""

import json
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .answer import Answer, working
from .options import JsonOption, OneOrMore, QuietOption

if TYPE_CHECKING:
    from polars import DataFrame


def study(
    file: Path,
    out: Path | None = None,
    runs: OneOrMore = None,
    seed: Annotated[int | None, typer.Option(min=0)] = None,
    jobs: OneOrMore = None,
    scheduler: str | None = None,
    picture: Path | None = None,
    json_: JsonOption = False,
    quiet: QuietOption = False,
) -> None:
    r"""Draw and solve many recordings as FILE declares, and compare with the truth.

    Exit codes: 0 done; 2 bad input; 130 stopped by Ctrl-C: with --out the same command goes on.

    Parameters
    ----------
    file : Path
        Declaration of the study, TOML.
    out : Path, optional
        Parquet file for a row a run; an interrupted study goes on from it.
    runs : int, optional
        Instead of those declared.
    seed : int, optional
        Instead of the one declared.
    jobs : int, optional
        Processes; default: one a processor.
    scheduler : str, optional
        Dask cluster to run on, tcp://ADDRESS:PORT.
    picture : Path, optional
        Draw the summary to this PNG, SVG or PDF file.
    json_, quiet

    Examples
    --------
    handlaser study study.toml --runs 4
    handlaser study study.toml --runs 4 \
        --out runs.parquet --jobs 2
    """
    from ..files.study_toml import read_runs, read_study, write_runs, write_study_picture
    from ..files.writing import require_outputs
    from ..validation.runs import count_warnings, summarize_runs
    from ..validation.study import run_study, workers

    declared = read_study(file)
    runs = declared.runs if runs is None else runs
    declared = replace(declared, runs=runs, seed=declared.seed if seed is None else seed)
    require_outputs({"--out": out, "--picture": picture}, [file])
    kept = None if out is None or not out.exists() else read_runs(out)
    keep = None if out is None else partial(write_runs, out)
    with working(), workers(jobs, scheduler) as executor:
        table = run_study(declared, executor, kept, keep)
    summary, warnings = summarize_runs(table), count_warnings(table)
    content = {"summary": summary.to_dicts(), "warnings": warnings.to_dicts()}
    text = json.dumps(content, indent=2) + "\n"
    Answer(text, _lines(summary, warnings)).give(json=json_, quiet=quiet)
    if picture is not None:
        write_study_picture(picture, summary)


def _lines(summary: "DataFrame", warnings: "DataFrame") -> Iterator[str]:
    from ..results.description.tables import Cell, Column, Table, significant, text_table
    from .answer import columns

    words = "scene", "treatment"
    titles = tuple(Column(name, number=name not in words) for name in summary.columns)

    def shown(cell: object) -> Cell:
        return significant(cell, 4) if isinstance(cell, float | None) else Cell(str(cell))

    rows = tuple(tuple(map(shown, row)) for row in summary.iter_rows())
    yield from text_table(Table("study", "", titles, rows), columns())
    for row in warnings.iter_rows(named=True):
        yield f"{row['scene']}, {row['treatment']}: {row['code']} in {row['percent']:.1f} %"
