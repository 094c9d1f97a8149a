"""Whether a beam that is displaced while planes come in is named, and the right plane.

    python -m benchmarks.drift [--runs 100] [--turn-deg 0.3] [--scene arm] [--jobs J]

20 planes, 11 stations each; before the 11th one beam, another in every run, turns about a random axis
across it. `named` counts the runs in which the first alarm gives this beam and this plane, `at once`
those in which it comes with this plane, `at the end` those in which all 20 planes together give it.
False alarms are those of as many runs without a change, plane by plane and at the end.
"""

import argparse
import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

import handlaser_gtsam as hl
from benchmarks.studies import Studies, add_options
from handlaser_gtsam.estimation.options import RangeError
from handlaser_gtsam.validation.scenes import SCENES, Layout
from handlaser_gtsam.validation.simulate import Errors, simulate

SIGMA, TRANSLATION, ROTATION = 3e-5, 5e-5, math.radians(0.03)
PLANES, BEFORE, STATIONS = 20, 10, 11


@dataclass(frozen=True)
class Case:
    """Beams, and what the session is told and has to choose."""

    name: str
    beams: int
    noise: hl.Noise
    range_error: RangeError = "none"
    k: tuple[float, float] = (0.0, 0.0)


ROBOT = hl.Noise(SIGMA, TRANSLATION, ROTATION)
CASES = (
    Case("4 beams", 4, hl.Noise(SIGMA, 0.0, 0.0)),
    Case("1 beam", 1, hl.Noise(SIGMA, 0.0, 0.0)),
    Case("2 beams, range sigma not given", 2, hl.Noise(None, 0.0, 0.0)),
    Case("2 beams, learned range errors", 2, hl.Noise(SIGMA, 0.0, 0.0), "auto", (0.01, 0.05)),
    Case("4 beams, a robot that errs", 4, ROBOT),
    Case("1 beam, a robot that errs", 1, ROBOT),
)


def recorded(
    case: Case, turn: float, scene: str, rng: np.random.Generator
) -> tuple[hl.Recording, int]:
    """Return a recording in which a beam turns before the eleventh plane, and the beam."""
    layout = Layout(case.beams, PLANES, STATIONS, *case.k)
    truth, stations = SCENES[scene](layout, rng)
    noise = case.noise
    errors = Errors(SIGMA, noise.pose_translation_sigma or 0.0, noise.pose_rotation_sigma or 0.0)
    beam = int(rng.integers(case.beams))
    v = truth.directions.copy()
    axis = np.cross(v[beam], rng.normal(size=3))
    axis /= np.linalg.norm(axis)
    v[beam] = math.cos(turn) * v[beam] + math.sin(turn) * np.cross(axis, v[beam])
    early = simulate(truth, stations, errors, rng)
    late = simulate(replace(truth, directions=v), stations, errors, rng)
    rows = np.flatnonzero(early.plane_of_station < BEFORE)
    rest = np.flatnonzero(early.plane_of_station >= BEFORE)
    return hl.join([early.part(rows), late.part(rest)]), beam


def parts(recording: hl.Recording) -> Iterator[hl.Recording]:
    """Yield the recording plane by plane."""
    for plane in range(len(recording.plane_names)):
        yield recording.part(np.flatnonzero(recording.plane_of_station == plane))


def run_once(case: Case, turn: float, scene: str, seed: int) -> tuple[bool, bool, bool, bool]:
    """Return if the first alarm is right, and at once; if right at the end; if there is any."""
    recording, beam = recorded(case, turn, scene, np.random.default_rng(seed))
    session = hl.Session(case.noise, hl.CalibrationOptions(case.range_error))
    first, when = None, -1
    for number, part in enumerate(parts(recording)):
        moved = session.add(part).moved
        if moved is not None and first is None:
            first, when = moved, number
    truth = (recording.beam_names[beam], recording.plane_names[BEFORE])
    last = session.moved()
    right = first is not None and (first.name, first.since) == truth
    still = last is not None and (last.name, last.since) == truth
    return right, right and when == BEFORE, still, first is not None or last is not None


def main() -> None:
    """Print how often a displaced beam was named, and how often one that was not."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=100)
    parser.add_argument("--turn-deg", type=float, default=0.3)
    parser.add_argument("--scene", choices=sorted(SCENES), default="arm")
    add_options(parser)
    arguments = parser.parse_args()
    turns, runs = (math.radians(arguments.turn_deg), 0.0), arguments.runs
    rows = []
    with Studies.of(arguments) as studies:
        for case in CASES:
            counts = []
            for number, turn in enumerate(turns):
                seeds = range(number * runs, (number + 1) * runs)
                run = partial(run_once, case, turn, arguments.scene)
                counts.append(np.sum(studies.each(case.name, run, seeds), axis=0))
            rows.append((case.name, *counts[0][:3], counts[1][3]))
    print(f"of {runs} runs".ljust(32) + "  named  at once  at the end  false alarms")
    for name, *numbers in rows:
        print(f"{name:32} {numbers[0]:6} {numbers[1]:8} {numbers[2]:11} {numbers[3]:13}")


if __name__ == "__main__":
    main()
