"""Ultrasonic sensors: cones that read the nearest thing within them."""

import json
import math
import re
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from helpers import ROOT
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

import handlaser_gtsam as hl
from handlaser_gtsam.errors import InputError
from handlaser_gtsam.files.input_reading import read_any_kind
from handlaser_gtsam.files.rig_toml import read_rig
from handlaser_gtsam.model.families import BEAM, FAMILIES, PLANE, POSE
from handlaser_gtsam.model.geometry import normalized
from handlaser_gtsam.model.range_blocks import PoseVariables, Ranges
from handlaser_gtsam.model.sensors.beam import BeamSensor
from handlaser_gtsam.model.targets.plane import PlaneTarget
from handlaser_gtsam.model.targets.sphere import SPHERE, Sphere

HALF = math.radians(12.0)
NARROW = math.radians(6.0)
"""Cones of half the width; those of which wrong angles are tried are read far sooner."""
SIGMA = 1e-3
STATED = hl.Noise(range_sigma=SIGMA, pose_translation_sigma=0.0, pose_rotation_sigma=0.0)
Array = NDArray[np.float64]


def nearest_in_cone(r: Array, v: Array, distance_along: object) -> float:
    """Return the shortest range of all rays within the cone, searched for, not derived."""
    side = np.linalg.svd(v[None])[2][1:]

    def along(angles: Array) -> float:
        off, about = HALF * math.tanh(angles[0]), angles[1]
        u = math.cos(off) * v + math.sin(off) * (
            math.cos(about) * side[0] + math.sin(about) * side[1]
        )
        return float(distance_along(r, u))  # type: ignore[operator]

    starts = [np.array([x, a]) for x in (0.1, 1.0) for a in (0.0, 1.5, 3.0, 4.5)]
    options = {"xatol": 1e-10, "fatol": 1e-13, "maxiter": 4000}
    return min(float(minimize(along, x, method="Nelder-Mead", options=options).fun) for x in starts)


def survey(seed: int, tilt: float, stations: int = 20) -> tuple[hl.Survey, Array, Array]:
    """Return a survey of one cone before two planes, with its location and direction."""
    rng = np.random.default_rng(seed)
    r, v = rng.normal(scale=0.05, size=3), rng.normal(size=3)
    v /= np.linalg.norm(v)
    R, t, d, labels = [], [], [], []
    for label in ("A", "B"):
        n, b = rng.normal(size=3), rng.uniform(-1.0, 1.0)
        n /= np.linalg.norm(n)
        x, y = np.linalg.svd(n[None])[2][1:]
        for _ in range(stations):
            theta, about, D = rng.uniform(0.0, tilt), rng.uniform(0.0, 6.28), rng.uniform(0.3, 0.8)
            axis = -math.cos(theta) * n
            axis += math.sin(theta) * (math.cos(about) * x + math.sin(about) * y)
            to_axis = Rotation.align_vectors([axis], [v])[0]
            hand = (Rotation.from_rotvec(rng.uniform(-3.0, 3.0) * axis) * to_axis).as_matrix()
            o = (D - b) * n + rng.uniform(-0.5, 0.5) * x + rng.uniform(-0.5, 0.5) * y
            R.append(hand)
            t.append(o - hand @ r)
            labels.append(label)
            d.append(D / math.cos(max(theta - HALF, 0.0)) + SIGMA * rng.normal())
    listed = hl.StationList(np.array(R), np.array(t), tuple(labels))
    made = hl.Survey(listed, (), np.array(d)[:, None], ("sonar",), half_angle=HALF)
    return made, r, v


