"""Odd files: each ends in one line or in a warning, in little time and memory, never in silence."""

import decimal
import json
import math
import zipfile

import numpy as np
import polars as pl
import pytest

import handlaser_gtsam as hl

NAMES = ("x", "y", "z", "qx", "qy", "qz", "qw")
ROWS = 8


@pytest.fixture
def log():
    """Columns of a good log: eight stations before two planes, two beams."""
    rng = np.random.default_rng(3)
    half = rng.uniform(-0.1, 0.1, (ROWS, 3))
    poses = np.column_stack(
        (rng.uniform(-0.2, 0.2, (ROWS, 3)), half, np.sqrt(1.0 - (half**2).sum(axis=1)))
    )
    columns = dict(zip(NAMES, poses.T.tolist(), strict=True))
    ranges = {f"range_{b}": rng.uniform(0.1, 0.2, ROWS).tolist() for b in "ab"}
    return {"plane": ["A"] * 4 + ["B"] * 4} | columns | ranges


def fault(path, **given):
    with pytest.raises(hl.InputError) as caught:
        hl.read_log(path, hl.LogFormat(**given))
    text = str(caught.value)
    assert "\n" not in text
    return text


def warned(recording, code):
    return [one for one in recording.warnings if one.code == code]


def lines_of(columns, separator=","):
    rows = zip(*columns.values(), strict=True)
    return [separator.join(columns)] + [separator.join(map(str, row)) for row in rows]


# --- workbooks ------------------------------------------------------------------------------------


def workbook(path, columns, change=lambda _: None, first=0):
    xlsxwriter = pytest.importorskip("xlsxwriter")
    pytest.importorskip("fastexcel")
    with xlsxwriter.Workbook(path) as book:
        sheet = book.add_worksheet()
        for j, (name, cells) in enumerate(columns.items()):
            sheet.write(first, j, name)
            for i, cell in enumerate(cells):
                sheet.write(first + 1 + i, j, cell)
        change(sheet)
    return path


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
    assert hl.read_log(path).plane_names == (str(label).removesuffix(".0"),)


def test_a_panic_of_a_library_is_one_line(tmp_path, log, monkeypatch, handlaser):
    class PanicError(BaseException):
        pass

    def panic(*_, **__):
        raise PanicError("index out of bounds\nbacktrace")

    path = tmp_path / "log.parquet"
    pl.DataFrame(log).write_parquet(path)
    monkeypatch.setattr(pl, "scan_parquet", panic)
    code, _, err = handlaser("convert", path)
    assert code == 2
    assert "no table (index out of bounds)" in err
    assert "backtrace" not in err
