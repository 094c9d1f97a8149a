"""Studies: the same rows whoever works on them, none lost or counted twice, and what they add up to."""

import json
import os
import signal
import subprocess
import sys
import time
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import replace
from functools import cache, partial
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import polars as pl
import pytest

import handlaser_gtsam as hl
from benchmarks.studies import Studies
from handlaser_gtsam import run_study
from handlaser_gtsam.validation import Case, Study
from handlaser_gtsam.validation.scenes import Layout, draw_scene
from handlaser_gtsam.validation.simulate import Errors
from handlaser_gtsam.validation.study import ATTEMPTS, processes, run_blocks, solve_runs

EXACT = hl.Noise(3e-5, 0.0, 0.0)
PAPER = partial(draw_scene, layout=Layout(2, 3, 11), errors=Errors(3e-5))
REDUCED = partial(hl.validation.reduce_together, noise=EXACT)
ONE, TWO = partial(ThreadPoolExecutor, 1), partial(ProcessPoolExecutor, 2)
HAS_DASK, HAS_MATPLOTLIB = find_spec("distributed") is not None, find_spec("matplotlib") is not None


def reduced(runs, seed=3, draw=PAPER):
    return Study([Case("paper", "reduction", draw, REDUCED)], runs, seed)


def rows_of(study, *arguments):
    """Return the table of a study without the name of the study."""
    return run_study(study, *arguments).drop("study")


@cache
def rows_of_one(runs):
    """Return the table of a study that one thread works on, which nobody changes."""
    return rows_of(reduced(runs), ONE)


def once_killed(rng, mark):
    """Draw from a scene, but end the process of whoever draws first after some other runs."""
    if rng.bit_generator.seed_seq.entropy[-1] == 45 and not Path(mark).exists():
        Path(mark).touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return PAPER(rng)


@pytest.mark.slow
def test_rows_do_not_depend_on_who_works():
    one = rows_of_one(60)
    assert one.equals(rows_of(reduced(60), TWO))
    assert one["run"].to_list() == list(range(60))
    assert not rows_of(reduced(20, seed=4), ONE).equals(one.head(20))


def test_rows_do_not_depend_on_the_runs_that_are_solved_together():
    (case,) = reduced(20).cases
    together = solve_runs(case, (3, 0), range(20))
    parts = [solve_runs(case, (3, 0), part) for part in ([0], range(1, 8), range(8, 20))]
    assert together.equals(pl.concat(parts))


@pytest.mark.slow
def test_a_lost_worker_loses_and_doubles_nothing(tmp_path):
    draw = partial(once_killed, mark=str(tmp_path / "killed"))
    rows = rows_of(reduced(60, draw=draw), TWO)
    assert (tmp_path / "killed").exists()
    assert rows.equals(rows_of_one(60))


@pytest.mark.slow
def test_work_that_nobody_waits_for_ends_at_once():
    """As after Ctrl-C: Python would not end before a run of ten minutes did."""
    pools = []

    def executor():
        pools.append(processes(2))
        return pools[-1]

    results = run_blocks(time.sleep, [(0.0,), (600.0,)], executor)
    next(results)
    working = list(pools[0]._processes.values())
    results.close()
    for process in working:
        process.join(timeout=20.0)
    assert not any(process.is_alive() for process in working)


def killed(_):
    os.kill(os.getpid(), signal.SIGKILL)


def test_workers_that_are_lost_again_and_again_are_given_up():
    with pytest.raises(hl.SolverError, match=f"lost {ATTEMPTS} times"):
        list(run_blocks(killed, [(0,)], partial(ProcessPoolExecutor, 1)))


def read_beside_threads(rng):
    """Draw a recorded file, which polars reads with threads of its own."""
    hl.read_recording(Path(__file__).parents[1] / "examples/gripper/recording.csv")
    return PAPER(rng)


@pytest.mark.slow
def test_a_scene_that_reads_a_file_ends_where_this_process_has_threads():
    read_beside_threads(np.random.default_rng(1))
    executor = processes(1)
    found = executor.submit(read_beside_threads, np.random.default_rng(1))
    try:
        recording, _ = found.result(timeout=60.0)
    finally:
        for process in executor._processes.values():
            process.terminate()
    assert recording.beam_names == PAPER(np.random.default_rng(1))[0].beam_names


def noted(rng, file):
    """Draw from a scene, and note the number of the run."""
    with Path(file).open("a") as lines:
        print(rng.bit_generator.seed_seq.entropy[-1], file=lines)
    return PAPER(rng)


