"""What a plan is for: goals, what stations make small, and what will be known after each."""

import math
from functools import partial

import numpy as np
import pytest

from handlaser_gtsam.errors import InputError
from handlaser_gtsam.model.sensor_limits import Sensor
from handlaser_gtsam.planning.choice import choose, updated
from handlaser_gtsam.planning.goal import Aim, Forecast, Goal, PlannedMount, goal_rows
from handlaser_gtsam.planning.route import planned, visited
from handlaser_gtsam.planning.workspace import Workspace
from handlaser_gtsam.results.limits import Limits
from handlaser_gtsam.results.spots import radius
from handlaser_gtsam.validation.simulate import Stations

UNKNOWNS = 7


def drawn(*shape, seed=0):
    return np.random.default_rng(seed).standard_normal(shape)


def mounts():
    """A beam, whose direction has two axes, and a sensor, which turns about each of three."""
    return [
        PlannedMount(
            drawn(3, UNKNOWNS, seed=1), drawn(1, 2, UNKNOWNS, seed=2), drawn(3, UNKNOWNS, seed=3)
        ),
        PlannedMount(
            drawn(3, UNKNOWNS, seed=4), drawn(3, 1, UNKNOWNS, seed=5), drawn(3, UNKNOWNS, seed=6)
        ),
    ]


def aim(goal, distance=0.2):
    root = drawn(UNKNOWNS, UNKNOWNS, seed=7)
    return Aim(root @ root.T, mounts(), goal, distance)


ROWS = drawn(6, 2, UNKNOWNS, seed=8)
"""Whitened rows of six stations, two readings each."""


# --- goals -------------------------------------------------------------------------------------------


def test_a_goal_counts_locations_and_directions_in_its_own_units():
    goal = Goal(location_sigma=2e-4, direction_sigma=3e-3)
    one, other = mounts()
    expected = (one.location / 2e-4, one.turns[0] / 3e-3, other.location / 2e-4)
    rows = goal_rows(goal, (one, other))
    assert rows.shape == (3 + 2 + 3 + 3, UNKNOWNS)
    assert np.array_equal(rows[:8], np.concatenate(expected))
    assert np.array_equal(rows[8:], other.turns[:, 0] / 3e-3)


def test_a_goal_of_spots_makes_nothing_else_small():
    one, other = mounts()
    rows = goal_rows(Goal("spot", location_sigma=1e-4), (one, other))
    assert np.array_equal(rows, np.concatenate((one.spot, other.spot)))


def test_a_goal_takes_limits_where_it_states_nothing():
    limits = Limits(location_sigma=1e-3, direction_sigma=2e-3)
    found = Goal(direction_sigma=5e-4).within(limits)
    assert (found.location_sigma, found.direction_sigma, found.spot) == (1e-3, 5e-4, None)
    assert not Goal().stated
    assert Goal(spot=1e-3).stated
    assert Goal().within(limits).stated


def test_a_working_distance_is_the_middle_of_the_range_where_none_is_stated():
    sensor = Sensor(range_min=0.1, range_max=0.4)
    assert Goal().distance(sensor) == pytest.approx(0.25)
    assert Goal(working_distance=0.3).distance(sensor) == 0.3
    assert Goal(working_distance=0.0).distance(sensor) == 0.0


@pytest.mark.parametrize("name", ["location_sigma", "direction_sigma", "spot"])
@pytest.mark.parametrize("value", [0.0, -1e-3, math.nan, math.inf])
def test_goals_that_are_none_are_refused(name, value):
    with pytest.raises(InputError, match=name):
        Goal(**{name: value})


# --- forecasts ---------------------------------------------------------------------------------------


def test_a_forecast_is_that_of_dense_inverses():
    """Of the information of each station added, the largest of both mounts counts."""
    at = aim(Goal())
    found = at.forecast(ROWS)
    assert len(found) == len(ROWS)
    for count in range(len(ROWS) + 1):
        told = ROWS[:count].reshape(-1, UNKNOWNS)
        C = np.linalg.inv(np.linalg.inv(at.covariance) + told.T @ told)
        location = [np.sqrt(np.diagonal(m.location @ C @ m.location.T)).max() for m in at.mounts]
        one, other = at.mounts
        turns = [math.sqrt(np.linalg.eigvalsh(one.turns[0] @ C @ one.turns[0].T)[-1])]
        turns += [math.sqrt(float((axis @ C @ axis.T)[0, 0])) for axis in other.turns]
        spots = [radius(m.spot @ C @ m.spot.T) for m in at.mounts]
        assert found.location_sigma[count] == pytest.approx(max(location), rel=1e-9)
        assert found.direction_sigma[count] == pytest.approx(max(turns), rel=1e-9)
        assert found.spot[count] == pytest.approx(max(spots), rel=1e-9)


def test_errors_that_change_with_the_pose_do_not_average_away():
    """A thousand times the same station: noise falls to nothing, and what they have in common stays."""
    (A, F), weak = (ROWS[0], drawn(2, 3, seed=9)), 1e-6 * np.eye(UNKNOWNS)
    P = np.linalg.inv(weak + A.T @ A)
    first = Aim(P, mounts(), Goal(), 0.2, A.T @ F)  # of one such station before
    found = first.forecast(np.tile(np.hstack((A, F)), (1000, 1, 1)))
    for count in (0, 1000):
        P = np.linalg.inv(weak + (count + 1) * A.T @ A)
        moved = P @ ((count + 1) * A.T @ F)
        C = P + moved @ moved.T
        location = max(np.diagonal(m.location @ C @ m.location.T).max() for m in mounts())
        assert found.location_sigma[count] == pytest.approx(math.sqrt(location), rel=1e-6)


