"""Planes added one by one: how far from the batch solution, and how long.

    python -m benchmarks.incremental [--planes 200] [--every 1] [--robot]

Four beams, 11 stations a plane in any motion. `batch` solves all readings so far from the estimate
before the last plane, covariance included; times are medians of the last 15 planes, in one run.
"""

import argparse
import math
import statistics
import time

import numpy as np
from rich.progress import track

import handlaser_gtsam as hl
from handlaser_gtsam.covariance import covariance
from handlaser_gtsam.scenes import SCENES, Layout
from handlaser_gtsam.simulate import Errors, simulate
from handlaser_gtsam.solving import solve

SIGMA, TRANSLATION, ROTATION = 3e-5, 5e-5, math.radians(0.03)
SHOWN = (10, 20, 50, 100, 200, 500, 1000)
TIMED = 15


def batch_seconds(session: hl.Session, noise: hl.Noise) -> float:
    """Return how long one batch solution from the present estimate takes."""
    readings, at = session.estimate()
    begin = time.perf_counter()
    found = solve(readings, at, 0, noise, hl.CalibrationOptions("none"))
    covariance(found.problem, found.result.values)
    return time.perf_counter() - begin


def main() -> None:
    """Print agreement and times as planes come in."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--planes", type=int, default=200)
    parser.add_argument("--every", type=int, default=1, help="compare after so many planes")
    parser.add_argument("--robot", action="store_true", help="with a robot that errs")
    arguments = parser.parse_args()
    rng = np.random.default_rng(1)
    truth, stations = SCENES["unplanned"](Layout(4, arguments.planes, 11), rng)
    pose = (TRANSLATION, ROTATION) if arguments.robot else (0.0, 0.0)
    recording = simulate(truth, stations, Errors(SIGMA, *pose), rng)
    noise = hl.Noise(SIGMA, *pose)
    session = hl.Session(noise, hl.CalibrationOptions("none"))
    seconds, largest, largest_sigma, rows = [], 0.0, 0.0, []
    for plane in track(range(arguments.planes), description="planes"):
        part = recording.part(np.flatnonzero(recording.plane_of_station == plane))
        begin = time.perf_counter()
        session.add(part)
        seconds.append(time.perf_counter() - begin)
        if session.started and (plane + 1) % arguments.every == 0:
            found = session.compare()
            largest = max(largest, found.largest)
            largest_sigma = max(largest_sigma, found.largest_sigma)
        if plane + 1 in (*SHOWN, arguments.planes):
            batch = statistics.median(batch_seconds(session, noise) for _ in range(3))
            rows.append((plane + 1, statistics.median(seconds[-TIMED:]), batch))
    for planes, one, batch in rows:
        print(
            f"{planes:5} planes: add {1e3 * one:.2f} ms, batch {1e3 * batch:.1f} ms, "
            f"batch / add {batch / one:.1f}"
        )
    print(
        f"largest difference {largest:.1e} standard deviations, standard deviations differ by "
        f"{100.0 * largest_sigma:.2f} % at most"
    )


if __name__ == "__main__":
    main()
