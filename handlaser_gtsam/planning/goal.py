"""What a plan is for, and when it is reached."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from ..arrays import FloatArray, IntArray
from ..checks import require_fields, require_word
from ..data.value import Value
from ..model.sensor_limits import Sensor
from ..quantities import IN_DEG, IN_MM, LARGEST_LENGTH
from ..results.limits import Limits
from ..results.spots import radius
from .choice import CRITERIA, Criterion, choose, updates

DIRECTION_UNIT = math.radians(0.1)
"""[rad]"""


class PlannedMount(NamedTuple):
    """Derivatives by all U unknowns of what a goal asks of one beam or sensor.

    Attributes
    ----------
    location : (3, U)
        [m]
    turns : (T, a, U)
        Of a direction in its tangent plane (1, 2, U), or of a sensor about each of its axes (3, 1, U):
        the largest standard deviation along any of the a axes counts, of all T [rad].
    spot : (3, U)
        Of the laser spot at the working distance [m].
    """

    location: FloatArray
    turns: FloatArray
    spot: FloatArray


@dataclass(frozen=True, slots=True)
class Goal:
    """What to plan for.

    Attributes
    ----------
    criterion : str
        "A": the sum of the variances of locations and directions in units of the goal; "D": the
        volume of their confidence region; "E": the direction that is known least; "spot": the laser
        spots at the working distance.
    location_sigma, direction_sigma : float, optional
        Standard deviations of every beam that are to be reached: of a coordinate of the location
        [m], and of the direction along any tangent [rad].
    spot : float, optional
        Radius around every laser spot that is to hold it with 95 % [m].
    working_distance : float, optional
        A reading [m]; the middle of the sensor's range where not given.

    Raises
    ------
    InputError
        An unknown criterion, or numbers beyond sense.
    """

    criterion: Criterion = "A"
    location_sigma: float | None = None
    direction_sigma: float | None = None
    spot: float | None = None
    working_distance: float | None = None

    def __post_init__(self) -> None:
        require_word("criterion", self.criterion, CRITERIA)
        require_fields(self, "location_sigma", "direction_sigma", "spot", above=True)
        require_fields(self, "working_distance", least=-LARGEST_LENGTH, unit="m")

    @property
    def stated(self) -> bool:
        """Whether there is anything to reach."""
        return any(x is not None for x in (self.location_sigma, self.direction_sigma, self.spot))

    @property
    def units(self) -> tuple[float, float]:
        """What of a location [m] and of a direction [rad] counts as much."""
        # A location that is known to this counts as much as a direction known to `DIRECTION_UNIT`,
        # where no goal is stated [m]: a tenth of a millimetre.
        return self.location_sigma or 1e-4, self.direction_sigma or DIRECTION_UNIT

    def distance(self, sensor: Sensor) -> float:
        """Return the working distance [m]."""
        if self.working_distance is not None:
            return self.working_distance
        return 0.5 * (sensor.range_min + sensor.range_max)

    def within(self, limits: Limits) -> "Goal":
        """Return the goal with the limits of a rig file where it states none."""
        return replace(
            self,
            location_sigma=self.location_sigma or limits.location_sigma,
            direction_sigma=self.direction_sigma or limits.direction_sigma,
        )


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Forecast(Value):
    """What will be known after each further station: the largest of all beams.

    The stations count in the order in which they matter, which is not the order of the way.

    Attributes
    ----------
    location_sigma : (M + 1,)
        Of a coordinate [m], before the first station and after each.
    direction_sigma : (M + 1,)
        Along any tangent [rad].
    spot : (M + 1,)
        Radius that holds the laser spot with 95 % [m].
    working_distance : float
        The reading of that spot [m].
    """

    location_sigma: FloatArray
    direction_sigma: FloatArray
    spot: FloatArray
    working_distance: float

    def __len__(self) -> int:
        """Return how many stations there are."""
        return len(self.location_sigma) - 1

    def reaches(self, goal: Goal) -> int | None:
        """Return the least number of stations that reaches a goal; None where all do not.

        Zero stations reach a goal that states nothing.
        """
        pairs = (
            (self.location_sigma, goal.location_sigma),
            (self.direction_sigma, goal.direction_sigma),
            (self.spot, goal.spot),
        )
        asked = [values <= most for values, most in pairs if most is not None]
        good = np.all(asked, axis=0) if asked else np.ones(len(self.spot), dtype=bool)
        return int(good.argmax()) if good.any() else None

    def words(self, stations: int) -> str:
        """Return what is known after a number of stations, in words."""
        return (
            f"location {self.location_sigma[stations] * IN_MM:.2g} mm, "
            f"direction {self.direction_sigma[stations] * IN_DEG:.2g} deg, "
            f"spot within {self.spot[stations] * IN_MM:.2g} mm"
        )


def goal_rows(goal: Goal, mounts: Sequence[PlannedMount]) -> FloatArray:
    """Return what is to become small (W, U): mounts in units of the goal, or their spots [m]."""
    if goal.criterion == "spot":
        return np.concatenate([mount.spot for mount in mounts])
    location, turn = goal.units
    parts = [(m.location / location, np.concatenate(m.turns) / turn) for m in mounts]
    return np.concatenate([part for pair in parts for part in pair])


class Aim:
    """What is known before the next stations, and what these are to make small.

    Attributes
    ----------
    covariance : (U, U)
        Of all unknowns, before the first station.
    mounts : sequence of PlannedMount
        Of all beams and sensors that count.
    goal : Goal
    distance : float
        The working distance [m]; NaN where each beam and sensor has its own.
    weight : (W, U)
        What is to become small; see `goal_rows`.
    by_pose : (U, c)
        What c errors of the hand that change with its pose add to that, none where not given: G of
        `choice`. Rows of stations have their effect, of unit variance, in c columns at the end.
    """

    def __init__(
        self,
        covariance: FloatArray,
        mounts: Sequence[PlannedMount],
        goal: Goal,
        distance: float,
        by_pose: FloatArray | None = None,
    ) -> None:
        self.covariance, self.mounts = covariance, mounts
        self.goal, self.distance = goal, distance
        self.weight = goal_rows(goal, mounts)
        self.by_pose = np.zeros((len(covariance), 0)) if by_pose is None else by_pose

    def chosen(
        self,
        rows: FloatArray,
        count: int,
        beside: Iterable[FloatArray] = (),
        *,
        exchange: bool = False,
        start: IntArray | None = None,
    ) -> IntArray:
        """Choose among candidates given by rows (K, N, B, U + c), at the mean and at draws.

        See `choose`; `beside` are the rows (M, B, U + c) of stations that are chosen already.
        """
        known, by_pose = self.after(beside)
        return choose(
            rows,
            known,
            self.weight,
            count,
            self.goal.criterion,
            by_pose=by_pose,
            exchange=exchange,
            start=start,
        )

    def after(self, rows: Iterable[FloatArray]) -> tuple[FloatArray, FloatArray]:
        """Return the covariance (U, U) and `by_pose` after stations given by rows (M, B, U + c)."""
        *_, last = updates(self.covariance, self.by_pose, rows)
        return last

    def forecast(self, rows: FloatArray) -> Forecast:
        """Return what will be known after each of some stations, given by rows (M, B, U + c)."""
        sigmas = []
        for P, G in updates(self.covariance, self.by_pose, rows):
            moved = P @ G
            C = P + moved @ moved.T
            location = max(np.diagonal(m.location @ C @ m.location.T).max() for m in self.mounts)
            turns = (m.turns @ C @ np.swapaxes(m.turns, 1, 2) for m in self.mounts)
            direction = max(np.linalg.eigvalsh(turn).max() for turn in turns)
            spot = max(radius(m.spot @ C @ m.spot.T) for m in self.mounts)
            sigmas.append((math.sqrt(location), math.sqrt(direction), spot))
        location, direction, spot = np.array(sigmas).T
        return Forecast(location, direction, spot, self.distance)

    def enough(self, rows: FloatArray) -> int:
        """Return how many of some stations reach the goal, at least one; all where they do not.

        All, too, where the goal states nothing. The stations are given by rows (M, B, U + c).
        """
        least = self.forecast(rows).reaches(self.goal) if self.goal.stated else None
        return len(rows) if least is None else max(least, 1)
