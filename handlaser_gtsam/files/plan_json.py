"""A plan as JSON: stations, what is expected there, and what will be known after them."""

from collections.abc import Iterable, Mapping

from scipy.spatial.transform import Rotation

from ..planning.route import Plan
from ..planning.survey import SurveyPlan
from .checked_text import Record, json_text, record


def plan_text(plan: Plan) -> str:
    """Return a plan as JSON text; stations that only divide the way are among the others."""
    stations, forecast = plan.stations, plan.forecast
    columns: dict[str, Iterable[object]] = {
        "station": stations.station_names,
        "plane": stations.plane_labels,
        "position_m": stations.world_t_hand,
        "quaternion_xyzw": Rotation.from_matrix(stations.world_R_hand).as_quat(canonical=True),
        "ranges_m": plan.ranges,
        "range_sigmas_m": plan.range_sigmas,
    }
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
    stations = plan.stations
    columns: dict[str, Iterable[object]] = {
        "station": stations.station_names,
        "target": stations.plane_labels,
        "sensor": plan.sensors,
        "position_m": stations.world_t_hand,
        "quaternion_xyzw": Rotation.from_matrix(stations.world_R_hand).as_quat(canonical=True),
        "spot_error_m": plan.spot_errors[1:],
    }
    content: Record = {
        "spot_error_m": plan.spot_errors[0],
        "stations": _rows(columns),
        "undetermined": plan.undetermined,
        "determined": plan.determined,
    }
    return json_text("survey-plan", content)


def _rows(columns: Mapping[str, Iterable[object]]) -> list[Record]:
    """Return a record for every row of some columns."""
    return [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]
