"""Odd files: each ends in one line or in a warning, in little time and memory, never in silence."""

import bz2
import decimal
import json
import math
import struct
import zipfile

import numpy as np
import polars as pl
import pytest

import handlaser_gtsam as hl
from benchmarks import odd_files
from benchmarks.odd_files import (
    NAMES,
    ODD,
    ROWS,
    good_log,
    lines_of,
    mcap,
    measured,
    ros1_bag,
    zeros,
    zstd_zeros,
)
from handlaser_gtsam.files.logs.packed import zstd_bound


@pytest.fixture
def log():
    return good_log()


def fault(path, **given):
    with pytest.raises(hl.InputError) as caught:
        hl.read_log(path, hl.LogFormat(**given))
    text = str(caught.value)
    assert "\n" not in text
    return text


def warned(recording, code):
    return [one for one in recording.warnings if one.code == code]


# --- workbooks ------------------------------------------------------------------------------------


def workbook(path, columns, change=lambda _: None, first=0):
    pytest.importorskip("xlsxwriter")
    pytest.importorskip("fastexcel")
    return odd_files.workbook(path, columns, change, first)


def test_cells_that_do_not_say_where_they_are_stand_one_after_the_other(tmp_path, log):
    path = odd_files.without_places(workbook(tmp_path / "log.xlsx", log))
    found = hl.read_log(path)
    assert np.abs(found.ranges - np.column_stack([log["range_a"], log["range_b"]])).max() < 1e-15
    assert found.plane_labels == tuple(log["plane"])
    errors = workbook(tmp_path / "log.xlsx", log, odd_files.errors_in_cells)
    found = hl.read_log(odd_files.without_places(errors))
    assert [one.values["cells"] for one in warned(found, "cells-without-value")] == [1, 1, 1]
    assert "'#N/A' (I3)" in " ".join(one.message for one in found.warnings)


def test_cells_of_a_workbook_that_hold_no_value_are_counted(tmp_path, log):
    def change(sheet):
        sheet.write_formula(1, 8, "=1/0", None, "#DIV/0!")
        sheet.write_formula(2, 8, "=NA()", None, "#N/A")
        sheet.write_formula(3, 9, "=NA()", None, "#N/A")
        sheet.write_formula(4, 9, "=I5", None, "")

    found = hl.read_log(workbook(tmp_path / "log.xlsx", log, change))
    assert np.isnan(found.ranges).sum() == 4
    words = " ".join(one.message for one in warned(found, "cells-without-value"))
    assert [one.values["cells"] for one in warned(found, "cells-without-value")] == [1, 2, 1]
    for part in ("'#DIV/0!' (I2)", "'#N/A' (I3, J4)", "'formula without a value' (J5)"):
        assert part in words
    kept = np.isfinite(found.ranges)
    ranges = np.column_stack([log["range_a"], log["range_b"]])
    assert np.abs(found.ranges - ranges)[kept].max() < 1e-15


def test_an_empty_text_of_a_formula_is_no_error(tmp_path, log):
    path = workbook(
        tmp_path / "log.xlsx", log, lambda sheet: sheet.write_formula(1, 12, '=IF(1,"","x")')
    )
    text = {}
    with zipfile.ZipFile(path) as archive:
        text = {one: archive.read(one) for one in archive.namelist()}
    sheet = "xl/worksheets/sheet1.xml"
    before = b'<c r="M2"><f>IF(1,"","x")</f><v>0</v></c>'
    assert before in text[sheet]
    text[sheet] = text[sheet].replace(before, b'<c r="M2" t="str"><f>IF(1,"","x")</f><v></v></c>')
    with zipfile.ZipFile(path, "w") as archive:
        for name, content in text.items():
            archive.writestr(name, content)
    assert not warned(hl.read_log(path), "cells-without-value")


