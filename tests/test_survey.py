"""Sensors of many rays, spheres, points and relations: rows, starts, noise, and what is rejected."""

import pickle
from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

import handlaser_gtsam as hl
from benchmarks import rigs, rigs_by_distance, rigs_by_rays
from benchmarks.rigs import RELATIONS as STATED_RELATIONS
from benchmarks.rigs import body_of, errors_of, stated_relation, survey_of
from handlaser_gtsam.data.recording import TARGETS
from handlaser_gtsam.data.survey import ERRORS, RAY_ERRORS, normal_label
from handlaser_gtsam.estimation.estimate import BlockProblem
from handlaser_gtsam.estimation.survey import estimate_survey, first_state
from handlaser_gtsam.estimation.survey_rows import blocks_of, rows_of
from handlaser_gtsam.files.logs.bag_points import READ_FROM
from handlaser_gtsam.files.points_table import COLUMNS
from handlaser_gtsam.model import reduction as reduction_module
from handlaser_gtsam.model import relation as relations
from handlaser_gtsam.model.block import whitened
from handlaser_gtsam.model.condensed_shots import Stated
from handlaser_gtsam.model.families import FAMILIES, PLANE
from handlaser_gtsam.model.range_blocks import PoseVariables, Ranges
from handlaser_gtsam.model.reduction import damped_step, reduction_of
from handlaser_gtsam.model.relation import Relation
from handlaser_gtsam.model.sensor_limits import Rejected
from handlaser_gtsam.model.sensors.beam import BeamSensor
from handlaser_gtsam.model.sensors.kinds import KINDS
from handlaser_gtsam.model.sensors.mounted import SENSOR, Mounted
from handlaser_gtsam.model.targets.plane import PlaneTarget
from handlaser_gtsam.model.targets.point import POINT
from handlaser_gtsam.model.targets.sphere import SPHERE
from handlaser_gtsam.model.targets_in_shots import condensed_shots
from handlaser_gtsam.pipeline import calibrate_survey
from handlaser_gtsam.results.description.survey import facts
from handlaser_gtsam.results.survey_warnings import rejected_shot

EXACT = hl.Noise(pose_translation_sigma=0.0, pose_rotation_sigma=0.0)
GENERATORS = {"rays": rigs_by_rays, "distance": rigs_by_distance}
CASES = {
    "profiler": ("profiler", {}),
    "scanner": ("scanner", {}),
    "array": ("array", {}),
    "points": ("points", {}),
    "sphere": ("profiler", {"targets": "sphere"}),
    "planes and sphere": ("profiler", {"targets": "planes+sphere"}),
    "array before a sphere": ("array", {"targets": "sphere"}),
    "mixed": ("mixed", {}),
    "wrong shots": ("profiler", {"wrong_shots": 0.1, "wrong_by": "station", "stations": 15}),
}


def far(rig, result):
    """The smallest probability that chance makes a mount so far off."""
    return min(
        chi2.sf(float(error @ np.linalg.solve(C, error)), len(error))
        for error, C in errors_of(rig, result)
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("case", "generator"),
    [
        *[("wrong shots", "rays"), *((case, "distance") for case in CASES)],
    ],
)
def test_mounts_are_found_without_a_start_within_their_covariance(case, generator):
    kind, options = CASES[case]
    rig = getattr(GENERATORS[generator], kind)(101, **options)
    result = hl.calibrate(survey_of(rig), EXACT)
    assert result.status == "converged", result.message
    assert far(rig, result) > 1e-4


@pytest.mark.slow
def test_errors_of_the_hand_are_counted_stated_or_not():
    hand = 5e-5, 1.7e-4
    # Without errors of the hand the standard deviations would be six times as small.
    exact = hl.calibrate(survey_of(rigs_by_rays.profiler(7, planes=3, stations=14)), EXACT)
    for noise in (
        hl.Noise(pose_translation_sigma=hand[0], pose_rotation_sigma=hand[1]),
        hl.Noise(pose_covariance=np.diag([hand[1] ** 2] * 3 + [hand[0] ** 2] * 3)),
        hl.Noise(),
    ):
        rig = rigs_by_rays.profiler(7, hand_sigma=hand, planes=3, stations=14)
        result = hl.calibrate(survey_of(rig), noise)
        assert far(rig, result) > 1e-4
        ratio = result.sensors["profiler"].location_sigma / exact.sensors["profiler"].location_sigma
        assert ratio.min() > 2.0


@pytest.mark.slow
def test_results_are_equal_and_pickled_as_others_are():
    rig = rigs_by_rays.profiler(3, targets="planes+sphere")
    ball = rig.truth["targets"]["sphere:S1"]
    survey = survey_of(rig, [hl.Known("radius", ("sphere:S1",), ball["radius"], sigma=1e-4)])
    one, again = hl.calibrate(survey, EXACT), hl.calibrate(survey, EXACT)
    assert one == again
    assert "_found" not in repr(one)
    kept = pickle.loads(pickle.dumps(one))
    assert kept == one
    assert (hl.plan(kept, 2).forecast.spot > 0.0).all()


