"""All flat figures of a calibration of beams; `sections.html.j2` places them, with their captions.

A further one is a line of `flat_figures`. `page` adds the scenes, and `survey_figures` has the figures
of surveys.
"""

import math
from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from ...arrays import FloatArray, IntArray, evenly
from ...model.distributions import CONFIDENCE, beta_quantile, gaussian_quantile
from ...model.families import BEAM
from ...model.joint import STRONG, correlation_matrix
from ...quantities import IN_DEG, IN_MM
from ..checked_text import Record
from .figure import (
    COLOURS,
    LEGEND,
    MOST_POINTS,
    MOST_SHAPES,
    STYLE,
    Figure,
    axis,
    axis_of_names,
    axis_of_stations,
    label,
    layout,
    marker,
    numbers,
    trace,
)
from .subject import ReadingRows, Subject

BESIDE = 0.7
"""The part of the distance between two planes that their beams take up: a gap tells the planes
apart."""
SHADES = ("#08306b", "#6baed6", "#f7f8fa", "#fc9272", "#7f0000")
"""Of correlations from -1 to 1: pale up to a strong one, and dark beyond."""


def flat_figures(subject: Subject) -> list[Figure]:
    """Return the flat figures that there are something to draw for."""
    figures = [*residual_figures(subject), qq_figure(subject)]
    joint = subject.calibration.covariance
    if joint is not None and subject.solved:
        names, directions = joint.beam_names[:LEGEND], subject.calibration.parameters().directions
        figures.append(correlation_figure(names, directions[:LEGEND], joint.matrix(names, [])))
    figures.append(stations_figure(subject))
    return [figure for figure in figures if figure is not None]


def residual_figures(subject: Subject) -> list[Figure]:
    """Return the residuals against range, incidence, station and plane; none without a recording."""
    rows = subject.rows
    if rows is None or not rows.used.any():
        return []
    recording, names = rows.recording, list(subject.calibration.beams)
    drawn = _drawn(rows)
    each = [(i, drawn[rows.beam[drawn] == i]) for i in range(len(names))]
    beams = [
        (
            mine,
            {
                "name": f"beam {label(names[index])}",
                "text": [
                    f"station {label(recording.station_names[j])}, "
                    f"plane {label(recording.plane_labels[j])}"
                    for j in rows.station[mine].tolist()
                ],
                "marker": marker(index, len(names)) | {"opacity": 0.8},
            },
        )
        for index, mine in each
        if len(mine)
    ]
    # The band of one standard deviation of a reading, where nothing else lies behind the points.
    sigma = subject.calibration.fit.range_sigma * IN_MM
    noise = [_band("x", -sigma, sigma)] if subject.solved and math.isfinite(sigma) else []
    planes = recording.plane_of_station
    ends = [0.5, *(np.flatnonzero(np.diff(planes)) + 1.5).tolist(), len(planes) + 0.5]
    every_other = [_band("y", *edges) for edges in list(pairwise(ends))[1 : 2 * MOST_SHAPES : 2]]
    beside = BESIDE * ((rows.beam + 0.5) / len(names) - 0.5)
    figures: dict[str, tuple[str, FloatArray, Record]] = {
        "by-range": ("reading, mm", rows.reading * IN_MM, {}),
        "by-incidence": ("incidence, deg", rows.incidence * IN_DEG, {}),
        "by-station": (
            "",
            1.0 + rows.station.astype(np.float64),
            {"xaxis": axis_of_stations(len(planes)), "shapes": every_other},
        ),
        "by-plane": (
            "",
            planes[rows.station] + beside,
            {"xaxis": axis_of_names("plane", recording.plane_names)},
        ),
    }
    if not subject.solved:
        del figures["by-incidence"]
    legend, e = 1 < len(names) <= LEGEND, rows.residual * IN_MM
    return [
        Figure(
            name,
            [trace("residuals", x[mine], e[mine]) | one for mine, one in beams],
            layout(title, "residual, mm", legend=legend) | {"shapes": noise} | more,
        )
        for name, (title, x, more) in figures.items()
    ]


def _drawn(rows: ReadingRows) -> IntArray:
    """Return the rows that are drawn: all, or half of them evenly spread and half the largest."""
    used = np.flatnonzero(rows.used)
    if len(used) <= MOST_POINTS:
        return used
    half = MOST_POINTS // 2
    largest = np.argsort(-np.abs(rows.residual[used]), kind="stable")[:half]
    return used[np.union1d(largest, evenly(len(used), half))]


