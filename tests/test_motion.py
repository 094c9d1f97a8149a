"""What a motion can determine before anything is solved, and what is reported when it cannot."""

import json
from dataclasses import replace

import numpy as np
import pytest
from helpers import DEGENERATE, GRIPPER, bench, degenerate, motion, recording_of, simulated

import handlaser_gtsam as hl
from benchmarks.random_problems import judge_solvable, judge_unsolvable
from handlaser_gtsam.files.recording_csv import write_recording
from handlaser_gtsam.observability.motion import check_motion, lemma_words
from handlaser_gtsam.observability.other_solutions import Judge, held
from handlaser_gtsam.observability.rank import ObservabilityOptions, observability

NONE = hl.CalibrationOptions("none")


@pytest.mark.slow
@pytest.mark.parametrize("case", DEGENERATE)
def test_what_the_motion_leaves_open_is_what_the_solution_leaves_open(case):
    recording = degenerate(case)
    check = check_motion(recording)
    solved = hl.calibrate(recording, options=NONE).observability
    key = [(part.kind, part.name, part.quantity, part.axes.shape[1]) for part in check.open_parts]
    assert key == [
        (part.kind, part.name, part.quantity, part.axes.shape[1]) for part in solved.open_parts
    ]
    assert check.advice == solved.advice


def test_the_lemmas_name_the_stations_that_serve():
    check = check_motion(hl.read_recording(GRIPPER / "recording.csv"))
    assert check.undetermined == ()
    for plane in check.planes:
        assert (plane.stations, plane.translations) == (11, 3)
        assert plane.axes >= 2
        assert len(plane.translating) == 8
    words = lemma_words(check, ("1", "2", "3", "4"))
    assert "plane A, 11 stations: normal in closed form (Lemma 1)" in words[0]
    assert "stations 1, 2, 3, 4" in words[0]


def test_free_motion_satisfies_no_lemma_one_and_determines_everything():
    check = check_motion(simulated("arm")[0])
    assert check.undetermined == ()
    assert all(plane.translations == 0 and plane.axes >= 2 for plane in check.planes)


@pytest.mark.slow
@pytest.mark.parametrize(("case", "code"), [("one plane, one axis", 3), (None, 0)])
def test_the_command(handlaser, tmp_path, case, code):
    recording, path = degenerate(case) if case else simulated("arm")[0], tmp_path / "recording.csv"
    write_recording(path, recording)
    exit_code, _, err = handlaser("check", path)
    assert exit_code == code
    assert len(err.splitlines()) == (1 if code else 0)
    assert ("location along (0.00, 0.00, 1.00)" in err) == bool(code)
    exit_code, out, _ = handlaser("check", path, "--json")
    assert exit_code == code
    record = json.loads(out)
    assert record["format"] == "handlaser-check"
    assert bool(record["undetermined"]) == bool(code)


def test_an_open_beam_does_not_spoil_the_others():
    """Beam 2 has four readings: beam 1 and the plane come out as if it were not there."""
    recording = recording_of(bench(1, 2), *motion("free", 25), [0] * 25, 1e-4)
    ranges = recording.ranges.copy()
    ranges[4:, 1] = np.nan
    both = hl.calibrate(replace(recording, ranges=ranges), hl.Noise(1e-4, 0.0, 0.0), NONE)
    alone = hl.calibrate(
        replace(recording, ranges=ranges[:, :1], beam_names=("1",)), hl.Noise(1e-4, 0.0, 0.0), NONE
    )
    assert both.status == "unobservable"
    assert all("beam 2" in words for words in both.observability.undetermined)
    assert both.beams["2"].covariance is None
    mine, its = both.beams["1"], alone.beams["1"]
    # Four readings for five unknowns of beam 2 fit exactly and say nothing about the rest.
    assert np.allclose(mine.location, its.location, atol=1e-8)
    assert np.allclose(mine.covariance, its.covariance, rtol=1e-4, atol=1e-16)
    assert np.allclose(both.planes["A"].covariance, alone.planes["A"].covariance, rtol=1e-4)


def test_what_is_determined_is_not_moved_to_the_hand():
    truth = bench(1, 1)
    readings = recording_of(truth, *motion("free", 40), [0] * 40, 1e-4).readings()
    observed = observability(truth, readings, 2, 1e-4)
    assert observed.full
    at, still = held(truth, observed, Judge(readings, 2, 1e-4, ObservabilityOptions()))
    assert at == truth
    assert still.full


@pytest.mark.slow
def test_open_coordinates_have_no_sigma_and_the_others_do():
    found = hl.calibrate(degenerate("one plane, one axis"), hl.Noise(1e-4), NONE)
    sigma = found.beams["1"].sigma
    assert np.isinf(sigma[2])
    assert np.isfinite(sigma[[0, 1, 3, 4, 5]]).all()
    assert found.beams["1"].covariance is None
    plane = found.planes["A"]
    assert np.isfinite(plane.normal_sigma)
    assert np.isinf(plane.offset_sigma)


def test_indices_do_not_depend_on_units_or_noise():
    recording, _ = simulated("arm", range_sigma=1e-3)
    scaled = replace(
        recording, world_t_hand=0.1 * recording.world_t_hand, ranges=0.1 * recording.ranges
    )
    indices = [
        hl.calibrate(r, hl.Noise(s, 0.0, 0.0), NONE).observability.indices
        for r, s in ((recording, 1e-3), (scaled, 1e-4))
    ]
    for name in ("O1", "O2", "O3", "O4"):
        mine, its = (getattr(i, name) for i in indices)
        assert mine > 0.0
        assert mine == pytest.approx(its, rel=1e-6)
    assert pytest.approx(indices[0].O2 * indices[0].O3) == indices[0].O4


@pytest.mark.slow
@pytest.mark.parametrize(("judge", "problems"), [(judge_solvable, 8), (judge_unsolvable, 5)])
def test_random_problems_end_at_the_optimum_or_in_a_refusal(judge, problems):
    """The first of the 12,000 whose study by `benchmarks.random_problems` is in docs/results.md.

    The gate goes through the first 40 and 20 of them by that command.
    """
    verdicts = [judge(seed) for seed in range(problems)]
    assert [one for one in verdicts if not one.good] == []
