"""What a survey holds and determines: words and ranks, before anything is calibrated.

What vehicles leave undetermined before walls is reasoned, not computed here: whatever has only planes
parallel to the axis of all turns before it is the same at all heights, and a hand that never turns may
be shifted with all that it looks at.
"""

import json
import re
import shutil
from dataclasses import replace

import numpy as np
import pytest
from profiler_example import FOLDER, calibrated_example, example
from scipy.spatial.transform import Rotation
from test_survey_arrays import rough

import handlaser_gtsam as hl
from benchmarks import rigs_by_rays
from benchmarks.rigs import survey_of
from handlaser_gtsam.estimation.survey import state_of
from handlaser_gtsam.estimation.survey_rows import rows_of
from handlaser_gtsam.estimation.survey_starts import start_of
from handlaser_gtsam.model.sensors.kinds import KINDS
from handlaser_gtsam.results.description.tables import NONE
from handlaser_gtsam.results.survey_check import check_lines, check_survey
from handlaser_gtsam.validation.survey_scenes import fan_of
from handlaser_gtsam.validation.survey_simulate import SurveyTruth, simulate_survey

WALLS = {
    "vertical": [(0, 0), (60, 0), (-50, 0)],
    "one leans": [(0, 0), (60, 0), (-50, 25)],
    "a sphere": [],
}
"""Azimuth and lean of walls [degrees]."""
AHEAD = {"scanner": np.eye(3)}
"""Rotation of a sensor that looks along the hand's x axis; of all others their z axis does."""
HEIGHT = "the height of every sensor (location along (0.00, 0.00, 1.00))"
COMMON = "one common height of all sensors and targets (location along (0.00, 0.00, 1.00))"
IMAGE = "its mirror image in the plane of the motion fits as well"
SHIFT = "a common shift of all sensors and targets (location in three directions)"


def mounted(name, kind, tilt, location):
    """A sensor that looks ahead, tilted by so many degrees, and its mount."""
    noise = {"sigma": 1e-4}
    if kind == "array":
        a = np.tan(np.radians(np.linspace(-20.0, 20.0, 6)))
        noise["zones"] = np.column_stack((np.tile(a, 6), np.repeat(a, 6), np.ones(36)))
    ahead = AHEAD.get(kind, np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]]))
    mount = np.eye(4)
    mount[:3, :3] = Rotation.from_euler("xy", [tilt, 0.4 * tilt], degrees=True).as_matrix() @ ahead
    mount[:3, 3] = location
    return fan_of(name, kind, 2.0, **noise), mount


def vehicle(kind, motion, walls, tilt=20.0, beside=(), seed=0):
    """The survey of a sensor, and of others beside it, on a hand that turns about z only."""
    rng = np.random.default_rng(seed)
    sensors = [mounted("eye", kind, tilt, (0.1, -0.05, 0.3))]
    sensors += [mounted(other, other, -15.0, (0.0, 0.1, 0.2)) for other in beside]
    targets = {"sphere:S": np.array([2.2, 0.05, 0.4, 0.5])}
    if WALLS[walls]:
        azimuth, lean = np.radians(WALLS[walls]).T
        c = np.cos(lean)
        n = np.column_stack((np.cos(azimuth) * c, np.sin(azimuth) * c, np.sin(lean)))
        targets = {f"plane:{'ABC'[i]}": np.append(n[i], -2.0) for i in range(len(n))}
    R, t, labels = [], [], []
    for i, label in enumerate(targets):
        yaw, reach = (np.radians(WALLS[walls][i][0]), 0.5) if WALLS[walls] else (0.0, 0.1)
        for _ in range(12):
            turn = 0.0 if motion == "never turning" else yaw + rng.uniform(-reach, reach)
            R.append(Rotation.from_euler("z", turn).as_matrix())
            up = 0.0 if motion == "planar" else rng.uniform(-0.2, 0.2)
            t.append([*rng.uniform(-reach, reach, 2), up])
            labels.append(label)
    stations = hl.StationList(np.array(R), np.array(t), tuple(labels))
    fans, mounts = [fan for fan, _ in sensors], {fan.name: mount for fan, mount in sensors}
    truth = SurveyTruth(mounts, {}, targets)
    return simulate_survey(truth, stations, fans, hl.simulate.Errors(1e-4), rng)


