"""Planes added one by one: how far from the batch solution, and how long.

    python -m benchmarks.incremental [--planes 200] [--every 1] [--robot | --poses | --defaults]

Four beams, 11 stations a plane in any motion; a robot that errs, with poses marginalised or estimated,
or with range errors too and nothing given: then all scales are learned and integrated over.
`batch` solves all readings so far from the present estimate, covariance included, in turns with the
planes that are added. Times are medians of 15 planes; `mean` is over the last 50, with the comparisons
that a session makes by itself. The slope is that of a line through the medians.
"""

import argparse
import math
import statistics
import time

import numpy as np
from rich.progress import track

import handlaser_gtsam as hl
from handlaser_gtsam.estimation.joint_solution import settle
from handlaser_gtsam.validation.scenes import SCENES, Layout
from handlaser_gtsam.validation.simulate import Errors, simulate

SIGMA, TRANSLATION, ROTATION = 3e-5, 5e-5, math.radians(0.03)
SHOWN = (10, 20, 50, 100, 200, 500, 1000)
TIMED, LONG = 15, 50


def batch_seconds(session: hl.Session, noise: hl.Noise, options: hl.CalibrationOptions) -> float:
    """Return how long one batch solution from the present estimate takes."""
    readings, at = session.estimate()
    begin = time.perf_counter()
    assert settle(readings, at, noise, options).finished().joint is not None
    return time.perf_counter() - begin


def made(
    arguments: argparse.Namespace,
) -> tuple[hl.Recording, hl.Noise, hl.CalibrationOptions]:
    """Return the recording that is asked for, and how it is calibrated."""
    rng = np.random.default_rng(1)
    k = (0.01, 0.2) if arguments.defaults else (0.0, 0.0)
    truth, stations = SCENES["unplanned"](Layout(4, arguments.planes, 11, *k), rng)
    errs = arguments.robot or arguments.poses or arguments.defaults
    pose = (TRANSLATION, ROTATION) if errs else (0.0, 0.0)
    recording = simulate(truth, stations, Errors(SIGMA, *pose), rng)
    if arguments.defaults:
        return recording, hl.Noise(), hl.CalibrationOptions()
    options = hl.CalibrationOptions("none", poses="estimated" if arguments.poses else "auto")
    return recording, hl.Noise(SIGMA, *pose), options


def main() -> None:
    """Print agreement and times as planes come in."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--planes", type=int, default=200)
    parser.add_argument("--every", type=int, default=1, help="compare after so many planes")
    parser.add_argument("--robot", action="store_true", help="poses marginalised")
    parser.add_argument("--poses", action="store_true", help="poses estimated")
    parser.add_argument("--defaults", action="store_true", help="give nothing")
    arguments = parser.parse_args()
    recording, noise, options = made(arguments)
    session = hl.Session(noise, options)
    shown = sorted({*SHOWN, arguments.planes})
    seconds, batches, largest, largest_sigma, rows = [], [], 0.0, 0.0, []
    for plane in track(range(arguments.planes), description="planes"):
        part = recording.part(recording.plane_of_station == plane)
        begin = time.perf_counter()
        session.add(part)
        seconds.append(time.perf_counter() - begin)
        if session.started and (plane + 1) % arguments.every == 0:
            found = session.compare()
            largest = max(largest, found.largest)
            largest_sigma = max(largest_sigma, found.largest_sigma)
        near = any(0 <= number - plane - 1 < TIMED for number in shown)
        if session.started and ((near and plane % 3 == 0) or plane + 1 in shown):
            batches.append(batch_seconds(session, noise, options))
        if plane + 1 in shown and batches:
            one, batch = statistics.median(seconds[-TIMED:]), statistics.median(batches)
            rows.append((plane + 1, one, statistics.mean(seconds[-LONG:]), batch))
            batches = []
    for planes, one, mean, batch in rows:
        print(
            f"{planes:5} planes: add {1e3 * one:.2f} ms (mean {1e3 * mean:.2f}), batch "
            f"{1e3 * batch:.1f} ms, batch / add {batch / one:.1f}"
        )
    if len(rows) > 1:
        slope = np.polyfit([row[0] for row in rows], [row[1] for row in rows], 1)[0]
        of_batch = 1e6 * rows[-1][3] / rows[-1][0]
        print(f"slope {1e6 * slope:.1f} us a plane; of the batch {of_batch:.0f} us")
    print(
        f"largest difference {largest:.1e} standard deviations, standard deviations differ by "
        f"{100.0 * largest_sigma:.2f} % at most"
    )


if __name__ == "__main__":
    main()