@pytest.mark.slow
def test_what_was_interrupted_goes_on(tmp_path):
    path, notes = tmp_path / "runs.parquet", tmp_path / "notes"
    keep = partial(hl.files.write_runs, path)
    study = reduced(40, draw=partial(noted, file=str(notes)))

    def stop(told):
        if told.done >= 20:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_study(study, ONE, None, keep, stop)
    kept = hl.files.read_runs(path)
    assert kept["run"].to_list() == list(range(20))
    notes.write_text("")
    whole = run_study(study, ONE, kept, keep)
    assert set(map(int, notes.read_text().split())) == set(range(20, 40))
    assert whole.drop("study").equals(rows_of_one(60).head(40))
    assert hl.files.read_runs(path).equals(whole)
    more = run_study(replace(study, runs=60), ONE, whole)
    assert more.drop("study").equals(rows_of_one(60))
    assert run_study(study, ONE, more).equals(whole)
    with pytest.raises(hl.InputError, match="another study"):
        run_study(reduced(40, seed=4), ONE, more)


@pytest.mark.slow
def test_honest_estimates_have_a_nees_of_one():
    errors = Errors(3e-5, 5e-5, np.radians(0.03))
    draw = partial(draw_scene, scene="unplanned", layout=Layout(2, 4, 11), errors=errors)
    cases = [
        Case("robot", "told", draw, partial(hl.validation.reduce_together, noise=errors.stated())),
        Case("robot", "taken as exact", draw, REDUCED),
    ]
    runs = 100
    told, exact = hl.validation.summarize_runs(run_study(Study(cases, runs, 1), TWO)).rows(
        named=True
    )
    assert told["converged"] == exact["converged"] == 100.0
    # If sigmas were a quarter too small, the NEES would be 1.8 with a standard error of 0.1: even four
    # of these lower it fails, and so does the other treatment.
    assert told["nees"] == pytest.approx(1.0, abs=4.0 * told["standard_error"])
    assert told["coverage"] == pytest.approx(95.0, abs=2.0 * np.sqrt(200 / runs))
    assert exact["nees"] > 2.0
    assert told["location_mm"] < exact["location_mm"]


def test_both_treatments_see_the_same_recordings():
    options = hl.CalibrationOptions("none", outliers="keep")
    calibrated = partial(hl.validation.calibrate_each, noise=EXACT, options=options)
    cases = [Case("paper", "reduction", PAPER, REDUCED), Case("paper", "", PAPER, calibrated)]
    one, other = run_study(Study(cases, 3), ONE).partition_by("treatment")
    for name in ("location_squares", "direction_squares", "nees", "worst"):
        assert one[name].to_numpy() == pytest.approx(other[name].to_numpy(), rel=1e-4)


def test_recordings_of_several_shapes_are_solved_in_their_order():
    """One of four recordings has a reading less."""
    recordings = [PAPER(np.random.default_rng(seed))[0] for seed in range(4)]
    ranges = recordings[1].ranges.copy()
    ranges[5, 0] = np.nan
    recordings[1] = replace(recordings[1], ranges=ranges)
    together = hl.validation.reduce_together(recordings, EXACT)
    for one, recording in zip(together, recordings, strict=True):
        (alone,) = hl.validation.reduce_together([recording], EXACT)
        assert alone == one


@pytest.mark.slow
def test_refusals_and_warnings_are_counted():
    draw = partial(draw_scene, layout=Layout(1, 1, 4), errors=Errors(3e-5))
    case = Case("poor", "calibrate", draw, partial(hl.validation.calibrate_each, noise=EXACT))
    runs = run_study(Study([case], 4), ONE)
    assert runs["status"].is_in(["refused", "undetermined", "converged", "unobservable"]).all()
    assert hl.validation.summarize_runs(runs)["converged"][0] < 100.0
    codes = pl.Series([["a", "b", "a"], [], ["b"], ["b"]])
    warnings = hl.validation.count_warnings(runs.with_columns(codes=codes))
    assert warnings.rows() == [("poor", "calibrate", "a", 25.0), ("poor", "calibrate", "b", 75.0)]
    assert hl.validation.summarize_runs(runs.with_columns(codes=codes))["warned"][0] == 75.0


@pytest.mark.parametrize(
    ("cases", "runs", "words"),
    [
        ([], 1, "one or more"),
        ([*reduced(1).cases, *reduced(1).cases], 1, "once"),
        (reduced(1).cases, 0, "runs"),
        ([Case("x", "y", lambda _: None, REDUCED)], 1, "pickled"),
        ([Case("x", "y", partial(draw_scene, scene="none"), REDUCED)], 1, "scene 'none'"),
        (
            [Case("x", "y", np.random.Generator.random, REDUCED)],
            1,
            "x draws float; expected a Recording",
        ),
    ],
)
def test_what_is_no_study_is_refused(cases, runs, words):
    with pytest.raises(hl.InputError, match=words):
        run_study(Study(cases, runs), ONE)


