"""Arms: poses found and refused, what touches, the way between stations, files."""

import itertools
import json
import math
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from arms import HANGING, HAS_PINOCCHIO, example_arm, small_arm
from helpers import GRIPPER, ROOT
from scipy.spatial.transform import Rotation

import handlaser_gtsam as hl
from benchmarks.planned_cell import ERR, SENSOR
from handlaser_gtsam.planning import plan as plan_module
from handlaser_gtsam.planning import route
from handlaser_gtsam.planning.belief import belief_of
from handlaser_gtsam.planning.route import driven
from handlaser_gtsam.planning.workspace import inside
from handlaser_gtsam.validation.scenes import SCENES, Layout
from handlaser_gtsam.validation.simulate import Stations, simulate

needs_pinocchio = pytest.mark.skipif(not HAS_PINOCCHIO, reason="needs pinocchio")
BASE = np.array([0.1, 0.1, 0.4])
ARMS = {
    "ur5": ("ur_description/urdf/ur5_robot.urdf", "tool0"),
    "panda": ("panda_description/urdf/panda.urdf", "panda_hand_tcp"),
}


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    return hl.planning.Robot(
        small_arm(tmp_path_factory.mktemp("arm")), "hand", HANGING, [0.2, 0.1, 0.5]
    )


def example(name):
    path = example_arm(ARMS[name][0])
    if path is None:
        pytest.skip("needs example-robot-data")
    return hl.planning.Robot(path, ARMS[name][1], HANGING, BASE, clearance=0.002)


def drawn(robot, count, seed=0):
    """Joints within the limits at which nothing touches."""
    low, high = robot.limits
    q = np.random.default_rng(seed).uniform(low, high, (4 * count, len(low)))
    return q[robot.free(q)][:count]


# --- joints of poses ---------------------------------------------------------------------------------


@needs_pinocchio
def test_the_joints_found_are_at_the_pose_and_within_the_limits(small):
    R, t = small.poses(drawn(small, 60))
    found = small.joints(R, t)
    good = ~np.isnan(found).any(axis=1)
    assert good.mean() >= 0.95  # every pose is reachable; a few are missed from all starts
    again_R, again_t = small.poses(found[good])
    assert np.abs(again_t - t[good]).max() < 1e-6
    assert np.abs(again_R - R[good]).max() < 1e-6
    low, high = small.limits
    assert ((found[good] >= low) & (found[good] <= high)).all()
    assert small.free(found[good]).all()
    assert (small.reachable(R, t) == good).all()


@pytest.mark.slow
@needs_pinocchio
@pytest.mark.parametrize("name", ARMS)
def test_arms_of_others_reach_their_own_poses(name):
    robot = example(name)
    R, t = robot.poses(drawn(robot, 60))
    found = robot.joints(R, t)
    good = ~np.isnan(found).any(axis=1)
    assert good.mean() >= 0.9
    again_R, again_t = robot.poses(found[good])
    assert np.abs(again_t - t[good]).max() < 1e-6
    assert np.abs(again_R - R[good]).max() < 1e-6


@needs_pinocchio
def test_the_hand_is_that_of_the_whole_arm_on_a_turned_base(tmp_path):
    """By pinocchio, of the arm with its finger and without a base, which is applied by hand."""
    import pinocchio

    path, turn = small_arm(tmp_path), Rotation.from_euler("xyz", [0.5, -0.3, 1.0]).as_matrix()
    robot = hl.planning.Robot(path, "hand", turn, [0.1, 0.2, 0.3])
    model = pinocchio.buildModelFromUrdf(path)
    data = model.createData()
    for q in drawn(robot, 5):
        named = dict(zip(robot.joint_names, q, strict=True))
        whole = [named.get(name, 0.0) for name in list(model.names)[1:]]
        whole = pinocchio.integrate(model, pinocchio.neutral(model), np.array(whole))
        pinocchio.framesForwardKinematics(model, data, whole)
        hand = data.oMf[model.getFrameId("hand")]
        (R,), (t,) = robot.poses(q)
        assert np.allclose(R, turn @ hand.rotation, atol=1e-12)  # rounding
        assert np.allclose(t, turn @ hand.translation + [0.1, 0.2, 0.3], atol=1e-12)


