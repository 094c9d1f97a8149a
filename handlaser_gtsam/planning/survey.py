r"""The next stations of a survey: where a profiler, a scanner or an array has most to say.

Candidates look at the targets as they were found, from all sides, at ranges that the sensor had so far
and within the workspace. A candidate says what all its rays say, J'(I + A A')^-1 J with the derivatives
J by sensor and target, and A by the hand's errors, in standard deviations; `choose` takes those that
shrink the laser spots at working distance most. What the survey leaves undetermined counts as known to
a metre, or a radian: so the first stations go where the motion has been too poor. That bound only
guides the choice: spot errors are stated only where survey and stations determine everything.
"""

from dataclasses import dataclass, replace

import numpy as np

from ..arrays import FloatArray, evenly
from ..checks import require_count, require_kind
from ..data.station_list import StationList
from ..data.value import Value
from ..errors import InputError
from ..estimation.estimate import information_axes, least_information
from ..estimation.survey_rows import Item, rays_on
from ..model.families import FAMILIES, PLANE, POSE, bases
from ..model.geometry import skew
from ..model.sensors.kinds import KINDS
from ..model.sensors.mounted import SENSOR
from ..model.weighting import covariance_roots
from ..results.spot_error import radius
from ..results.survey import SurveyCalibration
from ..validation.simulate import Stations, generator
from .bounds import MOST_PLANNED
from .choice import choose
from .goal import Forecast, Goal
from .information import updated
from .workspace import Workspace, drawn_turns, inside, workspace_of

VIEWS = 600
"""Candidates before each target for each sensor: twice as many bring less than a tenth more."""
ORIENTATIONS = 6 * VIEWS
"""Orientations that are drawn for them: of a hand that turns in all directions a sixth looks there."""
RAYS = 60
"""Rays of a candidate: some of a shot, evenly spaced, with the weight of all."""
STEEPEST_VIEW = np.radians(50.0)
"""Candidates look at a plane at angles of incidence up to that: most sensors read there."""
PAST_CENTRE = 0.6
"""They look past the centre of a sphere by up to this part of its radius."""
FEWEST = 0.6
"""This part of the rays meets a plane at least; of a sphere a third of that."""
UNDETERMINED_SIGMA = 1.0
"""Standard deviation [m], [rad] of what is undetermined so far."""


OF_BEAMS = {
    "single beams": (
        "a sensor of many rays in [[sensors]]; or, for beams, a recording of their stations before "
        "planes alone, with a rig file without [[known]]; `check` says what the motion before other "
        "targets leaves open, and what cures it"
    ),
    "cones": (
        "a sensor of many rays in [[sensors]]; for cones add stations that lean by more than "
        "half_angle_deg, about two axes and at different distances, and see with `check` how well the "
        "mounts would be known"
    ),
}
"""What to do where there are only single beams, or cones, to plan for."""


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class SurveyPlan(Value):
    """Stations to measure next, the most useful first.

    Attributes
    ----------
    stations : StationList
    sensors : names
        The sensor that looks at the target, at each station.
    spot_errors : (M + 1,)
        Largest radius of a sensor that holds its spot with 95 %, before the first and after each [m];
        NaN as long as the survey, with the stations up to there, leaves anything undetermined.
    undetermined : tuple of str
        What the survey alone leaves undetermined, in sentences.
    reached : bool, optional
        Whether the goal is reached after them, where there is one: the plan ends there.
    """

    stations: StationList
    sensors: tuple[str, ...]
    spot_errors: FloatArray
    undetermined: tuple[str, ...]
    reached: bool | None = None

    @property
    def determined(self) -> bool:
        """Whether everything is determined once the survey has its stations."""
        return bool(np.isfinite(self.spot_errors[-1]))