def that_fails(rng):
    return 1 / (rng.random() > 1.0)


def test_a_function_that_raises_is_named_with_its_run():
    for executor in (ONE, TWO):  # from another process, too
        with pytest.raises(
            hl.InputError, match=r"found ZeroDivisionError in .*that_fails, run 0 of"
        ):
            run_study(reduced(1, draw=that_fails), executor)
    case = Case("paper", "mine", PAPER, that_fails_too)
    words = r"KeyError in .*that_fails_too, runs 0 to 1 of mine: '1' \(test_study.py, line"
    with pytest.raises(hl.InputError, match=words):
        run_study(Study([case], 2), ONE)


def that_fails_too(recordings):
    raise KeyError(recordings[0].beam_names[0])


def test_a_file_of_something_else_is_refused(tmp_path):
    path = tmp_path / "mine.parquet"
    pl.DataFrame({"a": [1]}).write_parquet(path)
    with pytest.raises(hl.InputError, match="no runs of a study"):
        hl.files.read_runs(path)
    path.write_text("text")
    with pytest.raises(hl.InputError, match="no runs of a study"):
        hl.files.read_runs(path)


STUDY = """
runs = 20
seed = 5
[scenes.small]
scene = "paper"
beams = 2
planes = 3
k1 = 0.01
k1_sigma = 0.002
pose_translation_sigma_mm = 0.0
pose_rotation_sigma_deg = 0.0
[treatments.together]
solve = "reduction"
noise = "scene"
range_error = "k1"
[treatments.exact]
solve = "reduction"
range_error = "k1k2"
noise = { range_sigma_mm = 0.03, pose_translation_sigma_mm = 0.0, pose_rotation_sigma_deg = 0.0 }
[treatments.default]
outliers = "keep"
"""


def declared(tmp_path, text):
    path = tmp_path / "study.toml"
    path.write_text(text)
    return path


def test_a_study_is_declared_in_a_file(tmp_path):
    found = hl.read_study(declared(tmp_path, STUDY))
    assert (found.runs, found.seed) == (20, 5)
    assert [case.treatment for case in found.cases] == ["together", "exact", "default"]
    scene = found.cases[0].draw.keywords
    assert scene["layout"] == Layout(2, 3, 11, 0.01)
    assert scene["range_error_sigmas"] == (0.002, 0.0)
    assert found.cases[0].solve.func is hl.validation.reduce_together
    assert found.cases[0].solve.keywords == {"noise": hl.Noise(3e-5, 0.0, 0.0), "terms": 1}
    assert found.cases[2].solve.func is hl.validation.calibrate_each
    assert found.cases[2].solve.keywords["noise"] is None
    assert found.cases[2].solve.keywords["options"].outliers == "keep"


def test_a_scene_may_be_a_function(tmp_path):
    text = """
[scenes.mine]
function = "handlaser_gtsam.validation.scenes:draw_scene"
arguments = { scene = "arm" }
[treatments.default]
"""
    (case,) = hl.read_study(declared(tmp_path, text)).cases
    recording, _ = case.draw(np.random.default_rng(1))
    assert recording == draw_scene(np.random.default_rng(1), "arm")[0]
    with pytest.raises(hl.InputError, match='noise = "scene" for the scene of a function'):
        hl.read_study(declared(tmp_path, text + 'noise = "scene"'))
    for old, new in (("validation.scenes:", ""), ("arguments = { scene", "arguments = { sceen")):
        with pytest.raises(hl.InputError, match="module:name"):
            hl.read_study(declared(tmp_path, text.replace(old, new)))


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("runs = 20", "run = 20", "unknown field run"),
        ('scene = "paper"', "", "no field scenes.small.scene"),
        ('scene = "paper"', 'scene = "mine"', "scenes.small.scene"),
        ('scene = "paper"', 'function = "a:b"', "small.beams; expected one of function, arg"),
        ("beams = ", "baems = ", "small.baems; expected one of scene, beams, planes"),
        ('range_error = "k1"\n', "", "reduction"),
        ('outliers = "keep"', 'outliers = "none"', "outliers"),
        ("beams = 2", "beams = 0", "beams"),
        (
            "[scenes.small]",
            "[scene.small]",
            "no field scenes; expected the field, which a study needs",
        ),
    ],
)
def test_a_declaration_is_checked(tmp_path, old, new, words):
    with pytest.raises(hl.InputError, match=words):
        hl.read_study(declared(tmp_path, STUDY.replace(old, new)))


