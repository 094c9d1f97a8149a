"""Stations as robot programs and in conventions of controllers, read back by what is not ours."""

import csv
import re
import warnings
from dataclasses import replace
from io import StringIO
from itertools import pairwise

import numpy as np
import pytest
from controllers import CONTROLLERS, of_quaternion, rodrigues
from scipy.spatial.transform import Rotation

import handlaser_gtsam as hl
from handlaser_gtsam.model.conventions import FORMATS

with warnings.catch_warnings():
    warnings.simplefilter("ignore")  # RoboDK warns of its own name space
    from robodk import robomath

COUNT = 9
PROGRAMS = "krl", "rapid", "tp", "urscript"


def stations(joints=False):
    """Turns of every kind, also where Euler angles lock, and half turns; two on the way."""
    rng = np.random.default_rng(5)
    turns = [
        Rotation.from_euler("ZYX", [30.0, 90.0, 10.0], degrees=True),
        Rotation.from_euler("ZYX", [30.0, -90.0, 10.0], degrees=True),
        Rotation.from_rotvec([np.pi, 0.0, 0.0]),
        Rotation.identity(),
        *Rotation.random(COUNT - 4, rng=rng),
    ]
    names = ["1", "via 1", "2", "3", 'a "b"; END', "via 2", "7", "ü", "9"]
    names_of_joints = tuple(f"j{i}" for i in range(6)) if joints else ()
    return hl.StationList(
        np.stack([turn.as_matrix() for turn in turns]),
        rng.uniform(-0.9, 0.9, (COUNT, 3)),
        ("A", "A", "B, left", *"BBBCCC"),
        tuple(names),
        rng.uniform(-3.0, 3.0, (COUNT, 6)) if joints else None,
        names_of_joints,
    )


class Robot:
    """What a program told a robot: poses (4, 4) [m] or joints [rad], and where it set its output.

    Halts stand by the number of goals before them.
    """

    def __init__(self):
        self.goals, self.read, self.halts = [], [], []

    def halted(self):
        self.halts.append(len(self.goals))

    def goes(self, goal):
        self.goals.append(goal)
        self.read.append(False)


def pose(matrix):
    """A pose of RoboDK, in metres."""
    T = np.array(matrix.rows, dtype=float)
    T[:3, 3] /= 1e3
    return T


def driven(to, text):
    """Read a program line by line; the poses by RoboDK's formulas, URScript by Python itself."""
    robot = Robot()
    if to == "urscript":
        P = type("P", (), {"__getitem__": lambda _, row: pose(robomath.UR_2_Pose(milli(row)))})

        def output(number, on):
            assert number == 3
            robot.read[-1] |= on

        space = {
            "p": P(),
            "movel": lambda goal, a, v: robot.goes(goal),  # noqa: ARG005
            "movej": lambda goal, a, v: robot.goes(np.array(goal)),  # noqa: ARG005
            "sleep": lambda pause: None if pause == 0.5 else 1 / 0,
            "set_standard_digital_out": output,
            "popup": lambda text, title, blocking: robot.halted() if blocking else 1 / 0,  # noqa: ARG005
        }
        assert text.endswith("\nend\n")
        exec(text.removesuffix("end\n"), space)
        space["handlaser_stations"]()
        return robot
    number = r"(-?\d+\.\d+)"
    if to == "krl":
        for line in text.splitlines():
            values = [float(x) for x in re.findall(rf"[XYZABC1-6] {number}", line)]
            if line.startswith("LIN {"):
                robot.goes(pose(robomath.KUKA_2_Pose(values)))
            elif line.startswith("PTP {"):
                assert re.findall(r"A\d", line) == [f"A{i}" for i in range(1, 7)]
                robot.goes(np.radians(values))
            elif line == "$OUT[3]=TRUE":
                robot.read[-1] = True
            elif line == "HALT":
                robot.halted()
    if to == "rapid":
        goals = {}
        for kind, name, held in re.findall(r"CONST (\w+) (\w+):=(.*);", text):
            numbers = [
                [float(x) for x in one.split(",")] for one in re.findall(r"\[([^\[\]]+)\]", held)
            ]
            if kind == "robtarget":
                T = pose(robomath.quaternion_2_pose(numbers[1]))
                T[:3, 3] = np.array(numbers[0]) / 1e3
                goals[name] = T
            else:
                goals[name] = np.radians(numbers[0])
        for line in text.splitlines():
            words = line.split()
            if words and words[0] in ("MoveL", "MoveAbsJ"):
                robot.goes(goals[words[1].split(",")[0]])
            elif line.strip() == "SetDO do3,1;":
                robot.read[-1] = True
            elif line.strip() == "Stop;":
                robot.halted()
    if to == "tp":
        steps, held = text.split("/POS")
        goals = {}
        for block in re.findall(r"^P\[(\d+)\]\{(.*?)^\};", held, re.MULTILINE | re.DOTALL):
            fields = {k: float(x) for k, x in re.findall(r"\b([XYZWPR]) = (-?\d+\.\d+)", block[1])}
            goals[block[0]] = pose(robomath.Fanuc_2_Pose([fields[key] for key in "XYZWPR"]))
        for line in steps.splitlines():
            step = line.split(":", 1)[-1].strip(" ;")
            if step.startswith("L P["):
                robot.goes(goals[re.match(r"L P\[(\d+)\] 100mm/sec FINE$", step)[1]])
            elif step == "DO[3]=ON":
                robot.read[-1] = True
            elif step == "PAUSE":
                robot.halted()
    return robot


