"""handlaser check: what the motion of a recording can determine, before anything is solved."""

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .answer import Answer, print_wrapped
from .exit_codes import UNDETERMINED
from .options import JsonOption, RecordingArgument
from .progress_line import Working

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
    with Working():
        answer = _checked(recording, rig, json=json_)
    answer.give(json=json_)


def _checked(path: Path, rig: Path | None, *, json: bool) -> Answer:
    from ..files.calibration_json import check_text
    from ..files.rig_reading import read_with
    from ..files.rig_toml import known_rig
    from ..observability.motion import check_motion, lemma_words

    report, known = read_with(known_rig(rig, {}), path)
    recording = report.recording
    found = check_motion(recording)
    lines = [f"{found.readings} readings for {found.unknowns} unknowns, without range errors"]
    lines += lemma_words(found, recording.beam_names)
    failure = None
    if found.undetermined:
        words = f"the motion leaves open {'; '.join(found.undetermined)}. "
        failure = UNDETERMINED, f"{words}To determine it: {'; '.join(found.advice)}"
        lines += [] if rig is None or json else _missing(recording, known)
    else:
        lines.append("the motion determines everything, for beams and planes in general position")
        lines += [] if rig is None or json else _next(recording, known)
    warnings = [f"WARNING: {warning}" for warning in recording.warnings]
    return Answer(check_text(found), partial(print_wrapped, lines), warnings, failure)


def _missing(recording: "Recording", rig: "Rig") -> list[str]:
    """Return the stations that are missing in words; nothing where the rig file has no bounds."""
    from ..planning.advice import advice_lines, missing_stations

    plan = missing_stations(recording, rig.bounds, rig.sensor, rig.workspace, rig.noise, rig.goal)
    return [] if plan is None else advice_lines(plan)


def _next(recording: "Recording", rig: "Rig") -> list[str]:
    """Return the next best stations in words, after a calibration; nothing where there is none."""
    from ..estimation.options import CalibrationOptions
    from ..pipeline import calibrate
    from ..planning.advice import advice_lines, next_stations

    found = calibrate(recording, rig.noise, CalibrationOptions(sensor=rig.sensor))
    plan = next_stations(found, rig.sensor, rig.workspace, rig.goal)
    return [] if plan is None else advice_lines(plan)
