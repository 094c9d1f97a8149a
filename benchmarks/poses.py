"""How long solutions with marginalised and with estimated hand poses take, beside exact ones.

    python -m benchmarks.poses [--repeat N]

13 planes, 25 stations a plane, 4 beams; all from one start, in turns, in one run.
"""

import argparse
import math
import statistics
import time

import numpy as np

from handlaser_gtsam.data.noise import Noise
from handlaser_gtsam.estimation.joint_solution import settle
from handlaser_gtsam.estimation.options import CalibrationOptions, Poses
from handlaser_gtsam.starts import find_start
from handlaser_gtsam.validation.scenes import SCENES, Layout
from handlaser_gtsam.validation.simulate import Errors, simulate

SIGMAS = (3e-5, 5e-5, math.radians(0.03))
LAYOUT = Layout(4, 13, 25)
MODES: tuple[Poses, ...] = ("exact", "marginalised", "estimated")


def main() -> None:
    """Print the median of each way, and how many times as long estimated poses take."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeat", type=int, default=7)
    arguments = parser.parse_args()
    rng = np.random.default_rng(1)
    truth, stations = SCENES["paper"](LAYOUT, rng)
    readings = simulate(truth, stations, Errors(*SIGMAS), rng).readings()
    readings = readings.seen_from(readings.plane_means(readings.world_t_hand))
    start = find_start(readings).parameters
    seconds: dict[Poses, list[float]] = {mode: [] for mode in MODES}
    for _ in range(arguments.repeat):
        for mode in MODES:
            options = CalibrationOptions("k1k2", poses=mode)
            begin = time.perf_counter()
            found = settle(readings, start, Noise(*SIGMAS), options).finished()
            seconds[mode].append(time.perf_counter() - begin)
            assert found.poses == mode, found.poses
    median = {mode: statistics.median(values) for mode, values in seconds.items()}
    for mode in MODES:
        print(
            f"{mode:12}: {1e3 * median[mode]:.1f} ms, {median[mode] / median['exact']:.1f} of exact"
        )
    print(f"estimated / marginalised = {median['estimated'] / median['marginalised']:.2f}")


if __name__ == "__main__":
    main()