def test_a_station_before_a_target_without_truth_is_named():
    stations = hl.StationList(np.eye(3)[None], np.zeros((1, 3)), ("sphere:ball",))
    truth = SurveyTruth({}, {}, {"plane:A": np.array([0.0, 0.0, 1.0, 0.5])})
    with pytest.raises(hl.InputError, match=r"sphere:ball.*plane:A"):
        simulate_survey(truth, stations, [], hl.simulate.Errors(), np.random.default_rng(1))


VEHICLES = [
    ("profiler", "planar", "vertical", HEIGHT),
    ("profiler", "planar", "a sphere", COMMON),
    ("scanner", "SCARA", "vertical", HEIGHT),
    ("scanner", "SCARA", "one leans", COMMON),
    ("points", "never turning", "vertical", SHIFT),
    ("array", "planar", "one leans", COMMON),
]


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "motion", "walls", "words"), [*VEHICLES])
def test_vehicles_with_sensors_of_many_rays(kind, motion, walls, words):
    check = check_survey(vehicle(kind, motion, walls))
    # Moves along the axis tell a leaning wall from its image.
    flat = kind in ("profiler", "scanner") and (motion, walls) != ("SCARA", "one leans")
    assert len(check.undetermined) == 1 + flat
    assert check.undetermined[0].startswith(words)
    assert check.exactly
    cures = {HEIGHT: "add a board that leans", COMMON: "measure the height of one sensor"}
    cure = cures.get(words, "turn the hand about two different axes")
    assert check.advice[flat].startswith(cure)
    assert check.sensors[0].location_sigma == np.inf
    if flat:
        assert check.undetermined[1] == f"which way up flat sensor eye is: {IMAGE}"
        assert check.advice[0].startswith(
            "against the mirror image, state the mount of flat sensor eye"
        )
        assert check.sensors[0].rotation_sigma == np.inf
    else:
        # Turns are determined: ten times better than what counts as undetermined, 0.1 rad.
        assert check.sensors[0].rotation_sigma < 0.01


@pytest.mark.slow
def test_of_two_heights_that_disagree_the_readings_do_not_say_which_is_false():
    """In planar motion the leaning wall was named alone, and all followed without it."""
    survey = vehicle("array", "planar", "one leans", beside=("points",))
    azimuth, lean = np.radians(WALLS["one leans"][2])
    leaning = np.array(
        [np.cos(azimuth) * np.cos(lean), np.sin(azimuth) * np.cos(lean), np.sin(lean)]
    )
    well = {"sigma": 1e-4, "sigma_angle": 0.01}
    plane = hl.Known("plane", ("plane:C",), value=-1.997, direction=leaning, **well)  # 3 mm off
    eye, points = (
        hl.Known("mount", (f"sensor:{one[0]}",), pose=mounted(*one)[1], **well)
        for one in (
            ("eye", "array", 20.0, (0.1, -0.05, 0.3)),
            ("points", "points", -15.0, (0.0, 0.1, 0.2)),
        )
    )
    noise = hl.Noise(pose_translation_sigma=2e-5, pose_rotation_sigma=1e-5)
    for others in ((eye,), (eye, points)):
        found = hl.calibrate(replace(survey, known=(plane, *others)), noise)
        (warning,) = found.warnings
        assert (found.verdict.code, warning.code) == ("contradicted", "relation-contradicted")
        either = len(others) == 1
        assert ("plane of plane:C or mount of sensor:eye" in warning.message) == either
        assert [one.contradicted for one in found.relations] == [True] + [either] * len(others)
        assert found.relations[0].rivals == ((eye,) if either else ())
        assert found.without.status == ("undetermined" if either else "converged")


