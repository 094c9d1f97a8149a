"""handlaser check: what the motion of a recording can determine, before anything is solved."""

from pathlib import Path

from .answer import UNDETERMINED, Answer
from .options import JsonOption, RecordingArgument
from .working import Working


def check(recording: RecordingArgument, json_: JsonOption = False) -> None:
    """Say which stations serve which unknown, and which motion is missing.

    Exit codes: 0 the motion determines everything, for beams and planes in general position; 2 bad
    input; 3 it leaves something open.
    """
    with Working():
        answer = _checked(recording)
    answer.give(json=json_)


def _checked(path: Path) -> Answer:
    from ..files.calibration_json import check_text
    from ..files.recording_csv import read_recording
    from ..observability.motion import check_motion, lemma_words

    recording = read_recording(path)
    found = check_motion(recording)
    lines = [f"{found.readings} readings for {found.unknowns} unknowns, without range errors"]
    lines += lemma_words(found, recording.beam_names)
    failure = None
    if found.undetermined:
        words = f"the motion leaves open {'; '.join(found.undetermined)}. "
        failure = UNDETERMINED, f"{words}To determine it: {'; '.join(found.advice)}"
    else:
        lines.append("the motion determines everything, for beams and planes in general position")
    warnings = [f"WARNING: {warning}" for warning in recording.warnings]
    return Answer(check_text(found), lambda: print("\n".join(lines)), warnings, failure)
