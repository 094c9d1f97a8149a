"""Logs that are odd or broken: one line says what was found and what to do, and nothing is lost."""

import json
import math
import os
import re
import threading
from datetime import datetime, timedelta

import numpy as np
import polars as pl
import pytest
from helpers import GRIPPER

import handlaser_gtsam as hl

NAMES = ["x", "y", "z", "qx", "qy", "qz", "qw"]


@pytest.fixture
def log():
    """Columns of a good log: eight stations, two beams, times a second apart."""
    rng = np.random.default_rng(0)
    rows = []
    for _ in range(8):
        x, y, z = rng.uniform(-0.2, 0.2, 3)
        half = 0.1 * rng.uniform(-1.0, 1.0, 3)
        rows.append([x, y, z, *half, math.sqrt(1.0 - half @ half)])
    columns = {name: [float(row[i]) for row in rows] for i, name in enumerate(NAMES)}
    ranges = {f"range_{b}": rng.uniform(0.1, 0.2, 8).tolist() for b in "ab"}
    return {"plane": ["A"] * 4 + ["B"] * 4} | columns | ranges


def written(folder, columns, name="log.csv", separator=","):
    path = folder / name
    pl.DataFrame(columns, strict=False).write_csv(path, separator=separator)
    return path


def refused(path, words, **given):
    """The one line that says what is wrong; every word of `words` is in it."""
    with pytest.raises(hl.InputError) as caught:
        hl.read_log(path, hl.LogFormat(**given))
    text = str(caught.value)
    assert "\n" not in text
    for part in words if isinstance(words, tuple) else (words,):
        assert re.search(part, text), (part, text)


def renamed(columns, **names):
    return {names.get(name, name): values for name, values in columns.items()}


# --- columns ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("old", "new", "words", "given"),
    [
        ("range_a", "range_a [um]", ("unit 'um'", "values in 'm', 'mm', 'in'"), {}),
        ("range_a", "range_a [V]", ("unit 'v'", "--as-stated"), {}),
        ("x", "x [cm]", "unit 'cm'", {"pose_columns": ("x [cm]", *NAMES[1:])}),
        ("x", "x_cm", "unit 'cm'", {}),
    ],
    ids=str,
)
def test_units_that_nothing_is_read_in_are_refused(tmp_path, log, old, new, words, given):
    refused(written(tmp_path, renamed(log, **{old: new})), words, **given)


def test_two_columns_that_may_be_one_coordinate_are_refused(tmp_path, log):
    refused(written(tmp_path, log | {"X": log["y"]}), ("several columns that may be x", "x, X"))


@pytest.mark.parametrize(
    "given",
    [
        {"pose_columns": ("x", "x", *NAMES[2:])},
        {"range_columns": ("a=range_a", "b=range_a")},
        {"range_columns": ("x",)},
        {"plane_column": "x"},
        {"beam_column": "plane", "range_column": "range_a"},
    ],
    ids=str,
)
def test_a_column_is_one_thing(tmp_path, log, given):
    refused(written(tmp_path, log), ("one column as", "a column of its own for each"), **given)


def test_a_file_without_header_is_told_from_one_with_names(tmp_path, log):
    path = written(tmp_path, log)
    path.write_text(path.read_text().split("\n", 1)[1])
    refused(path, ("numbers in the first line", "--header"))
    with pytest.raises(hl.InputError, match="numbers in the first line"):
        hl.read_recording(path)


def test_decimal_commas_between_commas_are_named(tmp_path, log):
    path = written(tmp_path, log)
    head, rows = path.read_text().split("\n", 1)
    path.write_text(head + "\n" + rows.replace(".", ","))
    refused(path, "decimal commas need another separator")


# --- poses --------------------------------------------------------------------------------------------


def test_a_position_far_beyond_any_arm_is_refused_in_millimetres_too(tmp_path, log):
    scaled = log | {name: [1e3 * one for one in log[name]] for name in "xyz"}
    scaled["x"][3] = 1e5
    path = written(tmp_path, scaled)
    spelled = {"rotation": "xyzw", "units": "mm"}
    refused(path, ("line 5", "100000 read as millimetres", "30 m"), **spelled)
    found = hl.read_log(path, hl.LogFormat(**spelled, as_stated=True))
    assert "pose-convention" in [one.code for one in found.warnings]