@cache
def two_cones(seed: int, half: float = HALF) -> tuple[hl.Survey, Array]:
    """Return a survey of two cones on a hand before two planes and a ball, with their locations.

    At some stations before the ball the nearest ray of a cone only just meets it.
    """
    rng = np.random.default_rng(seed)
    locations = np.array([[0.06, 0.02, 0.04], [-0.05, 0.03, 0.05]])
    axes = np.array([[0.12, -0.05, 1.0], [-0.1, 0.08, 1.0]])
    axes /= np.linalg.norm(axes, axis=1)[:, None]
    centre, radius = np.array([0.2, 0.1, 1.1]), 0.15
    planes = {"A": (np.array([0.1, 0.05, 1.0]), 0.9), "B": (np.array([0.8, 0.1, 0.6]), 1.2)}
    R, t, ranges, labels = [], [], [], []
    for label in np.repeat(["A", "B", "sphere:ball"], 15).tolist():
        read = np.full(2, np.nan)
        while np.isnan(read).any():  # a cone that hears nothing
            away = rng.uniform(0.25, 0.55)
            if label in planes:
                n, offset = planes[label][0] / np.linalg.norm(planes[label][0]), planes[label][1]
                foot = rng.uniform(-0.3, 0.3, 3)
                ahead, place = n, (offset - away - n @ foot) * n + foot
            else:
                ahead = np.append(rng.uniform(-0.6, 0.6, 2), 1.0)
                ahead /= np.linalg.norm(ahead)
                place = centre - (away + radius) * ahead
            about, roll = rng.uniform(0.0, 6.28), Rotation.from_euler("z", rng.uniform(-3.0, 3.0))
            lean = rng.uniform(0.0, 2.5 * half) * np.array([math.cos(about), math.sin(about), 0.0])
            turn = Rotation.align_vectors([ahead], [[0.0, 0.0, 1.0]])[0] * roll
            hand = (turn * Rotation.from_rotvec(lean)).as_matrix()
            place = place - 0.04 * hand[:, 2]
            for i, (r, v) in enumerate(zip(locations, axes, strict=True)):
                o, u = place + hand @ r, hand @ v
                if label in planes:
                    beyond = max(math.acos(u @ n) - half, 0.0)
                    read[i] = (offset - n @ o) / math.cos(beyond)
                    continue
                L = float(np.linalg.norm(centre - o))
                beyond = max(math.acos(u @ (centre - o) / L) - half, 0.0)
                under = radius**2 - (L * math.sin(beyond)) ** 2
                read[i] = L * math.cos(beyond) - math.sqrt(under) if under > 0.0 else np.nan
        R.append(hand)
        t.append(place)
        labels.append(label)
        ranges.append(read + SIGMA * rng.normal(size=2))
    listed = hl.StationList(np.array(R), np.array(t), tuple(labels))
    return hl.Survey(listed, (), np.array(ranges), ("1", "2"), half_angle=half), locations


@cache
def two_calibrated(seed: int) -> hl.SurveyCalibration:
    """Return the calibration of two cones, made once for all tests."""
    return hl.calibrate(two_cones(seed)[0], STATED)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["plane", "sphere"])
def test_a_cone_reads_the_nearest_that_is_within_it(kind: str) -> None:
    """The range is the least over all rays of the cone, and derivatives are those of differences."""
    rng = np.random.default_rng(5)
    n, c = np.array([0.1, -0.2, 1.0]) / np.linalg.norm([0.1, -0.2, 1.0]), np.array([0.0, 0.1, 1.0])
    for trial in range(6):  # within the cone, and beyond it
        lean = (0.3 if trial % 2 else 2.2) * HALF
        if kind == "sphere":
            lean = HALF + (-0.1 if trial % 2 else 0.12)
        v = Rotation.from_rotvec(lean * np.array([1.0, 0.0, 0.0])).apply(n)
        r = rng.normal(scale=0.05, size=3)
        if kind == "plane":
            target = np.concatenate((n, [0.0], c))
            family: str = PLANE.name
            seen: PlaneTarget | Sphere = PlaneTarget(np.array([0]))

            def ahead(o: Array, u: Array) -> float:
                return float(n @ (c - o) / (n @ u))
        else:
            centre = r + 0.9 * n
            target, family = np.append(centre, 0.25), SPHERE.name
            seen = Sphere(np.array([0]))

            def ahead(o: Array, u: Array, centre: Array = centre) -> float:
                w = o - centre
                under = (w @ u) ** 2 - w @ w + 0.25**2
                return float(-(w @ u) - math.sqrt(under)) if under > 0.0 else 9.0

        values = {
            BEAM.name: np.concatenate((r, v, [0.01, 0.02]))[None, None],
            family: target[None, None],
            POSE.name: np.concatenate((np.eye(3).ravel(), np.zeros(3)))[None, None],
        }
        zero = np.array([0])
        block = Ranges(BeamSensor(zero, HALF), seen, PoseVariables(zero), np.full((1, 1, 1), 0.7))
        columns = block.evaluate(values).columns[:, 0, 0, 0]
        g = 0.7 * (1.0 + 0.01 + 0.02 * 0.7)
        assert columns[-1] + g == pytest.approx(nearest_in_cone(r, v, ahead), abs=1e-9)
        first = 0
        for name in (BEAM.name, family, POSE.name):
            for j in range(FAMILIES[name].dim):
                step, ends = np.zeros((1, 1, FAMILIES[name].dim)), []
                for sign in (1e-6, -1e-6):
                    step[..., j] = sign
                    moved = {**values, name: FAMILIES[name].retract(values[name], step)}
                    ends.append(block.evaluate(moved).columns[-1, 0, 0, 0])
                slope = (ends[0] - ends[1]) / 2e-6
                assert columns[first + j] == pytest.approx(slope, abs=2e-6)
            first += FAMILIES[name].dim


