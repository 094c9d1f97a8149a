"""The report of a survey: one page, as beams before planes have one, with profiles drawn."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ... import __version__
from ...arrays import FloatArray, IntArray
from ...data.survey import Shots, Survey, normal_label
from ...model.sensors.kinds import KINDS
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
from ..json_text import Record
from .figure import (
    MOST_POINTS,
    MOST_SHAPES,
    Figure,
    axis,
    colour,
    evenly,
    label,
    layout,
    marker,
    numbers,
)
from .page import page_of, script_of, sections_of
from .scene import Geometry, plate, scene_figure

SECTIONS = {
    "verdict": "",
    "mounts": "Mounts",
    "targets": "Targets",
    "space": "Geometry",
    "fit": "Fit",
    "made": "How it was made",
}
"""The sections of the page in their order, each with its name in the list of links."""
POINTS_OF_PROFILE = 60
"""Points that a drawn profile has at most."""


Spots = tuple[str, IntArray, FloatArray, FloatArray]
"""The readings of a sensor or beam in the world: its name, their stations (N,), spots, and where their
rays begin (N, 3) [m]."""


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
    spots = list(_spots(result, survey))
    drawn = [_scene(result, survey, spots), _by_station(result, survey, spots)]
    drawn += [figure for figure in (_profiles(survey),) if figure is not None]
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
            "findings": [sentence(part) for part in words.split("; ")],
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
    }
    sections = sections_of("survey.html.j2", SECTIONS, values)
    return page_of(
        f"{opening} · {source}", sections, figures, script=script_of("page.js"), labels=SECTIONS
    )


def _counts(result: SurveyCalibration, survey: Survey) -> tuple[tuple[str, int], ...]:
    points = sum(len(shots.reading) for shots in survey.shots)
    return (
        ("stations", len(survey.stations)),
        ("targets", len(result.targets)),
        ("sensors", len(result.sensors) + len(result.beams)),
        ("points", points),
        ("rejected", len(result.rejected)),
    )


def _spots(result: SurveyCalibration, survey: Survey) -> Iterator[Spots]:
    R, t = survey.stations.world_R_hand, survey.stations.world_t_hand
    for name, station, *in_hand in _in_hand(result, survey):
        place, source = (np.einsum("nij,nj->ni", R[station], x) + t[station] for x in in_hand)
        yield name, station, place, source


def _in_hand(result: SurveyCalibration, survey: Survey) -> Iterator[Spots]:
    for shots in survey.shots:
        mount = result.sensors[shots.name]
        some = evenly(len(shots.reading), 20 * MOST_POINTS)
        rays = KINDS[shots.kind].rays(shots.across[some])
        spot = rays.origin + shots.reading[some, None] * rays.direction
        place, source = (x @ mount.rotation.T + mount.location for x in (spot, rays.origin))
        yield shots.name, shots.station[some], place, source
    if survey.ranges is not None:
        for i, name in enumerate(survey.beam_names):
            beam = result.beams[name]
            station = np.flatnonzero(~np.isnan(survey.ranges[:, i]))
            d = survey.ranges[station, i]
            d = d * (1.0 + beam.range_error[0] + beam.range_error[1] * d)
            place = beam.location + d[:, None] * beam.direction
            yield name, station, place, np.broadcast_to(beam.location, place.shape)


def _labels(survey: Survey) -> NDArray[np.str_]:
    return np.array([normal_label(x) for x in survey.stations.plane_labels])


def _off(
    result: SurveyCalibration, survey: Survey, station: IntArray, place: FloatArray
) -> FloatArray:
    """Return the distances (N,) of spots from their targets [m]; NaN where there is none."""
    off, labels = np.full(len(station), np.nan), _labels(survey)[station]
    for target in result.targets.values():
        seen, v = labels == target.label, target.values
        if target.kind == "plane":
            off[seen] = place[seen] @ [v["nx"], v["ny"], v["nz"]] + v["b"]
        elif target.kind == "sphere":
            centre = np.array([v["x"], v["y"], v["z"]])
            off[seen] = np.linalg.norm(place[seen] - centre, axis=1) - v["radius"]
    return off


def _scene(result: SurveyCalibration, survey: Survey, spots: list[Spots]) -> Figure:
    """Return the picture in space: targets, hands, and where each sensor looked."""
    labels, planes = _labels(survey), []
    for target in result.targets.values():
        if target.kind != "plane":
            continue
        seen = [place[labels[station] == target.label] for _, station, place, _ in spots]
        points = np.concatenate(seen) if seen else np.empty((0, 3))
        if len(points) > 2:  # the two of a groove have labels of their own
            v = target.values
            planes.append((target.label, plate(np.array([v["nx"], v["ny"], v["nz"]]), points)))
    beams = []
    for name, station, place, source in spots:
        stations = np.unique(station)
        stations = stations[evenly(len(stations), MOST_POINTS // 4)]
        middles = [[x[station == s].mean(axis=0) for x in (source, place)] for s in stations]
        names = tuple(survey.stations.station_names[s] for s in stations)
        beams.append((name, np.array(middles) * IN_MM, names))
    of = survey.stations
    some = evenly(len(of), MOST_POINTS // 4)
    extent = float(np.ptp(np.concatenate([place for _, _, place, _ in spots]), axis=0).max())
    hands = np.repeat(of.world_t_hand[some][:, None], 4, axis=1)
    hands[:, 1:] += 0.1 * extent * np.swapaxes(of.world_R_hand[some], 1, 2)
    geometry = Geometry(
        "world",
        tuple(planes),
        tuple(beams),
        hands * IN_MM,
        tuple(of.station_names[i] for i in some),
    )
    caption = "Each sensor at its stations, with a line to the middle of what it saw there."
    return replace(scene_figure(geometry), caption=caption)


def _by_station(result: SurveyCalibration, survey: Survey, spots: list[Spots]) -> Figure:
    """Return how far the points of each shot are from their target, in the mean."""
    traces: list[Record] = []
    names = survey.stations.station_names
    for index, (name, station, place, _) in enumerate(spots):
        off = _off(result, survey, station, place)
        good = np.isfinite(off)
        stations = np.unique(station[good])
        mean = [float(off[good & (station == s)].mean()) for s in stations]
        traces.append(
            {
                "type": "scatter",
                "mode": "markers",
                "name": label(name),
                "x": [int(s) + 1 for s in stations],
                "y": numbers(np.array(mean) * IN_MM, 4),
                "text": [label(names[s]) for s in stations],
                "hovertemplate": "%{text}: %{y} mm<extra></extra>",
                "marker": marker(index, len(spots)),
            }
        )
    shown = layout("station", "mean distance from the target, mm", legend=len(spots) > 1)
    caption = (
        "How far the points of each shot are from their target, in the mean; shots that were left "
        "out are drawn, too."
    )
    return Figure("by-station", caption, traces, shown)


def _profiles(survey: Survey) -> Figure | None:
    """Return profiles and scans in the plane of their sensor; None where there are none."""
    flat = [shots for shots in survey.shots if KINDS[shots.kind].flat]
    if not flat:
        return None
    traces: list[Record] = []
    for index, shots in enumerate(flat):
        for place, (station, x, z) in enumerate(_drawn_profiles(shots)):
            traces.append(
                {
                    "type": "scatter",
                    "mode": "lines",
                    "name": label(shots.name),
                    "legendgroup": shots.name,
                    "showlegend": place == 0,
                    "x": numbers(x * IN_MM, 5),
                    "y": numbers(z * IN_MM, 5),
                    "text": label(survey.stations.station_names[station]),
                    "hovertemplate": "%{text}<extra></extra>",
                    "line": {"color": colour(index, len(flat)), "width": 1},
                    "opacity": 0.6,
                }
            )
    more: Record = {"yaxis": axis("second axis of the sensor, mm", scaleanchor="x")}
    shown = layout("first axis of the sensor, mm", "", 380, more, legend=len(flat) > 1)
    caption = (
        "What the sensors saw, in their own planes: x and z of a profiler, x and y of a scanner."
    )
    return Figure("profiles", caption, traces, shown)


def _drawn_profiles(shots: Shots) -> Iterator[tuple[int, FloatArray, FloatArray]]:
    stations = np.unique(shots.station)
    for station in stations[evenly(len(stations), MOST_SHAPES)]:
        rows = np.flatnonzero(shots.station == station)
        rows = rows[np.argsort(shots.across[rows, 0], kind="stable")]
        rows = rows[evenly(len(rows), POINTS_OF_PROFILE)]
        rays = KINDS[shots.kind].rays(shots.across[rows])
        p = rays.origin + shots.reading[rows, None] * rays.direction
        first, second = p[:, KINDS[shots.kind].axes].T
        yield int(station), first, second