def test_left_handed_matrices_are_called_so(tmp_path, log):
    rows = np.tile(np.diag([1.0, 1.0, -1.0, 1.0]).ravel(), (8, 1))
    rows[:, 3] = log["x"]
    path = written(tmp_path, {f"m{i}": rows[:, i] for i in range(16)} | log)
    columns = tuple(f"m{i}" for i in range(16))
    refused(
        path, "determinant -1, of a left-handed frame", pose_format="matrix", pose_columns=columns
    )


# --- options ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"estimate_lag": True}, "no column of times"),
        ({"lag_s": 0.1}, "no column of times"),
        ({"interpolate": True}, "no column of times"),
        ({"sheet": "S"}, "--sheet, which says nothing of a file that is no workbook"),
        (
            {"readings_time_units": "ms"},
            "--readings-time-units, which says nothing of a log without",
        ),
        (
            {"readings_station_column": "n"},
            "--readings-station-column, which says nothing of a log",
        ),
        (
            {"tolerance_s": 1.0},
            "--tolerance-s, which says nothing of one table that is read row by",
        ),
        ({"stand_mm": 3.0}, "--stand-mm, which says nothing of a log without --stands"),
    ],
    ids=str,
)
def test_no_option_is_passed_over_in_silence(tmp_path, log, given, words):
    refused(written(tmp_path, log), words, **given)


def test_zero_is_a_number_that_is_stated(tmp_path, log, handlaser, refusal):
    """A lag of zero on the command line counts instead of that of the rig file."""
    time = np.arange(8.0)
    poses = written(tmp_path, {"time": time} | {name: log[name] for name in NAMES}, "poses.csv")
    late = {"time": time + 10.0} | {name: log[name] for name in log if name[:2] in ("pl", "ra")}
    readings, rig = written(tmp_path, late, "late.csv"), tmp_path / "rig.toml"
    rig.write_text("[log]\nlag_s = 10.0\ntolerance_s = 0.1\n")
    common = ("convert", poses, "--readings", readings, "--rig", rig)
    assert handlaser(*common)[0] == 0
    assert "within the tolerance" in refusal(*common, "--lag-s", "0")
    assert "--tolerance-s 0" in refusal(*common, "--tolerance-s", "0")


# --- times --------------------------------------------------------------------------------------------


def two_files(folder, log, times, late=None):
    """Poses and readings in files of their own."""
    poses = written(folder, {"time": times} | {name: log[name] for name in NAMES}, "poses.csv")
    rest = {name: log[name] for name in log if name not in NAMES}
    late = times if late is None else late
    return poses, {"readings": written(folder, {"time": late} | rest, "readings.csv")}


@pytest.mark.parametrize("how", [{}, {"interpolate": True}], ids=str)
def test_two_poses_at_one_time_are_refused(tmp_path, log, how):
    times = np.arange(8.0)
    times[5] = times[4]
    path, given = two_files(tmp_path, log, times, np.arange(8.0))
    refused(path, ("line 7, column time", "the time 4 s again"), **given, tolerance_s=2.0, **how)
    log |= {name: [*log[name][:5], log[name][4], *log[name][6:]] for name in NAMES}
    path, given = two_files(tmp_path, log, times)  # one pose, logged twice
    assert len(hl.read_log(path, hl.LogFormat(**given, tolerance_s=0.1)).ranges) == 8


def test_times_that_go_back_are_warned_of(tmp_path, log):
    times = np.arange(8.0)
    times[4:] -= 3.5
    path, given = two_files(tmp_path, log, times)
    found = hl.read_log(path, hl.LogFormat(**given, tolerance_s=0.1))
    said = [one for one in found.warnings if one.code == "times-back"]
    assert [one.message.split(":")[0] for one in said] == ["poses.csv", "readings.csv"]
    assert all("the first: line 6" in one.message for one in said)


