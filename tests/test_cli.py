"""The command line: exit codes, streams and files of the contract."""

import json
import math
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from helpers import DEGENERATE, GRIPPER, degenerate, simulated
from typer.testing import CliRunner

import handlaser_gtsam as hl
from handlaser_gtsam import __version__
from handlaser_gtsam.cli import main
from handlaser_gtsam.files.recording_csv import write_recording
from handlaser_gtsam.validation.scenes import Layout

RECORDING, RIG = str(GRIPPER / "recording.csv"), str(GRIPPER / "rig.toml")


def one_line(text):
    return text.endswith("\n") and text.count("\n") == 1


def test_tables_in_millimetres_and_degrees(handlaser):
    code, out, err = handlaser("calibrate", RECORDING, "--rig", RIG, "--cross-check", "-v")
    assert code == 0
    assert err == ""
    for words in ("location x", "mm", "direction, angle", "deg", "k2", "1/m", "chi^2 / dof", "rms"):
        assert words in out
    assert "start: translations" in out
    assert "cross-check with SciPy: largest difference" in out


def test_json_alone_on_stdout(handlaser):
    code, out, err = handlaser("calibrate", RECORDING, "--rig", RIG, "--json")
    assert (code, err) == (0, "")
    record = json.loads(out, parse_constant=lambda name: pytest.fail(f"{name} is not finite"))
    assert (record["format"], record["version"]) == ("handlaser-calibration", 1)
    assert record["status"] == "converged"
    beam = record["beams"][0]
    assert beam["name"] == "1"
    assert len(beam["location_m"]) == len(beam["direction"]) == 3
    assert set(beam["range_error"]) == {"k1", "k2_per_m"}
    assert set(beam["sigma"]) == {"location_m", "direction_rad", "k1", "k2_per_m"}
    assert [len(row) for row in beam["covariance"]] == [8] * 8
    assert set(record["planes"][0]) == {"name", "normal", "offset_m", "sigma"}
    assert {"readings", "rms_m", "max_m", "chi2", "dof", "sigma0", "rejected"} <= set(record["fit"])
    assert record["observability"]["rank"] == record["observability"]["unknowns"] == 40
    assert record["observability"]["undetermined"] == []
    assert record["start"]["method"] == "translations"
    assert record["iterations"] > 0


def test_quiet_prints_nothing_and_writes(handlaser, tmp_path):
    out_file = tmp_path / "calibration.json"
    code, out, err = handlaser("calibrate", RECORDING, "--rig", RIG, "-q", "--out", out_file)
    assert (code, out, err) == (0, "", "")
    assert json.loads(out_file.read_text())["status"] == "converged"
    assert [path.name for path in tmp_path.iterdir()] == ["calibration.json"]


def test_the_cross_check_of_a_script_goes_to_stderr(handlaser):
    code, out, err = handlaser("calibrate", RECORDING, "--rig", RIG, "--json", "--cross-check")
    assert code == 0
    assert json.loads(out)["status"] == "converged"
    assert "cross-check" in err
    assert one_line(err)


@pytest.mark.slow
@pytest.mark.parametrize("case", DEGENERATE)
def test_exit_3_says_what_is_undetermined(handlaser, tmp_path, case):
    path, out_file = tmp_path / "recording.csv", tmp_path / "result.json"
    write_recording(path, degenerate(case))
    code, out, err = handlaser("calibrate", path, "--out", out_file, "--verbose")
    assert code == 3
    assert "does not determine" in err
    assert "location" in err
    assert "turn the hand" in err
    assert one_line(err)
    assert "NOT A CALIBRATION" in out
    record = json.loads(out_file.read_text())
    assert record["status"] == "unobservable"
    assert record["observability"]["undetermined"]
    assert record["observability"]["advice"]
    assert record["beams"][0]["covariance"] is None
    assert None in record["beams"][0]["sigma"]["location_m"]
    assert "undetermined" in out
    assert record["beams"][0]["covariance"] is None


def test_exit_2_is_one_line(refusal, tmp_path):
    path = tmp_path / "recording.csv"
    path.write_text("plane,x,y,z,qx,qy,qz,qw,range_1\nA,0,0,0,0,0,0,1,near\n")
    err = refusal("calibrate", path, "--out", tmp_path / "result.json")
    assert all(words in err for words in ("line 2", "range_1", "'near'", "a finite number"))
    assert not (tmp_path / "result.json").exists()


