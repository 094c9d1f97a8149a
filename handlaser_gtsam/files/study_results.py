"""What a study leaves: its table of runs as a Parquet file, and its summary as a picture."""

import io
from pathlib import Path

import polars as pl

from ..errors import InputError
from ..validation.runs import RUN_SCHEMA
from .writing import path_of, require_writable, write_bytes

PANELS = {
    "nees": "NEES a degree of freedom",
    "coverage": "coverage of 95 % intervals, %",
    "location_mm": "rms error of r, mm",
    "direction_deg": "rms error of v, deg",
}
"""Columns of the summary that are drawn, and their titles."""


def read_runs(path: Path | str) -> pl.DataFrame:
    """Read the table of a study.

    Raises
    ------
    InputError
        No readable file, or no table of runs.
    """
    path = path_of(path)
    try:
        return pl.read_parquet(path.read_bytes()).match_to_schema(pl.Schema(RUN_SCHEMA))
    except OSError as error:
        raise InputError(f"no readable file ({error.strerror})", "runs, Parquet", path) from error
    except pl.exceptions.PolarsError as error:
        found = f"no runs of a study ({str(error).splitlines()[0][:80]})"
        raise InputError(found, "a table that a study wrote, or a new file", path) from error


def write_runs(path: Path | str, runs: pl.DataFrame) -> None:
    """Write the table of a study in one step; raises InputError where that is not possible."""
    buffer = io.BytesIO()
    runs.write_parquet(buffer)
    write_bytes(path_of(path), buffer.getvalue())


def write_study_picture(path: Path | str, summary: pl.DataFrame) -> None:
    """Draw a summary: NEES with its standard error, coverage, and rms errors.

    Raises
    ------
    InputError
        No PNG, SVG or PDF, no way to write it, or no matplotlib.
    """
    path = path_of(path)
    require_writable(path)
    try:
        from matplotlib.figure import Figure
    except ImportError as error:
        expected = "pip install 'handlaser-gtsam[plots]'"
        raise InputError("no matplotlib, which draws pictures", expected) from error
    names = [f"{row['scene']}, {row['treatment']}" for row in summary.iter_rows(named=True)]
    figure = Figure(figsize=(11.0, 1.6 + 0.35 * len(names)), layout="constrained")
    axes = figure.subplots(1, len(PANELS), sharey=True)
    for axis, (column, title) in zip(axes, PANELS.items(), strict=True):
        errors = summary["standard_error"].fill_null(0.0) if column == "nees" else None
        axis.errorbar(summary[column], names, xerr=errors, fmt="o", capsize=3)
        axis.set_title(title, fontsize=9)
        axis.grid(axis="x", alpha=0.4)
    axes[0].axvline(1.0, color="green", alpha=0.5)
    axes[1].axvline(95.0, color="green", alpha=0.5)
    axes[0].invert_yaxis()
    try:
        figure.savefig(path)
    except ValueError as error:  # a kind of picture that matplotlib does not know
        raise InputError(f"the picture {path.name}", "a PNG, SVG or PDF file", path) from error