def milli(row):
    return [*(1e3 * np.array(row[:3])), *row[3:]]


@pytest.mark.parametrize("joints", [False, True], ids=["lines", "joints"])
@pytest.mark.parametrize("to", PROGRAMS)
def test_programs_drive_to_the_stations_and_stop_where_something_is_read(to, joints):
    plan = stations(joints)
    text = hl.export_text(plan, to, hl.ExportOptions(signal=3, pause=0.5))
    robot = driven(to, text)
    assert len(robot.goals) == COUNT
    assert robot.read == [not name.startswith("via") for name in plan.station_names]
    for goal, R, t, q in zip(
        robot.goals, plan.world_R_hand, plan.world_t_hand, stations(True).joints, strict=True
    ):
        if joints and to != "tp":
            assert np.abs(goal - q).max() < 1e-9
        else:
            assert np.abs(goal[:3, :3] - R).max() < 1e-6
            assert np.abs(goal[:3, 3] - t).max() < 1e-6


@pytest.mark.parametrize("to", PROGRAMS)
def test_programs_halt_where_a_plate_may_have_to_be_moved(to):
    """Before the way to the next plane, and again at its end; not between targets that stand."""
    plan = stations()
    names = "1", "via 1", "via 2", "via 3", "2", "3", "4", "via 4", "5"
    on_the_way = replace(plan, plane_labels=tuple("AAABBBCCA"), station_names=names)
    options = hl.ExportOptions(signal=3, pause=0.5)
    assert driven(to, hl.export_text(on_the_way, to, options)).halts == [3, 4, 6, 8]
    kinds = {"A": "plane:A", "B": "sphere:B", "C": "point:C"}
    standing = replace(on_the_way, plane_labels=tuple(map(kinds.get, on_the_way.plane_labels)))
    assert driven(to, hl.export_text(standing, to, options)).halts == []


def test_an_arm_of_seven_joints_moves_along_lines():
    plan = stations()
    seven = hl.StationList(
        plan.world_R_hand, plan.world_t_hand, plan.plane_labels, plan.station_names,
        np.zeros((COUNT, 7)), tuple("abcdefg"),
    )  # fmt: skip
    assert "LIN {" in hl.export_text(seven, "krl")
    assert "PTP {" not in hl.export_text(seven, "krl")


@pytest.mark.parametrize("to", PROGRAMS)
def test_no_name_breaks_out_of_its_comment(to):
    """Every line but the comments is the same whatever the names."""
    plan = stations()
    names = [
        f"via {i}" if name.startswith("via") else str(i)
        for i, name in enumerate(plan.station_names)
    ]
    labels = tuple("AADBBBCCC")
    plain = hl.StationList(plan.world_R_hand, plan.world_t_hand, labels, tuple(names))
    comment = {"krl": ";", "rapid": "!", "tp": "!", "urscript": "#"}[to]

    def code(one):
        lines = hl.export_text(one, to).splitlines()
        lines = [re.sub(r"^ *\d+: *", "", line).strip() for line in lines]
        return [line for line in lines if not line.startswith(comment)]

    assert code(plan) == code(plain)
    assert hl.export_text(plan, to).isascii()