def test_times_of_another_unit_are_refused_by_their_name(tmp_path, log):
    path, given = two_files(tmp_path, log, np.arange(8.0))
    for file in (path, given["readings"]):
        file.write_text(file.read_text().replace("time", "time [ms]", 1))
    refused(path, ("unit 'ms'", "--time-units ms"), **given, tolerance_s=0.1)


def test_an_interpolated_pose_needs_one_before_and_one_after(tmp_path, log):
    path, given = two_files(tmp_path, log, np.arange(8.0), np.arange(8.0) + 0.25)
    words = "no reading with poses before and after it within the tolerance"
    refused(path, words, **given, tolerance_s=0.5, interpolate=True)


# --- tables of other kinds ----------------------------------------------------------------------------


def book(folder, columns, change=None):
    xlsxwriter = pytest.importorskip("xlsxwriter")
    path = folder / "log.xlsx"
    made = xlsxwriter.Workbook(path)
    date = made.add_format({"num_format": "yyyy-mm-dd hh:mm:ss.000"})
    sheet = made.add_worksheet("Log")
    for i, (name, values) in enumerate(columns.items()):
        sheet.write(0, i, name)
        for row, value in enumerate(values, 1):
            sheet.write(row, i, value, *([date] if isinstance(value, datetime) else []))
    if change is not None:
        change(sheet)
    made.close()
    return path


def test_names_that_stand_twice_in_a_workbook_are_refused(tmp_path, log):
    path = book(tmp_path, log, lambda sheet: sheet.write(0, len(log) - 1, "range_a"))
    refused(path, ("column range_a", "the same name twice"))


def test_a_truth_value_in_a_workbook_is_no_number(tmp_path, log):
    path = book(tmp_path, log, lambda sheet: sheet.write(3, 1, True))
    refused(path, ("line 4, column x", "found 'true'"))


def test_texts_and_numbers_in_a_workbook_are_read_and_notes_said_nothing_of(tmp_path, log, capfd):
    def change(sheet):
        sheet.write(3, 1, repr(log["x"][2]).replace(".", ","))
        sheet.write(3, 30, "the robot was warm")

    found = hl.read_log(book(tmp_path, log, change))
    assert (
        np.abs(found.world_t_hand[:, 0] - log["x"]).max() < 1e-9
    )  # nine decimals, of such a column
    assert np.abs(found.world_t_hand[:, 1] - log["y"]).max() < 1e-15
    assert capfd.readouterr() == ("", "")


def test_dates_of_a_workbook_keep_their_milliseconds(tmp_path, log):
    start = datetime(2026, 1, 1, 8)
    times = [start + timedelta(milliseconds=250 * i) for i in range(8)]
    path = book(tmp_path, {"time": times} | {name: log[name] for name in NAMES})
    rest = {name: log[name] for name in log if name not in NAMES}
    readings = written(tmp_path, {"time": [one.isoformat() for one in times]} | rest, "r.csv")
    found = hl.read_log(path, hl.LogFormat(readings=readings, tolerance_s=0.01))
    assert np.abs(found.ranges[:, 0] - log["range_a"]).max() < 1e-12


def test_columns_of_parquet_of_any_type_are_read_or_refused(tmp_path, log):
    path, frame = tmp_path / "log.parquet", pl.DataFrame(log)
    frame.with_columns(pl.lit(timedelta(seconds=2)).alias("time")).write_parquet(path)
    assert len(hl.read_log(path, hl.LogFormat(plane_ranges=("A=0s..1s",))).ranges) == 8
    frame.with_columns(pl.struct(b="x").alias("a"), pl.col("x").alias("a.b")).write_parquet(path)
    refused(path, ("column a.b", "the same name twice"))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (
            lambda row: row | {"x": [row["x"]]},
            ("line 3, column x", "an array", "a number, as in line 1"),
        ),
        (lambda row: row | {"x": True}, ("line 3, column x", "a truth value")),
        (lambda row: row | {"x": math.nan}, ("line 3", "NaN, which JSON has not")),
    ],
    ids=["array", "truth", "nan"],
)
def test_lines_of_json_that_differ_are_named(tmp_path, log, change, words):
    rows = pl.DataFrame(log).to_dicts()
    rows[2] = change(rows[2])
    path = tmp_path / "log.jsonl"
    path.write_text("".join(json.dumps(row) + "\n" for row in rows))
    refused(path, words)


