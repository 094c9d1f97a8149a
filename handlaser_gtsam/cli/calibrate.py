"""handlaser calibrate: a recording becomes a calibrated rig."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .choices import LossChoice, OutliersChoice, PosesChoice, RangeErrorChoice

if TYPE_CHECKING:
    from ..data.recording import Recording
    from ..results.calibration import Calibration
    from ..results.verdict import Verdict
    from ..validation.cross_check import CrossCheck
    from .incremental import PlaneByPlane

UNDETERMINED, NOT_USABLE, INTERRUPTED = 3, 4, 130
DISAGREEMENT = 0.01
"""Solvers that differ by more standard deviations than this have not found the same optimum."""


def calibrate(
    recording: Annotated[Path, typer.Argument(help="Recording, CSV.", show_default=False)],
    rig: Annotated[Path | None, typer.Option(help="Rig file, TOML: noise, sensor, limits.")] = None,
    range_error: Annotated[
        RangeErrorChoice,
        typer.Option(
            help="Terms of the true range d + k1 d + k2 d^2 of a reading d; auto: both, under a prior "
            "of zero mean whose scales are learned from all beams."
        ),
    ] = RangeErrorChoice.auto,
    outliers: Annotated[
        OutliersChoice,
        typer.Option(
            help="Leave out, and list, readings that the others contradict; or keep them."
        ),
    ] = OutliersChoice.reject,
    loss: Annotated[
        LossChoice, typer.Option(help="Loss of the final estimate, reading by reading.")
    ] = LossChoice.gaussian,
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
    poses: Annotated[
        PosesChoice,
        typer.Option(
            help="How errors of the hand poses count; auto: marginalised, pose sigmas that are not "
            "given are estimated; exact: the robot is taken to make no errors, as with sigmas of zero."
        ),
    ] = PosesChoice.auto,
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
    at_range_mm: Annotated[
        float | None,
        typer.Option(
            help="Working distance at which the laser spot's error is stated; default: median reading."
        ),
    ] = None,
    range_mm: Annotated[
        tuple[float, float] | None,
        typer.Option(metavar="MIN MAX", help="Range of the sensor, mm: --range-mm 0 30."),
    ] = None,
    max_incidence_deg: Annotated[
        float | None, typer.Option(help="Largest angle between beam and plane normal, deg.")
    ] = None,
    out: Annotated[
        Path | None, typer.Option(readable=False, help="Write the result to this JSON file.")
    ] = None,
    cross_check: Annotated[
        bool, typer.Option("--cross-check", help="Solve again with SciPy and compare.")
    ] = False,
    incremental: Annotated[
        bool,
        typer.Option(
            "--incremental",
            help="Add plane by plane, show what each teaches, and compare with all at once.",
        ),
    ] = False,
    json_: Annotated[
        bool, typer.Option("--json", help="Print the result as JSON, and nothing else.")
    ] = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Print no tables.")] = False,
    verbose: Annotated[
        bool, typer.Option("--verbose", "-v", help="Print all tables: planes, intervals, spots.")
    ] = False,
) -> None:
    """Find the mount of every beam and every plane in RECORDING, with covariances.

    Exit codes: 0 good; 1 a bug; 2 bad input; 3 no calibration: the recording does not determine it, or
    the solver gave up; 4 not usable: outside the limits of the rig file, or with a systematic error
    larger than what the result states; 130 stopped by Ctrl-C.
    """
    from ..errors import InputError
    from ..estimation.options import CalibrationOptions
    from ..files.calibration_json import calibration_text
    from ..files.recording_csv import read_recording
    from ..files.writing import require_writable, same_file, write_text
    from ..pipeline import calibrate as run
    from ..results.verdict import verdict
    from ..validation import cross_check as checking
    from .settings import reading_of, settings_of

    if out is not None:
        for source in (recording, rig):
            if source is not None and same_file(out, source):
                raise InputError("the input itself as --out", "another file to write to", out)
        require_writable(out)
    reading = reading_of(at_range_mm)
    numbers = (
        range_sigma_mm,
        pose_translation_sigma_mm,
        pose_rotation_sigma_deg,
        incidence_sigma_mm,
    )
    settings = settings_of(rig, numbers, range_mm, max_incidence_deg)
    table = read_recording(recording, settings.sensor)
    options = CalibrationOptions(
        range_error.value,
        outliers.value,
        loss.value,
        poses.value,
        range_sigma_by_beam,
        estimate_noise,
        sensor=settings.sensor,
    )
    fed = None
    if incremental:
        from .incremental import plane_by_plane

        fed = plane_by_plane(table, settings.noise, options, quiet=json_ or quiet)
        result, table = fed.result, fed.recording
    else:
        result = run(table, settings.noise, options)
    text = calibration_text(result, reading)
    if out is not None:
        write_text(out, text)
    check = None
    if cross_check and result.status == "converged":
        check = checking.cross_check(result, table)
    judged = verdict(result, table, settings.limits, reading)
    if json_:
        sys.stdout.write(text)
    elif not quiet:
        _show(result, table, judged, (check, out, fed), verbose=verbose)
    _finish(result, judged, check, fed, aloud=json_ or quiet)


def _show(
    result: "Calibration",
    recording: "Recording",
    judged: "Verdict",
    beside: tuple["CrossCheck | None", Path | None, "PlaneByPlane | None"],
    *,
    verbose: bool,
) -> None:
    from ..results.lines import WIDTH, wrapped
    from ..results.screen import screen_lines
    from ..text import printable
    from .tables import TableConsole, calibration_tables, cross_check_line

    check, out, fed = beside
    closing = [] if check is None else wrapped(cross_check_line(check), 2)
    closing += [] if out is None else [f"wrote {printable(str(out))}"]
    width = None if sys.stdout.isatty() else WIDTH
    console = TableConsole(highlight=False, markup=False, width=width)
    if verbose:
        for part in calibration_tables(result, recording, judged):
            text = "\n".join(wrapped(part)) if isinstance(part, str) else part
            console.print(text, soft_wrap=True)
    else:
        for line in screen_lines(result, recording, judged, closing=len(closing)):
            console.print(line, soft_wrap=True)
    if fed is not None:
        from .incremental import comparison_line, update_table

        console.print(update_table(fed))
        if fed.comparison is not None:
            console.print("\n".join(wrapped(comparison_line(fed.comparison))), soft_wrap=True)
    for line in closing:
        console.print(line, soft_wrap=True)


def _finish(
    result: "Calibration",
    judged: "Verdict",
    cross: "CrossCheck | None",
    fed: "PlaneByPlane | None",
    *,
    aloud: bool,
) -> None:
    """Say on stderr what went wrong, and leave with the exit code of the contract."""
    from .tables import cross_check_line

    if cross is not None and aloud:
        print(cross_check_line(cross), file=sys.stderr)
    for warning in result.warnings if aloud else ():
        if warning.message != result.message:
            print(f"WARNING: {warning}", file=sys.stderr)
    if result.status != "converged":
        print(f"handlaser: {result.message}", file=sys.stderr)
        raise typer.Exit(INTERRUPTED if result.interrupted else UNDETERMINED)
    if cross is not None and cross.largest > DISAGREEMENT:
        print(
            f"handlaser: SciPy disagrees by {cross.largest:.2g} standard deviations in "
            f"{cross.parameter}; expected the same optimum: do not use this calibration",
            file=sys.stderr,
        )
        raise typer.Exit(UNDETERMINED)
    if fed is not None and fed.comparison is not None and fed.comparison.largest > DISAGREEMENT:
        print(
            f"handlaser: plane by plane is {fed.comparison.largest:.2g} standard deviations from all "
            f"at once; expected the same optimum: do not use this calibration",
            file=sys.stderr,
        )
        raise typer.Exit(UNDETERMINED)
    if judged.exceeded:
        print(f"handlaser: outside the limits: {'; '.join(judged.exceeded)}", file=sys.stderr)
        raise typer.Exit(NOT_USABLE)
    if not judged.usable:
        print(f"handlaser: {judged.sentence}", file=sys.stderr)
        raise typer.Exit(NOT_USABLE)
