"""Logs of controllers and spreadsheets: conventions, tables, and what is refused."""

import inspect
import json
import math
import re
import shlex
import zipfile
from dataclasses import fields, replace
from typing import get_args
from xml.sax.saxutils import escape

import numpy as np
import polars as pl
import pytest
from controllers import CONTROLLERS, about_z_y_x, written
from helpers import GRIPPER, ROOT

import handlaser_gtsam as hl
from benchmarks.log_conventions import (
    RESIDUAL,
    SAME,
    UNNOTICED,
    WARNED,
    log_recording,
    matrix,
    meanings,
    numbers,
    study,
)
from handlaser_gtsam.cli.convert import Log
from handlaser_gtsam.files.rig_toml import LogTable, with_log_table
from handlaser_gtsam.model.conventions import ANGLES, FORMATS, formats_of


def text_of(names, rows, extra=(), separator=","):
    """A table as text, every number with all its digits."""
    heads = [*names, *(name for name, _ in extra)]
    lines = [separator.join(heads)]
    for i, row in enumerate(rows):
        cells = [repr(float(x)) for x in row]
        cells += [str(column[i]) for _, column in extra]
        lines.append(separator.join(cells))
    return "\n".join(lines) + "\n"


def assert_poses(recording, R, t):
    assert np.abs(recording.world_R_hand - R).max() < 1e-9
    assert np.abs(recording.world_t_hand - t).max() < 1e-9


def readings_of(R, t):
    """Readings of one beam from hand poses to a plane far above [m], by the formula."""
    n, r, v = np.array([0.1, -0.2, 1.0]), np.array([0.02, -0.03, 0.05]), np.array([0.1, 0.2, 0.9])
    n, v = n / math.sqrt(n @ n), v / math.sqrt(v @ v)
    return (5.0 - (t + R @ r) @ n) / ((R @ v) @ n)


# --- conventions -------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", CONTROLLERS)
def test_poses_of_controllers_are_read_as_their_manuals_say(tmp_path, name):
    rng = np.random.default_rng(list(CONTROLLERS).index(name))
    rows, R, t = written(name, rng, 20)
    path = tmp_path / "log.csv"
    path.write_text(text_of(CONTROLLERS[name].names, rows, [("range_1", [0.1] * 20)]))
    found = hl.read_log(path, hl.LogFormat(pose_format=name, plane="wall"))
    assert_poses(found, R, t)


def test_every_format_is_written_by_a_controller_or_means_the_same_as_one():
    meanings = {FORMATS[name].meaning for name in CONTROLLERS}
    assert {one.meaning for one in FORMATS.values()} == meanings
    assert len(CONTROLLERS) >= 12


def test_every_format_stands_on_the_page():
    page = (ROOT / "docs" / "logs.md").read_text()
    assert [name for name in FORMATS if f"`{name}`" not in page] == []


@pytest.mark.parametrize("name", ["kuka", "abb", "franka", "ur"])
def test_a_convention_spelled_out_is_the_same_as_its_name(tmp_path, name):
    rows, R, t = written(name, np.random.default_rng(3), 10)
    path = tmp_path / "log.csv"
    columns = [f"c{i}" for i in range(rows.shape[1])]
    path.write_text(text_of(columns, rows, [("range_1", [0.1] * 10)]))
    rotation, units, angles = FORMATS[name].meaning
    spelled = hl.LogFormat(
        rotation=rotation,
        units=units,
        angles=angles if FORMATS[name].has_angles else None,
        pose_columns=tuple(columns),
        plane="wall",
    )
    assert_poses(hl.read_log(path, spelled), R, t)


def test_tool_and_base_are_taken_off_and_added(tmp_path):
    """The log has base_T_tool; the flange in the robot's frame is asked for."""
    rows, R, t = written("kuka", np.random.default_rng(5), 12)
    path = tmp_path / "log.csv"
    path.write_text(text_of(CONTROLLERS["kuka"].names, rows, [("range_1", [0.1] * 12)]))
    tool_R, tool_t = about_z_y_x(0.3, -0.2, 0.1), np.array([0.01, -0.02, 0.15])
    base_R, base_t = about_z_y_x(1.0, 0.2, -0.4), np.array([0.5, 0.3, -0.1])
    deg = 180.0 / math.pi
    given = hl.LogFormat(
        pose_format="kuka",
        plane="wall",
        tool=(10.0, -20.0, 150.0, 0.3 * deg, -0.2 * deg, 0.1 * deg),
        base=(500.0, 300.0, -100.0, 1.0 * deg, 0.2 * deg, -0.4 * deg),
    )
    flange_R = R @ tool_R.T
    flange_t = t - flange_R @ tool_t
    assert_poses(hl.read_log(path, given), base_R @ flange_R, flange_t @ base_R.T + base_t)


def test_inverted_poses_are_inverted_back(tmp_path):
    rows, R, t = written("fanuc", np.random.default_rng(6), 12)
    path = tmp_path / "log.csv"
    path.write_text(text_of(CONTROLLERS["fanuc"].names, rows, [("range_1", [0.1] * 12)]))
    found = hl.read_log(path, hl.LogFormat(pose_format="fanuc", plane="wall", inverted=True))
    assert_poses(found, np.swapaxes(R, 1, 2), -np.einsum("mji,mj->mi", R, t))


# --- tables ------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def kuka():
    """A log of readings that fit, in millimetres and degrees, and what it means."""
    rng = np.random.default_rng(7)
    rows, R, t = [], [], []
    for _ in range(30):
        angles = np.array([1.0, 0.3, -0.5]) + rng.uniform(-0.4, 0.4, 3)
        R.append(about_z_y_x(*angles))
        t.append(rng.uniform(-0.3, 0.3, 3))
        rows.append([*(1e3 * t[-1]), *(angles * 180.0 / math.pi)])
    R, t = np.array(R), np.array(t)
    return np.array(rows), R, t, readings_of(R, t)


KUKA = ("X", "Y", "Z", "A", "B", "C")