@needs_pinocchio
def test_the_jacobian_is_that_of_differences(small):
    arm, step = small._scene().arm, 1e-6
    for q in drawn(small, 5):
        (J,) = arm.hands(q[None])[2]
        for i, e in enumerate(step * np.eye(len(q))):
            (high_R, low_R), (high_t, low_t), _ = arm.hands(np.array([q + e, q - e]))
            turn = Rotation.from_matrix(high_R @ low_R.T).as_rotvec()
            # Central differences at 1e-6 err by rounding, 1e-10.
            assert np.allclose(J[:3, i], (high_t - low_t) / (2.0 * step), atol=1e-8)
            assert np.allclose(J[3:, i], turn / (2.0 * step), atol=1e-8)


@needs_pinocchio
@pytest.mark.parametrize("kind", ["prismatic", "revolute"])
def test_an_arm_may_have_a_single_joint(tmp_path, kind):
    path = tmp_path / "axis.urdf"
    path.write_text(
        '<robot name="axis"><link name="base"/><link name="hand"/>'
        f'<joint name="only" type="{kind}"><parent link="base"/><child link="hand"/>'
        '<origin xyz="0.1 0 0.2"/><axis xyz="1 0 0"/>'
        '<limit lower="0" upper="1" effort="1" velocity="1"/></joint></robot>'
    )
    robot = hl.planning.Robot(str(path), "hand")
    R, t = robot.poses(np.array([[0.3], [0.8]]))
    moved = np.array([0.3, 0.8]) if kind == "prismatic" else np.zeros(2)
    assert np.allclose(t, [0.1, 0.0, 0.2] + moved[:, None] * np.eye(3)[0], atol=1e-12)
    turned = Rotation.from_matrix(R).as_rotvec()[:, 0]
    assert np.allclose(turned, [0.0, 0.0] if kind == "prismatic" else [0.3, 0.8], atol=1e-12)
    assert np.allclose(robot.joints(R, t), [[0.3], [0.8]], atol=1e-8)


@needs_pinocchio
def test_joints_are_named_as_in_the_urdf_and_fingers_are_none(small):
    assert small.joint_names == ("rail", "pan", "lift", "elbow", "roll", "tilt", "flange")


@needs_pinocchio
def test_poses_out_of_reach_are_refused(small):
    far = small.base_t + np.array([[0.0, 0.0, -5.0], [0.0, 1.3, -0.3]])
    assert not small.reachable(np.tile(np.eye(3), (2, 1, 1)), far).any()


@needs_pinocchio
def test_poses_at_which_the_arm_meets_the_plate_are_refused(small):
    R, t = np.eye(3)[None], np.array([[0.5, 0.1, 0.4]])
    assert small.reachable(R, t).all()
    ahead = t[0] + [0.0, 0.0, 0.02]
    assert small.reachable(R, t, hl.planning.Plate(ahead, [0.0, 0.0, 1.0])).all()
    behind = t[0] - [0.0, 0.0, 0.06]
    assert not small.reachable(R, t, hl.planning.Plate(behind, [0.0, 0.0, 1.0])).any()
    # The finger is the nearest body to the plate: it ends 10 mm behind the hand's frame.
    for clearance, good in ((0.028, True), (0.032, False)):
        wide = replace(small, clearance=clearance)
        assert wide.reachable(R, t, hl.planning.Plate(ahead, [0.0, 0.0, 1.0])).all() == good


@needs_pinocchio
def test_an_arm_that_touches_itself_is_refused(small):
    folded = np.array([0.0, 0.0, 1.9, 2.6, 0.0, 2.2, 0.0])
    assert not small.free(folded).any()
    assert small.free(np.zeros(7)).all()
    assert not small.free_way(np.zeros(7), folded)
    assert small.free_way(np.zeros(7), np.array([0.2, 1.0, 0.5, 0.5, 0.0, 0.0, 0.0]))


# --- plans -------------------------------------------------------------------------------------------


@pytest.fixture(autouse=True)
def few_candidates(monkeypatch):
    """Let plans choose among 200 stations: joints of 1,200, as ever, take most of their time."""
    monkeypatch.setattr(plan_module, "POOL", 200)


@pytest.fixture(scope="module")
def recording():
    rng = np.random.default_rng(3)
    truth, stations = SCENES["paper"](Layout(planes=2, k1=0.01), rng)
    return simulate(truth, stations, ERR, rng, SENSOR)


@pytest.fixture(scope="module")
def calibrated(recording):
    return hl.calibrate(recording, ERR.stated(), hl.CalibrationOptions("k1", sensor=SENSOR))