@pytest.mark.slow
@pytest.mark.parametrize("seed", [6, 15])
def test_flat_sensors_take_the_mirror_image_that_the_others_have(seed):
    """Each finds one of two images of itself and of the board, and an array finds the true one only.

    Started from one's image and another's true mount, a search ended in nonsense with small sigmas.
    """
    survey = vehicle("profiler", "planar", "one leans", beside=("scanner", "array"), seed=seed)
    found = hl.calibrate(survey)
    assert found.status == "undetermined"  # one common height
    assert 0.7 * found.dof < found.chi2 < 1.3 * found.dof
    assert not found.rejected
    # A guess about the arm may decide standard deviations where sensors are as precise.
    assert {one.code for one in found.warnings} <= {"errors-by-pose"}
    for name, kind, tilt in (
        ("eye", "profiler", 20.0),
        ("scanner", "scanner", -15.0),
        ("array", "array", -15.0),
    ):
        true = mounted(name, kind, tilt, (0.0, 0.0, 0.0))[1][:3, :3]
        turned = Rotation.from_matrix(true.T @ found.sensors[name].rotation).magnitude()
        assert turned < 5.0 * found.sensors[name].rotation_sigma.max()


@pytest.mark.slow
def test_one_of_two_shots_before_a_target_does_not_make_a_survey_no_fit():
    """At the start both misfit, because the one at the wrong pose pulls the wall."""
    survey = vehicle("profiler", "planar", "one leans")
    t = survey.stations.world_t_hand.copy()
    t[13] += [0.1, 0.05, 0.0]
    kept = np.isin(np.arange(36), [*range(14), *range(24, 36)])
    found = hl.calibrate(
        replace(survey, stations=replace(survey.stations, world_t_hand=t)).part(kept)
    )
    assert found.status == "undetermined"  # one common height
    assert [one.target for one in found.rejected] == ["plane:B"]
    off = found.sensors["eye"].location[:2] - [0.1, -0.05]
    assert (np.abs(off) < 4.0 * found.sensors["eye"].location_sigma[:2]).all()


@pytest.mark.slow
@pytest.mark.parametrize("tilt", [20.0, 30.0])
def test_an_open_height_takes_no_sigma_from_the_other_coordinates(tilt):
    """A mount that is roughly known closes what is open, and says nothing of x and y."""
    survey = vehicle("profiler", "planar", "vertical", tilt)
    noise = hl.Noise(pose_translation_sigma=1e-4, pose_rotation_sigma=1e-4)
    left_open = hl.calibrate(survey, noise)
    mount = left_open.sensors["eye"]
    assert left_open.status == "undetermined"
    assert np.isfinite(mount.location_sigma).tolist() == [True, True, False]
    rough = hl.Known("mount", ("sensor:eye",), sigma=0.1, sigma_angle=0.1, pose=mount.matrix())
    closed = hl.calibrate(hl.Survey(survey.stations, survey.shots, known=(rough,)), noise)
    assert closed.status == "converged"
    # The weight of a decimetre beside a millimetre is 1e-4 of that of the readings.
    beside = closed.sensors["eye"].location_sigma
    assert mount.location_sigma[:2] == pytest.approx(beside[:2], rel=1e-3)
    assert beside[2] > 0.05
    (table,) = left_open.described(left_open.verdict).main_tables
    row = dict(zip([column.title for column in table.columns], table.rows[0], strict=True))
    assert row["z [mm]"].text == NONE
    assert row["x [mm]"].value == pytest.approx(1e3 * mount.location[0])
    assert row["sigma [mm]"].value == pytest.approx(1e3 * mount.location_sigma[:2].max())