def plan_survey(
    calibration: SurveyCalibration,
    count: int = 10,
    workspace: Workspace | None = None,
    goal: Goal | None = None,
    rng: np.random.Generator | None = None,
) -> SurveyPlan:
    """Choose the next stations of a survey with sensors of many rays.

    Parameters
    ----------
    calibration : SurveyCalibration
        Converged or undetermined.
    count : int
        Stations at most.
    workspace : Workspace, optional
        Where the hand may go; about the stations so far where it is not given.
    goal : Goal, optional
        Standard deviations of locations and turns, and spot errors, that are enough for all sensors.
    rng : Generator, optional

    Raises
    ------
    InputError
        No sensor of many rays, a survey that does not fit, or no place for a station.
    """
    require_kind("calibration", calibration, SurveyCalibration)
    require_count("count", count, 1, MOST_PLANNED)
    found = calibration._found
    if calibration.status not in ("converged", "undetermined"):
        raise InputError(f"a survey that is {calibration.status}", "one whose readings fit")
    if not calibration.sensors:
        single = "cones" if found.rows.survey.half_angle else "single beams"
        raise InputError(
            f"a survey of {single} alone, which no stations are planned for", OF_BEAMS[single]
        )
    rng = generator(rng)
    if workspace is None:
        workspace = workspace_of(found.rows.survey.stations)
    names, place = list(calibration.sensors), found.rows.places().place[SENSOR.name]
    seen: dict[tuple[int, tuple[str, int]], list[Item]] = {}
    for item in found.rows.items:
        if item.family == SENSOR.name:
            seen.setdefault((item.member, item.target), []).append(item)
    views: list[tuple[FloatArray, FloatArray, FloatArray]] = []
    looks: list[tuple[str, str]] = []
    for (member, target), items in seen.items():
        view = _views(calibration, items, workspace, rng)
        if view is not None:
            R, t, said = view
            # What a sensor says at further stations counts as little as what it has said.
            views.append(
                (R, t, said / found.spread[place[member] : place[member] + POSE.dim].max())
            )
            looks += [(names[member], found.rows.label(target))] * len(R)
    if not views:
        expected = "a workspace with room for other orientations before the targets"
        raise InputError("no place from which a sensor sees its target", expected)
    values = {name: x[None] for name, x in found.estimate.values.items()}
    problem = found.problem()
    J, _ = problem.rows(problem.blocks, values).whitened()
    information = J.T @ J + np.eye(J.shape[1]) / UNDETERMINED_SIGMA**2
    scale = 1.0 / np.sqrt(np.diagonal(information))  # unknowns differ in size
    size, axes = np.linalg.eigh(information * np.outer(scale, scale))
    root = axes / np.sqrt(np.maximum(size, np.finfo(float).eps))
    spread = found.spread
    C = np.asarray((root @ root.T) * np.outer(scale, scale) * np.outer(spread, spread))
    most = max(said.shape[1] for _, _, said in views)
    padded = [(R, t, np.pad(x, ((0, 0), (0, most - x.shape[1]), (0, 0)))) for R, t, x in views]
    R, t, rows = (np.concatenate(parts) for parts in zip(*padded, strict=True))
    # Derivatives (3 sensors, U) of the spots at working distance, in their sensors' frames.
    spots = np.zeros((len(names), 3, J.shape[1]))
    for own, first, sensor in zip(spots, place, calibration.sensors.values(), strict=True):
        own[:, first : first + 6] = np.hstack((-skew(sensor.spot), np.eye(3)))
    taken, _, _ = choose(rows[None], C, spots.reshape(-1, J.shape[1]), min(count, len(rows)))
    information, axes, unit = information_axes(problem, problem.blocks, values)
    told = np.sqrt(information)[:, None] * axes.T
    known, asked = not calibration.undetermined, goal if goal is not None and goal.stated else None
    reached, errors = False, [_spot_error(C, spots) if known else np.nan]
    for A in rows[taken]:
        if reached:
            break
        C = updated(C, A[None])
        told = np.vstack((told, A * unit))
        if not known:  # rows of unit weight and in natural units: do they determine all unknowns
            information = np.asarray(np.linalg.svd(told, compute_uv=False) ** 2, dtype=np.float64)
            known = bool(information.min() >= least_information(information))
        errors.append(_spot_error(C, spots) if known else np.nan)
        if known and asked is not None:
            reached = _reached(calibration, C, errors[-1], asked)
    taken = taken[: len(errors) - 1]
    return SurveyPlan(
        StationList(R[taken], t[taken], tuple(looks[i][1] for i in taken)),
        tuple(looks[i][0] for i in taken),
        np.array(errors),
        calibration.undetermined,
        None if asked is None else reached,
    )


