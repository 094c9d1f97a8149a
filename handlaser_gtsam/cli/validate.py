"""handlaser validate: does a calibration predict what it has not seen; does an old one still hold."""

import sys
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .choices import PosesChoice, RangeErrorChoice

if TYPE_CHECKING:
    from ..data.recording import Recording
    from ..estimation.options import CalibrationOptions
    from ..files.rig_toml import Rig
    from ..validation.hold_out import HoldOut

FAILED = 4


def validate(
    recording: Annotated[Path, typer.Argument(help="Recording, CSV.", show_default=False)],
    rig: Annotated[Path | None, typer.Option(help="Rig file, TOML: noise, sensor, limits.")] = None,
    calibration: Annotated[
        Path | None,
        typer.Option(
            help="Test this old calibration, JSON, on RECORDING: does it still hold? Of the other "
            "options only noise, sensor and exact poses count then."
        ),
    ] = None,
    hold_out: Annotated[
        Path | None, typer.Option(help="Test the calibration of RECORDING on this other recording.")
    ] = None,
    range_error: Annotated[
        RangeErrorChoice,
        typer.Option(help="Range-error terms; auto: k1 and k2 under a prior of learned scales."),
    ] = RangeErrorChoice.auto,
    poses: Annotated[
        PosesChoice,
        typer.Option(
            help="How errors of the hand poses count; auto: pose sigmas that are not given are "
            "estimated; exact: the robot is taken to make no errors."
        ),
    ] = PosesChoice.auto,
    range_sigma_mm: Annotated[
        float | None,
        typer.Option(help="Standard deviation of a reading, mm; estimated if not given."),
    ] = None,
    pose_translation_sigma_mm: Annotated[
        float | None,
        typer.Option(help="Sigma of the hand position an axis, mm; estimated if not given."),
    ] = None,
    pose_rotation_sigma_deg: Annotated[
        float | None,
        typer.Option(
            help="Sigma of the hand rotation about each axis, deg; estimated if not given."
        ),
    ] = None,
    incidence_sigma_mm: Annotated[
        float | None,
        typer.Option(help="Added to a reading's sigma times the tangent of the incidence, mm."),
    ] = None,
    estimate_noise: Annotated[
        bool,
        typer.Option(
            "--estimate-noise",
            help="Estimate the sigmas of ranges and poses even where they are given.",
        ),
    ] = False,
    range_sigma_by_beam: Annotated[
        bool,
        typer.Option("--range-sigma-by-beam", help="Estimate the range sigma of each beam."),
    ] = False,
    range_mm: Annotated[
        tuple[float, float] | None,
        typer.Option(metavar="MIN MAX", help="Range of the sensor, mm: --range-mm 0 30."),
    ] = None,
    max_incidence_deg: Annotated[
        float | None, typer.Option(help="Largest angle between beam and plane normal, deg.")
    ] = None,
    splits: Annotated[int, typer.Option(min=0, help="Random 70/30 splits.")] = 5,
    seed: Annotated[int, typer.Option(min=0, help="Of the splits.")] = 0,
    json_: Annotated[
        bool, typer.Option("--json", help="Print the result as JSON, and nothing else.")
    ] = False,
) -> None:
    """Leave planes and stations out of RECORDING and predict them; or test a calibration on it.

    Exit codes: 0 good; 2 bad input; 3 no calibration; 4 not usable: outside the limits of the rig
    file (its rms holds for planes left out, too), a plane left out contradicts the beams found without
    it (1 in 100 good recordings exits so), a systematic error larger than what the result states; with
    --calibration or --hold-out, the calibration does not hold (p below 0.001).
    """
    from ..errors import InputError
    from ..estimation.options import CalibrationOptions
    from ..files.recording_csv import read_recording
    from .settings import settings_of

    if calibration is not None and hold_out is not None:
        raise InputError("--calibration and --hold-out", "one of the two")
    numbers = (
        range_sigma_mm,
        pose_translation_sigma_mm,
        pose_rotation_sigma_deg,
        incidence_sigma_mm,
    )
    settings = settings_of(rig, numbers, range_mm, max_incidence_deg)
    options = CalibrationOptions(
        range_error.value,
        poses=poses.value,
        range_sigma_by_beam=range_sigma_by_beam,
        estimate_noise=estimate_noise,
        sensor=settings.sensor,
    )
    table = read_recording(recording, settings.sensor)
    if calibration is None and hold_out is None:
        _validate(table, settings, options, (splits, seed), json_)
        return
    _test(table, settings, options, (calibration, hold_out), json_)


