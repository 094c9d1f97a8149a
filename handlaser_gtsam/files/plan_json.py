"""A plan as JSON: stations, what is expected there, and what will be known after them.

What will be known is a picture, too: SVG, three curves over the number of stations, with the goal.
"""

import math
from collections.abc import Iterable, Mapping

import numpy as np
from scipy.spatial.transform import Rotation

from ..arrays import FloatArray
from ..planning.goal import Forecast, Goal
from ..planning.route import Plan
from ..quantities import IN_DEG, IN_MM
from .checked_text import Record, json_text, record
from .exports.rendering import environment


def plan_text(plan: Plan) -> str:
    """Return a plan as JSON text; stations that only divide the way are among the others.

    In a survey they are in the order in which they matter: what will be known after each stands beside
    it, too.
    """
    stations, forecast = plan.stations, plan.forecast
    turns = Rotation.from_matrix(stations.world_R_hand)
    sigmas = {
        "location_sigma_m": forecast.location_sigma,
        "direction_sigma_rad": forecast.direction_sigma,
    }
    columns: dict[str, Iterable[object]] = {
        "station": stations.station_names,
        "target" if plan.sensors else "plane": stations.plane_labels,
        **({"sensor": plan.sensors} if plan.sensors else {}),
        "position_m": stations.world_t_hand,
        "quaternion_xyzw": turns.as_quat(canonical=True),
    }
    if plan.sensors:
        for name, values in {"spot_error_m": forecast.spot, **sigmas}.items():
            column = np.full(len(stations), np.nan)  # nothing is read on the way
            column[plan.read] = values[1:]
            columns[name] = column
    else:
        columns |= {"ranges_m": plan.ranges, "range_sigmas_m": plan.range_sigmas}
    if stations.joints is not None:
        columns["joints"] = stations.joints
    known = {"stations": range(len(forecast) + 1), **sigmas, "spot_m": forecast.spot}
    plates = [
        record(plate, "plane point_m normal", plane=name) for name, plate in plan.plates.items()
    ]
    content: Record = {
        "stations": _rows(columns),
        "forecast": _rows(known),
        "working_distance_m": forecast.working_distance,
        **record(
            plan,
            "reached plates safe plate_across_m skipped uncounted undetermined determined",
            plates=plates,
        ),
    }
    if plan.sensors:
        content["spot_error_m"] = forecast.spot[0]
    if stations.joint_names:
        content["joint_names"] = list(stations.joint_names)
    return json_text("survey-plan" if plan.sensors else "plan", content)


def _rows(columns: Mapping[str, Iterable[object]]) -> list[Record]:
    """Return a record for every row of some columns."""
    return [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]


EDGES = {"left": 56, "right": 286, "top": 34, "bottom": 196}
"""Of the curves in a panel of 300 by 240 pixels: the title stands above, labels below and before."""


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
    template = environment(f"{__package__}.exports").get_template("forecast.svg.j2")
    return template.render(panels=panels, below=below, **EDGES)


def _across(number: float, count: int) -> float:
    """Return where a number of stations stands between the edges [pixels]."""
    return EDGES["left"] + (EDGES["right"] - EDGES["left"]) * number / count


def _panel(
    title: str, values: FloatArray, limit: float | None, unit: float
) -> tuple[str, list[tuple[float, str]], float | None, str]:
    """Return title, labels and their heights, the height of the limit, and the curve [pixels]."""
    shown, count = np.flatnonzero((values > 0.0) & np.isfinite(values)), max(len(values) - 1, 1)
    drawn = np.log10([*values[shown] * unit, *([] if limit is None else [limit * unit])] or [1.0])
    low, high = float(drawn.min()) - 0.05, float(drawn.max()) + 0.05
    # The numbers between powers of ten that are 1, 2 or 5 times one.
    powers = range(math.floor(low), math.ceil(high) + 1)
    ticks = [step * 10.0**power for power in powers for step in (1.0, 2.0, 5.0)]
    ticks = [tick for tick in ticks if low <= math.log10(tick) <= high]
    if len(ticks) > 6:  # more do not fit above one another
        ticks = [tick for tick in ticks if math.log10(tick).is_integer()]

    def height(value: float) -> float:
        share = (math.log10(value) - low) / (high - low)
        return EDGES["bottom"] - (EDGES["bottom"] - EDGES["top"]) * share

    labels = [(height(tick), f"{tick:g}") for tick in ticks]
    at = [f"{_across(n, count):.1f} {height(values[n] * unit):.1f}" for n in shown.tolist()]
    return title, labels, None if limit is None else height(limit * unit), "L".join(at)
