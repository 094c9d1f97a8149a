"""How much garbage does a calibration bear? Readings replaced at random, seed by seed.

    python -m benchmarks.garbage
    python -m benchmarks.garbage --seeds 10 --share 0.2

A share of the readings is replaced by uniform garbage over the span of all readings. The result counts
as good when every coordinate of every beam and plane lies within 3 of its standard deviations of the
result without garbage. With a share of zero the readings wrongly left out are counted.
"""

import argparse
import sys
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

import handlaser_gtsam as hl
from benchmarks.studies import Studies, add_options
from handlaser_gtsam.data.recording import Recording
from handlaser_gtsam.results.calibration import Calibration
from handlaser_gtsam.validation.scenes import SCENES, Layout
from handlaser_gtsam.validation.simulate import Errors, simulate

SIGMAS = 3.0
RANGE_SIGMA = {"paper": 3e-5, "arm": 1e-3}


@dataclass(frozen=True, slots=True)
class Case:
    """A scene, and whether the range sigma is told."""

    scene: str
    layout: Layout
    told: bool


CASES = tuple(
    Case(scene, layout, told)
    for scene, layout in (
        ("paper", Layout()),
        ("arm", Layout()),
        ("arm", Layout(1, 1, 32)),
        ("arm", Layout(1, 4, 32)),
    )
    for told in (True, False)
)


@dataclass(frozen=True, slots=True)
class Outcome:
    """Largest distance from the clean result in standard deviations, and readings wrongly left out."""

    seed: int
    distance: float
    wrongly: int
    good_readings: int


def run(case: Case, share: float, seed: int) -> Outcome:
    """Calibrate one recording with and without garbage."""
    rng = np.random.default_rng(seed)
    sigma = RANGE_SIGMA[case.scene]
    truth, stations = SCENES[case.scene](case.layout, rng)
    recording = simulate(truth, stations, Errors(sigma), rng)
    spoilt, replaced = with_garbage(recording, share, rng)
    noise = hl.Noise(sigma if case.told else None)
    clean = hl.calibrate(recording, noise, hl.CalibrationOptions("none", outliers="keep"))
    found = hl.calibrate(spoilt, noise, hl.CalibrationOptions("none"))
    used = ~np.isnan(found.fit.residuals)
    wrongly = int((~used & ~replaced & ~np.isnan(recording.ranges)).sum())
    return Outcome(seed, distance(found, clean), wrongly, int((~replaced).sum()))


def with_garbage(
    recording: Recording, share: float, rng: np.random.Generator
) -> tuple[Recording, np.ndarray[tuple[int, ...], np.dtype[np.bool_]]]:
    """Return the recording with a share of its readings replaced, and which ones (M, B)."""
    ranges = recording.ranges.copy()
    rows = np.flatnonzero(~np.isnan(ranges))
    chosen = rng.choice(rows, round(share * len(rows)), replace=False)
    low, high = float(np.nanmin(ranges)), float(np.nanmax(ranges))
    ranges.flat[chosen] = rng.uniform(low, high, len(chosen))
    replaced = np.zeros(ranges.shape, dtype=bool)
    replaced.flat[chosen] = True
    return replace(recording, ranges=ranges), replaced


def distance(found: Calibration, clean: Calibration) -> float:
    """Return the largest difference of a coordinate in standard deviations of `found`."""
    if found.status != "converged" or clean.status != "converged":
        return np.inf
    worst = 0.0
    for name, beam in found.beams.items():
        other = clean.beams[name]
        difference = np.concatenate(
            (beam.location - other.location, beam.direction - other.direction)
        )
        assert beam.sigma is not None
        worst = max(worst, float((np.abs(difference) / beam.sigma[:6]).max()))
    for name, plane in found.planes.items():
        twin = clean.planes[name]
        difference = np.append(plane.normal - twin.normal, plane.offset - twin.offset)
        assert plane.sigma is not None
        worst = max(worst, float((np.abs(difference) / plane.sigma).max()))
    return worst


def main() -> int:
    """Run every case with garbage and without; exit with 1 if more than 1 in 100 seeds failed."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("--seeds", type=int, default=100)
    parser.add_argument("--share", type=float, default=0.3)
    add_options(parser, jobs=2)
    arguments = parser.parse_args()
    failed = False
    with Studies.of(arguments) as studies:
        for share in (arguments.share, 0.0):
            for case in CASES:
                name = f"{share:.0%} {case.scene}"
                found = studies.each(name, partial(run, case, share), range(arguments.seeds))
                failed |= _report(studies, case, share, found)
    return 1 if failed else 0


def _report(studies: Studies, case: Case, share: float, outcomes: list[Outcome]) -> bool:
    bad = [outcome for outcome in outcomes if not outcome.distance < SIGMAS]
    wrongly = sum(o.wrongly for o in outcomes) / sum(o.good_readings for o in outcomes)
    layout = case.layout
    told = "sigma given" if case.told else "sigma not given"
    studies.show(
        f"{share:.0%} garbage, {case.scene}, {layout.beams} beams x {layout.planes} planes x "
        f"{layout.stations} stations, {told}: {len(outcomes) - len(bad)} of {len(outcomes)} good, "
        f"{wrongly:.2%} of the good readings left out; failed seeds {[o.seed for o in bad]}"
    )
    return len(bad) > 0.01 * len(outcomes)


if __name__ == "__main__":
    sys.exit(main())