@pytest.mark.slow
def test_the_command_prints_a_line_for_every_case(tmp_path, handlaser, refusal):
    path = declared(tmp_path, STUDY[: STUDY.index("[treatments.default]")])
    out, picture = tmp_path / "runs.parquet", tmp_path / "study.svg"
    arguments = ["study", str(path), "--out", str(out), "--jobs", "1", "--runs", "10"]
    if HAS_MATPLOTLIB:
        arguments += ["--picture", str(picture)]
    code, shown, err = handlaser(*arguments)
    assert (code, err) == (0, "")
    assert "together" in shown
    assert hl.files.read_runs(out).height == 20
    assert picture.exists() == HAS_MATPLOTLIB
    summary = json.loads(handlaser(*arguments, "--json")[1])["summary"]
    assert [one["runs"] for one in summary] == [10, 10]
    assert "another study" in refusal(*arguments, "--seed", "6")
    assert "no regular file" in refusal("study", path, "--out", tmp_path)


@pytest.mark.slow
def test_ctrl_c_keeps_the_runs_and_the_same_command_goes_on(tmp_path, handlaser):
    path = declared(tmp_path, STUDY[: STUDY.index("[treatments.exact]")].replace("20", "4000"))
    out = tmp_path / "runs.parquet"
    command = [sys.executable, "-m", "handlaser_gtsam.cli", "study", str(path), "--jobs", "2"]
    begun = subprocess.Popen(
        [*command, "--out", str(out)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    deadline = time.monotonic() + 60.0
    while not out.exists() and time.monotonic() < deadline:
        time.sleep(0.1)
    os.killpg(begun.pid, signal.SIGINT)  # as a terminal does: to the workers, too
    _, stderr = begun.communicate(timeout=60)
    assert begun.returncode == 130, stderr
    assert stderr.splitlines()[-1] == "handlaser: stopped by Ctrl-C"
    kept = hl.files.read_runs(out)
    assert 0 < kept.height < 4000
    again = handlaser(*command[3:], "--out", out, "--runs", kept.height, "--json")[1]
    assert json.loads(again)["summary"][0]["runs"] == kept.height


@pytest.mark.slow
@pytest.mark.skipif(not HAS_DASK, reason="needs dask.distributed")
def test_a_dask_cluster_gives_the_same_rows_though_a_worker_dies(tmp_path):
    from distributed import Client, LocalCluster

    mark = str(tmp_path / "killed")
    told = []
    with (
        LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster,
        Client(cluster) as client,
    ):
        study = reduced(60, draw=partial(once_killed, mark=mark))
        rows = rows_of(study, client.get_executor, None, None, told.append)
    assert Path(mark).exists()
    assert [told[-1].done, told[-1].total] == [60, 60]
    assert rows.equals(rows_of_one(60))


@pytest.mark.skipif(not HAS_DASK, reason="needs dask.distributed")
def test_no_scheduler_is_said_in_one_line(tmp_path, refusal, monkeypatch):
    monkeypatch.setattr("handlaser_gtsam.validation.study.CONNECTS_WITHIN", 0.5)
    path = declared(tmp_path, STUDY)
    assert "no scheduler" in refusal("study", path, "--scheduler", "tcp://127.0.0.1:1")


# --- the studies of benchmarks ------------------------------------------------------------------------


def marked(folder, seed):
    """Draw a number, and leave a mark that it was drawn."""
    with (Path(folder) / str(seed)).open("a") as mark:
        mark.write("x")
    return seed, float(np.random.default_rng(seed).standard_normal())


def stopped_at(folder, seed):
    if seed == 7 and not (Path(folder) / "stopped").exists():
        (Path(folder) / "stopped").touch()
        raise ValueError("stopped")
    return marked(folder, seed)


def test_a_study_of_benchmarks_goes_on_from_kept_runs(tmp_path):
    rows, marks = tmp_path / "rows", tmp_path / "marks"
    marks.mkdir()
    run = partial(stopped_at, str(marks))
    with Studies(1, rows=rows) as studies, pytest.raises(ValueError, match="stopped"):
        studies.each("numbers", run, range(12))
    with Studies(2, rows=rows) as studies:
        first = studies.each("numbers", run, range(12))
        assert [seed for seed, _ in first] == list(range(12))
        assert studies.each("numbers", run, range(12)) == first
        assert studies.each("others", run, range(13))[:12] == first  # another study
    drawn = [len((marks / str(seed)).read_text()) for seed in range(13)]
    # Workers may be at work on others when one is stopped: what nobody received is drawn again.
    assert drawn[:7] == [2] * 7
    assert all(2 <= count <= 3 for count in drawn[7:12])
    assert drawn[12] == 1
