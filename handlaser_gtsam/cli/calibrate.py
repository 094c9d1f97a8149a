"""handlaser calibrate: a recording becomes a calibrated rig."""

import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .answer import Answer, print_wrapped
from .exit_codes import INTERRUPTED, NOT_USABLE, UNDETERMINED
from .options import (
    HOW,
    AtRangeOption,
    Given,
    JsonOption,
    Model,
    QuietOption,
    RecordingArgument,
    metres,
)
from .progress_line import Working

if TYPE_CHECKING:
    from ..data.recording import Recording
    from ..files.logs.report import LogReport
    from ..files.rig_toml import Rig
    from ..planning.route import Plan
    from ..results.calibration import Calibration
    from ..results.description.description import Description
    from ..results.verdict import Verdict
    from ..validation.cross_check import CrossCheck
    from .incremental import PlaneByPlane

DISAGREEMENT = 0.01
"""Solvers that differ by more standard deviations than this have not found the same optimum."""
LEAST_ADVICE = 5
"""Lines of the screen that the next best stations have at least; warnings come before more."""


OutliersChoice = StrEnum("OutliersChoice", {"reject": "reject", "keep": "keep"})
LossChoice = StrEnum(
    "LossChoice", {"gaussian": "gaussian", "huber": "huber", "cauchy": "cauchy", "tukey": "tukey"}
)


@dataclass(frozen=True, slots=True)
class Manner:
    """How it is calibrated, beside what `validate` takes as well."""

    outliers: Annotated[
        OutliersChoice,
        typer.Option(
            help="Leave out, and list, readings that the others contradict; or keep them.",
            rich_help_panel=HOW,
        ),
    ] = OutliersChoice.reject
    loss: Annotated[
        LossChoice,
        typer.Option(help="Loss of the final estimate, reading by reading.", rich_help_panel=HOW),
    ] = LossChoice.gaussian
    incremental: Annotated[
        bool,
        typer.Option(
            "--incremental",
            help="Add plane by plane, show what each teaches, and compare with all at once.",
            rich_help_panel=HOW,
        ),
    ] = False
    cross_check: Annotated[
        bool,
        typer.Option(
            "--cross-check", help="Solve again with SciPy and compare.", rich_help_panel=HOW
        ),
    ] = False


@dataclass(frozen=True, slots=True)
class Output:
    """What becomes of the result."""

    out: Annotated[
        Path | None, typer.Option(readable=False, help="Write the result to this JSON file.")
    ] = None
    report: Annotated[
        Path | None,
        typer.Option(readable=False, help="Write a report, one HTML page, to this file."),
    ] = None
    at_range_mm: AtRangeOption = None
    verbose: Annotated[
        bool, typer.Option("--verbose", "-v", help="Print all tables: planes, intervals, spots.")
    ] = False
    quiet: QuietOption = False
    json_: JsonOption = False
    report_date: Annotated[
        str | None,
        typer.Option(
            help="Date of the report, as 2026-03-31; default: that of the recording's file."
        ),
    ] = None

    @property
    def reading(self) -> float | None:
        """The reading of --at-range-mm in metres."""
        return metres(self.at_range_mm)

    def check(self, sources: tuple[Path | None, ...]) -> None:
        """Refuse files that cannot be written, or are one of the `sources` or each other."""
        from ..files.writing import require_outputs

        require_outputs({"--out": self.out, "--report": self.report}, sources)
        if self.report_date is not None:
            from ..files.report.options import iso_day

            iso_day(self.report_date)


@dataclass(frozen=True, slots=True)
class _Outcome:
    """A calibration, its JSON text, and what is said of it."""

    result: "Calibration"
    text: str
    verdict: "Verdict"
    check: "CrossCheck | None"
    fed: "PlaneByPlane | None"
    advice: "Plan | None"
    read: tuple[str, ...]