def _views(
    calibration: SurveyCalibration,
    items: list[Item],
    workspace: Workspace,
    rng: np.random.Generator,
) -> tuple[FloatArray, FloatArray, FloatArray] | None:
    """Draw candidates of the sensor of some items; keep those that see their target, None if none does.

    Returns
    -------
    R, t : (N, 3, 3), (N, 3)
        Hand poses.
    rows : (N, B, U)
        What they say, of unit weight, over all unknowns.
    """
    found, member, (family, number) = calibration._found, items[0].member, items[0].target
    R, t = _drawn(calibration, items, workspace, rng)
    good = inside(workspace, Stations(R, t, np.zeros(len(R), dtype=np.intp)))
    R, t = R[good], t[good]
    if not len(R):
        return None
    shots = found.rows.survey.shots[member]
    # Some rays of the largest shot have the weight of all.
    points = max((item.points for item in items if item.points is not None), key=len)
    some = points[evenly(len(points), RAYS)]
    rays = KINDS[shots.kind].rays(shots.across[some])
    values = {name: x[None] for name, x in found.estimate.values.items()}
    values[POSE.name] = np.hstack((R.reshape(-1, 9), t))[None]
    none = np.zeros(1)
    columns, missed = rays_on(values, member, family, np.full(len(R), number), rays, none, none)
    s = columns[-1, 0]
    reading = np.concatenate([item.shot.reading for item in items if item.shot is not None])
    good = (s > 0.8 * reading.min()) & (s < 1.2 * reading.max()) & np.isfinite(s) & ~missed
    enough = good.mean(axis=1) >= (FEWEST if family == PLANE.name else FEWEST / 3.0)
    if not enough.any():
        return None
    R, t, s, good = R[enough], t[enough], s[enough], good[enough]
    values[POSE.name] = values[POSE.name][:, enough]
    at = np.full(len(R), number)
    h = 1e-6  # of the scale, by differences: it is rarely unknown
    scaled = replace(
        rays,
        origin=rays.origin + h * rays.origin_by_scale,
        direction=rays.direction + h * rays.direction_by_scale,
    )
    stretched, _ = rays_on(values, member, family, at, scaled, none, none)
    by_scale = (stretched[-1, 0] - s) / h
    by_scale = np.where(np.isfinite(by_scale), by_scale, 0.0)
    flat = np.where(np.isfinite(s), s, 0.0)
    by_error = np.stack((np.ones_like(flat), flat, flat**2, -by_scale))[:, None]
    columns, _ = rays_on(values, member, family, at, rays, flat, by_error)
    root = good * np.sqrt(len(points) / len(some)) / found.noise.sigma[member]
    columns = np.moveaxis(np.where(root > 0.0, columns[:, 0] * root, 0.0), 0, 2)  # (N, S, c)
    seen = np.arange(FAMILIES[family].dim)
    place, widths = found.rows.places(), found.rows.unknown()
    free = np.flatnonzero(np.broadcast_to(widths[SENSOR.name], SENSOR.dim))
    J = columns[..., np.append(free, SENSOR.dim + seen)]
    # The hand's errors are those of the first station.
    covariance = found.at(values, found.noise).pose_covariance()
    A = columns[..., SENSOR.dim + len(seen) :][..., :6] @ covariance_roots(covariance[:1])[0]
    AJ = np.swapaxes(A, 1, 2) @ J
    M = np.swapaxes(J, 1, 2) @ J
    M -= np.swapaxes(AJ, 1, 2) @ np.linalg.solve(np.eye(6) + np.swapaxes(A, 1, 2) @ A, AJ)
    size, axes = np.linalg.eigh(M)
    rows = np.zeros((*size.shape, len(place.names)))
    of_sensor = place.place[SENSOR.name][member] + np.arange(len(free))
    rows[..., np.append(of_sensor, place.place[family][number] + seen)] = np.sqrt(
        np.maximum(size, 0.0)
    )[..., None] * np.swapaxes(axes, 1, 2)
    return R, t, rows


