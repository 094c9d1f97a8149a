"""Whether planned stations are worth planning: Monte Carlo over the paper's cell.

    python -m benchmarks.planning [--runs 1000] [--jobs 2] [--studies paper blind loop speed]

`paper`: a first motion of 13 stations before plane A, from bounds alone; 4 planned stations; a second
plan of the rest, 28 or 44 in all, both after the same beginning. Random stations of the same number,
from the same candidates, beside them. `NEES` is that of all beams over their unknowns; `found/stated`:
the largest standard deviation of a direction that follows over the one that was predicted, median and
10 % to 90 %; `outside`: planned stations with a reading outside the sensor's range or incidence.

`blind`: mounts drawn from the stated bounds, and the first motion for these: how many are calibrated,
and at how many all readings are within the range.

`loop`: a robot that errs less, its first motion, and then plan, measure, update in turns of 4 stations
until 95 % intervals of all coordinates are within 0.1 mm and 0.1 deg; random stations beside it.

`speed`: greedy choice of 44 stations from 1,200 candidates, 4 beams and 4 planes, at the estimate and
at 4 draws of the posterior; CPU time, best of five.

What misses a limit is named at the end of a line.
"""

import argparse
import math
import time
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache

import numpy as np

import handlaser_gtsam as hl
from benchmarks.defaults import nees, rms
from benchmarks.planned_cell import SENSOR, Cell, cell, errors_of
from benchmarks.planned_loop import Loop, loop, random_plan
from benchmarks.studies import Studies, add_options
from handlaser_gtsam.planning.belief import belief_of, station_rows
from handlaser_gtsam.planning.choice import choose
from handlaser_gtsam.planning.goal import goal_rows
from handlaser_gtsam.planning.plan import Task
from handlaser_gtsam.planning.workspace import joined
from handlaser_gtsam.validation.scenes import SCENES, Layout
from handlaser_gtsam.validation.simulate import simulate

FIRST, SECOND = 13, 4
"""Stations of the first motion, and of the first plan."""
TOTALS = {28: (0.12e-3, math.radians(0.17)), 44: (0.10e-3, math.radians(0.14))}
"""Stations in all, and the largest rms errors of r [m] and v [rad]."""
OPTIONS = hl.CalibrationOptions("none", sensor=SENSOR)
WAYS = ("planned", "random")
STUDIES = ("paper", "blind", "loop", "speed")


@dataclass(frozen=True, slots=True)
class Judged:
    """One calibration against the truth.

    Attributes
    ----------
    nees : float
        An unknown.
    location, direction : float
        Mean squared error of r [m^2] and v [rad^2].
    agreement : float
        Largest standard deviation of a direction, found over predicted.
    outside : int
        Stations with a reading that the sensor cannot give.
    """

    nees: float
    location: float
    direction: float
    agreement: float
    outside: int


def run_once(seed: int) -> dict[tuple[int, str], Judged | None]:
    """Plan, measure and calibrate one cell, for all totals, with planned and with random stations.

    All have the first motion in common, and both totals of a way the few stations after it.
    """
    rng = np.random.default_rng(seed)
    here = cell(rng)
    motion = hl.planning.blind_motion(here.bounds, SENSOR, here.workspace, here.noise, FIRST)
    recording = here.measured(motion, rng)
    first = hl.calibrate(recording, here.noise, OPTIONS)
    found: dict[tuple[int, str], Judged | None] = dict.fromkeys(
        (total, way) for total in TOTALS for way in WAYS
    )
    for number, way in enumerate(WAYS):
        rng = np.random.default_rng((seed, number))
        second = _measured(here, recording, first, SECOND, way, rng)
        if second is None:
            continue
        for total in TOTALS:
            rng = np.random.default_rng((seed, number, total))
            last = _measured(here, *second[:2], total - FIRST - SECOND, way, rng)
            if last is not None:
                found[total, way] = _judged(here, last[1], last[2], second[3] + last[3])
    return found