@pytest.mark.slow
@pytest.mark.parametrize("seed", [2, 5])
def test_the_mirror_image_is_that_of_the_mount_that_is_stated(seed):
    """Whatever else is wrong, here the noise that is stated: the true mount was called contradicted."""
    survey = vehicle("scanner", "planar", "one leans", tilt=11.0, seed=seed)
    rng = np.random.default_rng(seed)
    (shots,) = survey.shots
    shots = replace(shots, reading=shots.reading + 5e-3 * rng.normal(size=shots.reading.shape))
    t = survey.stations.world_t_hand
    t = t + [2e-3, 2e-3, 0.0] * rng.normal(size=t.shape)
    true = mounted("eye", "scanner", 11.0, (0.1, -0.05, 0.3))[1]
    known = hl.Known("mount", ("sensor:eye",), sigma=5e-3, sigma_angle=np.radians(3.0), pose=true)
    found = hl.calibrate(
        hl.Survey(replace(survey.stations, world_t_hand=t), (shots,), known=(known,))
    )
    turn = Rotation.from_matrix(true[:3, :3].T @ found.sensors["eye"].rotation).magnitude()
    assert np.degrees(turn) < 1.0
    assert "relation-contradicted" not in [one.code for one in found.warnings]


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_a_start_is_the_mirror_image_that_is_stated(seed):
    """Both fit alike: which one a search without the statement finds is chance."""
    survey = vehicle("scanner", "planar", "one leans", tilt=11.0, seed=seed)
    true = mounted("eye", "scanner", 11.0, (0.1, -0.05, 0.3))[1]
    image = np.diag([1.0, 1.0, -1.0, 1.0]) @ true
    image[:3, KINDS["scanner"].across] *= -1.0
    for pose in (true, image):
        known = hl.Known("mount", ("sensor:eye",), sigma=0.1, sigma_angle=0.05, pose=pose)
        rows = rows_of(replace(survey, known=(known,)))
        values, _ = start_of(rows, state_of(rows, hl.Noise()).sigmas())
        R = values["sensor"][0, 0, :9].reshape(3, 3)
        assert Rotation.from_matrix(pose[:3, :3].T @ R).magnitude() < np.radians(2.0)


def test_a_true_mount_that_is_rough_beside_much_noise_is_not_contradicted():
    """The search ends in the mirror image, with sizes of the noise that hide it."""
    survey, rng = vehicle("scanner", "planar", "one leans", tilt=11.0), np.random.default_rng(0)
    (shots,), of = survey.shots, survey.stations
    reading = shots.reading + 5e-3 * rng.normal(size=shots.reading.shape)
    t = of.world_t_hand + [2e-3, 2e-3, 0.0] * rng.normal(size=of.world_t_hand.shape)
    yaw = np.radians(0.1) * rng.normal(size=(len(of), 1))
    R = of.world_R_hand @ Rotation.from_euler("z", yaw).as_matrix()
    true = mounted("eye", "scanner", 11.0, (0.1, -0.05, 0.3))[1]
    known = hl.Known("mount", ("sensor:eye",), sigma=5e-3, sigma_angle=np.radians(6.0), pose=true)
    stations = replace(of, world_R_hand=R, world_t_hand=t)
    noisy = replace(shots, sigma=None, reading=reading)
    found = hl.calibrate(hl.Survey(stations, (noisy,), known=(known,)))
    assert found.status == "undetermined"
    asked = re.search(r"sigma_deg below ([0-9.]+)", found.message)
    turn = np.degrees(found._found.images["sensor", 0])
    # All that is nearer to the image than to the true mount has to be four sigmas away.
    assert float(asked[1]) == pytest.approx(turn / 8.0, rel=0.02)


def test_flat_sensors_before_one_ball_find_it_at_one_height():
    """In a planar motion each has two mirror images, and finds the ball at a height of its own."""
    found = hl.calibrate(vehicle("profiler", "planar", "a sphere", beside=("scanner",), seed=5))
    assert found.status == "undetermined"
    assert not found.rejected
    assert found.chi2 < 1.5 * found.dof
    assert found.targets["sphere:S"].values["radius"] == pytest.approx(0.5, abs=0.01)


