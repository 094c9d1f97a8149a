"""All flat figures of a calibration of beams, in the order of the report.

A further one is a line of `flat_figures`. `page` adds the scenes, and `survey` has the figures of
surveys.
"""

import math
from collections.abc import Sequence

import numpy as np

from ...arrays import FloatArray
from ...model.families import BEAM
from ...model.joint import STRONG, correlation_matrix
from ...planning.picture import logarithmic_ticks
from ...quantities import IN_DEG, IN_MM
from ..checked_text import Record
from .figure import (
    COLOURS,
    LEGEND,
    LETTERS_BELOW,
    Figure,
    axis,
    label,
    layout,
    numbers,
    tick_labels,
)
from .residual_figures import qq_figure, residual_figures
from .subject import Subject

LABELS_ABOVE = 7
"""Labels of an axis that fit above one another."""
CLEAR = 0.06
"""Room above and below a logarithmic curve, in decades: its line stands clear of the edge."""


def flat_figures(subject: Subject) -> list[Figure]:
    """Return the flat figures that there are something to draw for."""
    figures = [*residual_figures(subject), qq_figure(subject)]
    joint = subject.calibration.covariance
    if joint is not None and subject.solved:
        names, directions = joint.beam_names[:LEGEND], subject.calibration.parameters().directions
        figures.append(correlation_figure(names, directions[:LEGEND], joint.matrix(names, [])))
    figures.append(stations_figure(subject))
    return [figure for figure in figures if figure is not None]


def correlation_figure(
    names: Sequence[str], directions: FloatArray, covariance: FloatArray
) -> Figure:
    """Return the correlations of beams as a map; arguments as of `correlation_matrix`."""
    unknowns, C = correlation_matrix(names, directions, covariance)
    labels = [(unknown.beam, BEAM.labels[unknown.number]) for unknown in unknowns]
    beams = list(dict.fromkeys(beam for beam, _ in labels))
    first = [next(i for i, (beam, _) in enumerate(labels) if beam == name) for name in beams]
    ends = [*first[1:], len(labels)]
    numbered = {beam: label(beam) for beam in beams}
    if len(set(numbered.values())) < len(beams):  # names that differ only where they are cut
        numbered = {beam: f"{label(beam)} ({i})" for i, beam in enumerate(beams, 1)}
    words = [f"beam {numbered[beam]} {name}" for beam, name in labels]
    trace: Record = {
        "type": "heatmap",
        "z": [numbers(row, 3) for row in C],
        "x": words,
        "y": words,
        "hovertemplate": "%{y}<br>%{x}<br>%{z:.3f}<extra></extra>",
        "zmin": -1,
        "zmax": 1,
        "colorscale": [  # pale up to a strong correlation, and dark beyond
            (0.0, "#08306b"),
            (0.5 * (1.0 - STRONG), "#6baed6"),
            (0.5, "#f7f8fa"),
            (0.5 * (1.0 + STRONG), "#fc9272"),
            (1.0, "#7f0000"),
        ],
        "colorbar": {
            "thickness": 10,
            "len": 0.9,
            "outlinewidth": 0,
            "tickvals": [-1, -0.5, 0, 0.5, 1],
        },
    }
    caption = "Correlations. Every beam has location x, y, z, two components of its direction, and "
    caption += f"its range errors. Dark is above {STRONG} in size: hardly told apart."
    side = axis(
        "beam",
        type="category",
        tickvals=[(a + b - 1) / 2.0 for a, b in zip(first, ends, strict=True)],
        ticktext=tick_labels(beams, LETTERS_BELOW // 2),
        showgrid=False,
        zeroline=False,
        ticks="",
    )
    white: Record = {"type": "line", "line": {"color": "white", "width": 2}}
    borders: list[Record] = []  # between the beams
    for edge in (start - 0.5 for start in first[1:]):
        borders.append(white | {"xref": "paper", "x0": 0, "x1": 1, "y0": edge, "y1": edge})
        borders.append(white | {"yref": "paper", "y0": 0, "y1": 1, "x0": edge, "x1": edge})
    upright = side | {"autorange": "reversed", "tickangle": -90}
    more: Record = {"xaxis": side, "yaxis": upright, "shapes": borders}
    return Figure("correlation", caption, [trace], layout("", "", 420, more))


def stations_figure(subject: Subject) -> Figure | None:
    """Return how the uncertainty fell with the stations, and what the next ones promise."""
    past, plan = subject.history, subject.plan
    if past is None or not np.isfinite(past[1].spot).any():
        return None
    stations, known = past
    spot = f"95 % spot at {subject.verdict.reading * IN_MM:.3g} mm, mm"
    traces: list[Record] = []
    for index, (name, quantity, unit) in enumerate(
        (
            (spot, "spot", IN_MM),
            ("location, mm", "location_sigma", IN_MM),
            ("direction, deg (right)", "direction_sigma", IN_DEG),
        )
    ):
        curve: Record = {
            "type": "scatter",
            "mode": "lines+markers",
            "name": name,
            "x": numbers(stations.astype(np.float64)),
            "y": numbers(getattr(known, quantity) * unit),
            "yaxis": "y2" if index == 2 else "y",
            "line": {"color": COLOURS[index], "width": 2},
            "marker": {"size": 4},
            "hovertemplate": "%{y:.3g} after %{x} stations",
        }
        traces.append(curve)
        if plan is not None:
            ahead = getattr(plan.forecast, quantity) * unit
            x = stations[-1] + np.arange(len(ahead), dtype=np.float64)
            line: Record = {"color": COLOURS[index], "width": 2, "dash": "dot"}
            dashed: Record = {"x": numbers(x), "y": numbers(ahead), "line": line}
            traces.append(curve | dashed | {"showlegend": False})
    caption = "Largest standard deviations, and the largest 95 % spot error, after the first "
    caption += "stations of the recording, at the noise found from all."
    if plan is not None:
        caption += " Dotted: what the next best stations promise."
    right = _logarithmic(traces, "y2")
    more: Record = {
        "yaxis": axis("mm", **_logarithmic(traces, "y")),
        "yaxis2": axis("deg", **right, overlaying="y", side="right", showgrid=False),
        "margin": {"l": 58, "r": 58, "t": 34, "b": 48},
    }
    return Figure("by-count", caption, traces, layout("stations", "mm", more=more, legend=True))


def _logarithmic(traces: list[Record], side: str) -> Record:
    """Return the type, the range and round ticks of an axis, for what stands on its `side`.

    Left to itself plotly labels every digit, one over the other where the figure is small.
    """
    values: list[float] = [
        y
        for trace in traces
        if trace["yaxis"] == side and isinstance(trace["y"], list)
        for y in trace["y"]
        if y
    ]
    if not values:  # of readings without noise
        return {"type": "linear"}
    low, high = math.log10(min(values)) - CLEAR, math.log10(max(values)) + CLEAR
    inside = logarithmic_ticks(low, high)
    inside = inside[:: math.ceil(len(inside) / LABELS_ABOVE) or 1]
    words = [f"{tick:g}" for tick in inside]
    return {"type": "log", "range": [low, high], "tickvals": inside, "ticktext": words}