@pytest.mark.slow
def test_wrong_shots_are_left_out_as_wholes():
    options = {"wrong_shots": 0.1, "wrong_by": "station", "stations": 15, "planes": 2}
    rig = rigs_by_rays.profiler(3, **options)
    result = hl.calibrate(survey_of(rig), EXACT)
    wrong = {int(s) for s in rig.tables["profiler"]["station"][rig.truth["wrong"]["profiler"]]}
    out = {int(one.station) - 1 for one in result.rejected}
    assert wrong
    assert wrong == out


@pytest.mark.slow
def test_noise_that_next_to_nothing_tells_is_as_is_usual_and_said():
    """Eight readings of one plane, and seven unknowns: a beam was 180 standard deviations off."""
    kind, options, noise = rigs.ROWS["mixed"]
    rig = getattr(rigs_by_rays, kind)(181, **options)
    survey = survey_of(rig)
    result = hl.calibrate(survey, noise)
    assert result.usable
    (warning,) = result.warnings
    assert warning.code == "few-readings"
    assert warning.values["spare"] < 2.0
    assert "the noise of single beams" in result.verdict.sentence
    off = rig.truth["beam"]["location"] - result.beams["beam"].location
    assert (np.abs(off) < 4.0 * result.beams["beam"].location_sigma).all()
    stated = calibrate_survey(survey, replace(noise, range_sigma=1e-4), result)
    assert not stated.warnings


@pytest.mark.slow
def test_what_is_left_out_is_named_with_its_kind():
    """A number may be the name of a beam as well as of a station."""
    survey = survey_of(rigs_by_rays.mixed(101, sensors=("profiler", "beam"), stations=10))
    ranges = survey.ranges.copy()
    row = int(np.flatnonzero(~np.isnan(ranges[:, 0]))[4])
    ranges[row, 0] += 0.05
    result = hl.calibrate(replace(survey, ranges=ranges), hl.Noise())
    station, beam = survey.stations.station_names[row], survey.beam_names[0]
    assert (
        f"beam {beam} at station {station} (contradicted)"
        in dict(facts(result, result.verdict))["left out"]
    )
    lost = Rejected("2", "s", "plane:A", "too-few-points")
    assert rejected_shot(lost, result.beams) == "sensor s at station 2"


def test_a_cone_is_refused_with_what_is_undetermined():
    rig = rigs_by_rays.profiler(3, planes=1, motion="cone", stations=12)
    result = hl.calibrate(survey_of(rig), EXACT)
    assert result.status == "undetermined"
    assert "the shift of profiler along (0.00, 0.00, 1.00) of its own frame" in result.message
    assert "offset of plane:A" in result.message
    assert any("cone" in words for words in result.undetermined)
    sensor = result.sensors["profiler"]
    assert np.isfinite(sensor.rotation_sigma).all()  # the turn is known all the same


@pytest.mark.parametrize("off", [0.0, 0.06])
def test_a_ball_in_the_middle_of_every_view_leaves_a_turn_open(off):
    """However the hand turns; in a camera's frame the ball is off to any side, or on its axis [m]."""
    rng, radius, stations = np.random.default_rng(0), 0.05, 10
    x, y = (grid.ravel() for grid in np.meshgrid(*[np.linspace(-0.4, 0.4, 25)] * 2))
    rays = np.column_stack((x, y, np.ones_like(x)))
    rays /= np.linalg.norm(rays, axis=1)[:, None]
    R = Rotation.random(stations, rng=rng).as_matrix()
    side = rng.uniform(0.0, 2.0 * np.pi, size=stations)
    middle = np.column_stack(
        (off * np.cos(side), off * np.sin(side), rng.uniform(0.25, 0.35, stations))
    )
    X = Rotation.from_euler("xyz", [20.0, -35.0, 10.0], degrees=True).as_matrix()
    location = np.array([0.1, -0.05, 0.2])
    points, of = [], []
    for station, c in enumerate(middle):
        along = rays @ c
        inside = along**2 - c @ c + radius**2
        reading = along - np.sqrt(np.where(inside > 0.0, inside, np.nan))
        seen = np.isfinite(reading)
        reading += 1e-5 * rng.standard_normal(len(rays))
        points.append((reading[:, None] * rays)[seen])
        of.append(np.full(seen.sum(), station))
    t = -np.einsum("sij,sj->si", R, middle @ X.T + location)  # the ball is at the origin
    camera = hl.Shots.points("camera", np.concatenate(of), np.concatenate(points))
    survey = hl.Survey(hl.StationList(R, t, ("sphere:ball",) * stations), (camera,))
    result = hl.calibrate(survey, EXACT)
    if off:
        assert result.usable
    else:
        (words,) = result.undetermined
        assert "the turn of camera about the direction (0.00, 0.00, 1.00) of its own frame" in words
        assert "To determine it: see the ball off the middle of the view" in result.message
        assert "plane" not in result.message


