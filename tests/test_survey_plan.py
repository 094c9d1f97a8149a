"""Plans of surveys: what they promise is what the stations bring, by formulas of this file."""

import json
import math
import re
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from arms import HANGING, HAS_PINOCCHIO, small_arm
from helpers import ROOT
from scipy.spatial.transform import Rotation

import handlaser_gtsam as hl
from benchmarks import rigs_by_rays
from benchmarks.arm_errors import STOPS, Case, Scene
from benchmarks.rigs import EXACT, survey_of
from handlaser_gtsam import pipeline
from handlaser_gtsam.cli.words import plan_lines
from handlaser_gtsam.files.recording_csv import write_stations
from handlaser_gtsam.planning import plan as planning
from handlaser_gtsam.planning.survey import _Known, _Look
from handlaser_gtsam.planning.workspace import Workspace
from handlaser_gtsam.results.spots import radius
from handlaser_gtsam.validation.simulate import Stations

needs_pinocchio = pytest.mark.skipif(not HAS_PINOCCHIO, reason="needs pinocchio")
X = np.linspace(-0.03, 0.03, 200)
SIGMA = 3e-5
MOUNT = Rotation.from_rotvec([0.4, -0.3, 1.1]).as_matrix(), np.array([0.03, -0.05, 0.12])
NORMAL, OFFSET = np.array([0.1, -0.05, 0.9935]), -0.9
NORMAL = NORMAL / np.linalg.norm(NORMAL)


def profile(R, t, rng):
    """What the profiler at a hand pose reads of the plane n . x + b = 0, noise and all."""
    mount, place = MOUNT
    start = t + (R @ place) + np.outer(X, R @ mount[:, 0])
    z = -(start @ NORMAL + OFFSET) / (R @ mount[:, 2] @ NORMAL)
    return z + SIGMA * rng.standard_normal(len(X))


def measured(poses, rng):
    """A survey of hand poses before the plane."""
    stations = hl.StationList(*map(np.array, zip(*poses, strict=True)), ("plane:A",) * len(poses))
    z = np.concatenate([profile(R, t, rng) for R, t in poses])
    station = np.repeat(np.arange(len(poses)), len(X))
    shots = hl.Shots.profiler("profiler", station, np.tile(X, len(poses)), z, sigma=SIGMA)
    return hl.Survey(stations, (shots,))


def looking(tilts, rng):
    """Hand poses whose profiler looks at the plane from some 0.1 m, tilted about x and y [rad]."""
    mount, place = MOUNT
    for about_x, about_y in tilts:
        # The sensor's z along the normal, then tilted about its own axes.
        side = np.cross(NORMAL, [1.0, 0.0, 0.0])
        side /= np.linalg.norm(side)
        square = np.column_stack((side, np.cross(NORMAL, side), NORMAL))
        sensor = square @ Rotation.from_euler("xy", [about_x, about_y]).as_matrix()
        foot = -OFFSET * NORMAL + 0.05 * rng.standard_normal(3)
        foot -= NORMAL * (foot @ NORMAL + OFFSET)
        R = sensor @ mount.T
        yield R, foot - rng.uniform(0.07, 0.13) * sensor[:, 2] - R @ place


@cache
def found_from_six(largest):
    """Return six hand poses, tilted by up to `largest`, and the calibration of what is read there."""
    rng = np.random.default_rng(2)
    poses = list(looking(rng.uniform(-largest, largest, (6, 2)), rng))
    return poses, hl.calibrate(measured(poses, rng), EXACT)


def remembering(real):
    """A function that returns what another one returned when it was called first."""
    made = []

    def first(*given, **options):
        if not made:
            made.append(real(*given, **options))
        return made[0]

    return first


@pytest.fixture
def once(monkeypatch):
    """What the command calibrates and plans is computed once, for all ways in which it is shown."""
    for module, name in ((pipeline, "calibrate"), (planning, "plan")):
        monkeypatch.setattr(module, name, remembering(getattr(module, name)))


