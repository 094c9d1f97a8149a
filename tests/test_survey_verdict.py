"""The verdict on a survey: its code, causes and remedies for programs, and its radius around a spot."""

import json
from dataclasses import replace

import numpy as np
import pytest

import handlaser_gtsam as hl
from benchmarks import rigs_by_rays
from benchmarks.rigs import HAND, survey_of
from handlaser_gtsam.files.calibration_writing import calibration_text
from handlaser_gtsam.results.limits import Limits
from handlaser_gtsam.results.survey_verdict import survey_verdict
from handlaser_gtsam.results.warnings import RIVAL

FIELDS = ["code", "usable", "sentence", "spot", "may_hide", "causes", "remedies"]
"""Of a verdict in the JSON of calibrations of beams before planes."""
EXACT = hl.Noise(pose_translation_sigma=0.0, pose_rotation_sigma=0.0)


def record_of(result, limits=None):
    """The verdict as its JSON has it, which must be that of calibrations of beams before planes."""
    content = json.loads(calibration_text(result, survey_verdict(result, limits)))
    assert list(content["verdict"]) == FIELDS
    return content["verdict"]


@pytest.mark.slow
def test_a_program_reads_code_causes_and_remedies():
    survey = survey_of(rigs_by_rays.profiler(3, targets="planes+sphere"))
    result = hl.calibrate(survey, EXACT)
    sigma = float(result.sensors["profiler"].location_sigma.max())
    good = record_of(result)
    assert (good["code"], good["usable"]) == ("usable", True)
    assert good["spot"]["radius_m"] == result.sensors["profiler"].spot_error
    assert [one["code"] for one in good["remedies"]] == ["more-stations"]
    bad = record_of(result, Limits(location_sigma=sigma / 3.0))
    assert (bad["code"], bad["usable"]) == ("outside-limits", False)
    (cause,) = bad["causes"]
    assert cause["values"]["value"] == sigma
    assert bad["remedies"][0]["number"] == pytest.approx(9.0)
    # What makes numbers wrong comes before limits that they exceed, and both are said.
    rival = hl.CalibrationWarning(RIVAL, "another mount", {"chi2": 0.5})
    judged = survey_verdict(replace(result, warnings=(rival,)), Limits(location_sigma=sigma / 3.0))
    assert judged.code == "undetermined"
    assert rival.message in judged.sentence
    assert judged.exceeded[0] in judged.sentence


@pytest.mark.slow
def test_what_is_undetermined_has_more_stations_as_its_remedy():
    survey = survey_of(rigs_by_rays.profiler(3))
    result = hl.calibrate(survey.part(np.arange(len(survey.stations)) < 3), EXACT)
    verdict = record_of(result)
    assert (verdict["code"], verdict["usable"], verdict["spot"]) == ("undetermined", False, None)
    (remedy,) = verdict["remedies"]
    assert remedy["code"] == "more-stations"
    assert remedy["message"] == "measure at more stations"


@pytest.mark.slow
def test_a_false_relation_and_a_range_error_are_codes():
    rig = rigs_by_rays.profiler(3, targets="planes+sphere")
    survey, radius = survey_of(rig), rig.truth["targets"]["sphere:S1"]["radius"]
    false = hl.Known("radius", ("sphere:S1",), radius + 0.002, sigma=1e-4)
    verdict = record_of(hl.calibrate(replace(survey, known=(false,)), EXACT))
    assert verdict["code"] == "contradicted"
    (remedy,) = verdict["remedies"]
    assert remedy["code"] == "relation-contradicted"
    assert "relation-contradicted" in {one["code"] for one in verdict["causes"]}
    (shots,) = survey.shots
    longer = replace(survey, shots=(replace(shots, reading=1.001 * shots.reading),))
    found = hl.calibrate(longer, EXACT)
    verdict = record_of(found)
    assert verdict["code"] == "no-fit"
    assert [one["code"] for one in verdict["remedies"]] == ["range-error"]
    (cause,) = [one.message for one in found.warnings if one.code == "range-error"]
    assert found.message.startswith(f"{cause}; the rows do not fit each other: ")
    assert found.verdict.findings == (found.message,)