@pytest.mark.slow
def test_covariances_are_gtsams_and_the_dense_inverse():
    rig = rigs_by_rays.mixed(3, sensors=("profiler", "beam"), targets="planes+sphere")
    found = estimate_survey(survey_of(rig), EXACT)
    problem, estimate = found.problem(), found.estimate
    J, _ = problem.rows(
        problem.blocks, {name: x[None] for name, x in estimate.values.items()}
    ).whitened()
    scale = np.sqrt(np.diagonal(estimate.covariance))
    inverse = np.linalg.inv((J * scale).T @ (J * scale))
    assert np.abs(estimate.covariance / np.outer(scale, scale) - inverse).max() < 1e-6


def test_rows_that_see_the_same_are_added_up_at_once(monkeypatch):
    """The step is that of the dense rows, whether hand poses are variables or constants."""
    rig = rigs_by_rays.mixed(3, sensors=("profiler", "array"), targets="planes+sphere", planes=3)
    rows = rows_of(survey_of(rig), EXACT)
    state = first_state(rows, EXACT)
    in_any_order = np.random.default_rng(0).permutation(len(rows.items)).tolist()
    rows = replace(rows, items=tuple(rows.items[i] for i in in_any_order))
    values = {name: x + 1e-4 if name == "sphere" else x for name, x in state.values.items()}
    blocks, _ = blocks_of(rows.items, state.sigmas(), values)
    J, e = BlockProblem(blocks, values, rows.unknown()).rows(blocks, values).whitened()
    dense = -np.linalg.pinv(J) @ e
    blocks, _ = blocks_of(rows.items, state.sigmas(), values, given_poses=True)
    monkeypatch.setattr(reduction_module, "_KNOWN", {})
    monkeypatch.setattr(reduction_module, "FEWER", 1)
    reduction = reduction_of(blocks, rows.counts(), rows.unknown())
    assert max(len(plan.runs) for plan in reduction.plans) > 1
    columns = [whitened(block.evaluate(values), block.weights) for block in blocks]
    step, local = damped_step(reduction.normal(blocks, columns), np.zeros(1))
    steps = [reduction.gathered(name, step, local) for name in rows.unknown()]
    found = np.concatenate([one.ravel() for one in steps])
    sigma = np.sqrt(np.diagonal(np.linalg.pinv(J.T @ J)))
    assert np.abs(dense).max() > 1e-5
    assert (np.abs(found - dense) < 1e-9 * sigma).all()


def test_several_groups_of_one_beam_plane_and_pose_have_their_rows():
    one = np.zeros(3, dtype=int)
    reading = np.array([0.30, 0.31, 0.32]).reshape(1, 3, 1)
    block = Ranges(BeamSensor(one), PlaneTarget(one), PoseVariables(one), reading)
    pose = np.append(np.eye(3).ravel(), np.zeros(3))
    values = {
        "beam": np.array([0.01, 0.02, 0.03, 0.0, 0.0, 1.0, 0.0, 0.0]).reshape(1, 1, 8),
        "plane": np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.33]).reshape(1, 1, 7),
        "pose": pose.reshape(1, 1, 12),
    }
    e = block.evaluate(values).columns[-1, 0, :, 0]
    assert e == pytest.approx([0.0, -0.01, -0.02])


def test_residuals_of_readings_have_their_derivatives_and_the_noise_of_readings():
    """Derivatives are differences; a reading that is longer by 1 mm is 1 mm off, whatever k1 is."""
    one = np.zeros(2, dtype=int)
    pose = np.append(Rotation.from_rotvec([0.1, -0.2, 0.3]).as_matrix().ravel(), [0.1, 0.2, 0.0])
    direction = np.array([0.2, -0.1, 1.0]) / np.sqrt(1.05)
    values = {
        "beam": np.array([0.01, 0.02, 0.03, *direction, 0.2, 0.01]).reshape(1, 1, 8),
        "plane": np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.6]).reshape(1, 1, 7),
        "pose": pose.reshape(1, 1, 12),
    }

    def residuals(reading, at):
        sensor = BeamSensor(one, as_read=True)
        block = Ranges(sensor, PlaneTarget(one), PoseVariables(one), reading.reshape(1, 2, 1))
        return block.evaluate(at).columns[..., 0]

    reading, step = np.array([0.45, 0.5]), 1e-6
    columns = residuals(reading, values)[:, 0]
    for coordinate in range(7):
        ends = [
            FAMILIES["beam"].retract(values["beam"], side * step * np.eye(1, 7, coordinate)[None])
            for side in (1.0, -1.0)
        ]
        more, less = (residuals(reading, {**values, "beam": end})[-1, 0] for end in ends)
        # Second derivatives of half a metre make 1e-12 of a step of 1e-6.
        assert columns[coordinate] == pytest.approx((more - less) / (2.0 * step), abs=1e-8)
    exact = reading
    for _ in range(5):
        exact = exact + residuals(exact, values)[-1, 0]
    assert residuals(exact, values)[-1, 0] == pytest.approx(0.0, abs=1e-12)
    assert residuals(exact + 1e-3, values)[-1, 0] == pytest.approx(-1e-3, rel=1e-4)


