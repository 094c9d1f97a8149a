"""Help with examples that run, errors of usage in one line, shell completion, and --log-level."""

import logging
import os
import re
import shlex
import shutil
import subprocess
import sys
from importlib import import_module
from inspect import getdoc
from pkgutil import iter_modules

import pytest
from helpers import GRIPPER, ROOT

import handlaser_gtsam as hl
from handlaser_gtsam import cli
from handlaser_gtsam.cli.options import logging_at
from handlaser_gtsam.cli.verbs import VERBS, examples_of

RECORDING = GRIPPER / "recording.csv"
QUICK = ("--poses", "exact", "--range-error", "k1k2", "--range-sigma-mm", "0.03")


# --- help --------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Return a folder with the files that examples name, and what earlier ones wrote.

    Also the calibration that the first of them writes: where several processes share the tests, it may
    run in another one.
    """
    path = tmp_path_factory.mktemp("examples")
    for source in (RECORDING, GRIPPER / "rig.toml", ROOT / "examples" / "study" / "study.toml"):
        shutil.copy(source, path)
    rig = hl.read_rig(path / "rig.toml")
    options = hl.CalibrationOptions(sensor=rig.sensor)
    calibration = hl.calibrate(hl.read_recording(RECORDING, rig.sensor), rig.noise, options)
    hl.write_calibration(path / "calibration.json", calibration)
    return path


def test_every_verb_has_examples():
    assert all(examples_of(verb) for verb in VERBS)


def test_every_module_with_examples_is_a_verb():
    names = [one.name for one in iter_modules(cli.__path__) if not one.name.startswith("_")]
    of_name = {name: getattr(import_module(f"{cli.__name__}.{name}"), name, None) for name in names}
    shown = {name for name, one in of_name.items() if "\nExamples\n" in (getdoc(one) or "")}
    assert shown == set(VERBS)


@pytest.mark.slow
@pytest.mark.parametrize("verb", VERBS)
def test_examples_run_as_the_help_has_them(handlaser, folder, monkeypatch, verb):
    monkeypatch.chdir(folder)
    _, text, _ = handlaser(verb, "--help")
    lines = text.split("Examples:\n")[1].replace("\\\n", " ").splitlines()
    commands = [shlex.split(line) for line in lines if line.strip()]
    assert len(commands) == len(examples_of(verb)) >= 1
    assert all(command[:2] == ["handlaser", verb] for command in commands)
    if verb == "watch":  # runs until it is stopped: see test_watch
        return
    if verb == "plot":
        pytest.importorskip("matplotlib")
    for command in commands:
        code, _, err = handlaser(*command[1:])
        assert (code, err) == (0, ""), command
    if verb == "calibrate":
        assert hl.read_calibration(folder / "calibration.json").success


@pytest.mark.parametrize("verb", ["", *VERBS])
def test_help_is_no_wider_than_the_terminal(handlaser, monkeypatch, verb):
    monkeypatch.setenv("COLUMNS", "50")
    code, text, err = handlaser(*verb.split(), "--help")
    assert (code, err) == (0, "")
    assert max(map(len, text.splitlines())) <= 50


def test_options_of_logs_stand_by_themselves(handlaser):
    _, text, _ = handlaser("convert", "--help")
    before, after = text.split("Options for logs:\n")
    assert "--rig" in before
    assert "--write-log" in before
    assert "--quiet" in before
    assert "--pose-format" not in before
    assert "--pose-format" in after
    assert "--rig <path>" not in after


def test_the_help_of_calibrate_begins_with_what_most_people_need(handlaser):
    _, text, _ = handlaser("calibrate", "--help")
    options = re.findall(r"(?m)^  (?:-\w, )?(--[a-z-]+)", text)
    assert options[:4] == ["--rig", "--range-sigma-mm", "--out", "--report"]
    assert len(options) <= 30
    titles = re.findall(r"(?m)^(\w[\w ,]+):$", text)
    assert titles[:2] == ["Arguments", "Options"]
    assert len(titles) == 4


def test_help_is_as_wide_as_the_terminal(handlaser, monkeypatch):
    for columns in (80, 160):
        monkeypatch.setenv("COLUMNS", str(columns))
        widest = max(map(len, handlaser("calibrate", "--help")[1].splitlines()))
        assert columns - 12 < widest <= columns  # a word that does not fit is on the next line


def test_nothing_but_the_name_shows_the_help(handlaser):
    assert handlaser() == handlaser("--help")
    assert handlaser()[0] == 0


# --- errors ------------------------------------------------------------------------------------------

WRONG = {
    "levitate": "No such command 'levitate'",
    "calibrate": "Missing argument",
    "calibrate a b": "unexpected extra argument",
    "calibrate x --range-eror 3": "--range-error",
    "calibrate x --range-error k3": "'k3' is not one of 'auto', 'none', 'k1', 'k1k2'",
    "calibrate x --range-sigma-mm thin": "'--range-sigma-mm'",
    "calibrate x --range-mm 3": "2 arguments",
    "calibrate x --out": "requires an argument",
    "simulate x --beams 0": "'--beams'",
    "check x --log-level loud": "'debug', 'info', 'warning', 'error'",
    "export x --to karel": "'kuka'",
    "export x": "Missing option '--to'",
    "--show-completion=x": "--show-completion",
    "calibrate x --r\x1b[31m": "\\x1b[31m",
}


@pytest.mark.parametrize("line", WRONG)
def test_errors_of_usage_are_one_line_with_a_hint(refusal, line):
    err = refusal(*line.split())
    assert err[:-1].isprintable()
    assert err.startswith("handlaser: ")
    assert WRONG[line] in err
    verb = line.split()[0]
    if verb in VERBS and "--range-mm" not in line and not line.endswith("--out"):
        assert f"handlaser {verb} --help" in err
    assert "--help shows what there is" in err


# --- completion --------------------------------------------------------------------------------------


def completed(*words):
    """Return what bash is told for the last of the words."""
    environment = os.environ | {
        "_HANDLASER_COMPLETE": "complete_bash",
        "COMP_WORDS": " ".join(words),
        "COMP_CWORD": str(len(words) - 1),
    }
    command = [sys.executable, "-m", "handlaser_gtsam.cli"]
    run = subprocess.run(command, capture_output=True, text=True, env=environment, check=True)
    return run.stdout.split()


@pytest.mark.slow
def test_verbs_options_and_choices_are_completed():
    assert completed("handlaser", "ca") == ["calibrate"]
    assert set(completed("handlaser", "")) == set(VERBS)
    assert completed("handlaser", "calibrate", "--range-e") == ["--range-error"]
    assert completed("handlaser", "export", "x.json", "--to", "ku") == ["kuka"]


@pytest.mark.skipif(shutil.which("bash") is None, reason="bash is not installed")
def test_bash_takes_the_completion_that_is_shown(tmp_path):
    """By the script itself, in a shell whose handlaser is this one."""
    fake = tmp_path / "handlaser"
    fake.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m handlaser_gtsam.cli "$@"\n')
    fake.chmod(0o755)
    script = (
        "export _TYPER_COMPLETE_TEST_DISABLE_SHELL_DETECTION=1\n"
        "source <(handlaser --show-completion bash)\n"
        "COMP_WORDS=(handlaser vali); COMP_CWORD=1\n"
        "_handlaser_completion handlaser\n"
        'echo "${COMPREPLY[@]}"; complete -p handlaser\n'
    )
    environment = os.environ | {"PATH": f"{tmp_path}:{os.environ['PATH']}"}
    run = subprocess.run(
        ["bash", "-c", script], capture_output=True, text=True, env=environment, check=True
    )
    first, second = run.stdout.splitlines()
    assert first == "validate"
    assert "_handlaser_completion handlaser" in second


def test_completion_imports_nothing_heavy():
    code = (
        "import sys, os; os.environ.update(_HANDLASER_COMPLETE='complete_bash',"
        " COMP_WORDS='handlaser export x --to', COMP_CWORD='4')\n"
        "from handlaser_gtsam.cli import main\n"
        "sys.argv = ['handlaser']\n"
        "try: main()\n"
        "except SystemExit: pass\n"
        "heavy = {'gtsam', 'numpy', 'scipy', 'polars'} & set(sys.modules)\n"
        "assert not heavy, heavy\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True, capture_output=True)


# --- logging -----------------------------------------------------------------------------------------

STAGES = [
    "calibrating 44 stations, 4 planes, 4 beams",
    "stage: search",
    "start: ",
    "converged",
]


def test_stages_are_logged_to_stderr(handlaser):
    run = ("calibrate", RECORDING, *QUICK, "--json")
    quiet = handlaser(*run)
    code, out, err = handlaser(*run, "--log-level", "info")
    assert (code, out) == quiet[:2]
    assert quiet[2] == ""
    lines = err.splitlines()
    assert all(re.fullmatch(r" *\d+\.\d{3} s (info|warning) +\S.*", line) for line in lines)
    found = [next(i for i, line in enumerate(lines) if stage in line) for stage in STAGES]
    assert found == sorted(found)
    debug = handlaser(*run, "--log-level", "debug")[2].splitlines()
    assert any("debug   step 1: cost" in line for line in debug)
    assert len(debug) > len(lines)
    assert handlaser(*run, "--log-level", "error")[2] == ""
    assert logging.getLogger("handlaser_gtsam").level == logging.NOTSET


@pytest.mark.slow
def test_warnings_of_a_calibration_are_logged(handlaser):
    run = ("calibrate", RECORDING, *QUICK[:2], "--range-sigma-mm", "0.003", "--json")
    err = handlaser(*run, "--log-level", "warning")[2]
    logged = [line for line in err.splitlines() if " s warning " in line]
    assert logged
    assert len(logged) == sum(line.startswith("WARNING") for line in err.splitlines())


def test_names_are_logged_escaped(capsys):
    logger = logging.getLogger("handlaser_gtsam")
    with logging_at("info"):
        logger.info("plane %s", "a\x1b[31m\nb")
        logger.debug("never")
    logger.info("never")
    out, err = capsys.readouterr()
    assert out == ""
    assert err.endswith(" s info    plane a\\x1b[31m\\nb\n")
    assert err.count("\n") == 1


@pytest.mark.slow
def test_from_python_nothing_is_heard_unless_logging_is_set_up():
    code = (
        "import logging, sys\nimport handlaser_gtsam as hl\n"
        f"recording = hl.read_recording({str(RECORDING)!r})\n"
        "def calibrate():\n"
        "    noise = hl.Noise(3e-5, 0.0, 1e-4)\n"
        "    hl.calibrate(recording, noise, hl.CalibrationOptions('none', poses='exact'))\n"
        "calibrate()\n"
        "print('set up', file=sys.stderr)\n"
        "logging.basicConfig(level=logging.INFO)\n"
        "calibrate()\n"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout == ""
    assert run.stderr.startswith("set up\n")
    assert "INFO:handlaser_gtsam:stage: search" in run.stderr
