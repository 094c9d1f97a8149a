"""handlaser plan: from nothing, from a recording, from a result; what is refused."""

import json
import re

import numpy as np
import pytest
from helpers import GRIPPER, ROOT
from profiler_example import calibrated_example

import handlaser_gtsam as hl
from handlaser_gtsam.validation.simulate import Errors, Stations, simulate

RIG = ROOT / "examples" / "planned" / "rig.toml"
RECORDING = GRIPPER / "recording.csv"
GRIPPER_RIG = (GRIPPER / "rig.toml").read_text()
BOX = "[workspace]\nbox_mm = [[500, 0, 250], [700, 200, 500]]\nlargest_turn_deg = 25\n"


@pytest.fixture
def rig(tmp_path):
    path = tmp_path / "rig.toml"
    path.write_text(GRIPPER_RIG + BOX)
    return path


def test_a_first_motion(handlaser, tmp_path):
    out = tmp_path / "stations.csv"
    code, text, err = handlaser("plan", "--rig", RIG, "--out", out)
    assert (code, err) == (0, "")
    assert "first motion" in text
    assert f"wrote {out}" in text
    stations = hl.read_stations(out)
    assert len(stations) >= 11
    # Four translations at one orientation first, then turns; long steps between them are divided.
    read = [j for j, name in enumerate(stations.station_names) if not name.startswith("via")]
    assert len(read) < len(stations)
    first = stations.world_R_hand[read[:4]]
    assert np.allclose(first, first[0])
    steps = stations.world_t_hand[read[1:4]] - stations.world_t_hand[read[0]]
    assert np.linalg.matrix_rank(steps, tol=1e-4) == 3
    way = np.linalg.norm(np.diff(stations.world_t_hand, axis=0), axis=1)
    assert way.max() < 0.06 + 1e-9  # largest_step_mm


def test_a_first_motion_says_which_sensors_it_is_not_for(handlaser, tmp_path):
    """Sensors of many rays have no bounds, and single beams of [[sensors]] are those of [blind]."""
    rig, beam = tmp_path / "rig.toml", '\n[[sensors]]\nname = "1"\nkind = "beam"\n'
    profiler = '\n[[sensors]]\nname = "line"\nkind = "profiler"\npoints = "line.csv"\n'
    out = tmp_path / "stations.csv"
    for more, warned in ((beam, False), (profiler, True)):
        rig.write_text(RIG.read_text() + more)
        code, text, err = handlaser("plan", "--rig", rig, "--out", out)
        assert code == 0
        assert "first motion" in text
        assert ("says nothing of line in [[sensors]]" in " ".join(err.split())) == warned


def test_from_a_recording(handlaser, tmp_path, rig):
    out = tmp_path / "stations.csv"
    picture = tmp_path / "forecast.svg"
    words = ("plan", RECORDING, "--rig", rig, "--stations", 6, "--out", out, "--picture", picture)
    code, text, err = handlaser(*words)
    assert picture.read_text().count('class="curve"') == 3
    assert (code, err) == (0, "")
    assert "stations  location mm  direction deg  spot mm" in " ".join(text.split("\n"))
    stations = hl.read_stations(out)
    recording = hl.read_recording(RECORDING)
    assert len(stations) == 6
    assert set(stations.plane_labels) <= set(recording.plane_names)
    assert not set(stations.station_names) & set(recording.station_names)


def test_json_alone_on_stdout(handlaser, tmp_path, rig):
    out = tmp_path / "stations.csv"
    code, text, err = handlaser(
        "plan", RECORDING, "--rig", rig, "--stations", 4, "--out", out, "--json"
    )
    assert (code, err) == (0, "")
    found = json.loads(text)
    assert (found["format"], found["version"]) == ("handlaser-plan", 1)
    assert len(found["stations"]) == 4
    assert len(found["forecast"]) == 5
    assert found["reached"] is None
    assert (found["undetermined"], found["determined"], found["skipped"]) == ([], True, 0)
    sigmas = [one["direction_sigma_rad"] for one in found["forecast"]]
    assert sigmas == sorted(sigmas, reverse=True)
    assert set(found["stations"][0]) == {
        *("station", "plane", "position_m", "quaternion_xyzw", "ranges_m", "range_sigmas_m")
    }


@pytest.mark.slow
def test_a_plan_that_is_not_written_shows_its_stations(handlaser, rig):
    """A few with their poses; of more the command says how to get them."""
    plan = ("plan", RECORDING, "--rig", rig, "--stations")
    _, text, _ = handlaser(*plan, 3)
    shown = text.split("stations, hand poses world_T_hand (--out FILE writes them):\n")[1]
    pose = re.compile(r"  \d+ before plane [A-D]: \(.*\) mm, qx qy qz qw \(.*\)")
    assert len(shown.splitlines()) == 3
    assert all(map(pose.fullmatch, shown.splitlines()))
    _, text, _ = handlaser(*plan, 11)
    assert "qx qy qz qw" not in text
    assert text.splitlines()[-1] == "--out FILE writes the poses of the 11 stations"


@pytest.mark.slow
def test_from_a_result_and_with_the_plate_put_anew(handlaser, tmp_path, rig):
    result, out = tmp_path / "result.json", tmp_path / "stations.csv"
    assert handlaser("calibrate", RECORDING, "--rig", rig, "-q", "--out", result)[0] == 0
    plan = ("plan", "--rig", rig, "--calibration", result, "--stations", 8, "--out", out)
    code, text, _ = handlaser(*plan)
    assert code == 0
    assert "put the plate" not in text
    assert set(hl.read_stations(out).plane_labels) <= {"A", "B", "C", "D"}
    code, text, _ = handlaser(*plan, "--planes", 2)
    assert code == 0
    assert set(hl.read_stations(out).plane_labels) <= {"E", "F"}
    assert "put the plate" in text


