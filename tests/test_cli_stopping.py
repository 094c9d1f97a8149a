"""Ctrl-C at any moment, and the sign of life of a command that computes."""

import os
import pty
import signal
import subprocess
import sys
import time

import pytest
from helpers import simulated

from handlaser_gtsam.cli.answer import QUIET_S, working
from handlaser_gtsam.cli.stopping import CtrlC
from handlaser_gtsam.files.recording_csv import write_recording
from handlaser_gtsam.progress import tell
from handlaser_gtsam.validation.scenes import Layout

BEGUN = """
import signal
signal.signal(signal.SIGINT, signal.default_int_handler)  # whatever the shell of the tests says
from handlaser_gtsam.cli import main
install = signal.signal
def installed(*arguments):
    before = install(*arguments)
    print("ready", flush=True)
    return before
signal.signal = installed
main()
"""
"""Says so when the command takes care of the signal."""
COMPUTING = """
import signal
signal.signal(signal.SIGINT, signal.default_int_handler)
from handlaser_gtsam.cli import answer, main
told_to = answer.told_to
def listening(listener):
    def listened(told):
        print("ready", flush=True)
        listener(told)
    return told_to(listened)
answer.told_to = listening
main()
"""
"""Says so when the computation has begun."""
CLEAR = b"\r\x1b[K"


@pytest.fixture(scope="module")
def long(tmp_path_factory):
    """A recording whose validation takes much longer than any test waits."""
    path = tmp_path_factory.mktemp("long") / "recording.csv"
    write_recording(path, simulated(layout=Layout(beams=6, planes=40))[0])
    return path


def commands(recording, folder):
    return {
        "calibrate": ["calibrate", recording, "--out", folder / "result.json", "-q"],
        "calibrate --incremental": ["calibrate", recording, "--incremental"],
        "validate": ["validate", recording],
        "simulate": ["simulate", folder / "scene", "--planes", "3000", "--stations", "300"],
    }


def stopped(program, arguments, seconds):
    """Send SIGINT so many seconds after the program is ready; return code, stdout and stderr."""
    process = subprocess.Popen(
        [sys.executable, "-c", program, *map(str, arguments)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert process.stdout.readline() == "ready\n"
    time.sleep(seconds)
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=60)
    return process.returncode, out, err


@pytest.mark.parametrize("seconds", [0.0, 0.4])
@pytest.mark.parametrize(
    "command", ["calibrate", "calibrate --incremental", "validate", "simulate"]
)
def test_a_stop_at_any_moment_is_one_line_and_130(long, tmp_path, command, seconds):
    code, _, err = stopped(BEGUN, commands(long, tmp_path)[command], seconds)
    assert (code, err) == (130, "handlaser: stopped by Ctrl-C\n")
    assert not list(tmp_path.rglob(".handlaser-*"))
    result = tmp_path / "result.json"
    assert not result.exists() or result.read_text().endswith("}\n")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("command", "seconds"),
    [("validate", 0.2), ("calibrate --incremental", 0.2), ("calibrate", 0.0)],
)
def test_a_stop_of_the_computation_is_one_line_and_130(long, tmp_path, command, seconds):
    code, out, err = stopped(COMPUTING, commands(long, tmp_path)[command], seconds)
    assert (code, err) == (130, "handlaser: stopped by Ctrl-C\n")
    assert set(out.split()) <= {"ready"}


@pytest.mark.slow
def test_the_command_says_what_it_does_after_a_second_and_takes_it_back(long, tmp_path):
    screen, terminal = pty.openpty()
    arguments = commands(long, tmp_path)["validate"]
    process = subprocess.Popen(
        [sys.executable, "-c", BEGUN, *map(str, arguments)],
        stdout=subprocess.PIPE,
        stderr=terminal,
    )
    os.close(terminal)
    began, shown = time.monotonic(), b""
    while b" s" not in shown:
        shown += os.read(screen, 1000)
    assert time.monotonic() - began >= QUIET_S
    assert shown.startswith(CLEAR + b"handlaser: ")
    process.send_signal(signal.SIGINT)
    assert process.wait(timeout=60) == 130
    shown += os.read(screen, 1000)
    os.close(screen)
    *_, last = shown.split(CLEAR)
    assert last == b"handlaser: stopped by Ctrl-C\r\n"
    assert b"handlaser" not in process.communicate()[0]


def test_a_part_that_was_stopped_is_followed_by_no_other(monkeypatch):
    monkeypatch.setattr(CtrlC, "asked", True)
    with working():
        tell("solve")
        with pytest.raises(KeyboardInterrupt):
            tell("leave-out", 1, 3)


def test_who_has_to_ignore_the_signal_goes_on_ignoring_it():
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        with CtrlC():
            assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN
        assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGINT, before)


def test_an_import_that_swallows_the_exception_does_not_swallow_the_stop(tmp_path):
    (tmp_path / "swallowing.py").write_text(
        "import os, signal\n"
        "try: os.kill(os.getpid(), signal.SIGINT)\n"
        "except BaseException: raise ImportError\n"
    )
    code = (
        "import signal, sys\n"
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "from handlaser_gtsam.cli.stopping import CtrlC\n"
        f"sys.path.append({str(tmp_path)!r})\n"
        "with CtrlC():\n"
        "    try: import swallowing\n"
        "    except ImportError: print('went on')\n"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (run.returncode, run.stdout) == (130, "")
    assert run.stderr == "handlaser: stopped by Ctrl-C\n"
