"""A forecast as a picture: SVG, three curves over the number of stations, with the goal."""

import math
from collections.abc import Iterator

from ..arrays import FloatArray
from ..quantities import IN_DEG, IN_MM
from .goal import Forecast, Goal

WIDTH, HEIGHT = 300, 240
"""Of a panel, in pixels."""
LEFT, RIGHT, TOP, BOTTOM = 56, 14, 34, 44
"""Room around its axes."""
STYLE = (
    "text{font:12px sans-serif;fill:#222}.axis{stroke:#222;fill:none}.grid{stroke:#ddd}"
    ".curve{stroke:#0b6;stroke-width:2;fill:none}.goal{stroke:#c33;stroke-dasharray:5 4}"
)
NICE = (1.0, 2.0, 5.0)
"""Ticks are these times a power of ten."""
MOST_TICKS = 6
"""Labels that fit beside one another."""


def forecast_svg(forecast: Forecast, goal: Goal) -> str:
    """Return a picture of what will be known after so many stations, beside the goal."""
    distance = forecast.working_distance * IN_MM
    panels = (
        ("location, mm", forecast.location_sigma * IN_MM, goal.location_sigma, IN_MM),
        ("direction, deg", forecast.direction_sigma * IN_DEG, goal.direction_sigma, IN_DEG),
        (f"95 % spot at {distance:.3g} mm, mm", forecast.spot * IN_MM, goal.spot, IN_MM),
    )
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{len(panels) * WIDTH}" '
        f'height="{HEIGHT}" role="img">',
        "<title>Largest standard deviations after so many stations</title>",
        f"<style>{STYLE}</style>",
        '<rect width="100%" height="100%" fill="white"/>',
    ]
    for index, (title, values, most, unit) in enumerate(panels):
        limit = None if most is None else most * unit
        lines.append(f'<g transform="translate({index * WIDTH} 0)">')
        lines += _panel(title, values, limit)
        lines.append("</g>")
    return "\n".join([*lines, "</svg>"]) + "\n"


def _panel(title: str, values: FloatArray, limit: float | None) -> Iterator[str]:
    """Yield the lines of one panel: logarithmic upwards."""
    shown = [float(x) for x in values if x > 0.0 and math.isfinite(x)]
    least, most = min(shown, default=1.0), max(shown, default=1.0)
    if limit is not None:
        least, most = min(least, limit), max(most, limit)
    low, high = math.log10(least) - 0.05, math.log10(most) + 0.05
    count = max(len(values) - 1, 1)

    def x(number: float) -> float:
        return LEFT + (WIDTH - LEFT - RIGHT) * number / count

    def y(value: float) -> float:
        share = (math.log10(value) - low) / (high - low)
        return HEIGHT - BOTTOM - (HEIGHT - TOP - BOTTOM) * share

    yield f'<text x="{LEFT}" y="20">{title}</text>'
    for tick in _ticks(low, high):
        yield f'<path class="grid" d="M{LEFT} {y(tick):.1f}H{WIDTH - RIGHT}"/>'
        yield f'<text x="{LEFT - 6}" y="{y(tick) + 4:.1f}" text-anchor="end">{tick:g}</text>'
    for number in sorted({0, count // 2, count}):
        yield f'<text x="{x(number):.1f}" y="{HEIGHT - 26}" text-anchor="middle">{number}</text>'
    yield f'<text x="{x(count / 2):.1f}" y="{HEIGHT - 8}" text-anchor="middle">stations</text>'
    yield f'<path class="axis" d="M{LEFT} {TOP}V{HEIGHT - BOTTOM}H{WIDTH - RIGHT}"/>'
    if limit is not None:
        yield f'<path class="goal" d="M{LEFT} {y(limit):.1f}H{WIDTH - RIGHT}"/>'
    points = [
        f"{x(number):.1f} {y(float(value)):.1f}"
        for number, value in enumerate(values)
        if value > 0.0 and math.isfinite(value)
    ]
    if points:
        yield f'<path class="curve" d="M{"L".join(points)}"/>'


def _ticks(low: float, high: float) -> list[float]:
    """Return round numbers between two powers of ten."""
    powers = range(math.floor(low), math.ceil(high) + 1)
    every = [step * 10.0**power for power in powers for step in NICE]
    inside = [tick for tick in every if low <= math.log10(tick) <= high]
    if len(inside) > MOST_TICKS:
        return [tick for tick in inside if math.log10(tick).is_integer()]
    return inside
