"""Compare this package's solver, the SciPy reference and GTSAM's own optimizer in one run.

    python -m benchmarks.solve
    python -m benchmarks.solve --planes 13 100 --out rows.json

Every solver gets the same recordings (11 stations x 4 beams a plane, k1 and k2), the same closed-form
start, and must reach the same optimum. Times are medians and include building the problem:

graph      levenberg_marquardt of this package on its factor graph
sums       the reduction, of which GTSAM eliminates the sums at every step
reduction  the same minimum in NumPy, planes eliminated, without a graph
reference  scipy.optimize.least_squares, derivatives by differences (sparse above 200 unknowns)
gtsam-lm   gtsam.LevenbergMarquardtOptimizer on the same graph

ceres      a program in C++ that solves the same problem with Ceres, where the environment variable
           HANDLASER_CERES_PEER names it; it is called with a text file and a number of repetitions
           and prints a row of JSON (seconds, cost, iterations)

`over Ceres`: in CPU time, which other processes change less; of the reduction 8 problems at once, too.
`together`: 1000 problems of 4 planes at once by the reduction, over the time of one after the other.
`start to covariances` is find_start, graph and marginals together; `calibrate` is everything, with the
noise given as it was simulated. Its CPU time over that of `graph` is printed below the table.
"""

import argparse
import json
import os
import resource
import statistics
import subprocess
import tempfile
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any
from unittest import mock

import gtsam
import numpy as np
from rich.console import Console
from rich.table import Table

from handlaser_gtsam.arrays import FloatArray
from handlaser_gtsam.data.noise import Noise
from handlaser_gtsam.data.parameters import Parameters
from handlaser_gtsam.data.recording import Readings, Recording
from handlaser_gtsam.estimation.joint_solution import SolutionTask
from handlaser_gtsam.estimation.solution import Solution, covariance
from handlaser_gtsam.model import damped_search
from handlaser_gtsam.model.reduction import Normal
from handlaser_gtsam.model.weighting import Variances
from handlaser_gtsam.pipeline import calibrate
from handlaser_gtsam.solvers.beam_problem import solve_together
from handlaser_gtsam.solvers.graph import build_graph
from handlaser_gtsam.solvers.graph_levenberg import levenberg_marquardt
from handlaser_gtsam.solvers.gtsam_sums import eliminated_sums
from handlaser_gtsam.solvers.reference.problem import Residuals, minimize
from handlaser_gtsam.starts import find_start
from handlaser_gtsam.starts.translations import translation_start
from handlaser_gtsam.validation.cross_check import recording_problem
from handlaser_gtsam.validation.scenes import Layout, paper
from handlaser_gtsam.validation.simulate import Errors, simulate

TERMS = 2
SIGMA = 3e-5
SAME_COST = 1e-6
TURNS = 3
ABREAST = 8
"""Problems that the reduction solves at once beside one alone."""
WHOLE = "start to covariances"
PEER = "HANDLASER_CERES_PEER"
EXACT = Noise(SIGMA, pose_translation_sigma=0.0, pose_rotation_sigma=0.0)


@dataclass(frozen=True, slots=True)
class Row:
    """One solver on one problem; cost is half the weighted sum of squares."""

    solver: str
    planes: int
    seconds: float
    cost: float
    iterations: int


def problem(planes: int, seed: int = 1) -> Recording:
    """Return the recording that every solver gets."""
    rng = np.random.default_rng(seed)
    truth, stations = paper(Layout(4, planes, 11, k1=0.01, k2=0.4), rng)
    return simulate(truth, stations, Errors(SIGMA), rng)


def closed_form(readings: Readings) -> Parameters:
    """Return the paper's start as it is, without range errors and without any refinement."""
    start = translation_start(readings)
    if start is None:
        raise SystemExit("the benchmark's recording has no pure translations")
    return start


def solve_graph(readings: Readings, start: Parameters) -> tuple[float, int]:
    """Solve with this package; return cost and iterations."""
    result = levenberg_marquardt(build_graph(readings, start, TERMS, SIGMA))
    return result.cost, result.iterations


