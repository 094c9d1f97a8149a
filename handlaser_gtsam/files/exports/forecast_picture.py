"""A forecast as a picture: SVG, three curves over the number of stations, with the goal."""

import math
from collections.abc import Mapping

import numpy as np

from ...arrays import FloatArray
from ...planning.goal import Forecast, Goal
from ...quantities import IN_DEG, IN_MM
from .rendering import environment

Edges = Mapping[str, int]
"""Of the curves in a panel [pixels]."""


def forecast_svg(forecast: Forecast, goal: Goal) -> str:
    """Return a picture of what will be known after how many stations, beside the goal."""
    distance = forecast.working_distance
    where = f"{distance * IN_MM:.3g} mm" if math.isfinite(distance) else "working distance"
    # In a panel of 300 by 240 pixels the title stands above, labels below and before.
    edges = {"left": 56, "right": 286, "top": 34, "bottom": 196}
    panels = (
        _panel("location, mm", forecast.location_sigma, goal.location_sigma, IN_MM, edges),
        _panel("direction, deg", forecast.direction_sigma, goal.direction_sigma, IN_DEG, edges),
        _panel(f"95 % spot at {where}, mm", forecast.spot, goal.spot, IN_MM, edges),
    )
    count = max(len(forecast), 1)
    below = [
        (_across(number, count, edges), f"{number}") for number in sorted({0, count // 2, count})
    ]
    template = environment(__package__).get_template("forecast.svg.j2")
    return template.render(panels=panels, below=below, **edges)


def _across(number: float, count: int, edges: Edges) -> float:
    """Return where a number of stations stands between the edges [pixels]."""
    return edges["left"] + (edges["right"] - edges["left"]) * number / count


def _panel(
    title: str, values: FloatArray, limit: float | None, unit: float, edges: Edges
) -> tuple[str, list[tuple[float, str]], float | None, str]:
    """Return title, labels and their heights, the height of the limit, and the curve [pixels]."""
    shown, count = np.flatnonzero((values > 0.0) & np.isfinite(values)), max(len(values) - 1, 1)
    drawn = np.log10([*values[shown] * unit, *([] if limit is None else [limit * unit])] or [1.0])
    low, high = float(drawn.min()) - 0.05, float(drawn.max()) + 0.05
    ticks = logarithmic_ticks(low, high)
    if len(ticks) > 6:  # more do not fit above one another
        ticks = [tick for tick in ticks if math.log10(tick).is_integer()]

    def height(value: float) -> float:
        share = (math.log10(value) - low) / (high - low)
        return edges["bottom"] - (edges["bottom"] - edges["top"]) * share

    labels = [(height(tick), f"{tick:g}") for tick in ticks]
    at = [f"{_across(n, count, edges):.1f} {height(values[n] * unit):.1f}" for n in shown.tolist()]
    return title, labels, None if limit is None else height(limit * unit), "L".join(at)


def logarithmic_ticks(low: float, high: float) -> list[float]:
    """Return the numbers between powers of ten whose exponents are given: 1, 2 and 5 times one."""
    powers = range(math.floor(low), math.ceil(high) + 1)
    ticks = [step * 10.0**power for power in powers for step in (1.0, 2.0, 5.0)]
    return [tick for tick in ticks if low <= math.log10(tick) <= high]
