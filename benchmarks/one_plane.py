"""How long one beam before one plane takes, from readings to covariances, beside the SciPy reference.

    python -m benchmarks.one_plane

One recording of 32 stations in any motion, the size of the published single-plane recordings. Times
are medians over seeds; the reference solves from the same start and has no start of its own to find.
"""

import statistics
import time

import numpy as np
from numpy.random import default_rng

from handlaser_gtsam.data.noise import Noise
from handlaser_gtsam.data.recording import Recording
from handlaser_gtsam.estimation.options import CalibrationOptions
from handlaser_gtsam.model.weighting import Variances
from handlaser_gtsam.pipeline import calibrate
from handlaser_gtsam.solvers.reference.problem import solve
from handlaser_gtsam.starts import find_start
from handlaser_gtsam.validation.cross_check import recording_problem
from handlaser_gtsam.validation.scenes import Layout, arm
from handlaser_gtsam.validation.simulate import Errors, simulate

SIGMA, SEEDS = 1e-3, 20


def recording(seed: int) -> Recording:
    """Return one plane, 32 stations, one beam."""
    rng = default_rng(seed)
    truth, stations = arm(Layout(1, 1, 32), rng)
    return simulate(truth, stations, Errors(SIGMA), rng)


def main() -> None:
    """Print the medians."""
    rows: dict[str, list[float]] = {"sigma given": [], "sigma not given": [], "reference": []}
    for seed in range(SEEDS + 1):
        one = recording(seed)
        start = find_start(one.readings(), SIGMA, 0).parameters
        for name, noise in (("sigma given", Noise(SIGMA)), ("sigma not given", Noise())):
            begin = time.perf_counter()
            calibrate(one, noise, CalibrationOptions("none"))
            rows[name].append(time.perf_counter() - begin)
        begin = time.perf_counter()
        solve(recording_problem(one, start, (0,), Variances(np.array([SIGMA]))))
        rows["reference"].append(time.perf_counter() - begin)
    reference = statistics.median(rows["reference"][1:])
    for name, seconds in rows.items():
        median = statistics.median(seconds[1:])  # the first run warms up
        most = max(seconds[1:])
        print(
            f"{name}: median {1e3 * median:.1f} ms, most {1e3 * most:.1f} ms, "
            f"{median / reference:.1f} of the reference's solution"
        )


if __name__ == "__main__":
    main()
