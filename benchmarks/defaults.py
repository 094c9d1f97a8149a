"""Whether the defaults are honest: Monte Carlo over the simulated robot cell.

    python -m benchmarks.defaults [--runs 200] [--jobs 2] [--beams 4 1] [--a 0 0.1 0.3 1 3 10]
                                  [--motion 0.16] [--given] [--kind each]
    python -m benchmarks.defaults --scene-check [--runs 100]

Every recording has 6 planes x 13 stations, joint errors of 0.004 deg, readings that err by 0.1 mm, and
range errors k1 ~ N(0, 0.01 a), k2 ~ N(0, 0.2/m a) of every beam (--kind alike: the same of all beams;
--kind k1: no k2; --kind parabola: k2 = -k1 / 0.6 m). It is calibrated with nothing given (with --given:
the range sigma, and the covariance of every hand pose), and for comparison with both range-error terms,
and without any at a = 0.

NEES is the squared error of all beams in their joint covariance over the number of unknowns, of all of
them and of r and v alone, the mounts: its limits are on these. Range errors of exactly zero (a = 0)
are no draw from any distribution of range errors that has a width, so that of k is below one there.
Coverage counts how often the 95 % intervals of single coordinates hold the truth. `>5` counts
recordings with a coordinate of a beam beyond five of its standard deviations, `fail` those without a
result; `v/none` and `v/k1k2` are ratios of rms errors of v over the recordings that both ways solve.
What misses a limit is named at the end of a line.

--scene-check counts recordings with a coordinate beyond five standard deviations in the scene `arm` of
the package, with k1 = 0.02 and k2 = 0.01/m, readings that err by 0.1 mm, and exact poses.
"""

import argparse
import math
import time
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial

import numpy as np

import handlaser_gtsam as hl
from benchmarks.robot_arm import pose_covariance
from benchmarks.robot_cell import KINDS, MOTION, Scene, Truth, cell
from benchmarks.studies import Studies, add_options
from handlaser_gtsam.arrays import FloatArray
from handlaser_gtsam.estimation.options import RangeError
from handlaser_gtsam.validation.scenes import SCENES, SENSORS, Layout
from handlaser_gtsam.validation.simulate import Errors, simulate

A = (0.0, 0.1, 0.3, 1.0, 3.0, 10.0)
FAR = 5.0
"""Standard deviations that no error of an honest result exceeds in a few hundred recordings."""
CHECKED = {
    "rig file": (hl.Noise(1e-4, 0.0, 0.0), SENSORS["arm"]),
    "range sigma given": (hl.Noise(1e-4), hl.Sensor()),
    "nothing given": (hl.Noise(), hl.Sensor()),
}
"""What --scene-check gives: all of the rig file that `handlaser simulate` writes, or less of it."""


@dataclass(frozen=True, slots=True)
class Case:
    """Beams, size and kind of the range errors, whether the noise is given, and the hand's motion."""

    beams: int
    a: float
    given: bool
    motion: float = MOTION
    kind: str = "each"

    @property
    def ways(self) -> tuple[RangeError, ...]:
        """How recordings of this case are calibrated, the default first."""
        return ("auto", "k1k2", "none") if self.a == 0.0 else ("auto", "k1k2")


@dataclass(frozen=True, slots=True)
class Judged:
    """One calibration against the truth.

    Attributes
    ----------
    nees, mount_nees : float
        An unknown, of all unknowns of the beams and of r and v alone.
    covered : float
        Share of coordinates that lie in their 95 % intervals.
    location, direction : float
        Mean squared error of r [m^2] and v [rad^2].
    farthest : float
        Largest error of a coordinate in its standard deviation.
    seconds : float
        Wall time.
    """

    nees: float
    mount_nees: float
    covered: float
    location: float
    direction: float
    farthest: float
    seconds: float


def stated_noise(scene: Scene, truth: Truth) -> hl.Noise:
    """Return all that there is to say about the noise of a recording."""
    sigma = math.radians(scene.joint_sigma_deg)
    return hl.Noise(scene.range_sigma, pose_covariance=pose_covariance(truth.joints, sigma))


