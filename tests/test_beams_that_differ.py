"""A laser and an ultrasonic cone on one hand: their noise and their half angle are those of each."""

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

import handlaser_gtsam as hl
from handlaser_gtsam.errors import InputError

HALF = math.radians(10.0)
LASER, SONAR = 2e-4, 4e-3
"""Standard deviations of readings [m]."""
EXACT = hl.Noise(pose_translation_sigma=0.0, pose_rotation_sigma=0.0)
PLANES = {
    "floor": (np.array([0.1, 0.05, 1.0]), 0.9),
    "wall": (np.array([0.8, 0.1, 0.6]), 1.2),
    "board": (np.array([-0.5, 0.7, 0.4]), 1.0),
}
MOUNTS = np.array([[0.06, 0.02, 0.04], [-0.05, 0.03, 0.05]])
AXES = np.array([[0.12, -0.05, 1.0], [-0.1, 0.08, 1.0]])


def hand_of_two(seed: int, stations: int = 14) -> hl.Survey:
    """Return what a laser and a cone read before three planes; nothing of the noise is stated."""
    rng = np.random.default_rng(seed)
    axes = AXES / np.linalg.norm(AXES, axis=1)[:, None]
    R, t, ranges, labels = [], [], [], []
    for label, (n, offset) in PLANES.items():
        n = n / np.linalg.norm(n)
        for _ in range(stations):
            turn = Rotation.align_vectors([n], [[0.0, 0.0, 1.0]])[0]
            turn *= Rotation.from_euler("z", rng.uniform(-3.0, 3.0))
            lean = rng.uniform(0.0, 0.6) * np.array([1.0, 0.0, 0.0])
            lean = Rotation.from_euler("z", rng.uniform(-3.0, 3.0)).apply(lean)
            hand = (turn * Rotation.from_rotvec(lean)).as_matrix()
            place = rng.uniform(-0.3, 0.3, 3)
            place += (offset - rng.uniform(0.3, 0.7) - n @ place) * n
            away = [offset - n @ (place + hand @ r) for r in MOUNTS]
            angle = [math.acos(float(hand @ v @ n)) for v in axes]
            R.append(hand)
            t.append(place)
            labels.append(label)
            ranges.append(
                [
                    away[0] / math.cos(angle[0]) + LASER * rng.normal(),
                    away[1] / math.cos(max(angle[1] - HALF, 0.0)) + SONAR * rng.normal(),
                ]
            )
    listed = hl.StationList(np.array(R), np.array(t), tuple(labels))
    return hl.Survey(listed, (), np.array(ranges), ("laser", "sonar"), half_angle=(0.0, HALF))


def errors_of(result: hl.SurveyCalibration) -> NDArray[np.float64]:
    """Return the squares of the errors of both locations, in their covariances."""
    found = []
    for beam, r in zip(result.beams.values(), MOUNTS, strict=True):
        e = beam.location - r
        found.append(float(e @ np.linalg.solve(beam.covariance[:3, :3], e)))
    return np.array(found)


@pytest.mark.slow
def test_the_noise_of_each_is_learned_and_errors_are_as_large_as_their_sigmas():
    """With one noise for both the laser was known as badly as the cone, twenty times too badly."""
    squares = []
    for seed in range(5):
        result = hl.calibrate(hand_of_two(seed), EXACT)
        assert result.usable, result.verdict.sentence
        squares.append(errors_of(result))
        for beam, sigma in zip(result.beams.values(), (LASER, SONAR), strict=True):
            assert beam.reading_sigma == pytest.approx(sigma, rel=0.6)
    for one in np.sum(squares, axis=0).tolist():
        least, most = chi2.ppf([1e-4, 1.0 - 1e-4], 3 * len(squares))
        assert least < one < most


def test_stated_noise_is_of_the_beam_it_is_stated_of():
    """What is stated of one beam says nothing of the other; SciPy finds the same."""
    made = replace(hand_of_two(3), range_sigma=(np.nan, SONAR))
    result = hl.calibrate(made, EXACT)
    laser, sonar = result.beams.values()
    assert (sonar.reading_sigma, laser.reading_sigma != SONAR) == (SONAR, True)
    checked = hl.cross_check(result)
    assert not checked.difference, checked.difference
    said = " ".join(result.summary().split())
    assert "sonar 4 mm" in said
    both = hl.calibrate(hand_of_two(3), replace(EXACT, range_sigma=5e-3))
    assert {beam.reading_sigma for beam in both.beams.values()} == {5e-3}
    fine = hl.calibrate(hand_of_two(3), replace(EXACT, range_sigma=1e-3))
    assert fine.beams["laser"].reading_sigma == 1e-3
    assert fine.beams["sonar"].reading_sigma == pytest.approx(SONAR, rel=0.3)
    assert "stated range sigma of sonar of 1 mm" in fine.warnings[0].message


