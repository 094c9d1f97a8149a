"""handlaser check: what the motion of a recording can determine, before anything is solved."""

from pathlib import Path
from typing import TYPE_CHECKING

from .answer import Answer, lines_read, working
from .options import JsonOption, RecordingArgument, read_stated
from .stopping import Exit

if TYPE_CHECKING:
    from ..data.recording import Recording
    from ..data.survey import Survey
    from ..files.rig_toml import Rig
    from ..planning.route import Plan
    from ..results.calibration import Calibration


def check(recording: RecordingArgument, rig: Path | None = None, json_: JsonOption = False) -> None:
    """Say which stations serve which unknown, and which motion is missing.

    Of sensors of many rays, other targets or relations: what the recording holds, and how well mounts
    would be known.

    Exit codes: 0 the motion determines everything, for beams and planes in general position, and for
    other targets where they stand; 2 bad input; 3 it leaves something open, or shots of sensors of many
    rays do not fit each other, or are not what is stated of them.

    Parameters
    ----------
    rig : Path, optional
        Rig file, TOML: how logs are written; with the sensor's range, the next best stations are named.

    Examples
    --------
    handlaser check recording.csv
    handlaser check recording.csv --rig rig.toml
    """
    from ..data.survey import Survey
    from ..files.rig_toml import known_rig

    with working():
        read, known = read_stated(known_rig(rig, {}), recording, [])
        if isinstance(read, Survey):
            answer = _of_survey(read, known)
        else:
            answer = _of_beams(read.recording, known, advise=rig is not None and not json_)
    answer.give(json=json_)


def _of_survey(survey: "Survey", rig: "Rig") -> Answer:
    """Check a survey: what it holds, and what its motion leaves undetermined."""
    from ..files.calibration_writing import check_text
    from ..results.survey_check import check_lines, check_survey

    found = check_survey(survey, rig.noise)
    failure = (Exit.UNDETERMINED, found.open_sentence) if found.undetermined else None
    if failure is not None and not found.exactly:
        failure = failure[0], f"{failure[1]}. Some of it is undetermined at this noise only"
    if found.doubt is not None:
        failure = Exit.UNDETERMINED, found.doubt
    warnings = [one for one in found.warnings if one.message not in (found.doubt or "")]
    lines = [*check_lines(found), *lines_read("read", survey.lines)]
    return Answer(check_text(found, survey.lines), lines, warnings, failure)


def _of_beams(read: "Recording", rig: "Rig", *, advise: bool) -> Answer:
    """Check a recording of beams before planes; name the next stations where that is asked for."""
    from ..files.calibration_writing import check_text
    from ..observability.motion import check_motion, lemma_words
    from ..observability.wording import open_sentence

    found = check_motion(read)
    lines = [f"{found.readings} readings for {found.unknowns} unknowns, without range errors"]
    lines += lemma_words(found, read.beam_names)
    failure = None
    if found.undetermined:
        failure = Exit.UNDETERMINED, open_sentence(found.undetermined, found.advice)
    else:
        lines.append("the motion determines everything, for beams and planes in general position")
    if advise:
        from ..estimation.options import CalibrationOptions
        from ..pipeline import calibrate
        from ..planning.advice import advice_lines

        known = None
        if failure is None:
            known = calibrate(read, rig.noise, CalibrationOptions(sensor=rig.sensor))
        plan = advised(read, rig, known)
        lines += [] if plan is None else advice_lines(plan)
    return Answer(check_text(found), lines, read.warnings, failure)


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