def test_titles_and_blank_lines_of_a_workbook_keep_the_numbers_of_its_lines(tmp_path, log):
    def change(sheet):
        sheet.write(2, 0, "Cell 3, second visit")
        sheet.write(6, 8, "much")

    text = fault(workbook(tmp_path / "log.xlsx", log, change, first=4))
    assert "line 7" in text
    assert "'much'" in text
    path = workbook(tmp_path / "log.xlsx", log, lambda sheet: sheet.write(2, 0, "Visit"), first=4)
    found = hl.read_log(path)
    assert "above the header: 'Visit'" in warned(found, "title-lines")[0].message
    assert found.station_names[0] == "1"


@pytest.mark.parametrize("ending", ["xls", "xlsb", "ods"])
def test_workbooks_whose_errors_cannot_be_told_are_refused(tmp_path, ending):
    path = tmp_path / f"log.{ending}"
    path.write_bytes(b"PK")
    assert "saved as .xlsx" in fault(path)


# --- text -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("title", ["Cell 3; second visit", "Cell 3;;;", "Messung vom 25.11.2026"])
def test_titles_above_the_header_are_passed_over_and_said(tmp_path, log, title):
    path = tmp_path / "log.csv"
    path.write_text("\n".join([title, "", *lines_of(log, ";"), ""]))
    for found in (hl.read_log(path), hl.read_recording(path)):
        assert "passed over 1 line above" in warned(found, "title-lines")[0].message
        assert found.ranges.shape == (ROWS, 2)


def test_a_header_that_is_no_title_stays(tmp_path, log):
    path = tmp_path / "log.csv"
    sparse = log | {"range_a": [log["range_a"][0]] + [""] * (ROWS - 1)}
    path.write_text("\n".join([*lines_of(sparse), ""]))
    assert not hl.read_log(path).warnings


def test_the_separator_that_a_spreadsheet_states(tmp_path, log):
    path = tmp_path / "log.csv"
    path.write_text("\n".join(["sep=;", *lines_of(log, ";"), ""]))
    assert not hl.read_log(path).warnings
    assert not hl.read_recording(path).warnings
    bad = log | {"x": ["much", *log["x"][1:]]}
    path.write_text("\n".join(["sep=;", *lines_of(bad, ";"), ""]))
    assert "line 3" in fault(path)


@pytest.mark.parametrize(
    "form",
    ["{d:02}.11.2026 08:15:{s:02},{ms:03}", "{d:02}.11.2026 08:15:{s:02}", "{d}.11.2026 08:{s:02}"],
)
def test_german_dates(tmp_path, log, form):
    seconds = np.arange(ROWS)
    stamps = [form.format(d=25, s=s, ms=250) for s in seconds.tolist()]
    poses = {"time": stamps} | {name: log[name] for name in NAMES}
    readings = {"time": stamps} | {name: log[name] for name in log if name not in NAMES}
    for name, columns in (("poses.csv", poses), ("late.csv", readings)):
        (tmp_path / name).write_text("\n".join([*lines_of(columns, ";"), ""]))
    given = hl.LogFormat(readings=tmp_path / "late.csv", tolerance_s=0.01)
    assert hl.read_log(tmp_path / "poses.csv", given).ranges.shape == (ROWS, 2)


@pytest.mark.parametrize("separator", [",", ";", "\t"])
def test_cells_in_quotes_are_what_they_are_without(tmp_path, log, separator):
    plain = tmp_path / "plain.csv"
    plain.write_text("\n".join([*lines_of(log, separator), ""]))
    names = log | {"plane": [f'the "{one}"{separator} again' for one in log["plane"]]}
    names = names if separator != "\t" else log
    quoted = {f' "{name}" ': cells for name, cells in names.items()}
    quoted = {
        name: ['"' + str(one).replace('"', '""') + '" ' for one in cells]
        for name, cells in quoted.items()
    }
    path = tmp_path / "quoted.csv"
    path.write_text("\n".join([*lines_of(quoted, separator), ""]))
    found, wanted = hl.read_recording(path), hl.read_recording(plain)
    assert (found.ranges == wanted.ranges).all()
    assert (found.world_t_hand == wanted.world_t_hand).all()
    assert found.plane_labels == tuple(names["plane"])


