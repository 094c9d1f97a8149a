"""A beam that errs by more than the others gets a range sigma of its own where none is stated."""

from dataclasses import replace

import numpy as np
import pytest

import handlaser_gtsam as hl
from handlaser_gtsam.validation.quick_validation import held_out
from handlaser_gtsam.validation.scenes import SCENES, Errors, Layout, simulate

USUAL, SHIFT, TURN = 2e-5, 5e-5, np.radians(5e-3)


def recorded(seed, layout, rough=None, sigma=2e-4):
    """Return a recording by a robot that errs, and its truth; beam number `rough` errs by `sigma`."""
    rng = np.random.default_rng(seed)
    truth, stations = SCENES["paper"](layout, rng)
    recording = simulate(truth, stations, Errors(USUAL, SHIFT, TURN), rng)
    ranges = recording.ranges.copy()
    if rough is not None:
        ranges[:, rough] += sigma * rng.standard_normal(len(ranges))
    return replace(recording, ranges=ranges), truth


def rough_beams(calibration):
    return [one.values for one in calibration.warnings if one.code == "rough-beam"]


def squared_errors(calibration, truth):
    """Return squares of the errors of each mount in its own covariance, over the numbers in it."""
    errors = np.hstack(
        (
            calibration.parameters().locations - truth.locations,
            calibration.parameters().directions - truth.directions,
        )
    )
    squares = []
    for beam, error in zip(calibration.beams.values(), errors, strict=True):
        inverse = np.linalg.pinv(beam.covariance[:6, :6], rcond=1e-9, hermitian=True)
        squares.append(error @ inverse @ error / 5.0)
    return np.array(squares)


@pytest.mark.parametrize("seed", range(3))
def test_a_rough_beam_is_named_with_its_own_sigma_and_all_mounts_are_honest(seed):
    recording, truth = recorded(seed, Layout(beams=4, planes=4, stations=12), rough=2)
    found = hl.calibrate(recording)
    (rough,) = rough_beams(found)
    assert rough["beam"] == recording.beam_names[2]
    assert rough["sigma"] == pytest.approx(2e-4, rel=0.35)
    assert rough["others"] == pytest.approx(USUAL, rel=0.5)
    assert found.verdict.code == "usable-with-care"
    assert squared_errors(found, truth).mean() < 2.5
    one = hl.calibrate(recording, options=hl.CalibrationOptions(range_sigma_by_beam=False))
    assert not rough_beams(one)
    # One sigma of all leaves the others too unsure.
    sizes = [[beam.sigma[:3].max() for beam in each.beams.values()] for each in (found, one)]
    assert (np.delete(sizes[0], 2) < np.delete(sizes[1], 2)).all()


def test_of_two_beams_it_is_the_same_as_a_sigma_by_beam():
    recording, _ = recorded(5, Layout(beams=2, planes=4, stations=12), rough=0)
    found = hl.calibrate(recording)
    each = hl.calibrate(recording, options=hl.CalibrationOptions(range_sigma_by_beam=True))
    assert rough_beams(found)
    assert not rough_beams(each)
    for name, beam in found.beams.items():
        away = (beam.location - each.beams[name].location) / each.beams[name].sigma[:3]
        assert np.abs(away).max() < 0.02
        np.testing.assert_allclose(beam.sigma, each.beams[name].sigma, rtol=0.02)


@pytest.mark.parametrize("beams", [2, 5])
def test_beams_that_are_alike_have_one_sigma(beams):
    for seed in range(6):
        recording, _ = recorded(seed, Layout(beams=beams, planes=3, stations=12))
        assert not rough_beams(hl.calibrate(recording))


def test_several_rough_beams_have_sigmas_of_their_own():
    recording, _ = recorded(3, Layout(beams=5, planes=4, stations=12), rough=1)
    ranges = recording.ranges.copy()
    ranges[:, 4] += 4e-4 * np.random.default_rng(4).standard_normal(len(ranges))
    found = {
        one["beam"]: one["sigma"]
        for one in rough_beams(hl.calibrate(replace(recording, ranges=ranges)))
    }
    assert found == pytest.approx({"2": 2e-4, "5": 4e-4}, rel=0.35)


