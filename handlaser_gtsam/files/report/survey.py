"""The report of a survey: one page, as beams before planes have one, with profiles drawn."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ... import __version__
from ...arrays import FloatArray, evenly
from ...data.survey import Survey
from ...quantities import IN_MM
from ...results.description.survey import beams_table, facts, sensors_table, targets_table
from ...results.description.tables import (
    listed,
    name_cell,
    of_words,
    sentence,
    text,
)
from ...results.limits import LimitCheck
from ...results.survey import SurveyCalibration
from ..checked_text import Record
from .figure import GREY, MOST_POINTS, Figure, label, numbers
from .page import page_of, script_of, sections_of
from .scene import AXIS_SIZE, Geometry, plate, scene_figure
from .survey_figures import (
    Seen,
    along_the_rays,
    by_station,
    by_target,
    in_hand,
    labels_of,
    on_targets,
    profiles,
    seen_by_all,
)

SECTIONS = {
    "verdict": "",
    "mounts": "Mounts",
    "targets": "Targets",
    "space": "Geometry",
    "fit": "Fit",
    "made": "How it was made",
}
"""The sections of the page in their order, each with its name in the list of links."""
IN_HAND = "The sensors in the hand frame: some of their rays, as far as they read."
CORNERS_OF_A_RING = 49
"""Corners of a circle that looks round."""


def survey_report(
    result: SurveyCalibration,
    survey: Survey,
    source: str,
    day: str = "",
    checks: tuple[LimitCheck, ...] = (),
) -> str:
    """Return the page; the same result makes the same page.

    Parameters
    ----------
    result : SurveyCalibration
    survey : Survey
        What was calibrated.
    source : str
        Name of the file of stations.
    day : str
        Date of the report; none where not given.
    checks : tuple of LimitCheck
        Of its user's limits.
    """
    opening, sections, figures = survey_content(result, survey, source, day, checks)
    script = script_of("page.js")
    return page_of(f"{opening} · {source}", sections, figures, script=script, labels=SECTIONS)


def survey_content(
    result: SurveyCalibration,
    survey: Survey,
    source: str,
    day: str = "",
    checks: tuple[LimitCheck, ...] = (),
) -> tuple[str, dict[str, str], dict[str, Figure]]:
    """Return the opening of the verdict, sections as HTML and figures by name; as `survey_report`."""
    seen = list(seen_by_all(result, survey))
    hand = replace(scene_figure(in_hand(seen)), caption=IN_HAND)
    some = [along_the_rays(result, seen), profiles(survey, seen)]
    on = on_targets(result, survey, seen)
    drawn = [_scene(result, survey, seen), hand, by_station(survey, seen), by_target(survey, seen)]
    drawn += [*on, *(figure for figure in some if figure is not None)]
    figures = {figure.name: figure for figure in drawn}
    made = [("program", f"handlaser {__version__}"), ("stations", source)]
    made += [("date", day)] if day else []
    mark = "good" if result.usable and not result.warnings else "care" if result.usable else "bad"
    opening, _, words = result.verdict.partition(": ")
    values = {
        "title": source,
        "shown": {
            "mark": mark,
            "opening": opening,
            "findings": [
                part if part.startswith(tuple(result.sensors)) else sentence(part)
                for part in words.split("; ")
            ],
            "counts": _counts(result, survey),
        },
        "warnings": [one.message for one in result.warnings],
        "mounts": [t for t in (sensors_table(result), beams_table(result)) if t],
        "targets": targets_table(result),
        "rows": facts(result, checks),
        "rejected": listed(
            "rejected",
            "Shots that were left out",
            of_words("sensor", "station", "target", "reason"),
            result.rejected,
            lambda one: (
                *map(name_cell, (one.sensor, one.station, one.target)),
                text(one.reason),
            ),
            "shot",
        ),
        "made": made,
        "figures": figures,
        "on_targets": [figure.name for figure in on],
    }
    return opening, sections_of("survey.html.j2", SECTIONS, values), figures


def _counts(result: SurveyCalibration, survey: Survey) -> tuple[tuple[str, int], ...]:
    points = sum(len(shots.reading) for shots in survey.shots)
    return (
        ("stations", len(survey.stations)),
        ("targets", len(result.targets)),
        ("sensors", len(result.sensors) + len(result.beams)),
        ("points", points),
        ("rejected", len(result.rejected)),
    )


def _scene(result: SurveyCalibration, survey: Survey, seen: Sequence[Seen]) -> Figure:
    """Return the picture in space: targets, hands, and where each sensor looked; of used shots."""
    of, labels = survey.stations, labels_of(survey)
    planes, balls = [], []
    for target in result.targets.values():
        v = target.values
        if target.kind == "sphere":
            balls.append(_rings(target.label, np.array([v["x"], v["y"], v["z"]]), v["radius"]))
        if target.kind != "plane":
            continue
        points = [one.place[one.used & (labels[one.station] == target.label)] for one in seen]
        on = np.concatenate(points) if points else np.empty((0, 3))
        if len(on) > 2:  # the two of a groove have labels of their own
            plane = plate(np.array([v["nx"], v["ny"], v["nz"]]), on)
            planes.append((target.label.removeprefix("plane:"), plane))
    beams, extent = [], 0.0
    for one in seen:
        stations = np.unique(one.station[one.used])
        stations = stations[evenly(len(stations), MOST_POINTS // 4)] if len(stations) else stations
        segments = np.empty((len(stations), 2, 3))
        for i, s in enumerate(stations.tolist()):
            mine = one.used & (one.station == s)
            source = of.world_R_hand[s] @ one.source[mine].mean(axis=0) + of.world_t_hand[s]
            segments[i] = source, one.place[mine].mean(axis=0)
        if len(stations):
            extent = max(extent, float(np.ptp(segments.reshape(-1, 3), axis=0).max()))
        names = tuple(f"{label(one.called)}, {label(of.station_names[s])}" for s in stations)
        beams.append((one.called, segments * IN_MM, names))
    some = evenly(len(of), MOST_POINTS // 4)
    hands = np.repeat(of.world_t_hand[some][:, None], 4, axis=1)
    hands[:, 1:] += AXIS_SIZE * extent * np.swapaxes(of.world_R_hand[some], 1, 2)
    names = tuple(of.station_names[i] for i in some)
    drawn = scene_figure(
        Geometry("world", tuple(planes), tuple(beams), hands * IN_MM, names, mount="")
    )
    caption = (
        "Each sensor at its stations, with a line to the middle of what it saw there; rejected shots "
        "are not drawn."
    )
    return replace(drawn, caption=caption, data=[*balls, *drawn.data])


def _rings(name: str, centre: FloatArray, radius: float) -> Record:
    """Return three circles of a sphere as one line."""
    a = np.linspace(0.0, 2.0 * np.pi, CORNERS_OF_A_RING)
    flat = np.stack((np.cos(a), np.sin(a), np.zeros_like(a)), axis=1)
    gap = np.full((1, 3), np.nan)
    rings = [np.concatenate((np.roll(flat, turn, axis=1), gap)) for turn in range(3)]
    points = (centre + radius * np.concatenate(rings)) * IN_MM
    return {
        "type": "scatter3d",
        "mode": "lines",
        "name": label(name),
        **{coordinate: numbers(points[:, i]) for i, coordinate in enumerate("xyz")},
        "line": {"color": GREY, "width": 2},
        "hovertemplate": f"{label(name)}<extra></extra>".replace("%{", "% {"),
        "showlegend": False,
    }
