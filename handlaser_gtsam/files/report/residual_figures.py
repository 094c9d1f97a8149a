"""Figures of the residuals: against range, incidence, station and plane, and beside a Gaussian."""

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np

from ...arrays import FloatArray, IntArray, evenly
from ...model.distributions import CONFIDENCE, beta_quantile, gaussian_quantile
from ...quantities import IN_DEG, IN_MM
from ..checked_text import Record
from .figure import (
    COLOURS,
    GREY,
    LEGEND,
    LETTERS_BELOW,
    MOST_POINTS,
    MOST_SHAPES,
    SHORTEST_LABEL,
    Figure,
    axis,
    label,
    layout,
    marker,
    numbers,
    tick_labels,
)
from .subject import ReadingRows, Subject

BESIDE = 0.7
"""The part of the distance between two planes that their beams take up: a gap tells the planes
apart."""


def residual_figures(subject: Subject) -> list[Figure]:
    """Return the residuals against range, incidence, station and plane; none without a recording."""
    rows = subject.rows
    if rows is None or not rows.used.any():
        return []
    drawn = _drawn(rows)
    figures = [_by_range(subject, rows, drawn)]
    figures += [_by_incidence(subject, rows, drawn)] if subject.solved else []
    figures += [_by_station(subject, rows, drawn), _by_plane(subject, rows, drawn)]
    used = int(rows.used.sum())
    if len(drawn) == used:
        return figures
    note = f" {len(drawn)} of {used} readings are drawn, the largest residuals among them."
    return [replace(figure, caption=figure.caption + note) for figure in figures]


def _drawn(rows: ReadingRows) -> IntArray:
    """Return the rows that are drawn: all, or half of them evenly spread and half the largest."""
    used = np.flatnonzero(rows.used)
    if len(used) <= MOST_POINTS:
        return used
    half = MOST_POINTS // 2
    largest = np.argsort(-np.abs(rows.residual[used]), kind="stable")[:half]
    return used[np.union1d(largest, evenly(len(used), half))]


def _by_range(subject: Subject, rows: ReadingRows, drawn: IntArray) -> Figure:
    caption = "Residual against reading. A trend says that the range error has more terms."
    if subject.solved:
        caption += (
            " The grey band is one standard deviation of a reading, without that of the pose."
        )
    return _figure(subject, "by-range", caption, "reading, mm", rows, drawn, rows.reading * IN_MM)


def _by_incidence(subject: Subject, rows: ReadingRows, drawn: IntArray) -> Figure:
    caption = (
        "Residual against the angle between beam and plane normal. A spread that grows says that "
        "flat incidence errs more."
    )
    x = rows.incidence * IN_DEG
    return _figure(subject, "by-incidence", caption, "incidence, deg", rows, drawn, x)


def _by_station(subject: Subject, rows: ReadingRows, drawn: IntArray) -> Figure:
    caption = (
        "Residual by station, in the order of the recording; a band for every other plane. A drift "
        "or a step says that something moved."
    )
    planes = rows.recording.plane_of_station
    ends = [0.5, *(np.flatnonzero(np.diff(planes)) + 1.5).tolist(), len(planes) + 0.5]
    bands = [
        _band("y", x0=low, x1=high) for low, high in list(pairwise(ends))[1 : 2 * MOST_SHAPES : 2]
    ]
    below = axis("station, in their order", zeroline=False, range=[0.0, len(planes) + 1.0])
    x = 1.0 + rows.station.astype(np.float64)
    return _figure(subject, "by-station", caption, "", rows, drawn, x, xaxis=below, shapes=bands)


def _by_plane(subject: Subject, rows: ReadingRows, drawn: IntArray) -> Figure:
    caption = (
        "Residual by plane, its beams side by side. A plane that stands out is bent, moved or "
        "wrongly labelled."
    )
    beams, names = len(subject.calibration.beams), rows.recording.plane_names
    x = rows.recording.plane_of_station[rows.station] + BESIDE * ((rows.beam + 0.5) / beams - 0.5)
    every = max(1, math.ceil(len(names) * SHORTEST_LABEL / LETTERS_BELOW))
    ticks = list(range(0, len(names), every))
    below = axis(
        "plane",
        tickvals=ticks,
        ticktext=tick_labels([names[p] for p in ticks]),
        range=[-0.6, len(names) - 0.4],
        showgrid=False,
        zeroline=False,
    )
    return _figure(subject, "by-plane", caption, "plane", rows, drawn, x, xaxis=below)