def workspace(robot):
    return hl.planning.Workspace(
        [0.5, 0.0, 0.25], [0.7, 0.2, 0.5], np.eye(3), math.radians(25.0), robot=robot
    )


def check_drive(robot, stations, plates):
    """Check joints against poses, plate and limits, and the ways at other steps than the plan did."""
    R, t = robot.poses(stations.joints)
    assert np.abs(t - stations.world_t_hand).max() < 1e-6
    assert np.abs(R - stations.world_R_hand).max() < 1e-6
    low, high = robot.limits
    assert ((stations.joints >= low) & (stations.joints <= high)).all()
    assert stations.joint_names == robot.joint_names
    labels = stations.plane_labels
    for j, (joints, label) in enumerate(zip(stations.joints, labels, strict=True)):
        assert robot.free(joints, plates[label]).all(), stations.station_names[j]
        if j:
            plate = plates[label] if label == labels[j - 1] else None
            share = np.linspace(0.0, 1.0, 137)[:, None]
            along = stations.joints[j - 1] + share * (joints - stations.joints[j - 1])
            touching = ~replace(robot, clearance=robot.clearance / 2).free(along, plate)
            assert not touching.any(), stations.station_names[j]


@pytest.mark.slow
@needs_pinocchio
@pytest.mark.parametrize("name", ARMS)
def test_every_planned_station_is_reached_without_a_collision(name, calibrated):
    robot = example(name)
    here = workspace(robot)
    plan = hl.plan(calibrated, 12, SENSOR, here)
    assert (len(plan), plan.skipped) == (12, 0)
    assert len(plan.forecast) == len(plan)
    at = plan.stations
    index = np.zeros(len(at), dtype=np.intp)
    assert inside(here, Stations(at.world_R_hand, at.world_t_hand, index)).all()
    belief = belief_of(calibrated)
    check_drive(robot, at, dict(zip(belief.plane_names, belief.plates(), strict=True)))


@pytest.mark.slow
@needs_pinocchio
def test_joints_are_the_nearest_of_those_that_differ_by_full_turns():
    """A UR5 turns each joint by a turn to either side: half of the joints found were a turn off."""
    robot = example("ur5")
    near = drawn(robot, 1)[0] / 4.0  # within a quarter of a turn of zero
    at = replace(robot, start=near)
    R, t = robot.poses(drawn(robot, 40, seed=1))
    found = at.joints(R, t)
    good = ~np.isnan(found).any(axis=1)
    assert good.sum() > 30
    assert np.abs(found[good] - near).max() <= math.pi + 1e-9
    again_R, again_t = robot.poses(found[good])
    assert np.abs(again_R - R[good]).max() < 1e-6
    assert np.abs(again_t - t[good]).max() < 1e-6
    for joints in robot.solutions(R[0], t[0], None, near):
        assert np.abs(joints - near).max() <= math.pi + 1e-9


@needs_pinocchio
def test_a_pose_has_several_choices_of_joints_the_nearest_first(small):
    """From where the arm stands first, then in the order of how far the farthest joint moves."""
    near, plate = drawn(small, 1)[0], None
    R, t = (one[0] for one in small.poses(near))
    found = list(small.solutions(R, t, plate, near))
    assert len(found) > 2
    assert np.abs(found[0] - near).max() < 1e-6
    moves = [float(np.abs(joints - near).max()) for joints in found]
    assert moves == sorted(moves)
    for one, other in itertools.combinations(found, 2):
        assert np.abs(one - other).max() > 1e-4
    again_R, again_t = small.poses(np.array(found))
    assert np.abs(again_R - R).max() < 1e-6
    assert np.abs(again_t - t).max() < 1e-6
    assert small.free(np.array(found)).all()


@needs_pinocchio
def test_choices_of_joints_at_which_the_arm_touches_the_plate_are_passed_over(small):
    near = drawn(small, 1)[0]
    R, t = (one[0] for one in small.poses(near))
    every = np.array(list(small.solutions(R, t, None, near)))
    plate = hl.planning.Plate(small.base_t - [0.2, 0.0, 0.2], np.eye(3)[0])  # beside the arm
    free = small.free(every, plate)
    assert 0 < free.sum() < len(every)
    assert np.array_equal(list(small.solutions(R, t, plate, near)), every[free])


