"""The command line and the files that it meets: where results go, and what a terminal can show."""

import io
import json
import os
import stat
import subprocess
import sys

import numpy as np
import pytest
from helpers import GRIPPER, simulated

# Before anything of theirs is replaced:
import handlaser_gtsam.session
import handlaser_gtsam.validation.validate  # noqa: F401
from handlaser_gtsam.cli import main
from handlaser_gtsam.data.recording import Recording
from handlaser_gtsam.files import writing
from handlaser_gtsam.files.recording_csv import write_recording
from handlaser_gtsam.validation.scenes import Layout

RECORDING, RIG = GRIPPER / "recording.csv", GRIPPER / "rig.toml"
QUICK = ["--poses", "exact", "--range-error", "none", "--range-sigma-mm", "0.03"]


@pytest.fixture
def never_solved(monkeypatch):
    def solved(*_, **__):
        pytest.fail("solved before everything was checked")

    monkeypatch.setattr("handlaser_gtsam.pipeline.calibrate", solved)


def refused(result, *words):
    """Assert that a run ended with exit code 2 and one printable line that holds `words`."""
    code, out, err = result
    assert (code, out) == (2, "")
    assert err.endswith("\n")
    assert err[:-1].isprintable()
    assert all(word in err for word in words)


@pytest.mark.usefixtures("never_solved")
class TestBeforeSolving:
    def test_a_missing_folder(self, handlaser, tmp_path):
        out = tmp_path / "missing" / "result.json"
        refused(handlaser("calibrate", RECORDING, "--out", out), "No such file or directory")

    def test_a_folder(self, handlaser, tmp_path):
        refused(handlaser("calibrate", RECORDING, "--out", tmp_path), "no regular file there")

    def test_a_file_in_place_of_the_folder(self, handlaser, tmp_path):
        (tmp_path / "file").write_text("")
        out = tmp_path / "file" / "result.json"
        refused(handlaser("calibrate", RECORDING, "--out", out), "Not a directory")

    def test_links_in_a_circle(self, handlaser, tmp_path):
        first, second = tmp_path / "first.json", tmp_path / "second.json"
        first.symlink_to(second)
        second.symlink_to(first)
        refused(handlaser("calibrate", RECORDING, "--out", first), "links that lead in a circle")

    def test_a_folder_that_is_a_circle(self, handlaser, tmp_path):
        (tmp_path / "loop").symlink_to(tmp_path / "loop")
        out = tmp_path / "loop" / "result.json"
        refused(handlaser("calibrate", RECORDING, "--out", out), "Too many levels")

    def test_an_endless_name(self, handlaser, tmp_path):
        refused(handlaser("calibrate", RECORDING, "--out", tmp_path / ("x" * 300)), "too long")

    def test_a_write_protected_file(self, handlaser, tmp_path, monkeypatch):
        out = tmp_path / "result.json"
        out.write_text("old")
        monkeypatch.setattr(writing.os, "access", lambda _, mode: mode != os.W_OK)
        refused(handlaser("calibrate", RECORDING, "--out", out), "write-protected")
        assert out.read_text() == "old"

    def test_a_folder_that_takes_no_files(self, handlaser, tmp_path, monkeypatch):
        def denied(*_, **__):
            raise PermissionError(13, "Permission denied")

        monkeypatch.setattr(writing.tempfile, "mkstemp", denied)
        out = tmp_path / "result.json"
        refused(handlaser("calibrate", RECORDING, "--out", out), "Permission denied")

    @pytest.mark.parametrize("link", ["symlink_to", "hardlink_to"])
    @pytest.mark.parametrize("source", [RECORDING, RIG])
    def test_an_input_under_another_name(self, handlaser, tmp_path, link, source):
        mine, out = tmp_path / source.name, tmp_path / "other.json"
        mine.write_bytes(source.read_bytes())
        getattr(out, link)(mine)
        inputs = {path.name: path for path in (RECORDING, RIG)} | {source.name: mine}
        run = handlaser(
            "calibrate", inputs["recording.csv"], "--rig", inputs["rig.toml"], "--out", out
        )
        refused(run, "the input itself")
        assert mine.read_bytes() == source.read_bytes()

    @pytest.mark.parametrize(
        ("option", "values"),
        [
            ("--at-range-mm", ["nan"]),
            ("--at-range-mm", ["1e300"]),
            ("--range-sigma-mm", ["1e300"]),
            ("--range-sigma-mm", ["-1"]),
            ("--pose-translation-sigma-mm", ["inf"]),
            ("--pose-rotation-sigma-deg", ["-0.1"]),
            ("--incidence-sigma-mm", ["nan"]),
            ("--range-mm", ["nan", "30"]),
            ("--range-mm", ["0", "1e300"]),
            ("--max-incidence-deg", ["1e300"]),
        ],
    )
    def test_numbers_beyond_sense(self, handlaser, option, values):
        refused(handlaser("calibrate", RECORDING, option, *values), "expected")


