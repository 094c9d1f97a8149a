"""Studies: the same rows whoever works on them, none lost or counted twice, and what they add up to."""

import os
import signal
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from functools import partial
from pathlib import Path

import numpy as np
import polars as pl
import pytest

import handlaser_gtsam as hl
from handlaser_gtsam import Calibrated, Case, Drawn, Reduced, Simulated, study
from handlaser_gtsam.simulation.scenes import Layout
from handlaser_gtsam.simulation.simulate import Errors

EXACT = hl.Noise(3e-5, 0.0, 0.0)
PAPER = Simulated("paper", Layout(2, 3, 11), Errors(3e-5))


def reduced(name="paper", scene=PAPER):
    return Case(name, "reduction", scene, Reduced(EXACT))


def once_killed(rng, mark, scene=PAPER):
    """Draw from a scene, but end the process of whoever draws first after some other runs."""
    if rng.bit_generator.seed_seq.entropy[-1] == 45 and not Path(mark).exists():
        Path(mark).touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return scene(rng)


def test_rows_do_not_depend_on_who_works():
    one = study([reduced()], 60, 3, ThreadPoolExecutor(1)).rows
    many = study([reduced()], 60, 3, partial(ProcessPoolExecutor, 2)).rows
    assert one.equals(many)
    assert not one.equals(study([reduced()], 60, 4, ThreadPoolExecutor(1)).rows)


def test_a_lost_worker_loses_and_doubles_nothing(tmp_path):
    draw = Drawn(f"{__name__}:once_killed", {"mark": str(tmp_path / "killed")})
    found = study(
        [Case("paper", "reduction", draw, Reduced(EXACT))], 100, 3, partial(ProcessPoolExecutor, 2)
    )
    assert (tmp_path / "killed").exists()
    assert found.rows.equals(study([reduced()], 100, 3, ThreadPoolExecutor(1)).rows)


def test_what_was_interrupted_goes_on(tmp_path):
    def stop(done, _total):
        if done >= 40:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        study([reduced()], 100, 3, partial(ThreadPoolExecutor, 1), hl.StudyFolder(tmp_path), stop)
    kept = {path: path.stat().st_mtime_ns for path in tmp_path.glob("*.parquet")}
    assert 2 <= len(kept) < 5
    found = study([reduced()], 100, 3, partial(ThreadPoolExecutor, 1), hl.StudyFolder(tmp_path))
    assert all(path.stat().st_mtime_ns == time for path, time in kept.items())
    assert found.rows.equals(study([reduced()], 100, 3, ThreadPoolExecutor(1)).rows)
    more = study([reduced()], 140, 3, partial(ThreadPoolExecutor, 1), hl.StudyFolder(tmp_path))
    assert more.rows[:100].equals(found.rows)
    with pytest.raises(hl.InputError, match="another study"):
        study([reduced()], 100, 4, None, hl.StudyFolder(tmp_path))


def test_honest_estimates_have_a_nees_of_one():
    errors = Errors(3e-5, 5e-5, np.radians(0.03))
    scene = Simulated("unplanned", Layout(2, 4, 11), errors)
    cases = [
        Case("robot", "told", scene, Reduced(errors.stated())),
        Case("robot", "taken as exact", scene, Reduced(EXACT)),
    ]
    found = study(cases, 200, 1, partial(ProcessPoolExecutor, 2)).summary()
    told, exact = found.rows(named=True)
    assert told["converged"] == exact["converged"] == 100.0
    assert told["nees"] == pytest.approx(1.0, abs=4.0 * told["standard_error"])
    assert told["coverage"] == pytest.approx(95.0, abs=2.0)
    assert exact["nees"] > 2.0
    assert told["location_mm"] < exact["location_mm"]


def test_both_treatments_see_the_same_recordings():
    scene = Simulated("paper", Layout(2, 3, 11), Errors(3e-5))
    options = hl.CalibrationOptions("none", outliers="keep")
    cases = [reduced(scene=scene), Case("paper", "calibrate", scene, Calibrated(EXACT, options))]
    rows = study(cases, 3, 0, ThreadPoolExecutor(1)).rows
    one, other = rows.partition_by("treatment")
    for name in ("location_squares", "direction_squares", "nees", "worst"):
        assert one[name].to_numpy() == pytest.approx(other[name].to_numpy(), rel=1e-4)


def test_refusals_and_warnings_are_counted():
    scene = Simulated("paper", Layout(1, 1, 4), Errors(3e-5))
    cases = [Case("poor", "calibrate", scene, Calibrated(EXACT))]
    found = study(cases, 4, 0, ThreadPoolExecutor(1))
    assert (
        found.rows["status"].is_in(["refused", "undetermined", "converged", "unobservable"]).all()
    )
    assert found.summary()["converged"][0] < 100.0
    assert set(found.power().columns) == {"scene", "treatment", "code", "percent"}


@pytest.mark.parametrize(
    ("cases", "runs", "words"),
    [
        ([], 1, "one or more"),
        ([reduced(), reduced()], 1, "once"),
        ([reduced()], 0, "runs"),
        ([Case("x", "y", lambda _: None, Reduced(EXACT))], 1, "pickled"),
        ([Case("x", "y", Drawn("nowhere:none"), Reduced(EXACT))], 1, "module:name"),
    ],
)
def test_what_is_no_study_is_refused(cases, runs, words):
    with pytest.raises(hl.InputError, match=words):
        study(cases, runs, 0, ThreadPoolExecutor(1))


def test_a_folder_of_something_else_is_refused(tmp_path):
    pl.DataFrame({"a": [1]}).write_parquet(tmp_path / "mine.parquet")
    with pytest.raises(hl.InputError, match="something else"):
        study([reduced()], 20, 0, ThreadPoolExecutor(1), hl.StudyFolder(tmp_path))
