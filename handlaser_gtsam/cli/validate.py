"""handlaser validate: does a calibration predict what it has not seen; does an old one still hold."""

import math
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ..errors import InputError, SolverError
from .answer import Answer, working
from .options import Given, JsonOption, Model, RecordingArgument, Seed, read_stated
from .stopping import Exit

if TYPE_CHECKING:
    from ..data.recording import Recording
    from ..data.survey import Survey
    from ..estimation.options import CalibrationOptions
    from ..files.rig_toml import Rig


def validate(
    recording: RecordingArgument,
    given: Given,
    model: Model,
    calibration: Path | None = None,
    hold_out: Path | None = None,
    splits: Annotated[int, typer.Option(min=0)] = 5,
    seed: Seed = 0,
    json_: JsonOption = False,
) -> None:
    r"""Leave planes and stations out of RECORDING and predict them; or test a calibration on it.

    Exit codes: 0 good; 2 bad input; 3 no calibration, or, of sensors of many rays, SciPy finds another
    one; 4 not usable: outside the limits of the rig file (its rms holds for planes held out, too), a
    plane held out contradicts the beams found without it (1 in 100 good recordings exits so), a
    systematic error larger than what the result states; with --calibration or --hold-out, the
    calibration does not hold (p below 0.001).

    Parameters
    ----------
    recording, given, model
    calibration : Path, optional
        Test this old calibration, JSON, on RECORDING: does it still hold? Of the other options only
        noise, sensor and exact poses count then. Other sensors are calibrated again and compared.
    hold_out : Path, optional
        Test the calibration of RECORDING on this other recording.
    splits : int
        Random 70/30 splits.
    seed : int
        Of the splits.
    json_ : bool

    Examples
    --------
    handlaser validate recording.csv --rig rig.toml
    handlaser validate recording.csv \
        --calibration calibration.json
    """
    from ..data.survey import Survey

    with working():
        rig = given.read()
        if calibration is not None and hold_out is not None:
            raise InputError("--calibration and --hold-out", "one of the two")
        against = calibration is not None or hold_out is not None
        read, rig = read_stated(rig, recording, model.stated())
        if isinstance(read, Survey) and against:
            answer = _tested_survey(read, rig, calibration)
        elif isinstance(read, Survey):
            answer = validated(read, rig, None, splits, seed)
        elif against:
            answer = _tested(read.recording, rig, model.options(rig), calibration, hold_out)
        else:
            answer = validated(read.recording, rig, model.options(rig), splits, seed)
    answer.give(json=json_)


def validated(
    recording: "Recording | Survey",
    rig: "Rig",
    options: "CalibrationOptions | None",
    splits: int,
    seed: int,
) -> Answer:
    """Validate by leaving planes, or other targets, and stations out; a survey has no options."""
    import numpy as np

    from ..files.validation_json import validation_text
    from ..validation import validate as validating
    from ..validation.validation import DISAGREES, verdict_of_validation
    from .answer import text_width
    from .words import validation_lines

    rng = np.random.default_rng(seed)
    result = validating.validate(recording, rig.noise, options, splits=splits, rng=rng)
    judged = verdict_of_validation(result, rig.limits)
    failure = None
    if not judged.usable:
        unsolved = result.calibration.status != "converged"
        unsolved |= any(one.code == DISAGREES for one in judged.causes)
        failure = Exit.UNDETERMINED if unsolved else Exit.NOT_USABLE, judged.sentence
    lines = validation_lines(result, judged, text_width())
    return Answer(validation_text(result, judged), lines, failure=failure)


def _tested_survey(survey: "Survey", rig: "Rig", old: Path | None) -> Answer:
    """Test an old calibration on a survey."""
    from ..files.calibration_reading import SurveyFile, read_calibration
    from ..files.validation_json import survey_hold_out_text
    from ..model.distributions import p_words
    from ..quantities import IN_DEG, IN_MM
    from ..validation.other_survey import hold_out_survey
    from .words import hold_out_lines

    if old is None:  # the tables of points are those of the rig file
        expected = "`validate OTHER --rig ITS_RIG --calibration RESULT`, the result of `calibrate`"
        raise InputError("--hold-out with sensors of many rays or other targets", expected)
    file = read_calibration(old)
    if not isinstance(file, SurveyFile):
        expected = "the result of a survey, with sensors of many rays or other targets"
        raise InputError("a calibration of beams before planes", expected, old)
    found = hold_out_survey(file.placed(), survey, rig.noise)
    failure = None
    if not found.holds:
        words = "; ".join(
            f"{one.subject} sits {math.hypot(*one.shift) * IN_MM:.2g} mm and "
            f"{one.turn * IN_DEG:.2g} deg from where it was"
            for one in found.moved
        )
        failure = (
            Exit.NOT_USABLE,
            f"the calibration does not hold ({p_words(found.p_value)}): {words}: look for a sensor "
            "that was knocked or moved, and calibrate again",
        )
    lines = hold_out_lines(found, "survey_hold_out")
    return Answer(survey_hold_out_text(found), lines, survey.warnings, failure)


def _tested(
    recording: "Recording",
    rig: "Rig",
    options: "CalibrationOptions",
    old: Path | None,
    other: Path | None,
) -> Answer:
    """Test an old calibration on `recording`, or its own calibration on another one."""
    from ..data.noise import POSE_SIGMAS
    from ..files.calibration_reading import read_mounts
    from ..files.input_reading import read_with
    from ..files.validation_json import hold_out_text
    from ..model.distributions import p_words
    from ..model.sensor_limits import within
    from ..pipeline import calibrate
    from ..results.messages import said
    from ..results.mounts import Mounts
    from ..validation.other_recording import hold_out
    from .words import hold_out_lines

    noise, exact = rig.noise, dict.fromkeys(POSE_SIGMAS, 0.0)
    if options.poses == "exact":
        noise = replace(noise, pose_covariance=None, **exact)
    if old is not None:
        mounts = read_mounts(old)
    else:
        calibration = calibrate(recording, rig.noise, options)
        if calibration.status != "converged":
            raise SolverError(calibration.message)
        mounts = Mounts.of(calibration)
        noise = calibration.noise(noise) if calibration.noise_estimate else noise
        recording = read_with(rig, other or Path())[0].recording
    found = hold_out(mounts, within(recording, rig.sensor), noise, explain=True)
    failure = None
    if not found.holds:
        likely = "; or ".join(one.message for one in found.explained_by)
        words = f"the calibration does not hold ({p_words(found.p_value)})"
        if not found.fits:
            words = f"the readings fit no beams, by {found.misfit:.0f} times what the noise says"
        failure = Exit.NOT_USABLE, f"{words}: {likely or said('unexplained')}"
    return Answer(hold_out_text(found), hold_out_lines(found), recording.warnings, failure)
