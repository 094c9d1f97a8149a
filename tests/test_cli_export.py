"""handlaser export: what goes to the screen and into files, and what is refused."""

import json
import subprocess
import sys

import pytest
from exported import calibrated
from helpers import GRIPPER

import handlaser_gtsam as hl
from handlaser_gtsam.cli.export import FormatChoice
from handlaser_gtsam.files.exports.formats import BEAMS, FORMATS, TAKEN

RECORDING, RIG = GRIPPER / "recording.csv", GRIPPER / "rig.toml"
NEEDED = {name: ["--link", "tool0"] for name in TAKEN["link"]} | {"fanuc": ["--tool", "3"]}
WARNED = "WARNING: a reading is far\n"


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "calibration.json"
    path.write_text(calibrated().model_dump_json())
    return path


def refused(result, *words):
    code, out, err = result
    assert (code, out) == (2, "")
    assert err.count("\n") == 1
    assert all(word in err for word in words), err


def test_the_command_has_the_formats_that_there_are():
    assert tuple(one.value for one in FormatChoice) == FORMATS


@pytest.mark.parametrize("to", BEAMS)
def test_every_format_is_written(handlaser, file, tmp_path, to):
    out = tmp_path / "out"
    arguments = ("export", file, "--to", to, *NEEDED.get(to, ()))
    code, printed, err = handlaser(*arguments, "--out", out)
    assert (code, printed, err) == (0, f"wrote {out}\n", WARNED)
    assert len(out.read_bytes()) > 100
    assert handlaser(*arguments, "--out", out, "--quiet")[:2] == (0, "")
    code, printed, err = handlaser(*arguments)
    assert (code, printed.encode(), err) == (0, out.read_bytes(), WARNED)


def test_systematic_errors_that_were_found_are_repeated(handlaser, tmp_path):
    one = {
        "code": "sag",
        "subject": "",
        "unit": "m",
        "size": 1e-4,
        "sigma": 1e-5,
        "p_value": 1e-4,
        "found": True,
        "explained_by": None,
        "confounded": False,
        "detectable": 1e-4,
        "alike": [],
        "location_shift_m": [],
        "direction_shift_rad": [],
        "location_error_m": [],
        "direction_error_rad": [],
        "message": "a sag of 0.1 mm",
        "remedy": "use a flatter plate",
    }
    record = json.loads(calibrated().model_dump_json())
    record["systematic"] = [one, one | {"found": False}, one | {"explained_by": "lag"}]
    path = tmp_path / "calibration.json"
    path.write_text(json.dumps(record))
    code, _, err = handlaser("export", path, "--to", "kuka")
    assert code == 0
    assert err == f"{WARNED}WARNING: systematic error sag: a sag of 0.1 mm; use a flatter plate\n"


@pytest.mark.parametrize("to", BEAMS)
def test_a_result_that_is_not_usable_says_so(handlaser, tmp_path, to):
    """On the screen, and in a comment: who reads the file later has not seen that."""
    record = json.loads(calibrated().model_dump_json())
    words = "Not usable, outside the limits: rms 0.3 mm above 0.2 mm."
    record["verdict"] = {"usable": False, "sentence": words}
    path = tmp_path / "calibration.json"
    path.write_text(json.dumps(record))
    words_of_format = NEEDED.get(to, [])
    code, out, err = handlaser("export", path, "--to", to, *words_of_format)
    assert (code, err) == (0, f"WARNING: {words}\n{WARNED}")
    assert "NOT USABLE" in out
    path.write_text(calibrated().model_dump_json())
    assert "NOT USABLE" not in handlaser("export", path, "--to", to, *words_of_format)[1]


def test_what_the_verdict_says_is_not_said_again(handlaser, tmp_path):
    record = json.loads(calibrated().model_dump_json())
    record["verdict"] = {"usable": False, "sentence": "Not usable, contradicted: a reading is far."}
    path = tmp_path / "calibration.json"
    path.write_text(json.dumps(record))
    err = handlaser("export", path, "--to", "kuka")[2]
    assert err == "WARNING: Not usable, contradicted: a reading is far.\n"


def test_calibrations_and_stations_are_told_apart(handlaser, file):
    to_program = handlaser("export", file, "--to", "krl")
    refused(to_program, "a calibration, and krl takes stations", "--to urdf | ")
    refused(
        handlaser("export", RECORDING, "--to", "kuka"), "kuka takes a calibration", "--to krl | "
    )
    refused(handlaser("export", file.parent / "none.csv", "--to", "krl"), "no readable file")


def test_options_reach_the_frame(handlaser, file):
    beam = calibrated().beams[1]
    given = ("--beam", "2", "--axis", "x", "--at-reading-mm", "15")
    code, printed, _ = handlaser("export", file, "--to", "ur", *given)
    assert code == 0
    assert printed.count("p[") == 1
    pose = json.loads("[" + printed.split("p[")[1].strip())
    along = 0.015 * (1.0 + beam.range_error.k1 + beam.range_error.k2_per_m * 0.015)
    wanted = [r + along * v for r, v in zip(beam.location_m, beam.direction, strict=True)]
    assert pose[:3] == pytest.approx(wanted, abs=1e-12)
    assert "x of each frame lies along its beam; its origin is where it reads 15.0 mm" in printed


