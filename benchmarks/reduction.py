"""What the reduction saves, and how many steps the paper's simulation takes.

    python -m benchmarks.reduction [--runs 1000] [--planes 4 13 100] [--repeat 15]

Steps: designed stations of the paper's scene, from the closed form as it is, planes eliminated. Times:
11 stations x 4 beams a plane, k1 and k2, the same start and the same steps; with all unknowns in one
normal matrix, dense, and with the planes eliminated before the beams. CPU time, medians, in turn.
"""

import argparse
import statistics
import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks.solve import SIGMA, TERMS, closed_form, problem
from benchmarks.studies import Studies, add_options
from handlaser_gtsam.data.parameters import Parameters
from handlaser_gtsam.data.readings import Readings
from handlaser_gtsam.model.families import count_unknowns
from handlaser_gtsam.solvers.beam_problem import jacobian_columns, linearized, moved, solve_together
from handlaser_gtsam.validation.scenes import ERRORS, SCENES, Layout
from handlaser_gtsam.validation.simulate import simulate

SAME_COST = 1e-9


@dataclass(frozen=True, slots=True)
class Times:
    """CPU seconds with and without the reduction, and the steps that both took."""

    planes: int
    reduced: float
    dense: float
    steps: int


def steps_once(seed: int) -> int:
    """Return how many steps a run of the paper's simulation takes from the closed form."""
    rng = np.random.default_rng(seed)
    truth, stations = SCENES["paper"](Layout(), rng)
    readings = simulate(truth, stations, ERRORS["paper"], rng).readings()
    found = solve_together([readings], [closed_form(readings)], 0, SIGMA)
    return int(found.iterations[0]) if found.converged[0] else -1


def dense_solution(readings: Readings, start: Parameters, steps: int) -> float:
    """Take steps with all unknowns in one normal matrix; return half the sum of squares at the end."""
    at, width = start, 5 + TERMS
    of_beams, rows = width * readings.beams, np.arange(len(readings))[:, None]
    beam = width * readings.beam[:, None] + np.arange(width)
    plane = of_beams + 3 * readings.plane[:, None] + np.arange(3)
    J = np.zeros((len(readings), count_unknowns(readings, TERMS)))
    for _ in range(steps):
        _, centres = linearized(at, readings, TERMS)
        columns = jacobian_columns(at, readings, TERMS, centres)
        J[rows, beam], J[rows, plane] = columns[:width].T, columns[width:-1].T
        step = -np.linalg.solve(J.T @ J, J.T @ columns[-1])
        own = step[:of_beams].reshape(-1, width), step[of_beams:].reshape(-1, 3)
        at = moved(at, *own, centres)
    e = jacobian_columns(at, readings, TERMS)[-1]
    return 0.5 * float(e @ e) / SIGMA**2


def times(planes: int, repeat: int) -> Times:
    """Return the times of both ways to one solution."""
    readings = problem(planes).readings()
    start = closed_form(readings)
    found = solve_together([readings], [start], TERMS, SIGMA)
    steps, cost = int(found.iterations[0]), float(found.cost[0])
    seconds: tuple[list[float], list[float]] = ([], [])
    for _ in range(repeat):
        begin = time.process_time()
        solve_together([readings], [start], TERMS, SIGMA)
        middle = time.process_time()
        other = dense_solution(readings, start, steps)
        seconds[0].append(middle - begin)
        seconds[1].append(time.process_time() - middle)
        if abs(other - cost) > SAME_COST * cost:
            raise SystemExit(f"{planes} planes: costs {cost!r} and {other!r}")
    return Times(planes, statistics.median(seconds[0]), statistics.median(seconds[1]), steps)


def steps_line(steps: Sequence[int]) -> str:
    """Return how many steps the runs took."""
    done = [one for one in steps if one >= 0]
    within = 100.0 * sum(one <= 10 for one in done) / len(steps)
    return (
        f"steps from the closed form: median {statistics.median(done):.0f}, most {max(done)}, at most "
        f"10 in {within:.1f} % of {len(steps)} runs"
    )


def main() -> None:
    """Print a line of steps, and a line of times for every number of planes."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=1000)
    parser.add_argument("--planes", type=int, nargs="+", default=[4, 13, 100])
    parser.add_argument("--repeat", type=int, default=15)
    add_options(parser)
    arguments = parser.parse_args()
    with Studies.of(arguments) as studies:
        studies.show(steps_line(studies.each("steps", steps_once, range(arguments.runs))))
    for planes in arguments.planes:
        one = times(planes, arguments.repeat)
        print(
            f"{planes} planes: {1e3 * one.reduced:.2f} ms with the reduction, {1e3 * one.dense:.2f} "
            f"without, {one.dense / one.reduced:.1f} times; {one.steps} steps"
        )


if __name__ == "__main__":
    main()
