"""Random sequences of what happens to a session, compared with the batch solution at the end.

    python -m benchmarks.session_chaos [--sequences 1000] [--jobs J]

Planes and stations are added and removed, bad data are offered, a beam is split because it moved,
exceptions and Ctrl-C fall into the evaluation of factors at a random call. Poses are exact,
marginalised or estimated, or range error and range sigma are found on the way, or systematic errors
are unknowns. A sequence is good when
nothing but the exception itself came out and, after every step, the beams agree with the batch solution
to a hundredth of a standard deviation.
"""

import argparse
import math
from collections import Counter
from dataclasses import replace

import gtsam
import numpy as np

import handlaser_gtsam as hl
from benchmarks.studies import Studies, add_options
from handlaser_gtsam.factors import Evaluation, RangeBlock
from handlaser_gtsam.validation.scenes import SCENES, Layout
from handlaser_gtsam.validation.simulate import Errors, simulate

SIGMA, PLANES, STATIONS, BEAMS, STEPS = 3e-5, 14, 9, 2, 15
AGREED = 0.01
ACTIONS = (
    "add",
    "remove plane",
    "remove station",
    "bad data",
    "gross errors",
    "split beam",
    "exception",
    "Ctrl-C",
)
ROBOT = (5e-5, math.radians(0.03))
MODES = (
    ("exact", hl.Noise(SIGMA, 0.0, 0.0), hl.CalibrationOptions("none")),
    ("marginalised", hl.Noise(SIGMA, *ROBOT), hl.CalibrationOptions("none")),
    ("estimated", hl.Noise(SIGMA, *ROBOT), hl.CalibrationOptions("none", poses="estimated")),
    ("unknown", hl.Noise(), hl.CalibrationOptions()),
    ("unknown, estimated", hl.Noise(), hl.CalibrationOptions(poses="estimated")),
    (
        "free errors",
        hl.Noise(SIGMA, 0.0, 0.0),
        hl.CalibrationOptions(
            "none", free=("lag", "incidence"), sensor=hl.Sensor(kind="triangulation")
        ),
    ),
)


class _Falling:
    """Lets the evaluation of blocks fail from a given call on, until the context ends."""

    def __init__(self, error: type[BaseException], after: int) -> None:
        self.error, self.after, self.calls = error, after, 0
        self.original = RangeBlock.evaluate

    def __enter__(self) -> None:
        def evaluate(
            block: RangeBlock, values: gtsam.Values
        ) -> tuple[Evaluation, tuple[slice, ...]]:
            self.calls += 1
            if self.calls > self.after:
                raise self.error("on purpose")
            return self.original(block, values)

        RangeBlock.evaluate = evaluate  # type: ignore[method-assign,assignment]

    def __exit__(self, *_: object) -> None:
        RangeBlock.evaluate = self.original  # type: ignore[method-assign]


def act(
    session: hl.Session, action: str, fresh: list[hl.Recording], rng: np.random.Generator
) -> None:
    """Do one thing to the session; what it refuses, it refuses with InputError."""
    try:
        if action == "add" and fresh:
            session.add(fresh[0])
            fresh.pop(0)
        elif action == "remove plane":
            session.remove_plane(str(rng.choice(session.planes)))
        elif action == "remove station":
            session.remove_station(str(rng.choice(session.recording().station_names)))
        elif action == "bad data":
            session.add(session.recording().part([0]))  # a station that is there already
        elif action == "gross errors" and fresh:
            session.add(_spoilt(fresh.pop(0), rng))
        elif action == "split beam":
            beams = session.beams().names
            session.split_beam(str(rng.choice(beams)), str(rng.choice(session.planes)))
        elif fresh:
            error = KeyboardInterrupt if action == "Ctrl-C" else ValueError
            with _Falling(error, int(rng.integers(0, 8))):
                session.add(fresh[0])
                fresh.pop(0)
    except hl.InputError:
        return
    except (KeyboardInterrupt, ValueError):
        if action not in ("exception", "Ctrl-C"):
            raise


def _spoilt(recording: hl.Recording, rng: np.random.Generator) -> hl.Recording:
    """Return a recording with two readings off by millimetres."""
    ranges = recording.ranges.copy()
    ranges.flat[rng.choice(ranges.size, 2, replace=False)] += rng.uniform(1e-3, 5e-3, 2)
    return replace(recording, ranges=ranges)


def run_once(seed: int) -> str:
    """Return how a sequence ended."""
    rng = np.random.default_rng(seed)
    name, noise, options = MODES[seed % len(MODES)]
    k = (0.02, 0.3) if name.startswith("unknown") else (0.0, 0.0)
    truth, stations = SCENES["unplanned"](Layout(BEAMS, PLANES, STATIONS, *k), rng)
    pose = (noise.pose_translation_sigma or 0.0, noise.pose_rotation_sigma or 0.0)
    recording = simulate(truth, stations, Errors(SIGMA, *pose), rng)
    parts = [recording.part(np.flatnonzero(recording.plane_of_station == p)) for p in range(PLANES)]
    session = hl.Session(noise, options)
    session.add(hl.join(parts[:5]))
    fresh = parts[5:]
    for step in range(STEPS):
        action = str(rng.choice(ACTIONS))
        act(session, action, fresh, rng)
        found = session.compare()
        if max(found.largest, found.largest_sigma) > AGREED:
            off = f"{found.largest:.2g} sigma, {100.0 * found.largest_sigma:.2g} %"
            return f"off by {off} (seed {seed}, {name}, step {step}, {action})"
    return f"agrees after every step, {name}"


def main() -> None:
    """Print how the sequences ended."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sequences", type=int, default=1000)
    add_options(parser)
    arguments = parser.parse_args()
    with Studies.of(arguments) as studies:
        count = Counter(studies.each("sequences", run_once, range(arguments.sequences)))
    for outcome, number in count.most_common():
        print(f"{number:6}  {outcome}")


if __name__ == "__main__":
    main()