def profiles(count, seed=5, points=1000):
    """Profiles of three planes with their hand poses, condensed and whole."""
    rig = rigs_by_rays.profiler(seed, planes=3, stations=count)
    rng = np.random.default_rng(0)
    T = np.asarray(rig.truth["profiler"])
    station, x, z = [], [], []
    for i, label in enumerate(rig.label):
        plane = rig.truth["targets"][label]
        S = rig.truth["hand"][i] @ T
        n, d = S[:3, :3].T @ plane["normal"], plane["normal"] @ S[:3, 3] + plane["offset"]
        here = np.linspace(-0.02, 0.02, points)
        station.append(np.full(points, i))
        x.append(here)
        # No point is so far off that it is left out.
        noise = np.clip(rng.normal(size=points), -3.5, 3.5)
        z.append(-(n[0] * here + d) / n[2] + 1e-4 * noise)
    arrays = (np.concatenate(part) for part in (station, x, z))
    shots = hl.Shots.profiler("profiler", *arrays, sigma=1e-4)
    return rig, hl.Survey(hl.StationList(rig.R, rig.t, tuple(rig.label)), (shots,))


def whole_block(survey, labels):
    """The block that holds every point."""
    shots = survey.shots[0]
    count = len(survey.stations)
    rays = KINDS["profiler"].rays(shots.across)
    shape = (count, -1)

    def grouped(vectors):
        return np.moveaxis(vectors.reshape(*shape, 3), 2, 0)[:, None]

    member = np.array([labels.index(label) for label in survey.stations.plane_labels])
    d = shots.reading.reshape(1, *shape)
    by_error = np.stack((np.ones_like(d), d, d * d, np.zeros_like(d)))
    sensor = Mounted(np.zeros(count, int), grouped(rays.origin), grouped(rays.direction), by_error)
    return Ranges(sensor, PlaneTarget(member), PoseVariables(np.arange(count)), d)


def test_condensed_shots_say_what_all_points_say():
    """60 shots of 1000 points: the same information, and the same step, to 1e-9 standard deviations."""
    _, survey = profiles(20)
    found = estimate_survey(survey, EXACT)
    estimate = found.estimate
    values = {name: x[None] for name, x in estimate.values.items()}
    whole = whole_block(survey, list(found.rows.targets["plane"]))
    problem = hl.estimation.BlockProblem([whole], values, found.problem().unknown, 0.2)
    rows = problem.rows([whole], values)
    few = problem.rows(found.problem().blocks, values)
    sigma = np.sqrt(np.diagonal(estimate.covariance))
    J, e = rows.derivatives * sigma / 1e-4, rows.residuals / 1e-4
    K, f = few.derivatives * sigma, few.residuals
    assert len(f) < 0.01 * len(e)
    assert np.abs(J.T @ J - K.T @ K).max() < 1e-8 * np.abs(J.T @ J).max()
    assert (
        np.abs(np.linalg.solve(J.T @ J, J.T @ e) - np.linalg.solve(K.T @ K, K.T @ f)).max() < 1e-9
    )


@pytest.mark.parametrize("ratio", [0.0, 1.0])
def test_many_shots_at_once_are_as_one_by_one(ratio):
    """The same points, shapes and information; the rays that stand for a shot may be others."""
    rng = np.random.default_rng(3)
    x = np.linspace(-0.03, 0.03, 150)
    shots = []
    for _ in range(20):
        z = 0.2 + rng.normal() * x + 1e-4 * rng.normal(size=150) - 0.02 * (rng.random(150) < 0.1)
        shots.append((x[:, None] + 1e-4 * ratio * rng.normal(size=(150, 1)), z))
    kind = KINDS["profiler"]
    for one, (across, z) in zip(
        condensed_shots(kind, "plane", shots, Stated(ratio)), shots, strict=True
    ):
        (other,) = condensed_shots(kind, "plane", [(across, z)], Stated(ratio))
        assert (one.kept == other.kept).all()
        assert one.shape == pytest.approx(other.shape, rel=1e-9, abs=1e-9)
        assert (one.squares, one.dof) == (pytest.approx(other.squares, rel=1e-6), other.dof)
        information = []
        for shot in (one, other):
            A = np.column_stack((np.ones(2), shot.rays.origin[:, 0]))
            B = shot.mix.T @ np.hstack((A, shot.by_error.T))
            information.append(B.T @ B)
        scale = np.sqrt(np.diagonal(information[1])) + 1e-30
        off = (information[0] - information[1]) / np.outer(scale, scale)
        assert np.abs(off).max() < 1e-6


def test_a_shot_of_one_ray_shows_no_ball():
    """These readings led to a circle of no size, at which no derivative was finite."""
    reading = 0.23 + 0.02 * np.random.default_rng(84).random(30)
    for kind in ("profiler", "scanner"):
        assert condensed_shots(KINDS[kind], "sphere", [(np.zeros((30, 1)), reading)]) == [None]


@pytest.mark.slow
def test_noise_across_a_profile_pulls_no_slope():
    """Noise in x as large as in z: the slopes of many shots have no bias, and their stated spread."""
    rng = np.random.default_rng(1)
    x = np.linspace(-0.025, 0.025, 100)
    off = []
    for _ in range(200):
        noise = rng.normal(scale=5e-4, size=(2, 100))
        profile = (x + noise[0])[:, None], 0.1 + 0.5 * x + noise[1]
        (shot,) = condensed_shots(KINDS["profiler"], "plane", [profile], Stated(1.0))
        off.append(shot.shape[1] - 0.5)
    assert abs(np.mean(off)) < 4.0 * np.std(off) / np.sqrt(200)


