"""handlaser check: what the motion of a recording can determine, before anything is solved."""

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .answer import Answer, print_wrapped
from .options import JsonOption, RecordingArgument
from .progress_line import Working
from .stopping import UNDETERMINED

if TYPE_CHECKING:
    from ..data.recording import Recording
    from ..files.rig_toml import Rig
    from ..planning.route import Plan
    from ..results.calibration import Calibration


RigOption = Annotated[
    Path | None,
    typer.Option(
        help="Rig file, TOML: how logs are written; with the sensor's range, the next best stations "
        "are named."
    ),
]


def check(recording: RecordingArgument, rig: RigOption = None, json_: JsonOption = False) -> None:
    """Say which stations serve which unknown, and which motion is missing.

    Exit codes: 0 the motion determines everything, for beams and planes in general position; 2 bad
    input; 3 it leaves something open.
    """
    from ..files.calibration_json import check_text
    from ..files.rig_reading import read_with
    from ..files.rig_toml import known_rig
    from ..observability.motion import check_motion, lemma_words

    with Working():
        report, known = read_with(known_rig(rig, {}), recording)
        read = report.recording
        found = check_motion(read)
        lines = [f"{found.readings} readings for {found.unknowns} unknowns, without range errors"]
        lines += lemma_words(found, read.beam_names)
        failure = None
        if found.undetermined:
            words = f"the motion leaves open {'; '.join(found.undetermined)}. "
            failure = UNDETERMINED, f"{words}To determine it: {'; '.join(found.advice)}"
        else:
            lines.append(
                "the motion determines everything, for beams and planes in general position"
            )
        if rig is not None and not json_:
            from ..planning.advice import advice_lines

            plan = advised(read, known, _calibrated(read, known) if failure is None else None)
            lines += [] if plan is None else advice_lines(plan)
    warnings = [f"WARNING: {warning}" for warning in read.warnings]
    show = partial(print_wrapped, lines)
    Answer(check_text(found), show, warnings, failure).give(json=json_)


def _calibrated(recording: "Recording", rig: "Rig") -> "Calibration":
    from ..estimation.options import CalibrationOptions
    from ..pipeline import calibrate

    return calibrate(recording, rig.noise, CalibrationOptions(sensor=rig.sensor))


def advised(recording: "Recording", rig: "Rig", found: "Calibration | None") -> "Plan | None":
    """Return the next best stations, or those that are missing where nothing is determined yet.

    None where nothing can be said, as where the rig file has no bounds.
    """
    from ..planning.advice import missing_stations, next_stations

    if found is None or found.status == "unobservable":
        return missing_stations(
            recording, rig.bounds, rig.sensor, rig.workspace, rig.noise, rig.goal
        )
    return next_stations(found, rig.sensor, rig.workspace, rig.goal)