def kuka_text(kuka, separator=",", names=KUKA, range_name="range_1"):
    rows, _, _, d = kuka
    extra = [(range_name, [repr(float(1e3 * x)) for x in d])]
    return text_of(names, rows, extra, separator)


FORMAT = {"pose_format": "kuka", "plane": "wall", "range_units": "mm"}


def sheet(names, rows):
    """A workbook with one sheet, as Office Open XML by hand."""

    def cell(x):
        if isinstance(x, str):
            return f'<c t="inlineStr"><is><t>{escape(x)}</t></is></c>'
        return f"<c><v>{x!r}</v></c>"

    lines = [list(names), *[[float(x) for x in row] for row in rows]]
    body = "".join(
        f'<row r="{i + 1}">{"".join(map(cell, line))}</row>' for i, line in enumerate(lines)
    )
    main = "http://schemas.openxmlformats.org/spreadsheetml/2006/main"
    office = "http://schemas.openxmlformats.org/officeDocument/2006/relationships"
    package = "http://schemas.openxmlformats.org/package/2006"
    kind = "application/vnd.openxmlformats-officedocument.spreadsheetml"
    return {
        "[Content_Types].xml": f'<Types xmlns="{package}/content-types"><Default Extension="rels" '
        f'ContentType="application/vnd.openxmlformats-package.relationships+xml"/><Override '
        f'PartName="/xl/workbook.xml" ContentType="{kind}.sheet.main+xml"/><Override '
        f'PartName="/xl/worksheets/sheet1.xml" ContentType="{kind}.worksheet+xml"/></Types>',
        "_rels/.rels": f'<Relationships xmlns="{package}/relationships"><Relationship Id="r1" '
        f'Type="{office}/officeDocument" Target="xl/workbook.xml"/></Relationships>',
        "xl/workbook.xml": f'<workbook xmlns="{main}" xmlns:r="{office}"><sheets><sheet name="Log" '
        'sheetId="1" r:id="r1"/></sheets></workbook>',
        "xl/_rels/workbook.xml.rels": f'<Relationships xmlns="{package}/relationships"><Relationship '
        f'Id="r1" Type="{office}/worksheet" Target="worksheets/sheet1.xml"/></Relationships>',
        "xl/worksheets/sheet1.xml": f'<worksheet xmlns="{main}"><sheetData>{body}</sheetData>'
        "</worksheet>",
    }


def write_sheet(path, names, rows):
    with zipfile.ZipFile(path, "w") as file:
        for name, text in sheet(names, rows).items():
            file.writestr(name, '<?xml version="1.0" encoding="UTF-8"?>' + text)


@pytest.mark.parametrize("kind", ["csv", "tsv", "german", "space", "parquet", "jsonl", "xlsx"])
def test_tables_of_all_kinds_are_the_same(tmp_path, kuka, kind):
    rows, R, t, d = kuka
    path = tmp_path / f"log.{kind if kind in ('parquet', 'jsonl', 'xlsx') else 'csv'}"
    table = np.column_stack((rows, 1e3 * d))
    names = [*KUKA, "range_1"]
    if kind == "parquet":
        pl.DataFrame(table, schema=names, orient="row").write_parquet(path)
    elif kind == "jsonl":
        lines = [json.dumps(dict(zip(names, row, strict=True))) for row in table.tolist()]
        path.write_text("\n".join(lines) + "\n")
    elif kind == "xlsx":
        pytest.importorskip("fastexcel")
        write_sheet(path, names, table)
    elif kind == "german":
        path.write_text(kuka_text(kuka, ";").replace(".", ","))
    else:
        path.write_text(kuka_text(kuka, {"csv": ",", "tsv": "\t", "space": "   "}[kind]))
    found = hl.read_log(path, hl.LogFormat(**FORMAT))
    assert_poses(found, R, t)
    assert np.abs(found.ranges[:, 0] - d).max() < 1e-12
    assert found.plane_names == ("wall",)
    assert found.station_names == tuple(str(i + 1) for i in range(30))


def test_our_own_recordings_are_logs_too():
    path = GRIPPER / "recording.csv"
    assert hl.read_log(path) == hl.read_recording(path)


def test_arrays_and_structures_of_json_lines(tmp_path):
    """O_T_EE as an array of 16, and a PoseStamped as a structure."""
    rows, R, t = written("franka", np.random.default_rng(2), 8)
    franka, ros = tmp_path / "franka.jsonl", tmp_path / "ros.jsonl"
    objects = [{"O_T_EE": row, "range_a": 0.1} for row in rows.tolist()]
    franka.write_text("\n".join(map(json.dumps, objects)))
    assert_poses(hl.read_log(franka, hl.LogFormat(pose_format="franka", plane="A")), R, t)
    rows, R, t = written("ros", np.random.default_rng(2), 8)
    objects = [
        {
            "pose": {
                "position": dict(zip("xyz", row[:3], strict=True)),
                "orientation": dict(zip("xyzw", row[3:], strict=True)),
            },
            "range_a": 0.1,
        }
        for row in rows.tolist()
    ]
    ros.write_text("\n".join(map(json.dumps, objects)))
    assert_poses(hl.read_log(ros, hl.LogFormat(plane="A")), R, t)


def test_a_long_table_has_one_row_a_reading(tmp_path, kuka):
    rows, R, t, d = kuka
    lines = ["station," + ",".join(KUKA) + ",sensor,value"]
    for i, row in enumerate(rows):
        for beam, shift in (("left", 0.0), ("right", 5.0)):
            if (i, beam) != (3, "right"):
                pose = ",".join(repr(float(x)) for x in row)
                lines.append(f"P{i},{pose},{beam},{float(1e3 * d[i] + shift)!r}")
    path = tmp_path / "log.csv"
    path.write_text("\n".join(lines) + "\n")
    given = hl.LogFormat(**FORMAT, beam_column="sensor", range_column="value")
    found = hl.read_log(path, given)
    assert found.beam_names == ("left", "right")
    assert found.station_names == tuple(f"P{i}" for i in range(30))
    assert_poses(found, R, t)
    assert np.abs(found.ranges[:, 0] - d).max() < 1e-12
    assert np.flatnonzero(np.isnan(found.ranges[:, 1])).tolist() == [3]