def test_good_readings_of_a_very_rough_beam_are_no_contradiction():
    """Its readings were outliers beside the sigma of the others, and it was said to contradict them."""
    for seed in range(3):
        recording, truth = recorded(
            seed, Layout(beams=4, planes=4, stations=14), rough=0, sigma=3e-4
        )
        found = hl.calibrate(recording)
        assert [one["beam"] for one in rough_beams(found)] == ["1"]
        assert len(found.fit.rejected) <= 2
        assert squared_errors(found, truth).mean() < 2.5


@pytest.mark.parametrize("rough", [7, 8])
def test_one_of_many_beams_is_found_whether_it_represents_others_or_not(rough):
    recording, _ = recorded(1, Layout(beams=33, planes=2, stations=12), rough, 1e-4)
    found = rough_beams(hl.calibrate(recording))
    assert [one["beam"] for one in found] == [recording.beam_names[rough]]


@pytest.mark.parametrize("seed", [2, 3, 4])
def test_few_readings_tell_that_their_beam_is_rough(seed):
    """With one sigma for all, 14 readings of it were usable without a word and four times too sure."""
    recording, _ = recorded(seed, Layout(beams=4, planes=4, stations=12), rough=3)
    kept = (np.arange(48) % 4 == 0) | np.isin(np.arange(48), [1, 2])
    ranges = recording.ranges.copy()
    ranges[~kept, 3] = np.nan
    (rough,) = rough_beams(hl.calibrate(replace(recording, ranges=ranges)))
    assert rough["beam"] == "4"
    assert rough["sigma"] == pytest.approx(2e-4, rel=0.4)


def test_a_stated_range_sigma_holds_for_all_beams():
    recording, _ = recorded(2, Layout(beams=4, planes=4, stations=12))
    found = hl.calibrate(recording, hl.Noise(USUAL))
    assert not rough_beams(found)
    assert found.fit.range_sigma_given


def test_planes_are_added_with_one_sigma_of_all_beams():
    recording, _ = recorded(1, Layout(beams=3, planes=4, stations=12), rough=1)
    session = hl.Session()
    session.add(recording)
    assert session.options.range_sigma_by_beam is False
    assert not rough_beams(session.calibration())


def test_what_is_held_out_is_judged_by_the_sigma_of_each_beam(tmp_path):
    """With one sigma for all, its own planes contradicted a calibration, by 1e-9."""
    recording, _ = recorded(4, Layout(beams=4, planes=4, stations=12), rough=1)
    found = hl.validate(recording, splits=1)
    assert found.calibration.verdict.code == "usable-with-care"
    assert not found.contradicted
    assert not held_out(found.calibration).contradicted
    path = tmp_path / "calibration.json"
    hl.write_calibration(path, found.calibration)
    mounts = hl.read_mounts(path)
    np.testing.assert_allclose(mounts.range_sigma, hl.Mounts.of(found.calibration).range_sigma)
    assert mounts.range_sigma[1] > 5.0 * mounts.range_sigma[0]
    other, _ = recorded(4, Layout(beams=4, planes=4, stations=12), rough=1)
    part = other.part(np.arange(0, 48, 2))
    assert hl.hold_out(mounts, part).holds
    assert mounts.arranged(("2",)).range_sigma == mounts.range_sigma[1]


def test_a_rough_beam_is_named_where_no_other_scale_is_learned():
    recording, _ = recorded(1, Layout(beams=4, planes=4, stations=12), rough=2)
    alone = hl.CalibrationOptions("none", poses="exact")
    assert [one["beam"] for one in rough_beams(hl.calibrate(recording, options=alone))] == ["3"]
    alike, _ = recorded(1, Layout(beams=4, planes=4, stations=12))
    found = hl.calibrate(alike, options=alone)
    assert not rough_beams(found)
    assert not found.noise_estimate