def test_a_result_keeps_the_mode_of_the_file_that_it_replaces(handlaser, tmp_path):
    out, fresh = tmp_path / "result.json", tmp_path / "fresh.json"
    out.write_text("old")
    out.chmod(0o640)
    for path in (out, fresh):
        assert handlaser("calibrate", RECORDING, "--rig", RIG, "-q", "--out", path)[0] == 0
        assert json.loads(path.read_text())["status"] == "converged"
    assert stat.S_IMODE(out.stat().st_mode) == 0o640
    mask = os.umask(0)
    os.umask(mask)
    assert stat.S_IMODE(fresh.stat().st_mode) == 0o666 & ~mask
    assert {path.name for path in tmp_path.iterdir()} == {"result.json", "fresh.json"}


def test_a_link_to_nothing_becomes_a_link_to_the_result(handlaser, tmp_path):
    link, target = tmp_path / "link.json", tmp_path / "results" / "new.json"
    target.parent.mkdir()
    link.symlink_to(target)
    assert handlaser("calibrate", RECORDING, "--rig", RIG, "-q", "--out", link)[0] == 0
    assert link.is_symlink()
    assert json.loads(target.read_text())["status"] == "converged"


@pytest.fixture(scope="module")
def foreign(tmp_path_factory):
    """A recording whose names no ASCII terminal can show, in a file whose name is not printable."""
    one, _ = simulated(layout=Layout(beams=3, planes=3), seed=2)
    names = {"A": "Straße", "B": "壁", "C": "стол"}
    recording = Recording(
        one.world_R_hand,
        one.world_t_hand,
        np.asarray(one.ranges),
        tuple(names[label] for label in one.plane_labels),
        ("β1", "β2", "β3"),
    )
    path = tmp_path_factory.mktemp("foreign") / "mess\x1b[31mung.csv"
    write_recording(path, recording)
    return path


COMMANDS = {
    "calibrate": ["calibrate", "{}", *QUICK, "--out", "{}.json"],
    "calibrate --verbose": ["calibrate", "{}", *QUICK, "--verbose", "--cross-check"],
    "calibrate --json": ["calibrate", "{}", *QUICK, "--json"],
    "calibrate --incremental": ["calibrate", "{}", *QUICK, "--incremental"],
    "check": ["check", "{}"],
    "validate": ["validate", "{}", *QUICK, "--splits", "1"],
    "simulate": ["simulate", "{}-folder", "--force"],
}


@pytest.mark.parametrize(
    ("command", "encoding"),
    [*((command, "ascii") for command in COMMANDS), ("calibrate", "latin-1"), ("check", "latin-1")],
)
def test_what_a_terminal_cannot_show_is_escaped(foreign, monkeypatch, command, encoding):
    streams = [io.TextIOWrapper(io.BytesIO(), encoding=encoding) for _ in range(2)]
    monkeypatch.setattr(sys, "stdout", streams[0])
    monkeypatch.setattr(sys, "stderr", streams[1])
    arguments = [argument.format(foreign) for argument in COMMANDS[command]]
    monkeypatch.setattr(sys, "argv", ["handlaser", *arguments])
    try:
        main()
        code = 0
    except SystemExit as stop:
        code = stop.code or 0
    texts = []
    for stream in streams:
        stream.flush()
        texts.append(stream.buffer.getvalue().decode(encoding))
    assert (code, texts[1].strip()) == (0, "")
    assert "\x1b" not in texts[0]
    if command in ("calibrate", "calibrate --verbose"):
        assert "\\u03b21" in texts[0]
    if command in ("check", "validate", "calibrate --incremental"):
        assert "\\u58c1" in texts[0]
    if command in ("calibrate", "simulate"):
        assert "\\x1b[31mung" in texts[0]


@pytest.mark.slow
def test_the_encoding_of_the_environment_is_honoured(foreign):
    environment = os.environ | {"PYTHONIOENCODING": "ascii"}
    run = subprocess.run(
        [sys.executable, "-m", "handlaser_gtsam.cli", "check", str(foreign)],
        capture_output=True,
        env=environment,
        check=False,
    )
    assert (run.returncode, run.stderr) == (0, b"")
    assert b"\\u58c1" in run.stdout


def test_a_file_name_with_terminal_escapes_is_shown_escaped(handlaser, tmp_path):
    path = tmp_path / "a\x1b[31m\nb.csv"
    refused(handlaser("calibrate", path), "a\\x1b[31m\\nb.csv", "no readable file")
    path.write_text("plane,x\nA,1\n")
    refused(handlaser("check", path), "a\\x1b[31m\\nb.csv, line 1", "no column 'y'")