def test_columns_are_mapped_by_name(tmp_path, kuka):
    names = ("X_act", "Y_act", "Z_act", "A_act", "B_act", "C_act")
    path = tmp_path / "log.csv"
    path.write_text(kuka_text(kuka, names=names, range_name="AI 1"))
    given = hl.LogFormat(**FORMAT, pose_columns=names, range_columns=("front=AI 1",))
    found = hl.read_log(path, given)
    assert found.beam_names == ("front",)
    assert_poses(found, kuka[1], kuka[2])
    with pytest.raises(hl.InputError, match="no column 'AI 2' among X_act"):
        hl.read_log(path, hl.LogFormat(**FORMAT, pose_columns=names, range_columns=("AI 2",)))


def test_a_file_without_header_and_with_comments(tmp_path):
    rows, R, t = written("ros", np.random.default_rng(4), 9)
    path = tmp_path / "poses.txt"
    lines = [f"{0.5 * i} " + " ".join(repr(float(x)) for x in row) for i, row in enumerate(rows)]
    path.write_text("# a trajectory\n" + "\n".join(lines) + "\n")
    readings = tmp_path / "readings.csv"
    readings.write_text("time,range_1\n" + "".join(f"{0.5 * i + 0.01},0.2\n" for i in range(9)))
    given = hl.LogFormat(pose_format="tum", readings=readings, tolerance_s=0.05, plane="A")
    assert_poses(hl.read_log(path, given), R, t)


@pytest.mark.parametrize("separator", [",", " ", ";", ", "])
@pytest.mark.parametrize("header", [True, False])
def test_a_tum_file_may_have_a_header_and_other_separators(tmp_path, separator, header):
    rows, R, t = written("ros", np.random.default_rng(4), 9)
    lines = [[f"{0.5 * i}", *(repr(float(x)) for x in row)] for i, row in enumerate(rows)]
    names = [["time", "x", "y", "z", "qx", "qy", "qz", "qw"]] if header else []
    path, readings = tmp_path / "poses.txt", tmp_path / "readings.csv"
    path.write_text("\n".join(separator.join(line) for line in [*names, *lines]))
    readings.write_text("time,range_1\n" + "".join(f"{0.5 * i + 0.01},0.2\n" for i in range(9)))
    given = hl.LogFormat(pose_format="tum", readings=readings, tolerance_s=0.05, plane="A")
    assert_poses(hl.read_log(path, given), R, t)


def test_planes_by_stations_by_column_and_by_file(tmp_path, kuka):
    path = tmp_path / "log.csv"
    path.write_text(kuka_text(kuka))
    known = {"pose_format": "kuka", "range_units": "mm"}
    ranges = ("A=1..10", "B=11..29")
    found = hl.read_log(path, hl.LogFormat(**known, plane_ranges=ranges))
    assert found.plane_labels == ("A",) * 10 + ("B",) * 19
    assert [one.code for one in found.warnings] == ["stations-left-out"]
    (tmp_path / "planes.csv").write_text("plane,from,to\nA,1,10\nB,11,29\n")
    by_file = hl.read_log(path, hl.LogFormat(**known, plane_file=tmp_path / "planes.csv"))
    assert by_file == found
    rows = kuka_text(kuka).splitlines()
    labelled = [rows[0] + ",wall"] + [f"{line},w{i % 2}" for i, line in enumerate(rows[1:])]
    path.write_text("\n".join(labelled) + "\n")
    found = hl.read_log(path, hl.LogFormat(**known, plane_column="wall"))
    assert found.plane_names == ("w0", "w1")


@pytest.mark.slow
@pytest.mark.parametrize("how", ["mean", "median"])
def test_repeated_readings_become_one_and_their_scatter_the_sigma(tmp_path, how):
    """Two hundred stations of nine readings: the scatter is known to 2 or 3 percent."""
    rng = np.random.default_rng(8)
    rows, R, t = written("ros", rng, 200)
    d = readings_of(R, t)
    d = np.where(d > 0.0, d, 5.0)
    noise = 1e-3 * rng.standard_normal((200, 9))
    lines = ["station,x,y,z,qx,qy,qz,qw,range_1"]
    for i, row in enumerate(rows):
        pose = ",".join(repr(float(x)) for x in row)
        lines += [f"S{i},{pose},{float(d[i] + e)!r}" for e in noise[i]]
    path = tmp_path / "log.csv"
    path.write_text("\n".join(lines) + "\n")
    report = hl.describe_log(path, hl.LogFormat(plane="A", average=how, as_stated=True))
    recording = report.recording
    mean = {"mean": noise.mean(axis=1), "median": np.median(noise, axis=1)}[how]
    assert np.abs(recording.ranges[:, 0] - (d + mean)).max() < 1e-12
    assert report.scatter == pytest.approx(1e-3, rel=0.08)
    assert report.scatter_of["1"] == pytest.approx(report.scatter)
    worth = {"mean": 9.0, "median": 18.0 / math.pi}[how]
    assert np.allclose(recording.samples, worth)
    again = tmp_path / "recording.csv"
    hl.write_recording(again, recording)
    assert np.array_equal(hl.read_recording(again).samples, recording.samples)


# --- what is refused, and what the message says ------------------------------------------------------

