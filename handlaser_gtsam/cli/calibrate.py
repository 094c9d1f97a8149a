"""handlaser calibrate: a recording becomes a calibration."""

import shlex
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from .answer import Answer, Working, text_width, wrote
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
)
from .stopping import failure_of

if TYPE_CHECKING:
    from ..files.logs.report import LogReport
    from ..files.rig_toml import Rig
    from ..planning.route import Plan
    from ..results.calibration import Calibration
    from ..results.description.tables import Table
    from ..results.verdict import Verdict
    from ..validation.cross_check import CrossCheck


OutliersChoice = Literal["reject", "keep"]
LossChoice = Literal["gaussian", "huber", "cauchy", "tukey"]


@dataclass(frozen=True, slots=True)
class Manner(Model):
    """What is estimated, and how it is calibrated.

    Attributes
    ----------
    outliers : OutliersChoice
        Leave out, and list, readings that the others contradict; or keep them.
    loss : LossChoice
        Loss of the final estimate, reading by reading.
    incremental : bool
        Add plane by plane, or target by target, show what each teaches, and compare with all at once.
    cross_check : bool
        Solve again with SciPy and compare.
    """

    outliers: Annotated[OutliersChoice, how] = "reject"
    loss: Annotated[LossChoice, how] = "gaussian"
    incremental: Annotated[bool, how] = False
    cross_check: Annotated[bool, how] = False


@dataclass(frozen=True, slots=True)
class Output:
    """What becomes of the result.

    Attributes
    ----------
    out : Path, optional
        Write the result to this JSON file.
    report : Path, optional
        Write a report, one HTML page, to this file.
    verbose : bool
        Print all tables: planes, intervals, spots.
    """

    out: OutOption = None
    report: OutOption = None
    at_range_mm: AtRangeOption = None
    verbose: Annotated[bool, typer.Option("--verbose", "-v")] = False
    quiet: QuietOption = False
    json_: JsonOption = False


def calibrate(recording: RecordingArgument, given: Given, manner: Manner, output: Output) -> None:
    r"""Find the mount of every beam and every plane in RECORDING, with covariances.

    Exit codes: 0 good; 1 a bug; 2 bad input; 3 no calibration: the recording does not determine it, its
    readings do not fit each other, or another solver disagrees; 4 not usable: outside the limits of the
    rig file, or with a systematic error larger than what the result states; 130 stopped by Ctrl-C.

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
    from ..files.rig_reading import read_any_kind
    from ..files.writing import require_outputs
    from .survey import refuse_of_beams, survey_answer

    with Working():
        rig = given.read()
        outputs = {"--out": output.out, "--report": output.report}
        require_outputs(outputs, (recording, given.rig, *rig.log.files))
        read = read_any_kind(rig, recording)
        if isinstance(read, Survey):
            stated = [] if output.at_range_mm is None else ["--at-range-mm"]
            stated += replace(manner, incremental=False).stated()
            refuse_of_beams(rig, stated, recording)
            answer = survey_answer(recording, rig, read, output, incremental=manner.incremental)
        else:
            log, rig = read
            answer = _of_beams(recording, rig, log, manner, output, given.rig)
    answer.give(json=output.json_, quiet=output.quiet)


def _of_beams(
    path: Path,
    rig: "Rig",
    log: "LogReport",
    manner: Manner,
    output: Output,
    rig_file: Path | None,
) -> Answer:
    """Calibrate, write the result where it is asked for, and return what is said."""
    from ..files.calibration_json import calibration_text
    from ..files.writing import write_text
    from ..pipeline import calibrate as run
    from ..quantities import SAME_OPTIMUM
    from ..results.verdict import verdict

    recording, reading = log.recording, metres(output.at_range_mm)
    taught, check, advice = None, None, None
    before, disagreement = list[str](), ""
    if manner.incremental:
        from .incremental import comparison_line, disagreement_of, plane_by_plane

        result, recording, taught, comparison = plane_by_plane(
            recording, rig.noise, manner.options(rig)
        )
        if comparison is not None:
            before.append(comparison_line(comparison))
            disagreement = disagreement_of(comparison)
    else:
        result = run(recording, rig.noise, manner.options(rig))
    if result.recording is None:
        result = replace(result, recording=recording)
    judged = verdict(result, rig.limits, reading)
    text = calibration_text(result, judged)
    if output.out is not None:
        write_text(output.out, text)
    if manner.cross_check and result.status == "converged":
        from ..validation.cross_check import cross_check

        check = cross_check(result, recording)
        if check.largest > SAME_OPTIMUM:
            disagreement = f"SciPy disagrees by {check.difference}"
    aloud = output.json_ or output.quiet
    if output.report is not None or not aloud:
        from .check import advised

        advice = advised(recording, rig, result)
    if output.report is not None:
        from ..files.report.options import ReportOptions
        from ..files.report.page import write_report

        words = shlex.join(("handlaser", *sys.argv[1:]))
        options = ReportOptions(rig, reading, path, rig_file, log.beside, words, advice)
        write_report(output.report, result, options)
    compared = [] if check is None else [cross_check_line(check)]
    before += compared
    warnings = [one for one in result.warnings if one.message != result.message]
    files = wrote(output.out, output.report)
    return Answer(
        text,
        _lines(result, judged, advice, taught, log.lines, before, files, verbose=output.verbose),
        [*compared, *warnings] if aloud else (),
        failure_of(result, judged, disagreement),
    )


def _lines(
    result: "Calibration",
    judged: "Verdict",
    advice: "Plan | None",
    taught: "Table | None",
    read: Sequence[str],
    before: Sequence[str],
    files: Sequence[str],
    *,
    verbose: bool,
) -> Iterator[str]:
    """Yield the tables, what stands `before` the next best stations, these, and how it was read."""
    from ..planning.advice import advice_lines, advice_within
    from ..results.description.description import Description
    from ..results.description.rendering import full_table
    from ..results.description.screen import LINES, full_lines, screen_lines
    from ..results.lines import as_many, wrapped
    from ..text import printable

    width, described = text_width(), Description(result, judged)
    above = [line for text in before for line in wrapped(text, None, width)]
    after = wrapped(f"log: {printable('; '.join(read))}", None, width) if read else []
    around, next_best = len(above) + len(after) + len(files), list[str]()
    if verbose:
        lines, next_best = full_lines(described, width), advice_lines(advice) if advice else []
    elif advice is None:
        lines = screen_lines(described, closing=around, width=width)
    else:
        kept = as_many(5, width)  # lines of the next best stations; warnings come before more
        lines = screen_lines(described, closing=around + kept, width=width)
        room = max(as_many(LINES, width) - around - len(lines), kept)
        next_best = advice_within(advice, room, width)
    yield from lines
    yield from () if taught is None else full_table("plane by plane", taught, width)
    yield from (*above, *next_best, *after, *files)


def cross_check_line(check: "CrossCheck") -> str:
    """Return the cross-check in one line."""
    return (
        f"cross-check with SciPy: largest difference {check.largest:.1e} standard deviations "
        f"({check.parameter}); standard deviations agree to {check.largest_sigma:.1e} "
        f"({check.sigma_parameter})"
    )