@pytest.mark.slow
def test_a_cone_is_found_from_nothing():
    """Errors are as large as their covariances say, and SciPy finds the same.

    The covariances of two cones on one hand are tested below, with ten cones.
    """
    squares, cones = [], 4
    for seed in range(cones):
        made, r, v = survey(seed, 2.0 * HALF)
        result = hl.calibrate(made, STATED)
        assert result.status == "converged"
        beam = result.beams["sonar"]
        error = beam.location - r
        squares.append(error @ np.linalg.solve(beam.covariance[:3, :3], error))
        assert math.acos(min(1.0, float(v @ beam.direction))) < 5.0 * beam.direction_sigma
        if seed == 0:
            assert hl.cross_check(result).largest < 1e-4
    least, most = chi2.ppf([1e-3, 1.0 - 1e-3], 3 * cones)
    assert least < sum(squares) < most


@pytest.mark.slow
@pytest.mark.parametrize("seed", [4, 21])
def test_readings_that_graze_a_ball_end_no_search(seed):
    """On the way, or with noise, a ray misses: such a reading is left out, and said to be."""
    _, locations = two_cones(seed)
    result = two_calibrated(seed)
    assert result.usable, result.verdict.sentence
    for beam, r in zip(result.beams.values(), locations, strict=True):
        assert (np.abs(beam.location - r) < 4.0 * beam.location_sigma).all()
    assert "grazing" in {one.reason for one in result.rejected}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("seed", "half", "factor", "noise"),
    [
        (0, NARROW, 1.0 / 0.6, replace(STATED, range_sigma=None)),
        (5, NARROW, 2.0, STATED),
        (14, HALF, 0.5, STATED),
    ],
)
def test_a_wrong_half_angle_is_named(seed, half, factor, noise):
    """With estimated noise it was usable, and fourteen standard deviations off.

    On the way to the right one the misfit of seed 14 grows first.
    """
    made, _ = two_cones(seed, half)
    result = hl.calibrate(replace(made, half_angle=factor * half), noise)
    assert not result.usable
    warning = next(one for one in result.warnings if one.code == "half-angle")
    assert warning.values["half_angle"] == pytest.approx(half)


def rough(made: hl.Survey, noise: float, **changed: object) -> hl.Survey:
    """Return a survey with further noise of its readings [m]."""
    assert made.ranges is not None
    more = noise * np.random.default_rng(0).normal(size=made.ranges.shape)
    return replace(made, ranges=made.ranges + more, **changed)  # type: ignore[arg-type]


def test_an_angle_that_few_rough_readings_do_not_tell_is_warned_of():
    """With 15 degrees in place of 12 a mount was 5 standard deviations off, usable without a word."""
    made, r, _ = survey(0, 3.0 * HALF, stations=12)
    found = hl.calibrate(rough(made, 3e-3, half_angle=1.25 * HALF))
    (warning,) = (one for one in found.warnings if one.code == "half-angle-unsure")
    assert found.verdict.code == "usable-with-care"
    assert warning.values["shift_m"] > 0.5 * np.linalg.norm(found.beams["sonar"].location - r)