def test_it_stops_at_the_limits(handlaser, tmp_path):
    limited = tmp_path / "limited.toml"
    limited.write_text(f"{GRIPPER_RIG}{BOX}[limits]\ndirection_sigma_deg = 0.3\n")
    code, text, _ = handlaser(
        *("plan", RECORDING, "--rig", limited, "--out", tmp_path / "stations.csv")
    )
    assert code == 0
    assert "reach the limits" in text


def test_limits_that_only_hidden_errors_exceed_are_said(handlaser, tmp_path):
    """The gripper's sensors with a kind, whose incidence error may hide; by random errors they hold."""
    kind = GRIPPER_RIG.replace("[sensor]", '[sensor]\nkind = "triangulation"')
    limits = "[limits]\nlocation_sigma_mm = {}\n"
    said = []
    for most in (0.5, 50.0):
        limited = tmp_path / f"limited_{most}.toml"
        limited.write_text(kind + BOX + limits.format(most))
        words = ("plan", RECORDING, "--rig", limited, "--stations", 4)
        code, _, err = handlaser(*words, "--out", tmp_path / f"stations_{most}.csv")
        assert code == 0
        said.append("random errors alone" in err)
    assert said == [True, False]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((), "[blind]"),
        ((RECORDING, "--calibration", RECORDING), "one of the two"),
        ((RECORDING, "--stations", 0), "--stations"),
    ],
)
def test_refusals(refusal, tmp_path, rig, arguments, words):
    assert words in refusal("plan", *arguments, "--rig", rig, "--out", tmp_path / "s.csv")
    assert not (tmp_path / "s.csv").exists()


def test_no_range_of_the_sensor(refusal, tmp_path):
    out = tmp_path / "s.csv"
    assert "range_mm" in refusal("plan", RECORDING, "--out", out)


def test_the_result_of_a_survey_is_refused_before_anything_is_asked_for(refusal, tmp_path):
    result, rig = tmp_path / "result.json", tmp_path / "rig.toml"
    hl.write_calibration(result, calibrated_example())
    rig.write_text(BOX)
    found = refusal("plan", "--rig", rig, "--calibration", result)
    assert "found the result of a survey with --calibration; expected RECORDING" in found
    assert "range_mm" not in found


def test_an_input_is_not_replaced(refusal, rig):
    assert "the input itself" in refusal("plan", RECORDING, "--rig", rig, "--out", rig)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[workspace]\nbox_mm = [[0, 0, 0]]\n", "workspace.box_mm"),
        ("[workspace]\nbox_mm = [[0, 0, 0], [1, 1, -1]]\n", "low at most high"),
        (f"{BOX}home_quaternion = [0, 0, 0, 2]\n", "home_quaternion"),
        (f"{BOX}largest_turn_deg = 1\n", "TOML"),
        ("[goal]\ncriterion = 'B'\n", "goal.criterion"),
        ("[goal]\nspot_mm = -1\n", "spot"),
        ("[placement]\ntilt = 1\n", "largest_tilt_deg"),
        (
            "[blind]\nlocation_mm = [[0, 0, 0]]\ndirection = [[0, 0, 0]]\n"
            "plate_point_mm = [0, 0, 1]\nplate_normal = [0, 0, 1]\n",
            "without a length",
        ),
    ],
)
def test_faults_of_the_tables(tmp_path, text, words):
    path = tmp_path / "rig.toml"
    path.write_text(text)
    with pytest.raises(hl.InputError, match=r"rig\.toml") as caught:
        hl.read_rig(path)
    assert words in str(caught.value)


@pytest.mark.slow
def test_check_and_calibrate_end_with_the_next_best_stations(handlaser, rig):
    for verb in ("check", "calibrate"):
        code, text, err = handlaser(verb, RECORDING, "--rig", rig)
        assert (code, err) == (0, "")
        assert "next best stations" in text
        assert text.count("before plane") == 3
        assert len(text.splitlines()) <= 30
    assert "next best" not in handlaser("calibrate", RECORDING)[1]  # no range of the sensor
    assert "next best" not in handlaser("calibrate", RECORDING, "--rig", rig, "-q")[1]


@pytest.mark.slow
def test_check_and_calibrate_say_what_an_open_motion_lacks(handlaser, tmp_path):
    rng = np.random.default_rng(0)
    known = hl.read_rig(RIG)
    motion = hl.planning.blind_motion(
        known.bounds, known.sensor, known.workspace, known.noise
    ).stations
    some = [j for j, name in enumerate(motion.station_names) if not name.startswith("via")][:5]
    truth = known.bounds.draw(rng)
    poses = Stations(
        motion.world_R_hand[some], motion.world_t_hand[some], np.zeros(5, dtype=np.intp)
    )
    path, other = tmp_path / "begun.csv", tmp_path / "other.toml"
    hl.write_recording(path, simulate(truth, poses, Errors(3e-5), rng, known.sensor))
    other.write_text(GRIPPER_RIG + BOX)
    for verb in ("check", "calibrate"):
        code, text, err = handlaser(verb, path, "--rig", RIG)
        assert code == 3
        assert "next best stations" in text
        assert 3 <= text.count("before plane A: (") <= 12
        assert "to determine it" in err.lower()
    code, text, _ = handlaser("check", path, "--rig", other)
    assert (code, "next best" in text) == (3, False)  # no bounds
