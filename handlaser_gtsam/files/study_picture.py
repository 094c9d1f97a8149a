"""A study as a picture: honesty and accuracy of every scene and treatment."""

from pathlib import Path

import polars as pl

from ..errors import InputError
from .writing import path_of, require_writable

PANELS = {
    "nees": "NEES a degree of freedom",
    "coverage": "coverage of 95 % intervals, %",
    "location_mm": "rms error of r, mm",
    "direction_deg": "rms error of v, deg",
}
"""Columns of the summary that are drawn, and their titles."""


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