@pytest.mark.slow
@pytest.mark.parametrize("walls", ["vertical", "one leans"])
def test_a_level_scanner_on_a_flat_floor_sees_no_wall_lean(walls):
    """Walls that lean look the same to rays in the plane of the motion: no board that leans helps."""
    survey = vehicle("scanner", "planar", walls, tilt=0.0)
    check, found = check_survey(survey), hl.calibrate(survey)
    assert not check.exactly  # its own lean shows in second order
    (words,), (cure,) = check.undetermined, check.advice
    assert words.startswith(
        "the height of scanner eye (location along (0.00, 0.00, 1.00)), and how it"
    )
    assert cure.startswith("mount it so that the rays lean by 10 to 20 degrees out of that plane")
    assert found.status == "undetermined"
    assert found.message == f"the motion leaves open {words}. To determine it: {cure}"


@pytest.mark.slow
def test_a_level_scanner_is_determined_by_its_drawing_and_upright_walls():
    """What is asked for is named until all of it is stated."""
    survey, rng = vehicle("scanner", "planar", "vertical", tilt=0.0), np.random.default_rng(0)
    true = mounted("eye", "scanner", 0.0, (0.1, -0.05, 0.3))[1]
    drawn = true.copy()
    drawn[:3, :3] = (
        true[:3, :3] @ Rotation.from_rotvec(np.radians(0.3) * rng.normal(size=3)).as_matrix()
    )
    mount = hl.Known("mount", ("sensor:eye",), sigma=2e-3, sigma_angle=np.radians(0.3), pose=drawn)
    walls = [
        hl.Known("upright", (f"plane:{name}",), direction=[0, 0, 1], sigma_angle=np.radians(0.1))
        for name in "ABC"
    ]
    found = hl.calibrate(survey)
    assert all(f'relation = "{word}"' in found.message for word in ("mount", "upright"))
    for known, asked in (((mount,), "upright"), (walls, "mount")):
        found = hl.calibrate(replace(survey, known=tuple(known)))
        assert found.status == "undetermined"
        assert f'relation = "{asked}"' in found.message
        assert ("a stated mount alone" in found.message) == (asked == "upright")
        assert ('relation = "mount"' in found.message) == (asked == "mount")
    assert "height of scanner eye" in found.message
    found = hl.calibrate(replace(survey, known=(mount, *walls)))
    assert found.usable
    own = found.sensors["eye"]
    turn = Rotation.from_matrix(true[:3, :3].T @ own.rotation).as_rotvec()
    assert (np.abs(turn) < 5.0 * own.rotation_sigma).all()
    assert (np.abs(own.location - true[:3, 3]) < 5.0 * own.location_sigma).all()
    assert own.rotation_sigma.max() < np.radians(0.35)


@pytest.mark.slow
def test_planes_of_too_few_stations_are_not_said_to_lean():
    """The rays of this scanner lean by 20 degrees, and it saw plane B from one stop."""
    survey = vehicle("scanner", "planar", "vertical", tilt=20.0)
    true = mounted("eye", "scanner", 20.0, (0.1, -0.05, 0.3))[1]
    mount = hl.Known("mount", ("sensor:eye",), sigma=2e-3, sigma_angle=np.radians(0.3), pose=true)
    kept = np.isin(np.arange(len(survey.stations)), [0, 1, 2, 3, 12, 24, 25, 26])
    found = hl.calibrate(replace(survey, known=(mount,)).part(kept))
    assert found.status == "undetermined"
    assert "a stated mount alone" not in found.message


@pytest.mark.slow
def test_the_example_is_determined_and_says_what_it_holds(handlaser):
    words = ["check", str(FOLDER / "poses.csv"), "--rig", str(FOLDER / "rig.toml")]
    code, out, err = handlaser(*words)
    assert (code, err) == (0, "")
    assert "profiler scanner: 24 shots of 1152 points" in out
    assert "plane:plate, 12 stations: 12 orientations, turns about 3 axes" in out
    assert "60 numbers from shots for 13 unknowns" in out  # 12 x 2 + 12 x 3; 6 + 3 + 4
    code, out, _ = handlaser(*words, "--json")
    found = json.loads(out)
    assert code == 0
    assert found["format"] == "handlaser-survey-check"
    assert [one["name"] for one in found["targets"]] == ["plane:plate", "sphere:ball"]
    # As well as calibrate knows it, up to the sizes of the noise, which are learned there.
    known = float(calibrated_example().sensors["scanner"].location_sigma.max())
    assert 0.3 * known < found["sensors"][0]["location_sigma_m"] < 5.0 * known


