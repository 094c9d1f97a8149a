r"""The next stations of a survey: where a profiler, a scanner, an array or a beam has most to say.

Candidates look at the planes and spheres as they were found, from all sides, at ranges that the sensor
had so far and within the workspace. A candidate says what all its rays say, by the rows of the survey
and with the errors of the hand; those are taken that shrink the laser spots at working distance
most. What the survey leaves undetermined counts as known to a metre, or a radian: so the first stations
go where the motion has been too poor. That bound only guides the choice: standard deviations are stated
only where survey and stations determine everything.
"""

from collections.abc import Container, Iterator, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from ..arrays import BoolArray, FloatArray, evenly
from ..errors import InputError
from ..estimation.dense import dense_rows, with_pose_errors
from ..estimation.estimate import information_axes, least_information
from ..estimation.survey_by_pose import of_other_stations
from ..estimation.survey_rows import (
    TARGETS,
    Entity,
    Item,
    by_place,
    missed,
    rays_before,
    without_range_errors,
)
from ..model.block import Weights
from ..model.condensed_shots import MOST_SLANTED
from ..model.families import (
    BEAM,
    DIRECTION,
    LOCATION,
    MOUNT_DIM,
    OF_DIRECTION,
    OF_LOCATION,
    OF_RANGE_ERROR,
    PLANE,
    POSE,
    bases,
)
from ..model.range_blocks import PoseVariables, Ranges
from ..model.sensors.beam import BeamSensor
from ..model.sensors.kinds import KINDS
from ..model.sensors.mounted import SENSOR, Mounted
from ..model.targets.sphere import SPHERE
from ..results.survey import SensorMount, SurveyCalibration
from ..validation.simulate import Stations, read_back
from .bounds import Plate, plate_of
from .goal import Aim, Forecast, Goal, PlannedMount
from .route import Plan, planned, visited
from .workspace import (
    Workspace,
    drawn_turns,
    inside,
    joined,
    reached,
    room_to_turn,
    workspace_of,
)

VIEWS = 600
"""Candidates before each target for each sensor, or for all beams together: twice as many bring less
than a tenth more."""
RAYS = 60
"""Rays of a candidate: some of a shot, evenly spaced, with the weight of all."""
PAST_CENTRE = 0.6
"""They look past the centre of a sphere by up to this part of its radius."""
FEWEST = {PLANE.name: 0.6, SPHERE.name: 0.2}
"""This part of the rays of a sensor meets its target at least: a sphere is smaller than a plate."""


def plan_survey(
    calibration: SurveyCalibration,
    count: int,
    workspace: Workspace | None,
    goal: Goal,
    rng: np.random.Generator,
) -> Plan:
    """Choose the next stations of a survey; see `plan`.

    Raises
    ------
    InputError
        A survey of cones, one that does not fit, or no place for a station.
    """
    if calibration.status not in ("converged", "undetermined"):
        raise InputError(f"a survey that is {calibration.status}", "one whose readings fit")
    if goal.criterion in ("D", "E") or goal.working_distance:
        raise InputError(
            "criterion D or E, or working_distance_mm in [goal], with sensors of many rays or other "
            "targets",
            "what is enough: stations are chosen for spots at the typical readings",
        )
    of = calibration._found.rows
    if of.survey.cones.any() and not calibration.sensors:
        raise InputError(
            "a survey of cones alone, which no stations are planned for",
            "a sensor of many rays in [[sensors]]; for cones add stations that lean by more than "
            "half_angle_deg, about two axes and at different distances, and see with `check` how well "
            "the mounts would be known",
        )
    from_seen = workspace is None
    workspace = workspace_of(of.survey.stations) if workspace is None else workspace
    looks: dict[tuple[str, int, tuple[str, int]], list[Item]] = {}
    for item in of.items:
        if item.target[0] in TARGETS and not item.half_angle:
            looks.setdefault((item.family, item.member, item.target), []).append(item)
    targets = list(dict.fromkeys(target for _, _, target in looks))
    if workspace.robot is not None and len(targets) > 1:
        raise InputError(
            f"an arm before {len(targets)} targets that stand at once",
            "one target: ways of the arm are checked against one plate; leave [robot] away, and check "
            "the ways before you drive them",
        )
    plates: list[Plate | None] = [None] * len(targets)
    names, parts = list[str](), list[tuple[Stations, FloatArray]]()
    for (family, member, target), items in looks.items():
        look, at = _Look(calibration, items), targets.index(target)
        stations = look.drawn(workspace, at, rng, from_seen=from_seen)
        stations = stations[inside(workspace, stations)]
        if not len(stations):
            continue
        seen, said = look.rows(stations)
        stations, plates[at] = stations[seen], look.plate()
        near = reached(workspace, stations, plates)
        parts.append((stations[near], said[near]))
        name = of.names(family)[member]
        names += [f"beam {name}" if family == BEAM.name else name] * int(near.sum())
    if not names:
        raise InputError(
            "no place from which a sensor sees its target",
            "a workspace with room for other orientations before the planes or spheres",
        )
    pool, most = joined([part for part, _ in parts]), max(said.shape[1] for _, said in parts)
    padded = [np.pad(said, ((0, 0), (0, most - said.shape[1]), (0, 0))) for _, said in parts]
    rows, labels = np.concatenate(padded), [of.label(target) for target in targets]
    known = _Known(calibration, {(family, member) for family, member, _ in looks}, goal)
    chosen = known.chosen(rows[None], count, exchange=True)
    chosen = chosen[: known.enough(rows[chosen])]
    taken = of.survey.stations.station_names
    visit = partial(visited, workspace, labels=labels, plates=plates, taken=taken)
    plan, candidate = planned(known, pool, rows, chosen, visit)
    return replace(
        plan,
        sensors=tuple(names[i] if i >= 0 else "" for i in candidate),
        undetermined=calibration.undetermined,
    )


