"""Every export is read back by something that shares nothing with its writer: the same beam to 1e-9."""

import ast
import re
import shlex
import subprocess
from io import BytesIO, StringIO
from math import radians
from xml.dom.minidom import parseString

import numpy as np
import pytest
import xacro
import yaml
import yourdfpy
from blark.parse import parse_source_code
from exported import (
    COMPILER,
    about_x,
    about_y,
    about_z,
    calibrated,
    directions,
    numbers,
    of_quaternion,
    of_vector,
    true_point,
    unit,
)

import handlaser_gtsam as hl
from handlaser_gtsam.files.exports.beams import smallest_rotation

V = directions()
FILE = calibrated(V)
LINK = hl.ExportOptions(link="tool0")
BARE = '<robot name="r"><link name="tool0"/>{}</robot>'


def frames_of(to, text):
    """Return name, R and t [m] of every frame in an export, by the conventions of its reader."""
    if to == "kuka":
        for name, rest in re.findall(r"^DECL GLOBAL FRAME (\w+)=\{(.*)\}$", text, re.MULTILINE):
            fields = dict(part.split(" ") for part in rest.split(","))
            x, y, z, a, b, c = (float(fields[key]) for key in "XYZABC")
            R = about_z(radians(a)) @ about_y(radians(b)) @ about_x(radians(c))
            yield name.lower(), R, np.array([x, y, z]) / 1e3
    if to == "abb":
        for name, rest in re.findall(r"^ *PERS tooldata (\w+):=(.*);$", text, re.MULTILINE):
            held, (at, turn), load = ast.literal_eval(rest.replace("TRUE", "True"))
            assert held is True
            assert load[0] > 0.0
            assert abs(np.linalg.norm(turn) - 1.0) < 1e-9
            yield name, of_quaternion(*turn), np.array(at) / 1e3
    if to == "fanuc":
        for block in re.findall(r"^P\[\d+\]\{.*?^\};", text, re.MULTILINE | re.DOTALL):
            fields = {k: float(n) for k, n in re.findall(r"\b([XYZWPR]) = (-?\d+\.\d+)", block)}
            R = about_z(radians(fields["R"])) @ about_y(radians(fields["P"]))
            t = np.array([fields[key] for key in "XYZ"]) / 1e3
            yield None, R @ about_x(radians(fields["W"])), t
    if to == "ur":
        for name, rest in re.findall(r"^global (\w+) = p\[(.*)\]$", text, re.MULTILINE):
            x, y, z, *turn = map(float, rest.split(","))
            yield name, of_vector(*turn), np.array([x, y, z])
    if to in ("urdf", "xacro"):
        if to == "xacro":
            call = text.replace("</robot>", '<link name="tool0"/><xacro:handlaser_beams/></robot>')
            document = parseString(call)
            xacro.process_doc(document)
            text = document.toxml().replace("<robot", '<robot name="r"', 1)
        else:
            text = BARE.format(text)
        robot = yourdfpy.URDF.load(BytesIO(text.encode()), load_meshes=False)
        assert robot.validate()
        for joint in robot.robot.joints:
            assert (joint.type, joint.parent) == ("fixed", "tool0")
            assert joint.name == f"{joint.child}_joint"
            pose = robot.get_transform(joint.child, "tool0")
            yield joint.child, pose[:3, :3], pose[:3, 3]
    if to == "ros2-yaml":
        for one in yaml.safe_load(text)["transforms"]:
            assert set(one) == {"header", "child_frame_id", "transform"}
            assert one["header"] == {"frame_id": "tool0"}
            t, q = one["transform"]["translation"], one["transform"]["rotation"]
            assert all(type(number) is float for number in (*t.values(), *q.values()))
            R = of_quaternion(q["w"], q["x"], q["y"], q["z"])
            yield one["child_frame_id"], R, np.array([t["x"], t["y"], t["z"]])
    if to == "ros2-static":
        for line in text.splitlines():
            words = shlex.split(line, comments=True)
            if words[:2] == ["ros2", "run"]:
                assert words[2:4] == ["tf2_ros", "static_transform_publisher"]
                assert words[-1] == "&"
                given = dict(zip(words[4:-1:2], words[5:-1:2], strict=True))
                assert given["--frame-id"] == "tool0"
                q = [float(given[f"--q{key}"]) for key in "wxyz"]
                t = np.array([float(given[f"--{key}"]) for key in "xyz"])
                yield given["--child-frame-id"], of_quaternion(*q), t