@pytest.mark.parametrize(
    ("to", "words"),
    [
        ("krl", "; station s:1, target sphere:ball"),
        ("rapid", "! station s:1, target sphere:ball"),
        ("urscript", "# station s:1, target sphere:ball"),
        ("tp", "!station s 1, target sphere"),
    ],
)
def test_a_colon_stands_in_comments_that_allow_it(to, words):
    plan = hl.StationList([np.eye(3)] * 2, np.zeros((2, 3)), ("sphere:ball", "A"), ("s:1", "s:2"))
    text = hl.export_text(plan, to)
    assert words in text
    assert "U+003A" not in text
    assert ", plane A" in text


def test_remarks_of_fanuc_are_short():
    for line in hl.export_text(stations(), "tp").splitlines():
        if "!" in line:
            assert len(line.split("!")[1].rstrip(" ;")) <= 30


@pytest.mark.parametrize("name", FORMATS)
def test_poses_have_the_convention_of_their_controller(name, tmp_path):
    """By the formulas of the tests where they have that controller, and as a log that is read back."""
    plan = stations()
    text = hl.export_text(plan, "poses", hl.ExportOptions(pose_format=name))
    header, *rows = csv.reader(StringIO(text))
    assert [row[0] for row in rows] == list(plan.plane_labels)
    assert [row[1] for row in rows] == list(plan.station_names)
    how = CONTROLLERS.get(name)
    for row, R, t in zip(rows, plan.world_R_hand, plan.world_t_hand, strict=True):
        x = np.array([float(cell) for cell in row[2:]])
        if how is None:
            continue
        if how.whole:
            T = x.reshape(4, 4) if how.whole == "rows" else x.reshape(4, 4).T
        else:
            turn = x[3:] / (1.0 if how.matrix is of_quaternion else how.per_radian)
            if how.matrix is of_quaternion and name != "abb":
                turn = np.roll(turn, 1)
            T = np.eye(4)
            T[:3, :3], T[:3, 3] = how.matrix(*turn), x[:3]
        assert np.abs(T[:3, :3] - R).max() < 1e-9
        assert np.abs(T[:3, 3] / how.length - t).max() < 1e-9
    if name == "tum":  # a file of TUM has no header
        return
    ranges = "\n".join(f"{line},0.{i + 1}" for i, line in enumerate(text.splitlines()[1:]))
    path = tmp_path / "log.csv"
    path.write_text(f"{','.join(header)},range_1\n{ranges}\n")
    read = hl.read_log(path, hl.LogFormat(pose_format=name, as_stated=True))
    assert np.abs(read.world_R_hand - plan.world_R_hand).max() < 1e-9
    assert np.abs(read.world_t_hand - plan.world_t_hand).max() < 1e-9
    assert read.plane_labels == plan.plane_labels


def test_rodrigues_is_what_the_tests_take_for_rotation_vectors():
    assert CONTROLLERS["ur"].matrix is rodrigues


def test_the_command_writes_programs_of_planned_stations(handlaser, tmp_path):
    hl.write_stations(tmp_path / "next.csv", stations())
    out = tmp_path / "stations.src"
    code, printed, err = handlaser(
        "export", tmp_path / "next.csv", "--to", "krl", "--signal", "3", "--pause-s", "0.5",
        "--out", out,
    )  # fmt: skip
    assert (code, printed, err) == (0, f"wrote {out}\n", "")
    assert len(driven("krl", out.read_text()).goals) == COUNT
    assert all(a != b for a, b in pairwise(out.read_text().splitlines()))


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--to", "poses"), "no pose format"),
        (("--to", "poses", "--pose-format", "kukka"), "kuka"),
        (("--to", "krl", "--beam", "1"), "beams with the format krl"),
        (("--to", "krl", "--signal", "-1"), "signal"),
        (("--to", "tp", "--pause-s", "1000"), "pause"),
        (("--to", "kuka"), "kuka takes a calibration"),
    ],
)
def test_what_stations_cannot_be_is_said_in_one_line(refusal, tmp_path, options, words):
    hl.write_stations(tmp_path / "next.csv", stations())
    assert words in refusal("export", tmp_path / "next.csv", *options)


def test_a_calibration_is_no_program():
    with pytest.raises(hl.InputError, match="StationList"):
        hl.export_text(3, "krl")
