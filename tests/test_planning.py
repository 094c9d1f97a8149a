"""Plans: predictions, choice, margins and the first motion, each against a second way to the same."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from helpers import first_and_slow
from scipy.spatial.transform import Rotation

import handlaser_gtsam as hl
from benchmarks.arm_errors import STOPS, Case, Scene
from benchmarks.planned_cell import ERR, SENSOR, cell, errors_of
from benchmarks.planned_loop import loop
from handlaser_gtsam import model
from handlaser_gtsam.model.damped_search import LevenbergOptions
from handlaser_gtsam.model.families import BEAM
from handlaser_gtsam.observability.motion import check_motion
from handlaser_gtsam.planning.advice import missing_stations
from handlaser_gtsam.planning.belief import belief_of, outlook, station_rows, transported
from handlaser_gtsam.planning.blind import completing_motion
from handlaser_gtsam.planning.choice import choose, updated, value
from handlaser_gtsam.planning.goal import goal_rows
from handlaser_gtsam.planning.plan import Task, planning_task
from handlaser_gtsam.planning.route import divided, shortest
from handlaser_gtsam.planning.workspace import inside, joined
from handlaser_gtsam.results.mounts import Mounts
from handlaser_gtsam.results.spots import spot
from handlaser_gtsam.validation.scenes import SCENES, Layout
from handlaser_gtsam.validation.simulate import Stations, simulate

NOISE = ERR.stated()
RANGE_ERRORS = hl.CalibrationOptions("k1", sensor=SENSOR)
WORKSPACE = hl.planning.Workspace([0.5, 0.0, 0.25], [0.7, 0.2, 0.5], np.eye(3), math.radians(25.0))


@pytest.fixture(scope="module")
def recorded():
    rng = np.random.default_rng(3)
    truth, stations = SCENES["paper"](Layout(planes=2, k1=0.01), rng)
    recording = simulate(truth, stations, ERR, rng, SENSOR)
    return truth, recording, hl.calibrate(recording, NOISE, RANGE_ERRORS)


@pytest.fixture(scope="module")
def belief(recorded):
    return belief_of(recorded[2])


def before(belief):
    return Task(belief, WORKSPACE, SENSOR, hl.planning.Goal())


@pytest.fixture(scope="module")
def pool(belief):
    rng = np.random.default_rng(0)
    return joined([before(belief).candidates(p, 60, rng) for p in (0, 1)])


# --- what stations would tell ------------------------------------------------------------------------


def reading(at, R, t, plane, beam):
    """The range of one beam at one pose, written down once more."""
    n, b = R.T @ at.normals[plane], at.offsets[plane] + at.normals[plane] @ t
    return -(n @ at.locations[beam] + b) / (n @ at.directions[beam])


def residual(belief, x, stations, j, beam, d, twist):
    """The residual of a reading d, for unknowns and a hand pose that are moved."""
    at = belief.moved(x)
    R = stations.world_R_hand[j] @ Rotation.from_rotvec(twist[:3]).as_matrix()
    t = stations.world_t_hand[j] + stations.world_R_hand[j] @ twist[3:]
    k = at.range_errors[beam]
    return reading(at, R, t, stations.plane[j], beam) - d * (1.0 + k[0] + k[1] * d)


def dense_information(belief, stations):
    """The information of all stations, from central differences and a dense covariance each."""
    unknowns = len(belief.covariance)
    total, S = np.zeros((unknowns, unknowns)), belief.variances.pose[0]
    ahead, _, _, _ = outlook(belief, stations)
    step = 1e-6
    for j in range(len(stations.plane)):
        J, P = np.zeros((belief.beams, unknowns)), np.zeros((belief.beams, 6))
        for beam in range(belief.beams):
            d = ahead[j, beam]
            for axis in range(unknowns + 6):
                e = np.zeros(unknowns + 6)
                e[axis] = step
                high, low = (
                    residual(belief, s[:unknowns], stations, j, beam, d, s[unknowns:])
                    for s in (e, -e)
                )
                slope = (high - low) / (2.0 * step)
                if axis < unknowns:
                    J[beam, axis] = slope
                else:
                    P[beam, axis - unknowns] = slope
        k = belief.mean.range_errors
        own = belief.variances.range_sigma * (1.0 + k[:, 0] + 2.0 * k[:, 1] * ahead[j])
        total += J.T @ np.linalg.solve(np.diag(own**2) + P @ S @ P.T, J)
    return total


def test_predicted_covariances_are_those_of_dense_differences(belief, pool):
    """Information adds up: inv(inv(C) + J' inv(C_e) J) with numeric Jacobians, by another path."""
    chosen = Stations(pool.world_R_hand[::24], pool.world_t_hand[::24], pool.plane[::24])
    used = np.flatnonzero(np.diagonal(belief.covariance) > 0.0)
    assert len(used) == len(belief.covariance) - belief.beams  # k2 is not modelled
    C = updated(belief.covariance, station_rows(belief, chosen))
    at = np.ix_(used, used)
    scale = np.sqrt(np.diagonal(belief.covariance)[used])
    prior = np.linalg.inv(belief.covariance[at] / np.outer(scale, scale))
    more = dense_information(belief, chosen)[at] * np.outer(scale, scale)
    dense = np.linalg.inv(prior + more)
    # Central differences at 1e-6 err by rounding, 1e-10 of a reading; correlations multiply that.
    assert np.allclose(C[at] / np.outer(scale, scale), dense, atol=1e-5)


def test_the_belief_is_the_covariance_of_the_calibration(recorded, belief):
    joint = recorded[2].covariance
    for i, name in enumerate(joint.beam_names):
        own = belief.covariance[BEAM.dim * i : BEAM.dim * i + 3, BEAM.dim * i : BEAM.dim * i + 3]
        assert np.allclose(own, joint.matrix([name], [])[:3, :3], rtol=1e-12)
    mounts = belief_of(Mounts.of(recorded[2]))
    count = belief.first_plane
    # Other tangent bases: what does not depend on them is equal.
    for i in range(belief.beams):
        at = BEAM.dim * i + np.arange(3, 5)
        both = [np.linalg.eigvalsh(x.covariance[np.ix_(at, at)]) for x in (belief, mounts)]
        assert np.allclose(*both, rtol=1e-9)
    assert mounts.covariance.shape == (count, count)


def test_bases_move_with_their_directions():
    rng = np.random.default_rng(0)
    v = model.normalized(rng.standard_normal((50, 3)))
    near = model.normalized(v + 0.01 * rng.standard_normal((50, 3)))
    moved = transported(model.tangent_basis(v), near)
    assert np.allclose(np.einsum("nij,nik->njk", moved, moved), np.eye(2))
    assert np.allclose(np.einsum("ni,nij->nj", near, moved), 0.0, atol=1e-15)
    assert np.abs(moved - model.tangent_basis(v)).max() < 0.1


def test_the_spot_is_that_of_the_results(recorded, belief):
    rows = np.concatenate([mount.spot for mount in belief.mounts(0.02)])
    C = (rows @ belief.covariance @ rows.T)[:3, :3]
    found = spot(recorded[2], "1", 0.02)
    v = belief.mean.directions[0]
    assert math.sqrt(v @ C @ v) == pytest.approx(found.along, rel=1e-6)


# --- choice ------------------------------------------------------------------------------------------


def tiny(seed, candidates=7, unknowns=4):
    rng = np.random.default_rng(seed)
    rows = rng.standard_normal((1, candidates, 2, unknowns))
    return rows, np.eye(unknowns), rng.standard_normal((3, unknowns))


def after(rows, C, indices):
    return updated(C, rows[0, list(indices)])


@pytest.mark.parametrize("criterion", ["A", "D", "E"])
def test_the_first_station_is_the_best_of_all(criterion):
    for seed in range(10):
        rows, C, weight = tiny(seed)
        candidates = choose(rows, C, weight, 1, criterion)
        chosen = value(after(rows, C, candidates), weight, criterion)
        every = [value(after(rows, C, [i]), weight, criterion) for i in range(rows.shape[1])]
        if criterion == "E":  # chosen by a smooth norm of all eigenvalues: nearly the best
            assert chosen <= min(every) + 0.15 * abs(min(every))
        else:
            assert candidates[0] == int(np.argmin(every))


def test_exchange_finds_the_best_subset_of_tiny_problems():
    """Of 35 subsets of three it is nearly always the best one, and no single exchange betters it."""
    exact = 0
    for seed in range(20):
        rows, C, weight = tiny(seed)
        candidates = choose(rows, C, weight, 3)
        left = {
            one: value(after(rows, C, one), weight, "A")
            for one in itertools.combinations(range(rows.shape[1]), 3)
        }
        chosen = set(candidates.tolist())
        near = [left[one] for one in left if len(chosen & set(one)) == 2]
        assert left[tuple(sorted(chosen))] <= min(near) * (1.0 + 1e-9)
        exact += left[tuple(sorted(chosen))] <= min(left.values()) * (1.0 + 1e-9)
    assert exact >= 17


def test_each_further_station_is_the_best_beside_those_before():
    """Of ten chosen ones, which went through exchanges up and down, by covariances from nothing."""
    rows, C, weight = tiny(1, candidates=30, unknowns=8)
    candidates = choose(rows, C, weight, 10)
    assert len(set(candidates.tolist())) == 10
    for step in range(10):
        before, left = candidates[:step], candidates[step:]
        every = [value(after(rows, C, [*before, one]), weight, "A") for one in left]
        assert int(np.argmin(every)) == 0


@pytest.mark.parametrize("criterion", ["A", "D", "E"])
def test_errors_that_change_with_the_pose_count_in_the_choice(criterion):
    """By what an estimate that knows nothing of them is off, from dense inverses."""
    for seed in range(10):
        rows, C, weight = tiny(seed, candidates=9, unknowns=6)
        A, F = rows[0, ..., :4], rows[0, ..., 4:]
        C, weight, G = C[:4, :4], weight[:, :4], np.ones((4, 2))

        def left(of, A=A, F=F, C=C, weight=weight, G=G):
            A, F = (np.concatenate(x[list(of)]) for x in (A, F))
            P = np.linalg.inv(np.linalg.inv(C) + A.T @ A)
            K = np.hstack((P @ A.T, P @ (G + A.T @ F)))
            noise = K @ K.T + P @ np.linalg.inv(C) @ P
            S = weight @ noise @ weight.T
            return {"A": np.trace(S), "D": np.linalg.slogdet(S)[1], "E": np.linalg.eigvalsh(S)[-1]}[
                criterion
            ]

        chosen = choose(rows, C, weight, 3, criterion, by_pose=G)
        first = [left([one]) for one in chosen]
        assert first[0] == pytest.approx(min(first))
        swapped = [
            left({*chosen, new} - {old}) for old in chosen for new in {*range(9)} - {*chosen}
        ]
        assert left(chosen) <= min(swapped) + 1e-3 * abs(min(swapped))


@pytest.mark.parametrize("seed", [100, 101])
def test_what_is_promised_on_an_arm_that_errs_is_what_comes(seed):
    """Of the stations that follow; if errors of the arm averaged away, it would be less."""
    scene = Scene(Case("beams", False, True), seed)
    whole = scene.recording()
    before = np.arange(len(scene.plate)) % STOPS < STOPS // 2
    goal, sensor = hl.planning.Goal(working_distance=0.55), hl.Sensor(range_min=0.1, range_max=1.0)

    def task(calibration):
        return planning_task(calibration, sensor, None, goal)

    first = task(hl.calibrate(whole.part(before), scene.noise))
    poses = whole.world_R_hand[~before], whole.world_t_hand[~before]
    rows = station_rows(first.belief, Stations(*poses, scene.plate[~before]))
    came = task(hl.calibrate(whole, scene.noise)).aim.forecast(rows[:0]).spot[0]
    assert first.aim.forecast(rows).spot[-1] == pytest.approx(came, rel=0.05)
    averaged = rows.copy()
    averaged[..., len(first.belief.covariance) :] = 0.0
    assert first.aim.forecast(averaged).spot[-1] < 0.92 * came


def test_planned_stations_beat_random_ones(belief, pool):
    goal, rng = hl.planning.Goal(), np.random.default_rng(0)
    rows = station_rows(belief, pool)
    weight = goal_rows(goal, belief.mounts(0.015))
    chosen = choose(rows[None], belief.covariance, weight, 8)
    drawn = [
        value(after(rows[None], belief.covariance, rng.choice(120, 8, False)), weight, "A")
        for _ in range(20)
    ]
    assert value(after(rows[None], belief.covariance, chosen), weight, "A") < min(drawn)


# --- margins -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("count", first_and_slow(40, 400))
def test_no_reading_leaves_the_limits_for_nearly_all_truths(belief, pool, count):
    """Monte Carlo over the posterior and the noise of the robot, against the linear margins."""
    rng, sensor = np.random.default_rng(1), SENSOR
    assert before(belief).safe(pool).all()
    assert inside(WORKSPACE, pool).all()
    unsafe = 0
    for _ in range(count):
        truth = belief.draw(rng)
        read = simulate(truth, pool, ERR, rng, sensor)
        unsafe += int(np.isnan(read.ranges).any())
    # 120 stations at once, four sigmas each: 3e-5 a side and reading, an upper bound of 3 %.
    assert unsafe <= max(2, 0.03 * count)


def test_the_spread_of_readings_is_that_of_draws(belief, pool):
    rng = np.random.default_rng(2)
    few = Stations(pool.world_R_hand[::30], pool.world_t_hand[::30], pool.plane[::30])
    _, sigmas, _, _ = outlook(belief, few)
    read = np.stack([simulate(belief.draw(rng), few, ERR, rng).ranges for _ in range(400)])
    ratio = read.std(axis=0) / sigmas
    # The standard deviation of 400 draws is known to 3.5 %; 16 readings are compared.
    assert np.abs(ratio - 1.0).max() < 0.12


# --- plans -------------------------------------------------------------------------------------------


def test_a_plan_predicts_the_calibration_that_follows(recorded):
    truth, recording, first = recorded
    plan = hl.plan(first, 12, SENSOR, WORKSPACE)
    names = recording.plane_names
    index = np.array([names.index(label) for label in plan.stations.plane_labels])
    at = Stations(plan.stations.world_R_hand, plan.stations.world_t_hand, index)
    rng = np.random.default_rng(5)
    read = simulate(truth, at, ERR, rng, SENSOR)
    assert not np.isnan(read.ranges).any()
    error = (read.ranges - plan.ranges) / plan.range_sigmas
    assert np.abs(error).max() < 5.0
    more = plan.stations.recording(read.ranges, recording.beam_names)
    found = hl.calibrate(hl.join([recording, more]), NOISE, RANGE_ERRORS)
    largest = max(beam.direction_sigma for beam in found.beams.values())
    assert plan.forecast.direction_sigma[-1] == pytest.approx(largest, rel=0.1)
    location = max(beam.sigma[:3].max() for beam in found.beams.values())
    assert plan.forecast.location_sigma[-1] == pytest.approx(location, rel=0.1)


@pytest.mark.parametrize("degrees", [0.25, 0.28])
def test_a_plan_stops_where_the_goal_is_met(recorded, degrees):
    """It stopped before the second goal: those that seemed enough at a glance were not."""
    _, _, first = recorded
    goal = hl.planning.Goal(direction_sigma=math.radians(degrees))
    plan = hl.plan(first, 40, SENSOR, WORKSPACE, goal)
    assert plan.reached == len(plan) < 40
    assert plan.forecast.direction_sigma[-1] <= goal.direction_sigma
    assert plan.forecast.direction_sigma[-2] > goal.direction_sigma
    assert hl.plan(first, 1, SENSOR, WORKSPACE, goal).reached is None


@pytest.mark.parametrize("criterion", ["A", "D", "E", "spot"])
def test_every_criterion_gives_a_plan(recorded, criterion):
    plan = hl.plan(recorded[2], 5, SENSOR, WORKSPACE, hl.planning.Goal(criterion))
    assert len(plan) == 5
    assert plan.forecast.spot[-1] < plan.forecast.spot[0]


@pytest.mark.slow
def test_the_plate_put_anew_is_turned_where_that_tells_more(recorded):
    placement = hl.planning.Placement(2, largest_tilt=math.radians(20.0))
    plan = hl.plan(recorded[2], 8, SENSOR, WORKSPACE, placement=placement)
    assert set(plan.plates) == {"C", "D"}  # A and B are taken
    assert set(plan.stations.plane_labels) <= set(plan.plates)
    for plate in plan.plates.values():
        first = recorded[2].planes["B"].normal
        assert math.acos(min(plate.normal @ first, 1.0)) <= placement.largest_tilt + 1e-9


@pytest.mark.slow
@pytest.mark.parametrize(("stations", "tilt"), [(1, 20.0), (3, 20.0), (6, 0.0)])
def test_no_plate_is_put_up_in_vain_or_twice_in_one_place(recorded, stations, tilt):
    """A single station has one plate; a plate that is not to be tilted has one place."""
    placement = hl.planning.Placement(3, largest_tilt=math.radians(tilt))
    plan = hl.plan(recorded[2], stations, SENSOR, WORKSPACE, placement=placement)
    assert set(plan.plates) == set(plan.stations.plane_labels)
    normals = {tuple(plate.normal) for plate in plan.plates.values()}
    assert len(normals) == len(plan.plates) <= min(stations, 3 if tilt else 1)


@pytest.mark.slow
def test_a_calibration_without_a_covariance_is_no_guide(recorded):
    _, recording, _ = recorded
    stopped = replace(RANGE_ERRORS, solver=LevenbergOptions(max_iterations=1))
    few = hl.calibrate(recording, NOISE, stopped)
    assert few.status == "not_converged"
    with pytest.raises(hl.InputError, match="plan without a calibration"):
        hl.plan(few, 5, SENSOR, WORKSPACE)


@pytest.mark.parametrize(
    "arguments",
    [
        ("a file", 5, SENSOR),
        (None, 5, SENSOR),
        (None, 0, SENSOR),
        (None, 5, "sensor"),
        (None, 5, None),
    ],
)
def test_what_is_no_basis_is_refused_in_one_line(recorded, arguments):
    calibration = recorded[2] if arguments[1:] != (5, SENSOR) else arguments[0]
    with pytest.raises(hl.InputError) as caught:
        hl.plan(calibration, *arguments[1:])
    assert "\n" not in str(caught.value)


def test_a_sensor_without_a_range_is_no_basis(recorded):
    with pytest.raises(hl.InputError, match="range_mm"):
        hl.plan(recorded[2], 5, hl.Sensor(), WORKSPACE)


def test_planes_out_of_reach_are_passed_over(recorded):
    _, _, first = recorded
    n, b = first.planes["A"].normal, first.planes["A"].offset
    foot = np.array([0.6, 0.1, 0.4])
    foot = foot - (n @ foot + b) * n
    far = {"far": hl.planning.Plate(foot + 5.0 * n, n)}
    plan = hl.plan(first, 4, SENSOR, WORKSPACE, plates=far)
    assert set(plan.stations.plane_labels) <= {"A", "B"}
    assert not plan.plates  # a person need not put what stands


def test_a_workspace_out_of_reach_is_said(recorded):
    far = hl.planning.Workspace([2.0, 2.0, 2.0], [2.1, 2.1, 2.1], np.eye(3))
    with pytest.raises(hl.InputError, match="no station before plane A"):
        hl.plan(recorded[2], 5, SENSOR, far)


def test_a_home_that_looks_away_is_named(recorded):
    """The default home is that of a hand that looks up; most hands look down."""
    turned = replace(WORKSPACE, home=WORKSPACE.home @ np.diag([1.0, -1.0, -1.0]))
    with pytest.raises(
        hl.InputError,
        match=r"plane A .*home_quaternion \[1, 0, 0, 0\]; .*qx, qy, qz, qw of a hand that faces",
    ):
        hl.plan(recorded[2], 5, SENSOR, turned)


# --- the way -----------------------------------------------------------------------------------------


def way(stations, order, length):
    """The length of a way, a turn by one radian counted as a move by a length."""
    t, R = stations.world_t_hand[order], Rotation.from_matrix(stations.world_R_hand[order])
    turns = (R[:-1].inv() * R[1:]).magnitude()
    return np.linalg.norm(np.diff(t, axis=0), axis=1).sum() + length * turns.sum()


def test_the_way_is_the_shortest_of_tiny_problems(pool):
    few = Stations(pool.world_R_hand[:6], pool.world_t_hand[:6], pool.plane[:6])
    order = shortest(few, 0.05)
    assert sorted(order.tolist()) == list(range(6))
    every = [
        way(few, np.array((order[0], *rest)), 0.05)
        for rest in itertools.permutations(sorted(set(range(6)) - {int(order[0])}))
    ]
    assert way(few, order, 0.05) <= 1.15 * min(every)


def test_long_steps_are_divided(pool):
    few = Stations(pool.world_R_hand[:5], pool.world_t_hand[:5], pool.plane[:5])
    found, origin = divided(few, 0.01)
    steps = np.linalg.norm(np.diff(found.world_t_hand, axis=0), axis=1)
    assert steps.max() <= 0.01 + 1e-12
    assert origin[origin >= 0].tolist() == [0, 1, 2, 3, 4]
    assert np.allclose(found.world_t_hand[origin >= 0], few.world_t_hand)
    assert inside(WORKSPACE, found).all()


# --- the first motion --------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_first_motion_satisfies_the_lemmas_and_is_safe():
    """A hundred mounts from the bounds stay within the limits; the first ten are calibrated."""
    here = cell(np.random.default_rng(4), 1)
    plan = hl.planning.blind_motion(here.bounds, SENSOR, here.workspace, here.noise)
    assert plan.safe >= 0.99
    rng = np.random.default_rng(8)
    outside = 0
    for number in range(100):
        drawn = replace(here, truth=here.bounds.draw(rng))
        read = drawn.measured(plan, rng)
        outside += int(np.isnan(read.ranges).any())
        if number >= 10:
            continue
        found = hl.calibrate(read, here.noise, hl.CalibrationOptions(sensor=SENSOR))
        assert found.status == "converged"
    assert outside <= 3
    check = check_motion(read)
    (plane,) = check.planes
    assert plane.translations == 3  # Lemma 1
    assert plane.axes >= 2  # Lemma 2
    assert not check.undetermined


@pytest.mark.slow
def test_all_spots_of_a_first_motion_lie_on_the_plate():
    """Met by rays of its own, for mounts at the edges of the bounds."""
    here = cell(np.random.default_rng(4), 1)
    free = hl.planning.blind_motion(here.bounds, SENSOR, here.workspace, here.noise)
    across = 0.8 * free.plate_across
    bounds = replace(here.bounds, plate=replace(here.bounds.plate, across=across))
    plan = hl.planning.blind_motion(bounds, SENSOR, here.workspace, here.noise)
    assert plan.plate_across <= across + 2.0 * bounds.plate.within
    rng, point = np.random.default_rng(8), bounds.plate.point
    farthest = {"free": 0.0, "stated": 0.0}
    for name, motion in (("free", free), ("stated", plan)):
        R, t = motion.stations.world_R_hand, motion.stations.world_t_hand
        for _ in range(50):
            mount = bounds.draw(rng)
            for r, v in zip(mount.locations, mount.directions, strict=True):
                o, u = R @ r + t, R @ v
                s = -(o @ mount.normals[0] + mount.offsets[0]) / (u @ mount.normals[0])
                spots = o + s[:, None] * u
                off = float(np.linalg.norm(spots - point, axis=1).max())
                farthest[name] = max(farthest[name], off)
    assert farthest["stated"] <= 0.52 * across < farthest["free"]
    small = replace(here.bounds, plate=replace(here.bounds.plate, across=1e-3))
    with pytest.raises(hl.InputError, match="a larger plate"):
        hl.planning.blind_motion(small, SENSOR, here.workspace, here.noise)


def test_a_box_in_another_unit_is_told_from_a_plate_that_cannot_be_reached():
    here = cell(np.random.default_rng(4), 1)
    low, high = 1e-3 * here.workspace.low, 1e-3 * here.workspace.high
    away = hl.planning.Workspace(low, high, here.workspace.home)
    with pytest.raises(hl.InputError, match="a box of the workspace away from"):
        hl.planning.blind_motion(here.bounds, SENSOR, away, here.noise)


@pytest.mark.slow
@pytest.mark.parametrize("taken", [4, 6])
def test_what_a_first_motion_still_lacks_is_found(taken):
    """A first motion that was broken off, and mounts drawn from the bounds."""
    rng = np.random.default_rng(taken)
    here = cell(rng, 1)
    motion = hl.planning.blind_motion(here.bounds, SENSOR, here.workspace, here.noise)
    begun = here.measured(motion, rng).part(np.arange(taken))
    options = hl.CalibrationOptions(sensor=SENSOR)
    assert hl.calibrate(begun, here.noise, options).status == "unobservable"
    plan = missing_stations(begun, here.bounds, SENSOR, here.workspace, here.noise)
    assert 3 <= len(plan) <= 12
    assert not set(plan.stations.station_names) & set(begun.station_names)
    more = here.measured(plan, rng, first=taken)
    assert not np.isnan(more.ranges).any()
    found = hl.calibrate(hl.join([begun, more]), here.noise, options)
    assert found.status == "converged"
    whole = errors_of(found, here.truth)
    assert math.sqrt(whole[0].max()) < 5.0 * plan.forecast.location_sigma[-1] * math.sqrt(3.0)
    assert missing_stations(begun, None, SENSOR) is None
    fewer = hl.planning.Bounds(
        here.bounds.locations[:1], here.bounds.directions[:1], here.bounds.plate
    )
    assert missing_stations(begun, fewer, SENSOR) is None


@pytest.mark.slow
def test_the_closed_loop_needs_half_of_the_random_stations():
    """Of one robot; the study has the median of fifty, 0.3."""
    found = loop(1)
    assert found["planned"].reached
    assert found["planned"].stations <= 0.5 * found["random"].stations


def test_bounds_too_wide_for_the_sensor_are_refused():
    here = cell(np.random.default_rng(4), 1)
    wide = replace(here.bounds, location_within=0.02)
    with pytest.raises(hl.InputError, match="narrower bounds"):
        hl.planning.blind_motion(wide, SENSOR, here.workspace, here.noise)


def test_bounds_whose_plate_is_turned_over_are_refused():
    """With its normal towards the sensor: before a first motion, and with one begun."""
    rng = np.random.default_rng(4)
    here = cell(rng, 1)
    motion = hl.planning.blind_motion(here.bounds, SENSOR, here.workspace, here.noise)
    begun = here.measured(motion, rng).part(np.arange(4))
    plate = replace(here.bounds.plate, normal=-here.bounds.plate.normal)
    over = replace(here.bounds, plate=plate)
    with pytest.raises(
        hl.InputError, match="a normal of the plate that points away from the sensor"
    ):
        hl.planning.blind_motion(over, SENSOR, here.workspace, here.noise)
    with pytest.raises(hl.InputError, match="points away from the sensor"):
        completing_motion(over, SENSOR, begun, here.workspace, here.noise)
    anywhere = replace(here.workspace, largest_turn=math.pi)
    with pytest.raises(hl.InputError, match="face each other at no station"):
        completing_motion(over, SENSOR, begun, anywhere, here.noise)
    assert missing_stations(begun, over, SENSOR, anywhere, here.noise) is None


def test_the_same_seed_gives_the_same_plan(recorded):
    first, second = (hl.plan(recorded[2], 4, SENSOR, WORKSPACE) for _ in range(2))
    assert first == second