def solve_reduction(readings: Readings, start: Parameters) -> tuple[float, int]:
    """Solve by the reduction alone; return cost and iterations."""
    found = solve_together([readings], [start], TERMS, SIGMA)
    return float(found.cost[0]), int(found.iterations[0])


def step_by_gtsam(normal: Normal, damping: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the step of the only problem, whose sums GTSAM eliminates."""
    if damping.any():
        raise SystemExit("the benchmark's problems need no damping")
    sums = eliminated_sums(normal, SIGMA)
    return sums.step[None], sums.local_step[None]


def solve_sums(readings: Readings, start: Parameters) -> tuple[float, int]:
    """Solve by the reduction with the steps of GTSAM; return cost and iterations."""
    with mock.patch.object(damped_search, "damped_step", step_by_gtsam):
        return solve_reduction(readings, start)


def together_ratio(count: int) -> float:
    """Return the CPU time of many problems of 4 planes at once over that of one after the other."""
    readings = problem(4).readings()
    readings = readings.seen_from(readings.plane_means(readings.world_t_hand))
    start, rng = closed_form(readings), np.random.default_rng(0)
    noise = SIGMA * rng.standard_normal((count, len(readings)))
    many = [replace(readings, distance=readings.distance + one) for one in noise]
    seconds = []
    for problems in ([many], [[one] for one in many]):
        begin = time.process_time()
        for some in problems:
            solve_together(some, [start] * len(some), TERMS, SIGMA)
        seconds.append(time.process_time() - begin)
    return seconds[0] / seconds[1]


def solve_start_to_covariances(readings: Readings) -> tuple[float, int]:
    """Go the whole way with this package; return cost and iterations."""
    graph = build_graph(readings, find_start(readings, SIGMA).parameters, TERMS, SIGMA)
    result = levenberg_marquardt(graph)
    covariance(graph, result.values).all_planes()
    return result.cost, result.iterations


def solve_reference(recording: Recording, start: Parameters) -> tuple[float, int]:
    """Solve with SciPy; return cost and iterations."""
    beams = len(recording.beam_names)
    variances = Variances(np.full(beams, SIGMA))
    residuals = Residuals(recording_problem(recording, start, (TERMS,) * beams, variances))
    solution = minimize(residuals, residuals.unknowns.x0, "2-point")
    return float(solution.cost), int(solution.njev)


def solve_gtsam(readings: Readings, start: Parameters) -> tuple[float, int]:
    """Solve with GTSAM's own Levenberg-Marquardt; return cost and iterations."""
    graph = build_graph(readings, start, TERMS, SIGMA)
    settings = gtsam.LevenbergMarquardtParams()
    settings.setDiagonalDamping(True)
    settings.setlambdaInitial(1e-9)
    settings.setlambdaUpperBound(1e20)
    settings.setRelativeErrorTol(1e-12)
    settings.setAbsoluteErrorTol(1e-12)
    settings.setOrdering(graph.ordering)
    optimizer = gtsam.LevenbergMarquardtOptimizer(graph.graph, graph.values, settings)
    optimizer.optimize()
    return optimizer.error(), optimizer.iterations()


def solve_ceres(readings: Readings, start: Parameters, repeat: int) -> Row | None:
    """Solve with Ceres in another program, which measures its own time; None where there is none."""
    if not os.environ.get(PEER):
        return None
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "problem.txt")
        path.write_text(problem_text(readings, start))
        found, _ = run_ceres(path, repeat)
    return Row("ceres", readings.planes, found["seconds"], found["cost"], found["iterations"])


def run_ceres(path: Path, repeat: int) -> tuple[dict[str, Any], float]:
    """Run the program on a problem; return what it prints, and the CPU time of all it did [s]."""
    one = {**os.environ, "OMP_NUM_THREADS": "1"}
    command = [os.environ[PEER], str(path), str(repeat)]
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    run = subprocess.run(command, capture_output=True, text=True, check=True, env=one)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    seconds = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return json.loads(run.stdout), seconds


