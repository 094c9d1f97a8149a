"""Figures of the residuals: against range, incidence, station and plane, and beside a Gaussian."""

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np

from ...arrays import BoolArray, FloatArray, IntArray
from ...model.distributions import beta_quantile, gaussian_quantile
from ...quantities import IN_DEG, IN_MM
from ..json_text import Record
from .figure import (
    COLOURS,
    GREY,
    LEGEND,
    SYMBOLS,
    Figure,
    axis,
    colour,
    label,
    layout,
    numbers,
    tick_labels,
)
from .subject import ReadingRows, Subject

MOST_POINTS = 1000
"""Points of a figure; of more, every so many-th and the largest."""
MOST_TICKS, MOST_BANDS = 16, 60
"""Names of planes that fit below a figure, and bands that an eye tells apart behind it."""
ROOM = 48
"""Letters of all planes below a figure on a phone."""
SPREAD = 0.7
"""Of the distance between two planes, what the beams of one take up."""
UPPER_MARGIN: Record = {"l": 58, "r": 14, "t": 34, "b": 48}


def residual_figures(subject: Subject) -> list[Figure]:
    """Return the residuals against range, incidence, station and plane; none without a recording."""
    recording, rows = subject.calibration.recording, subject.rows
    if recording is None or rows is None or not rows.used.any():
        return []
    shown = _shown(rows)
    found = [_against_range(subject, rows, shown)]
    if subject.solved:
        found.append(_against_incidence(subject, rows, shown))
    found += [_against_station(subject, rows, shown), _against_plane(subject, rows, shown)]
    used = int(rows.used.sum())
    if len(shown) == used:
        return found
    note = f" {len(shown)} of {used} readings are drawn, the largest residuals among them."
    return [replace(one, caption=one.caption + note) for one in found]


def _shown(rows: ReadingRows) -> IntArray:
    """Return the rows that are drawn: all, or every so many-th and the largest."""
    used = np.flatnonzero(rows.used)
    if len(used) <= MOST_POINTS:
        return used
    half = MOST_POINTS // 2
    largest = np.argsort(-np.abs(rows.residual[used]), kind="stable")[:half]
    every = np.linspace(0, len(used) - 1, half).round().astype(np.intp)
    return used[np.union1d(largest, every)]


def _points(subject: Subject, rows: ReadingRows, shown: IntArray, x: FloatArray) -> list[Record]:
    """Return one trace a beam: residuals over x, which has one entry a reading."""
    recording, names = subject.calibration.recording, list(subject.calibration.beams)
    traces: list[Record] = []
    for index, name in enumerate(names):
        own = shown[rows.beam[shown] == index]
        if recording is None or not len(own):
            continue
        words = [
            f"station {label(recording.station_names[j])}, plane {label(recording.plane_labels[j])}"
            for j in rows.station[own].tolist()
        ]
        traces.append(
            {
                "type": "scatter",
                "mode": "markers",
                "name": f"beam {label(name)}",
                "x": numbers(x[own]),
                "y": numbers(rows.residual[own] * IN_MM),
                "text": words,
                "marker": {
                    "color": colour(index, len(names)),
                    "symbol": SYMBOLS[index] if len(names) <= LEGEND else SYMBOLS[0],
                    "size": 6,
                    "opacity": 0.8,
                },
                "hovertemplate": "%{y:.4f} mm<br>%{text}",
            }
        )
    return traces


def _legend(subject: Subject) -> Record:
    wanted = 1 < len(subject.calibration.beams) <= LEGEND
    return {"showlegend": wanted, "margin": UPPER_MARGIN} if wanted else {}


def _band(subject: Subject) -> list[Record]:
    """Return the band of one standard deviation of a reading."""
    sigma = subject.calibration.fit.range_sigma * IN_MM
    if not (subject.solved and math.isfinite(sigma)):
        return []
    shape: Record = {
        "type": "rect",
        "xref": "paper",
        "x0": 0,
        "x1": 1,
        "y0": -sigma,
        "y1": sigma,
        "fillcolor": "rgba(120,135,150,0.14)",
        "line": {"width": 0},
        "layer": "below",
    }
    return [shape]


def _against_range(subject: Subject, rows: ReadingRows, shown: IntArray) -> Figure:
    caption = "Residual against reading. A trend says that the range error has more terms."
    if subject.solved:
        caption += (
            " The grey band is one standard deviation of a reading, without that of the pose."
        )
    drawn = layout(
        "reading, mm", "residual, mm", more={"shapes": _band(subject)} | _legend(subject)
    )
    return Figure("by-range", caption, _points(subject, rows, shown, rows.reading * IN_MM), drawn)


