"""What a person sees of a plan."""

import math
from collections import Counter
from collections.abc import Iterator

from ..data.station_list import StationList
from ..planning.advice import pose_words
from ..planning.goal import Goal
from ..planning.robot import Robot
from ..planning.route import VIA, Plan
from ..quantities import IN_DEG, IN_MM, IN_PERCENT
from ..text import count

SHOWN_ROWS = 10
"""Rows of the forecast, evenly over the stations, and stations whose poses are shown at most: they fit
on a screen beside the rest."""
UNKNOWN_ABOVE = 999.0
"""Larger standard deviations are shown as unknown [mm], [deg]: nothing has determined them."""


def plan_lines(plan: Plan, goal: Goal) -> Iterator[str]:
    """Yield the lines of a plan: where to go, what will be known, and whether that is enough."""
    stations = plan.stations
    pairs = zip(stations.plane_labels, stations.station_names, strict=True)
    where = Counter(plane for plane, name in pairs if not name.startswith(VIA))
    parts = ", ".join(f"{number} before plane {plane}" for plane, number in where.items())
    first = "" if plan.safe is None else " for a first motion"
    yield f"{count(len(plan), 'station')}{first}: {parts}"
    passed = len(stations) - len(plan)
    if passed:
        yield f"{count(passed, 'station')} named {VIA} between them: nothing need be read there"
    if plan.skipped:
        yield (
            f"{count(plan.skipped, 'further station')} skipped: the arm found no way there without a "
            "collision"
        )
    yield from plan.assumed
    for name, plate in plan.plates.items():
        x, y, z = plate.normal
        a, b, c = plate.point * IN_MM
        yield (
            f"put the plate for plane {name} with its normal along ({x:.3f}, {y:.3f}, {z:.3f}), "
            f"through ({a:.0f}, {b:.0f}, {c:.0f}) mm, to within {plate.within * IN_MM:.2g} mm and "
            f"{plate.tilt * IN_DEG:.2g} deg"
        )
    if plan.safe is not None:
        yield (
            f"all readings are within the sensor's limits for {IN_PERCENT * plan.safe:.1f} % of the "
            "mounts within the bounds"
        )
    yield from _forecast(plan)
    yield from _enough(plan, goal)


def station_lines(stations: StationList) -> Iterator[str]:
    """Yield where the stations of a plan are that is not written; of many, that --out writes them."""
    if len(stations) > SHOWN_ROWS:
        yield f"--out FILE writes the poses of the {len(stations)} stations"
    elif len(stations):
        yield "stations, hand poses world_T_hand (--out FILE writes them):"
        named = zip(stations.station_names, stations.plane_labels, strict=True)
        for (name, label), pose in zip(named, pose_words(stations), strict=True):
            target = label if ":" in label else f"plane {label}"
            yield f"  {name} before {target}: {pose}"


def scene_lines(robot: Robot) -> Iterator[str]:
    """Yield what the ways of an arm were checked against, and what they were not."""
    within = ["the arm itself", "the plate"]
    missing = []
    if robot.table is None:
        missing.append("the table (state table_mm in [robot])")
    else:
        within.append(f"the table at {robot.table * IN_MM:.4g} mm")
    if not len(robot.start):
        missing.append("the way to the first station (state start_joints in [robot])")
    missing.append(
        "what else stands in the cell, and cables and sensors that the URDF does not have"
    )
    yield f"moves, straight in the joints, were checked against {', '.join(within)}"
    yield f"not checked: {'; '.join(missing)}"


def _forecast(plan: Plan) -> Iterator[str]:
    forecast = plan.forecast
    distance = forecast.working_distance * IN_MM
    yield (
        "largest standard deviation of any beam after a number of stations, and the radius that holds "
        f"its spot at {distance:.3g} mm with 95 %:"
    )
    yield "stations  location mm  direction deg  spot mm"
    last = len(forecast)
    shown = {round(last * index / (SHOWN_ROWS - 1)) for index in range(SHOWN_ROWS)}
    for number in sorted(shown | {last}):
        yield (
            f"{number:8}  {_cell(forecast.location_sigma[number] * IN_MM):>11}  "
            f"{_cell(forecast.direction_sigma[number] * IN_DEG):>13}  "
            f"{_cell(forecast.spot[number] * IN_MM):>7}"
        )


def _cell(value: float) -> str:
    return f"{value:.3g}" if math.isfinite(value) and value < UNKNOWN_ABOVE else "unknown"


def _enough(plan: Plan, goal: Goal) -> Iterator[str]:
    if not goal.stated:
        return
    if plan.reached is None:
        yield (
            f"{count(len(plan), 'station')} do not reach the limits and the goal of the rig file: more "
            "of them, or less noise"
        )
    elif plan.reached == 0:
        yield "the limits and the goal of the rig file are reached already: no station is needed"
    else:
        yield f"{count(plan.reached, 'station')} reach the limits and the goal of the rig file"