def test_json_lines_of_any_encoding_are_read_or_refused(tmp_path, log):
    path = tmp_path / "log.jsonl"
    text = "".join(json.dumps(row) + "\n" for row in pl.DataFrame(log).to_dicts())
    path.write_text(text, encoding="utf-8-sig")
    assert len(hl.read_log(path).ranges) == 8
    path.write_text(text, encoding="utf-16")
    refused(path, "UTF-16 text")
    path.write_text("")
    refused(path, "an empty file")


# --- folders and pipes --------------------------------------------------------------------------------


def test_a_folder_that_is_no_bag_is_called_so(tmp_path, refusal):
    for options in ((), ("--pose-format", "kuka")):
        assert "no bag that can be read (a folder without metadata.yaml)" in refusal(
            "convert", tmp_path, *options
        )


@pytest.mark.slow
def test_a_pipe_is_read_once(tmp_path, log, handlaser):
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    text = written(tmp_path, log).read_text()
    writing = threading.Thread(target=lambda: pipe.write_text(text), daemon=True)
    writing.start()
    rig = tmp_path / "rig.toml"
    rig.write_text('[log]\nunits = "m"\n')
    code, out, err = handlaser("check", pipe, "--rig", rig)
    writing.join(5.0)
    assert code in (0, 3), err
    assert out.startswith("16 readings")


# --- every verb ---------------------------------------------------------------------------------------


@pytest.fixture
def kuka(tmp_path):
    """The shipped recording in millimetres, with a rig file that says so."""
    lines = (GRIPPER / "recording.csv").read_text().split("\n")
    names = lines[0].split(",")
    rows = [line.split(",") for line in lines[1:] if line]
    lengths = [i for i, name in enumerate(names) if name in "xyz" or name.startswith("range_")]
    for row in rows:
        for i in lengths:
            row[i] = repr(1e3 * float(row[i])) if row[i] else ""
    path, rig = tmp_path / "log.csv", tmp_path / "rig.toml"
    path.write_text("\n".join(",".join(row) for row in [names, *rows]) + "\n")
    log = '[log]\nrotation = "xyzw"\nunits = "mm"\nrange_units = "mm"\n'
    rig.write_text((GRIPPER / "rig.toml").read_text() + log)
    return path, rig


@pytest.mark.slow
def test_plan_takes_a_log(kuka, handlaser):
    path, rig = kuka
    code, out, err = handlaser("plan", path, "--rig", rig, "--stations", "3", "--json")
    assert code == 0, err
    shipped = GRIPPER / "recording.csv", "--rig", GRIPPER / "rig.toml"
    plain = handlaser("plan", *shipped, "--stations", "3", "--json")
    first, second = (
        json.loads(text)["forecast"][0]["location_sigma_m"] for text in (out, plain[1])
    )
    assert first == pytest.approx(second, rel=1e-6)


@pytest.mark.slow
def test_plot_takes_a_log(kuka, tmp_path, handlaser):
    pytest.importorskip("matplotlib", reason="needs the extra plots")
    path, rig = kuka
    code, out, err = handlaser("plot", path, "--rig", rig, "--out", tmp_path / "pictures")
    assert code == 0, err
    assert "space-world.svg" in out


def test_a_command_to_type_keeps_its_options(tmp_path, refusal):
    """Options in words become fields of [log] where a rig file is read, but none of a whole command."""
    path = tmp_path / "numbers.csv"
    path.write_text("0.1,0.2,0.3\n0.4,0.5,0.6\n")
    assert "`handlaser convert LOG --header NAMES`" in refusal("calibrate", path)