def _against_incidence(subject: Subject, rows: ReadingRows, shown: IntArray) -> Figure:
    caption = (
        "Residual against the angle between beam and plane normal. A spread that grows says that "
    )
    caption += "flat incidence errs more."
    drawn = layout(
        "incidence, deg", "residual, mm", more={"shapes": _band(subject)} | _legend(subject)
    )
    points = _points(subject, rows, shown, rows.incidence * IN_DEG)
    return Figure("by-incidence", caption, points, drawn)


def _against_station(subject: Subject, rows: ReadingRows, shown: IntArray) -> Figure:
    recording = subject.calibration.recording
    planes = np.empty(0) if recording is None else recording.plane_of_station
    edges = np.flatnonzero(np.diff(planes)) + 1.5
    ends = [0.5, *edges.tolist(), len(planes) + 0.5]
    bands: list[Record] = [
        {
            "type": "rect",
            "yref": "paper",
            "x0": low,
            "x1": high,
            "y0": 0,
            "y1": 1,
            "fillcolor": "rgba(120,135,150,0.09)",
            "line": {"width": 0},
            "layer": "below",
        }
        for low, high in list(pairwise(ends))[1:MOST_BANDS:2]
    ]
    caption = (
        "Residual by station, in the order of the recording; a band for every other plane. A drift "
    )
    caption += "or a step says that something moved."
    below = axis("station, in their order", zeroline=False, range=[0.0, len(planes) + 1.0])
    drawn = layout("", "residual, mm", more={"xaxis": below, "shapes": bands} | _legend(subject))
    points = _points(subject, rows, shown, 1.0 + rows.station.astype(np.float64))
    return Figure("by-station", caption, points, drawn)


def _against_plane(subject: Subject, rows: ReadingRows, shown: IntArray) -> Figure:
    recording, beams = subject.calibration.recording, len(subject.calibration.beams)
    names = () if recording is None else recording.plane_names
    plane = np.zeros(len(rows.station))
    if recording is not None:
        plane = recording.plane_of_station[rows.station].astype(float)
    places = plane + SPREAD * ((rows.beam + 0.5) / beams - 0.5)
    every = max(1, math.ceil(len(names) / MOST_TICKS))
    ticks = list(range(0, len(names), every))
    below = axis(
        "plane",
        tickvals=list(ticks),
        ticktext=tick_labels([names[p] for p in ticks], ROOM),
        range=[-0.6, len(names) - 0.4],
        showgrid=False,
        zeroline=False,
    )
    caption = (
        "Residual by plane, its beams side by side. A plane that stands out is bent, moved or "
    )
    caption += "wrongly labelled."
    drawn = layout(
        "plane", "residual, mm", more={"xaxis": below, "shapes": _band(subject)} | _legend(subject)
    )
    return Figure("by-plane", caption, _points(subject, rows, shown, places), drawn)


def qq_figure(subject: Subject) -> Figure | None:
    """Return the standardized residuals beside those of a Gaussian; None without a calibration."""
    rows = subject.rows
    if rows is None or not subject.solved:
        return None
    z = rows.standardized[rows.used & np.isfinite(rows.standardized)]
    if len(z) < 3:
        return None
    z, count = np.sort(z), len(z)
    rank = np.arange(1, count + 1)
    expected = gaussian_quantile((rank - 0.5) / count)
    low, high = (
        gaussian_quantile(beta_quantile(tail, rank, count + 1 - rank)) for tail in (0.025, 0.975)
    )
    keep = _evenly(count)
    x = numbers(expected[keep])
    edge: Record = {"type": "scatter", "mode": "lines", "x": x, "hoverinfo": "skip"}
    traces: list[Record] = [
        edge | {"y": numbers(low[keep]), "line": {"width": 0}},
        edge
        | {
            "y": numbers(high[keep]),
            "line": {"width": 0},
            "fill": "tonexty",
            "fillcolor": "rgba(120,135,150,0.18)",
        },
        edge | {"y": x, "line": {"color": GREY, "width": 1}},
        {
            "type": "scatter",
            "mode": "markers",
            "x": x,
            "y": numbers(z[keep]),
            "marker": {"color": COLOURS[0], "size": 5},
            "hovertemplate": "%{y:.2f} where %{x:.2f} is expected<extra></extra>",
        },
    ]
    caption = "Q-Q plot: residuals in their standard deviations beside those of a Gaussian. Good "
    caption += "ones stay in the grey band, which holds each point with 95 %."
    return Figure("qq", caption, traces, layout("expected", "residual, standard deviations"))


def _evenly(count: int) -> BoolArray:
    keep = np.ones(count, dtype=bool)
    if count > MOST_POINTS:
        keep[:] = False
        keep[np.linspace(0, count - 1, MOST_POINTS).round().astype(np.intp)] = True
    return keep