@pytest.mark.slow
def test_the_robot_is_named_where_its_errors_are_most_of_the_spot():
    """The share is what the variance of the spot loses where the hand has no errors."""
    hand = 2e-4, 1e-3
    survey = survey_of(rigs_by_rays.profiler(7, hand_sigma=hand, planes=3, stations=14))
    noise = hl.Noise(pose_translation_sigma=hand[0], pose_rotation_sigma=hand[1])
    (remedy,) = record_of(hl.calibrate(survey, noise))["remedies"]
    assert remedy["code"] == "poses"
    assert 0.9 < remedy["number"] <= 1.0
    covariance = np.diag([hand[1] ** 2] * 3 + [hand[0] ** 2] * 3)
    (stated,) = record_of(hl.calibrate(survey, hl.Noise(pose_covariance=covariance)))["remedies"]
    assert stated["number"] == pytest.approx(remedy["number"], rel=1e-6)


@pytest.mark.slow
def test_the_radius_around_the_spot_of_a_beam_holds_95_of_100():
    survey = survey_of(rigs_by_rays.beams(3, targets="planes+sphere", count=1))
    (beam,) = hl.calibrate(survey, hl.Noise()).beams.values()
    rng = np.random.default_rng(1)
    drawn = rng.multivariate_normal(np.zeros(7), beam.covariance, 20000)
    v = beam.direction
    across = np.linalg.svd(v[None])[2][
        1:
    ]  # tangents of its own: their turn about v changes nothing
    cosines = beam.covariance[3:5, 3:5]
    assert np.linalg.eigvalsh(cosines)[-1] == pytest.approx(beam.direction_sigma**2)
    assert across.shape == (2, 3)
    away = np.linalg.norm(drawn @ beam.spot_by().T, axis=1)
    assert (away < beam.spot_error).mean() == pytest.approx(0.95, abs=0.01)


def test_a_range_error_that_may_go_unnoticed_stands_beside_the_radius():
    """Balls alone hardly tell a k0 from another place of the sensor."""
    noise = hl.Noise(pose_translation_sigma=HAND[0], pose_rotation_sigma=HAND[1])
    result = hl.calibrate(
        survey_of(rigs_by_rays.array(0, targets="sphere", hand_sigma=HAND)), noise
    )
    (sensor,) = result.sensors.values()
    tested = sensor.errors["k0"]
    assert sensor.hidden == ("k0", tested.detectable * tested.spot_shift)
    words = "; random errors only: k0 may go unnoticed and move it by 0.67 mm); best"
    assert words in result.verdict.sentence
    planes = hl.calibrate(survey_of(rigs_by_rays.scanner(4, hand_sigma=HAND)), noise)
    (sensor,) = planes.sensors.values()
    assert 0.0 < sensor.hidden[1] < sensor.spot_error
    assert "random errors only" not in planes.verdict.sentence


def test_a_range_error_that_was_found_is_the_first_word_and_the_improvement():
    """The warning named k2 to be freed, and the improvement k1."""
    survey = survey_of(rigs_by_rays.profiler(2, hand_sigma=HAND))
    (shots,) = survey.shots
    survey = replace(survey, shots=(replace(shots, reading=0.9988 * shots.reading),))
    noise = hl.Noise(pose_translation_sigma=HAND[0], pose_rotation_sigma=HAND[1])
    result = hl.calibrate(survey, noise)
    (warning,) = result.warnings
    free = warning.values["free"]
    assert result.verdict.code == "usable-with-care"
    assert f"profiler reads with an error {free} of" in result.verdict.findings[1]
    assert f'free = ["{free}"] of profiler' in result.verdict.best.words
