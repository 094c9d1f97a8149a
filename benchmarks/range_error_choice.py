"""Whether the right number of range-error terms is chosen, beam by beam.

    python -m benchmarks.range_error_choice [--recordings N] [--jobs J]

Every recording has four beams in the paper's scene; each beam has no range error, k1, or k1 and k2 by
lot. Each term that is there is 5 to 8 of its own standard deviations large: those of a solution with
all terms for k1 and k2, given k2 = 0 for k1 alone. Exact poses, range sigma 0.03 mm, given or not.
"""

import argparse
import os
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace

import numpy as np
from rich.progress import Progress

import handlaser_gtsam as hl
from handlaser_gtsam.arrays import FloatArray, IntArray
from handlaser_gtsam.covariance import covariance
from handlaser_gtsam.graph import build_graph
from handlaser_gtsam.parameters import Parameters
from handlaser_gtsam.recording import Readings
from handlaser_gtsam.scenes import SCENES, Layout
from handlaser_gtsam.simulate import Errors, simulate

SIGMA = 3e-5
SIZE = (5.0, 8.0)
NAMES = ("none", "k1", "k1 and k2")


def effects(
    readings: Readings, truth: Parameters, terms: IntArray, rng: np.random.Generator
) -> FloatArray:
    """Return range errors (B, 2) with as many terms as asked for, each of a known significance."""
    S = covariance(problem := build_graph(readings, truth, 2, SIGMA), problem.values).beams
    k = np.zeros((len(terms), 2))
    for beam, count in enumerate(terms):
        own = S[7 * beam + 5 : 7 * beam + 7, 7 * beam + 5 : 7 * beam + 7]
        size = rng.uniform(*SIZE, 2) * rng.choice([-1.0, 1.0], 2)
        if count == 1:
            k[beam, 0] = size[0] * np.sqrt(own[0, 0] - own[0, 1] ** 2 / own[1, 1])
        elif count == 2:
            k[beam] = size * np.sqrt(np.diagonal(own))
    return k


def run_once(seed: int) -> list[tuple[bool, int, int]]:
    """Return (sigma given, true terms, chosen terms) of every beam of one recording."""
    rng = np.random.default_rng(seed)
    truth, stations = SCENES["paper"](Layout(), rng)
    readings = simulate(truth, stations, Errors(SIGMA), rng).readings()
    origins = readings.plane_means(readings.world_t_hand)
    terms = rng.integers(0, 3, len(truth.locations)).astype(np.intp)
    k = effects(readings.seen_from(origins), truth.seen_from(origins), terms, rng)
    recording = simulate(replace(truth, range_errors=k), stations, Errors(SIGMA), rng)
    found = []
    for given in (True, False):
        result = hl.calibrate(recording, hl.Noise(SIGMA if given else None))
        chosen = [beam.terms for beam in result.beams.values()]
        found += [(given, int(t), c) for t, c in zip(terms, chosen, strict=True)]
    return found


def study(recordings: int, jobs: int) -> Counter[tuple[bool, int, int]]:
    """Count (sigma given, true terms, chosen terms) over all beams."""
    count: Counter[tuple[bool, int, int]] = Counter()
    with Progress() as bar, ProcessPoolExecutor(jobs) as pool:
        task = bar.add_task("recordings", total=recordings)
        for one in pool.map(run_once, range(recordings), chunksize=4):
            count.update(one)
            bar.advance(task)
    return count


def share(count: Counter[tuple[bool, int, int]], given: bool, true: int) -> float:
    """Return the share of beams with `true` terms for which that number was chosen."""
    total = sum(count[given, true, chosen] for chosen in range(3))
    return count[given, true, true] / max(total, 1)


def main() -> None:
    """Print how often each number of terms was chosen for each true one."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--recordings", type=int, default=500)
    parser.add_argument("--jobs", type=int, default=os.cpu_count())
    arguments = parser.parse_args()
    count = study(arguments.recordings, arguments.jobs)
    for given in (True, False):
        for true in range(3):
            listed = ", ".join(f"{NAMES[c]} {count[given, true, c]}" for c in range(3))
            told = "sigma given" if given else "sigma not given"
            right = 100.0 * share(count, given, true)
            print(f"{told}, truth {NAMES[true]}: right for {right:.1f} % (chosen: {listed})")


if __name__ == "__main__":
    main()