@pytest.mark.slow
def test_rough_readings_whose_noise_is_not_stated_fit():
    """From thirty stations before a plane on, two cones with 5 mm of noise were called no fit."""
    rng = np.random.default_rng(0)
    r = np.array([[0.05, 0.01, 0.02], [-0.04, 0.03, 0.01]])
    v = np.array([[0.1, -0.05, 1.0], [-0.12, 0.15, 1.0]])
    v /= np.linalg.norm(v, axis=1)[:, None]
    R, t, ranges, labels = [], [], [], []
    for label, n in zip("ABC", ([0.2, 0.1, 1.0], [-0.5, 0.2, 1.0], [0.3, -0.6, 1.0]), strict=True):
        n /= np.linalg.norm(n)
        face = Rotation.align_vectors([n], [[0.0, 0.0, -1.0]])[0]  # z of the hand towards the plane
        for _ in range(35):
            about = rng.uniform(0.0, 6.28)
            lean = rng.uniform(0.0, 0.6) * np.array([math.cos(about), math.sin(about), 0.0])
            roll = Rotation.from_euler("z", rng.uniform(-3.0, 3.0))
            hand = (face * roll * Rotation.from_rotvec(lean)).as_matrix()
            place = rng.uniform(0.3, 0.8) * n + rng.uniform(-0.2, 0.2, 3)
            away = (place + r @ hand.T) @ n
            tilt = np.arccos(np.clip(-(v @ hand.T) @ n, -1.0, 1.0))
            R.append(hand)
            t.append(place)
            labels.append(label)
            ranges.append(away / np.cos(np.maximum(tilt - HALF, 0.0)) + 5e-3 * rng.normal(size=2))
    stations = hl.StationList(np.array(R), np.array(t), tuple(labels))
    found = hl.calibrate(hl.Survey(stations, (), np.array(ranges), ("1", "2"), half_angle=HALF))
    assert found.status == "converged"
    assert not found.rejected
    for beam, location in zip(found.beams.values(), r, strict=True):
        error = beam.location - location
        assert error @ np.linalg.solve(beam.covariance[:3, :3], error) < chi2.ppf(1.0 - 1e-3, 3)


@pytest.mark.parametrize("seed", [0, 2])
def test_noise_that_shows_before_one_plane_most_is_noise(seed):
    """Cones of 1 mm that never lean past their half angle were no fit, with the advice to check poses.

    Before one of three planes the typical reading misfits by a little more than six times the noise
    that is usual of a beam, and by a little less before all.
    """
    rng = np.random.default_rng(seed)
    r = rng.uniform(-0.06, 0.06, (2, 3))
    v = normalized(np.column_stack((rng.uniform(-0.1, 0.1, (2, 2)), np.ones(2))))
    R, t, ranges, labels = [], [], [], []
    walls = [([0.1, 0.05, 1.0], 0.9), ([0.8, 0.1, 0.6], 1.2), ([-0.5, 0.7, 0.4], 1.0)]
    for label, (n, offset) in zip("ABC", walls, strict=True):
        n = normalized(np.array(n))
        for _ in range(14):
            turn = Rotation.align_vectors([n], [[0.0, 0.0, 1.0]])[0]
            turn *= Rotation.from_euler("z", rng.uniform(-3.0, 3.0))
            lean = rng.uniform(0.0, 0.15) * np.array([1.0, 0.0, 0.0])
            lean = Rotation.from_euler("z", rng.uniform(-3.0, 3.0)).apply(lean)
            hand = (turn * Rotation.from_rotvec(lean)).as_matrix()
            place = rng.uniform(-0.3, 0.3, 3)
            place += (offset - rng.uniform(0.3, 0.7) - n @ place) * n
            away = offset - (place + r @ hand.T) @ n
            tilt = np.arccos((v @ hand.T) @ n)
            R.append(hand)
            t.append(place)
            labels.append(label)
            noise = [1e-3 * rng.normal() for _ in range(2)]
            ranges.append(away / np.cos(np.maximum(tilt - np.radians(15.0), 0.0)) + noise)
    stations = hl.StationList(np.array(R), np.array(t), tuple(labels))
    half = float(np.radians(15.0))
    found = hl.calibrate(hl.Survey(stations, (), np.array(ranges), ("1", "2"), half_angle=half))
    assert found.verdict.code == "undetermined"
    assert "all readings are within the cone" in found.verdict.sentence


