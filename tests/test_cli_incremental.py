"""handlaser calibrate --incremental."""

import json
import re

import numpy as np
import pytest
from helpers import GRIPPER
from test_drift import displaced

import handlaser_gtsam as hl

RECORDING, RIG = GRIPPER / "recording.csv", GRIPPER / "rig.toml"


@pytest.mark.slow
def test_plane_by_plane_is_all_at_once(handlaser, tmp_path):
    paths = [tmp_path / name for name in ("one.json", "all.json")]
    code, out, err = handlaser(
        "calibrate", RECORDING, "--rig", RIG, "--incremental", "--out", paths[0]
    )
    assert code == 0, err
    assert handlaser("calibrate", RECORDING, "--rig", RIG, "-q", "--out", paths[1])[0] == 0
    assert "plane by plane and all at once agree to" in out
    rows = [line.split() for line in out.split("plane by plane")[1].splitlines()]
    sigmas = [float(row[2]) for row in rows if row and row[0] in ("B", "C", "D")]
    assert sigmas == sorted(sigmas, reverse=True)
    assert len(sigmas) == 3
    one, both = (json.loads(path.read_text()) for path in paths)
    assert one["status"] == both["status"] == "converged"
    for a, b in zip(one["beams"], both["beams"], strict=True):
        assert a["name"] == b["name"]
        difference = np.abs(np.subtract(a["location_m"], b["location_m"]))
        assert (difference < 0.01 * np.array(b["sigma"]["location_m"])).all()
        assert a["sigma"]["location_m"] == pytest.approx(b["sigma"]["location_m"], rel=0.01)
    assert one["fit"]["chi2"] == pytest.approx(both["fit"]["chi2"], rel=1e-6)


def test_json_alone_is_printed(handlaser):
    code, out, _ = handlaser("calibrate", RECORDING, "--rig", RIG, "--incremental", "--json")
    assert code == 0
    assert json.loads(out)["status"] == "converged"


@pytest.mark.slow
def test_a_beam_that_has_moved_is_named(handlaser, tmp_path):
    recording, _ = displaced()
    path = tmp_path / "displaced.csv"
    hl.write_recording(path, recording)
    _, out, err = handlaser("calibrate", path, "--incremental", "--range-sigma-mm", "0.1")
    text = " ".join((out + err).split())
    assert "beam 2 has moved before plane G" in text
    assert "split the beam in a Session" in text
    assert "systematic errors: (which" not in text
    assert "systematic errors: none but what the displacement explains (" in text


@pytest.mark.slow
def test_what_does_not_determine_the_beams_says_so_as_ever(handlaser, tmp_path):
    recording = hl.read_recording(RECORDING)
    path = tmp_path / "part.csv"
    hl.write_recording(path, recording.part(np.arange(5)))
    code, out, err = handlaser("calibrate", path, "--rig", RIG, "--incremental")
    assert code == 3
    assert "does not determine" in err
    assert "waits for more" in out


def test_what_cannot_be_done_plane_by_plane_is_refused(refusal):
    err = refusal("calibrate", RECORDING, "--incremental", "--loss", "huber")
    assert "loss huber" in err
    assert len(err.splitlines()) == 1


@pytest.mark.slow
def test_target_by_target_is_all_at_once(handlaser):
    """What the JSON says is the calibration of all stations; the table says what each target taught."""
    profiler = GRIPPER.parent / "profiler"
    given = ("calibrate", profiler / "poses.csv", "--rig", profiler / "rig.toml")
    code, out, err = handlaser(*given, "--incremental")
    assert (code, err) == (0, "")
    lines = out.split("target by target\n")[1].splitlines()[1:4]
    table = {name: cells for name, *cells in map(str.split, lines)}
    (nothing, before, _), (learnt, after, _) = table["plane:plate"], table["sphere:ball"]
    assert nothing == "-"
    assert float(learnt) > 1.0
    assert float(after) < 0.5 * float(before)
    assert table["result"][1:] == table["sphere:ball"][1:]
    (agree,) = re.findall(r"all at once agree to (\S+) standard deviations", out)
    assert float(agree) < 0.01
    assert handlaser(*given, "--incremental", "--json")[1] == handlaser(*given, "--json")[1]


@pytest.mark.slow
def test_a_reading_that_the_others_hardly_predict_comes_back(handlaser, tmp_path):
    """At once, a beam that few stations see is rejected before the noise is known, being far off."""
    rig = GRIPPER.parent / "profiler" / "rig.toml"
    where = ("--beams", 2, "--targets", "plane:A,sphere:b,point:tip", "--stations", 8)
    assert handlaser("simulate", tmp_path, "--rig", rig, *where)[0] == 0
    given = ("calibrate", tmp_path / "stations.csv", "--rig", tmp_path / "rig.toml")
    code, out, err = handlaser(*given, "--incremental")
    assert (code, err) == (0, "")
    assert "left out" not in out


@pytest.mark.slow
def test_a_target_without_readings_is_said_so(handlaser, tmp_path):
    for name in ("poses.csv", "rig.toml", "profiles.csv"):
        text = (GRIPPER.parent / "profiler" / name).read_text()
        if name == "poses.csv":
            rows = text.splitlines()
            text = "\n".join(
                [*rows, rows[-1].replace("sphere:ball", "sphere:other").replace("P24", "P99")]
            )
        (tmp_path / name).write_text(text)
    given = ("calibrate", tmp_path / "poses.csv", "--rig", tmp_path / "rig.toml")
    _, out, _ = handlaser(*given, "--incremental")
    lines = [line for line in out.splitlines() if "sphere:other" in line]
    assert any(line.endswith("no reading") for line in lines)


@pytest.mark.slow
def test_learned_range_errors_raise_no_false_alarm(handlaser, tmp_path):
    """A recording whose range errors are learned anew on the way; nothing in it moves."""
    where = ("--planes", 25, "--scene", "unplanned", "--seed", 5, "--pose-axes", "xyz")
    assert handlaser("simulate", tmp_path, *where)[0] == 0
    paths = (tmp_path / "recording.csv", "--rig", tmp_path / "rig.toml")
    code, out, err = handlaser("calibrate", *paths, "--incremental", "--json")
    assert code == 0, err
    assert "beam-moved" not in {one["code"] for one in json.loads(out)["warnings"]}
