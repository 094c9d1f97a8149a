"""A forecast as a picture: SVG, three curves over the number of stations, with the goal."""

import math

import numpy as np

from ...arrays import FloatArray
from ...planning.goal import Forecast, Goal
from ...quantities import IN_DEG, IN_MM
from .rendering import environment

LEFT, RIGHT, TOP, BOTTOM = 56, 286, 34, 196
"""Of the curves in a panel of 300 by 240 pixels: the title stands above, labels below and before."""
MOST_LABELS = 6
"""Labels that fit above one another; with more, only powers of ten have one."""


def forecast_svg(forecast: Forecast, goal: Goal) -> str:
    """Return a picture of what will be known after how many stations, beside the goal."""
    distance = forecast.working_distance
    where = f"{distance * IN_MM:.3g} mm" if math.isfinite(distance) else "working distance"
    panels = (
        _panel("location, mm", forecast.location_sigma, goal.location_sigma, IN_MM),
        _panel("direction, deg", forecast.direction_sigma, goal.direction_sigma, IN_DEG),
        _panel(f"95 % spot at {where}, mm", forecast.spot, goal.spot, IN_MM),
    )
    count = max(len(forecast), 1)
    below = [(_across(number, count), f"{number}") for number in sorted({0, count // 2, count})]
    edges = {"left": LEFT, "right": RIGHT, "top": TOP, "bottom": BOTTOM}
    template = environment(__package__).get_template("forecast.svg.j2")
    return template.render(panels=panels, below=below, **edges)


def _across(number: float, count: int) -> float:
    """Return where a number of stations stands between the edges [pixels]."""
    return LEFT + (RIGHT - LEFT) * number / count


def _panel(
    title: str, values: FloatArray, limit: float | None, unit: float
) -> tuple[str, list[tuple[float, str]], float | None, str]:
    """Return title, labels and their heights, the height of the limit, and the curve [pixels]."""
    shown, count = np.flatnonzero((values > 0.0) & np.isfinite(values)), max(len(values) - 1, 1)
    drawn = np.log10([*values[shown] * unit, *([] if limit is None else [limit * unit])] or [1.0])
    low, high = float(drawn.min()) - 0.05, float(drawn.max()) + 0.05
    ticks = logarithmic_ticks(low, high)
    if len(ticks) > MOST_LABELS:
        ticks = [tick for tick in ticks if math.log10(tick).is_integer()]

    def height(value: float) -> float:
        return BOTTOM - (BOTTOM - TOP) * (math.log10(value) - low) / (high - low)

    labels = [(height(tick), f"{tick:g}") for tick in ticks]
    at = [f"{_across(n, count):.1f} {height(values[n] * unit):.1f}" for n in shown.tolist()]
    return title, labels, None if limit is None else height(limit * unit), "L".join(at)


def logarithmic_ticks(low: float, high: float) -> list[float]:
    """Return the numbers between powers of ten whose exponents are given: 1, 2 and 5 times one."""
    powers = range(math.floor(low), math.ceil(high) + 1)
    ticks = [step * 10.0**power for power in powers for step in (1.0, 2.0, 5.0)]
    return [tick for tick in ticks if low <= math.log10(tick) <= high]