@pytest.mark.slow
def test_what_a_plan_promises_is_what_its_stations_bring():
    rng = np.random.default_rng(2)
    tilts = rng.uniform(-0.5, 0.5, (6, 2))
    poses = list(looking(tilts, rng))
    first = hl.calibrate(measured(poses, rng), EXACT)
    assert first.status == "converged"
    home = Rotation.from_matrix([R for R, _ in poses]).mean().as_matrix()
    plan = hl.plan(first, 5, workspace=Workspace(-np.ones(3), np.full(3, 2.0), home, 0.7))
    before = first.sensors["profiler"].spot_error
    assert plan.forecast.spot[0] == pytest.approx(before, rel=1e-3)
    assert (np.diff(plan.forecast.spot) < 0.0).all()
    assert set(plan.stations.station_names).isdisjoint(first.survey.stations.station_names)
    added = zip(plan.stations.world_R_hand, plan.stations.world_t_hand, strict=True)
    after = hl.calibrate(measured([*poses, *added], rng), EXACT)
    brought = after.sensors["profiler"].spot_error
    assert brought < 0.5 * before
    assert plan.forecast.spot[-1] == pytest.approx(brought, rel=0.2)
    # Five stations at random, turned as far, bring less.
    random = looking(rng.uniform(-0.5, 0.5, (5, 2)), rng)
    other = hl.calibrate(measured([*poses, *random], rng), EXACT)
    assert brought < 0.9 * other.sensors["profiler"].spot_error


@pytest.mark.slow
@pytest.mark.parametrize("seed", [3, 4, 8])
def test_a_plan_determines_what_a_poor_motion_left_open(seed):
    """Of mounts that fit alike the one near the hand counts; from others stations see no plate."""
    rng = np.random.default_rng(seed)
    about_one_axis = [(tilt, 0.0) for tilt in np.linspace(-0.5, 0.5, 8)]
    poses = list(looking(about_one_axis, rng))
    first = hl.calibrate(measured(poses, rng), EXACT)
    assert first.status == "undetermined"
    assert np.linalg.norm(first.sensors["profiler"].location - MOUNT[1]) < 0.1
    plan = hl.plan(first, 4)
    assert plan.undetermined == first.undetermined
    assert np.isnan(plan.forecast.spot[0])
    assert plan.determined
    added = zip(plan.stations.world_R_hand, plan.stations.world_t_hand, strict=True)
    after = hl.calibrate(measured([*poses, *added], rng), EXACT)
    assert after.status == "converged"
    assert after.sensors["profiler"].shots == 12
    assert after.sensors["profiler"].spot_error < 1e-4


@pytest.mark.slow
def test_without_a_workspace_targets_are_looked_at_from_where_they_were_seen():
    """Nothing says what stands on the other sides."""
    rng = np.random.default_rng(4)
    poses = list(looking(rng.uniform(-0.4, 0.4, (8, 2)), rng))
    # Turns about the axis of the sensor allow the hand large ones.
    spun = [
        (R @ Rotation.from_rotvec(MOUNT[0][:, 2] * a).as_matrix(), t)
        for a, (R, t) in zip(np.linspace(-1.0, 1.0, 8), poses, strict=True)
    ]
    plan = hl.plan(hl.calibrate(measured(spun, rng), EXACT), 6)
    before = np.array([R @ MOUNT[0][:, 2] for R, _ in spun])
    axis = before.mean(axis=0) / np.linalg.norm(before.mean(axis=0))
    cone = np.arccos((before @ axis).min())
    planned = plan.stations.world_R_hand @ MOUNT[0][:, 2] @ axis
    assert np.arccos(planned.min()) <= max(cone, np.radians(20.0)) + 1e-3


def camera_before_a_ball(stations, rng):
    """A survey of a depth camera 0.1 m beside the hand, before a plane and a ball of 0.1 m radius."""
    u = np.stack(np.meshgrid(*2 * [np.linspace(-0.4, 0.4, 12)], [1.0]), axis=-1).reshape(-1, 3)
    u /= np.linalg.norm(u, axis=1)[:, None]
    station, points = [], []
    for i, (R, t) in enumerate(zip(stations.world_R_hand, stations.world_t_hand, strict=True)):
        o, ray = t + 0.1 * R[:, 0], u @ R.T
        if stations.plane_labels[i] == "plane:A":
            s = -o[2] / ray[:, 2]
            good = (s > 0.0) & (s < 1.5)
        else:
            b = ray @ (o - [0.0, 0.0, 0.4])
            under = b**2 - ((o - [0.0, 0.0, 0.4]) ** 2).sum() + 0.01
            s, good = -b - np.sqrt(np.maximum(under, 0.0)), under > 0.0
        s += 1e-3 * rng.standard_normal(len(s))
        points.append(s[good, None] * u[good])
        station.append(np.full(good.sum(), i))
    shots = hl.Shots.points("camera", np.concatenate(station), np.concatenate(points), sigma=1e-3)
    return hl.Survey(stations, (shots,))


