"""What a plan starts from: what is known, where the hand may go, what the beams read, and the goal."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from .. import model
from ..arrays import BoolArray
from ..errors import InputError
from ..model.sensor_limits import Sensor
from ..quantities import FAR_SIGMAS
from ..results.calibration import Calibration
from ..results.mounts import Mounts
from ..validation.simulate import Stations
from .belief import Belief, belief_of
from .bounds import Plate
from .goal import Aim, Goal
from .information import outlook, station_rows
from .route import Plan, planned
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
        distance = self.goal.distance(self.sensor)
        return Aim(self.belief.covariance, self.belief.mounts(distance), self.goal, distance)

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
                tried = tried[np.arange(min(len(tried), count))]
                asked += len(tried)
            kept.append(tried[reached(workspace, tried, plates)])
            good += len(kept[-1])
        if good >= LEAST_CANDIDATES:
            return joined(kept)[np.arange(min(count, good))]
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
        plates: Mapping[str, Plate] | None = None,
        safe: float | None = None,
    ) -> Plan:
        """Return a plan of stations, which matter in the order given, or of `spare` ones instead.

        They are visited in another order, unless this one is to stay (`ordered`), with others between
        them where steps are long.

        Raises
        ------
        InputError
            The arm finds no way to any station, or not to all that are ordered.
        """
        belief, workspace = self.belief, self.workspace
        location, direction = self.goal.units
        candidates = stations
        if spare is not None and workspace.robot is not None:
            candidates = joined([stations, spare])
        plan, candidate = planned(
            self.aim,
            workspace,
            candidates,
            station_rows(belief, candidates),
            chosen=np.arange(len(stations)),
            labels=belief.plane_names,
            plates=belief.plates(),
            taken=self.taken,
            length=None if ordered else location / direction,
        )
        if plan.skipped and ordered:
            raise InputError(
                f"no way of the arm to {plan.skipped} of {len(stations)} stations of a first motion",
                "more room around the plate, or a smaller clearance",
            )
        read = candidate >= 0
        ranges, sigmas = (np.full((len(read), belief.beams), np.nan) for _ in range(2))
        ranges[read], sigmas[read], _, _ = outlook(belief, candidates[candidate[read]])
        return replace(
            plan,
            ranges=ranges,
            range_sigmas=sigmas,
            plates={} if plates is None else dict(plates),
            safe=safe,
            uncounted=belief.uncounted,
        )


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