@pytest.mark.parametrize("column", ["x", "range_a"])
def test_points_that_may_stand_between_thousands_are_refused(tmp_path, log, column):
    """Millimetres as German spreadsheets write them: 1.404 is one metre and 404 mm, or 1.4 mm."""
    scaled = {name: [f"{1e3 * one:.6f}".rstrip("0") for one in log[name]] for name in ("y", "z")}
    scaled |= {name: [f"{1e3 * one:.0f}" for one in log[name]] for name in ("x", "range_a")}
    scaled |= {"range_b": [f"{1e3 * one:.6f}" for one in log["range_b"]]}
    scaled[column] = ["1.404", "-970" if column == "x" else "970", *scaled[column][2:]]
    path = tmp_path / "log.csv"
    path.write_text("\n".join([*lines_of(log | scaled, ";"), ""]))
    given = {"rotation": "xyzw", "units": "mm", "range_units": "mm", "as_stated": True}
    text = fault(path, **given)
    assert f"line 2, column {column}: found '1.404'" in text
    assert "state --decimal point" in text
    assert "or --decimal comma" in text
    found = hl.read_log(path, hl.LogFormat(**given, decimal="point"))
    assert (found.world_t_hand[0, 0] if column == "x" else found.ranges[0, 0]) == pytest.approx(
        1.404e-3
    )
    commas = log | scaled
    commas = {name: [str(one) for one in cells] for name, cells in commas.items()}
    for name in set(commas) - {column}:
        commas[name] = [one.replace(".", ",") for one in commas[name]]
    path.write_text("\n".join([*lines_of(commas, ";"), ""]))
    found = hl.read_log(path, hl.LogFormat(**given, decimal="comma"))
    assert (found.world_t_hand[0, 0] if column == "x" else found.ranges[0, 0]) == pytest.approx(
        1.404
    )


# --- tables of values -----------------------------------------------------------------------------


def test_a_field_twice_in_a_line_of_json_is_refused(tmp_path, log):
    rows = [dict(zip(log, row, strict=True)) for row in zip(*log.values(), strict=True)]
    lines = [json.dumps(row) for row in rows]
    lines[2] = lines[2][:-1] + ', "range_a": 0.3}'
    path = tmp_path / "log.jsonl"
    path.write_text("\n".join(lines))
    assert "line 3: found the field 'range_a' twice" in fault(path)
    lines[2] = '{"x": ' + "[" * 100_000 + "]" * 100_000 + "}"
    path.write_text("\n".join(lines))
    assert "line 3: found too deep nesting" in fault(path)


def test_columns_of_decimals_are_numbers_and_binary_ones_are_refused(tmp_path, log):
    path = tmp_path / "log.parquet"
    exact = [decimal.Decimal(round(1e6 * d)).scaleb(-6) for d in log["range_a"]]
    pl.DataFrame(log | {"range_a": exact}).write_parquet(path)
    assert np.abs(hl.read_log(path).ranges[:, 0] - log["range_a"]).max() < 1e-6
    pl.DataFrame(log | {"range_a": [b"\xff\x00"] * ROWS}).write_parquet(path)
    assert "range_a: found a column of binary values" in fault(path)


@pytest.mark.parametrize("label", [1.0, 1e300, math.inf])
def test_labels_that_are_floats(tmp_path, log, label):
    path = tmp_path / "log.parquet"
    pl.DataFrame(log | {"plane": [label] * ROWS}).write_parquet(path)
    (name,) = hl.read_log(path).plane_names
    assert float(name) == label  # 1e300 or 1e+300, as the version of polars has it
    assert not name.endswith(".0")


