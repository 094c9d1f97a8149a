"""A plan as JSON: stations, what is expected there, and what will be known after them."""

from scipy.spatial.transform import Rotation

from ..planning.route import Plan
from .json_text import Record, json_text


def plan_text(plan: Plan) -> str:
    """Return a plan as JSON text; stations that only divide the way are among the others."""
    stations = plan.stations
    quaternions = Rotation.from_matrix(stations.world_R_hand).as_quat(canonical=True)
    forecast = plan.forecast
    rows: list[Record] = [
        {
            "station": stations.station_names[j],
            "plane": stations.plane_labels[j],
            "position_m": stations.world_t_hand[j],
            "quaternion_xyzw": quaternions[j],
            "ranges_m": plan.ranges[j],
            "range_sigmas_m": plan.range_sigmas[j],
            **({} if stations.joints is None else {"joints": stations.joints[j]}),
        }
        for j in range(len(stations))
    ]
    known: list[Record] = [
        {
            "stations": number,
            "location_sigma_m": forecast.location_sigma[number],
            "direction_sigma_rad": forecast.direction_sigma[number],
            "spot_m": forecast.spot[number],
        }
        for number in range(len(forecast) + 1)
    ]
    plates: list[Record] = [
        {"plane": name, "point_m": plate.point, "normal": plate.normal}
        for name, plate in plan.plates.items()
    ]
    return json_text(
        "plan",
        {
            "stations": rows,
            "forecast": known,
            "working_distance_m": forecast.working_distance,
            "reached": plan.reached,
            "plates": plates,
            "safe": plan.safe,
            **({"joint_names": list(stations.joint_names)} if stations.joint_names else {}),
        },
    )
