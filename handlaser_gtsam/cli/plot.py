"""handlaser plot: the figures of a report as pictures."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .answer import Answer, Working, wrote
from .options import Given, Model
from .stopping import UNDETERMINED

if TYPE_CHECKING:
    from ..files.calibration_file import CalibrationFile
    from ..results.calibration import Calibration


def plot(
    file: Annotated[Path, typer.Argument(metavar="FILE", show_default=False)],
    out: Annotated[Path, typer.Option(show_default=False)],
    given: Given,
    model: Model,
) -> None:
    r"""Draw the figures of a report as PNG files into a folder.

    Of a calibration that was written by --out, only the beams and their correlations: its file holds
    no residuals. All options but --out are of the calibration of a recording. Needs matplotlib: pip
    install 'handlaser-gtsam[plots]'.

    Exit codes: 0 good; 2 bad input; 3 no calibration: what can be drawn all the same is drawn.

    Parameters
    ----------
    file : Path
        Recording or log, which is calibrated; or a calibration, FILE.json.
    out : Path
        Folder for the pictures; made where it is missing.
    given, model

    Examples
    --------
    handlaser plot recording.csv --rig rig.toml \
        --out pictures
    handlaser plot calibration.json --out mounts
    """
    from ..files.calibration_reading import read_calibration
    from ..files.report.options import ReportOptions
    from ..files.report.pictures import write_pictures
    from ..files.rig_reading import read_with
    from ..pipeline import calibrate

    found: Calibration | CalibrationFile
    with Working():
        rig = given.read()
        if file.suffix.lower() == ".json":
            found = read_calibration(file)
        else:
            report, rig = read_with(rig, file)
            found = calibrate(report.recording, rig.noise, model.options(rig))
        files = write_pictures(out, found, ReportOptions(rig))
    failure = None if found.status == "converged" else (UNDETERMINED, found.message)
    warnings = [f"WARNING: {one.message}" for one in found.warnings]
    Answer("", wrote(*files), warnings, failure).give(json=False)
