"""Whether standard deviations are right where a robot comes back to its stops: Monte Carlo.

    python -m benchmarks.repeated_programme [--runs 60] [--jobs 2]

A hand with two beams goes through one programme of twelve stops before each of four plates: once, three
times, or with three readings at each stop. It errs by 0.1 mm and 0.02 degrees at every stop, each time
alike, or anew each time; recorded poses flicker by 5 um and 10 urad, readings by 0.05 mm. Each line has
the mean square of the errors of r and v in standard deviations (1 is right), how many are beyond five
of them in a usable result, how many recordings are said to have a systematic error, and the same mean
square without what stations share. Nothing of the simulation is shared with the package.
"""

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy.spatial.transform import Rotation

import handlaser_gtsam as hl
from benchmarks.studies import Studies, add_options
from handlaser_gtsam.arrays import FloatArray
from handlaser_gtsam.model.joint import JointCovariance

SIGMA, SHIFT, TURN = 5e-5, 1e-4, 3.5e-4
"""Of readings [m], and of what the hand errs by [m], [rad]."""
FLICKER = 5e-6
"""Of recorded positions [m]; of orientations twice as much [rad]."""
NOISE = hl.Noise(SIGMA, pose_translation_sigma=SHIFT, pose_rotation_sigma=TURN)
TILTS = np.radians([[0, 0, 0], [22, 0, 0], [-12, 20, 0], [-10, -20, 0]])
STOPS = 12

Visits = Sequence[tuple[int, int]]
"""Plane and stop of every station."""
ACROSS: Visits = [(plane, stop) for plane in range(4) for stop in range(STOPS)]
"""One programme before each plate."""
AGAIN: Visits = [(plane, stop) for plane in range(4) for _ in range(3) for stop in range(STOPS)]
"""Three times before each."""
STAYS: Visits = [(plane, stop) for plane in range(4) for stop in range(STOPS) for _ in range(3)]
"""Once, three readings a stop."""


class Robot:
    """A hand with some beams that goes through one programme, whose errors are those of its stops."""

    def __init__(self, seed: int, beams: int = 2, stops: int = STOPS) -> None:
        rng = self.rng = np.random.default_rng(seed)
        self.r = rng.uniform(-0.05, 0.05, (beams, 3))
        v = np.array([0.0, 0.0, 1.0]) + rng.normal(0.0, 0.15, (beams, 3))
        self.v = v / np.linalg.norm(v, axis=1)[:, None]
        tilts = TILTS + rng.uniform(-0.1, 0.1, (4, 3))
        self.n = Rotation.from_rotvec(tilts).apply([0.0, 0.0, 1.0])
        turns = rng.uniform([-0.4, -0.4, -1.3], [0.4, 0.4, 1.3], (stops, 3))
        self.R, self.t = Rotation.from_euler("xyz", turns), rng.uniform(-0.12, 0.12, (stops, 3))
        self.turn = rng.normal(0.0, TURN, (stops, 3))
        self.shift = rng.normal(0.0, SHIFT, (stops, 3))

    def recording(
        self,
        visits: Visits,
        flicker: float = 0.0,
        knocked: int | None = None,
        *,
        repeats: bool = True,
    ) -> hl.Recording:
        """Return what is read at visits; `knocked` is the first after the sensors moved by 1 mm."""
        rng, d, R, t = self.rng, list[FloatArray](), list[FloatArray](), list[FloatArray]()
        for number, (plane, stop) in enumerate(visits):
            at = self.R[stop] * Rotation.from_rotvec(rng.normal(0.0, 2.0 * flicker, 3))
            where = self.t[stop] + rng.normal(0.0, flicker, 3)
            turn, shift = self.turn[stop], self.shift[stop]
            if not repeats:
                turn, shift = rng.normal(0.0, TURN, 3), rng.normal(0.0, SHIFT, 3)
            hand = at * Rotation.from_rotvec(turn)
            r = self.r + (np.array([6e-4, 8e-4, 0.0]) if knocked and number >= knocked else 0.0)
            spots = hand.apply(r) + where + at.apply(shift)
            d.append((0.45 - spots @ self.n[plane]) / (hand.apply(self.v) @ self.n[plane]))
            R.append(at.as_matrix())
            t.append(where)
        ranges = np.array(d) + rng.normal(0.0, SIGMA, (len(d), len(self.r)))
        names = tuple(f"b{i}" for i in range(len(self.r)))
        labels = tuple(f"p{plane}" for plane, _ in visits)
        return hl.Recording(np.array(R), np.array(t), ranges, plane_labels=labels, beam_names=names)

    def squares(self, found: hl.Calibration, joint: JointCovariance) -> float:
        """Return the mean square of the errors of the mounts, in standard deviations."""
        squares = []
        beams = zip(found.beams.values(), self.r, self.v, joint.all_beams(), strict=True)
        for beam, r, v, S in beams:
            e = np.concatenate((beam.location - r, beam.direction - v))
            squares.append(e @ np.linalg.pinv(S[:6, :6], rcond=1e-9) @ e / 5.0)
        return float(np.mean(squares))


@dataclass(frozen=True, slots=True)
class Found:
    """What is said of one recording, and how right it is, with and without what stations share."""

    square: float
    alone: float
    far: bool
    accused: bool


def run_once(visits: Visits, repeats: bool, given: bool, seed: int) -> Found:
    """Calibrate one recording."""
    robot = Robot(seed)
    recording = robot.recording(visits, FLICKER, repeats=repeats)
    found = hl.calibrate(recording, NOISE if given else None)
    assert found.covariance is not None, "everything is determined"
    alone = found.covariance if found.at_scales is None else found.at_scales.covariance
    off = np.array([beam.location for beam in found.beams.values()]) - robot.r
    sigmas = np.array([beam.location_sigma for beam in found.beams.values()])
    return Found(
        robot.squares(found, found.covariance),
        robot.squares(found, alone),
        found.verdict.code == "usable" and bool((np.abs(off) > 5.0 * sigmas).any()),
        any(one.found for one in found.systematic),
    )


def study(runs: int, studies: Studies) -> None:
    """Print a line for every programme."""
    programmes = {"once a plate": ACROSS, "three times": AGAIN, "three readings a stop": STAYS}
    for name, visits in programmes.items():
        for repeats in (True, False):
            for given in (True, False):
                errors = "errors come again" if repeats else "errors anew"
                noise = "noise stated" if given else "nothing given"
                line = f"{name}, {errors}, {noise}"
                run = partial(run_once, visits, repeats, given)
                found = studies.each(line, run, range(100, 100 + runs))
                square, alone = (
                    float(np.mean([getattr(one, which) for one in found]))
                    for which in ("square", "alone")
                )
                far, accused = sum(one.far for one in found), sum(one.accused for one in found)
                studies.show(
                    f"{line:55} {square:.2f}, beyond five {far}, accused {accused} of {runs}, "
                    f"without what is shared {alone:.2f}"
                )


def main() -> None:
    """Print a line a programme as soon as it is done."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=60)
    add_options(parser)
    arguments = parser.parse_args()
    with Studies.of(arguments) as studies:
        study(arguments.runs, studies)


if __name__ == "__main__":
    main()