@pytest.mark.parametrize("to", BEAMS)
@pytest.mark.parametrize(
    ("option", "value"),
    [("link", "tool0"), ("axis", "x"), ("at-reading-mm", "5"), ("tool", "1"), ("into", str(RIG))],
)
def test_an_option_that_means_nothing_is_refused(handlaser, file, tmp_path, to, option, value):
    field, words = (option.removesuffix("-mm").replace("-", space) for space in "_ ")
    if to in TAKEN[field]:
        return
    arguments = ("export", file, "--to", to, "--out", tmp_path / "out")
    given = [*NEEDED.get(to, ()), f"--{option}", value]
    refused(handlaser(*arguments, *given), f"{words} with the format {to}", TAKEN[field][0])
    assert not (tmp_path / "out").exists()


def test_what_a_format_needs_is_asked_for(handlaser, file):
    for to in NEEDED:
        refused(handlaser("export", file, "--to", to), "tool0" if to != "fanuc" else "UTOOL")


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--to", "kuka", "--beam", "9"), "one of 1, 2, 3"),
        (("--to", "kuka", "--beam", "1", "--beam", "1"), "beam '1' twice"),
        (("--to", "kuka", "--at-reading-mm", "nan"), "at-reading"),
        (("--to", "fanuc", "--tool", "0"), "1 to 99"),
        (("--to", "fanuc", "--tool", "98"), "99"),
        (("--to", "urdf", "--link", "a\nb"), "printable"),
        (("--to", "urdf", "--link", "a", "--into", "no.urdf"), "--into without --out"),
        (("--to", "urdf", "--link", "a", "--into", "no.urdf", "--out", "x"), "no readable file"),
    ],
)
def test_bad_options_are_refused_in_one_line(
    handlaser, file, options, words, monkeypatch, tmp_path
):
    monkeypatch.chdir(tmp_path)
    refused(handlaser("export", file, *options), words)


def test_inputs_are_never_replaced(handlaser, file, tmp_path):
    robot = tmp_path / "robot.urdf"
    robot.write_text('<robot name="r"><link name="tool0"/></robot>')
    before = file.read_bytes(), robot.read_bytes()
    given = ("export", file, "--to", "urdf", "--link", "tool0", "--into", robot)
    refused(handlaser(*given, "--out", robot), "the input itself")
    refused(handlaser(*given, "--out", file), "the input itself")
    assert (file.read_bytes(), robot.read_bytes()) == before
    code, out, _ = handlaser(*given, "--out", tmp_path / "new.urdf")
    assert (code, out) == (0, f"wrote {tmp_path / 'new.urdf'}\n")


@pytest.mark.parametrize("status", ["unobservable", "not_converged"])
def test_what_is_no_calibration_is_not_exported(handlaser, tmp_path, status):
    path, out = tmp_path / "calibration.json", tmp_path / "out"
    path.write_text(calibrated(status=status).model_dump_json())
    for to in ("kuka", "python"):
        code, printed, err = handlaser("export", path, "--to", to, "--out", out)
        assert (code, printed) == (3, "")
        assert err.count("\n") == 1
        assert status in err
        assert "2 steps" in err
        assert not out.exists()
    with pytest.raises(hl.NotConvergedError) as caught:
        hl.export_text(calibrated(status=status), "kuka")
    assert caught.value.status == status


def test_python_refuses_what_is_no_calibration():
    for ask, words in (
        (lambda: hl.export_text(3, "kuka"), "handlaser_gtsam.Calibration"),
        (lambda: hl.export_text(calibrated(), "karel"), "one of 'urdf'"),
        (lambda: hl.export_text(calibrated(), "kuka", "z"), "handlaser_gtsam.ExportOptions"),
        (lambda: hl.write_export("no/such/folder/x", calibrated(), "c"), "no/such/folder/x"),
        (lambda: hl.ExportOptions(axis="w"), "'x', 'y', 'z'"),
        (lambda: hl.ExportOptions("12"), "a sequence of texts"),
        (lambda: hl.ExportOptions(into=3), "the name of a file"),
        (lambda: hl.ExportOptions(link=3), "no text"),
    ):
        with pytest.raises(hl.InputError) as caught:
            ask()
        assert words in str(caught.value)
        assert "\n" not in str(caught.value)


@pytest.mark.slow
@pytest.mark.parametrize("to", ["python", "kuka"])
def test_the_screen_of_any_encoding_shows_it(tmp_path, to):
    names = ("β1", "壁", "3")
    (tmp_path / "foreign.json").write_text(calibrated(names=names).model_dump_json())
    code = "from handlaser_gtsam.cli import main; main()"
    run = subprocess.run(
        [sys.executable, "-c", code, "export", tmp_path / "foreign.json", "--to", to],
        capture_output=True,
        env={"PYTHONIOENCODING": "ascii", "LC_ALL": "C"},
        check=False,
    )
    assert (run.returncode, run.stderr.decode("ascii")) == (0, WARNED)
    assert run.stdout.decode("ascii") == hl.export_text(calibrated(names=names), to)
