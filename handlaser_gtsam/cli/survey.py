"""What `handlaser calibrate` does with a survey: sensors of many rays, spheres, points, relations."""

import math
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from ..errors import InputError
from .answer import Answer, print_wrapped, text_width, wrote
from .stopping import NOT_USABLE, UNDETERMINED

if TYPE_CHECKING:
    from ..data.recording import Recording
    from ..files.rig_toml import Rig
    from ..results.limits import LimitCheck
    from ..results.survey import SurveyCalibration
    from .calibrate import Output


def refuse_of_beams(rig: "Rig", stated: Sequence[str], path: Path) -> None:
    """Refuse what is stated and does not count with sensors of many rays, other targets or relations.

    Raises
    ------
    InputError
    """
    fields = {
        "max_incidence_deg": rig.sensor.max_incidence < math.pi / 2.0,
        "incidence_sigma_mm": rig.noise.incidence_sigma > 0.0,
        "rms_mm in [limits]": rig.limits.rms is not None,
    }
    found = [*stated, *(name for name, given in fields.items() if given)]
    if found:
        words = f"{', '.join(found)}, with sensors of many rays, other targets or relations"
        raise InputError(words, "it with beams before planes only", path)


def survey_answer(
    path: Path, rig: "Rig", recording: "Recording | None", output: "Output"
) -> Answer:
    """Calibrate a survey, write the result where it is asked for, and return what is said.

    Parameters
    ----------
    path : Path
        Of the stations.
    rig : Rig
    recording : Recording, optional
        What was read from there, if the rig file names no sensors of many rays and no relations.
    output : Output

    Raises
    ------
    InputError
    """
    from ..files.survey_json import survey_text
    from ..files.survey_reading import read_survey, survey_of
    from ..files.writing import require_outputs, write_text
    from ..pipeline import calibrate
    from ..results.survey import survey_limits

    tables = () if rig.survey is None else rig.survey.files
    require_outputs({"--out": output.out, "--report": output.report}, (path, *tables))
    survey = read_survey(path, rig) if recording is None else survey_of(recording, rig)
    result = calibrate(survey, rig.noise)
    text, checks = survey_text(result), survey_limits(result, rig.limits)
    if output.out is not None:
        write_text(output.out, text)
    if output.report is not None:
        from ..files.report.survey import survey_report

        page = survey_report(result, survey, path.name, output.report_date or "", checks)
        write_text(output.report, page)
    aloud = output.json_ or output.quiet
    warnings = [f"WARNING: {one.message}" for one in result.warnings] if aloud else []
    show = partial(_show, result, checks, output)
    return Answer(text, show, warnings, _failure(result, checks))


def _show(result: "SurveyCalibration", checks: "Sequence[LimitCheck]", output: "Output") -> None:
    from ..results.description.rendering import full_table, text_lines
    from ..results.description.survey import beams_table, facts, sensors_table, targets_table

    width = text_width()
    lines = text_lines([result.verdict], width)
    tables = {
        "sensors": sensors_table(result),
        "beams": beams_table(result),
        "targets": targets_table(result),
    }
    for title, table in tables.items():
        lines += [] if table is None else full_table(title, table, width)
    lines += text_lines([f"{name}: {words}" for name, words in facts(result, checks)], width)
    lines += text_lines([f"undetermined: {words}" for words in result.undetermined[1:]], width)
    lines += text_lines([f"WARNING: {one.message}" for one in result.warnings], width)
    print_wrapped([*lines, *wrote(output.out, output.report)])


def _failure(result: "SurveyCalibration", checks: "Sequence[LimitCheck]") -> tuple[int, str] | None:
    if result.status != "converged":
        return UNDETERMINED, result.message
    failed = [one.failure for one in checks if not one.held]
    if failed:
        return NOT_USABLE, f"outside the limits: {'; '.join(failed)}"
    return None if result.usable else (NOT_USABLE, result.verdict)