@pytest.mark.slow
def test_more_points_bring_no_bias_with_errors_of_the_hand():
    """The mean error of mounts, in their standard deviations, with 50 and with 500 points a shot."""
    hand = 1e-4, 3e-4
    noise = hl.Noise(pose_translation_sigma=hand[0], pose_rotation_sigma=hand[1])
    runs = 4
    for points in (50, 500):
        mean = np.zeros(6)
        for seed in range(runs):
            rig, survey = profiles(8, seed, points)
            rng = np.random.default_rng(seed)
            R = (
                rig.R
                @ Rotation.from_rotvec(rng.normal(scale=hand[1], size=(len(rig.R), 3))).as_matrix()
            )
            t = rig.t + np.einsum("nij,nj->ni", rig.R, rng.normal(scale=hand[0], size=rig.t.shape))
            stations = hl.StationList(R, t, survey.stations.plane_labels)
            result = hl.calibrate(hl.Survey(stations, survey.shots), noise)
            (error, C) = next(errors_of(rig, result))
            mean += error / np.sqrt(np.diagonal(C)) / runs
        # The mean of so many numbers of standard deviation one, four of its own away.
        assert np.abs(mean).max() < 4.0 / np.sqrt(runs)


def planes(rng):
    n = rng.normal(size=3)
    return np.concatenate((n / np.linalg.norm(n), rng.normal(size=1), rng.normal(size=3)))


def motion(rng):
    turn = Rotation.random(random_state=rng).as_matrix().ravel()
    return np.concatenate((turn, rng.normal(size=3)))


RELATIONS = {
    "angle": relations.at_an_angle("plane", 0, 1, 1.2, 1e-3),
    "angle of beams": relations.at_an_angle("beam", 0, 1, 1.2, 1e-3),
    "along": relations.along(0, np.array([0.0, 0.1, 1.0]), 1e-3),
    "upright": relations.upright(0, np.array([0.0, 0.1, 1.0]), 1e-3),
    "plane": relations.plane_at(0, np.array([0.0, 0.1, 1.0]), 0.3, 1e-3, 1e-3),
    "radius": relations.radius(0, 0.1, 1e-3),
    "position": relations.position("sphere", 0, np.ones(3), 1e-3),
    "distance": relations.distance(("sphere", 0), ("point", 0), 0.5, 1e-3),
    "face": relations.face(0, 0, np.array([0.0, 0.1, 1.0]), 0.2, 1e-3, 1e-3),
    "mount": relations.mounted_at(0, np.eye(4), 1e-3, 1e-3),
    "mounts": relations.mounted_together(0, 1, np.eye(4), 1e-3, 1e-3),
    "beam": relations.beam_at(0, np.zeros(3), np.array([0.0, 0.1, 1.0]), 1e-3, 1e-3),
    "held": relations.held(0, np.append(np.eye(3).ravel(), np.zeros(3)), np.eye(2, 4), 1e-2),
}


@pytest.mark.parametrize("case", RELATIONS)
def test_rows_of_relations_are_derivatives(case):
    rng = np.random.default_rng(3)
    beams = rng.normal(size=(2, 8))
    beams[:, 3:6] /= np.linalg.norm(beams[:, 3:6], axis=1)[:, None]
    values = {
        "plane": np.stack([planes(rng), planes(rng)])[None],
        "beam": beams[None],
        "sphere": rng.normal(size=(1, 1, 4)),
        "point": rng.normal(size=(1, 1, 3)),
        "body": motion(rng)[None, None],
        "sensor": np.stack([np.append(motion(rng), np.zeros(4)) for _ in range(2)])[None],
    }
    relation = RELATIONS[case]
    columns = relation.evaluate(values).columns
    for slot in relation.slots():
        family = FAMILIES[slot.family]
        for c in range(family.dim):
            delta = np.zeros((*values[slot.family].shape[:2], family.dim))
            delta[0, slot.member[0], c] = 1e-6
            sides = [
                relation.evaluate(
                    {**values, slot.family: family.retract(values[slot.family], sign * delta)}
                ).columns[-1]
                for sign in (1.0, -1.0)
            ]
            slope = (sides[0] - sides[1]) / 2e-6
            mine = columns[slot.columns.start + c]
            assert np.abs(mine - slope).max() < 1e-5 * max(np.abs(slope).max(), 1e3)


def test_a_rule_that_returns_derivatives_is_refused():
    relation = Relation((("sphere", 0),), lambda x: (x, [np.eye(4)]))
    with pytest.raises(hl.InputError, match="a rule that returns a tuple; expected the residuals"):
        relation.evaluate({"sphere": np.zeros((1, 1, 4))})