def test_what_is_more_than_noise_is_no_fit():
    """Without a bound the noise of transposed poses is learned, and the motion said to be too poor."""
    made, _ = two_cones(0)
    turned = replace(made.stations, world_R_hand=made.stations.world_R_hand.swapaxes(1, 2))
    found = hl.calibrate(replace(made, stations=turned))
    assert (found.status, found.verdict.code) == ("contradicted", "no-fit")


@pytest.mark.slow
def test_only_cones_that_read_alike_however_they_turn_are_said_to():
    """Readings with much noise leave directions undetermined that tilted axes tell."""
    found = hl.calibrate(rough(two_cones(2)[0], 12e-3))
    assert found.status == "undetermined"
    assert "within the cone" not in found.message


@pytest.mark.slow
def test_cones_on_a_hand_are_honest():
    """With the right half angle all are usable, and within chi2 of their truth."""
    squares, seeds = 0.0, (0, 1, 2, 4, 21)
    for seed in seeds:
        _, locations = two_cones(seed)
        result = two_calibrated(seed)
        assert result.usable, (seed, result.verdict.sentence)
        for beam, r in zip(result.beams.values(), locations, strict=True):
            error = beam.location - r
            squares += error @ np.linalg.solve(beam.covariance[:3, :3], error)
    least, most = chi2.ppf([1e-3, 1.0 - 1e-3], 2 * 3 * len(seeds))
    assert least < squares < most


@pytest.mark.slow
def test_within_the_cone_its_direction_is_open_and_its_location_is_not() -> None:
    """What cures it is said; a stated mount does."""
    made, r, v = survey(1, 0.95 * HALF, stations=40)
    result = hl.calibrate(made, STATED)
    assert result.status == "undetermined"
    assert not result.usable
    assert "direction of sonar: all readings are within the cone" in result.verdict.sentence
    assert "more than 12 degrees" in result.verdict.sentence
    beam = result.beams["sonar"]
    assert np.isfinite(beam.location_sigma).all()
    assert (np.abs(beam.location - r) < 4.0 * beam.location_sigma).all()
    pose = np.eye(4)
    pose[:3, :3] = Rotation.align_vectors([v], [[0.0, 0.0, 1.0]])[0].as_matrix()
    pose[:3, 3] = r
    known = hl.Known("mount", ("beam:sonar",), sigma=0.1, sigma_angle=0.02, pose=pose)
    assert hl.calibrate(replace(made, known=(known,)), STATED).usable


@pytest.mark.slow
def test_cones_are_made_and_read_by_the_command(handlaser, refusal, tmp_path):
    """From a rig file to a calibration; what is no cone is refused."""
    rig, made, targets = tmp_path / "rig.toml", tmp_path / "made", "plane:A,plane:B,sphere:S"
    rig.write_text("[noise]\nrange_sigma_mm = 1.0\n[sensor]\nhalf_angle_deg = 6\n")
    words = ["simulate", made, "--rig", rig, "--targets", targets, "--seed", "3"]
    assert "with --beams" in refusal(*words)
    assert handlaser(*words, "--beams", "2")[0] == 0
    assert "half_angle_deg = 6" in (made / "rig.toml").read_text()
    survey, _ = read_any_kind(read_rig(made / "rig.toml"), made / "stations.csv")
    assert survey.half_angle == pytest.approx(NARROW)
    code, out, _ = handlaser("calibrate", made / "stations.csv", "--rig", made / "rig.toml")
    assert code == 0
    assert out.startswith("Usable")
    assert "beam 1 within" in out
    rays = '[[sensors]]\nname = "s"\nkind = "profiler"\npoints = "p.csv"\n'
    rig.write_text(f"{rays}half_angle_deg = 6\n")
    err = refusal("calibrate", made / "stations.csv", "--rig", rig)
    assert "half_angle_deg of s, which is of kind = 'profiler'; expected it of kind = 'beam'" in err
    rig.write_text("[sensor]\nhalf_angle_deg = 95\n")
    assert "half_angle" in refusal("calibrate", made / "stations.csv", "--rig", rig)