def heights(path, robot, joints):
    """Height of every joint of an arm in the world (N, J), by pinocchio and nothing of the package."""
    import pinocchio

    model = pinocchio.buildModelFromUrdf(path)
    data, found = model.createData(), []
    for q in joints:
        pinocchio.forwardKinematics(model, data, q)
        t = np.array([data.oMi[j].translation for j in range(1, model.njoints)])
        found.append((t @ robot.base_R.T + robot.base_t)[:, 2])
    return np.array(found)


@pytest.mark.slow
@needs_pinocchio
def test_nothing_but_the_first_link_may_be_below_the_table():
    """Of joints at which the arm touches nothing else, by the heights of its axes, on a tilted base."""
    path = example("ur5").urdf
    turn = Rotation.from_euler("xyz", [0.5, -0.3, 1.0]).as_matrix()
    without = hl.planning.Robot(path, "tool0", turn, [0.1, 0.2, 0.3], clearance=0.002)
    q = drawn(without, 150)
    lowest = heights(path, without, q)[:, 1:].min(axis=1)
    for level in (-0.3, 0.1):
        free = replace(without, table=level).free(q)
        assert not free[lowest < level - 0.01].any()
        assert free[
            lowest > level + 0.15
        ].all()  # no link is thicker, or reaches farther beyond its axis
        assert 10 < free.sum() < 140


@pytest.mark.slow
@needs_pinocchio
@pytest.mark.parametrize("knows", [True, False])
def test_no_move_leads_through_the_table(recording, knows, monkeypatch):
    """A UR5 that stands on a table, its hand looking down, 100 to 350 mm above it.

    Its links are thicker than 30 mm, so that no axis comes nearer to the table than that. Where the
    arm does not know of it, its hand leaves the box on no move between stations by more than 100 mm.
    """
    # Of 200 stations those that are chosen lead an arm that does not know of the table past it.
    monkeypatch.setattr(plan_module, "POOL", 400)
    turned = replace(
        recording,
        world_R_hand=HANGING @ recording.world_R_hand,
        world_t_hand=recording.world_t_hand @ HANGING,
    )
    options = hl.CalibrationOptions("k1", sensor=SENSOR)
    calibrated = hl.calibrate(turned, ERR.stated(), options)
    path, height = example("ur5").urdf, -0.6
    robot = hl.planning.Robot(
        path,
        ARMS["ur5"][1],
        base_t=[0.1, -0.1, height],
        start=[0.0, -1.4, 1.6, -1.8, -1.57, 0.0],
        clearance=0.002,
        table=height if knows else None,
    )
    low, high = [0.5, -0.2, -0.5], [0.7, 0.0, -0.25]
    where = hl.planning.Workspace(low, high, HANGING, math.radians(25.0), robot=robot)
    plan = hl.plan(calibrated, 8, SENSOR, where)
    assert len(plan) == 8
    joints = np.vstack((robot.start, plan.stations.joints))
    step, limits = np.diff(joints, axis=0), robot.limits
    nearer = joints[1:] - 2.0 * math.pi * np.sign(
        step
    )  # by a full turn, where a step is more than half
    beyond = (nearer < limits[0]) | (nearer > limits[1])
    assert ((np.abs(step) <= math.pi + 1e-9) | beyond).all()
    share = np.linspace(0.0, 1.0, 60)[:, None]
    for before, after in itertools.pairwise(joints):
        way = before + share * (after - before)
        if knows:
            assert heights(path, robot, way)[:, 2:].min() > height + 0.03
        t = robot.poses(way)[1]
        beyond = np.maximum(low - t, t - high).max(axis=1)
        if not knows and max(beyond[0], beyond[-1]) <= 0.0:
            assert beyond.max() < 0.1 + 1e-6


@pytest.mark.slow
@needs_pinocchio
def test_stations_without_a_way_are_replaced(small, calibrated, monkeypatch):
    """Ways are refused to all stations on one side, of which the best plan has some."""
    here, asked = workspace(replace(small, clearance=0.002, table=-2.0)), []

    def one_sided(robot, stations, workspace, plates):
        asked.append(stations)
        good = np.flatnonzero(stations.world_t_hand[:, 0] < 0.6)
        way, origin, joints = driven(robot, stations[good], workspace, plates)
        return way, np.where(origin < 0, -1, good[origin]), joints

    monkeypatch.setattr(route, "driven", one_sided)
    plan = hl.plan(calibrated, 8, SENSOR, here)
    assert (asked[0].world_t_hand[:, 0] >= 0.6).any()
    assert len(asked) > 1
    assert (len(plan), plan.skipped, len(plan.forecast)) == (8, 0, 8)
    read = ~np.isnan(plan.ranges).any(axis=1)
    assert (plan.stations.world_t_hand[read, 0] < 0.6).all()
    assert len(np.unique(plan.stations.world_t_hand[read].round(9), axis=0)) == 8
    assert plan.forecast.direction_sigma[-1] < plan.forecast.direction_sigma[0]


