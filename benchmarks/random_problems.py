"""Does every recording get the right start, or a clear refusal? Thousands of random problems.

    python -m benchmarks.random_problems
    python -m benchmarks.random_problems --solvable 200 --unsolvable 50 --jobs 1

Solvable problems (`benchmarks.problems`) must end at the global optimum: the cost that the solver
reaches from the truth, or a lower one. Unsolvable ones (`benchmarks.unsolvable`) must not be reported
as converged, and what is named undetermined must span what a dense Jacobian says is open. The seed of
each problem is its number, so that every failure can be repeated.
"""

import argparse
import collections
import sys
import time
from dataclasses import dataclass

import numpy as np

import handlaser_gtsam as hl
from benchmarks.studies import Studies, add_options
from handlaser_gtsam import model
from handlaser_gtsam.arrays import FloatArray
from handlaser_gtsam.data.parameters import Parameters
from handlaser_gtsam.estimation.joint_solution import settle
from handlaser_gtsam.estimation.options import RangeError
from handlaser_gtsam.results.calibration import Calibration

from .problems import Problem, solvable
from .unsolvable import true_null_space, unsolvable

SAME_CHI2 = 1e-3
"""Costs that close belong to one optimum: a hundredth of a standard deviation."""
NOT_NAMED = 0.05
"""Largest part of a true null vector that may lie outside what is named."""
TERMS: dict[int, RangeError] = {0: "none", 1: "k1", 2: "k1k2"}


@dataclass(frozen=True, slots=True)
class Verdict:
    """What became of one problem; `good` if it is as it should be."""

    seed: int
    kind: str
    outcome: str
    good: bool
    seconds: float


def judge_solvable(seed: int) -> Verdict:
    """Calibrate a solvable problem and compare with the optimum found from the truth."""
    problem = solvable(np.random.default_rng(seed))
    noise, options = _given(problem)
    begin = time.perf_counter()
    found = hl.calibrate(problem.recording, noise, options)
    seconds = time.perf_counter() - begin
    readings = problem.recording.readings()
    origins = readings.plane_means(readings.world_t_hand)
    truth = problem.true_parameters().seen_from(origins)
    best = settle(readings.seen_from(origins), truth, noise, options).finished().chi2
    far = any(warning.code == "far-beam" for warning in found.warnings)
    if found.status != "converged" and far and found.fit.chi2 <= best + SAME_CHI2:
        outcome = "global optimum, with a beam farther off than a hand reaches: refused"
        return Verdict(seed, problem.kind, outcome, True, seconds)
    if found.status != "converged":
        return Verdict(seed, problem.kind, f"refused as {found.status}", False, seconds)
    if found.fit.chi2 > best + SAME_CHI2:
        return Verdict(seed, problem.kind, "another optimum", False, seconds)
    lower = found.fit.chi2 < best - SAME_CHI2
    outcome = "lower than from the truth" if lower else "global optimum"
    return Verdict(seed, problem.kind, outcome, True, seconds)


def judge_unsolvable(seed: int) -> Verdict:
    """Calibrate an unsolvable problem and compare what is named with what is open."""
    problem = unsolvable(np.random.default_rng(seed))
    begin = time.perf_counter()
    found = hl.calibrate(problem.recording, *_given(problem))
    seconds = time.perf_counter() - begin
    if found.status == "converged":
        return Verdict(seed, problem.kind, "converged", False, seconds)
    open_ = _dimension(problem)
    named = found.observability.unknowns - found.observability.rank
    if named < open_:
        return Verdict(seed, problem.kind, "fewer directions named than open", False, seconds)
    if _not_named(problem, found, open_) > NOT_NAMED:
        return Verdict(seed, problem.kind, "an open direction not named", False, seconds)
    outcome = "all named" if named == open_ else "all named, and weak ones"
    return Verdict(seed, problem.kind, outcome, True, seconds)


def _given(problem: Problem) -> tuple[hl.Noise, hl.CalibrationOptions]:
    """Return the noise of a problem and the options with which it is solved."""
    options = hl.CalibrationOptions(TERMS[problem.terms], outliers="keep")
    return hl.Noise(problem.range_sigma, 0.0, 0.0), options