def run_once(case: Case, seed: int) -> dict[RangeError, Judged | None]:
    """Calibrate one recording in every way; None where one of them has no result."""
    scene = Scene(beams=case.beams, motion=case.motion, a=case.a, kind=case.kind)
    recording, truth = cell(scene, np.random.default_rng(seed))
    noise = stated_noise(scene, truth) if case.given else hl.Noise()
    true = np.hstack((truth.locations, truth.directions, truth.range_errors))
    found: dict[RangeError, Judged | None] = {}
    for way in case.ways:
        since = time.perf_counter()
        try:
            result = hl.calibrate(recording, noise, hl.CalibrationOptions(way))
        except hl.HandlaserError:
            found[way] = None
        else:
            found[way] = judge(result, true, time.perf_counter() - since)
    return found


def judge(result: hl.Calibration, true: FloatArray, seconds: float = 0.0) -> Judged | None:
    """Compare a calibration with the truth (B, 8); None where it has no covariance."""
    joint = result.covariance
    if result.status != "converged" or joint is None:
        return None
    beams = list(result.beams.values())
    found = np.array([np.concatenate((b.location, b.direction, b.range_error)) for b in beams])
    e = found - true
    own = [lift.T @ row for lift, row in zip(joint.beam_lifts(), e, strict=True)]
    mounts = np.concatenate([np.arange(len(one)) < 5 for one in own])
    tangent = np.concatenate(own)
    sigma = np.sqrt(np.stack([np.diagonal(S) for S in joint.all_beams()]))
    intervals = np.array([result.intervals(b.name) for b in beams])
    held = (intervals[..., 0] <= true) & (true <= intervals[..., 1])
    seen = sigma > 0.0
    turn = np.linalg.norm(np.cross(found[:, 3:6], true[:, 3:6]), axis=1)
    return Judged(
        nees(joint.beams, tangent),
        nees(joint.beams[np.ix_(mounts, mounts)], tangent[mounts]),
        float(held[seen].mean()),
        float((e[:, :3] ** 2).sum(axis=1).mean()),
        float((turn**2).mean()),
        float((np.abs(e[seen]) / sigma[seen]).max()),
        seconds,
    )


def nees(covariance: FloatArray, e: FloatArray) -> float:
    """Return the squared errors e (n,) in their covariance (n, n), over n."""
    sigma = np.sqrt(np.diagonal(covariance))
    z = np.linalg.solve(covariance / np.outer(sigma, sigma), e / sigma)
    return float((e / sigma) @ z) / len(e)


def rms_ratio(runs: list[dict[RangeError, Judged | None]], other: RangeError) -> float:
    """Return the rms error of v by default over that of another way, where both have a result."""
    pairs = [(one.get("auto"), one.get(other)) for one in runs]
    both = [(x.direction, y.direction) for x, y in pairs if x is not None and y is not None]
    if not both:
        return math.nan
    default, compared = np.mean(both, axis=0)
    return math.sqrt(default / compared)


def line(case: Case, runs: list[dict[RangeError, Judged | None]]) -> str:
    """Return the numbers of a case, and the limits that it misses."""
    done = [one["auto"] for one in runs if one["auto"] is not None]
    head = f"{case.beams} beam{'s' * (case.beams > 1):1} a {case.a:4g}"
    if not done:
        return f"{head}: no result in {len(runs)} recordings"
    each = np.array([one.nees for one in done])
    mounts = float(np.mean([one.mount_nees for one in done]))
    covered = float(np.mean([one.covered for one in done]))
    both = [one["k1k2"] for one in runs if one["k1k2"] is not None]
    ratio, none = rms_ratio(runs, "k1k2"), rms_ratio(runs, "none")
    text = (
        f"{head}: NEES {each.mean():6.3f} +- {each.std() / math.sqrt(len(each)):.3f}, r v "
        f"{mounts:6.3f}, coverage {100 * covered:5.1f} %, "
        f"rms r {1e3 * rms([one.location for one in done]):.3f} mm, "
        f"v {math.degrees(rms([one.direction for one in done])):.3f} deg, "
        f"v/k1k2 {ratio:.3f} (its NEES {rms([b.nees for b in both]) ** 2:.3f}), "
        + (f"v/none {none:.3f}, " if case.a == 0.0 else "")
        + f"fail {len(runs) - len(done)}, >5 {sum(one.farthest > FAR for one in done)}, "
        f"{np.mean([one.seconds for one in done]):.2f} s"
    )
    missed = [name for name, holds in limits(case, mounts, covered, ratio, none) if not holds]
    return text + (f"  MISSES {', '.join(missed)}" if missed else "")