def _band(across: str, low: float, high: float, style: str = "band") -> Record:
    """Return a grey band, or a line, that goes all `across` the figure, along x or y, between edges."""
    along = "y" if across == "x" else "x"
    ends: Record = {f"{across}ref": "paper", f"{across}0": 0, f"{across}1": 1}
    return STYLE[style] | ends | {f"{along}0": low, f"{along}1": high}


def qq_figure(subject: Subject) -> Figure | None:
    """Return the standardized residuals beside Gaussian quantiles; None without a calibration."""
    rows = subject.rows
    if rows is None or not subject.solved:
        return None
    z = np.sort(rows.standardized[rows.used & np.isfinite(rows.standardized)])
    count = len(z)
    if count < 3 or not z.any():  # of an exact fit
        return None
    rank, drawn = np.arange(1, count + 1), evenly(count, MOST_POINTS)
    x = gaussian_quantile((rank - 0.5) / count)[drawn]
    low, high = (
        gaussian_quantile(beta_quantile(tail, rank, count + 1 - rank))[drawn]
        for tail in (0.5 * (1.0 - CONFIDENCE), 0.5 * (1.0 + CONFIDENCE))
    )
    traces = [
        trace("edge", x, low),
        trace("edge", x, high) | STYLE["filled"],
        trace("edge", x, x) | STYLE["diagonal"],
        trace("quantiles", x, z[drawn]),
    ]
    return Figure("qq", traces, layout("expected", "residual, standard deviations"))


def correlation_figure(
    names: Sequence[str], directions: FloatArray, covariance: FloatArray
) -> Figure:
    """Return the correlations of beams as a map; arguments as of `correlation_matrix`."""
    unknowns, C = correlation_matrix(names, directions, covariance)
    owners = [unknown.beam for unknown in unknowns]
    beams = list(dict.fromkeys(owners))
    first = [owners.index(beam) for beam in beams]
    numbered = {beam: label(beam) for beam in beams}
    if len(set(numbered.values())) < len(beams):  # names that differ only where they are cut
        numbered = {beam: f"{label(beam)} ({i})" for i, beam in enumerate(beams, 1)}
    words = [f"beam {numbered[one.beam]} {BEAM.labels[one.number]}" for one in unknowns]
    at = (0.0, 0.5 * (1.0 - STRONG), 0.5, 0.5 * (1.0 + STRONG), 1.0)
    drawn: Record = {"z": [numbers(row, 3) for row in C], "x": words, "y": words}
    drawn["colorscale"] = list(zip(at, SHADES, strict=True))
    middles = [0.5 * (a + b - 1) for a, b in pairwise((*first, len(owners)))]
    longest = max(24 // len(beams), 3)  # letters of all labels on a phone, and of one at least
    ticks = [label(beam, longest) for beam in beams]
    side = axis("beam", type="category", tickvals=middles, ticktext=ticks, ticks="")
    side |= STYLE["names"]
    borders = [  # between the beams
        _band(across, edge - 0.5, edge - 0.5, "border") for edge in first[1:] for across in "xy"
    ]
    upright = side | {"autorange": "reversed", "tickangle": -90}
    square: Record = {"height": 420, "xaxis": side, "yaxis": upright, "shapes": borders}
    return Figure("correlation", [STYLE["correlations"] | drawn], layout("", "") | square)


def stations_figure(subject: Subject) -> Figure | None:
    """Return how the uncertainty fell with the stations, and what the next ones promise."""
    past, plan = subject.history, subject.plan
    if past is None or not np.isfinite(past[1].spot).any():
        return None
    stations, known = past[0].astype(np.float64), past[1]
    reading = f"{subject.verdict.reading * IN_MM:.3g} mm"
    traces: list[Record] = []
    for shade, side, name, quantity, unit in (
        (COLOURS[0], "y", f"95 % spot at {reading}, mm", "spot", IN_MM),
        (COLOURS[1], "y", "location, mm", "location_sigma", IN_MM),
        (COLOURS[2], "y2", "direction, deg (right)", "direction_sigma", IN_DEG),
    ):
        y, line = getattr(known, quantity) * unit, {"color": shade, "width": 2}
        curve: Record = {"name": name, "yaxis": side, "line": line}
        traces.append(trace("curve", stations, y) | curve)
        if plan is not None:
            ahead = getattr(plan.forecast, quantity) * unit
            dotted: Record = {"line": line | {"dash": "dot"}, "showlegend": False}
            x = stations[-1] + np.arange(len(ahead))
            traces.append(trace("curve", x, ahead) | curve | dotted)
    both: Record = {
        "yaxis": axis("mm") | STYLE["logarithmic"],
        "yaxis2": axis("deg") | STYLE["logarithmic"] | STYLE["right"],
    }
    shown = layout("stations", "mm", legend=True) | STYLE["two sides"] | both
    return Figure("by-count", traces, shown)