def test_parallel_planes_have_right_derivatives_where_they_are_parallel():
    rng = np.random.default_rng(3)
    first, second = planes(rng), planes(rng)
    second[:3] = first[:3]
    relation, values = (
        relations.parallel(0, 1, 0.3, 1e-3, 1e-3),
        {"plane": np.stack((first, second))[None]},
    )
    columns = relation.evaluate(values).columns
    for slot in relation.slots():
        for c in range(3):
            delta = np.zeros((1, 2, 3))
            delta[0, slot.member[0], c] = 1e-6
            moved = [
                relation.evaluate(
                    {"plane": FAMILIES["plane"].retract(values["plane"], sign * delta)}
                ).columns[-1]
                for sign in (1.0, -1.0)
            ]
            slope = (moved[0] - moved[1]) / 2e-6
            assert np.abs(columns[slot.columns.start + c] - slope).max() < 0.02


@pytest.mark.slow
def test_a_body_ties_its_planes_and_one_wrong_face_is_named():
    rig = rigs_by_rays.profiler(2, targets="body")
    (body,) = body_of(rig)
    free = hl.calibrate(survey_of(rig), EXACT)
    tied = hl.calibrate(survey_of(rig, [body]), EXACT)
    assert not tied.relations[0].contradicted
    assert far(rig, tied) > 1e-4
    ratio = tied.sensors["profiler"].location_sigma / free.sensors["profiler"].location_sigma
    assert ratio.max() < 1.001
    faces = body.faces.copy()
    faces[0, 3] += 0.005
    wrong = hl.Known("body", body.of, sigma=1e-5, sigma_angle=1e-5, faces=faces)
    assert hl.calibrate(survey_of(rig, [wrong]), EXACT).relations[0].contradicted
    faces = body.faces * [1.0, 1.0, 1.0, -1.0]  # of normals that point into the body
    inside_out = hl.Known("body", body.of, sigma=1e-5, sigma_angle=1e-5, faces=faces)
    result = hl.calibrate(survey_of(rig, [inside_out]), EXACT)
    assert [one.code for one in result.warnings] == ["relation-contradicted"]


def profiles_of_a_groove(labels, turned=0):
    """A V of two planes at right angles, seen as one profile; some are turned by half a turn."""
    rng = np.random.default_rng(2)
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = Rotation.from_rotvec([0.3, -0.2, 0.5]).as_matrix(), [0.05, -0.02, 0.1]
    sides = (
        (np.array([1.0, 0.0, 1.0]) / np.sqrt(2), 0.0),
        (np.array([-1.0, 0.0, 1.0]) / np.sqrt(2), 0.0),
    )
    poses, station, x, z = [], [], [], []
    for i in range(16):
        turn = Rotation.from_euler(
            "xyz", [180 + rng.uniform(-20, 20), *rng.uniform(-15, 15, 2)], degrees=True
        )
        S = np.eye(4)
        S[:3, :3] = turn.as_matrix() @ np.diag([-1.0, -1.0, 1.0] if i < turned else np.ones(3))
        S[:3, 3] = [rng.uniform(-0.005, 0.005), rng.uniform(-0.05, 0.05), rng.uniform(0.12, 0.2)]
        here = np.linspace(-0.03, 0.03, 200)
        depth = np.stack(
            [-(n @ (S[:3, :1] * here + S[:3, 3:]) + b) / (n @ S[:3, 2]) for n, b in sides]
        ).min(axis=0)
        poses.append(S @ np.linalg.inv(T))
        station.append(np.full(200, i))
        x.append(here)
        z.append(depth + rng.normal(scale=2e-5, size=200))
    P = np.array(poses)
    shots = hl.Shots.profiler("p", *(np.concatenate(a) for a in (station, x, z)))
    return hl.Survey(hl.StationList(P[:, :3, :3], P[:, :3, 3], labels), (shots,)), T


@pytest.mark.slow
@pytest.mark.parametrize("turned", [0, 8])
def test_a_groove_is_two_planes(turned):
    labels = ("groove:V2",) * turned + ("groove:V",) * (16 - turned)
    survey, T = profiles_of_a_groove(labels, turned)
    result = hl.calibrate(survey, EXACT)
    assert result.status == "converged"
    sides = {f"plane:{label[7:]}.{side}" for label in labels for side in ("left", "right")}
    assert set(result.targets) == sides
    R = result.sensors["p"].rotation
    turn = Rotation.from_matrix(R.T @ T[:3, :3]).as_rotvec()
    error = np.concatenate((turn, R.T @ (T[:3, 3] - result.sensors["p"].location)))
    C = result.sensors["p"].covariance
    assert error @ np.linalg.solve(C, error) < 22.5


def test_sides_of_a_groove_that_change_places_are_said_to():
    survey, _ = profiles_of_a_groove(("groove:V",) * 16, turned=8)
    result = hl.calibrate(survey, EXACT)
    assert not result.usable
    assert "the sides of a groove change places" in result.verdict.sentence