@pytest.mark.slow
@needs_pinocchio
@pytest.mark.parametrize("aside", [0.0, -0.005, 0.005, 0.01])
def test_a_first_motion_is_reached_too(small, aside):
    """From half of these bases the arm has no way to one of the stations that are chosen first."""
    rig = hl.read_rig(ROOT / "examples" / "planned" / "rig.toml")
    base = small.base_t + aside * np.eye(3)[0]
    robot = replace(small, base_t=base, clearance=0.002)
    here = replace(rig.workspace, robot=robot)
    plan = hl.planning.blind_motion(rig.bounds, rig.sensor, here, rig.noise)
    check_drive(here.robot, plan.stations, {"A": rig.bounds.plate})


@pytest.mark.slow
@needs_pinocchio
def test_a_first_motion_begins_with_joints_from_which_the_others_are_reached():
    """With the first joints that are found there is a way to 17 of 27 stations."""
    rig = hl.read_rig(ROOT / "examples" / "planned" / "rig.toml")
    here = replace(rig.workspace, robot=replace(example("ur5"), base_t=np.array([0.0, 0.0, 0.3])))
    plan = hl.planning.blind_motion(rig.bounds, rig.sensor, here, rig.noise)
    check_drive(here.robot, plan.stations, {"A": rig.bounds.plate})


@needs_pinocchio
@pytest.mark.parametrize("name", ["small", *ARMS])
def test_no_pose_of_the_arm_is_too_far(name, small):
    robot = small if name == "small" else example(name)
    arm = robot._scene().arm
    _, t = robot.poses(np.random.default_rng(0).uniform(*robot.limits, (3000, len(arm.low))))
    assert not arm.too_far(t).any()
    # With every link straightened out it would reach farther, but less than twice as far.
    farthest = np.linalg.norm(t - robot.base_t, axis=1).argmax()
    assert arm.too_far(robot.base_t + 2.0 * (t[farthest] - robot.base_t)[None]).all()


@needs_pinocchio
def test_an_arm_too_far_away_is_said(small, calibrated):
    far = replace(small, base_t=small.base_t + 3.0)
    with pytest.raises(hl.InputError, match="that the arm reaches without a collision"):
        hl.plan(calibrated, 4, SENSOR, workspace(far))


# --- files -------------------------------------------------------------------------------------------

TABLES = """
[workspace]
box_mm = [[500, 0, 250], [700, 200, 500]]
largest_turn_deg = 25

[robot]
urdf = "small.urdf"
frame = "hand"
base_mm = [200, 100, 500]
base_quaternion = [1, 0, 0, 0]
start_joints = [0, 0, 0.3, 1.0, 0, 0.6, 0]
clearance_mm = 2
"""


@pytest.fixture
def rig(tmp_path):
    small_arm(tmp_path)
    path = tmp_path / "rig.toml"
    path.write_text((GRIPPER / "rig.toml").read_text() + TABLES)
    return path


@pytest.mark.slow
@needs_pinocchio
def test_the_command_writes_joints_that_read_back(handlaser, rig, tmp_path):
    out = tmp_path / "stations.csv"
    code, text, err = handlaser(
        "plan", GRIPPER / "recording.csv", "--rig", rig, "--stations", 4, "--out", out, "--json"
    )
    assert (code, err) == (0, "")
    robot, found = hl.read_rig(rig).workspace.robot, hl.read_stations(out)
    assert out.read_text().splitlines()[0].endswith("qw," + ",".join(
        f"joint_{name}" for name in robot.joint_names
    ))  # fmt: skip
    _, t = robot.poses(found.joints)
    assert np.abs(t - found.world_t_hand).max() < 1e-6
    assert robot.free_way(robot.start, found.joints[0])
    printed = json.loads(text)
    assert printed["joint_names"] == list(robot.joint_names)
    assert [row["joints"] for row in printed["stations"]] == found.joints.tolist()
    hl.write_stations(tmp_path / "again.csv", found)
    again = hl.read_stations(tmp_path / "again.csv")
    assert (again.joints == found.joints).all()
    assert again.joint_names == found.joint_names


