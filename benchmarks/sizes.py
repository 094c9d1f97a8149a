"""How long large recordings take to calibrate, how much memory, and whether the result is honest.

    python -m benchmarks.sizes [--beams 50 100 200 400] [--stations 100000] [--scenes paper arm]

Beams stand before four planes of 16 stations each, with the noise given and with nothing given; then
one beam at many stations, on exact poses. Each case runs in a process of its own. Printed are processor
and wall time, the most memory, and the NEES of all beams (1 where errors are as large as stated; less
where sensors have no range errors, as here). What grows is the time from the fewest beams to the most,
as a power of their number. Ends with 1 where a result is missing, or off by more than twice what it
states.

`OPENBLAS_NUM_THREADS=1` makes processor and wall time the same.
"""

import argparse
import itertools
import math
import resource
import subprocess
import sys
import time

import numpy as np

import handlaser_gtsam as hl
from benchmarks.defaults import nees
from handlaser_gtsam.data.parameters import Parameters
from handlaser_gtsam.results.calibration import Calibration
from handlaser_gtsam.validation.scenes import SCENES, Layout
from handlaser_gtsam.validation.simulate import Errors, simulate

ERRORS = 3e-5, 5e-5, 5e-4
PLANES, STATIONS = 4, 16
MOST_NEES = 4.0


def case(name: str) -> tuple[hl.Recording, Parameters, hl.Noise]:
    """Return the recording of a case, its truth, and what is said of its noise."""
    scene, beams, stations, said = name.split(":")
    many = int(stations) > STATIONS
    layout = Layout(int(beams), PLANES, int(stations) // (PLANES if many else 1))
    truth, poses = SCENES[scene](layout, np.random.default_rng(0))
    sigmas = (ERRORS[0], 0.0, 0.0) if many else ERRORS
    recording = simulate(truth, poses, Errors(*sigmas), np.random.default_rng(1))
    return recording, truth, hl.Noise(*sigmas) if said == "given" else hl.Noise()


def error_of(found: Calibration, truth: Parameters) -> float:
    """Return the NEES of all beams."""
    estimates = (np.hstack((b.location, b.direction, b.range_error)) for b in found.beams.values())
    true = np.hstack((truth.locations, truth.directions, truth.range_errors))
    covariance = found.covariance
    assert covariance is not None  # of a result that has converged
    off = [
        lift.T @ (e - t)
        for lift, e, t in zip(covariance.beam_lifts(), estimates, true, strict=True)
    ]
    return nees(covariance.beams, np.concatenate(off))


def run(name: str) -> None:
    """Calibrate one case and print its row."""
    recording, truth, noise = case(name)
    processor, wall = time.process_time(), time.perf_counter()
    found = hl.calibrate(recording, noise)
    processor, wall = time.process_time() - processor, time.perf_counter() - wall
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    error = error_of(found, truth) if found.status == "converged" else math.inf
    print(processor, wall, memory, error, found.status)


def measured(name: str) -> tuple[float, bool]:
    """Run a case in a process of its own and print it; return its wall time, and if it is honest."""
    command = [sys.executable, "-m", "benchmarks.sizes", "--case", name]
    text = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    *numbers, status = text.split()
    processor, wall, memory, error = map(float, numbers)
    scene, beams, stations, said = name.split(":")
    print(
        f"{scene:9} {beams:>4} beams {stations:>7} stations, {said:7}: {processor:6.1f} s CPU, "
        f"{wall:6.1f} s, {memory:5.0f} MB, NEES {error:.2f}, {status}",
        flush=True,
    )
    return wall, error < MOST_NEES


def main() -> None:
    """Print a row a case; exit 1 where a result is missing or wrong."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--beams", type=int, nargs="+", default=[50, 100, 200, 400])
    parser.add_argument("--stations", type=int, default=100_000)
    parser.add_argument("--scenes", nargs="+", choices=sorted(SCENES), default=["paper", "arm"])
    parser.add_argument("--case", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.case:
        run(options.case)
        return
    honest = []
    for scene, said in itertools.product(options.scenes, ("given", "nothing")):
        rows = [measured(f"{scene}:{beams}:{STATIONS}:{said}") for beams in options.beams]
        honest += [good for _, good in rows]
        if len(rows) > 1:
            span = math.log(options.beams[-1] / options.beams[0])
            print(f"  grows with the power {math.log(rows[-1][0] / rows[0][0]) / span:.2f}")
    if options.stations:
        for said in ("given", "nothing"):
            honest.append(measured(f"arm:1:{options.stations}:{said}")[1])
    sys.exit(0 if all(honest) else 1)


if __name__ == "__main__":
    main()
