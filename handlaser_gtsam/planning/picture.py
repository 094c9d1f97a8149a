"""A forecast as a picture: SVG, three curves over the number of stations, with the goal."""

import math
from collections.abc import Iterator

import numpy as np

from ..arrays import FloatArray
from ..quantities import IN_DEG, IN_MM
from .goal import Forecast, Goal

PANEL_WIDTH = 300
"""Of a panel, in pixels: three fit on a page."""
PANEL_HEIGHT = 240
"""In pixels."""
EDGE_LEFT, EDGE_RIGHT = 56, PANEL_WIDTH - 14
"""Ends of the horizontal axis, in pixels: labels stand before."""
EDGE_TOP, EDGE_BOTTOM = 34, PANEL_HEIGHT - 44
"""Ends of the vertical axis, in pixels: the title stands above, labels below."""
STYLE = (
    "text{font:12px sans-serif;fill:#222}.axis{stroke:#222;fill:none}.grid{stroke:#ddd}"
    ".curve{stroke:#0b6;stroke-width:2;fill:none}.goal{stroke:#c33;stroke-dasharray:5 4}"
)
MOST_LABELS = 6
"""Labels that fit above one another; with more, only powers of ten have one."""


def forecast_svg(forecast: Forecast, goal: Goal) -> str:
    """Return a picture of what will be known after how many stations, beside the goal."""
    distance = forecast.working_distance * IN_MM
    panels = (
        ("location, mm", forecast.location_sigma, goal.location_sigma, IN_MM),
        ("direction, deg", forecast.direction_sigma, goal.direction_sigma, IN_DEG),
        (f"95 % spot at {distance:.3g} mm, mm", forecast.spot, goal.spot, IN_MM),
    )
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{len(panels) * PANEL_WIDTH}" '
        f'height="{PANEL_HEIGHT}" role="img">',
        "<title>Largest standard deviations after the stations</title>",
        f"<style>{STYLE}</style>",
        '<rect width="100%" height="100%" fill="white"/>',
    ]
    for index, (title, values, most, unit) in enumerate(panels):
        lines.append(f'<g transform="translate({index * PANEL_WIDTH} 0)">')
        lines += _panel(title, values * unit, None if most is None else most * unit)
        lines.append("</g>")
    return "\n".join([*lines, "</svg>"]) + "\n"


def _panel(title: str, values: FloatArray, limit: float | None) -> Iterator[str]:
    """Yield the lines of one panel: logarithmic upwards."""
    count = max(len(values) - 1, 1)
    shown = np.flatnonzero((values > 0.0) & np.isfinite(values))
    logs = np.log10([*values[shown], *([] if limit is None else [limit])] or [1.0])
    low, high = float(logs.min()) - 0.05, float(logs.max()) + 0.05

    def x(number: float) -> float:
        return EDGE_LEFT + (EDGE_RIGHT - EDGE_LEFT) * number / count

    def y(value: float) -> float:
        return EDGE_BOTTOM - (EDGE_BOTTOM - EDGE_TOP) * (math.log10(value) - low) / (high - low)

    ticks = logarithmic_ticks(low, high)
    if len(ticks) > MOST_LABELS:
        ticks = [tick for tick in ticks if math.log10(tick).is_integer()]
    yield f'<text x="{EDGE_LEFT}" y="20">{title}</text>'
    for tick in ticks:
        yield f'<path class="grid" d="M{EDGE_LEFT} {y(tick):.1f}H{EDGE_RIGHT}"/>'
        yield (f'<text x="{EDGE_LEFT - 6}" y="{y(tick) + 4:.1f}" text-anchor="end">{tick:g}</text>')
    below = [(number, f"{number}", 18) for number in sorted({0, count // 2, count})]
    for number, label, down in (*below, (count / 2, "stations", 36)):
        place = f'x="{x(number):.1f}" y="{EDGE_BOTTOM + down}"'
        yield f'<text {place} text-anchor="middle">{label}</text>'
    yield f'<path class="axis" d="M{EDGE_LEFT} {EDGE_TOP}V{EDGE_BOTTOM}H{EDGE_RIGHT}"/>'
    if limit is not None:
        yield f'<path class="goal" d="M{EDGE_LEFT} {y(limit):.1f}H{EDGE_RIGHT}"/>'
    if shown.size:
        points = [f"{x(number):.1f} {y(values[number]):.1f}" for number in shown.tolist()]
        yield f'<path class="curve" d="M{"L".join(points)}"/>'


def logarithmic_ticks(low: float, high: float) -> list[float]:
    """Return the numbers between powers of ten whose exponents are given: 1, 2 and 5 times one."""
    powers = range(math.floor(low), math.ceil(high) + 1)
    ticks = [step * 10.0**power for power in powers for step in (1.0, 2.0, 5.0)]
    return [tick for tick in ticks if low <= math.log10(tick) <= high]