class _Known(Aim):
    """What a survey knows of its unknowns, and from when on it knows all of them.

    In `covariance` what is undetermined is known to a metre or a radian. What is to become small are
    the spots of the sensors and beams that stations are planned for.
    """

    def __init__(
        self, calibration: SurveyCalibration, planned: Container[Entity], goal: Goal
    ) -> None:
        found = calibration._found
        problem = found.problem()
        information, axes, self._unit = information_axes(problem, problem.start)
        self._rows = np.sqrt(information)[:, None] * axes.T
        self._open = bool(calibration.undetermined)
        unit = self._unit
        H = (axes * information) @ axes.T + np.diag(unit**2)
        scale = 1.0 / np.sqrt(np.diagonal(H))  # unknowns differ in size
        size, own = np.linalg.eigh(H * np.outer(scale, scale))
        root = own / np.sqrt(np.maximum(size, np.finfo(float).eps))
        spread = scale * unit * found.spread
        covariance = (root @ root.T) * np.outer(spread, spread)
        mounts, by_pose = list(_mounts(calibration, planned)), None
        if found.by_pose is not None:
            F = np.concatenate(list(found.by_pose.columns), axis=1)
            J, _ = found.ended().dense()[0].whitened()
            by_pose = J.T @ F / found.spread[:, None] ** 2
        super().__init__(covariance, mounts, replace(goal, criterion="spot"), np.nan, by_pose)

    def forecast(self, rows: FloatArray) -> Forecast:
        """Return what will be known after each station; NaN where something is undetermined."""
        told, known = self._rows, [not self._open]
        # Of unit weight and in natural units: do they determine all unknowns?
        for station in rows[..., : len(self._unit)]:
            told = np.vstack((told, station * self._unit))
            information = np.asarray(np.linalg.svd(told, compute_uv=False) ** 2, dtype=np.float64)
            known.append(known[-1] or bool(information.min() >= least_information(information)))
        said = super().forecast(rows)
        every = said.location_sigma, said.direction_sigma, said.spot
        location, direction, spot = (np.where(known, one, np.nan) for one in every)
        return Forecast(location, direction, spot, said.working_distance)


def _mounts(calibration: SurveyCalibration, planned: Container[Entity]) -> Iterator[PlannedMount]:
    """Yield what a goal asks of every sensor and beam that stations are planned for."""
    of = calibration._found.rows.places()
    for family, mounts in (SENSOR.name, calibration.sensors), (BEAM.name, calibration.beams):
        for member, mount in enumerate(mounts.values()):
            if (family, member) not in planned:
                continue
            spot = mount.spot_by()
            own = np.eye(spot.shape[1], len(of.names), int(of.place[family][member]))
            location, turns = own[LOCATION], own[DIRECTION][None]
            if isinstance(mount, SensorMount):
                location, turns = mount.rotation @ own[3:], own[:3, None]
            yield PlannedMount(location, turns, spot @ own)