@pytest.mark.slow
def test_a_range_error_that_is_held_is_found_and_freed():
    """A scanner that reads 0.2 mm too short: found by the test, and right once it is free."""
    rig = rigs_by_rays.scanner(4, planes=3, stations=14)
    rig.tables["scanner"]["reading"] -= 2e-4
    held = hl.calibrate(survey_of(rig), EXACT)
    error = held.sensors["scanner"].errors["k0"]
    assert error.found
    assert error.size == pytest.approx(2e-4, abs=5.0 * error.sigma)
    assert any(w.code == "range-error" for w in held.warnings)
    table = rig.tables["scanner"]
    shots = hl.Shots.scanner(
        "scanner", table["station"], table["angle"], table["reading"], free=("k0",)
    )
    stations = hl.StationList(rig.R, rig.t, tuple(rig.label))
    free = hl.calibrate(hl.Survey(stations, (shots,)), EXACT)
    sigma = float(np.sqrt(free.sensors["scanner"].covariance[6, 6]))
    assert free.sensors["scanner"].range_error["k0"] == pytest.approx(2e-4, abs=5.0 * sigma)
    assert far(rig, free) > 1e-4


def before(label, *, beam, **options):
    """A survey of one station, read by a profiler, or by a beam."""
    stations = hl.StationList(np.eye(3)[None], np.zeros((1, 3)), (label,))
    if beam:
        return hl.Survey(stations, (), [[0.3]], ("1",), **options)
    return hl.Survey(stations, (hl.Shots.profiler("p", [0], [0.0], [1.0]),), **options)


LABELS = ("A", "plane:A", "sphere:A", "point:A", "groove:A", "sensor:A", "beam:A")
OF_KINDS = {
    "angle": {("A", "plane:B"), ("plane:A", "plane:B"), ("beam:A", "beam:B")},
    "parallel": {("A", "plane:B"), ("plane:A", "plane:B")},
    "along": {("A",), ("plane:A",)},
    "upright": {("A",), ("plane:A",)},
    "plane": {("A",), ("plane:A",)},
    "radius": {("sphere:A",)},
    "position": {("sphere:A",), ("point:A",)},
    "distance": set(product(("sphere:A", "point:A"), ("sphere:B", "point:B"))),
    "body": {("A", "plane:B"), ("plane:A", "plane:B")},
    "mount": {("sensor:A",), ("beam:A",)},
    "mounts": {("sensor:A", "sensor:B")},
}
"""What each relation can be of, among the labels of LABELS and of the same named B."""


@pytest.mark.parametrize("relation", OF_KINDS)
def test_a_relation_takes_variables_of_its_kinds_and_no_others(relation):
    """Numbers of another family used to be taken: the radius of a plane moved that of a ball."""
    fields = {
        "angle": {"value": 1.0, "sigma_angle": 1e-3},
        "parallel": {"value": 1.0, "sigma": 1e-3, "sigma_angle": 1e-3},
        "along": {"direction": [0, 0, 1], "sigma_angle": 1e-3},
        "upright": {"direction": [0, 0, 1], "sigma_angle": 1e-3},
        "plane": {"direction": [0, 0, 1], "sigma": 1e-3, "sigma_angle": 1e-3},
        "radius": {"value": 0.1, "sigma": 1e-3},
        "position": {"direction": [0, 0, 1], "sigma": 1e-3},
        "distance": {"value": 0.1, "sigma": 1e-3},
        "body": {"faces": np.eye(2, 4), "sigma": 1e-3, "sigma_angle": 1e-3},
        "mount": {"pose": np.eye(4), "sigma": 1e-3, "sigma_angle": 1e-3},
        "mounts": {"pose": np.eye(4), "sigma": 1e-3, "sigma_angle": 1e-3},
    }[relation]
    right = OF_KINDS[relation]
    others = [(one,) for one in LABELS]
    if len(next(iter(right))) == 2:
        second = ("plane:B", "sphere:B", "point:B", "groove:B", "sensor:B", "beam:B")
        others = list(product(LABELS, second))
    assert right < set(others)
    for of in others:
        if of in right:
            assert hl.Known(relation, of, **fields).of == tuple(map(normal_label, of))
        else:
            with pytest.raises(hl.InputError, match=rf"found {relation} of .*; expected .*:NAME"):
                hl.Known(relation, of, **fields)