def _dimension(problem: Problem) -> int:
    """Return the dimension of the true null space."""
    readings = problem.recording.readings()
    origins = readings.plane_means(readings.world_t_hand)
    truth, length = problem.true_parameters(), float(np.median(readings.distance))
    null = true_null_space(truth.seen_from(origins), readings.seen_from(origins), length)
    return int(null.shape[1])


def _not_named(problem: Problem, found: Calibration, dimension: int) -> float:
    """Return the largest part of the `dimension` open directions at the solution outside the names."""
    readings = problem.recording.readings()
    origins = readings.plane_means(readings.world_t_hand)
    beams, planes = list(found.beams.values()), list(found.planes.values())
    at = Parameters(
        np.array([beam.location for beam in beams]),
        np.array([beam.direction for beam in beams]),
        np.zeros((len(beams), 2)),
        np.array([plane.normal for plane in planes]),
        np.array([plane.offset for plane in planes]),
    )
    length = float(np.median(readings.distance))
    null = true_null_space(at.seen_from(origins), readings.seen_from(origins), length, dimension)
    open_parts = found.observability.open_parts
    named = {(part.kind, part.name, part.quantity): part.axes for part in open_parts}
    worst = 0.0
    v_basis, n_basis = model.tangent_basis(at.directions), model.tangent_basis(at.normals)
    for i, beam in enumerate(beams):
        rows = null[5 * i : 5 * i + 5]
        worst = max(worst, _outside(rows[:3], named.get(("beam", beam.name, "location"))))
        turned = v_basis[i] @ rows[3:]
        worst = max(worst, _outside(turned, named.get(("beam", beam.name, "direction"))))
    for p, plane in enumerate(planes):
        rows = null[5 * len(beams) + 3 * p :][:3]
        turned = n_basis[p] @ rows[:2]
        worst = max(worst, _outside(turned, named.get(("plane", plane.name, "normal"))))
        worst = max(worst, _outside(rows[2:], named.get(("plane", plane.name, "offset"))))
    return worst


def _outside(rows: FloatArray, axes: FloatArray | None) -> float:
    """Return the largest part of the columns' span of `rows` outside the named axes."""
    rest = rows if axes is None else rows - axes @ (axes.T @ rows)
    return float(np.linalg.norm(rest, 2)) if rest.size else 0.0


def main() -> int:
    """Run both studies; exit with 1 if a problem went wrong."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("--solvable", type=int, default=10_000)
    parser.add_argument("--unsolvable", type=int, default=2_000)
    parser.add_argument("--first-seed", type=int, default=0)
    add_options(parser, jobs=2)
    arguments = parser.parse_args()
    wrong = 0
    with Studies.of(arguments) as studies:
        for title, judge, count in (
            ("solvable", judge_solvable, arguments.solvable),
            ("unsolvable", judge_unsolvable, arguments.unsolvable),
        ):
            seeds = range(arguments.first_seed, arguments.first_seed + count)
            wrong += _report(studies, title, studies.each(title, judge, seeds))
    return 1 if wrong else 0


def _report(studies: Studies, title: str, verdicts: list[Verdict]) -> int:
    bad = [verdict for verdict in verdicts if not verdict.good]
    studies.show(f"{title}: {len(verdicts)} problems, {len(bad)} wrong")
    outcomes = collections.Counter(verdict.outcome for verdict in verdicts)
    for outcome, count in outcomes.most_common():
        studies.show(f"  {count:6d}  {outcome}")
    seconds = np.array([verdict.seconds for verdict in verdicts])
    if seconds.size:
        tail = np.quantile(seconds, [0.5, 0.99, 1.0])
        studies.show(
            f"  seconds a calibration: median {tail[0]:.3f}, 99 % {tail[1]:.2f}, most {tail[2]:.2f}"
        )
    for verdict in bad[:20]:
        studies.show(f"  seed {verdict.seed} ({verdict.kind}): {verdict.outcome}")
    return len(bad)


if __name__ == "__main__":
    sys.exit(main())
