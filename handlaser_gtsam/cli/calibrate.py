"""handlaser calibrate: a recording becomes a calibration."""

import shlex
import sys
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from .answer import Answer, lines_read, text_width, working, wrote
from .options import (
    AtRangeOption,
    Given,
    JsonOption,
    Model,
    OutOption,
    QuietOption,
    RecordingArgument,
    how,
    metres,
    read_stated,
    require_outputs_of,
)
from .stopping import Exit

if TYPE_CHECKING:
    from ..data.recording import Recording
    from ..data.survey import Survey
    from ..estimation.options import CalibrationOptions
    from ..files.logs.format import LogReport
    from ..files.rig_toml import Rig
    from ..planning.route import Plan
    from ..results.calibration import Calibration
    from ..results.description.tables import Table
    from ..results.survey import SurveyCalibration
    from ..results.verdict import Verdict
    from ..session.reports import Comparison


def calibrate(
    recording: RecordingArgument,
    given: Given,
    model: Model,
    outliers: Annotated[Literal["reject", "keep"], how] = "reject",
    loss: Annotated[Literal["gaussian", "huber", "cauchy", "tukey"], how] = "gaussian",
    incremental: Annotated[bool, how] = False,
    cross_check: Annotated[bool, how] = False,
    out: OutOption = None,
    report: OutOption = None,
    at_range_mm: AtRangeOption = None,
    verbose: Annotated[bool, typer.Option("--verbose", "-v")] = False,
    quiet: QuietOption = False,
    json_: JsonOption = False,
) -> None:
    r"""Find where each beam or sensor sits in the hand, and each target, with covariances.

    Exit codes: 0 good; 1 a bug; 2 bad input; 3 no calibration: the recording does not determine it, its
    readings do not fit each other, or another solver disagrees; 4 not usable: outside the limits of the
    rig file, with a mount that no sensor has or another one about as probable, or with a systematic
    error larger than what the result states; 130 stopped by Ctrl-C.

    Parameters
    ----------
    recording, given, model
    outliers : str
        Leave out, and list, readings that the others contradict; or keep them.
    loss : str
        Loss of the final estimate, reading by reading.
    incremental : bool
        Add plane by plane, or target by target, show what each teaches, and compare with all at once.
    cross_check : bool
        Solve again with SciPy and compare.
    out : Path, optional
        Write the result to this JSON file.
    report : Path, optional
        Write a report, one HTML page, to this file.
    at_range_mm : float, optional
    verbose : bool
        Print all tables: planes, intervals, spots.
    quiet, json_

    Examples
    --------
    handlaser calibrate recording.csv
    handlaser calibrate recording.csv \
        --rig rig.toml --out calibration.json
    handlaser calibrate recording.csv \
        --rig rig.toml --verbose --cross-check
    handlaser calibrate recording.csv --json \
        --range-sigma-mm 0.03 --poses exact
    """
    from ..data.survey import Survey
    from ..files.calibration_writing import calibration_text
    from ..files.writing import write_text
    from ..results.calibration import Calibration

    with working():
        rig = given.read()
        require_outputs_of({"--out": out, "--report": report}, rig, (recording, given.rig))
        chosen = {"--outliers": outliers != "reject", "--loss": loss != "gaussian"}
        stated = [] if at_range_mm is None else ["--at-range-mm"]
        stated += model.stated() + [option for option, changed in chosen.items() if changed]
        read, rig = read_stated(rig, recording, stated)
        of_survey = isinstance(read, Survey)
        options = model.options(rig, outliers=outliers, loss=loss)
        reading, plan, disagreement = metres(at_range_mm), None, ""
        result, ordered, taught, comparison = _solved(read, rig, options, incremental=incremental)
        above = list[str]()
        if comparison is not None:
            from .incremental import comparison_words

            line, disagreement = comparison_words(comparison, "target" if of_survey else "plane")
            above.append(line)
        judged = result.judged(rig.limits, reading)
        text = calibration_text(result, judged)
        if out is not None:
            write_text(out, text)
        checked = list[str]()
        if cross_check and result.success:
            from ..validation.cross_check import cross_check as check_again

            check = check_again(result, ordered)
            checked = [
                f"cross-check with SciPy: largest difference {check.largest:.1e} standard deviations "
                f"({check.parameter}); standard deviations agree to {check.largest_sigma:.1e} "
                f"({check.sigma_parameter})"
            ]
            if check.difference:
                disagreement = f"SciPy finds {check.difference}"
        aloud = json_ or quiet
        if (report or not aloud) and ordered is not None and isinstance(result, Calibration):
            from .check import advised

            plan = advised(ordered, rig, result)
        if report is not None:
            from ..files.report.options import ReportOptions
            from ..files.report.report import write_report

            words = shlex.join(("handlaser", *sys.argv[1:]))
            beside = () if isinstance(read, Survey) else read.beside
            options_of_report = ReportOptions(
                rig, reading, recording, given.rig, beside, words, plan
            )
            write_report(report, result, options_of_report)
        after = lines_read("read" if of_survey else "log", read.lines) + wrote(out, report)
        answer = Answer(
            text,
            _lines(result, judged, taught, above + checked, plan, after, verbose=verbose),
            [*checked, *result.warnings] if aloud else (),
            _failure_of(result, judged, disagreement),
        )
    answer.give(json=json_, quiet=quiet)


