"""A plan as JSON: stations, what is expected there, and what will be known after them."""

from collections.abc import Iterable, Mapping

import numpy as np
from scipy.spatial.transform import Rotation

from ..planning.route import Plan
from .checked_text import Record, json_text, record


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
            plan, "reached plates safe skipped uncounted undetermined determined", plates=plates
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