@pytest.mark.slow
def test_readings_that_only_shift_along_their_noise_change_no_word():
    """The check asks the readings where the targets are, and nothing else."""
    survey = vehicle("profiler", "planar", "one leans")
    noisy = hl.Shots.profiler(
        "eye",
        survey.shots[0].station,
        survey.shots[0].across[:, 0],
        survey.shots[0].reading
        + 3e-4 * np.random.default_rng(1).standard_normal(len(survey.shots[0].reading)),
        sigma=3e-4,
    )
    again = check_survey(hl.Survey(survey.stations, (noisy,)))
    assert again.undetermined == check_survey(survey).undetermined


@pytest.mark.slow
def test_a_cone_is_named_with_its_cure():
    rig = rigs_by_rays.profiler(101, targets="planes", planes=1, motion="cone")
    check = check_survey(survey_of(rig))
    assert "saw its plane at one angle to the direction (0.00, 0.00, 1.00)" in check.undetermined[0]
    assert check.advice == ("tilt it by another angle, or add a second plane",)
    assert check.exactly


@pytest.mark.slow
def test_too_few_stations_are_said(tmp_path, handlaser):
    folder = shutil.copytree(FOLDER, tmp_path / "profiler")
    rows = (folder / "poses.csv").read_text().splitlines()
    (folder / "poses.csv").write_text("\n".join(rows[:4]) + "\n")
    points = (folder / "profiles.csv").read_text().splitlines()
    kept = [row for row in points if row.split(",")[0] in ("station", "P1", "P2", "P3")]
    (folder / "profiles.csv").write_text("\n".join(kept) + "\n")
    words = ["check", str(folder / "poses.csv"), "--rig", str(folder / "rig.toml")]
    code, out, err = handlaser(*words, "--json")
    assert code == 3
    assert json.loads(out)["undetermined"]
    few = (
        "too few stations, 6 numbers from shots for 9 unknowns, leave open sensor scanner: location"
    )
    assert few in err
    # The hand turns about two axes, and is not to be turned about two axes.
    assert "To determine it: measure at more stations" in err
    assert "turn the hand" not in err
    code, _, err = handlaser("calibrate", *words[1:])
    assert code == 3
    assert few in err
    assert "turn the hand" not in err


@pytest.mark.slow
def test_beams_beside_sensors_are_said():
    rig = rigs_by_rays.mixed(101)
    survey = survey_of(rig)
    lines = list(check_lines(check_survey(survey)))
    assert any(line.startswith("beam beam: ") for line in lines)
    (noise,) = [line for line in lines if "follow from the noise" in line]
    assert noise.endswith("beams 0.1 mm assumed, hand 0.1 mm and 0.02 deg assumed")
    stated = check_survey(survey, hl.Noise(2e-4, 1e-4, None))
    assert stated.noise[-2] == "single beams 0.2 mm as stated"
    assert stated.noise[-1] == "hand 0.1 mm as stated and 0.02 deg assumed"


def require_no_promise(check):
    """Where most shots do not fit each other, nothing is said of how well mounts would be known."""
    assert not check.undetermined
    assert all(np.isinf(one.location_sigma) for one in check.sensors)
    lines = list(check_lines(check))
    assert check.doubt in lines
    assert check.doubt.startswith("most shots do not fit each other: a typical one misses")
    assert not any("to be known to" in line or "determines" in line for line in lines)


@pytest.mark.slow  # starts are looked for in halves of shots that do not fit
def test_an_array_that_reads_the_other_way_is_asked_for_its_convention():
    """A calibration says so in its headline, too."""
    survey, _, _ = rough(3, stations=12, sigma=2e-4, stated="perpendicular")
    check, found = check_survey(survey), hl.calibrate(survey)
    require_no_promise(check)
    assert check.doubt.endswith('set convention = "radial"')
    assert not found.usable
    assert 'set convention = "radial"' in found.verdict.sentence


