"""Recordings with one mistake of a cell each: none is silent and wrong; headlines name causes."""

from dataclasses import replace

import numpy as np
import pytest

import handlaser_gtsam as hl
from benchmarks.cell_mistakes import AFTER, BEFORE, judge, make_cell
from handlaser_gtsam.results.verdict import verdict

NAMED = (
    "everything-in-mm",
    "positions-in-mm",
    "ranges-in-inches",
    "poses-inverted",
    "quaternions-scalar-first",
    "axis-negated",
    "two-axes-exchanged",
    "sensors-exchanged-one-plate",
    "sensors-exchanged-from-middle",
    "output-inverted",
    "unit-changes-half-way",
    "labels-exchanged-from-middle",
    "two-plates-one-label",
    "plate-moves-20mm",
    "read-on-the-way",
)
SMALL = {"plate-moves-20mm": 54}
"""Seeds of the smallest cells, two sensors before two plates: 11 where nothing is said."""
HARMLESS = ("none", "gross-3%", "readings-1mm", "poses-rounded", "tool-wrong-throughout")


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMED)
def test_the_headline_names_the_mistake(name):
    row = judge((name, SMALL.get(name, 11)), None)
    assert row.named, row.headline
    assert row.outcome != "silent"
    assert row.headline.count("read so") <= 1  # what is named is said once


@pytest.mark.slow
@pytest.mark.parametrize("name", HARMLESS)
def test_what_does_no_harm_stays_usable_and_right(name):
    row = judge((name, 11), None)
    assert row.outcome in ("silent", "care"), row.headline
    assert not row.wrong


@pytest.mark.slow
def test_a_beam_that_hits_the_plane_from_behind_is_named():
    row = judge(("output-inverted", 1), None)
    assert row.outcome == "unusable"
    assert "from its two sides" in row.headline
    assert "beam 1 looks inverted" in row.headline


@pytest.mark.slow
def test_readings_of_coarse_steps_are_called_coarse():
    """A sensor of 1 mm resolution at about 5 mm: neither stations nor the cell are at fault."""
    cell = make_cell(1)
    cell.record_poses()
    cell.read()
    small = 0.045
    names = tuple(str(i) for i in range(cell.d.shape[1]))
    d = np.round(small * cell.d, 3)
    found = hl.calibrate(
        hl.Recording(cell.recorded_R, small * cell.recorded_t, d, tuple(cell.labels), names)
    )
    assert found.status == "not_converged"
    words = verdict(found).sentence
    assert "they are rounded to 1 mm where they spread by" in words
    assert "stations" not in words


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "seed"), [("labels-exchanged-from-middle", 0), ("plate-moves-20mm", 2)]
)
def test_labels_are_named_where_most_of_their_readings_are_rejected(name, seed):
    """The rest is calibrated well, and a third of the readings is lost."""
    row = judge((name, seed), None)
    assert row.named, row.headline
    assert not row.wrong


@pytest.mark.slow
def test_readings_that_noise_was_learned_for_are_no_fit_beside_a_mistake_that_explains_them():
    """A third of plate A is rejected, and the rest makes errors of the hand of 1 mm."""
    row = judge(("two-plates-one-label", 6), None)
    assert row.named, row.headline
    assert row.outcome == "unusable"


@pytest.mark.slow
def test_labels_that_change_late_are_named_once():
    row = judge(("label-late-by-three", 3), None)
    named = ("stations have the label of another plane", "look like another plane's")
    assert sum(row.headline.count(words) for words in named) == 1
    assert not row.wrong


def test_the_study_has_more_than_forty_mistakes():
    assert len(BEFORE) + len(AFTER) - 1 >= 40


ROBOT = {"pose_translation_sigma": 4e-5, "pose_rotation_sigma": 1.4e-4}
EXACT = {"pose_translation_sigma": 0.0, "pose_rotation_sigma": 0.0}


@pytest.mark.parametrize("model", ["none", "k1k2"])
@pytest.mark.parametrize("poses", [ROBOT, EXACT], ids=["robot", "exact"])
def test_sizes_of_systematic_errors_do_not_grow_with_the_samples(model, poses):
    """A mean of 100 readings with a hundredth of the variance is one reading of a better sensor."""
    cell = make_cell(5)
    cell.k[:] *= model != "none"
    cell.record_poses()
    cell.read()
    names = tuple(str(i) for i in range(cell.d.shape[1]))
    one = hl.Recording(cell.recorded_R, cell.recorded_t, cell.d, tuple(cell.labels), names)
    many = replace(one, samples=np.full(cell.d.shape, 100.0))
    options = hl.CalibrationOptions(range_error=model)
    first = hl.calibrate(one, hl.Noise(2e-5, **poses), options)
    second = hl.calibrate(many, hl.Noise(2e-4, **poses), options)
    assert np.allclose(second.fit.range_sigma, 10.0 * first.fit.range_sigma, rtol=0.05)
    sizes = {error.code: error for error in second.systematic}
    tested = [error for error in first.systematic if not error.confounded]
    assert {error.code for error in tested} >= {"incidence", "cubic", "drift", "sag", "displaced"}
    for error in tested:
        other = sizes[error.code]
        # The levels of the noise in the readings, which the two take alike, differ by rounding.
        for value in ("size", "sigma", "detectable", "location_shift", "direction_shift"):
            ours, theirs = getattr(error, value), getattr(other, value)
            assert np.allclose(theirs, ours, rtol=1e-4, atol=1e-9), (error.code, value)
