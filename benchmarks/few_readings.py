"""Single beams with 7 to 12 readings each, whose noise is not stated: what is said of it is true.

    python -m benchmarks.few_readings --rigs 100

Surveys of a line profiler and two single beams before two planes and a ball, by both generators of
`benchmarks.rigs`, with errors of the hand of 0.05 mm and 0.01 deg that are stated or not, and noise of
all readings of 0.02, 0.1 and 0.5 mm that is not. Of the readings of a beam 7 to 12 are kept at random:
it has seven unknowns. Each line is how many 95 % regions of the locations of beams hold the truth in
results that are usable, and in all that converged, the NEES of the former a degree of freedom, how many
of their beams have a coordinate beyond 5 standard deviations, and how many results are not usable.
"""

import argparse
import sys
import time
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.stats import chi2

import handlaser_gtsam as hl
from handlaser_gtsam.errors import HandlaserError

from .rigs import FAR, GENERATORS, HAND, STATED, errors_of, survey_of

SIGMAS = 2e-5, 1e-4, 5e-4
"""Standard deviations of a reading [m]."""
LEAST_KEPT, MOST_KEPT = 7, 12
"""Readings of a beam."""


@dataclass
class Coverage:
    """What is found of some surveys.

    Attributes
    ----------
    squares : list of float
        Squared errors of the locations of beams in usable results, in their covariance.
    others : list of float
        The same of results that converged and are not usable.
    wrong, unusable, surveys : int
        Locations that are wrong in a usable result; results that are not usable; all results.
    """

    squares: list[float]
    others: list[float]
    wrong: int = 0
    unusable: int = 0
    surveys: int = 0

    @property
    def inside(self) -> float:
        """The part of the 95 % regions of usable results that hold the truth."""
        return float(np.mean(chi2.cdf(self.squares, 3) < 0.95))

    @property
    def inside_of_all(self) -> float:
        """The same of all results that converged."""
        return float(np.mean(chi2.cdf([*self.squares, *self.others], 3) < 0.95))

    @property
    def nees(self) -> float:
        """NEES a degree of freedom."""
        return float(np.mean(self.squares)) / 3.0


def few_readings(seed: int, generator: Any, sigma: float) -> Any:
    """Return a rig whose beams have few readings."""
    options = {"targets": "planes+sphere", "planes": 2, "spheres": 1, "stations": 3 + seed % 2}
    sensors = ("profiler", "beam", "beam")
    rig = generator.mixed(seed, sigma=sigma, hand_sigma=HAND, sensors=sensors, **options)
    rng = np.random.default_rng(seed)
    for table in rig.tables.values():
        if table["kind"] == "beam":
            read = len(table["station"])
            kept = min(read, int(rng.integers(LEAST_KEPT, MOST_KEPT + 1)))
            some = np.sort(rng.choice(read, kept, replace=False))
            table["station"], table["reading"] = table["station"][some], table["reading"][some]
    return rig


def coverage(generator: Any, sigma: float, noise: hl.Noise, rigs: int) -> Coverage:
    """Return what is found of as many rigs."""
    found = Coverage([], [])
    for seed in range(rigs):
        print(f"\r{seed + 1} of {rigs} ", end="", file=sys.stderr, flush=True)
        rig = few_readings(seed, generator, sigma)
        found.surveys += 1
        try:
            result = hl.calibrate(survey_of(rig), noise)
        except HandlaserError:
            found.unusable += 1
            continue
        found.unusable += not result.usable
        if result.status != "converged":
            continue
        names = [*result.sensors, *result.beams]
        for name, (error, C) in zip(names, errors_of(rig, result), strict=True):
            if name in result.beams:
                squares = found.squares if result.usable else found.others
                squares.append(float(error @ np.linalg.solve(C, error)))
                far = bool((np.abs(error) > FAR * np.sqrt(np.diagonal(C))).any())
                found.wrong += far and result.usable
    print("\r" + " " * 40 + "\r", end="", file=sys.stderr)
    return found


def main() -> None:
    """Print the study."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rigs", type=int, default=100)
    rigs = parser.parse_args().rigs
    for name, generator in GENERATORS.items():
        for hand, noise in (("stated", STATED), ("not stated", hl.Noise())):
            for sigma in SIGMAS:
                begin = time.process_time()
                found = coverage(generator, sigma, noise, rigs)
                seconds = (time.process_time() - begin) / rigs
                print(
                    f"by {name}, hand {hand}, {1e3 * sigma:g} mm: {100 * found.inside:.1f} % of "
                    f"{len(found.squares)} inside ({100 * found.inside_of_all:.1f} % of all that "
                    f"converged), NEES {found.nees:.2f}, {found.wrong} wrong, "
                    f"{found.unusable} of {found.surveys} not usable, {seconds:.2f} s",
                    flush=True,
                )


if __name__ == "__main__":
    main()