BAD = {
    "another kind": (lambda: hl.Shots("a", "lidar", [0], [[0.0]], [1.0]), "kind"),
    "not finite": (lambda: hl.Shots.profiler("a", [0], [0.0], [np.nan]), "not finite"),
    "other lengths": (lambda: hl.Shots.profiler("a", [0], [0.0, 1.0], [1.0]), "shapes"),
    "a range of zero": (lambda: hl.Shots.scanner("a", [0], [0.0], [0.0]), "above zero"),
    "stations that are no numbers": (lambda: hl.Shots.profiler("a", ["x"], [0.0], [1.0]), "whole"),
    "directions behind": (lambda: hl.Shots.array("a", [0], [[0, 0, -1.0]], [1.0]), "above zero"),
    "a relation of one": (lambda: hl.Known("angle", ("plane:A",), 1.0, 0.0, 1.0), "2 planes"),
    "a relation to itself": (
        lambda: hl.Known("distance", ("sphere:S", "sphere:S"), 1.0, 1e-3),
        "every label once",
    ),
    "a sigma that a relation has not": (
        lambda: hl.Known("radius", ("sphere:S",), 0.1, 1e-3, 1e-3),
        "a sigma_angle with radius of sphere:S; expected value, sigma",
    ),
    "a groove before a beam": (lambda: before("groove:V", beam=True), "a beam that reads groove:V"),
    "a groove before a cone": (
        lambda: before("groove:V", beam=True, half_angle=0.2),
        "a cone that reads groove:V; expected planes and spheres: only a profile",
    ),
    "a point before no beam": (
        lambda: before("point:tip", beam=False),
        "point:tip, which p reads and no beam; expected a beam aimed at it",
    ),
    "a station that is not there": (
        lambda: hl.Survey(
            hl.StationList(np.eye(3)[None], np.zeros((1, 3)), ("A",)),
            (hl.Shots.profiler("a", [1], [0.0], [1.0]),),
        ),
        "station 1",
    ),
    "a label of no kind": (
        lambda: hl.Survey(
            hl.StationList(np.eye(3)[None], np.zeros((1, 3)), ("cube:A",)),
            (hl.Shots.profiler("a", [0], [0.0], [1.0]),),
        ),
        "cube:A",
    ),
    "a sigma of zero": (
        lambda: hl.Known("radius", ("sphere:S",), 0.02, sigma=0.0),
        "no sigma above zero of radius of sphere:S; expected how well it is known",
    ),
    "nothing read": (
        lambda: hl.Survey(hl.StationList(np.eye(3)[None], np.zeros((1, 3)), ("A",))),
        "without readings",
    ),
}


@pytest.mark.parametrize("case", BAD)
def test_what_is_no_survey_is_refused_in_one_line(case):
    make, words = BAD[case]
    with pytest.raises(hl.InputError, match=words) as caught:
        make()
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("seed", [7, 71])
def test_spots_that_are_aimed_exactly_leave_the_noise_of_readings_as_it_is(seed):
    """Where rows of one kind fit exactly, the likelihood of their size has no bound."""
    rig = rigs_by_rays.beams(seed, targets="point", stations=15)
    survey = survey_of(rig)
    found = hl.calibrate(survey, EXACT)
    assert found.usable
    assert far(rig, found) > 1e-4
    *_, beams, _ = estimate_survey(survey, EXACT).noise.sigma
    assert beams == pytest.approx(1e-4, rel=0.3)


@pytest.mark.parametrize(
    ("times", "code"), [(1.0, None), (0.6, "sigmas-too-small"), (2.5, "sigmas-too-large")]
)
def test_a_stated_sigma_that_shots_contradict_is_said(times, code):
    survey = survey_of(rigs_by_rays.profiler(1))
    shots = replace(survey.shots[0], sigma=times * 1e-4)
    found = hl.calibrate(replace(survey, shots=(shots,)), EXACT)
    assert found.usable
    assert [one.code for one in found.warnings] == ([] if code is None else [code])


@pytest.mark.slow
@pytest.mark.parametrize("seed", [45, 81])
def test_a_false_face_is_named_and_not_the_shots_that_contradict_it(seed):
    """It used to reject a third of the shots of its plane, and stayed."""
    kind, options = STATED_RELATIONS["body"]
    rig = getattr(rigs_by_rays, kind)(seed, **options)
    true, false = stated_relation(rig, hl.calibrate(survey_of(rig), EXACT), "body")
    assert hl.calibrate(survey_of(rig, [true]), EXACT).usable
    result = hl.calibrate(survey_of(rig, [false]), EXACT)
    assert result.relations[0].contradicted
    assert "the readings contradict what is said to be known: body of" in result.verdict.sentence
    assert not result.rejected


def test_every_kind_of_sensor_and_target_is_known_everywhere():
    assert set(ERRORS) == set(KINDS) == set(COLUMNS) == set(READ_FROM)
    assert set(TARGETS) - {"groove"} == {PLANE.name, SPHERE.name, POINT.name}
    assert {*SENSOR.coordinates} >= {*RAY_ERRORS}
    # A shift of parallel rays along themselves is a location of the sensor.
    for kind, errors in ERRORS.items():
        assert set(RAY_ERRORS) - set(errors) == ({"k0"} if KINDS[kind].parallel else set())


def test_shots_condensed_at_range_errors_have_the_unit_and_the_derivatives_of_readings():
    """Twice as long ranges do not make noise larger, and a scale of x turns a line by its part."""
    x, rng = np.linspace(-0.03, 0.03, 40), np.random.default_rng(0)
    z = 0.2 + 0.4 * x + 1e-4 * rng.normal(size=40)
    kind, shots = KINDS["profiler"], [(x[:, None], z)]

    def at_errors(*errors):
        return Stated(errors=np.array(errors), sorted_out=True)

    (plain,) = condensed_shots(kind, "plane", shots)
    (longer,) = condensed_shots(kind, "plane", shots, at_errors(0.0, 1.0, 0.0, 0.0))
    assert longer.squares == pytest.approx(plain.squares)
    scale = 0.25
    (wider,) = condensed_shots(kind, "plane", shots, at_errors(0.0, 0.0, 0.0, scale))
    at, slope = wider.rays.origin[:, 0], np.polyfit(x, z, 1)[0] / (1.0 + scale)
    assert wider.by_error[3] == pytest.approx(-slope * at / (1.0 + scale), rel=1e-6)
