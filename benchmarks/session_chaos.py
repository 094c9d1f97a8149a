"""Random sequences of what happens to a session, compared with the batch solution at the end.

    python -m benchmarks.session_chaos [--sequences 1000] [--jobs J]

Planes and stations are added and removed, bad data are offered, exceptions and Ctrl-C fall into the
evaluation of factors at a random call. A sequence is good when nothing but the exception itself came
out and the beams agree with the batch solution to a hundredth of a standard deviation at its end.
"""

import argparse
import os
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace

import gtsam
import numpy as np
from rich.progress import Progress

import handlaser_gtsam as hl
from handlaser_gtsam.factors import Evaluation, RangeBlock
from handlaser_gtsam.scenes import SCENES, Layout
from handlaser_gtsam.simulate import Errors, simulate

SIGMA, PLANES, STATIONS, BEAMS, STEPS = 3e-5, 14, 9, 2, 15
AGREED = 0.01
ACTIONS = ("add", "remove plane", "remove station", "bad data", "exception", "Ctrl-C")


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
        elif fresh:
            error = KeyboardInterrupt if action == "Ctrl-C" else ValueError
            with _Falling(error, int(rng.integers(0, 8))):
                session.add(fresh[0])
                fresh.pop(0)
    except (hl.InputError, KeyboardInterrupt, ValueError):
        return


def run_once(seed: int) -> str:
    """Return how a sequence ended."""
    rng = np.random.default_rng(seed)
    truth, stations = SCENES["unplanned"](Layout(BEAMS, PLANES, STATIONS), rng)
    recording = simulate(truth, stations, Errors(SIGMA), rng)
    parts = [recording.part(np.flatnonzero(recording.plane_of_station == p)) for p in range(PLANES)]
    session = hl.Session(hl.Noise(SIGMA), hl.CalibrationOptions("none"))
    session.add(hl.join(parts[:5]))
    fresh = [replace(part) for part in parts[5:]]
    for _ in range(STEPS):
        act(session, str(rng.choice(ACTIONS)), fresh, rng)
    found = session.compare()
    good = found.largest < AGREED and found.largest_sigma < AGREED
    return "agrees" if good else f"off by {found.largest:.2g} sigma (seed {seed})"


def main() -> None:
    """Print how the sequences ended."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sequences", type=int, default=1000)
    parser.add_argument("--jobs", type=int, default=os.cpu_count())
    arguments = parser.parse_args()
    count: Counter[str] = Counter()
    with Progress() as bar, ProcessPoolExecutor(arguments.jobs) as pool:
        task = bar.add_task("sequences", total=arguments.sequences)
        for one in pool.map(run_once, range(arguments.sequences), chunksize=4):
            count[one] += 1
            bar.advance(task)
    for outcome, number in count.most_common():
        print(f"{number:6}  {outcome}")


if __name__ == "__main__":
    main()