def ceres_ratios(planes: int, together: int, repeat: int) -> dict[str, float]:
    """Return the CPU time of solvers over that of Ceres; of the reduction also for many at once.

    All take turns. Of three shares of runs the first does not count: of Ceres it is taken off as the
    time of a run of its own, with what the program reads.
    """
    readings = problem(planes).readings()
    start = closed_form(readings)
    many = [readings] * together, [start] * together
    runs: dict[str, tuple[Callable[[], object], int]] = {
        "graph": (lambda: solve_graph(readings, start), 1),
        "sums": (lambda: solve_sums(readings, start), 1),
        "reduction": (lambda: solve_reduction(readings, start), 1),
        f"reduction of {together} at once": (
            lambda: solve_together(*many, TERMS, SIGMA),
            together,
        ),
    }
    seconds: dict[str, list[float]] = {name: [] for name in runs}
    peer: list[float] = []
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "problem.txt")
        path.write_text(problem_text(readings, start))
        for _ in range(TURNS + 2):
            for name, (run, count) in runs.items():
                ends = []
                for number in range(3 * repeat):
                    run()
                    if number + 1 in (repeat, 3 * repeat):
                        ends.append(time.process_time())
                seconds[name].append((ends[1] - ends[0]) / (2 * repeat * count))
            short, long = run_ceres(path, repeat)[1], run_ceres(path, 3 * repeat)[1]
            peer.append((long - short) / (2 * repeat))
    median = statistics.median(peer)
    return {name: statistics.median(each) / median for name, each in seconds.items()}


def problem_text(readings: Readings, start: Parameters) -> str:
    """Return sizes and sigma, then beams, planes, and readings with their poses, a row each."""
    rows = [[readings.planes, readings.beams, len(readings), SIGMA]]
    rows += np.hstack((start.locations, start.directions, start.range_errors)).tolist()
    rows += np.column_stack((start.normals, start.offsets)).tolist()
    R, t = readings.world_R_hand.reshape(-1, 9), readings.world_t_hand
    index = zip(readings.plane.tolist(), readings.beam.tolist(), strict=True)
    numbers = np.column_stack((readings.distance, R, t)).tolist()
    rows += [[*pair, *row] for pair, row in zip(index, numbers, strict=True)]
    return "\n".join(" ".join(repr(x) for x in row) for row in rows) + "\n"


def calibrate_ratio(planes: int) -> float:
    """Return the CPU time of `calibrate` over that of building and solving the graph alone."""
    recording = problem(planes)
    readings = recording.readings()
    start = closed_form(readings)
    seconds = []
    for run in (lambda: solve_graph(readings, start), lambda: calibrate(recording, EXACT)):
        each = []
        for _ in range(TURNS):
            begin = time.process_time()
            run()
            each.append(time.process_time() - begin)
        seconds.append(statistics.median(each))
    return seconds[1] / seconds[0]


def gtsam_share(planes: int, noise: Noise | None) -> float:
    """Return which part of the CPU time of `calibrate` GTSAM's last word takes, its graph included."""
    recording, last = problem(planes), SolutionTask.last_word
    spent = 0.0

    def timed(task: SolutionTask, solution: Solution) -> Solution:
        nonlocal spent
        begin = time.process_time()
        try:
            return last(task, solution)
        finally:
            spent += time.process_time() - begin

    calibrate(recording, noise)
    with mock.patch.object(SolutionTask, "last_word", timed):
        begin = time.process_time()
        calibrate(recording, noise)
        return spent / (time.process_time() - begin)