def test_rays_that_graze_a_ball_count_in_no_plan():
    rng, down = np.random.default_rng(0), np.diag([1.0, -1.0, -1.0])
    turned = down @ Rotation.from_rotvec(rng.uniform(-0.4, 0.4, (12, 3))).as_matrix()
    labels = ("plane:A",) * 6 + ("sphere:ball",) * 6
    aim = np.array([[0.0, 0.0, 0.4 * label.startswith("sphere")] for label in labels])
    away = rng.uniform(0.4, 0.6, (12, 1)) * turned[:, :, 2]
    first = hl.StationList(turned, aim - away - 0.1 * turned[:, :, 0], labels)
    found = hl.calibrate(camera_before_a_ball(first, rng), EXACT)
    plan = hl.plan(found, 5)
    assert "sphere:ball" in plan.stations.plane_labels
    after = hl.calibrate(camera_before_a_ball(first.joined(plan.stations), rng), EXACT)
    # Grazing rays would move most with the ball, but no calibration counts them.
    assert plan.forecast.spot[-1] == pytest.approx(after.sensors["camera"].spot_error, rel=0.15)


@pytest.mark.slow
@pytest.mark.parametrize("sensor", ["profiler", "camera"])
def test_what_is_promised_on_an_arm_that_errs_is_what_comes(sensor):
    """Of the stations that follow; if errors of the arm averaged away, it would be a quarter less."""
    scene = Scene(Case(sensor, False, True), 100)
    whole = scene.survey()
    before = np.arange(len(whole.stations)) % STOPS < STOPS // 2
    first = hl.calibrate(whole.part(before), scene.noise)
    known, rows = _Known(first, {("sensor", 0)}, hl.planning.Goal()), []
    for plate in range(4):
        look = _Look(first, [i for i in first._found.rows.items if i.target[1] == plate])
        at = ~before & (scene.plate == plate)
        poses = whole.stations.world_R_hand[at], whole.stations.world_t_hand[at]
        seen, said = look.rows(Stations(*poses, np.full(len(poses[0]), plate)))
        assert seen.all()
        rows.append(said)
    most = max(said.shape[1] for said in rows)
    every = np.concatenate([np.pad(x, ((0, 0), (0, most - x.shape[1]), (0, 0))) for x in rows])
    promised = known.forecast(every).spot
    assert promised[0] == pytest.approx(first.sensors["s"].spot_error, rel=1e-3)
    came = hl.calibrate(whole, scene.noise).sensors["s"].spot_error
    assert promised[-1] == pytest.approx(came, rel=0.1)
    independent = every.copy()
    independent[..., len(known.covariance) :] = 0.0
    assert known.forecast(independent).spot[-1] < 0.75 * came


def test_the_same_stations_again_leave_what_changes_with_the_pose():
    """Noise is halved by them, and errors that are the same at all stations stay as they are."""
    scene = Scene(Case("camera", False, True), 100)
    first = hl.calibrate(scene.survey(), scene.noise)
    known, rows = _Known(first, {("sensor", 0)}, hl.planning.Goal()), []
    for plate in range(4):
        look = _Look(first, [i for i in first._found.rows.items if i.target[1] == plate])
        of, at = scene.survey().stations, scene.plate == plate
        poses = of.world_R_hand[at], of.world_t_hand[at]
        rows.append(look.rows(Stations(*poses, np.full(len(poses[0]), plate)))[1])
    (mount,) = known.mounts
    moved = mount.spot @ known.covariance @ known.by_pose
    noise = 0.5 * mount.spot @ known.covariance @ mount.spot.T
    found = known.forecast(np.concatenate(rows)).spot[-1]
    assert found == pytest.approx(radius(noise + moved @ moved.T), rel=0.05)
    assert radius(moved @ moved.T) > 0.8 * found


def test_a_plan_ends_where_its_goal_is_reached():
    _, first = found_from_six(0.5)
    whole = hl.plan(first, 6)
    enough = hl.planning.Goal(spot=float(whole.forecast.spot[3]) * 1.001)
    plan = hl.plan(first, 6, goal=enough)
    assert plan.reached == len(plan) == len(plan.sensors) == 3
    for hard in (hl.planning.Goal(location_sigma=1e-9), hl.planning.Goal(direction_sigma=1e-9)):
        assert hl.plan(first, 6, goal=hard).reached is None
    assert whole.reached is None


