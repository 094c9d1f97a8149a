"""What verbs do with a survey: other sensors, targets, and relations."""

import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from ..errors import InputError
from ..text import count
from .answer import Answer, text_width, wrote
from .stopping import UNDETERMINED, failure_of, left_open

if TYPE_CHECKING:
    from ..data.survey import Survey
    from ..errors import CalibrationWarning
    from ..files.rig_toml import Rig
    from ..results.description.tables import Table
    from ..results.survey import SurveyCalibration
    from ..results.verdict import Verdict
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
        expected = "it with beams before planes only (errors of a sensor are `free` in [[sensors]])"
        raise InputError(words, expected, path)


def require_outputs_of(outputs: Mapping[str, Path | None], rig: "Rig") -> None:
    """Refuse files to write, by their options, that the sensors of a rig file read, or would read.

    Raises
    ------
    InputError
        Also a name that `points` with a * would take for the table of another station.
    """
    from ..files.writing import require_outputs

    if rig.survey is None:
        return
    require_outputs(outputs, rig.survey.files)
    for option, path in outputs.items():
        if path is not None and rig.survey.reads(path):
            found = f"{option} with a name that points in [[sensors]] takes for a table of points"
            raise InputError(found, "another name, or another folder", path)


def survey_answer(
    path: Path,
    rig: "Rig",
    survey: "Survey",
    output: "Output",
    *,
    incremental: bool = False,
) -> Answer:
    """Calibrate a survey, write the result where it is asked for, and return what is said.

    Parameters
    ----------
    path : Path
        Of the stations.
    rig : Rig
    survey : Survey
    output : Output
    incremental : bool
        Whether to add target by target first, and to show what each taught.

    Raises
    ------
    InputError
    """
    from ..files.survey_json import survey_text
    from ..files.writing import write_text
    from ..pipeline import calibrate
    from ..results.survey_verdict import survey_verdict

    require_outputs_of({"--out": output.out, "--report": output.report}, rig)
    taught, compared, disagreement = None, list[str](), ""
    if incremental:
        from .incremental import comparison_line, disagreement_of, target_by_target

        result, taught, comparison = target_by_target(survey, rig.noise)
        compared = [comparison_line(comparison, "target")]
        disagreement = disagreement_of(comparison, "target")
    else:
        result = calibrate(survey, rig.noise)
    judged = survey_verdict(result, rig.limits)
    text = survey_text(result, judged)
    if output.out is not None:
        write_text(output.out, text)
    if output.report is not None:
        from ..files.report.options import changed_on
        from ..files.report.survey import survey_report

        day = f"{changed_on(path).isoformat()} (of the recording's file)"
        page = survey_report(result, survey, path.name, day, judged)
        write_text(output.report, page)
    after = [*compared, *_read_lines(survey), *wrote(output.out, output.report)]
    lines = _lines(result, judged, taught, after)
    warnings = result.warnings if output.json_ or output.quiet else ()
    return Answer(text, lines, warnings, failure_of(result, judged, disagreement))


def survey_check(survey: "Survey", rig: "Rig") -> Answer:
    """Say what a survey holds, and what its motion leaves undetermined.

    Raises
    ------
    InputError
    """
    from ..files.survey_json import survey_check_text
    from ..results.survey_check import check_lines, check_survey

    found = check_survey(survey, rig.noise)
    failure = left_open(found.undetermined, found.advice)
    if failure is not None and not found.exactly:
        failure = failure[0], f"{failure[1]}. Some of it is undetermined at this noise only"
    if found.doubt is not None:
        failure = UNDETERMINED, found.doubt
    warnings = [one for one in found.warnings if one.message not in (found.doubt or "")]
    lines = [*check_lines(found), *_read_lines(survey)]
    return Answer(survey_check_text(found, survey.lines), lines, warnings, failure)


def converted_survey(
    path: Path, rig: "Rig", out: Path | None
) -> tuple[list[str], "tuple[CalibrationWarning, ...]"]:
    """Read a log of poses with the sensors of a rig file, and write its stations where asked to.

    Returns lines of what was read, and warnings.

    Raises
    ------
    InputError
        Also a bag, which has no table of points that would stay as it is.
    """
    from ..files.logs.bags import is_bag
    from ..files.recording_csv import write_stations
    from ..files.survey_reading import read_survey

    if is_bag(path):
        expected = "a log of poses beside tables of points; the other verbs take bags as they are"
        raise InputError("a bag, with sensors of many rays", expected, path)
    require_outputs_of({"--out": out}, rig)
    survey = read_survey(path, rig)
    if survey.beam_names:
        found = "a recording with ranges of beams, which is no log of poses"
        raise InputError(found, "it as it is: other verbs take it", path)
    if out is not None:
        write_stations(out, survey.stations)
    sensors, points = len(survey.shots), sum(len(shots.reading) for shots in survey.shots)
    words = f"{count(len(survey.stations), 'station')}, {count(sensors, 'sensor')}, "
    words += f"{count(len(set(survey.stations.plane_labels)), 'target')}, {count(points, 'point')}"
    return [words, *survey.lines], survey.warnings


def _read_lines(survey: "Survey") -> list[str]:
    """Return how the files of a survey were read, in a line; none where there is nothing to say."""
    from ..text import printable

    return [f"read: {printable('; '.join(survey.lines))}"] if survey.lines else []


def _lines(
    result: "SurveyCalibration",
    judged: "Verdict",
    taught: "Table | None",
    after: Sequence[str],
) -> Iterator[str]:
    """Yield the verdict, tables and facts of a result, its warnings, and what stands `after` them."""
    from ..results.description.rendering import full_table, text_lines
    from ..results.description.survey import beams_table, facts, sensors_table, targets_table

    width = text_width()
    yield from text_lines([judged.sentence], width)
    for title, table in (
        ("sensors", sensors_table(result)),
        ("beams", beams_table(result)),
        ("targets", targets_table(result)),
        ("target by target", taught),
    ):
        yield from () if table is None else full_table(title, table, width)
    lines = [f"{name}: {words}" for name, words in facts(result, judged)]
    lines += [*result.undetermined[1:], *(f"WARNING: {one.message}" for one in result.warnings)]
    yield from text_lines([*lines, *after], width)