@pytest.mark.slow
def test_a_wrong_half_angle_is_said_of_the_cone_it_is_of():
    """Of one kind of cones among others the names are said."""
    made = replace(hand_of_two(1), half_angle=(0.0, 0.5 * HALF))
    result = hl.calibrate(made, replace(EXACT, range_sigma=1e-3))
    (warning,) = (one for one in result.warnings if one.code.startswith("half-angle"))
    assert "of sonar" in warning.message
    assert warning.values["half_angle"] == pytest.approx(HALF)


def test_parts_keep_what_is_of_their_beams():
    """A part without the cone has no cone, and joining takes it back."""
    made = replace(hand_of_two(0), range_sigma=(LASER, SONAR))
    ranges = made.ranges.copy()
    half = np.arange(len(ranges)) < len(ranges) // 2
    ranges[half, 1] = np.nan
    made = replace(made, ranges=ranges)
    first, rest = made.part(half), made.part(~half)
    assert (first.beam_names, first.cones.tolist()) == (("laser",), [0.0])
    again = first.joined(rest)
    assert again == made
    other = replace(rest, range_sigma=(2.0 * LASER, SONAR))
    with pytest.raises(InputError, match="of laser after"):
        first.joined(other)


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"half_angle": (0.1, 0.2, 0.3)}, "half_angle of shape"),
        ({"half_angle": (0.0, np.nan)}, "half_angle"),
        ({"range_sigma": (0.0, 1.0)}, "range_sigma"),
        ({"range_sigma": (-1.0, np.nan)}, "range_sigma"),
    ],
)
def test_numbers_of_no_beam_are_refused(changed, words):
    """One number, or one a beam, each one that can be."""
    with pytest.raises(InputError, match=words):
        replace(hand_of_two(0), **changed)


BEAMS = """
[noise]
pose_translation_sigma_mm = 0.0
pose_rotation_sigma_deg = 0.0

[[sensors]]
name = "laser"
kind = "beam"

[[sensors]]
name = "sonar"
kind = "beam"
half_angle_deg = 10.0
sigma_mm = 4.0
"""


def test_the_command_takes_beams_that_differ(handlaser, refusal, tmp_path):
    """From a rig file to simulated readings and back, and what is said of no beam is refused."""
    rig, made = tmp_path / "rig.toml", tmp_path / "made"
    rig.write_text(BEAMS)
    words = ["simulate", made, "--rig", rig, "--targets", "plane:A,plane:B,plane:C"]
    assert handlaser(*words, "--seed", "2", "--stations", "14")[0] == 0
    survey = hl.read_survey(made / "stations.csv", made / "rig.toml")
    assert survey.said_of_beams()["sonar"] == (pytest.approx(math.radians(10.0)), 4e-3)
    code, out, _ = handlaser("calibrate", made / "stations.csv", "--rig", made / "rig.toml")
    assert code == 0, out
    assert "sonar 4 mm" in " ".join(out.split())
    for text, found in (
        (BEAMS.replace("sonar", "echo"), "echo of kind = 'beam' in [[sensors]], of which nothing"),
        (BEAMS + 'points = "p.csv"\n', "points of sonar, which is of kind = 'beam'"),
        (BEAMS.replace("10.0", "95.0"), "half_angle_deg of sonar"),
    ):
        rig.write_text(text)
        assert found in refusal("calibrate", made / "stations.csv", "--rig", rig)


def test_known_relations_of_beams_in_a_log_count(handlaser, tmp_path):
    """A rig file with [[known]] and beams alone reads logs as one without does."""
    rig, made = tmp_path / "rig.toml", tmp_path / "made"
    rig.write_text(BEAMS)
    words = ["simulate", made, "--rig", rig, "--targets", "plane:A,plane:B,plane:C"]
    assert handlaser(*words, "--seed", "2", "--stations", "14")[0] == 0
    log = tmp_path / "log.csv"
    text = (made / "stations.csv").read_text()
    log.write_text(text.replace("range_laser", "laser").replace("range_sonar", "sonar"))
    table = '\n[log]\nrange_columns = ["laser", "sonar"]\npose_format = "ros"\n'
    rig.write_text((made / "rig.toml").read_text() + table)
    code, out, err = handlaser("calibrate", log, "--rig", rig)
    assert code == 0, err
    assert "sonar 4 mm" in " ".join(out.split())


def test_a_range_error_that_no_beam_has_is_asked_about():
    """No laser reads 13 % too little: another unit, or positions of another scale, look like that."""
    survey = hand_of_two(0)
    assert survey.ranges is not None
    short = replace(survey, ranges=survey.ranges / (1.15, 1.0))
    (warning,) = [one for one in hl.calibrate(short).warnings if one.code == "large-range-error"]
    assert (warning.values["beam"], warning.values["expected"]) == ("laser", 0.01)
    assert 0.1 < float(warning.values["size"]) < 0.15  # the prior expects none
    assert "large-range-error" not in [one.code for one in hl.calibrate(survey).warnings]
