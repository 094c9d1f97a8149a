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
            lines += _advice(read, known, determined=failure is None)
    warnings = [f"WARNING: {warning}" for warning in read.warnings]
    show = partial(print_wrapped, lines)
    Answer(check_text(found), show, warnings, failure).give(json=json_)


def _advice(recording: "Recording", rig: "Rig", *, determined: bool) -> list[str]:
    """Return in words the next best stations after a calibration, or the stations that are missing.

    Nothing where there is no calibration, or the rig file has no bounds.
    """
    from ..planning.advice import advice_lines, missing_stations, next_stations

    if determined:
        from ..estimation.options import CalibrationOptions
        from ..pipeline import calibrate

        found = calibrate(recording, rig.noise, CalibrationOptions(sensor=rig.sensor))
        plan = next_stations(found, rig.sensor, rig.workspace, rig.goal)
    else:
        plan = missing_stations(
            recording, rig.bounds, rig.sensor, rig.workspace, rig.noise, rig.goal
        )
    return [] if plan is None else advice_lines(plan)