CASES = [
    *((to, "x", LINK, 0.0) for to in ("urdf", "xacro", "ros2-static", "ros2-yaml")),
    *((to, "z", hl.ExportOptions(), 0.0) for to in ("kuka", "abb", "ur")),
    ("fanuc", "z", hl.ExportOptions(tool=1), 0.0),
    *(
        (to, axis, hl.ExportOptions(axis=axis, at_reading=0.0153, tool=tool), 0.0153)
        for to, tool in (("kuka", None), ("abb", None), ("fanuc", 4), ("ur", None))
        for axis in "xyz"
    ),
]


@pytest.mark.parametrize(("to", "axis", "options", "reading"), CASES)
def test_frames_lie_along_the_beams(to, axis, options, reading):
    """Also where Euler angles lock, and beside the direction opposite to the axis."""
    found = list(frames_of(to, hl.export_text(FILE, to, options)))
    assert len(found) == len(V)
    a = "xyz".index(axis)
    for (name, R, t), beam, number in zip(found, FILE.beams, range(1, 99), strict=False):
        assert name in (f"laser_{number}", None)
        v = unit(np.array(beam.direction))
        assert np.abs(R[:, a] - v).max() < 1e-9
        k1, k2 = beam.range_error.k1, beam.range_error.k2_per_m
        along = reading + k1 * reading + k2 * reading**2
        assert np.abs(t - (np.array(beam.location_m) + along * v)).max() < 1e-9
        assert np.abs(R @ R.T - np.eye(3)).max() < 1e-9
        assert np.linalg.det(R) > 0.0
        # The trace tells the angle: no smaller turn takes the axis to the beam.
        assert np.trace(R) == pytest.approx(1.0 + 2.0 * v[a], abs=1e-9)


def test_the_roll_is_continuous_but_opposite_to_the_axis():
    rng = np.random.default_rng(0)
    for axis, a in zip("xyz", np.eye(3), strict=True):
        for v in map(unit, rng.normal(size=(200, 3))):
            step = 1e-7 * rng.normal(size=3)
            turned = smallest_rotation(axis, unit(v + step)) - smallest_rotation(axis, v)
            # The roll turns by tan(angle / 2) times the step at most.
            tangent = np.linalg.norm(v - a) / np.linalg.norm(v + a)
            assert np.abs(turned).max() <= 2.0 * (1.0 + tangent) * np.linalg.norm(step) + 1e-14
    assert np.diag(smallest_rotation("x", -np.eye(3)[0])).tolist() == [-1.0, 1.0, -1.0]
    assert np.diag(smallest_rotation("y", -np.eye(3)[1])).tolist() == [-1.0, -1.0, 1.0]
    assert np.diag(smallest_rotation("z", -np.eye(3)[2])).tolist() == [1.0, -1.0, -1.0]


def test_a_fanuc_program_sets_the_tools_it_was_told():
    text = hl.export_text(FILE, "fanuc", hl.ExportOptions(("3", "1"), tool=7))
    steps = [line.split(":", 1)[1].strip(" ;") for line in text.split("/POS")[0].splitlines()[5:]]
    done = [step for step in steps if not step.startswith("!")]
    assert done == ["PR[7]=P[1]", "UTOOL[7]=PR[7]", "PR[8]=P[2]", "UTOOL[8]=PR[8]"]
    assert all(len(step) <= 32 for step in steps)
    assert [one.split(",")[1].strip() for one in text.split("UF : 0")[1:]] == ["UT : 7", "UT : 8"]
    found = list(frames_of("fanuc", text))
    assert found[0][1][:, 2] == pytest.approx(V[2], abs=1e-9)
    assert found[1][1][:, 2] == pytest.approx(V[0], abs=1e-9)


# --- code --------------------------------------------------------------------------------------------

READINGS = [0.0, 0.013, 0.5, -0.004]
POSES = [
    ((0.4, -0.2, 1.1), (0.1, 0.2, -0.3, 0.9)),  # of any length
    ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 2.0)),
    ((-1.0, 3.0, 0.5), (0.6, 0.0, 0.8, 0.0)),
]
MEASURED = [
    (beam, number, reading, pose)
    for number, beam in enumerate(FILE.beams, 1)
    for reading in READINGS
    for pose in POSES
]


def expected(beam, reading, pose):
    t, q = pose
    x, y, z, w = unit(np.array(q))
    return true_point(beam, reading, np.array(t), of_quaternion(w, x, y, z))


