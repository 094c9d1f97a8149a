"""How well the sigmas of ranges and poses are estimated from the residuals.

    python -m benchmarks.noise_components [--runs N] [--jobs J]

Four beams, 13 planes and 20 stations a plane; nothing about the noise is given. In the paper's scene
the spots are 2 cm from the origin of the hand: there 0.03 deg move them by a third of the noise. In
the scene `arm` they are 30 cm away.
"""

import argparse
import math
from collections.abc import Iterator
from functools import partial

import numpy as np

import handlaser_gtsam as hl
from benchmarks.studies import Studies, add_options
from handlaser_gtsam.arrays import FloatArray
from handlaser_gtsam.validation.scenes import SCENES, Layout
from handlaser_gtsam.validation.simulate import Errors, simulate

TRUE = {
    "paper": np.array([3e-5, 5e-5, math.radians(0.03)]),
    "arm": np.array([1e-4, 1e-4, math.radians(0.03)]),
}
NAMES = ("range", "pose translation", "pose rotation")


def run_once(seed: int, scene: str = "paper") -> FloatArray:
    """Return the estimated sigmas over the true ones, then what is said of their own errors.

    NaN where there is no calibration.
    """
    rng = np.random.default_rng(seed)
    truth, stations = SCENES[scene](Layout(4, 13, 20), rng)
    recording = simulate(truth, stations, Errors(*TRUE[scene]), rng)
    found = hl.calibrate(recording, options=hl.CalibrationOptions("none"))
    if found.status != "converged":
        return np.full(6, np.nan)
    rows = [
        [one.sigma for one in found.noise_estimate],
        [one.error for one in found.noise_estimate],
    ]
    ratio: FloatArray = (np.array(rows) / TRUE[scene]).ravel()
    return ratio


def main() -> None:
    """Print the mean and the spread of each estimated sigma."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=100)
    add_options(parser)
    arguments = parser.parse_args()
    with Studies.of(arguments) as studies:
        for scene in TRUE:
            run = partial(run_once, scene=scene)
            ratio = np.array(studies.each(scene, run, range(arguments.runs)))
            for text in lines(scene, ratio):
                studies.show(text)


def lines(scene: str, ratio: FloatArray) -> Iterator[str]:
    """Yield the mean and the spread of each estimated sigma, from a row (6,) a run."""
    for name, values, said in zip(NAMES, ratio.T[:3], ratio.T[3:], strict=True):
        off = np.abs(values - 1.0)
        yield (
            f"{scene}, {name}: estimated / true {np.nanmean(values):.3f} +- "
            f"{np.nanstd(values):.3f} (said: {np.nanmedian(said):.3f}), furthest "
            f"{np.nanmax(off):.3f} off, within 20 % in {100 * np.mean(off <= 0.2):.0f} %"
        )
    yield f"{scene}: {np.isnan(ratio[:, 0]).sum()} of {len(ratio)} not converged"


if __name__ == "__main__":
    main()