@pytest.mark.slow
@needs_pinocchio
@pytest.mark.parametrize("table", ["", "table_mm = -200\n"])
def test_the_answer_says_what_was_in_the_scene(handlaser, rig, table):
    rig.write_text(rig.read_text() + table)
    code, text, err = handlaser("plan", GRIPPER / "recording.csv", "--rig", rig, "--stations", 2)
    assert (code, err) == (0, "")
    said = " ".join(text.split())
    assert ("checked against the arm itself, the plate, the table at -200 mm" in said) == bool(
        table
    )
    assert ("not checked: the table (state table_mm in [robot])" in said) != bool(table)
    assert "cables and sensors that the URDF does not have" in said
    assert "start_joints" not in said


@needs_pinocchio
@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("small.urdf", "none.urdf", "robot.urdf"),
        ('"hand"', '"foot"', "robot.frame, one of base"),
        ("[0, 0, 0.3, 1.0, 0, 0.6, 0]", "[0, 0]", "one for each of rail"),
        ("[0, 0, 0.3, 1.0, 0, 0.6, 0]", "[9, 0, 0.3, 1.0, 0, 0.6, 0]", "beyond the limits"),
    ],
)
def test_what_is_wrong_with_the_arm_is_said_in_one_line(refusal, rig, old, new, words):
    rig.write_text(rig.read_text().replace(old, new))
    err = refusal("plan", GRIPPER / "recording.csv", "--rig", rig)
    assert words in " ".join(err.split())


def test_without_pinocchio_the_way_to_install_it_is_said(refusal, rig, monkeypatch):
    monkeypatch.setitem(sys.modules, "pinocchio", None)
    err = refusal("plan", GRIPPER / "recording.csv", "--rig", rig)
    assert "pip install 'handlaser-gtsam[robot]'" in " ".join(err.split())


@pytest.mark.slow
def test_nothing_of_pinocchio_is_imported_without_the_table():
    code = (
        "import sys, handlaser_gtsam as hl; rig = hl.read_rig('examples/planned/rig.toml'); "
        "hl.planning.blind_motion(rig.bounds, rig.sensor, rig.workspace, rig.noise); "
        "assert not {'pinocchio', 'coal', 'hppfcl'} & set(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], check=True, cwd=ROOT)


def test_the_plate_of_the_arm_is_that_of_the_first_motion(tmp_path):
    """Its size is stated in either table; that of [blind] counts for the spots where both have one."""
    blind = "[blind]\nlocation_mm = [[0, 0, 0]]\ndirection = [[0, 0, 1]]\n"
    blind += "plate_point_mm = [600, 100, 400]\nplate_normal = [0, 0, 1]\n"
    of_arm, own = "plate_across_mm = 250\n", "plate_across_mm = 200\n"
    across = []
    for text in (TABLES + blind, TABLES + of_arm + blind, TABLES + of_arm + blind + own):
        (tmp_path / "rig.toml").write_text(text)
        across.append(hl.read_rig(tmp_path / "rig.toml").bounds.plate.across)
    assert across == [None, 0.25, 0.2]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('[robot]\nurdf = "a"\nframe = "b"\n', r"\[robot\] without \[workspace\]"),
        (TABLES.replace("[1, 0, 0, 0]", "[1, 1, 0, 0]"), "robot.base_quaternion"),
        (TABLES.replace("clearance_mm = 2", "clearance_mm = -2"), "clearance"),
        (TABLES.replace('frame = "hand"', ""), "robot.frame"),
    ],
)
def test_tables_that_are_none(tmp_path, text, words):
    (tmp_path / "rig.toml").write_text(text)
    with pytest.raises(hl.InputError, match=words):
        hl.read_rig(tmp_path / "rig.toml")


def test_joints_of_a_list_of_stations():
    R, t = np.tile(np.eye(3), (2, 1, 1)), np.zeros((2, 3))
    good = hl.StationList(R, t, ("A", "A"), (), [[0.0, 1.0], [2.0, 3.0]], ("a", "b"))
    assert good.joints.shape == (2, 2)
    for joints, names in (
        ([[0.0, 1.0]], ("a", "b")),
        ([[0.0, 1.0], [2.0, np.nan]], ("a", "b")),
        ([[0.0, 1.0], [2.0, 3.0]], ("a", "a")),
        (None, ("a",)),
        ([[0.0], [1.0]], ()),
    ):
        with pytest.raises(hl.InputError):
            hl.StationList(R, t, ("A", "A"), (), joints, names)