def _measured(
    here: Cell,
    recording: hl.Recording,
    so_far: hl.Calibration,
    count: int,
    way: str,
    rng: np.random.Generator,
) -> tuple[hl.Recording, hl.Calibration, hl.planning.Plan, int] | None:
    """Return recording and calibration with so many stations more, their plan, and those outside.

    None where the calibration so far has not converged.
    """
    if so_far.status != "converged":
        return None
    missing = here.unread(recording)
    if way == "planned":
        plan = hl.plan(so_far, count, SENSOR, here.workspace, plates=missing)
    else:
        plan = random_plan(so_far, count, here.workspace, missing, rng)
    read = here.measured(plan, rng, first=len(recording.station_names))
    recording = hl.join([recording, read])
    outside = int(np.isnan(read.ranges).any(axis=1).sum())
    return recording, hl.calibrate(recording, here.noise, OPTIONS), plan, outside


def _judged(
    here: Cell, result: hl.Calibration, plan: hl.planning.Plan, outside: int
) -> Judged | None:
    """Compare a calibration with the truth and its plan; None where it has no covariance."""
    if result.covariance is None:
        return None
    location, direction = errors_of(result, here.truth)
    largest = max(beam.direction_sigma or 0.0 for beam in result.beams.values())
    return Judged(
        nees(result.covariance.beams, _tangent(result, here.truth)),
        float(location.mean()),
        float(direction.mean()),
        largest / float(plan.forecast.direction_sigma[-1]),
        outside,
    )


def _tangent(result: hl.Calibration, truth: hl.Parameters) -> np.ndarray:
    """Return the errors of all beams in the coordinates of their covariance."""
    joint, at = result.covariance, result.parameters()
    assert joint is not None
    found = np.hstack((at.locations, at.directions, at.range_errors))
    true = np.hstack((truth.locations, truth.directions, truth.range_errors))
    parts = [lift.T @ row for lift, row in zip(joint.beam_lifts(), found - true, strict=True)]
    return np.concatenate(parts)


def paper_line(total: int, way: str, runs: list[Judged | None]) -> str:
    """Return the numbers of one way to choose stations, and the limits that it misses."""
    done = [one for one in runs if one is not None]
    if not done:
        return f"{total} {way:8}: no result in {len(runs)} cells"
    each = np.array([one.nees for one in done])
    r, v = rms([one.location for one in done]), rms([one.direction for one in done])
    ratio = np.quantile([one.agreement for one in done], [0.1, 0.5, 0.9])
    outside = sum(one.outside > 0 for one in done)
    text = (
        f"{total} {way:8}: rms r {1e3 * r:.3f} mm, v {math.degrees(v):.3f} deg, NEES {each.mean():.3f} "
        f"+- {each.std() / math.sqrt(len(each)):.3f}, fail {len(runs) - len(done)}, found/stated "
        f"{ratio[1]:.3f} ({ratio[0]:.2f} to {ratio[2]:.2f}), outside in {outside} of {len(done)} cells"
    )
    if way == "random":
        return text
    missed = [name for name, holds in limits(total, r, v, each, ratio[1], outside) if not holds]
    return text + (f"  MISSES {', '.join(missed)}" if missed else "")


def limits(
    total: int, r: float, v: float, each: np.ndarray, ratio: float, outside: int
) -> Iterator[tuple[str, bool]]:
    """Yield what must hold, and whether it does."""
    most_r, most_v = TOTALS[total]
    yield f"rms r {1e3 * most_r:.2f} mm", r <= most_r
    yield f"rms v {math.degrees(most_v):.2f} deg", v <= most_v
    yield "NEES 0.95 to 1.05", 0.95 <= float(each.mean()) <= 1.05
    yield "predicted within 10 %", abs(ratio - 1.0) <= 0.1
    yield "outside in 1 of 100", outside <= 0.01 * len(each)


@cache
def blind_cell() -> tuple[Cell, hl.planning.Plan]:
    """Return bounds and the first motion for them: the same for all mounts."""
    here = cell(np.random.default_rng(0), 1)
    return here, hl.planning.blind_motion(here.bounds, SENSOR, here.workspace, here.noise)