FORECAST = Forecast(
    np.array([4.0, 3.0, 2.0, 1.0]),
    np.array([8.0, 2.0, 2.0, 2.0]),
    np.array([9.0, 9.0, 9.0, 3.0]),
    0.2,
)


@pytest.mark.parametrize(
    ("goal", "count"),
    [
        (Goal(), 0),
        (Goal(location_sigma=4.0), 0),  # a bound that is met exactly is reached
        (Goal(location_sigma=2.5), 2),
        (Goal(direction_sigma=2.0), 1),
        (Goal(location_sigma=3.0, direction_sigma=2.0), 1),
        (Goal(location_sigma=3.0, direction_sigma=2.0, spot=4.0), 3),
        (Goal(location_sigma=3.0, spot=2.9), None),
    ],
)
def test_a_goal_is_reached_where_everything_that_it_states_is(goal, count):
    assert FORECAST.reaches(goal) == count


def test_what_is_not_known_reaches_nothing():
    nothing = np.full(4, np.nan)
    assert Forecast(nothing, nothing, nothing, 0.2).reaches(Goal(spot=1.0)) is None


def test_enough_stations_are_those_that_reach_the_goal():
    sigmas = aim(Goal()).forecast(ROWS).location_sigma
    between = math.sqrt(sigmas[2] * sigmas[3])
    assert aim(Goal(location_sigma=between)).enough(ROWS) == 3
    assert aim(Goal(location_sigma=2.0 * sigmas[0])).enough(ROWS) == 1  # reached already: one
    assert aim(Goal(location_sigma=0.5 * sigmas[-1])).enough(ROWS) == len(ROWS)  # out of reach: all
    assert aim(Goal()).enough(ROWS) == len(ROWS)  # nothing is stated: all


@pytest.mark.parametrize("criterion", ["A", "D", "E", "spot"])
def test_stations_are_chosen_beside_those_that_are_there(criterion):
    # Of one mount: a criterion that counts a volume needs fewer coordinates than unknowns.
    at = Aim(aim(Goal()).covariance, mounts()[:1], Goal(criterion), 0.2)
    known = updated(at.covariance, ROWS[:2])
    expected = choose(
        ROWS[None, 2:], known, goal_rows(at.goal, at.mounts), 3, criterion, exchange=False
    )
    assert at.chosen(ROWS[None, 2:], 3, ROWS[:2]).tolist() == expected.tolist()


# --- the order of stations ---------------------------------------------------------------------------

ROOM = Workspace([-1.0] * 3, [1.0] * 3, np.eye(3))
ALONG = np.array([0.5, 0.1, 0.4, 0.2, 0.3])
"""Where stations lie on a line [m]: the short way from the first goes 0, 2, 4, 3, 1."""


def on_a_line(along, planes=None):
    t = np.stack((along, np.zeros_like(along), np.zeros_like(along)), axis=1)
    plane = np.zeros(len(along), np.intp) if planes is None else np.array(planes)
    return Stations(np.tile(np.eye(3), (len(along), 1, 1)), t, plane)


def test_stations_are_visited_on_a_short_way_or_as_they_are():
    stations = on_a_line(ALONG)
    way, origin = visited(ROOM, stations, labels=["A"], plates=[None], length=0.1)
    assert origin.tolist() == [0, 2, 4, 3, 1]
    assert way.world_t_hand[:, 0].tolist() == [0.5, 0.4, 0.3, 0.2, 0.1]
    _, origin = visited(ROOM, stations, labels=["A"], plates=[None])
    assert origin.tolist() == [0, 1, 2, 3, 4]


def test_one_plane_is_done_before_the_next():
    stations = on_a_line(np.array([0.1, 0.3, 0.2, 0.4]), [1, 0, 1, 0])
    way, origin = visited(ROOM, stations, labels=["A", "B"], plates=[None, None], length=0.1)
    assert way.plane_labels == ("A", "A", "B", "B")
    assert origin.tolist() == [1, 3, 2, 0]


def test_new_stations_have_names_that_nobody_has():
    stepping = Workspace([-1.0] * 3, [1.0] * 3, np.eye(3), largest_step=0.11)
    stations = on_a_line(np.array([0.1, 0.3, 0.4]))
    taken = ("1", "4", "via 1")
    way, origin = visited(stepping, stations, labels=["A"], plates=[None], taken=taken, length=0.1)
    assert way.station_names == ("5", "via 2", "6", "7")
    assert origin.tolist() == [0, -1, 1, 2]


def test_a_plan_is_driven_on_a_short_way_and_forecast_by_what_matters():
    """The forecast counts stations as they were chosen, wherever the way has them."""
    stations = on_a_line(ALONG)
    rows, at = ROWS[: len(ALONG)], aim(Goal())
    chosen = np.array([3, 0, 4])
    visit = partial(visited, ROOM, labels=["A"], plates=[None], length=0.1)
    plan, candidate = planned(at, stations, rows, chosen, visit)
    assert candidate.tolist() == [3, 4, 0]
    assert plan.stations.world_t_hand[:, 0].tolist() == [0.2, 0.3, 0.5]
    assert np.array_equal(plan.forecast.spot, at.forecast(rows[chosen]).spot)
    assert not np.array_equal(plan.forecast.spot, at.forecast(rows[candidate]).spot)
    assert (plan.reached, plan.skipped) == (None, 0)
    goal = Goal(spot=float(plan.forecast.spot[2]))
    plan, _ = planned(aim(goal), stations, rows, chosen, visit)
    assert plan.reached == 2