class _Look:
    """A sensor, or a beam, before one target: candidates there, and what they say."""

    def __init__(self, calibration: SurveyCalibration, items: Sequence[Item]) -> None:
        self.found, self.first, self.items = calibration._found, items[0], items
        self.values = {name: x[None] for name, x in self.found.estimate.values.items()}
        member, (family, number) = self.first.member, self.first.target
        self.target = self.values[family][0, number]
        self.reading = np.array(
            [i.reading if i.shot is None else np.median(i.shot.reading) for i in items]
        )
        if self.first.family == BEAM.name:
            x = self.values[BEAM.name][0, member]
            self.start, self.ray = x[OF_LOCATION], x[OF_DIRECTION]
        else:
            sensor = list(calibration.sensors.values())[member]
            shots = self.found.rows.survey.shots[member]
            middle = KINDS[shots.kind].rays(np.median(shots.across, axis=0)[None])
            self.start = sensor.rotation @ middle.origin[0] + sensor.location
            self.ray = sensor.rotation @ middle.direction[0]
        stations, at = self.found.rows.survey.stations, [item.station for item in items]
        R, t = stations.world_R_hand[at], stations.world_t_hand[at]
        self.before = R @ self.ray
        self.spots = R @ self.start + t + self.reading[:, None] * self.before

    def plate(self) -> Plate | None:
        """Return a plane as a plate about the spots so far; None for a sphere."""
        if self.first.target[0] != PLANE.name:
            return None
        n, height, centre = self.target[:3], self.target[3], self.target[4:]
        away = float(np.sign((self.before @ n).sum()))
        return plate_of(away * n, away * float(height - n @ centre), self.spots.mean(axis=0))

    def drawn(
        self, workspace: Workspace, target: int, rng: np.random.Generator, *, from_seen: bool
    ) -> Stations:
        """Draw stations before `target`, turned as far as allowed, whose middle ray looks there.

        Perhaps only `from_seen` directions: within the cone from which it was seen so far.
        """
        beams = len(self.found.rows.survey.beam_names)
        views = VIEWS // beams if self.first.family == BEAM.name else VIEWS
        # Of a hand that turns in all directions a sixth looks there.
        R, x = drawn_turns(workspace, 6 * views, rng), self.target
        if from_seen:
            axis = self.before.mean(axis=0) / np.linalg.norm(self.before.mean(axis=0))
            cone = room_to_turn(float(np.arccos(np.clip((self.before @ axis).min(), -1.0, 1.0))))
            R = R[R @ self.ray @ axis >= np.cos(cone)]
        if self.first.target[0] == PLANE.name:
            away = np.sign((self.before @ x[:3]).sum())
            # Candidates look at a plane at angles of incidence up to that: most sensors read there.
            R = R[away * (R @ self.ray @ x[:3]) > np.cos(np.radians(50.0))][:views]
            direction, middle = R @ self.ray, self.spots.mean(axis=0)
            spread = (self.spots - middle)[rng.integers(len(self.spots), size=len(R))]
            at = middle + rng.uniform(-1.0, 1.0, (len(R), 1)) * spread
        else:
            R = R[:views]
            direction = R @ self.ray
            aside = bases(direction) @ rng.uniform(-PAST_CENTRE, PAST_CENTRE, (len(R), 2, 1))
            at = x[:3] + x[3] * (aside[..., 0] - direction)
        nearest, farthest = np.quantile(self.reading, (0.05, 0.95)).tolist()
        d = rng.uniform(nearest, farthest, (len(R), 1))
        return Stations(R, at - d * direction - R @ self.start, np.full(len(R), target))

    def rows(self, stations: Stations) -> tuple[BoolArray, FloatArray]:
        """Return which stations (M,) see their target, and what these say: whitened rows (N, B, U + c).

        At a station of a beam all beams that see the target say something. The last columns are of
        errors of the hand that change with its pose; see `Aim`.
        """
        (family, number), mount, member = self.first.target, self.first.mount, self.first.member
        count, state = len(stations), self.found.ended()
        poses = np.hstack((stations.world_R_hand.reshape(-1, 9), stations.world_t_hand))
        values = {**self.values, POSE.name: poses[None]}
        seen_at = np.full(count, number)
        if self.first.family == BEAM.name:
            beams = values[BEAM.name].shape[1]
            station, rays, heavier = np.repeat(np.arange(count), beams), 1, 1.0
            single, zero = (
                BeamSensor(np.tile(np.arange(beams), count)),
                np.zeros((1, len(station), 1)),
            )
            target = TARGETS[family](np.repeat(seen_at, beams))
            block = Ranges(single, target, PoseVariables(station), zero)
        else:
            shots = self.found.rows.survey.shots[member]
            points = max((i.points for i in self.items if i.points is not None), key=len)
            some = points[evenly(len(points), RAYS)]  # which have the weight of all
            own = KINDS[shots.kind].rays(shots.across[some])
            station, rays, heavier = np.arange(count), len(some), len(points) / len(some)
            heavier /= float(np.median([item.growth for item in self.items]))
            block = rays_before(member, own, family, seen_at, station)
        met = block.evaluate(without_range_errors(values))
        d = np.concatenate(
            [np.atleast_1d(i.reading if i.shot is None else i.shot.reading) for i in self.items]
        )
        s, sensor = met.columns[-1, 0], block.sensor
        good = (s > 0.8 * d.min()) & (s < 1.2 * d.max())
        good &= ~missed(family, met)
        if family == SPHERE.name or isinstance(sensor, Mounted):  # a survey counts none that graze
            good &= np.linalg.norm(by_place(met), axis=0) < MOST_SLANTED
        s = np.where(good, s, 0.0)
        if isinstance(sensor, Mounted):
            seen, reading = good.mean(axis=1) >= FEWEST[family], s
            # A ray that is turned moves as one that starts elsewhere, in proportion to its range.
            moved = own.origin_by_scale + s[..., None] * own.direction_by_scale
            by_scale = np.einsum("igs,gsi->gs", met.columns[3:6, 0], moved)
            by_error = np.stack((np.ones_like(s), s, s**2, -by_scale))[:, None]
            sensor = replace(sensor, by_error=by_error)
        else:
            seen = good.reshape(count, -1)[:, member]
            k = values[BEAM.name][0, sensor.member][:, OF_RANGE_ERROR]
            reading = read_back(s[:, 0], k)[:, None]
        root = good * np.sqrt(heavier) / state.sigmas()[mount]
        weights = Weights(root[None], None, np.repeat(station[:, None], rays, axis=1))
        block = replace(block, sensor=sensor, reading=reading[None], weights=weights)
        hand = np.broadcast_to(state.pose_covariance()[:1], (count, 6, 6))  # of the first station
        of = self.found.rows.places()
        dense = dense_rows(with_pose_errors([block], values, hand), values, of)
        J, _ = dense.whitened()
        J = J.reshape(count, -1, len(of.names))[seen]
        used = np.flatnonzero(J.any(axis=(0, 1)))
        J = J[..., used]
        # As few rows along eigenvectors: rows of like size would lose digits to what is undetermined.
        size, axes = np.linalg.eigh(np.swapaxes(J, 1, 2) @ J)
        size, axes = np.sqrt(np.maximum(size, 0.0)), np.swapaxes(axes, 1, 2)
        rows = np.zeros((len(J), len(used), len(of.names)))
        rows[..., used] = size[..., None] * axes
        if self.found.by_pose is not None and self.found.by_pose.sizes is not None:
            at = stations.world_R_hand, stations.world_t_hand
            by_pose = of_other_stations(self.found.by_pose.sizes, state, dense, *at)
            F = np.concatenate(list(by_pose.columns), axis=1)
            F = F.reshape(count, -1, F.shape[1])[seen]
            unit = np.divide(1.0, size, out=np.zeros_like(size), where=size > 0.0)[..., None] * axes
            rows = np.concatenate((rows, unit @ (np.swapaxes(J, 1, 2) @ F)), axis=2)
        # What a sensor says at further stations counts as little as what it has said.
        width = MOUNT_DIM if self.first.family == BEAM.name else POSE.dim
        place = of.place[mount[0]][member] + np.arange(width)
        return seen, rows / self.found.spread[place].max()
