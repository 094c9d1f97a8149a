"""The report of a survey: one page, as beams before planes have one, with profiles drawn."""

from pathlib import Path

from ... import __version__
from ...results.description.survey import facts, targets_table
from ...results.description.tables import Cell, listed, name_cell
from ...results.survey import SurveyCalibration
from ...results.verdict import Verdict
from .figure import STYLE, Figure
from .options import ReportOptions, date_of
from .page import page_of, script_of, sections_of
from .scene import in_hand, scene_figure
from .survey_figures import (
    along_the_rays,
    by_station,
    by_target,
    on_targets,
    profiles,
    seen_by_all,
    world_figure,
)

SECTIONS: dict[str, str] = STYLE["sections of a survey"]
"""The sections of the page in their order, each with its name in the list of links."""


def survey_report(result: SurveyCalibration, options: ReportOptions) -> str:
    """Return the page; the same result and options make the same page.

    Raises
    ------
    InputError
        As `write_report`.
    """
    judged = result.judged(options.rig.limits, options.reading)
    file = options.recording_file
    source = "stations" if file is None else Path(file).name
    opening, sections, figures = survey_content(result, judged, source, date_of(options))
    script = script_of("page.js")
    return page_of(f"{opening} · {source}", sections, figures, script=script, labels=SECTIONS)


def survey_content(
    result: SurveyCalibration, verdict: Verdict, source: str, day: str = ""
) -> tuple[str, dict[str, str], dict[str, Figure]]:
    """Return the opening of the verdict, sections as HTML and figures by name.

    Parameters
    ----------
    result : SurveyCalibration
    verdict : Verdict
        With its user's limits.
    source : str
        Name of the file of stations.
    day : str
        Date of the report; none where not given.
    """
    survey, shown = result.survey, result.described(verdict)
    seen = list(seen_by_all(result, survey))
    on = on_targets(result, survey, seen)
    drawn = [world_figure(result, survey, seen)]
    drawn += [scene_figure(space) for space in filter(None, [in_hand(seen)])]
    drawn += [by_station(survey, seen), by_target(survey, seen), *(figure for _, figure in on)]
    drawn += [one for one in (along_the_rays(seen), profiles(survey, seen)) if one is not None]
    figures = {figure.name: figure for figure in drawn}
    made = [("program", f"handlaser {__version__}"), ("stations", source)]
    made += [("read", "; ".join(survey.lines))] if survey.lines else []
    made += [("date", day)] if day else []
    values = {
        "title": source,
        "shown": shown,
        "warnings": shown.warnings,
        "mounts": shown.main_tables,
        "targets": targets_table(result),
        "rows": facts(result, verdict),
        "rejected": listed(
            "rejected:survey",
            result.rejected,
            lambda one: (
                *map(name_cell, (one.sensor, one.station, one.target)),
                Cell(one.reason),
            ),
            "shot",
        ),
        "made": made,
        "figures": figures,
        "on_targets": [(target, figure.name) for target, figure in on],
    }
    return verdict.opening, sections_of("survey.html.j2", SECTIONS, values), figures
