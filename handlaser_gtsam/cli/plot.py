"""handlaser plot: the figures of a report as pictures."""

from pathlib import Path
from typing import Annotated

import typer

from .answer import Answer, working, wrote
from .options import Given, Model, RecordingArgument
from .stopping import Exit


def plot(
    recording: RecordingArgument,
    out: Annotated[Path, typer.Option(show_default=False)],
    given: Given,
    model: Model,
) -> None:
    r"""Draw the figures of a report into a folder: PNG files, and SVG of views in space.

    The recording is calibrated for it. Needs matplotlib: pip install 'handlaser-gtsam[plots]'.

    Exit codes: 0 good; 2 bad input; 3 no calibration: what can be drawn all the same is drawn.

    Parameters
    ----------
    out : Path
        Folder for the pictures; made where it is missing.
    given, model

    Examples
    --------
    handlaser plot recording.csv --rig rig.toml \
        --out pictures
    """
    from ..files.input_reading import read_with
    from ..files.report.options import ReportOptions
    from ..files.report.pictures import write_pictures
    from ..pipeline import calibrate

    with working():
        rig = given.read()
        report, rig = read_with(rig, recording)
        found = calibrate(report.recording, rig.noise, model.options(rig))
        files = write_pictures(out, found, ReportOptions(rig))
    failure = None if found.status == "converged" else (Exit.UNDETERMINED, found.message)
    Answer("", wrote(*files), found.warnings, failure).give(json=False)