def _validate(
    recording: "Recording",
    settings: "Rig",
    options: "CalibrationOptions",
    splits: tuple[int, int],
    json_: bool,
) -> None:
    import numpy as np
    from rich.console import Console
    from rich.progress import Progress

    from ..files.validation_json import validation_text
    from ..validation.leave_out import validate as run
    from ..validation.verdict import verdict_of_validation
    from .validation_tables import validation_lines

    planes = len(recording.plane_names)
    total = 2 + splits[0] + (planes if planes > 1 else 0)
    with Progress(console=Console(stderr=True), transient=True, disable=json_) as bar:
        task = bar.add_task("calibrating", total=total)
        result = run(
            recording,
            settings.noise,
            options,
            splits=splits[0],
            rng=np.random.default_rng(splits[1]),
            step=lambda name: bar.update(task, description=name, advance=1),
        )
    judged = verdict_of_validation(result, recording, settings.limits)
    if json_:
        sys.stdout.write(validation_text(result))
    else:
        _show(validation_lines(result, judged))
    if not judged.usable:
        print(f"handlaser: {judged.sentence}", file=sys.stderr)
        raise typer.Exit(FAILED)


def _show(lines: Iterable[str]) -> None:
    from ..results.lines import wrapped

    for line in lines:
        print("\n".join(wrapped(line)))


def _test(
    recording: "Recording",
    settings: "Rig",
    options: "CalibrationOptions",
    files: tuple[Path | None, Path | None],
    json_: bool,
) -> None:
    """Test an old calibration on `recording`, or its own calibration on another one."""
    from ..files.mounts_json import read_mounts
    from ..files.recording_csv import read_recording
    from ..files.validation_json import hold_out_text
    from ..model.sensor import within
    from ..pipeline import calibrate
    from ..results.mounts import Mounts
    from ..results.significance import SINGLE_LEVEL
    from ..validation.hold_out import hold_out
    from .validation_tables import hold_out_lines

    old, other = files
    noise = settings.noise
    if options.poses == "exact":
        noise = replace(
            noise, pose_translation_sigma=0.0, pose_rotation_sigma=0.0, pose_covariance=None
        )
    if old is not None:
        mounts, tested = read_mounts(old), recording
    else:
        found = calibrate(recording, settings.noise, options)
        if found.status != "converged":
            print(f"handlaser: {found.message}", file=sys.stderr)
            raise typer.Exit(3)
        mounts, tested = Mounts.of(found), read_recording(other or Path(), settings.sensor)
        noise = found.noise(noise) if found.noise_estimate else noise
    for warning in tested.warnings:
        print(f"WARNING: {warning}", file=sys.stderr)
    result: HoldOut = hold_out(mounts, within(tested, settings.sensor), noise)
    if json_:
        sys.stdout.write(hold_out_text(result))
    else:
        _show(hold_out_lines(result))
    if result.p_value < SINGLE_LEVEL:
        moved = [beam.name for beam in result.beams if beam.p_value < SINGLE_LEVEL]
        print(
            f"handlaser: the calibration does not hold (p {result.p_value:.1e}); moved alone would "
            f"explain it: beam {' or '.join(moved) or 'none'}; calibrate again",
            file=sys.stderr,
        )
        raise typer.Exit(FAILED)