@pytest.mark.parametrize(
    "arguments",
    [
        ["calibrate"],
        ["calibrate", RECORDING, "--range-error", "k3"],
        ["calibrate", RECORDING, "--range-sigma-mm", "thin"],
        ["calibrate", RECORDING, "--range-sigma-mm", "0"],
        ["calibrate", RECORDING, "--range-sigma-mm", "nan"],
        ["calibrate", RECORDING, "--range-mm", "30", "10"],
        ["calibrate", RECORDING, "--max-incidence-deg", "95"],
        ["calibrate", RECORDING, "--rig", "missing.toml"],
        ["calibrate", RECORDING, "--range-mm", "500", "600"],
        ["calibrate", RECORDING, "--out", "no/such/folder/result.json"],
        ["simulate", "somewhere", "--beams", "0"],
        ["simulate", "somewhere", "--scene", "moon"],
        ["levitate"],
    ],
)
def test_usage_errors_exit_2(refusal, arguments, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    refusal(*arguments)


def test_exit_4_names_the_limit(handlaser, tmp_path):
    rig = tmp_path / "rig.toml"
    rig.write_text("[noise]\nrange_sigma_mm = 0.03\n[limits]\nlocation_sigma_mm = 0.001\n")
    code, _, err = handlaser("calibrate", RECORDING, "--rig", rig, "--quiet")
    assert code == 4
    assert "location sigma" in err
    assert "above 0.001 mm" in err
    assert one_line(err)


def test_options_override_the_rig_file(handlaser):
    arguments = ("calibrate", RECORDING, "--rig", RIG, "--json")
    _, out, _ = handlaser(*arguments, "--range-sigma-mm", "0.06", "--range-mm", "0", "25")
    fit = json.loads(out)["fit"]
    assert fit["range_sigma_m"] == pytest.approx(6e-5)
    assert fit["rejected"]
    assert all(r["residual_m"] is None for r in fit["rejected"])


def test_warning_of_uncertain_poses_is_printed(handlaser):
    sigma = ("--pose-rotation-sigma-deg", "0.03")
    given = ("calibrate", RECORDING, *sigma, "--range-sigma-mm", "0.03", "--range-error", "k1k2")
    _, out, _ = handlaser(*given, "--poses", "exact")
    assert "taken as exact" in out
    _, out, _ = handlaser(*given)
    assert "taken as exact" not in out


def test_simulate_writes_what_ships(handlaser, tmp_path):
    """The files in examples/gripper are those of this command."""
    folder = tmp_path / "gripper"
    options = "--scene paper --pose-translation-sigma-mm 0 --pose-rotation-sigma-deg 0"
    options += " --k1 0.01 --k2-per-m 1.0 --seed 1 --quiet"
    code, out, err = handlaser("simulate", folder, *options.split())
    assert (code, out, err) == (0, "", "")
    for name in ("rig.toml", "truth.json", "recording.csv"):
        mine, shipped = (folder / name).read_text(), (GRIPPER / name).read_text()
        # Another processor may round the last digit differently.
        assert numbers_of(mine) == pytest.approx(numbers_of(shipped), rel=1e-12, abs=1e-15)


def numbers_of(text):
    words = text.replace(",", " ").replace("[", " ").replace("]", " ").split()
    found = []
    for word in words:
        try:
            found.append(float(word))
        except ValueError:
            continue
    assert found
    return found


def test_simulate_never_overwrites_unasked(handlaser, refusal, tmp_path):
    assert handlaser("simulate", tmp_path, "--quiet")[0] == 0
    before = (tmp_path / "recording.csv").read_bytes()
    assert "--force" in refusal("simulate", tmp_path, "--seed", "5")
    assert (tmp_path / "recording.csv").read_bytes() == before
    assert handlaser("simulate", tmp_path, "--seed", "5", "--force")[0] == 0
    assert (tmp_path / "recording.csv").read_bytes() != before


@pytest.mark.parametrize(("axes", "erring"), [((), (1, 4)), (("--pose-axes", "z"), (2, 5))])
def test_the_rig_of_a_simulation_states_the_axes_that_err(handlaser, tmp_path, axes, erring):
    assert handlaser("simulate", tmp_path, *axes, "--quiet")[0] == 0
    noise = hl.read_rig(tmp_path / "rig.toml").noise
    variances = np.zeros(6)
    variances[list(erring)] = math.radians(0.03) ** 2, 5e-5**2
    assert noise.pose_covariance == pytest.approx(np.diag(variances))
    recording, rig = tmp_path / "recording.csv", tmp_path / "rig.toml"
    code, out, _ = handlaser("calibrate", recording, "--rig", rig, "--json")
    assert code == 0
    assert 0.8 < json.loads(out)["fit"]["sigma0"] < 1.25


def test_the_rig_of_a_simulation_on_all_axes_states_sigmas(handlaser, tmp_path):
    assert handlaser("simulate", tmp_path, "--pose-axes", "xyz", "--quiet")[0] == 0
    noise = hl.read_rig(tmp_path / "rig.toml").noise
    assert noise.pose_covariance is None
    assert noise.pose_translation_sigma == pytest.approx(5e-5)


def test_simulated_arm_calibrates_with_its_rig(handlaser, tmp_path):
    options = ("--scene", "arm", "--planes", "3", "--stations", "15", "--beams", "2")
    assert handlaser("simulate", tmp_path, *options, "--quiet")[0] == 0
    rig, recording = tmp_path / "rig.toml", tmp_path / "recording.csv"
    code, out, _ = handlaser("calibrate", recording, "--rig", rig, "--json")
    assert code == 0
    record = json.loads(out)
    assert record["start"]["method"] in ("sweep", "directions")
    truth = json.loads((tmp_path / "truth.json").read_text())
    for beam, true in zip(record["beams"], truth["beams"], strict=True):
        assert beam["location_m"] == pytest.approx(true["location_m"], abs=5e-3)


def test_all_planes_are_listed_in_full(handlaser, tmp_path):
    recording, _ = simulated(layout=Layout(planes=14))
    write_recording(tmp_path / "recording.csv", recording)
    _, out, _ = handlaser("calibrate", tmp_path / "recording.csv", "--range-error", "none", "-v")
    planes = out[out.index("planes. ") :].splitlines()[2:16]
    assert [line.split()[0] for line in planes] == list(recording.plane_names)


@pytest.mark.slow
def test_a_reader_that_goes_away_is_no_bug():
    """Gone before the first line; what `head` leaves unread fits into the pipe."""
    command = [sys.executable, "-m", "handlaser_gtsam.cli", "check", RECORDING]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as run:
        run.stdout.close()
        assert run.stderr.read() == ""
    assert run.returncode == 0


@pytest.mark.slow
def test_ctrl_c_ends_with_130_and_no_traceback(tmp_path):
    recording, _ = simulated(layout=Layout(planes=300))
    write_recording(tmp_path / "recording.csv", recording)
    interrupt = (
        "import signal, sys, threading, os\n"
        "import handlaser_gtsam.estimation.joint_solution as solver\n"
        "tell = solver.tell_trial\n"
        "def interrupted(*rest):\n"
        "    tell(*rest)\n"
        "    os.kill(os.getpid(), signal.SIGINT)\n"
        "solver.tell_trial = interrupted\n"
        "from handlaser_gtsam.cli import main\n"
        f"sys.argv = ['handlaser', 'calibrate', {str(tmp_path / 'recording.csv')!r}, '-q',"
        f" '--out', {str(tmp_path / 'result.json')!r}]\n"
        "main()\n"
    )
    run = subprocess.run(
        [sys.executable, "-c", interrupt], capture_output=True, text=True, check=False
    )
    assert run.returncode == 130
    assert "Traceback" not in run.stderr
    assert "stopped by Ctrl-C" in run.stderr
    assert json.loads((tmp_path / "result.json").read_text())["status"] == "not_converged"


def test_version_and_help():
    from handlaser_gtsam.cli.verbs import app

    runner = CliRunner()
    assert runner.invoke(app, ["--version"]).stdout.strip() == f"handlaser {__version__}"
    for arguments in (["--help"], ["calibrate", "--help"], ["simulate", "--help"]):
        assert runner.invoke(app, arguments).exit_code == 0


def test_help_loads_nothing_heavy():
    code = (
        "import sys; sys.argv = ['handlaser', '--help']\n"
        "from handlaser_gtsam.cli import main\n"
        "try: main()\n"
        "except SystemExit: pass\n"
        "heavy = {'gtsam', 'numpy', 'scipy', 'polars', 'pydantic', 'jinja2', 'plotly'}\n"
        "heavy &= set(sys.modules)\n"
        "assert not heavy, heavy\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True, capture_output=True)


@pytest.mark.slow
def test_calibrating_beams_imports_nothing_for_plans_logs_and_surveys(tmp_path):
    """Whoever follows the command with a debugger is not led through rooms that it does not use."""
    program = (
        "import sys\n"
        "from handlaser_gtsam.cli import main\n"
        "try: main()\n"
        "except SystemExit as end: assert not end.code\n"
        "print(*(name for name in sys.modules if name.startswith('handlaser_gtsam.')))\n"
    )
    arguments = ["calibrate", str(GRIPPER / "recording.csv"), "--rig", str(GRIPPER / "rig.toml")]
    arguments += ["--out", str(tmp_path / "out.json"), "--quiet"]
    ended = subprocess.run(
        [sys.executable, "-c", program, *arguments], capture_output=True, text=True, check=True
    )
    imported = {name.partition(".")[2] for name in ended.stdout.split()}
    assert "estimation.joint_solution" in imported
    unused = ("planning.", "validation.", "session.")
    unused += ("files.logs.reading", "files.points_table", "estimation.survey")
    assert not [name for name in imported if name.startswith(unused)]


def test_the_recording_is_never_overwritten_by_its_result(refusal, tmp_path):
    path = tmp_path / "recording.csv"
    write_recording(path, simulated()[0])
    before = path.read_bytes()
    refusal("calibrate", path, "-q", "--out", path)
    assert path.read_bytes() == before


@pytest.mark.parametrize("sigma", ["1e-200", "1e200", "0", "nan"])
def test_impossible_sigmas_are_refused(refusal, sigma):
    refusal("calibrate", GRIPPER / "recording.csv", "--range-sigma-mm", sigma)


@pytest.mark.parametrize("value", ["1" * 5000, "[" * 3000])
def test_endless_toml_is_refused(refusal, tmp_path, value):
    rig = tmp_path / "rig.toml"
    rig.write_text(f"[noise]\nrange_sigma_mm = {value}\n")
    refusal("calibrate", GRIPPER / "recording.csv", "--rig", rig)


@pytest.mark.parametrize(
    ("option", "value"), [("--k2-per-m", "inf"), ("--k1", "nan"), ("--k1", "1e300")]
)
def test_simulate_refuses_impossible_range_errors_and_writes_nothing(
    refusal, tmp_path, option, value
):
    refusal("simulate", tmp_path / "new", option, value)
    assert not (tmp_path / "new").exists()


@pytest.mark.slow
def test_a_full_output_is_no_bug():
    command = [sys.executable, "-m", "handlaser_gtsam.cli", "check", "--json"]
    with Path("/dev/full").open("w") as full:
        run = subprocess.run(
            [*command, str(GRIPPER / "recording.csv")],
            stdout=full,
            stderr=subprocess.PIPE,
            check=False,
        )
    assert run.returncode == 2
    assert b"no way to write" in run.stderr


def test_robust_losses_and_kept_outliers_are_options(handlaser):
    code, out, _ = handlaser(
        "calibrate", GRIPPER / "recording.csv", "--loss", "huber", "--outliers", "keep", "--json"
    )
    assert code == 0
    assert json.loads(out)["fit"]["rejected"] == []


def test_a_cross_check_that_disagrees_is_no_calibration(handlaser, monkeypatch):
    from handlaser_gtsam.validation import cross_check as checking

    monkeypatch.setattr(
        checking,
        "cross_check",
        lambda *_: checking.CrossCheck(2.5, "beam 1 location", 0.1, "beam 1 location", 3),
    )
    code, _, err = handlaser("calibrate", GRIPPER / "recording.csv", "--cross-check", "--quiet")
    assert code == 3
    assert "SciPy finds another solution, by 2.5 standard deviations" in err


def test_linear_algebra_has_one_thread_unless_somebody_says_so(monkeypatch):
    """Of small matrices further threads take twice the processor time and save nothing."""
    monkeypatch.delenv("OPENBLAS_NUM_THREADS")
    monkeypatch.setenv("OMP_NUM_THREADS", "3")
    monkeypatch.setattr(sys, "argv", ["handlaser", "--version"])
    with pytest.raises(SystemExit):
        main()
    assert os.environ["OPENBLAS_NUM_THREADS"] == "1"
    assert os.environ["OMP_NUM_THREADS"] == "3"