def test_python_code_gives_the_points():
    space = {}
    exec(compile(hl.export_text(FILE, "python"), "beams.py", "exec"), space)
    assert "import" not in re.sub(r'""".*?"""', "", hl.export_text(FILE, "python"), flags=re.DOTALL)
    for beam, _, reading, pose in MEASURED:
        found = space["point_in_base"](beam.name, reading, *pose)
        assert np.abs(np.array(found) - expected(beam, reading, pose)).max() < 1e-9
        k = beam.range_error
        assert space["true_range"](beam.name, reading) == pytest.approx(
            reading + k.k1 * reading + k.k2_per_m * reading**2, abs=1e-15
        )


@pytest.mark.slow
@pytest.mark.skipif(COMPILER is None, reason="no C compiler")
def test_c_code_compiles_without_a_warning_and_gives_the_points(tmp_path):
    (tmp_path / "beams.h").write_text(hl.export_text(FILE, "c"))
    rows = []
    for _, number, reading, (t, q) in MEASURED:
        values = ", ".join(map(repr, (reading, *t, *q)))
        rows.append(f"    show(&laser_{number}, (double[]){{{values}}});")
    (tmp_path / "main.c").write_text(
        '#include <stdio.h>\n#include "beams.h"\n#include "beams.h"\n'
        "static void show(const handlaser_beam *beam, const double *in) {\n"
        "    double p[3];\n"
        "    handlaser_point_in_base(beam, in[0], in + 1, in + 4, p);\n"
        '    printf("%.17g %.17g %.17g %.17g\\n", p[0], p[1], p[2], handlaser_range(beam, in[0]));\n'
        "}\nint main(void) {\n" + "\n".join(rows) + "\n    return 0;\n}\n"
    )
    strict = ["-std=c99", "-pedantic", "-Wall", "-Wextra", "-Wconversion", "-Wshadow", "-Werror"]
    command = [COMPILER, *strict, "main.c", "-o", "main"]
    run = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
    out = subprocess.run([tmp_path / "main"], capture_output=True, text=True, check=True).stdout
    found = np.loadtxt(StringIO(out))
    assert len(found) == len(MEASURED)
    for row, (beam, _, reading, pose) in zip(found, MEASURED, strict=True):
        assert np.abs(row[:3] - expected(beam, reading, pose)).max() < 1e-9
        at_rest = true_point(beam, reading, np.zeros(3), np.eye(3)) - np.array(beam.location_m)
        assert row[3] == pytest.approx(at_rest @ unit(np.array(beam.direction)), abs=1e-12)


class Structure(dict):
    """What a dot reaches into."""

    __getattr__ = dict.__getitem__


def run_structured_text(text):
    """Return constants, and functions of the assignments in functions and blocks: enough of it."""
    text = re.sub(r"\(\*.*?\*\)", "", text, flags=re.DOTALL).replace("LREAL#", "")
    constants = {
        name: Structure(eval(f"dict({fields.replace(':=', '=')})"))
        for name, fields in re.findall(r"(\w+) : HANDLASER_BEAM := \((.*)\);", text)
    }
    functions = {}

    def made(body, outputs):
        # An assignment at the beginning of a statement; inside calls it names an argument.
        steps = [statement.strip().split(":=", 1) for statement in body.split(";")[:-1]]

        def call(**inputs):
            space = dict(inputs)
            for target, value in steps:
                space[target.strip()] = eval(value.strip().replace(":=", "="), functions, space)
            return tuple(space[one] for one in outputs)

        return call

    for kind, name, declared, body in re.findall(
        r"^(FUNCTION|FUNCTION_BLOCK) (\w+)(.*?END_VAR)\n((?:    \w+ := .*?;\n)+)END_\1$",
        text,
        re.MULTILINE | re.DOTALL,
    ):
        if kind == "FUNCTION":
            one = made(body, [name])
            functions[name] = lambda one=one, **inputs: one(**inputs)[0]
        else:
            outputs = re.search(r"VAR_OUTPUT(.*?)END_VAR", declared, re.DOTALL)[1]
            functions[name] = made(body, re.findall(r"(\w+) :", outputs))
    return constants, functions


