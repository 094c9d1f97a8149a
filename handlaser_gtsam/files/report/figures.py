"""The flat figures of a report: residuals, Q-Q, correlations, and the uncertainty by stations."""

import math
from itertools import pairwise

import numpy as np
from scipy.stats import beta, norm

from ...arrays import BoolArray, FloatArray, IntArray
from ...results.lines import DEG, MM
from ..json_text import Record
from .evidence import FLAGGED, MOST_BEAMS
from .figure import (
    COLOURS,
    GREY,
    SYMBOLS,
    Figure,
    axis,
    colour,
    label,
    layout,
    numbers,
)
from .mounts import correlation_matrix
from .subject import ReadingRows, Subject

MOST_POINTS = 1500
"""Points of a figure; of more, every so many-th and the largest."""
MOST_TICKS, MOST_BANDS = 16, 60
LEGEND = 8
"""Up to so many beams have a legend."""
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
    return [*found, _against_station(subject, rows, shown), _against_plane(subject, rows, shown)]


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
                "y": numbers(rows.residual[own] * MM),
                "text": words,
                "marker": {
                    "color": colour(index, len(names)),
                    "symbol": SYMBOLS[index % len(SYMBOLS)],
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
    sigma = subject.calibration.fit.range_sigma * MM
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
    return Figure("by-range", caption, _points(subject, rows, shown, rows.reading * MM), drawn)


def _against_incidence(subject: Subject, rows: ReadingRows, shown: IntArray) -> Figure:
    caption = (
        "Residual against the angle between beam and plane normal. A spread that grows says that "
    )
    caption += "flat incidence errs more."
    drawn = layout(
        "incidence, deg", "residual, mm", more={"shapes": _band(subject)} | _legend(subject)
    )
    points = _points(subject, rows, shown, rows.incidence * DEG)
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
    drawn = layout(
        "station, in their order", "residual, mm", more={"shapes": bands} | _legend(subject)
    )
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
        ticktext=[label(names[p]) for p in ticks],
        range=[-0.6, len(names) - 0.4],
        showgrid=False,
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
    expected = np.asarray(norm.ppf((rank - 0.5) / count))
    low, high = (
        np.asarray(norm.ppf(beta.ppf(tail, rank, count + 1 - rank))) for tail in (0.025, 0.975)
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


def correlation_figure(subject: Subject) -> Figure | None:
    """Return the correlations of all unknowns of the beams; None without a covariance."""
    labels, C = correlation_matrix(subject, MOST_BEAMS)
    if not labels or not subject.solved:
        return None
    beams = list(dict.fromkeys(beam for beam, _ in labels))
    first = [next(i for i, (beam, _) in enumerate(labels) if beam == name) for name in beams]
    ends = [*first[1:], len(labels)]
    words = [f"beam {label(beam)} {name}" for beam, name in labels]
    trace: Record = {
        "type": "heatmap",
        "z": [numbers(row, 3) for row in C],
        "text": [[f"{one}<br>{other}" for other in words] for one in words],
        "hovertemplate": "%{text}<br>%{z:.3f}<extra></extra>",
        "zmin": -1,
        "zmax": 1,
        "colorscale": _scale(),
        "colorbar": {
            "thickness": 10,
            "len": 0.9,
            "outlinewidth": 0,
            "tickvals": [-1, -0.8, 0, 0.8, 1],
        },
    }
    middles = [(a + b - 1) / 2.0 for a, b in zip(first, ends, strict=True)]
    names = [f"beam {label(name)}" for name in beams]
    lines: list[Record] = [
        {"type": "line", "line": {"color": "white", "width": 2}, **where}
        for start in first[1:]
        for where in (
            {"xref": "paper", "x0": 0, "x1": 1, "y0": start - 0.5, "y1": start - 0.5},
            {"yref": "paper", "y0": 0, "y1": 1, "x0": start - 0.5, "x1": start - 0.5},
        )
    ]
    side = axis("", tickvals=middles, ticktext=names, showgrid=False, zeroline=False, ticks="")
    caption = (
        "Correlations. Every beam has location x, y, z, two components of its direction, and its "
    )
    caption += f"range errors. Dark is above {FLAGGED} in size: hardly told apart."
    upright = side | {"autorange": "reversed", "tickangle": -90}
    drawn = layout("", "", 420, {"xaxis": side, "yaxis": upright, "shapes": lines})
    return Figure("correlation", caption, [trace], drawn)


def _scale() -> list[tuple[float, str]]:
    """Return colours that are pale up to the flag and dark beyond."""
    edge = 0.5 * (1.0 + FLAGGED)
    return [
        (0.0, "#08306b"),
        (1.0 - edge, "#6baed6"),
        (0.5, "#f7f8fa"),
        (edge, "#fc9272"),
        (1.0, "#7f0000"),
    ]


def stations_figure(subject: Subject) -> Figure | None:
    """Return how the uncertainty fell with the stations, and what the next ones promise."""
    past, plan = subject.history, subject.plan
    if past is None or not np.isfinite(past.known.spot).any():
        return None
    place = f"95 % spot at {subject.reading * MM:.3g} mm, mm"
    curves = (
        (place, past.known.spot * MM, "y", COLOURS[0], "spot"),
        ("location, mm", past.known.location_sigma * MM, "y", COLOURS[1], "location_sigma"),
        (
            "direction, deg (right)",
            past.known.direction_sigma * DEG,
            "y2",
            COLOURS[2],
            "direction_sigma",
        ),
    )
    traces: list[Record] = []
    for name, values, side, shade, quantity in curves:
        trace: Record = {
            "type": "scatter",
            "mode": "lines+markers",
            "name": name,
            "x": numbers(past.stations.astype(float)),
            "y": numbers(values),
            "yaxis": side,
            "line": {"color": shade, "width": 2},
            "marker": {"size": 4},
            "hovertemplate": "%{y:.3g} after %{x} stations",
        }
        traces.append(trace)
        if plan is not None:
            ahead = getattr(plan.forecast, quantity) * (DEG if side == "y2" else MM)
            x = past.stations[-1] + np.arange(len(ahead), dtype=float)
            dashed: Record = {
                "x": numbers(x),
                "y": numbers(ahead),
                "line": {"color": shade, "width": 2, "dash": "dot"},
                "showlegend": False,
            }
            traces.append(trace | dashed)
    upright = axis("mm", type="log", dtick="D2")
    right = axis("deg", type="log", dtick="D2", overlaying="y", side="right", showgrid=False)
    caption = "Largest standard deviations, and the largest 95 % spot error, after the first "
    caption += "stations of the recording, at the noise found from all."
    if plan is not None:
        caption += " Dotted: what the next best stations promise."
    margin: Record = {"l": 58, "r": 58, "t": 34, "b": 48}
    more: Record = {"yaxis": upright, "yaxis2": right, "showlegend": True, "margin": margin}
    return Figure("by-count", caption, traces, layout("stations", "mm", more=more))