def blind_once(seed: int) -> tuple[bool, bool]:
    """Tell whether a mount drawn from the bounds is calibrated, and all its readings are in range."""
    here, plan = blind_cell()
    rng = np.random.default_rng(seed)
    drawn = Cell(here.bounds.draw(rng), here.bounds, here.plates, here.errors)
    read = drawn.measured(plan, rng)
    result = hl.calibrate(read, here.noise, hl.CalibrationOptions(sensor=SENSOR))
    return result.status == "converged", not bool(np.isnan(read.ranges).any())


def blind_line(runs: list[tuple[bool, bool]]) -> str:
    """Return the numbers of the first motion, and the limits that it misses."""
    calibrated, inside = (sum(one[i] for one in runs) for i in (0, 1))
    text = (
        f"first motion of {len(blind_cell()[1])} stations: {calibrated} of {len(runs)} mounts "
        f"calibrated, all readings within the range at {inside}"
    )
    missed = [] if calibrated == len(runs) else ["every mount calibrated"]
    missed += [] if inside >= 0.99 * len(runs) else ["99 of 100 within the range"]
    return text + (f"  MISSES {', '.join(missed)}" if missed else "")


def loop_line(runs: list[dict[str, Loop]]) -> str:
    """Return how many stations planned and random ones need."""
    both = [(one["planned"], one["random"]) for one in runs]
    ratio = [a.stations / b.stations for a, b in both]
    planned, drawn = (np.median([one[i].stations for one in both]) for i in (0, 1))
    unreached = sum(not a.reached for a, _ in both), sum(not b.reached for _, b in both)
    text = (
        f"closed loop: {planned:.0f} planned stations after the first motion, {drawn:.0f} random ones "
        f"(medians of {len(runs)}), ratio {np.median(ratio):.2f}; goal not reached in {unreached[0]} "
        f"and {unreached[1]}, which count with what they had"
    )
    return text + ("" if np.median(ratio) <= 0.5 else "  MISSES at most half")


def speed_line() -> str:
    """Return how long a greedy choice takes, and the limit that it misses."""
    rng = np.random.default_rng(0)
    truth, stations = SCENES["paper"](Layout(), rng)
    here = cell(rng)
    recording = simulate(truth, stations, here.errors, rng, SENSOR)
    belief = belief_of(hl.calibrate(recording, here.noise, OPTIONS))
    task = Task(belief, here.workspace, SENSOR, hl.planning.Goal())
    parts = [task.candidates(p, 300, rng) for p in range(4)]
    drawn = [belief, *(belief.about(belief.draw(rng)) for _ in range(4))]
    rows = np.stack([station_rows(one, joined(parts)) for one in drawn])
    weight = goal_rows(hl.planning.Goal(), belief.mounts(0.015))
    seconds = []
    for _ in range(5):
        begin = time.process_time()
        choose(rows, belief.covariance, weight, 44, exchange=False)
        seconds.append(time.process_time() - begin)
    text = f"greedy choice of 44 stations from {rows.shape[1]} candidates: {min(seconds):.2f} s"
    return text + ("" if min(seconds) <= 1.0 else "  MISSES 1 s")


def study(names: list[str], runs: int, studies: Studies) -> None:
    """Print the lines of each study as soon as it is done."""
    seeds = range(runs)
    if "paper" in names:
        found = studies.each("paper's cell", run_once, seeds)
        for total in TOTALS:
            for way in WAYS:
                studies.show(paper_line(total, way, [one[total, way] for one in found]))
    if "blind" in names:
        studies.show(blind_line(studies.each("first motion", blind_once, seeds)))
    if "loop" in names:
        studies.show(loop_line(studies.each("closed loop", loop, seeds[:50])))
    if "speed" in names:
        studies.show(speed_line())


def main() -> None:
    """Print a line for every kind of stations."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=1000)
    parser.add_argument("--studies", nargs="+", choices=STUDIES, default=STUDIES)
    add_options(parser)
    arguments = parser.parse_args()
    with Studies.of(arguments) as studies:
        study(list(arguments.studies), arguments.runs, studies)


if __name__ == "__main__":
    main()