@pytest.mark.slow
def test_range_errors_and_noise_of_cones_are_shown(handlaser, tmp_path):
    """As of any beam: a k1 of 3 % is found, and stands on the screen with its noise."""
    rig, made = tmp_path / "rig.toml", tmp_path / "made"
    rig.write_text("[noise]\nrange_sigma_mm = 1.0\n[sensor]\nhalf_angle_deg = 6\n")
    words = [
        "simulate",
        made,
        "--rig",
        rig,
        "--targets",
        "plane:A,plane:B,sphere:S",
        "--beams",
        "1",
    ]
    assert handlaser(*words, "--seed", "3", "--k1", "0.03")[0] == 0
    words = ["calibrate", made / "stations.csv", "--rig", made / "rig.toml"]
    code, out, _ = handlaser(*words, "--out", tmp_path / "out.json")
    assert code == 0
    said = " ".join(out.split())
    assert "single beams 1 mm" in said
    k1, sigma = map(float, re.search(r"range error of beam 1: k1 (\S+) \+- (\S+) %", said).groups())
    (beam,) = json.loads((tmp_path / "out.json").read_text())["beams"]
    assert beam["reading_sigma_m"] == 1e-3
    assert k1 == pytest.approx(100.0 * beam["range_error"][0], rel=1e-3)  # four digits are shown
    variance = beam["covariance"][5][5]  # of location (3), direction (2), k1 and k2
    assert sigma == pytest.approx(100.0 * math.sqrt(variance), rel=0.05)  # two digits
    # The simulated error is of the reading: 3 %, found within four standard deviations.
    assert abs(k1 - 3.0) < 4.0 * sigma


@pytest.mark.slow
@pytest.mark.parametrize("verb", ["check", "calibrate"])
def test_ultrasonic_sensors_without_a_half_angle_are_said_to_be_read_as_beams(
    handlaser, tmp_path, verb
):
    """Of planes, and of a survey with a ball; not where the half angle is stated."""
    rig, made = tmp_path / "rig.toml", tmp_path / "made"
    rig.write_text("[noise]\nrange_sigma_mm = 1.0\n[sensor]\nhalf_angle_deg = 5\n")
    words = ["simulate", made, "--rig", rig, "--targets", "plane:A,sphere:S", "--beams", "1"]
    assert handlaser(*words, "--seed", "3")[0] == 0
    for recording in (ROOT / "examples/gripper/recording.csv", made / "stations.csv"):
        # A check shows that nothing is said where the half angle is stated.
        for half_angle in ("", "half_angle_deg = 5\n") if verb == "check" else ("",):
            rig.write_text(f'[sensor]\nkind = "ultrasonic"\n{half_angle}')
            _, out, err = handlaser(verb, recording, "--rig", rig)
            said = " ".join(f"{out} {err}".split())
            assert ("in [sensor] without half_angle_deg" in said) == (not half_angle)


def test_a_cone_that_no_beam_has_is_refused(refusal, tmp_path):
    """A half angle counts for single beams only: a survey of a profiler has none."""
    folder = ROOT / "examples/profiler"
    for name in ("poses.csv", "profiles.csv"):
        (tmp_path / name).write_bytes((folder / name).read_bytes())
    rig = tmp_path / "rig.toml"
    rig.write_text((folder / "rig.toml").read_text() + "\n[sensor]\nhalf_angle_deg = 12\n")
    assert "found half_angle_deg in [sensor], and no single beam" in refusal(
        "calibrate", tmp_path / "poses.csv", "--rig", rig
    )
    words = ("simulate", tmp_path / "made", "--rig", rig, "--targets", "plane:A,sphere:S")
    assert "half_angle_deg in [sensor] without single beams" in refusal(*words)
    read = hl.read_survey(folder / "poses.csv", folder / "rig.toml")
    with pytest.raises(InputError, match="no single beam that it would count for"):
        replace(read, half_angle=HALF)


def test_a_cone_is_not_aimed_at_a_point() -> None:
    """Only a beam is."""
    made, *_ = survey(0, HALF)
    labels = ("point:tip", *made.stations.plane_labels[1:])
    with pytest.raises(InputError, match="a cone that reads point:tip"):
        replace(made, stations=replace(made.stations, plane_labels=labels))