AMBIGUOUS = "X;Y;Z;A;B;C;range_1\n1,000;2,000;3,000;1;2;3;1,500\n1,100;2,000;3,000;1;2;3;1,500\n"
REFUSED = {
    "separators": (
        "X, mm;Y, mm;Z, mm;A, d;B, d;C, d;range_1\n" + "1,5;2,5;3,5;1,5;2,5;3,5;100\n" * 3,
        {},
        "state --delimiter",
    ),
    "thousands": (AMBIGUOUS, {}, "line 2, column X: found '1,000'; expected a decimal comma or"),
    "points between thousands": (
        "X;Y;Z;A;B;C;range_1\n6.139,514;2,5;3,5;1,5;2,5;3,5;100\n",
        {},
        "line 2, column X: found '6.139,514'; expected a number; state --decimal comma",
    ),
    "both marks": (
        "X;Y;Z;A;B;C;range_1\n1,5;2,5;3.5;1,5;2,5;3,5;100\n",
        {},
        "line 2, column Z: found '3.5'; expected decimal commas",
    ),
    "no planes": ("X,Y,Z,A,B,C,range_1\n10,20,30,1,2,3,5\n", {"plane": ""}, "--plane NAME"),
    "two X": (
        "x,X [mm],Y,Z,A,B,C,range_1\n10,10,20,30,1,2,3,5\n",
        {"pose_columns": ("X", "Y", "Z", "A", "B", "C")},
        "no column 'X' among x, X [mm], Y",
    ),
    "unit in a name": (
        "X [m],Y [m],Z [m],A,B,C,range_1\n10,20,30,1,2,3,5\n",
        {},
        "column X [m]: found the unit 'm' in the name of the column, which is read as 'mm'; expected "
        "--units m",
    ),
    "other columns": (
        "X,Y,Z,W,P,R,range_1\n10,20,30,1,2,3,5\n",
        {},
        "these are columns as of --pose-format fanuc",
    ),
    "a word": ("X,Y,Z,A,B,C,range_1\n10,20,30,1,2,E3,5\n", {}, "line 2, column C: found 'E3'"),
    "no range": ("X,Y,Z,A,B,C,d\n10,20,30,1,2,3,5\n", {}, "--range-columns"),
    "a range of planes": (
        "X,Y,Z,A,B,C,range_1\n10,20,30,1,2,3,5\n",
        {"plane": "", "plane_ranges": ("A=1..7",)},
        "no station '7' in the log",
    ),
    "station twice": (
        "station,X,Y,Z,A,B,C,range_1\n1,10,20,30,1,2,3,5\n1,90,20,30,1,2,3,5\n",
        {},
        "line 3, column station: found station '1' again at a pose 80 mm and 0 deg away",
    ),
    "cut": ("X,Y,Z,A,B,C,range_1\n10,20,30,1,2,3,5.55\n11,20,30,1,2,3,5", {}, "line end"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_cannot_be_read_is_refused_in_one_line(tmp_path, case):
    text, change, words = REFUSED[case]
    path = tmp_path / "log.csv"
    path.write_text(text)
    with pytest.raises(hl.InputError) as caught:
        hl.read_log(path, hl.LogFormat(**(FORMAT | change)))
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("written_as", "read_as", "words"),
    [("matrix", "franka", "row by row"), ("franka", "matrix", "column by column")],
)
def test_a_matrix_the_other_way_is_told_by_its_last_row(tmp_path, written_as, read_as, words):
    rows, _, _ = written(written_as, np.random.default_rng(3), 20)
    extra = [("range_1", [0.2 + 0.01 * i for i in range(20)])]
    (tmp_path / "log.csv").write_text(text_of(CONTROLLERS[read_as].names, rows, extra))
    with pytest.raises(hl.InputError, match=rf"last row is .*is it {words}"):
        hl.read_log(tmp_path / "log.csv", hl.LogFormat(pose_format=read_as, plane="A"))


def test_a_decimal_comma_is_read_where_it_is_stated(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text(AMBIGUOUS)
    found = hl.read_log(path, hl.LogFormat(**FORMAT, decimal="comma", as_stated=True))
    assert found.world_t_hand[1].tolist() == pytest.approx([1.1e-3, 2e-3, 3e-3])
    assert found.ranges[0, 0] == pytest.approx(1.5e-3)


def test_broken_files_of_other_kinds_are_refused(tmp_path):
    for name in ("log.parquet", "log.jsonl", "log.xlsx"):
        (tmp_path / name).write_bytes(b'{"x": 1}\nnonsense\n')
        with pytest.raises(hl.InputError) as caught:
            hl.read_log(tmp_path / name, hl.LogFormat(**FORMAT))
        assert name in str(caught.value)
        assert "\n" not in str(caught.value)
    with pytest.raises(hl.InputError, match=r"log.jsonl, line 2: found no JSON"):
        hl.read_log(tmp_path / "log.jsonl", hl.LogFormat(**FORMAT))
    with pytest.raises(hl.InputError, match="no such file"):
        hl.read_log(tmp_path / "none.csv")


CONTRADICTIONS = [
    {"pose_format": "kuka", "rotation": "ZYX"},
    {"pose_format": "cuka"},
    {"rotation": "ZYY", "units": "m", "angles": "deg"},
    {"rotation": "xyz", "units": "m"},
    {"rotation": "xyzw"},
    {"beam_column": "b"},
    {"plane": "A", "plane_column": "plane"},
    {"tool": (1.0, "2")},
    {"tolerance_s": -1.0},
    {"frames": ("base",)},
    {"plane": "A\nB"},
]


@pytest.mark.parametrize("given", CONTRADICTIONS, ids=str)
def test_contradictory_formats_are_refused(given):
    with pytest.raises(hl.InputError):
        hl.LogFormat(**given)


def test_names_from_files_are_escaped(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text("X,Y,Z,\x1b[31mA,B,C,range_1\n1,2,3,1,2,3,5\n")
    with pytest.raises(hl.InputError) as caught:
        hl.read_log(path, hl.LogFormat(**FORMAT))
    assert "\x1b" not in str(caught.value)


# --- options, rig file, command ----------------------------------------------------------------------


def test_every_field_is_an_option_and_a_field_of_the_rig_file():
    names = [one.name for one in fields(hl.LogFormat)]
    options = inspect.signature(Log).parameters
    assert list(options) == list(LogTable.model_fields) == names
    for name, option in options.items():
        assert get_args(option.annotation)[1].help, name


def test_the_rig_file_says_how_logs_are_written(tmp_path):
    (tmp_path / "rig.toml").write_text(
        '[log]\npose_format = "kuka"\nrange_units = "mm"\nplane = "wall"\n'
        'pose_columns = ["X", "Y", "Z", "A", "B", "C"]\nreadings = "other.csv"\n'
    )
    log = hl.read_rig(tmp_path / "rig.toml").log
    assert (log.pose_format, log.plane, log.readings) == ("kuka", "wall", tmp_path / "other.csv")
    (tmp_path / "rig.toml").write_text('[log]\npose_format = "cuka"\n')
    with pytest.raises(hl.InputError, match="'cuka'"):
        hl.read_rig(tmp_path / "rig.toml")
    (tmp_path / "rig.toml").write_text("[log]\npose = 3\n")
    with pytest.raises(hl.InputError, match="one of pose_format"):
        hl.read_rig(tmp_path / "rig.toml")


@pytest.fixture
def gripper_log(tmp_path):
    """The shipped recording as a controller's log: mm, angles about fixed axes by arc tangents."""
    recording = hl.read_recording(GRIPPER / "recording.csv")
    lines = ["X,Y,Z,W,P,R,plane,d1,d2,d3,d4"]
    for R, t, plane, d in zip(
        recording.world_R_hand,
        recording.world_t_hand,
        recording.plane_labels,
        recording.ranges,
        strict=True,
    ):
        w, p = math.atan2(R[2, 1], R[2, 2]), math.asin(-R[2, 0])
        angles = [x * 180.0 / math.pi for x in (w, p, math.atan2(R[1, 0], R[0, 0]))]
        numbers = [repr(float(x)) for x in (*(1e3 * t), *angles)]
        lines.append(",".join([*numbers, plane, *(repr(float(1e3 * x)) for x in d)]))
    path = tmp_path / "fanuc.csv"
    path.write_text("\n".join(lines) + "\n")
    return path


OPTIONS = [
    "--pose-format",
    "fanuc",
    "--range-units",
    "mm",
    "--range-columns",
    "1=d1,2=d2,3=d3,4=d4",
]


@pytest.mark.slow
def test_calibrate_check_and_validate_take_a_log(handlaser, gripper_log, tmp_path):
    file = tmp_path / "rig.toml"
    file.write_text((GRIPPER / "rig.toml").read_text())
    rig = ["--rig", file]
    assert handlaser("convert", gripper_log, *OPTIONS, *rig, "--write-log", file)[0] == 0
    code, out, err = handlaser("calibrate", gripper_log, *rig, "--json")
    direct = handlaser("calibrate", GRIPPER / "recording.csv", *rig, "--json")
    assert (code, err) == (direct[0], direct[2])
    mounts, wanted = (json.loads(text)["beams"] for text in (out, direct[1]))
    for one, other in zip(mounts, wanted, strict=True):
        assert np.allclose(one["location_m"], other["location_m"], atol=1e-9)
        assert np.allclose(one["direction"], other["direction"], atol=1e-8)
    code, out, _ = handlaser("check", gripper_log, *rig)
    assert (code, out) == handlaser("check", GRIPPER / "recording.csv", *rig)[:2]
    assert handlaser("validate", gripper_log, *rig, "--splits", "0")[0] == 0


def test_convert_writes_the_recording(handlaser, refusal, gripper_log, tmp_path):
    out = tmp_path / "recording.csv"
    code, said, err = handlaser("convert", gripper_log, *OPTIONS, "--out", out)
    assert (code, err) == (0, "")
    assert "44 stations, 4 beams, 4 planes" in said
    assert "fanuc: mm, deg, angles xyz" in said
    found, wanted = hl.read_recording(out), hl.read_recording(GRIPPER / "recording.csv")
    assert_poses(found, wanted.world_R_hand, wanted.world_t_hand)
    assert np.abs(found.ranges - wanted.ranges).max() < 1e-15
    assert "the input itself" in refusal("convert", gripper_log, *OPTIONS, "--out", gripper_log)


def test_a_log_that_is_taken_for_a_recording_is_recognised(refusal, gripper_log):
    err = refusal("calibrate", gripper_log)
    assert "log.pose_format fanuc" in err
    assert "convert LOG --write-log RIG" in err


@pytest.mark.slow
def test_what_was_converted_is_calibrated_with_the_rig_file_of_the_log(
    handlaser, refusal, gripper_log, tmp_path
):
    rig, out = tmp_path / "rig.toml", tmp_path / "recording.csv"
    rig.write_text(
        '[log]\npose_format = "fanuc"\nrange_units = "mm"\n'
        'range_columns = ["1=d1", "2=d2", "3=d3", "4=d4"]\n'
    )
    assert handlaser("convert", gripper_log, "--rig", rig, "--out", out)[0] == 0
    code, said, _ = handlaser("check", out, "--rig", rig)
    assert (code, said) == handlaser("check", gripper_log, "--rig", rig)[:2]
    rig.write_text('[log]\nunits = "mm"\n')  # as a log of ros in millimetres
    err = refusal("check", out, "--rig", rig)
    assert "log.units m" in err or "log.pose_format ros" in err


@pytest.mark.slow
def test_a_recording_of_two_files_is_calibrated_with_their_rig_file(handlaser, tmp_path):
    poses, rig, out = (
        ROOT / "examples" / "logs" / "kuka_poses.csv",
        tmp_path / "rig.toml",
        tmp_path / "recording.csv",
    )
    columns = "1=Laser 1,2=Laser 2,3=Laser 3,4=Laser 4"
    options = ["--pose-format", "kuka", "--station-column", "Point", "--plane-column", "Plate"]
    options += ["--readings", ROOT / "examples" / "logs" / "kuka_lasers.csv"]
    options += ["--range-columns", columns, "--range-units", "mm"]
    assert handlaser("convert", poses, *options, "--out", out, "--write-log", rig)[0] == 0
    assert handlaser("check", out, "--rig", rig)[:2] == handlaser("check", poses, "--rig", rig)[:2]


@pytest.mark.slow
def test_the_table_of_a_rig_file_is_written_beside_the_rest(handlaser, gripper_log, tmp_path):
    """The file keeps every byte, and gets the table once; what reads alike writes nothing."""
    rig = tmp_path / "rig.toml"
    for before, ends in (
        ("", "\n"),
        ("[sensor]\r\nrange_mm = [0, 30] # of the data sheet", "\r\n"),
    ):
        rig.write_bytes(before.encode())
        assert handlaser("convert", gripper_log, *OPTIONS, "--write-log", rig)[0] == 0
        text = rig.read_bytes().decode()
        assert text.startswith(before)
        assert f'[log]{ends}pose_format = "fanuc"{ends}' in text
        assert text.count("\n") == text.count(ends)
        given = hl.read_rig(rig).log
        assert given.pose_format == "fanuc"
        assert given.range_columns == ("1=d1", "2=d2", "3=d3", "4=d4")
        assert handlaser("convert", gripper_log, *OPTIONS, "--write-log", rig)[0] == 0
        assert rig.read_bytes().decode() == text


def test_a_table_that_says_another_thing_is_not_replaced(handlaser, refusal, gripper_log, tmp_path):
    rig, out = tmp_path / "rig.toml", tmp_path / "recording.csv"
    rig.write_text('[log]\npose_format = "kuka"\nrange_units = "mm"\n')
    before = rig.read_bytes()
    options = (*OPTIONS, "--write-log", rig, "--out", out)
    assert "[log] with other values of pose_format, range_columns" in refusal(
        "convert", gripper_log, *options
    )
    assert rig.read_bytes() == before
    assert not out.exists()
    rig.write_text("[log")
    assert handlaser("convert", gripper_log, *options)[0] == 2
    rig.unlink()
    assert "nothing that a table [log] could say" in refusal(
        "convert", GRIPPER / "recording.csv", "--write-log", rig
    )
    assert not rig.exists()


def test_every_field_comes_back_from_the_table_of_a_rig_file(tmp_path):
    folder = tmp_path / "rigs"
    folder.mkdir()
    given = hl.LogFormat(
        rotation="ZYX",
        units="mm",
        angles="deg",
        inverted=True,
        tool=(1.0, 1e-7, 3.0, 0.1, -0.2, 1e5),
        range_columns=('links=Länge "a"', "b\\c=D"),
        plane_file=tmp_path / "planes.csv",
        readings=tmp_path / "other" / "readings.csv",
        lag_s=-0.25,
    )
    (folder / "rig.toml").write_text(with_log_table(folder / "rig.toml", given))
    found = hl.read_rig(folder / "rig.toml").log
    assert replace(found, plane_file=None, readings=None) == replace(
        given, plane_file=None, readings=None
    )
    for one, other in zip(found.files, given.files, strict=True):
        assert one.resolve() == other.resolve()


@pytest.mark.slow
def test_options_win_over_the_rig_file(handlaser, refusal, gripper_log, tmp_path):
    rig = tmp_path / "rig.toml"
    rig.write_text(
        '[log]\npose_format = "kuka"\nrange_units = "mm"\nplane_column = "plane"\n'
        'range_columns = ["1=d1", "2=d2", "3=d3", "4=d4"]\n'
    )
    assert "--pose-format fanuc" in refusal("convert", gripper_log, "--rig", rig)
    assert handlaser("convert", gripper_log, "--rig", rig, "--pose-format", "fanuc")[0] == 0
    spelled = [
        "--rotation",
        "xyz",
        "--units",
        "mm",
        "--angles",
        "deg",
        "--pose-columns",
        "X,Y,Z,W,P,R",
    ]
    assert handlaser("convert", gripper_log, "--rig", rig, *spelled)[0] == 0
    code, out, err = handlaser("convert", gripper_log, "--rig", rig, *spelled, "--plane", "one")
    assert (code, err) == (0, "")
    assert "4 beams, 1 plane, " in out


# --- wrong conventions -------------------------------------------------------------------------------


@pytest.mark.slow
def test_no_wrong_convention_of_all_ordered_pairs_goes_unnoticed():
    """Of one scene, with the tool down; the benchmark has others, and every rotation in all units."""
    several = [one for one in meanings() if formats_of(one.meaning)]
    told = list(study(log_recording("paper", "tool down"), several))
    assert len(told) == len(several) ** 2 >= 100
    assert "\n".join(matrix(told)).count(UNNOTICED) == 0
    same = [(one.written, one.read) for one in told if one.outcome == SAME]
    assert same == [(one.written, one.written) for one in told if one.written == one.read]
    by_fit = [one for one in told if one.outcome in (RESIDUAL, WARNED)]
    assert len(by_fit) >= 12
    assert [one for one in by_fit if not one.named] == []


@pytest.mark.slow
@pytest.mark.parametrize("name", ["kuka", "ros", "ur"])
@pytest.mark.parametrize("spoilt", [0.0, 0.1])
def test_the_right_convention_is_never_doubted(tmp_path, name, spoilt):
    """Neither with errors of robot and sensor, nor with a tenth of the readings wrong by a half."""
    recording = log_recording("arm", "askew", seed=5)
    rng = np.random.default_rng(0)
    d = recording.ranges.copy()
    wrong = rng.random(d.shape) < spoilt
    d[wrong] *= rng.uniform(0.5, 1.5, wrong.sum())
    rows = numbers(recording, FORMATS[name])
    names = CONTROLLERS[name].names
    extra = [("plane", recording.plane_labels)]
    extra += [(f"range_{b}", d[:, i].tolist()) for i, b in enumerate(recording.beam_names)]
    path = tmp_path / "log.csv"
    path.write_text(text_of(names, rows, extra))
    found = hl.read_log(path, hl.LogFormat(pose_format=name))
    assert [one.code for one in found.warnings] == []
    assert_poses(found, recording.world_R_hand, recording.world_t_hand)


SIGNS = {
    "quaternions of another length": (
        "ros",
        lambda x: x * [1, 1, 1, 0.5, 0.5, 0.5, 0.5],
        {},
        "length",
    ),
    "degrees as radians": (
        "fanuc",
        lambda x: x,
        {"angles": "rad"},
        "read as radians; expected at most 2 pi; are they degrees?",
    ),
    "millimetres as metres": ("kuka", lambda x: x, {"units": "m"}, "then state --pose-format kuka"),
    "metres as millimetres": ("ur", lambda x: x, {"units": "mm"}, "then state --pose-format ur"),
    "positions in inches": (
        "kuka",
        lambda x: x / [25.4, 25.4, 25.4, 1.0, 1.0, 1.0],
        {},
        "--pose-format kuka --units in, ",
    ),
    "positions in centimetres": (
        "kuka",
        lambda x: x / [10.0, 10.0, 10.0, 1.0, 1.0, 1.0],
        {},
        "the positions are in centimetres: write them in millimetres or metres",
    ),
    "inverted": ("kuka", lambda x: x, {"inverted": True}, "the poses are not inverted"),
    "ranges in millimetres": ("kuka", lambda x: x, {"range_units": "mm"}, "--range-units m"),
    "one pose": ("kuka", lambda x: x[:1].repeat(len(x), axis=0), {}, "one pose at all 44 stations"),
}


@pytest.mark.slow
@pytest.mark.parametrize("case", SIGNS)
def test_signs_of_a_wrong_convention_are_refused_and_the_right_one_named(tmp_path, case):
    name, change, given, words = SIGNS[case]
    recording = log_recording("paper", "tool down")
    rows = change(numbers(recording, FORMATS[name]))
    extra = [("plane", recording.plane_labels)]
    for i, beam in enumerate(recording.beam_names):
        extra.append((f"range_{beam}", ["" if np.isnan(d) else d for d in recording.ranges[:, i]]))
    path = tmp_path / "log.csv"
    path.write_text(text_of(CONTROLLERS[name].names, rows, extra))
    with pytest.raises(hl.InputError) as caught:
        hl.read_log(path, hl.LogFormat(pose_format=name, **given))
    assert words in str(caught.value)
    assert str(path) in str(caught.value)


UNITS = [("kuka", 1.0, "rad"), ("fanuc", 1.0, "rad"), ("kuka", 25.4, "deg"), ("ur", 1e-3, "rad")]
"""A format, what its positions are divided by, and the unit in which its angles are written."""


@pytest.mark.slow
@pytest.mark.parametrize(("name", "divided", "angles"), UNITS)
def test_options_that_are_named_read_the_file(tmp_path, name, divided, angles):
    recording, known = log_recording("paper", "tool down"), FORMATS[name]
    rows = numbers(recording, known) / np.repeat([divided, 1.0], 3)
    rows[:, 3:] *= ANGLES[known.angles] / ANGLES[angles]
    extra = [("plane", recording.plane_labels)]
    extra += [(f"range_{b}", d.tolist()) for b, d in zip("ab", recording.ranges.T, strict=False)]
    path = tmp_path / "log.csv"
    path.write_text(text_of(CONTROLLERS[name].names, rows, extra))
    with pytest.raises(hl.InputError) as caught:
        hl.read_log(path, hl.LogFormat(pose_format=name))
    stated = dict(re.findall("--(pose-format|units|angles) ([a-z]+)", str(caught.value)))
    found = hl.read_log(path, hl.LogFormat(**{k.replace("-", "_"): v for k, v in stated.items()}))
    assert_poses(found, recording.world_R_hand, recording.world_t_hand)


OTHER_COLUMNS = {
    "x y z a b c": ("mitsubishi", "doosan", (), "--pose-format mitsubishi"),
    "x y z rx ry rz": ("staubli", "yaskawa", (), "--pose-format staubli"),
    "X Y Z A B C": (
        "staubli",
        "kuka",
        (),
        "--rotation XYZ --units mm --angles deg --pose-columns X,Y,Z,A,B,C",
    ),
    "X:[mm] Y:[mm] Z:[mm] A B C": (
        "staubli",
        "kuka",
        (),
        "--rotation XYZ --units mm --angles deg --pose-columns 'X [mm],Y [mm],Z [mm],A,B,C'",
    ),
    "tcp_x tcp_y tcp_z rx ry rz": (
        "staubli",
        "kuka",
        ("--pose-columns", "tcp_x,tcp_y,tcp_z,rx,ry,rz"),
        "--rotation XYZ --units mm --angles deg --pose-columns tcp_x,tcp_y,tcp_z,rx,ry,rz",
    ),
    "T[0] T[1] T[2] T[5] T[4] T[3] T[6]": (
        "staubli",
        "kuka",
        ("--pose-columns", "T[0],T[1],T[2],T[5],T[4],T[3]"),
        "--pose-columns 'T[0],T[1],T[2],T[5],T[4],T[3]'",
    ),
}
"""By names of columns: what poses are written in and read as, with what options, and what is named."""


@pytest.mark.slow
@pytest.mark.parametrize("names", OTHER_COLUMNS)
def test_options_that_are_named_find_the_columns_of_the_file(tmp_path, handlaser, refusal, names):
    """Formats were named that look for other columns, and `--pose-columns NAMES` without the names."""
    written_in, read_as, options, named = OTHER_COLUMNS[names]
    recording = log_recording("paper", "tool down")
    columns = [one.replace(":", " ") for one in names.split()]
    rows = numbers(recording, FORMATS[written_in])
    if len(columns) > 6:
        rows = np.column_stack((rows, np.zeros(len(rows))))
    extra = [("plane", recording.plane_labels)]
    extra += [(f"range_{b}", d.tolist()) for b, d in zip("ab", recording.ranges.T, strict=False)]
    path = tmp_path / "log.csv"
    path.write_text(text_of(columns, rows, extra))
    said = refusal("convert", path, "--pose-format", read_as, *options)
    assert named in said
    found = re.search(r"(--(rotation|pose-format).*?), than as stated", said)[1]
    assert handlaser("convert", path, *shlex.split(found))[0] == 0


def test_a_tool_that_is_no_pose_is_told_of_formats_of_the_file(tmp_path, refusal):
    path = tmp_path / "log.csv"
    rows = [[0.1 * i, 0.2, 0.3, 0.1 * i, 0.2, 0.3] for i in range(4)]
    names = ["x", "y", "z", "roll", "pitch", "yaw"]
    path.write_text(text_of(names, rows, [("plane", ["A"] * 4), ("range_1", [0.1] * 4)]))
    said = refusal("convert", path, "--pose-format", "urdf-rpy", "--tool", "0,0,120,0,0,0")
    assert "then state --pose-format urdf-rpy --units mm" in said


def test_numbers_that_cannot_be_are_told_of_formats_of_the_file(tmp_path, refusal):
    path = tmp_path / "log.csv"
    rows = [[100.0 * i, 200.0, 300.0, 0.1 * i, 0.2, 0.3] for i in range(4)]
    names = ["x", "y", "z", "roll", "pitch", "yaw"]
    path.write_text(text_of(names, rows, [("plane", ["A"] * 4), ("range_1", [0.1] * 4)]))
    said = refusal("convert", path, "--pose-format", "urdf-rpy")
    assert "is it millimetres? then state --pose-format urdf-rpy --units mm" in said


@pytest.mark.slow
def test_who_insists_is_warned(tmp_path):
    recording = log_recording("paper", "tool down")
    path = tmp_path / "log.csv"
    extra = [("plane", recording.plane_labels)]
    for i, beam in enumerate(recording.beam_names):
        extra.append((f"range_{beam}", ["" if np.isnan(d) else d for d in recording.ranges[:, i]]))
    rows = numbers(recording, FORMATS["kuka"])
    path.write_text(text_of(CONTROLLERS["kuka"].names, rows, extra))
    found = hl.read_log(path, hl.LogFormat(pose_format="mitsubishi", as_stated=True))
    (warning,) = found.warnings
    assert warning.code == "pose-convention"
    assert "--pose-format kuka" in warning.message


@pytest.mark.slow
def test_poses_that_were_held_are_warned_of(tmp_path):
    recording = log_recording("paper", "tool down")
    rows = numbers(recording, FORMATS["kuka"])
    rows[20:24] = rows[19]
    extra = [("plane", recording.plane_labels), ("range_1", recording.ranges[:, 0].tolist())]
    path = tmp_path / "log.csv"
    path.write_text(text_of(CONTROLLERS["kuka"].names, rows, extra))
    found = hl.read_log(path, hl.LogFormat(pose_format="kuka", as_stated=True))
    (held,) = [one for one in found.warnings if one.code == "held-poses"]
    assert held.values["stations"] in (3, 4)  # station 22 is before another plane than the first


# --- single gross readings inside a station ----------------------------------------------------------


def repeated_log(path, noise):
    """Write a log of stations (S) with readings (S, N) that are 0.2 m and some noise."""
    lines = ["station,x,y,z,qx,qy,qz,qw,range_1"]
    for i, row in enumerate(noise):
        lines += [f"S{i},{0.01 * i},0,0,0,0,0,1,{0.2 + e!r}" for e in row.tolist()]
    path.write_text("\n".join(lines) + "\n")
    return path


def test_single_gross_readings_that_shift_a_mean_are_warned_of(tmp_path):
    noise = 5e-5 * np.random.default_rng(3).standard_normal((12, 60))
    noise[4, 20] += 0.05
    noise[7, 31:45:3] -= 0.02
    path = repeated_log(tmp_path / "log.csv", noise)
    (found,) = hl.read_log(path, hl.LogFormat(plane="A", as_stated=True)).warnings
    assert (found.code, found.values) == ("gross-readings", {"readings": 6, "stations": 2})
    assert "(S4, S7)" in found.message
    assert "--average median" in found.message
    assert not hl.read_log(path, hl.LogFormat(plane="A", average="median", as_stated=True)).warnings
    noise = 5e-5 * np.random.default_rng(3).standard_normal((12, 60))
    noise[4, 20] += 1e-3  # twenty sigmas move the mean of sixty by less than three of its own
    path = repeated_log(tmp_path / "little.csv", noise)
    assert not hl.read_log(path, hl.LogFormat(plane="A", as_stated=True)).warnings


@pytest.mark.parametrize("average", ["mean", "median"])
@pytest.mark.parametrize("pairs", [1, 2, 12])
def test_two_readings_of_a_station_that_differ_far_are_warned_of(tmp_path, average, pairs):
    """With or without other stations of several readings to compare with."""
    noise = 5e-5 * np.random.default_rng(3).standard_normal((12, 2))
    given = hl.LogFormat(plane="A", average=average, as_stated=True)
    path = repeated_log(tmp_path / "log.csv", noise)
    header, *rows = path.read_text().splitlines()
    alone = [row for i, row in enumerate(rows) if i % 2 == 0 or i // 2 < pairs]
    path.write_text("\n".join([header, *alone]))
    assert not hl.read_log(path, given).warnings
    wrong = repeated_log(tmp_path / "far.csv", noise + np.outer(np.arange(12) == 0, [0.0, 0.079]))
    first = wrong.read_text().splitlines()[1:3]
    path.write_text("\n".join([header, *first, *alone[2:]]))
    (found,) = hl.read_log(path, given).warnings
    assert (found.code, found.values) == ("gross-readings", {"readings": 2, "stations": 1})
    assert "(S0)" in found.message


def clean(kind, rng):
    """Return noise [m] (12, 60) of stations without a gross reading."""
    k, gauss = np.arange(60.0), rng.standard_normal((12, 60))
    return {
        "Gaussian": 5e-5 * gauss,
        "heavy tails": 5e-5 * rng.laplace(size=(12, 60)),
        "uniform": 5e-5 * rng.uniform(-1.0, 1.0, (12, 60)),
        "rounded": np.round(4e-5 * gauss, 4),
        "settling": 2e-5 * gauss + 2e-3 * np.exp(-k / 4.0),
        "drift": 2e-5 * gauss + 1e-4 * k * (rng.random(12) > 0.7)[:, None],
        "held": 0.0 * gauss,
    }[kind]


KINDS = ("Gaussian", "heavy tails", "uniform", "rounded", "settling", "drift", "held")


@pytest.mark.parametrize("kind", KINDS)
def test_no_reading_of_a_clean_station_is_called_gross(tmp_path, kind):
    for seed in range(3):
        path = repeated_log(tmp_path / "log.csv", clean(kind, np.random.default_rng(seed)))
        assert not hl.read_log(path, hl.LogFormat(plane="A", as_stated=True)).warnings
