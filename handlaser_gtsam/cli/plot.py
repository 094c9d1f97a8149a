"""handlaser plot: the figures of a report as pictures."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .answer import Answer, print_wrapped
from .exit_codes import UNDETERMINED
from .options import Given, Model
from .progress_line import Working

if TYPE_CHECKING:
    from ..files.calibration_file import CalibrationFile
    from ..files.report.options import ReportOptions
    from ..files.rig_toml import Rig
    from ..results.calibration import Calibration

SourceArgument = Annotated[
    Path,
    typer.Argument(
        metavar="FILE",
        help="Recording or log, which is calibrated; or a calibration, FILE.json.",
        show_default=False,
    ),
]
OutOption = Annotated[
    Path,
    typer.Option(help="Folder for the pictures; made where it is missing.", show_default=False),
]


def plot(file: SourceArgument, out: OutOption, given: Given, model: Model) -> None:
    """Draw the figures of a report as PNG files into a folder.

    Of a calibration that was written by --out, only the beams and their correlations: its file holds
    no residuals. All options but --out are of the calibration of a recording. Needs matplotlib: pip
    install 'handlaser-gtsam[plots]'.

    Exit codes: 0 good; 2 bad input; 3 no calibration: what can be drawn all the same is drawn.
    """
    with Working():
        answer = _drawn(file, out, given.read(), model)
    answer.give(json=False)


def _drawn(path: Path, folder: Path, rig: "Rig", model: Model) -> Answer:
    from ..files.report.pictures import write_pictures
    from ..text import printable

    found, options = _calibration(path, rig, model)
    files = write_pictures(folder, found, options)
    lines = [f"wrote {printable(str(file))}" for file in files]
    failure = None if found.status == "converged" else (UNDETERMINED, found.message)
    warnings = [f"WARNING: {one.message}" for one in found.warnings]
    return Answer("", lambda: print_wrapped(lines), warnings, failure)


def _calibration(
    path: Path, rig: "Rig", model: Model
) -> "tuple[Calibration | CalibrationFile, ReportOptions]":
    """Return the calibration of a file, or the one that stands in it."""
    from ..files.report.options import ReportOptions

    if path.suffix.lower() == ".json":
        from ..files.calibration_reading import read_calibration

        return read_calibration(path), ReportOptions(rig)
    from ..files.rig_reading import read_with
    from ..pipeline import calibrate

    report, rig = read_with(rig, path)
    return calibrate(report.recording, rig.noise, model.options(rig)), ReportOptions(rig)
