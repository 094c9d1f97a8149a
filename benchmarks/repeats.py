"""Whether readings that were logged more than once are recognised: Monte Carlo over the robot cell.

    python -m benchmarks.repeats [--runs 20] [--jobs 2]

Every recording of 4 planes x 11 stations x 4 beams is calibrated with nothing given, as it is and with
a fault that loggers and programs make. A line a fault says in how many recordings the right code is
found (in a warning, or as that of the error that refuses the file), and in how many of the results a
coordinate of a beam is beyond five of its standard deviations. `false` counts recordings without any
fault in which one of these codes is found.
"""

import argparse
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy.spatial.transform import Rotation

import handlaser_gtsam as hl
from benchmarks.defaults import FAR, judge
from benchmarks.odd_readings import logged
from benchmarks.robot_cell import Scene, cell
from benchmarks.studies import Studies, add_options
from handlaser_gtsam.arrays import FloatArray

JITTER = 1e-7
"""Of poses [m, rad] and readings [m] that are held."""
TENTH = 1e-4
"""What a rounded copy is rounded to [m]."""
CODE, CODES = 65.535, 4
"""What stands for "no reading" [m], and how often."""
SATURATED = 12
"""Readings at the limit of a sensor that saturates."""

Fault = Callable[[hl.Recording, np.random.Generator], hl.Recording]


@dataclass(frozen=True, slots=True)
class Found:
    """The codes found in one recording, and the farthest coordinate in standard deviations."""

    codes: tuple[str, ...]
    farthest: float


def every(recording: hl.Recording, times: int) -> hl.Recording:
    """Return every station so many times in a row."""
    return logged(recording, np.repeat(np.arange(len(recording.plane_labels)), times))


def jittered(recording: hl.Recording, rng: np.random.Generator) -> hl.Recording:
    """Return a recording whose poses and readings jitter."""
    turn = Rotation.from_rotvec(JITTER * rng.standard_normal(recording.world_t_hand.shape))
    return replace(
        recording,
        world_R_hand=recording.world_R_hand @ turn.as_matrix(),
        world_t_hand=recording.world_t_hand
        + JITTER * rng.standard_normal(recording.world_t_hand.shape),
        ranges=recording.ranges + JITTER * rng.standard_normal(recording.ranges.shape),
    )


def copied(recording: hl.Recording, change: Callable[[FloatArray], FloatArray]) -> hl.Recording:
    """Return a recording whose second beam is a changed copy of the first."""
    ranges = recording.ranges.copy()
    ranges[:, 1] = change(ranges[:, 0])
    return replace(recording, ranges=ranges)


def coded(recording: hl.Recording, rng: np.random.Generator) -> hl.Recording:
    """Return a recording with some readings that are a code."""
    ranges = recording.ranges.copy()
    ranges.ravel()[rng.choice(ranges.size, CODES, replace=False)] = CODE
    return replace(recording, ranges=ranges)


def saturated(recording: hl.Recording) -> hl.Recording:
    """Return a recording whose longest readings are all at one limit."""
    limit = np.sort(recording.ranges.ravel())[-SATURATED]
    return replace(recording, ranges=np.minimum(recording.ranges, limit))


FAULTS: dict[str, tuple[str, Fault]] = {
    "column twice": ("column-twice", lambda recording, _: copied(recording, np.copy)),
    "column twice, rounded": (
        "column-twice",
        lambda recording, _: copied(recording, lambda d: TENTH * np.round(d / TENTH)),
    ),
    "column twice, jitter": (
        "column-twice",
        lambda recording, rng: copied(
            recording, lambda d: d + JITTER * rng.standard_normal(len(d))
        ),
    ),
    "column twice, in mm": (
        "column-twice",
        lambda recording, _: copied(recording, lambda d: 1e3 * d),
    ),
    "file twice": (
        "repeated-stations",
        lambda recording, _: logged(recording, np.tile(np.arange(len(recording.plane_labels)), 2)),
    ),
    "every row ten times": ("repeated-stations", lambda recording, _: every(recording, 10)),
    "rows held with jitter": (
        "repeated-stations",
        lambda recording, rng: jittered(every(recording, 10), rng),
    ),
    "codes": ("reading-code", coded),
    "saturated": ("reading-code", lambda recording, _: saturated(recording)),
}
"""The code that is right for each fault, and how it is made."""


def run_once(fault: str, seed: int) -> Found:
    """Calibrate one recording with a fault; without one where `fault` is empty."""
    rng = np.random.default_rng(seed)
    recording, truth = cell(Scene(planes=4, stations=11), rng)
    if fault:
        recording = FAULTS[fault][1](recording, rng)
    try:
        result = hl.calibrate(recording)
    except hl.HandlaserError as error:
        return Found((getattr(error, "code", ""),), 0.0)
    codes = tuple(warning.code for warning in result.warnings)
    true = np.hstack((truth.locations, truth.directions, truth.range_errors))
    judged = judge(result, true)
    return Found(codes, 0.0 if judged is None else judged.farthest)


def study(runs: int, studies: Studies) -> None:
    """Print a line for every fault."""
    known = {code for code, _ in FAULTS.values()}
    clean = studies.each("no fault", partial(run_once, ""), range(runs))
    false = sum(bool(known & set(one.codes)) for one in clean)
    far = sum(one.farthest > FAR for one in clean)
    studies.show(f"{'no fault':22}: false {false} of {runs}, beyond {FAR:g} sigma {far}")
    for fault, (code, _) in FAULTS.items():
        found = studies.each(fault, partial(run_once, fault), range(runs))
        flagged = sum(code in one.codes for one in found)
        far = sum(one.farthest > FAR for one in found)
        studies.show(f"{fault:22}: {code} in {flagged} of {runs}, beyond {FAR:g} sigma {far}")


def main() -> None:
    """Print a line a fault as soon as it is done."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=20)
    add_options(parser)
    arguments = parser.parse_args()
    with Studies.of(arguments) as studies:
        study(arguments.runs, studies)


if __name__ == "__main__":
    main()