def calibrate(
    recording: RecordingArgument,
    given: Given,
    model: Model,
    manner: Manner,
    output: Output,
) -> None:
    """Find the mount of every beam and every plane in RECORDING, with covariances.

    Exit codes: 0 good; 1 a bug; 2 bad input; 3 no calibration: the recording does not determine it, or
    the solver gave up; 4 not usable: outside the limits of the rig file, or with a systematic error
    larger than what the result states; 130 stopped by Ctrl-C.
    """
    from ..data.survey import beyond_planes

    with Working():
        rig = given.read()
        output.check((recording, given.rig, *rig.log.files))
        if rig.survey is not None:
            answer = _of_survey(recording, rig, None, model, manner, output)
        else:
            log, rig = _read(recording, rig)
            if beyond_planes(log.recording.plane_names):
                answer = _of_survey(recording, rig, log.recording, model, manner, output)
            else:
                answer = _of_beams(recording, rig, log, model, manner, output, given.rig)
    answer.give(json=output.json_, quiet=output.quiet)


def _read(path: Path, rig: "Rig") -> "tuple[LogReport, Rig]":
    from ..files.rig_reading import read_stated

    return read_stated(rig, path)


def _of_survey(
    path: Path,
    rig: "Rig",
    recording: "Recording | None",
    model: Model,
    manner: Manner,
    output: Output,
) -> Answer:
    """Return the answer on sensors of many rays, targets that are no planes, and relations.

    Parameters
    ----------
    recording : Recording, optional
        Where the rig file names no other sensors.
    """
    from .survey import refuse_of_beams, survey_answer

    stated = [] if output.at_range_mm is None else ["--at-range-mm"]
    if (model, manner) != (Model(), Manner()):
        stated.append("options of how beams before planes are calibrated")
    refuse_of_beams(rig, stated, path)
    return survey_answer(path, rig, recording, output)


def _of_beams(
    path: Path,
    rig: "Rig",
    log: "LogReport",
    model: Model,
    manner: Manner,
    output: Output,
    rig_file: Path | None,
) -> Answer:
    outcome = _calibrated(path, rig, log, model, manner, output, rig_file)
    aloud = output.json_ or output.quiet
    return Answer(
        outcome.text,
        partial(_show, outcome, output),
        _warnings(outcome) if aloud else (),
        _failure(outcome),
    )


def _calibrated(
    path: Path,
    rig: "Rig",
    log: "LogReport",
    model: Model,
    manner: Manner,
    output: Output,
    rig_file: Path | None,
) -> _Outcome:
    """Calibrate, and write the result where it is asked for."""
    from ..files.calibration_json import calibration_text
    from ..files.writing import write_text
    from ..pipeline import calibrate as run
    from ..results.verdict import verdict

    reading = output.reading
    recording, noise, fed = log.recording, rig.noise, None
    options = replace(model.options(rig), outliers=manner.outliers.value, loss=manner.loss.value)
    if manner.incremental:
        from .incremental import plane_by_plane

        fed = plane_by_plane(recording, noise, options)
        result, recording = fed.result, fed.recording
    else:
        result = run(recording, noise, options)
    if result.recording is None:
        result = replace(result, recording=recording)
    judged = verdict(result, rig.limits, reading)
    text = calibration_text(result, judged)
    if output.out is not None:
        write_text(output.out, text)
    check = None
    if manner.cross_check and result.status == "converged":
        from ..validation.cross_check import cross_check

        check = cross_check(result, recording)
    advice = None
    if output.report is not None or not (output.json_ or output.quiet):
        advice = _advice(result, recording, rig)
    if output.report is not None:
        _report(output, result, (path, *log.beside), rig_file, rig, advice)
    return _Outcome(result, text, judged, check, fed, advice, log.lines)


def _advice(result: "Calibration", recording: "Recording", rig: "Rig") -> "Plan | None":
    """Return the next best stations, or those that are missing; None where nothing can be said."""
    from ..planning.advice import missing_stations, next_stations

    if result.status == "unobservable":
        return missing_stations(
            recording, rig.bounds, rig.sensor, rig.workspace, rig.noise, rig.goal
        )
    return next_stations(result, rig.sensor, rig.workspace, rig.goal)


def _report(
    output: Output,
    result: "Calibration",
    sources: tuple[Path, ...],
    rig_file: Path | None,
    rig: "Rig",
    advice: "Plan | None",
) -> None:
    """Write the report where it is asked for."""
    from ..files.report.options import ReportOptions, called_as, iso_day
    from ..files.report.page import write_report

    day = None if output.report_date is None else iso_day(output.report_date)
    options = ReportOptions(
        rig,
        output.reading,
        sources[0],
        rig_file,
        sources[1:],
        called_as(sys.argv[1:]),
        day,
        advice,
    )
    write_report(output.report or Path(), result, options)