def measure(planes: int, repeat: int) -> tuple[list[Row], float]:
    """Return a row a solver, and the median seconds of start to covariances.

    Solvers take turns of several runs each, so that a machine that slows down slows all of them and
    none pays for what another left in the cache.
    """
    recording = problem(planes)
    readings = recording.readings()
    start = closed_form(readings)
    slow = max(1, repeat // 5) if planes >= 100 else repeat
    runs: list[tuple[str, Callable[[], tuple[float, int]], int]] = [
        ("graph", lambda: solve_graph(readings, start), repeat),
        ("sums", lambda: solve_sums(readings, start), repeat),
        ("reduction", lambda: solve_reduction(readings, start), repeat),
        ("reference", lambda: solve_reference(recording, start), slow),
        ("gtsam-lm", lambda: solve_gtsam(readings, start), slow),
        (WHOLE, lambda: solve_start_to_covariances(readings), repeat),
    ]
    seconds: dict[str, list[float]] = {name: [] for name, _, _ in runs}
    answers: dict[str, tuple[float, int]] = {}
    for turn in range(TURNS):
        for name, run, times in runs:
            for _ in range(len(range(turn, times, TURNS))):
                begin = time.perf_counter()
                answers[name] = run()
                seconds[name].append(time.perf_counter() - begin)
    medians = {name: statistics.median(each) for name, each in seconds.items()}
    rows = [Row(name, planes, medians[name], *answers[name]) for name, _, _ in runs[:-1]]
    peer = solve_ceres(readings, start, repeat)
    rows += [] if peer is None else [peer]
    return rows, medians[WHOLE]


def table_of(rows: list[Row], whole: dict[int, float]) -> Table:
    """Return medians and ratios as a table."""
    table = Table("planes", "solver", "median ms", "ratio to graph", "iterations", "cost")
    for planes, seconds in whole.items():
        found = [row for row in rows if row.planes == planes]
        base = found[0]
        for row in found:
            same = abs(row.cost - base.cost) <= SAME_COST * base.cost
            cost = f"{row.cost:.6f}" + ("" if same else " NOT THE SAME OPTIMUM")
            ratio = f"{row.seconds / base.seconds:.2f}"
            milliseconds = f"{row.seconds * 1e3:.2f}"
            table.add_row(str(planes), row.solver, milliseconds, ratio, str(row.iterations), cost)
        ratio = f"{seconds / base.seconds:.2f}"
        table.add_row(str(planes), WHOLE, f"{seconds * 1e3:.2f}", ratio, "", "")
        table.add_section()
    return table


def main() -> None:
    """Run the benchmark from the command line."""
    parser = argparse.ArgumentParser(description="Compare solvers in one run.")
    parser.add_argument("--planes", type=int, nargs="+", default=[4, 13, 100, 1000])
    parser.add_argument("--repeat", type=int, default=15, help="runs of each; slow ones a fifth")
    parser.add_argument("--together", type=int, default=1000, help="problems solved together")
    parser.add_argument("--out", type=Path, help="write rows as JSON")
    arguments = parser.parse_args()
    rows: list[Row] = []
    whole: dict[int, float] = {}
    for planes in arguments.planes:
        found, whole[planes] = measure(planes, arguments.repeat)
        rows += found
    Console(width=110).print(table_of(rows, whole))
    for row in rows:
        if row.solver == "reference":
            ratio = row.seconds / whole[row.planes]
            print(f"{row.planes} planes: reference / start to covariances = {ratio:.1f}")
    for planes in arguments.planes:
        print(f"{planes} planes: calibrate / graph = {calibrate_ratio(planes):.1f} (CPU time)")
    for planes in arguments.planes:
        shares = gtsam_share(planes, EXACT), gtsam_share(planes, None)
        print(
            f"{planes} planes: GTSAM's part of calibrate = {shares[0]:.1%} with the noise given, "
            f"{shares[1]:.1%} with nothing given (CPU time)"
        )
    for planes in arguments.planes if os.environ.get(PEER) else ():
        few = arguments.repeat if planes < 100 else max(1, arguments.repeat // 5)
        ratios = ceres_ratios(planes, ABREAST, few)
        words = ", ".join(f"{name} {ratio:.2f}" for name, ratio in ratios.items())
        print(f"{planes} planes: over Ceres, a problem: {words} (CPU time)")
    ratio = together_ratio(arguments.together)
    print(f"{arguments.together} problems together / one by one = {ratio:.2f} (CPU time)")
    if arguments.out is not None:
        arguments.out.write_text(json.dumps([asdict(row) for row in rows], indent=2) + "\n")


if __name__ == "__main__":
    main()