def of_new_shape(text):
    """Without the beams whose numbers all have the shape of numbers before them, and with one digit
    of many: the parser takes seconds a page."""
    seen = set()

    def kept(lines):
        shapes = set(re.findall("LREAL#[^,)]*", re.sub(r"\d+", "0", lines[0])))
        new = not shapes <= seen
        seen.update(shapes)
        return lines[0] if new else ""

    found = re.sub(r"    \(\* beam .*\n    LASER_.*\n", kept, text)
    return re.sub(r"(?<=LREAL#)(-?\d+\.\d)\d*", r"\1", found)


@pytest.mark.slow
def test_structured_text_parses_and_gives_the_points():
    text = hl.export_text(FILE, "st")
    assert len(re.findall(" : HANDLASER_BEAM := ", text)) == len(V)
    few = of_new_shape(text)
    read = parse_source_code(few)
    assert read.exception is None
    kinds = [type(item).__name__ for item in read.transform().items]
    assert kinds == [
        "DataTypeDeclaration",
        "GlobalVariableDeclarations",
        "Function",
        "FunctionBlock",
    ]
    constants, functions = run_structured_text(text)
    assert len(constants) == len(V)
    for beam, number, reading, (t, q) in MEASURED:
        inputs = dict(zip(("PX", "PY", "PZ", "QX", "QY", "QZ", "QW"), (*t, *q), strict=True))
        held = constants[f"LASER_{number}"]
        found = functions["HANDLASER_POINT"](BEAM=held, READING=reading, **inputs)
        assert np.abs(np.array(found) - expected(beam, reading, (t, q))).max() < 1e-9


# --- what goes along ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("to", "options"),
    [
        *((to, LINK) for to in ("urdf", "xacro", "ros2-static", "ros2-yaml")),
        *((to, hl.ExportOptions()) for to in ("kuka", "abb", "ur", "c", "python", "st")),
        ("fanuc", hl.ExportOptions(tool=1)),
    ],
)
def test_the_sigma_of_every_beam_goes_along(to, options):
    text = hl.export_text(FILE, to, options)
    if to == "fanuc":
        text = " ".join(re.findall(r"!(.*?) ;", text))
    found = re.findall(
        r"beam (\d+): location \+- (\S+) (\S+) (\S+) mm, direction \+- (\S+) deg, "
        r"k1 (\S+) \+- (\S+), k2 (\S+) \+- (\S+) per m",
        text,
    )
    assert [row[0] for row in found] == [beam.name for beam in FILE.beams]
    for row, beam in zip(found, FILE.beams, strict=True):
        C = np.array(beam.covariance)
        location = np.sqrt(np.diag(C)[:3]) * 1e3
        turn = np.degrees(np.linalg.norm(C[3:6, 3:6], 2) ** 0.5)
        k1, k2 = np.sqrt(np.diag(C)[6:])
        wanted = [*location, turn, beam.range_error.k1, k1, beam.range_error.k2_per_m, k2]
        assert [float(one) for one in row[1:]] == pytest.approx(wanted, rel=0.05)
    assert hl.__version__ in text or to == "fanuc"


def test_terms_that_were_not_estimated_have_no_sigma():
    beams = [
        one.model_copy(update={"range_error_terms": i}) for i, one in enumerate(FILE.beams[:3])
    ]
    rows = [row[:24] for row in FILE.beam_covariance[:24]]
    few = FILE.model_copy(update={"beams": tuple(beams), "beam_covariance": tuple(rows)})
    lines = [line for line in hl.export_text(few, "c").splitlines() if line.startswith("// beam")]
    assert [("k1" in line, "k2" in line) for line in lines] == [
        (False, False),
        (True, False),
        (True, True),
    ]


def test_a_calibration_is_exported_as_its_file(tmp_path):
    """The numbers of a file are those of the calibration, to the last bit."""
    from helpers import GRIPPER

    recording = hl.read_recording(GRIPPER / "recording.csv")
    found = hl.calibrate(recording, hl.read_rig(GRIPPER / "rig.toml").noise)
    hl.write_calibration(tmp_path / "calibration.json", found)
    read = hl.read_calibration(tmp_path / "calibration.json")
    for to in ("kuka", "python"):
        assert hl.export_text(found, to) == hl.export_text(read, to)
    beam = found.beams["3"]
    row = next(row for row in hl.export_text(found, "ur").splitlines() if "laser_3 = " in row)
    assert numbers(row)[:3] == beam.location.tolist()
    hl.write_export(tmp_path / "beams.h", found, "c")
    assert (tmp_path / "beams.h").read_text() == hl.export_text(read, "c")
