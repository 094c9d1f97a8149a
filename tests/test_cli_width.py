"""Screens of any width, without colours, in any encoding."""

import io
import os
import pty
import re
import shlex
import shutil
import subprocess
import sys
from dataclasses import replace

import pytest
from helpers import GRIPPER, ROOT

import handlaser_gtsam as hl
from handlaser_gtsam.cli import main
from handlaser_gtsam.cli.verbs import VERBS, examples_of
from handlaser_gtsam.results.description.beams import CalibrationDescription
from handlaser_gtsam.results.description.tables import PLAIN, Cell, Column, Table, text_table
from handlaser_gtsam.results.lines import as_many

RECORDING = GRIPPER / "recording.csv"
RUN = [sys.executable, "-m", "handlaser_gtsam.cli"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Return a folder where every example runs, in any order, and the names are of all scripts."""
    path = tmp_path_factory.mktemp("foreign")
    text = RECORDING.read_text()
    for old, new in (("\nA,", "\nStraße,"), ("\nB,", "\n壁,"), ("range_2", "range_β")):
        text = text.replace(old, new)
    (path / "recording.csv").write_text(text)
    for source in (GRIPPER / "rig.toml", ROOT / "examples" / "study" / "study.toml"):
        shutil.copy(source, path)
    recording = hl.read_recording(path / "recording.csv")
    found = hl.calibrate(recording, hl.read_rig(path / "rig.toml").noise)
    hl.write_calibration(path / "calibration.json", found)
    return path


def words_of(example):
    """Return the words of an example; what it repeats, it does once: test_cli_help runs it whole."""
    words = shlex.split(example.replace("\\\n", " "))[1:]
    few = {"validate": "--splits", "study": "--runs"}.get(words[0])
    return [*words, few, "1"] if few and "--hold-out" not in words else words


ENDING = {verb: examples_of(verb)[0] for verb in VERBS if verb not in ("watch", "plot")}
"""What ends by itself, and needs no extra; `plot` says one line a file."""
SCREENS = [
    *ENDING.values(),
    "handlaser export calibration.json --to kuka --out a_file_with_a_name.dat",
    "handlaser calibrate recording.csv --rig rig.toml --incremental --verbose",
    "handlaser validate recording.csv --rig rig.toml --hold-out recording.csv",
    "handlaser plan --rig planned.toml",
]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("example", "encoding"),
    [*((example, "ascii") for example in SCREENS), (ENDING["calibrate"], "utf-8")],
)
def test_every_screen_fits_a_narrow_terminal_of_any_encoding(
    folder, monkeypatch, example, encoding
):
    monkeypatch.chdir(folder)
    monkeypatch.setenv("COLUMNS", "50")
    shutil.copy(ROOT / "examples" / "planned" / "rig.toml", "planned.toml")
    streams = [io.TextIOWrapper(io.BytesIO(), encoding=encoding) for _ in range(2)]
    monkeypatch.setattr(sys, "stdout", streams[0])
    monkeypatch.setattr(sys, "stderr", streams[1])
    extra = ["--force"] if "simulate" in example else []
    monkeypatch.setattr(sys, "argv", ["handlaser", *words_of(example), *extra])
    with pytest.raises(SystemExit) as stop:
        main()
    texts = []
    for stream in streams:
        stream.flush()
        texts.append(stream.buffer.getvalue().decode(encoding))
    out, err = texts
    assert (stop.value.code or 0, err) == (0, "")
    assert out
    assert "\x1b" not in out
    assert "\\u2500" not in out  # the lines of a table are made of what there is
    if example != ENDING["export"]:  # an export without --out is for copying, and not wrapped
        characters = re.sub(r"\\(x[0-9a-f]{2}|u[0-9a-f]{4})", "x", out)  # an escape stands for one
        assert max(map(len, characters.splitlines())) <= 50


@pytest.mark.slow
def test_nothing_is_lost_on_a_narrow_screen(handlaser, monkeypatch):
    """The words are the same, but for where the lines end, and the mounts."""
    arguments = ("calibrate", RECORDING, "--rig", GRIPPER / "rig.toml", "--cross-check")
    texts = {}
    for columns in (50, 80, 100, 200):
        monkeypatch.setenv("COLUMNS", str(columns))
        texts[columns] = handlaser(*arguments)[1]
    monkeypatch.delenv("COLUMNS")
    assert handlaser(*arguments)[1] == texts[100] == texts[200]
    values = re.findall(r"(?<= )-?\d+\.\d{3,}(?= )", texts[100])
    assert len(values) > 20
    moved = re.findall(r"moving a spot by [\d.]+ mm", " ".join(texts[100].split()))
    assert moved
    for columns in (50, 80):
        assert moved == re.findall(r"moving a spot by [\d.]+ mm", " ".join(texts[columns].split()))
        assert len(texts[columns].splitlines()) <= as_many(30, columns)
        for value in values[:6]:
            assert value in texts[columns]


@pytest.fixture(scope="module")
def calibration():
    recording = hl.read_recording(RECORDING)
    return hl.calibrate(recording, hl.Noise(3e-5, 0.0, 0.0), hl.CalibrationOptions("k1"))


@pytest.mark.parametrize("width", [50, 80, 100])
@pytest.mark.parametrize("count", [1, 4, 12])
def test_mounts_of_any_number_fit(calibration, width, count):
    beams = ([*calibration.beams.values()] * 3)[:count]
    named = {f"b{i}": replace(beam, name=f"b{i}") for i, beam in enumerate(beams)}
    many = replace(calibration, beams=named, covariance=None)
    table = CalibrationDescription(many, calibration.verdict).beams
    lines = text_table(table, width, 8)
    assert max(map(len, lines)) <= width
    words = " ".join(lines).split()
    for row in table.rows[:8]:  # every number stands somewhere, and the name in every part
        assert {cell.text.translate(PLAIN) for cell in row} <= set(words)
    assert ("and 4 more: --verbose" in lines) == (count == 12)


def test_a_table_that_does_not_fit_stands_in_parts():
    columns = (Column("plane", number=False), *map(Column, ("b mm", "+- mm", "a long name")))
    rows = (
        (Cell("A"), Cell("-583.809"), Cell("0.1553"), Cell("")),
        (Cell("a plane with a long name"), Cell("1"), Cell("2"), Cell("x" * 20)),
    )
    table = Table("planes", "", columns, rows)
    assert text_table(table, 30) == [
        "plane        b mm   +- mm",
        "A        -583.809  0.1553",
        "a p…ame         1       2",
        "plane             a long name",
        "A",
        "a p…ame  xxxxxxxxxxxxxxxxxxxx",
    ]
    assert len(text_table(table, 80)) == 3


@pytest.mark.slow
def test_nothing_is_coloured(handlaser):
    """What a terminal gets is what a file gets."""
    arguments = ("calibrate", RECORDING, "--poses", "exact", "--range-error", "k1k2", "--verbose")
    assert on_a_terminal(*arguments) == handlaser(*arguments)[1]


def on_a_terminal(*arguments):
    """Return what a terminal of 100 columns gets."""
    outside, inside = pty.openpty()
    shown = os.environ | {"TERM": "xterm-256color", "COLUMNS": "100"}
    with subprocess.Popen([*RUN, *map(str, arguments)], stdout=inside, env=shown) as run:
        os.close(inside)
        written = b""
        try:
            while part := os.read(outside, 65536):
                written += part
        except OSError:  # the other end is closed
            pass
    os.close(outside)
    assert run.returncode == 0
    return written.decode().replace("\r\n", "\n")


# --- encodings ---------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize(
    "environment",
    [{"PYTHONIOENCODING": "ascii"}, {"LC_ALL": "C", "PYTHONCOERCECLOCALE": "0"}],
)
def test_the_environment_decides_the_encoding(folder, environment):
    run = subprocess.run(
        [*RUN, "check", "recording.csv"],
        cwd=folder,
        env={**os.environ, **environment, "PYTHONUTF8": "0"},
        capture_output=True,
        check=False,
    )
    assert (run.returncode, run.stderr) == (0, b"")
    assert run.stdout.isascii()
    assert b"\\u58c1" in run.stdout
    assert b"\\u2500" not in run.stdout