@pytest.mark.slow
def test_cones_are_said_to_have_no_plan(handlaser, refusal, tmp_path):
    rig, made = tmp_path / "rig.toml", tmp_path / "made"
    rig.write_text("[noise]\nrange_sigma_mm = 1.0\n[sensor]\nhalf_angle_deg = 5\n")
    words = ["simulate", made, "--rig", rig, "--targets", "plane:A,sphere:S", "--beams", "1"]
    assert handlaser(*words, "--seed", "3")[0] == 0
    err = refusal("plan", made / "stations.csv", "--rig", rig)
    assert "found a survey of cones alone, which no stations are planned for" in err
    assert "add stations that lean by more than half_angle_deg" in err


def range_of(beam, target, R, t):
    """The range of a beam at a hand pose to a plane or a sphere; NaN where it misses it."""
    o, u, x = R @ beam.location + t, R @ beam.direction, np.array(list(target.values.values()))
    if target.kind == "plane":
        return -(x[:3] @ o + x[3]) / (x[:3] @ u)
    along = (x[:3] - o) @ u
    under = x[3] ** 2 - np.sum((x[:3] - o - along * u) ** 2)
    return along - math.sqrt(under) if under > 0.0 else np.nan


@pytest.mark.slow
def test_single_beams_are_planned_before_planes_and_spheres():
    """What the stations bring is what is promised, with readings by formulas of this file."""
    survey = survey_of(rigs_by_rays.beams(3, targets="planes+sphere"))
    found = hl.calibrate(survey, EXACT)
    plan = hl.plan(found, 8)
    known = plan.forecast
    for step, result in ((0, found), (-1, None)):
        if result is None:
            at = plan.stations
            poses = list(zip(at.world_R_hand, at.world_t_hand, at.plane_labels, strict=True))
            more = np.array(
                [
                    [range_of(beam, found.targets[label], R, t) for beam in found.beams.values()]
                    for R, t, label in poses
                ]
            )
            named = [survey.beam_names.index(name.removeprefix("beam ")) for name in plan.sensors]
            assert not np.isnan(more[np.arange(8), named]).any()
            k = np.array([beam.range_error for beam in found.beams.values()])
            more = 2.0 * more / (1 + k[:, 0] + np.sqrt((1 + k[:, 0]) ** 2 + 4 * k[:, 1] * more))
            so_far = survey.stations
            stations = hl.StationList(
                np.concatenate((so_far.world_R_hand, at.world_R_hand)),
                np.concatenate((so_far.world_t_hand, at.world_t_hand)),
                (*so_far.plane_labels, *at.plane_labels),
            )
            whole = replace(survey, stations=stations, ranges=np.concatenate((survey.ranges, more)))
            result = hl.calibrate(whole, EXACT)
        beams = result.beams.values()
        location = max(beam.location_sigma.max() for beam in beams)
        direction = max(beam.direction_sigma for beam in beams)
        # The noise is learned, and noise-free readings make it a little smaller.
        assert known.location_sigma[step] == pytest.approx(location, rel=0.1)
        assert known.direction_sigma[step] == pytest.approx(direction, rel=0.1)
    assert known.direction_sigma[-1] < 0.95 * known.direction_sigma[0]


@pytest.mark.slow
@needs_pinocchio
def test_an_arm_reaches_the_stations_of_a_survey(tmp_path):
    """Joints are at the poses, and nothing touches on the way, on a plate of the plan's own plane."""
    poses, first = found_from_six(0.4)
    R, t = map(np.array, zip(*poses, strict=True))
    home = Rotation.from_matrix(R).mean().as_matrix()
    base = t.mean(axis=0) + home @ [-0.3, 0.0, 0.1]
    robot = hl.planning.Robot(
        small_arm(tmp_path), "hand", home @ HANGING, base, clearance=0.002, plate_across=0.1
    )
    low, high = t.min(axis=0) - 0.05, t.max(axis=0) + 0.05
    here = Workspace(low, high, home, 0.5, robot=robot)
    plan = hl.plan(first, 3, workspace=here)
    at = plan.stations
    assert sum(map(bool, plan.sensors)) == len(plan.forecast) == 3 - plan.skipped >= 1
    reached_R, reached_t = robot.poses(at.joints)
    assert np.abs(reached_t - at.world_t_hand).max() < 1e-6
    assert np.abs(reached_R - at.world_R_hand).max() < 1e-6
    assert robot.free(at.joints).all()
    far = replace(here, robot=replace(robot, base_t=base + 3.0))
    with pytest.raises(hl.InputError, match="no place from which a sensor sees its target"):
        hl.plan(first, 3, workspace=far)


