"""Plan the next stations of a calibration, of beams before planes or of a survey."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from .. import model
from ..arrays import BoolArray, IntArray
from ..checks import require_count, require_kind
from ..errors import GrazingBeamError, InputError
from ..model.sensor_limits import Sensor
from ..quantities import FAR_SIGMAS
from ..results.calibration import Calibration
from ..results.mounts import Mounts
from ..validation.simulate import Stations, generator, plane_name
from .belief import COMPARED_DRAWS, Belief, belief_of, outlook, station_rows
from .bounds import MOST_PLANNED, Placement, Plate
from .choice import value
from .goal import Aim, Goal
from .route import Plan, planned, visited
from .workspace import (
    Workspace,
    drawn_turns,
    inside,
    joined,
    least_cosine,
    reached,
    require_facing,
    require_range,
    workspace_of,
)

if TYPE_CHECKING:
    from ..results.survey import SurveyCalibration

POOL = 1200
"""Candidates of all planes together: twice as many lower the criterion by about 2 %."""
ENDS = 0.4
"""Both exponents of the beta distribution of where in the range candidates read: mostly at its ends."""
MOST_TRIED = 40
"""Multiple of the candidates wanted that are drawn, before giving up: of a workspace of which a
fortieth is good."""
LEAST_CANDIDATES = 10
"""Fewer are no choice."""


class Task(NamedTuple):
    """What a plan starts from.

    Attributes
    ----------
    belief : Belief
    workspace : Workspace
    sensor : Sensor
    goal : Goal
    taken : sequence of str
        Names of stations that there are already.
    """

    belief: Belief
    workspace: Workspace
    sensor: Sensor
    goal: Goal
    taken: Sequence[str] = ()

    @property
    def aim(self) -> Aim:
        """What the stations are chosen for."""
        distance, belief = self.goal.distance(self.sensor), self.belief
        by_pose = None if belief.by_pose is None else belief.by_pose.counted
        return Aim(belief.covariance, belief.mounts(distance), self.goal, distance, by_pose)

    def safe(self, stations: Stations) -> BoolArray:
        """Tell at which stations (M,) all readings are within the sensor's limits, with a margin.

        The margin is `FAR_SIGMAS`: of a hundred readings at its very edge, less than one in a hundred
        plans has one beyond the limits.

        Raises
        ------
        GrazingBeamError, InputError
            As `outlook` does.
        """
        reading, spread, cosine, cosine_sigma = outlook(self.belief, stations)
        near, far = reading - FAR_SIGMAS * spread, reading + FAR_SIGMAS * spread
        steep = cosine - FAR_SIGMAS * cosine_sigma >= least_cosine(self.sensor)
        readable = self.sensor.can_read(near) & self.sensor.can_read(far)
        return np.asarray((readable & steep).all(axis=1))

    def candidates(self, plane: int, count: int, rng: np.random.Generator) -> Stations:
        """Return up to `count` stations before a plane at which every beam can read it safely.

        Raises
        ------
        InputError
            The sensor's range is not stated, or there is hardly a station.
        """
        belief, workspace, sensor = self.belief, self.workspace, self.sensor
        require_range(sensor)
        mean, name = belief.mean, belief.plane_names[plane]
        n, b, k = mean.normals[plane], mean.offsets[plane], mean.range_errors
        require_facing(f"plane {name}", workspace, mean.directions, n)
        low, high = (
            np.asarray(model.corrected(np.full(len(k), end), k))
            for end in (sensor.range_min, sensor.range_max)
        )

        def moved_to_read(count: int) -> Stations:
            """Return random stations, moved along the normal until the beams can read."""
            R = drawn_turns(workspace, count, rng)
            t = rng.uniform(workspace.low, workspace.high, (count, 3))
            n_hand = np.einsum("mji,j->mi", R, n)
            cosine = n_hand @ mean.directions.T
            good = (cosine > least_cosine(sensor)).all(axis=1)
            R, t, n_hand, cosine = R[good], t[good], n_hand[good], cosine[good]
            s = -(n_hand @ mean.locations.T + (t @ n + b)[:, None]) / cosine
            # A step back by h along the normal lengthens the range of a beam by h over its cosine.
            nearest = ((low - s) * cosine).max(axis=1)
            farthest = ((high - s) * cosine).min(axis=1)
            fits = farthest > nearest
            share = rng.beta(ENDS, ENDS, size=int(fits.sum()))
            back = nearest[fits] + share * (farthest - nearest)[fits]
            return Stations(R[fits], t[fits] - back[:, None] * n, np.full(len(back), plane))

        kept: list[Stations] = []
        plates = belief.plates()
        drawn = good = asked = 0
        # Multiple of the candidates wanted of which an arm is asked, which takes longer than
        # drawing them.
        while drawn < MOST_TRIED * count and good < count and asked < 3 * count:
            wanted = count
            if drawn:  # by how many of those drawn were good so far
                # Poses drawn in one round, or as many as are wanted if those are more: they fit
                # into memory.
                most = min(max(3000, count), MOST_TRIED * count - drawn)
                # Multiple of the poses that seem to be missing that are drawn: most rounds are the
                # last.
                missing = 1.3 * (count - good) * drawn / max(good, 1)
                wanted = int(np.clip(missing, 0.1 * count, most))
            drawn += wanted
            tried = moved_to_read(wanted)
            tried = tried[inside(workspace, tried)]
            if not len(tried):
                continue
            tried = tried[self.safe(tried)]
            if workspace.robot is not None:
                tried = tried[:count]
                asked += len(tried)
            kept.append(tried[reached(workspace, tried, plates)])
            good += len(kept[-1])
        if good >= LEAST_CANDIDATES:
            return joined(kept)[:count]
        if asked >= LEAST_CANDIDATES:
            raise InputError(
                f"no station before plane {name} that the arm reaches without a collision, of {asked} "
                "that are safe for the sensor",
                "another place of the plate or of the arm's base, or a smaller clearance",
            )
        raise InputError(
            f"no station before plane {name} at which every beam reads it safely",
            "a workspace that reaches the sensor's range, or a calibration that is known better",
        )

    def reachable(self, count: int, rng: np.random.Generator) -> Stations:
        """Return up to `count` safe stations before each plane; some planes may be out of reach.

        Raises
        ------
        InputError
            The sensor's range is not stated, or all planes are out of reach.
        """
        parts, refusal = [], None
        for plane in range(len(self.belief.plane_names)):
            try:
                parts.append(self.candidates(plane, count, rng))
            except InputError as error:
                refusal = refusal or error
        if refusal is not None and not parts:
            raise refusal
        return joined(parts)

    def planned(
        self,
        stations: Stations,
        spare: Stations | None = None,
        *,
        ordered: bool = False,
    ) -> Plan:
        """Return a plan of stations, which matter in the order given, or of `spare` ones instead.

        They are visited in another order, unless this one is to stay (`ordered`), with others between
        them where steps are long.

        Raises
        ------
        InputError
            The arm finds no way to any station, or not to all that are ordered.
        """
        belief, candidates = self.belief, stations
        location, direction = self.goal.units
        if spare is not None and self.workspace.robot is not None:
            candidates = joined([stations, spare])
        visit = partial(
            visited,
            self.workspace,
            labels=belief.plane_names,
            plates=belief.plates(),
            taken=self.taken,
            length=None if ordered else location / direction,
        )
        rows, chosen = station_rows(belief, candidates), np.arange(len(stations))
        plan, candidate = planned(self.aim, candidates, rows, chosen, visit)
        if plan.skipped and ordered:
            raise InputError(
                f"no way of the arm to {plan.skipped} of {len(stations)} stations of a first motion",
                "more room around the plate, or a smaller clearance",
            )
        read = candidate >= 0
        ranges, sigmas = (np.full((len(read), belief.beams), np.nan) for _ in range(2))
        ranges[read], sigmas[read], _, _ = outlook(belief, candidates[candidate[read]])
        return replace(plan, ranges=ranges, range_sigmas=sigmas, uncounted=belief.uncounted)


def planning_task(
    calibration: Calibration | Mounts,
    sensor: Sensor,
    workspace: Workspace | None,
    goal: Goal,
    plates: Mapping[str, Plate] | None = None,
) -> Task:
    """Return the task of planning further stations of a calibration; arguments as `plan` has them.

    Raises
    ------
    InputError
        No covariance, plane or workspace is known.
    """
    recording = None if isinstance(calibration, Mounts) else calibration.recording
    if workspace is None:
        if recording is None:
            raise InputError(
                "no recording that shows the workspace", "a workspace: [workspace] in a rig file"
            )
        workspace = workspace_of(recording)
    belief = belief_of(calibration)
    if plates is not None:
        belief = belief.before(plates)
    if not belief.plane_names:
        raise InputError("no plane to plan stations before", "where a plate stands roughly")
    names = () if recording is None else recording.station_names
    return Task(belief, workspace, sensor, goal, names)


def plan(
    calibration: "Calibration | Mounts | SurveyCalibration",
    stations: int,
    sensor: Sensor | None = None,
    workspace: Workspace | None = None,
    goal: Goal | None = None,
    *,
    plates: Mapping[str, Plate] | None = None,
    placement: Placement | None = None,
    rng: np.random.Generator | None = None,
) -> Plan:
    """Choose the stations that determine the mounts best, given what a calibration knows so far.

    They lie before the planes of the calibration, which stand where they stood, and before `plates`;
    with a `placement` before the last of these planes only, moved to the best orientations. Stations of
    a survey look at its planes and spheres as they were found, and first determine what its motion has
    left undetermined.

    Parameters
    ----------
    calibration : Calibration, Mounts or SurveyCalibration
        Mounts know no planes: `plates` says where there are some. A survey may be undetermined.
    stations : int
        At most; fewer where fewer reach what the goal states.
    sensor : Sensor
        Of beams before planes; sensors of a survey read as far as they did so far.
    workspace : Workspace, optional
        Around the stations so far, where not given.
    goal : Goal, optional
        Stations of a survey are chosen for spots, at the typical reading of each beam and sensor.
    plates : mapping of names to Plate, optional
        Of which nothing was read yet; for beams before planes.
    placement : Placement, optional
        For beams before planes.
    rng : numpy.random.Generator, optional

    Raises
    ------
    InputError
        No covariance, plane, workspace or sensor's range is known, or no station is safe; a survey of
        cones, one that does not fit, or arguments that are for beams before planes.
    """
    goal = Goal() if goal is None else goal
    rng = generator(rng)
    require_count("stations", stations, 1, MOST_PLANNED)
    if workspace is not None:
        require_kind("workspace", workspace, Workspace)
    if not isinstance(calibration, Calibration | Mounts):
        from ..results.survey import SurveyCalibration  # which plans of beams do not need
        from .survey import plan_survey

        expected = "a Calibration, a SurveyCalibration, or Mounts"
        require_kind("calibration", calibration, SurveyCalibration, expected)
        if sensor is not None or plates is not None or placement is not None:
            raise InputError(
                "a sensor, plates or a placement for a survey",
                "none of them: its stations go by the readings and targets that it has",
            )
        return plan_survey(calibration, stations, workspace, goal, rng)
    if sensor is None:
        raise InputError("no sensor for beams before planes", "the Sensor that states their range")
    require_kind("sensor", sensor, Sensor)
    task = planning_task(calibration, sensor, workspace, goal, plates)
    if placement is None:
        return _chosen(task, stations, rng)
    put = _placed(task, placement, max(stations // placement.count, 1), rng)
    while True:
        found = _chosen(task._replace(belief=task.belief.before(put, only=True)), stations, rng)
        used = [plate for name, plate in put.items() if name in found.stations.plane_labels]
        if len(used) == len(put):
            return replace(found, plates=put)
        # All stations before fewer plates say more: nobody need put up the others.
        put = dict(zip(put, used, strict=False))


def _chosen(task: Task, stations: int, rng: np.random.Generator) -> Plan:
    """Return a plan of a number of stations, or of fewer where these reach the goal."""
    belief, goal = task.belief, task.goal
    pool = task.reachable(max(POOL // len(belief.plane_names), 2 * stations), rng)
    each = [station_rows(belief, pool)]
    for _ in range(COMPARED_DRAWS):
        try:
            each.append(station_rows(belief.about(belief.draw(rng)), pool))
        except (GrazingBeamError, InputError):  # so wide a posterior has draws that read nothing
            continue
    rows = np.stack(each)
    aim, count = task.aim, stations
    if goal.stated:  # how many are enough, before these are chosen with more care
        quick = aim.chosen(rows[:1], stations)
        count = aim.enough(rows[0, quick])
    while True:
        chosen = aim.chosen(rows, count, exchange=True)
        best = _refined(task, pool[chosen], rng)
        forecast = aim.forecast(station_rows(belief, best))
        if count == stations or forecast.reaches(goal) is not None:
            break
        # Those that serve other mounts as well say less at the most probable ones.
        count = min(count + max(1, count // 10), stations)
    best = best[: aim.enough(station_rows(belief, best))]
    return task.planned(best, without(pool, chosen))


def without(pool: Stations, chosen: IntArray) -> Stations:
    """Return the stations that were not chosen."""
    return pool[np.setdiff1d(np.arange(len(pool)), chosen)]


def _placed(
    task: Task, placement: Placement, count: int, rng: np.random.Generator
) -> Mapping[str, Plate]:
    """Return where to put the last plate, time after time, with a number of stations before each.

    Each orientation is the best beside those before, and another: they are fewer where none is left.

    Raises
    ------
    InputError
        No orientation lets the beams read it.
    """
    taken, last = task.belief.plane_names, task.belief.plates()[-1]
    names = [plane_name(index) for index in range(placement.count + len(taken))]
    put: dict[str, Plate] = {}
    for name in [name for name in names if name not in taken][: placement.count]:
        best = np.inf
        before = task.belief
        for plate in placement.orientations(last):
            if any(np.array_equal(plate.normal, other.normal) for other in put.values()):
                continue  # the same plate once more is one plane, with a label of its own for nothing
            belief = before.before({name: plate})
            plane, trial = len(belief.plane_names) - 1, task._replace(belief=belief)
            try:
                pool = trial.candidates(plane, POOL // 20, rng)
            except InputError:
                continue
            rows, aim = station_rows(belief, pool), trial.aim
            known, by_pose = aim.after(rows[aim.chosen(rows[None], count)])
            left = value(known, aim.weight, task.goal.criterion, by_pose)
            if left < best:
                best, put[name] = left, plate
                after = replace(belief, covariance=known)
                if belief.by_pose is not None:
                    after = replace(after, by_pose=belief.by_pose._replace(counted=by_pose))
        if name in put:
            task = task._replace(belief=after)
        elif put:
            break
        else:
            raise InputError(
                "no orientation of the plate in which every beam reads it safely",
                "a workspace that reaches the sensor's range, or beams that are known better",
            )
    return put


def _refined(task: Task, stations: Stations, rng: np.random.Generator) -> Stations:
    """Return as many stations near the given ones, or they themselves, that say more at the mean.

    What lies between the candidates that were drawn is tried.
    """
    belief, workspace, sensor = task.belief, task.workspace, task.sensor
    count, span = len(stations), sensor.range_max - sensor.range_min
    # Sizes of the moves by which chosen stations are refined, as parts of the largest turn and of
    # the sensor's range: about as far as candidates are apart, and then as those are.
    for size in (0.4, 0.15):
        # Moved copies of every station in each of these rounds: a few to either side of each
        # coordinate.
        near = stations[np.repeat(np.arange(count), 24)]
        turn = size * workspace.largest_turn * rng.standard_normal((len(near), 3))
        step = size * span * rng.standard_normal((len(near), 3))
        near = Stations(
            near.world_R_hand @ Rotation.from_rotvec(0.5 * turn).as_matrix(),
            near.world_t_hand + 0.5 * step,
            near.plane,
        )
        near = near[inside(workspace, near)]
        try:
            near = near[task.safe(near)]
            near = near[reached(workspace, near, belief.plates())]
        except (GrazingBeamError, InputError):  # a move too far; the next round moves less
            continue
        pool = joined([stations, near])
        rows = station_rows(belief, pool)[None]
        stations = pool[task.aim.chosen(rows, count, exchange=True, start=np.arange(count))]
    return stations