def _drawn(
    calibration: SurveyCalibration,
    items: list[Item],
    workspace: Workspace,
    rng: np.random.Generator,
) -> tuple[FloatArray, FloatArray]:
    """Return hand poses, as far turned as the workspace allows, whose sensor looks at a target."""
    found = calibration._found
    stations = found.rows.survey.stations
    sensor = list(calibration.sensors.values())[items[0].member]
    station = np.array([item.station for item in items])
    reading = np.array([np.median(i.shot.reading) for i in items if i.shot is not None])
    middle = KINDS[sensor.kind].rays(
        np.median(found.rows.survey.shots[items[0].member].across, axis=0)[None]
    )
    o, u = middle.origin[0], middle.direction[0]
    in_hand = (o + reading[:, None] * u) @ sensor.rotation.T + sensor.location
    spots = (stations.world_R_hand[station] @ in_hand[..., None])[..., 0]
    spots += stations.world_t_hand[station]
    family, number = items[0].target
    x = found.estimate.values[family][number]
    R = drawn_turns(workspace, ORIENTATIONS, rng)
    direction = R @ sensor.rotation @ u
    if family == PLANE.name:
        before = stations.world_R_hand[station] @ sensor.rotation @ u @ x[:3]
        R = R[np.sign(before.sum()) * (direction @ x[:3]) > np.cos(STEEPEST_VIEW)][:VIEWS]
        direction = R @ sensor.rotation @ u
        spread = (spots - spots.mean(axis=0))[rng.integers(len(spots), size=len(R))]
        at = spots.mean(axis=0) + rng.uniform(-1.0, 1.0, (len(R), 1)) * spread
    else:
        R, direction = R[:VIEWS], direction[:VIEWS]
        aside = bases(direction) @ rng.uniform(-PAST_CENTRE, PAST_CENTRE, (len(R), 2, 1)) * x[3]
        at = x[:3] + aside[..., 0] - x[3] * direction
    nearest, farthest = np.quantile(reading, (0.05, 0.95)).tolist()
    d = rng.uniform(nearest, farthest, (len(R), 1))
    start = (R @ (sensor.rotation @ o + sensor.location)[:, None])[..., 0]
    return R, at - d * direction - start


def _reached(calibration: SurveyCalibration, C: FloatArray, spot: float, goal: Goal) -> bool:
    """Tell whether all sensors are as well known as the goal asks."""
    place, turns, shifts = calibration._found.rows.places().place[SENSOR.name], [], []
    for first, sensor in zip(place, calibration.sensors.values(), strict=True):
        S, R = C[first : first + 6, first : first + 6], sensor.rotation
        turns.append(np.diagonal(S[:3, :3]).max())
        shifts.append(np.diagonal(R @ S[3:, 3:] @ R.T).max())
    location, direction = np.sqrt([[max(shifts)], [max(turns)]])
    return Forecast(location, direction, np.array([spot]), np.nan).reaches(goal) is not None


def _spot_error(C: FloatArray, spots: FloatArray) -> float:
    """Return the largest radius that holds a spot with 95 % [m]."""
    return max(radius(own @ C @ own.T) for own in spots)