@pytest.mark.slow
@needs_pinocchio
def test_an_arm_before_several_targets_is_refused(tmp_path):
    """Its ways are checked against one plate, and all targets of a survey stand at once."""
    rng = np.random.default_rng(2)
    poses = list(looking(rng.uniform(-0.4, 0.4, (6, 2)), rng))
    survey = measured(poses, rng)
    labels = ("plane:A",) * 3 + ("plane:B",) * (len(survey.stations) - 3)
    of = hl.StationList(survey.stations.world_R_hand, survey.stations.world_t_hand, labels)
    several = hl.calibrate(replace(survey, stations=of), EXACT)
    low, high = -np.ones(3), np.ones(3)
    robot = hl.planning.Robot(small_arm(tmp_path), "hand", np.eye(3), np.zeros(3))
    here = Workspace(low, high, np.eye(3), robot=robot)
    with pytest.raises(hl.InputError, match=r"an arm before 2 targets .* one target"):
        hl.plan(several, 3, workspace=here)


@pytest.mark.parametrize("more", [{"criterion": "D"}, {"working_distance": 0.5}])
def test_what_a_goal_cannot_say_of_a_survey_is_refused(more):
    _, first = found_from_six(0.4)
    with pytest.raises(hl.InputError, match=r"criterion D or E, or working_distance_mm"):
        hl.plan(first, 3, goal=hl.planning.Goal(spot=1e-4, **more))


def test_what_is_of_beams_before_planes_is_refused():
    _, first = found_from_six(0.4)
    plate = hl.planning.Plate(np.zeros(3), NORMAL)
    given = ({"sensor": hl.Sensor()}, {"plates": {"B": plate}})
    for more in (*given, {"placement": hl.planning.Placement()}):
        with pytest.raises(hl.InputError, match="a sensor, plates or a placement for a survey"):
            hl.plan(first, 3, **more)


@pytest.mark.slow
def test_a_cone_beside_a_profiler_does_not_hide_what_is_planned(handlaser, tmp_path):
    """No stations are planned for cones: what is forecast, and reached, is of the profiler."""
    (tmp_path / "given.toml").write_text(
        '[sensor]\nhalf_angle_deg = 5.0\n[[sensors]]\nname = "p"\nkind = "profiler"\n'
    )
    words = ("--targets", "plane:A,sphere:b", "--beams", 1, "--seed", 1, "--stations", 12)
    assert handlaser("simulate", tmp_path / "out", "--rig", tmp_path / "given.toml", *words)[0] == 0
    survey = hl.read_survey(tmp_path / "out" / "stations.csv", tmp_path / "out" / "rig.toml")
    result = hl.calibrate(survey, hl.read_rig(tmp_path / "out" / "rig.toml").noise)
    assert result.status == "converged"
    plan = hl.plan(result, 3)
    assert plan.forecast.spot[0] == pytest.approx(result.sensors["p"].spot_error, rel=1e-5)
    assert plan.forecast.spot[-1] < 0.95 * plan.forecast.spot[0]


