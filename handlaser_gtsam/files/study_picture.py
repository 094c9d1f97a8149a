"""A study as a picture: honesty and accuracy of every scene and treatment."""

from pathlib import Path

import polars as pl

from ..errors import InputError
from .writing import path_of, require_writable

BAND = (0.9, 1.1)
"""A NEES a degree of freedom within is drawn as honest."""
KINDS = (".png", ".svg", ".pdf")


def write_study_picture(path: Path | str, summary: pl.DataFrame) -> None:
    """Draw a summary: NEES with its standard error, coverage, and rms errors.

    Raises
    ------
    InputError
        No PNG, SVG or PDF, no way to write it, or no matplotlib.
    """
    path = path_of(path)
    if path.suffix.lower() not in KINDS:
        raise InputError(f"a picture {path.suffix or 'without ending'}", "png, svg or pdf", path)
    require_writable(path)
    try:
        from matplotlib.figure import Figure
    except ImportError as error:
        expected = "pip install 'handlaser-gtsam[plots]'"
        raise InputError("no matplotlib, which draws pictures", expected) from error
    names = [f"{row['scene']}, {row['treatment']}" for row in summary.iter_rows(named=True)]
    figure = Figure(figsize=(11.0, 1.6 + 0.35 * len(names)), layout="constrained")
    axes = figure.subplots(1, 4, sharey=True)
    places = range(len(names))
    for axis, (column, title) in zip(
        axes,
        (
            ("nees", "NEES a degree of freedom"),
            ("coverage", "coverage of 95 % intervals, %"),
            ("location_mm", "rms error of r, mm"),
            ("direction_deg", "rms error of v, deg"),
        ),
        strict=True,
    ):
        values = summary[column].fill_null(float("nan")).to_numpy()
        errors = summary["standard_error"].fill_null(0.0) if column == "nees" else None
        axis.errorbar(values, places, xerr=errors, fmt="o", capsize=3)
        axis.set_title(title, fontsize=9)
        axis.grid(axis="x", alpha=0.4)
    axes[0].axvspan(*BAND, alpha=0.15, color="green")
    axes[1].axvline(95.0, color="green", alpha=0.5)
    axes[0].set_yticks(list(places), names)
    axes[0].invert_yaxis()
    figure.savefig(path)
