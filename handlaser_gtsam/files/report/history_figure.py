"""The figure of what was known after how many stations."""

import math

import numpy as np

from ...arrays import FloatArray
from ...planning.picture import logarithmic_ticks
from ...quantities import IN_DEG, IN_MM
from ..json_text import Record
from .figure import COLOURS, Figure, axis, layout, numbers
from .subject import Subject

LABELS_ABOVE = 7
"""Labels of an axis that fit above one another."""
CLEAR = 0.06
"""Room above and below a logarithmic curve, in decades: its line stands clear of the edge."""


def stations_figure(subject: Subject) -> Figure | None:
    """Return how the uncertainty fell with the stations, and what the next ones promise."""
    past, plan = subject.history, subject.plan
    if past is None or not np.isfinite(past[1].spot).any():
        return None
    stations, known = past
    spot = f"95 % spot at {subject.reading * IN_MM:.3g} mm, mm"
    traces: list[Record] = []
    for index, (name, quantity, unit) in enumerate(
        (
            (spot, "spot", IN_MM),
            ("location, mm", "location_sigma", IN_MM),
            ("direction, deg (right)", "direction_sigma", IN_DEG),
        )
    ):
        curve = _curve(name, index, stations.astype(np.float64), getattr(known, quantity) * unit)
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
    if not values:  # of readings without noise
        return {"type": "linear"}
    low, high = math.log10(min(values)) - CLEAR, math.log10(max(values)) + CLEAR
    inside = logarithmic_ticks(low, high)
    inside = inside[:: math.ceil(len(inside) / LABELS_ABOVE) or 1]
    words = [f"{tick:g}" for tick in inside]
    return {"type": "log", "range": [low, high], "tickvals": inside, "ticktext": words}
