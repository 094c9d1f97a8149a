"""What `handlaser calibrate` does with a survey: sensors of many rays, spheres, points, relations."""

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from .answer import Answer, print_wrapped
from .exit_codes import NOT_USABLE, UNDETERMINED

if TYPE_CHECKING:
    from ..files.rig_toml import Rig
    from ..results.survey import SurveyCalibration


def survey_answer(
    path: Path, rig: "Rig", out: Path | None, report: Path | None, *, aloud: bool
) -> Answer:
    """Calibrate a survey, write the result where it is asked for, and return what is said.

    Raises
    ------
    InputError
    """
    from ..files.survey_json import survey_text
    from ..files.survey_reading import read_survey
    from ..files.writing import write_text
    from ..pipeline import calibrate

    survey = read_survey(path, rig)
    result = calibrate(survey, rig.noise)
    text = survey_text(result)
    written = [file for file in (out, report) if file is not None]
    if out is not None:
        write_text(out, text)
    if report is not None:
        from ..files.report.survey import survey_report

        write_text(report, survey_report(result, survey, path.name))
    warnings = [f"WARNING: {one.message}" for one in result.warnings] if aloud else []
    return Answer(text, partial(_show, result, written), warnings, _failure(result))


def _show(result: "SurveyCalibration", written: Sequence[Path]) -> None:
    from ..results.description.rendering import full_table, text_lines
    from ..results.description.survey import beams_table, facts, sensors_table, targets_table
    from ..text import printable
    from .width import text_width

    width = text_width()
    lines = text_lines([result.verdict], width)
    tables = {
        "sensors": sensors_table(result),
        "beams": beams_table(result),
        "targets": targets_table(result),
    }
    for title, table in tables.items():
        lines += [] if table is None else full_table(title, table, width)
    lines += text_lines([f"{name}: {words}" for name, words in facts(result)], width)
    lines += text_lines([f"undetermined: {words}" for words in result.undetermined[1:]], width)
    lines += text_lines([f"WARNING: {one.message}" for one in result.warnings], width)
    print_wrapped([*lines, *(f"wrote {printable(str(file))}" for file in written)])


def _failure(result: "SurveyCalibration") -> tuple[int, str] | None:
    if result.status != "converged":
        return UNDETERMINED, result.message
    return None if result.usable else (NOT_USABLE, result.verdict)