def _figure(
    subject: Subject,
    name: str,
    caption: str,
    title: str,
    rows: ReadingRows,
    drawn: IntArray,
    x: FloatArray,
    **more: object,
) -> Figure:
    """Return the residuals over x, which has one entry a reading: one trace a beam."""
    recording, names = rows.recording, list(subject.calibration.beams)
    traces: list[Record] = []
    for index, beam in enumerate(names):
        mine = drawn[rows.beam[drawn] == index]
        if not len(mine):
            continue
        words = [
            f"station {label(recording.station_names[j])}, plane {label(recording.plane_labels[j])}"
            for j in rows.station[mine].tolist()
        ]
        traces.append(
            {
                "type": "scatter",
                "mode": "markers",
                "name": f"beam {label(beam)}",
                "x": numbers(x[mine]),
                "y": numbers(rows.residual[mine] * IN_MM),
                "text": words,
                "marker": marker(index, len(names)) | {"opacity": 0.8},
                "hovertemplate": "%{y:.4f} mm<br>%{text}",
            }
        )
    # The band of one standard deviation of a reading, where nothing else lies behind the points.
    sigma = subject.calibration.fit.range_sigma * IN_MM
    known = subject.solved and math.isfinite(sigma)
    shared: Record = {"shapes": [_band("x", y0=-sigma, y1=sigma)] if known else []}
    legend = 1 < len(names) <= LEGEND
    drawn_in = layout(title, "residual, mm", more=shared | more, legend=legend)
    return Figure(name, caption, traces, drawn_in)


def _band(across: str, **edges: float) -> Record:
    """Return a grey band that goes all `across` the figure, along x or y, between two edges."""
    return {
        "type": "rect",
        f"{across}ref": "paper",
        f"{across}0": 0,
        f"{across}1": 1,
        **edges,
        "fillcolor": "rgba(120,135,150,0.12)",
        "line": {"width": 0},
        "layer": "below",
    }


def qq_figure(subject: Subject) -> Figure | None:
    """Return the standardized residuals beside Gaussian quantiles; None without a calibration."""
    rows = subject.rows
    if rows is None or not subject.solved:
        return None
    z = np.sort(rows.standardized[rows.used & np.isfinite(rows.standardized)])
    count = len(z)
    if count < 3 or not z.any():  # of an exact fit
        return None
    rank = np.arange(1, count + 1)
    expected = gaussian_quantile((rank - 0.5) / count)
    low, high = (
        gaussian_quantile(beta_quantile(tail, rank, count + 1 - rank))
        for tail in (0.5 * (1.0 - CONFIDENCE), 0.5 * (1.0 + CONFIDENCE))
    )
    drawn = evenly(count, MOST_POINTS)
    x = numbers(expected[drawn])
    edge: Record = {"type": "scatter", "mode": "lines", "x": x, "hoverinfo": "skip"}
    traces: list[Record] = [
        edge | {"y": numbers(low[drawn]), "line": {"width": 0}},
        edge
        | {
            "y": numbers(high[drawn]),
            "line": {"width": 0},
            "fill": "tonexty",
            "fillcolor": "rgba(120,135,150,0.18)",
        },
        edge | {"y": x, "line": {"color": GREY, "width": 1}},
        {
            "type": "scatter",
            "mode": "markers",
            "x": x,
            "y": numbers(z[drawn]),
            "marker": {"color": COLOURS[0], "size": 5},
            "hovertemplate": "%{y:.2f} where %{x:.2f} is expected<extra></extra>",
        },
    ]
    caption = (
        "Q-Q plot: residuals in their standard deviations beside those of a Gaussian. Good "
        "ones stay in the grey band, which holds each point with 95 %."
    )
    return Figure("qq", caption, traces, layout("expected", "residual, standard deviations"))