def _show(outcome: _Outcome, output: Output) -> None:
    from ..planning.advice import advice_lines
    from ..results.description.description import Description
    from ..results.description.rendering import full_table
    from ..results.description.screen import full_lines
    from ..results.lines import wrapped
    from .incremental import comparison_line, update_table
    from .width import text_width

    fed, width = outcome.fed, text_width()
    described = Description(outcome.result, outcome.verdict)
    before, after = _around(outcome, output, width)
    if output.verbose:
        words = [] if outcome.advice is None else advice_lines(outcome.advice)
        advice = [line for text in words for line in wrapped(text, None, width)]
        lines = full_lines(described, width)
    else:
        lines, advice = _screen(described, outcome.advice, len(before) + len(after), width)
    if fed is not None:
        lines += full_table("plane by plane", update_table(fed), width)
        if fed.comparison is not None:
            before = [*wrapped(comparison_line(fed.comparison), None, width), *before]
    print_wrapped([*lines, *before, *advice, *after])


def _around(outcome: _Outcome, output: Output, width: int) -> tuple[list[str], list[str]]:
    """Return the lines before and after the next best stations."""
    from ..results.lines import as_many, wrapped
    from ..text import printable

    before: list[str] = []
    if outcome.check is not None:
        before = wrapped(cross_check_line(outcome.check), as_many(2, width), width)
    after: list[str] = []
    if outcome.read:
        after = wrapped(f"log: {printable('; '.join(outcome.read))}", None, width)
    written = [path for path in (output.out, output.report) if path is not None]
    return before, [*after, *(f"wrote {printable(str(path))}" for path in written)]


def cross_check_line(check: "CrossCheck") -> str:
    """Return the cross-check in one line."""
    return (
        f"cross-check with SciPy: largest difference {check.largest:.1e} standard deviations "
        f"({check.parameter}); standard deviations agree to {check.largest_sigma:.1e} "
        f"({check.sigma_parameter})"
    )


def _screen(
    described: "Description", advice: "Plan | None", around: int, width: int
) -> tuple[list[str], list[str]]:
    """Return the default screen, and the next best stations that fit below it with lines `around`."""
    from ..planning.advice import advice_within
    from ..results.description.screen import LINES, screen_lines
    from ..results.lines import as_many

    if advice is None:
        return screen_lines(described, closing=around, width=width), []
    kept = as_many(LEAST_ADVICE, width)
    lines = screen_lines(described, closing=around + kept, width=width)
    room = max(as_many(LINES, width) - around - len(lines), kept)
    return lines, advice_within(advice, room, width)


def _warnings(outcome: _Outcome) -> Iterator[str]:
    """Yield what stderr says where no tables do."""
    if outcome.check is not None:
        yield cross_check_line(outcome.check)
    for warning in outcome.result.warnings:
        if warning.message != outcome.result.message:
            yield f"WARNING: {warning}"


def _failure(outcome: _Outcome) -> tuple[int, str] | None:
    """Return the exit code of the contract and what went wrong; None where nothing did."""
    result, check, judged = outcome.result, outcome.check, outcome.verdict
    if result.interrupted:
        return INTERRUPTED, result.message
    if result.status != "converged":
        return UNDETERMINED, result.message
    advice = "expected the same optimum: do not use this calibration"
    if check is not None and check.largest > DISAGREEMENT:
        return UNDETERMINED, (
            f"SciPy disagrees by {check.largest:.2g} standard deviations in {check.parameter}; {advice}"
        )
    comparison = None if outcome.fed is None else outcome.fed.comparison
    if comparison is not None and comparison.largest > DISAGREEMENT:
        return UNDETERMINED, (
            f"plane by plane is {comparison.largest:.2g} standard deviations from all at once; {advice}"
        )
    if judged.exceeded:
        return NOT_USABLE, f"outside the limits: {'; '.join(judged.exceeded)}"
    return None if judged.usable else (NOT_USABLE, judged.sentence)