@pytest.mark.slow
def test_what_was_not_read_is_counted_as_by_a_calibration():
    """One station has no point, and those of another fit no ball."""
    survey = example()
    shots = survey.shots[0]
    kept = shots.station != 3
    z = shots.reading.copy()
    nowhere = shots.station == 15  # before the ball
    z[nowhere] = np.random.default_rng(1).uniform(0.1, 0.9, nowhere.sum())
    few = hl.Shots.profiler("scanner", shots.station[kept], shots.across[kept, 0], z[kept])
    few = hl.Survey(survey.stations, (few,))
    check, found = check_survey(few), hl.calibrate(few)
    assert check.sensors[0].shots == found.sensors["scanner"].shots == 22
    assert check.sensors[0].lost == 1
    codes = ["stations-left-out", "too-few-points"]
    assert [one.code for one in check.warnings] == codes
    assert check.warnings == tuple(one for one in found.warnings if one.code in codes)
    assert "and 1 shot with too few there" in next(check_lines(check))


@pytest.mark.slow
def test_degrees_of_freedom_are_said_in_the_counts_of_a_check(handlaser):
    words = (str(FOLDER / "poses.csv"), "--rig", str(FOLDER / "rig.toml"))
    counted = re.search(
        r"(\d+) numbers from shots for (\d+) unknowns", handlaser("check", *words)[1]
    )
    fit = re.search(
        r"at (\d+) degrees of freedom: (\d+) numbers from shots, (\d+) more of errors and "
        r"relations, (\d+) unknowns",
        " ".join(handlaser("calibrate", *words)[1].split()),
    )
    dof, numbers, more, unknowns = map(int, fit.groups())
    assert (numbers, unknowns) == tuple(map(int, counted.groups()))
    assert dof == numbers + more - unknowns


@pytest.mark.slow
def test_relations_count_in_a_check_and_false_ones_are_refused(handlaser, tmp_path):
    """As `calibrate` does: a beam before one plane is determined by what is known of its mount."""
    shutil.copytree(FOLDER, tmp_path / "folder")
    rig = tmp_path / "folder" / "rig.toml"
    plain = rig.read_text()
    few = (FOLDER / "poses.csv").read_text().splitlines()[:5]  # four stations before the plate
    (tmp_path / "folder" / "few.csv").write_text("\n".join(few) + "\n")
    points = (FOLDER / "profiles.csv").read_text().splitlines()
    kept = [
        line for line in points if line.partition(",")[0] in ("station", "P1", "P2", "P3", "P4")
    ]
    (tmp_path / "folder" / "profiles_few.csv").write_text("\n".join(kept) + "\n")
    T = np.array(json.loads((FOLDER / "truth.json").read_text())["hand_T_sensor"])
    angles = Rotation.from_matrix(T[:3, :3]).as_euler("ZYX", degrees=True)

    def ends(poses, text, place):
        pose = [*(1e3 * place).tolist(), *angles.tolist()]
        known = '[[known]]\nrelation = "mount"\nof = ["sensor:scanner"]\nsigma_mm = 0.1\n'
        rig.write_text(f"{text}\n{known}sigma_deg = 0.01\npose_mm_deg = {pose}\n")
        words = tmp_path / "folder" / poses, "--rig", rig
        return [handlaser(verb, *words) for verb in ("check", "calibrate")]

    rig.write_text(plain.replace("profiles.csv", "profiles_few.csv"))
    assert handlaser("check", tmp_path / "folder" / "few.csv", "--rig", rig)[0] == 3
    for code, _, err in ends(
        "few.csv", plain.replace("profiles.csv", "profiles_few.csv"), T[:3, 3]
    ):
        assert code == 0, err
    for code, _, err in ends("poses.csv", plain, T[:3, 3] + 0.01):
        assert code in (3, 4)
        assert "the readings contradict what is said to be known: mount of sensor:scanner" in err
