"""Single beams of a survey with two mounts that fit nearly as well."""

import numpy as np
import pytest

import handlaser_gtsam as hl
from benchmarks import rigs_by_rays
from benchmarks.few_readings import few_readings
from benchmarks.rigs import HAND, errors_of, survey_of

COARSE = 5e-4
NOISE = hl.Noise(COARSE, pose_translation_sigma=HAND[0], pose_rotation_sigma=HAND[1])


def solved(seed):
    """Return a rig whose beams have 7 to 12 readings of half a millimetre, with its calibration."""
    rig = few_readings(seed, rigs_by_rays, COARSE)
    return rig, hl.calibrate(survey_of(rig), NOISE)


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "beam"), [(35, "beam2"), (55, "beam3")])
def test_a_wrong_minimum_is_not_usable(seed, beam):
    """The lower minimum is not the true one here, by a chi2 of about one."""
    rig, found = solved(seed)
    errors = dict(zip([*found.sensors, *found.beams], errors_of(rig, found), strict=True))
    error, C = errors[beam]
    assert float(error @ np.linalg.solve(C, error)) > 100.0
    named = {w.values["beam"]: w.values for w in found.warnings if w.code == "another-mount"}
    turned = np.degrees(np.arccos(found.beams[beam].direction @ rig.truth[beam]["direction"]))
    assert named[beam]["turn_deg"] == pytest.approx(turned, abs=3.0)
    assert named[beam]["chi2"] < 3.0
    assert found.verdict.code == "undetermined"
    assert not found.usable
    assert found.verdict.best.code == "another-mount"


@pytest.mark.slow
def test_a_mount_that_is_less_probable_is_a_warning():
    _, found = solved(30)
    (rival,) = [w for w in found.warnings if w.code == "another-mount"]
    assert 5.99 < rival.values["chi2"] < 13.8
    assert found.verdict.code == "usable-with-care"


@pytest.mark.slow
def test_beams_with_one_minimum_have_no_rival():
    _, found = solved(1)
    assert "another-mount" not in [w.code for w in found.warnings]
