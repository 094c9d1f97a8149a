"""A plan as JSON: stations, what is expected there, and what will be known after them."""

from collections.abc import Iterable, Mapping

import numpy as np
from scipy.spatial.transform import Rotation

from ..data.station_list import StationList
from ..planning.route import Plan
from ..planning.survey import SurveyPlan
from .checked_text import Record, json_text, record


def plan_text(plan: Plan) -> str:
    """Return a plan as JSON text; stations that only divide the way are among the others."""
    stations, forecast = plan.stations, plan.forecast
    columns = _where(stations, "plane")
    columns |= {"ranges_m": plan.ranges, "range_sigmas_m": plan.range_sigmas}
    if stations.joints is not None:
        columns["joints"] = stations.joints
    known: dict[str, Iterable[object]] = {
        "stations": range(len(forecast) + 1),
        "location_sigma_m": forecast.location_sigma,
        "direction_sigma_rad": forecast.direction_sigma,
        "spot_m": forecast.spot,
    }
    plates = [
        record(plate, "plane point_m normal", plane=name) for name, plate in plan.plates.items()
    ]
    content: Record = {
        "stations": _rows(columns),
        "forecast": _rows(known),
        "working_distance_m": forecast.working_distance,
        **record(plan, "reached plates safe uncounted", plates=plates),
    }
    if stations.joint_names:
        content["joint_names"] = list(stations.joint_names)
    return json_text("plan", content)


def survey_plan_text(plan: SurveyPlan) -> str:
    """Return a plan of a survey as JSON text."""
    columns = _where(plan.stations, "target", sensor=plan.sensors)
    known, read = plan.forecast, np.array([bool(sensor) for sensor in plan.sensors])
    for name, values in (
        ("spot_error_m", known.spot),
        ("location_sigma_m", known.location_sigma),
        ("direction_sigma_rad", known.direction_sigma),
    ):
        column = np.full(len(read), np.nan)  # nothing is read on the way
        column[read] = values[1:]
        columns[name] = column
    if plan.stations.joints is not None:
        columns["joints"] = plan.stations.joints
    content: Record = {
        "spot_error_m": plan.spot_errors[0],
        "stations": _rows(columns),
        "undetermined": plan.undetermined,
        "determined": plan.determined,
        "skipped": plan.skipped,
    }
    if plan.stations.joint_names:
        content["joint_names"] = list(plan.stations.joint_names)
    return json_text("survey-plan", content)


def _where(
    stations: StationList, before: str, **more: Iterable[object]
) -> dict[str, Iterable[object]]:
    """Return the names of stations, what they are before, more columns, and their poses."""
    turns = Rotation.from_matrix(stations.world_R_hand)
    return {
        "station": stations.station_names,
        before: stations.plane_labels,
        **more,
        "position_m": stations.world_t_hand,
        "quaternion_xyzw": turns.as_quat(canonical=True),
    }


def _rows(columns: Mapping[str, Iterable[object]]) -> list[Record]:
    """Return a record for every row of some columns."""
    return [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]