@pytest.mark.slow
@pytest.mark.usefixtures("once")
@pytest.mark.parametrize(("largest", "code"), [(30.0, 0), (1e-3, 3)])
def test_the_command_says_what_is_open_and_whether_the_stations_mend_it(
    largest, code, handlaser, tmp_path
):
    """A hand that is kept from turning leaves open what turns would determine."""
    rng = np.random.default_rng(3)
    R, t = map(np.array, zip(*looking([(0.1, 0.1)] * 8, rng), strict=True))
    survey = measured(list(zip(R, t, strict=True)), rng)
    stations = tmp_path / "stations.csv"
    write_stations(stations, survey.stations)
    shots = survey.shots[0]
    rows = (
        f"{survey.stations.station_names[s]},{1e3 * x:.9f},{1e3 * z:.9f}"
        for s, x, z in zip(shots.station, shots.across[:, 0], shots.reading, strict=True)
    )
    (tmp_path / "points.csv").write_text("\n".join(["station,x,z", *rows]) + "\n")
    box = [(1e3 * t.min(axis=0) - 300).tolist(), (1e3 * t.max(axis=0) + 300).tolist()]
    home = Rotation.from_matrix(R[0]).as_quat().tolist()
    rig = tmp_path / "rig.toml"
    rig.write_text(
        f"[noise]\npose_translation_sigma_mm = 0.02\npose_rotation_sigma_deg = 0.005\n"
        f"[workspace]\nbox_mm = {box}\nhome_quaternion = {home}\nlargest_turn_deg = {largest}\n"
        '[[sensors]]\nname = "profiler"\nkind = "profiler"\npoints = "points.csv"\n'
    )
    out = tmp_path / "next.csv"
    words = ["plan", str(stations), "--rig", str(rig), "--stations", "4"]
    ended, said, err = handlaser(*words, "--out", str(out), "--json")
    answer = json.loads(said)
    assert ended == code
    assert err.startswith("WARNING: the recording leaves open: ")
    assert "an estimate that may be far off" in err
    assert ("would still leave something open" in err) == (code == 3)
    assert len(hl.read_stations(out).station_names) == 4
    assert answer["spot_error_m"] is None
    assert answer["undetermined"]
    assert answer["determined"] == (code == 0)
    assert (answer["stations"][-1]["spot_error_m"] is None) == (code == 3)
    if code == 3:
        _, said, err_of_text = handlaser(*words)
        assert re.search(r"^ +0 +unknown +unknown +unknown$", said, re.MULTILINE)
        assert err_of_text == err


@pytest.mark.parametrize("second", ["scanner", "camera"])
def test_sensors_are_listed_by_station_where_there_are_several(second):
    """With one sensor each row would say the same, or what the list of stations has."""
    sphere, plate = "sphere:ball", "plane:plate"
    stations = hl.StationList(np.stack([np.eye(3)] * 3), np.zeros((3, 3)), (sphere, plate, sphere))
    forecast = hl.planning.Forecast(*np.ones((3, 4)), 0.2)
    sensors = ("scanner", "scanner", second)
    plan = hl.planning.Plan(stations, np.ones((3, 1)), np.ones((3, 1)), forecast, sensors=sensors)
    lines = plan_lines(plan, hl.planning.Goal(), None)
    rows = ["1. scanner before sphere:ball", "2. scanner before plane:plate"]
    rows.append(f"3. {second} before sphere:ball")
    assert [line for line in lines if line[1:3] == ". "] == (rows if second == "camera" else [])


@pytest.mark.slow
@pytest.mark.usefixtures("once")
def test_the_command(handlaser, refusal, tmp_path):
    poses, rig = (str(ROOT / "examples/profiler" / name) for name in ("poses.csv", "rig.toml"))
    out = tmp_path / "next.csv"
    code, said, _ = handlaser("plan", poses, "--rig", rig, "--stations", "3", "--out", out)
    assert code == 0
    assert said.startswith("3 stations: 3 of scanner before sphere:ball")
    assert "not checked: stand, plate and arm; there is no [workspace]" in said
    assert "3. scanner" not in said
    names = hl.read_stations(out).station_names
    assert len(names) == 3
    assert "qx qy qz qw" not in said
    _, said, _ = handlaser("plan", poses, "--rig", rig, "--stations", "3")
    x, y, z = hl.read_stations(out).world_t_hand[0] * 1e3
    assert "stations, hand poses world_T_hand (--out FILE writes them):" in said
    assert f"  {names[0]} before sphere:ball: ({x:.1f}, {y:.1f}, {z:.1f}) mm, qx qy qz qw" in said
    _, said, _ = handlaser("plan", poses, "--rig", rig, "--stations", "3", "--json")
    answer = json.loads(said)
    errors = [answer["spot_error_m"], *(one["spot_error_m"] for one in answer["stations"])]
    assert errors == sorted(errors, reverse=True)
    assert all(one["location_sigma_m"] > 0.0 for one in answer["stations"])
    assert [one["spot_m"] for one in answer["forecast"]] == errors
    assert (answer["format"], answer["reached"], answer["skipped"]) == (
        "handlaser-survey-plan",
        None,
        0,
    )
    assert "found --planes, with sensors of many rays" in refusal(
        "plan", poses, "--rig", rig, "--planes", "2"
    )