def _solved(
    read: "LogReport | Survey", rig: "Rig", options: "CalibrationOptions", *, incremental: bool
) -> "tuple[Calibration | SurveyCalibration, Recording | None, Table | None, Comparison | None]":
    """Calibrate all at once, or one by one; of a survey no options are stated.

    Returns
    -------
    result : Calibration or SurveyCalibration
    recording : Recording or None
        Stations in the order of the result; None of a survey.
    taught : Table or None
        What each plane or target taught, one by one.
    comparison : Comparison or None
        How far one by one is from all at once.
    """
    from ..data.survey import Survey
    from ..pipeline import calibrate as run

    if incremental:
        from .incremental import plane_by_plane, target_by_target

        if isinstance(read, Survey):
            result, taught, comparison = target_by_target(read, rig.noise)
            return result, None, taught, comparison
        return plane_by_plane(read.recording, rig.noise, options)
    if isinstance(read, Survey):
        return run(read, rig.noise), None, None, None
    return run(read.recording, rig.noise, options), read.recording, None, None


def _lines(
    result: "Calibration | SurveyCalibration",
    judged: "Verdict",
    taught: "Table | None",
    above: Sequence[str],
    plan: "Plan | None",
    after: Sequence[str],
    *,
    verbose: bool,
) -> Iterator[str]:
    """Yield the result, what stands `above` the next best stations, these, and what is `after` them."""
    from ..planning.advice import advice_lines, advice_within
    from ..results.description.tables import full_table
    from ..results.description.terminal import LINES
    from ..results.lines import as_many, wrapped

    described, width, next_best = result.described(judged), text_width(), list[str]()
    first = [line for words in above for line in wrapped(words, None, width)]
    last = [line for words in after for line in wrapped(words, None, width)]
    around = len(first) + len(last)
    if verbose:
        lines = described.full(width)
        next_best = [] if plan is None else advice_lines(plan)
    else:
        # Lines of the next best stations; warnings come before more.
        kept = 0 if plan is None else as_many(5, width)
        lines = described.screen(closing=around + kept, width=width)
        room = max(as_many(LINES, width) - around - len(lines), kept)
        next_best = [] if plan is None else advice_within(plan, room, width)
    yield from lines
    yield from () if taught is None else full_table(taught.name, taught, width)
    yield from (*first, *next_best, *last)


def _failure_of(
    result: "Calibration | SurveyCalibration", judged: "Verdict", disagreement: str
) -> tuple[int, str] | None:
    """Return the exit code of the contract and what went wrong; None where nothing did.

    A `disagreement` says that another way led to another optimum.
    """
    if result.status != "converged":
        interrupted = getattr(result, "interrupted", False)  # one of a survey is not handed over
        return Exit.INTERRUPTED if interrupted else Exit.UNDETERMINED, result.message
    if disagreement:
        words = f"{disagreement}; expected the same optimum: do not use this calibration"
        return Exit.UNDETERMINED, words
    if judged.usable:
        return None
    limits = f"outside the limits: {'; '.join(judged.exceeded)}"
    return Exit.NOT_USABLE, limits if judged.code == "outside-limits" else judged.sentence
