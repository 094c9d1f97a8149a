"""handlaser validate: does a calibration predict what it has not seen; does an old one still hold."""

from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .answer import Answer, print_wrapped
from .exit_codes import NOT_USABLE
from .options import Given, JsonOption, Model, RecordingArgument
from .progress_line import Working

if TYPE_CHECKING:
    from ..data.noise import Noise
    from ..data.recording import Recording
    from ..estimation.options import CalibrationOptions
    from ..files.rig_toml import Rig
    from ..results.mounts import Mounts


@dataclass(frozen=True, slots=True)
class Against:
    """What is tested instead of planes that are held out."""

    calibration: Annotated[
        Path | None,
        typer.Option(
            help="Test this old calibration, JSON, on RECORDING: does it still hold? Of the other "
            "options only noise, sensor and exact poses count then."
        ),
    ] = None
    hold_out: Annotated[
        Path | None, typer.Option(help="Test the calibration of RECORDING on this other recording.")
    ] = None


@dataclass(frozen=True, slots=True)
class Splits:
    """How stations are held out."""

    splits: Annotated[int, typer.Option(min=0, help="Random 70/30 splits.")] = 5
    seed: Annotated[int, typer.Option(min=0, help="Of the splits.")] = 0


def validate(
    recording: RecordingArgument,
    against: Against,
    given: Given,
    model: Model,
    splits: Splits,
    json_: JsonOption = False,
) -> None:
    """Leave planes and stations out of RECORDING and predict them; or test a calibration on it.

    Exit codes: 0 good; 2 bad input; 3 no calibration; 4 not usable: outside the limits of the rig
    file (its rms holds for planes held out, too), a plane held out contradicts the beams found without
    it (1 in 100 good recordings exits so), a systematic error larger than what the result states; with
    --calibration or --hold-out, the calibration does not hold (p below 0.001).
    """
    with Working():
        answer = _answered(recording, against, given.read(), model, splits)
    answer.give(json=json_)


def _answered(path: Path, against: Against, rig: "Rig", model: Model, splits: Splits) -> Answer:
    from ..errors import InputError
    from ..files.rig_reading import read_with

    if against.calibration is not None and against.hold_out is not None:
        raise InputError("--calibration and --hold-out", "one of the two")
    options = model.options(rig)
    report, rig = read_with(rig, path)
    recording = report.recording
    if against == Against():
        return _validated(recording, rig, options, splits)
    return _tested(recording, rig, options, against)


def _validated(
    recording: "Recording", rig: "Rig", options: "CalibrationOptions", splits: Splits
) -> Answer:
    """Validate by leaving planes and stations out."""
    import numpy as np

    from ..files.validation_json import validation_text
    from ..validation import leave_out
    from .validation_tables import validation_lines
    from .width import text_width

    rng = np.random.default_rng(splits.seed)
    result = leave_out.validate(recording, rig.noise, options, splits=splits.splits, rng=rng)
    judged = leave_out.verdict_of_validation(result, rig.limits)
    lines = validation_lines(result, judged, text_width())
    failure = None if judged.usable else (NOT_USABLE, judged.sentence)
    return Answer(validation_text(result), partial(print_wrapped, lines), failure=failure)


def _tested(
    recording: "Recording", rig: "Rig", options: "CalibrationOptions", against: Against
) -> Answer:
    """Test an old calibration on `recording`, or its own calibration on another one."""
    from ..files.calibration_reading import read_mounts
    from ..files.rig_reading import read_with
    from ..files.validation_json import hold_out_text
    from ..model.sensor import within
    from ..results.significance import SINGLE_LEVEL
    from ..validation.hold_out import hold_out
    from .validation_tables import hold_out_lines

    noise = rig.noise
    if options.poses == "exact":
        noise = replace(
            noise, pose_translation_sigma=0.0, pose_rotation_sigma=0.0, pose_covariance=None
        )
    if against.calibration is not None:
        mounts = read_mounts(against.calibration)
    else:
        mounts, noise = _mounts(recording, rig, options, noise)
        recording = read_with(rig, against.hold_out or Path())[0].recording
    found = hold_out(mounts, within(recording, rig.sensor), noise)
    failure = None
    if found.p_value < SINGLE_LEVEL:
        moved = [beam.name for beam in found.beams if beam.p_value < SINGLE_LEVEL]
        words = (
            f"the calibration does not hold (p {found.p_value:.1e}); moved alone would "
            f"explain it: beam {' or '.join(moved) or 'none'}; calibrate again"
        )
        failure = NOT_USABLE, words
    warnings = [f"WARNING: {warning}" for warning in recording.warnings]
    show = partial(print_wrapped, hold_out_lines(found))
    return Answer(hold_out_text(found), show, warnings, failure)


def _mounts(
    recording: "Recording", rig: "Rig", options: "CalibrationOptions", noise: "Noise"
) -> tuple["Mounts", "Noise"]:
    """Return the beams that a recording gives, and `noise` with what it says of that.

    Raises
    ------
    SolverError
        It gives no calibration.
    """
    from ..errors import SolverError
    from ..pipeline import calibrate
    from ..results.mounts import Mounts

    found = calibrate(recording, rig.noise, options)
    if found.status != "converged":
        raise SolverError(found.message)
    return Mounts.of(found), found.noise(noise) if found.noise_estimate else noise
