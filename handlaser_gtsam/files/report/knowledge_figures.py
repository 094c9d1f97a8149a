"""Figures of what is known: correlations, and how the uncertainty fell with the stations."""

import math

import numpy as np

from ...arrays import FloatArray
from ...results.lines import DEG, MM
from ..json_text import Record
from .evidence import FLAGGED, MOST_BEAMS
from .figure import COLOURS, Figure, axis, label, layout, numbers, tick_labels
from .mounts import correlation_matrix
from .subject import Subject

NICE = (1.0, 2.0, 5.0)
MOST_TICKS = 7
ROOM_FOR_BEAMS = 28
"""Letters of all beams beside the correlations on a phone."""
ROOM = 0.06
"""Above and below a logarithmic curve, in decades."""


def correlation_figure(subject: Subject) -> Figure | None:
    """Return the correlations of all unknowns of the beams; None without a covariance."""
    labels, C = correlation_matrix(subject, MOST_BEAMS)
    if not labels or not subject.solved:
        return None
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
        "colorscale": _scale(),
        "colorbar": {
            "thickness": 10,
            "len": 0.9,
            "outlinewidth": 0,
            "tickvals": [-1, -0.8, 0, 0.8, 1],
        },
    }
    caption = "Correlations. Every beam has location x, y, z, two components of its direction, and "
    caption += f"its range errors. Dark is above {FLAGGED} in size: hardly told apart."
    side = axis(
        "beam",
        type="category",
        tickvals=[(a + b - 1) / 2.0 for a, b in zip(first, ends, strict=True)],
        ticktext=tick_labels(beams, ROOM_FOR_BEAMS),
        showgrid=False,
        zeroline=False,
        ticks="",
    )
    upright = side | {"autorange": "reversed", "tickangle": -90}
    more: Record = {"xaxis": side, "yaxis": upright, "shapes": _borders(first[1:])}
    return Figure("correlation", caption, [trace], layout("", "", 420, more))


def _borders(starts: list[int]) -> list[Record]:
    """Return white lines between the beams."""
    line: Record = {"type": "line", "line": {"color": "white", "width": 2}}
    found = []
    for edge in (start - 0.5 for start in starts):
        found.append(line | {"xref": "paper", "x0": 0, "x1": 1, "y0": edge, "y1": edge})
        found.append(line | {"yref": "paper", "y0": 0, "y1": 1, "x0": edge, "x1": edge})
    return found


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
    spot = f"95 % spot at {subject.reading * MM:.3g} mm, mm"
    traces: list[Record] = []
    for index, (name, quantity, unit) in enumerate(
        (
            (spot, "spot", MM),
            ("location, mm", "location_sigma", MM),
            ("direction, deg (right)", "direction_sigma", DEG),
        )
    ):
        curve = _curve(
            name, index, past.stations.astype(np.float64), getattr(past.known, quantity) * unit
        )
        traces.append(curve)
        if plan is not None:
            ahead = getattr(plan.forecast, quantity) * unit
            x = past.stations[-1] + np.arange(len(ahead), dtype=np.float64)
            line: Record = {"color": COLOURS[index], "width": 2, "dash": "dot"}
            dashed: Record = {"x": numbers(x), "y": numbers(ahead), "line": line}
            traces.append(curve | dashed | {"showlegend": False})
    caption = "Largest standard deviations, and the largest 95 % spot error, after the first "
    caption += "stations of the recording, at the noise found from all."
    if plan is not None:
        caption += " Dotted: what the next best stations promise."
    more: Record = {
        "yaxis": axis("mm", **_logarithmic(traces, "y")),
        "yaxis2": axis(
            "deg", **_logarithmic(traces, "y2"), overlaying="y", side="right", showgrid=False
        ),
        "showlegend": True,
        "margin": {"l": 58, "r": 58, "t": 34, "b": 48},
    }
    return Figure("by-count", caption, traces, layout("stations", "mm", more=more))


def _curve(name: str, index: int, x: FloatArray, y: FloatArray) -> Record:
    return {
        "type": "scatter",
        "mode": "lines+markers",
        "name": name,
        "x": numbers(x),
        "y": numbers(y),
        "yaxis": "y2" if index == 2 else "y",
        "line": {"color": COLOURS[index], "width": 2},
        "marker": {"size": 4},
        "hovertemplate": "%{y:.3g} after %{x} stations",
    }


def _logarithmic(traces: list[Record], side: str) -> Record:
    """Return the type, the range and round ticks of an axis, for what stands on its `side`."""
    values: list[float] = [
        y
        for trace in traces
        if trace["yaxis"] == side and isinstance(trace["y"], list)
        for y in trace["y"]
        if y
    ]
    low, high = math.log10(min(values)) - ROOM, math.log10(max(values)) + ROOM
    powers = range(math.floor(low), math.ceil(high) + 1)
    ticks = [step * 10.0**power for power in powers for step in NICE]
    inside = [tick for tick in ticks if low <= math.log10(tick) <= high]
    inside = inside[:: math.ceil(len(inside) / MOST_TICKS) or 1]
    words = [f"{tick:g}" for tick in inside]
    return {"type": "log", "range": [low, high], "tickvals": inside, "ticktext": words}