def rms(squares: list[float]) -> float:
    """Return the root of a mean of squares."""
    return math.sqrt(np.mean(squares)) if squares else math.nan


def limits(
    case: Case, mean_nees: float, covered: float, ratio: float, none: float
) -> Iterator[tuple[str, bool]]:
    """Yield what must hold in a case, and whether it does."""
    low, high = (0.9, 1.1) if case.given else (0.85, 1.2)
    yield f"NEES {low} to {high}", low <= mean_nees <= high
    yield "coverage 92 to 98 %", 0.92 <= covered <= 0.98
    yield "v/k1k2 at most 1.05", ratio <= 1.05
    if case.a == 0.0:
        yield "v/none at most 1.10", none <= 1.10
    if case.beams == 4 and case.a <= 1.0:
        yield "v/k1k2 at most 0.90", ratio <= 0.90


def check_once(name: str, seed: int) -> Judged | None:
    """Calibrate one recording of the scene `arm` by default; None where there is no result."""
    noise, sensor = CHECKED[name]
    rng = np.random.default_rng(seed)
    truth, stations = SCENES["arm"](Layout(k1=0.02, k2=0.01), rng)
    recording = simulate(truth, stations, Errors(1e-4), rng, SENSORS["arm"])
    result = hl.calibrate(recording, noise, hl.CalibrationOptions(sensor=sensor))
    return judge(result, np.hstack((truth.locations, truth.directions, truth.range_errors)))


def study(cases: list[Case], runs: int, studies: Studies) -> None:
    """Print a line for every case."""
    for case in cases:
        name = f"{case.beams} beams, a = {case.a:g}"
        studies.show(line(case, studies.each(name, partial(run_once, case), range(runs))))


def scene_check(runs: int, studies: Studies) -> None:
    """Print a line for everything that may be given of the scene `arm`."""
    for name in CHECKED:
        found = studies.each(name, partial(check_once, name), range(runs))
        done = [one for one in found if one is not None]
        far = sum(one.farthest > FAR for one in done)
        worst = max((one.farthest for one in done), default=math.nan)
        studies.show(
            f"scene arm, {name}: {far} of {runs} recordings with a coordinate beyond {FAR:g} "
            f"sigma, farthest {worst:.1f}, NEES {np.mean([one.nees for one in done]):.3f}, "
            f"fail {runs - len(done)}",
        )


def main() -> None:
    """Print a line a case as soon as it is done."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int)
    add_options(parser)
    parser.add_argument("--beams", type=int, nargs="+", default=[4, 1])
    parser.add_argument("--a", type=float, nargs="+", default=A)
    parser.add_argument("--motion", type=float, default=MOTION, help="see robot_cell.Scene")
    parser.add_argument("--given", action="store_true")
    parser.add_argument("--kind", choices=list(KINDS), default="each", help="see robot_cell.Scene")
    parser.add_argument("--scene-check", action="store_true")
    arguments = parser.parse_args()
    cases = [
        Case(beams, a, arguments.given, arguments.motion, arguments.kind)
        for beams in arguments.beams
        for a in arguments.a
    ]
    with Studies.of(arguments) as studies:
        if arguments.scene_check:
            scene_check(arguments.runs or 100, studies)
        else:
            study(cases, arguments.runs or 200, studies)


if __name__ == "__main__":
    main()