def test_a_panic_of_a_library_is_one_line(tmp_path, log, monkeypatch, refusal):
    class PanicError(BaseException):
        pass

    def panic(*_, **__):
        raise PanicError("index out of bounds\nbacktrace")

    path = tmp_path / "log.parquet"
    pl.DataFrame(log).write_parquet(path)
    monkeypatch.setattr(pl, "scan_parquet", panic)
    err = refusal("convert", path)
    assert "no table (index out of bounds)" in err
    assert "backtrace" not in err


# --- bags -----------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("chunks", [1, 8])
@pytest.mark.parametrize("compression", ["bz2", "lz4"])
def test_chunks_of_a_bag_stop_at_the_limit(tmp_path, compression, chunks):
    """Zeros: one chunk of 128 MB, and eight of 16 MB, are more than the 64 MB of any file."""
    pytest.importorskip("rosbags")
    pack = bz2.compress if compression == "bz2" else pytest.importorskip("lz4.frame").compress
    path = tmp_path / "log.bag"
    limit = "packed bytes that unpack to"
    content = pack(zeros((1 << 27) // chunks))
    assert limit in fault(ros1_bag(path, content, compression.encode(), chunks))
    content = pack(zeros(1 << 20))
    assert limit not in fault(ros1_bag(path, content, compression.encode(), chunks))
    assert "ends too early" in fault(ros1_bag(path, content[:-20], compression.encode(), chunks))


def test_chunks_of_mcap_are_judged_before_they_are_unpacked(tmp_path):
    pytest.importorskip("rosbags")
    path = tmp_path / "log.mcap"
    bomb = zstd_zeros(25_000)
    assert zstd_bound(bomb) == 25_000 << 17
    assert zstd_bound(b"\x53\x2a\x4d\x18" + struct.pack("<I", 3) + b"abc" + bomb) == 25_000 << 17
    assert "packed bytes that unpack to" in fault(mcap(path, bomb, 1000))
    assert "packed bytes that unpack to" in fault(mcap(path, b"", 1 << 40))
    lying = b"\x04\x22\x4d\x18\x68\x40" + struct.pack("<Q", 1 << 40) + bytes(9)
    assert "packed bytes that unpack to" in fault(mcap(path, lying, 1000, b"lz4"))


@pytest.mark.parametrize("level", [1, 19])
def test_the_bound_of_a_packed_text_is_near_its_size(level):
    zstd = pytest.importorskip("backports.zstd")
    text = np.random.default_rng(1).integers(0, 4, 1_000_000, dtype=np.uint8).tobytes()
    packed = zstd.compress(text, level)
    assert len(text) <= zstd_bound(packed) <= len(text) + (1 << 17)
    assert zstd_bound(packed + packed) == 2 * zstd_bound(packed)


@pytest.mark.parametrize("kind", ["ros1", "mcap"])
def test_two_publishers_on_one_topic_are_noticed(tmp_path, kind):
    pytest.importorskip("rosbags")
    from bags import Messages, write_bag

    def messages(make: Messages):
        for i in range(20):
            yield "/tcp", 0.1 * i, make.pose(0.1 * i, [0.1, 0.2, 0.3], [0.0, 0.0, 0.0, 1.0])
            reading = make.range(0.1 * i, 0.2)
            if i == 7:
                reading.header.frame_id = "other"
            yield "/laser", 0.1 * i, reading

    text = fault(write_bag(tmp_path, kind, messages), plane="A")
    assert "messages in the frames 'laser' and 'other' on topic /laser" in text


# --- time and memory ------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("name", ["XFD1048576.xlsx", "bomb.bag"])
def test_an_odd_file_takes_one_line_and_little_memory(tmp_path, name):
    """The gate runs `python -m benchmarks.odd_files`, which measures all of them and fails likewise."""
    for module in ("xlsxwriter", "fastexcel", "rosbags"):
        pytest.importorskip(module)
    one = next(one for one in ODD if one.name == name)
    found = measured("convert", one.written(tmp_path))
    assert found.code == 2, found.message
    assert found.faults(one) == []
