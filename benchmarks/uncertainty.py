"""Whether standard deviations tell the truth when the robot errs: Monte Carlo over the paper's scene.

    python -m benchmarks.uncertainty [--runs N] [--jobs J] [--scene paper|unplanned]

Every run draws stations, errors of the hand poses (0.05 mm and 0.03 deg, about and along the hand's Y
axis only, as in the paper, or about all axes) and of the readings (0.03 mm), and calibrates with the
defaults but without range errors, as the scene has none. NEES is the squared error of all beams in
their covariance, over the number of unknowns: 1 for an honest one. Coverage counts how often 95 %
intervals of single coordinates hold the truth.
"""

import argparse
import math
from dataclasses import dataclass
from functools import partial

import numpy as np

import handlaser_gtsam as hl
from benchmarks.studies import Studies, add_options
from handlaser_gtsam.arrays import FloatArray
from handlaser_gtsam.data.parameters import Parameters
from handlaser_gtsam.estimation.options import Poses
from handlaser_gtsam.validation.scenes import SCENES, Layout
from handlaser_gtsam.validation.simulate import Errors, simulate

RANGE_SIGMA, TRANSLATION_SIGMA, ROTATION_SIGMA = 3e-5, 5e-5, math.radians(0.03)
AXES = {"Y axis": (1,), "all axes": (0, 1, 2)}
MODES: tuple[Poses, ...] = ("exact", "marginalised", "estimated")


@dataclass(frozen=True, slots=True)
class Run:
    """One calibration: NEES an unknown, coverage of 95 % intervals, squared errors of r and v."""

    nees: float
    coverage: float
    location: float
    direction: float


@dataclass(frozen=True, slots=True)
class Summary:
    """Over all runs: means of NEES and coverage, rms errors of r [m] and v [rad]."""

    runs: int
    nees: float
    nees_error: float
    coverage: float
    location: float
    direction: float


def pose_covariance(axes: tuple[int, ...]) -> FloatArray:
    """Return the covariance (6, 6) of hand poses that err along and about some axes."""
    variance = np.zeros(6)
    for axis in axes:
        variance[axis], variance[3 + axis] = ROTATION_SIGMA**2, TRANSLATION_SIGMA**2
    return np.diag(variance)


def run_once(seed: int, scene: str, axes: tuple[int, ...]) -> dict[Poses, Run] | None:
    """Calibrate one draw in all three ways; None where one of them does not converge."""
    rng = np.random.default_rng(seed)
    truth, stations = SCENES[scene](Layout(), rng)
    errors = Errors(RANGE_SIGMA, TRANSLATION_SIGMA, ROTATION_SIGMA, axes)
    recording = simulate(truth, stations, errors, rng)
    noise = hl.Noise(RANGE_SIGMA, pose_covariance=pose_covariance(axes))
    found = {}
    for mode in MODES:
        result = hl.calibrate(recording, noise, hl.CalibrationOptions("none", poses=mode))
        if result.covariance is None:
            return None
        found[mode] = judge(result, truth)
    return found


def judge(result: hl.Calibration, truth: Parameters) -> Run:
    """Compare a calibration with the truth."""
    joint = result.covariance
    assert joint is not None
    beams = list(result.beams.values())
    found = np.array([np.concatenate((b.location, b.direction, b.range_error)) for b in beams])
    true = np.hstack((truth.locations, truth.directions, truth.range_errors))
    e = (found - true).ravel()
    lift = np.zeros((e.size, len(joint.beams)))
    first = 0
    for i in range(len(beams)):
        own = joint.beam_lifts()[i]
        lift[8 * i : 8 * i + 8, first : first + own.shape[1]] = own
        first += own.shape[1]
    tangent = lift.T @ e
    sigma = np.sqrt(np.diagonal(joint.beams))
    z = np.linalg.solve(joint.beams / np.outer(sigma, sigma), tangent / sigma)
    ambient = np.sqrt(np.diagonal(joint.matrix(planes=[])))
    seen = ambient > 0.0
    turn = np.linalg.norm(np.cross(found[:, 3:6], true[:, 3:6]), axis=1)
    return Run(
        float((tangent / sigma) @ z) / len(tangent),
        float((np.abs(e[seen]) <= 1.959964 * ambient[seen]).mean()),
        float(((found[:, :3] - true[:, :3]) ** 2).sum(axis=1).mean()),
        float((turn**2).mean()),
    )


def summarized(runs: list[Run]) -> Summary:
    """Return means over runs."""
    nees = np.array([run.nees for run in runs])
    return Summary(
        len(runs),
        float(nees.mean()),
        float(nees.std() / np.sqrt(len(runs))),
        float(np.mean([run.coverage for run in runs])),
        float(np.sqrt(np.mean([run.location for run in runs]))),
        float(np.sqrt(np.mean([run.direction for run in runs]))),
    )


def study(runs: int, studies: Studies, scene: str) -> dict[str, dict[Poses, Summary]]:
    """Return a summary for each kind of pose error and each way to treat it."""
    found: dict[str, dict[Poses, Summary]] = {}
    for name, axes in AXES.items():
        each = studies.each(name, partial(run_once, scene=scene, axes=axes), range(runs))
        done = [one for one in each if one is not None]
        studies.show(f"{name}: {runs - len(done)} of {runs} not converged")
        found[name] = {mode: summarized([one[mode] for one in done]) for mode in MODES}
    return found


def main() -> None:
    """Print a line for each kind of pose error and each way to treat it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=1000)
    add_options(parser)
    parser.add_argument("--scene", choices=sorted(SCENES), default="paper")
    arguments = parser.parse_args()
    with Studies.of(arguments) as studies:
        found = study(arguments.runs, studies, arguments.scene)
    for name, modes in found.items():
        for mode, s in modes.items():
            print(
                f"{name:8} {mode:12}: NEES/dof {s.nees:.3f} +- {s.nees_error:.3f}, coverage "
                f"{100 * s.coverage:.1f} %, rms r {s.location * 1e3:.3f} mm, "
                f"v {math.degrees(s.direction):.3f} deg"
            )
        ratio = modes["marginalised"].direction / modes["exact"].direction
        print(f"{name}: rms of v, marginalised / exact = {ratio:.3f}")


if __name__ == "__main__":
    main()
