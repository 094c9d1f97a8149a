"""Logs at full size: wrong conventions, a long table, large bags.

    python -m benchmarks.logs [--parts conventions table bags] [--scenes paper arm] [--all]
                              [--rows 200000] [--megabytes 200]

`conventions`: a recording is written under every convention and read under every other one, without
usual names of columns, with the hand held in three ways; a matrix of what is said for each. `--all`
adds every rotation in all units to the conventions of controllers.

`table`: a table of KUKA's with so many rows and four beams is read and checked; CPU time, best of
three.

`bags`: bags of so many megabytes of ROS 1, ROS 2 and MCAP, converted by the command; the largest
resident memory of that process (VmHWM: ru_maxrss counts what the parent had), and how long it took.
`scans`: one `LaserScan` of 1,000 rays beside each reading (the usual); `plain`: nothing but poses and
readings (the worst). `tf`: as `plain`, with four frames.

What misses a limit is named at the end of a line. Bags of millions of messages miss the limit of
memory, ROS 1 most: rosbags keeps an index of some 190 bytes a message.
"""

import argparse
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import polars as pl
from rich.progress import Progress
from scipy.spatial.transform import Rotation

import handlaser_gtsam as hl
from benchmarks.large_bags import KINDS, write_large
from benchmarks.log_conventions import (
    RESIDUAL,
    TURNS,
    UNNOTICED,
    WORDS,
    log_recording,
    matrix,
    meanings,
    study,
)
from handlaser_gtsam.model.conventions import formats_of

PARTS = ("conventions", "table", "bags")
MOST_SECONDS, MOST_MEGABYTES = 2.0, 300.0
LOADS = ("scans", "plain", "tf")
MEASURED = """
import pathlib, re, sys
from handlaser_gtsam.cli import main
sys.argv = ["handlaser", *sys.argv[1:]]
try:
    main()
finally:
    print(re.search(r"VmHWM:\\s*(\\d+)", pathlib.Path("/proc/self/status").read_text())[1])
"""
"""Runs the command, and says how many kilobytes it took at most."""


def conventions_lines(bar: Progress, scenes: list[str], *, every: bool) -> Iterator[str]:
    """Yield the matrices, and what is not noticed in each."""
    several = [one for one in meanings() if every or formats_of(one.meaning)]
    for scene in scenes:
        for turn in TURNS:
            pairs = study(log_recording(scene, turn), several)
            told = list(bar.track(pairs, len(several) ** 2, description=f"{scene}, {turn}"))
            yield f"{scene}, {turn}:"
            yield from matrix(told)
            unnamed = sum(one.outcome == RESIDUAL and not one.named for one in told)
            text = (
                f"not noticed: {sum(one.outcome == UNNOTICED for one in told)} of {len(told)} pairs"
            )
            text += f"; another than the right one named by the fit: {unnamed}"
            yield text + (
                "  MISSES all noticed" if UNNOTICED in [one.outcome for one in told] else ""
            )
    yield "; ".join(f"{letter} {words}" for letter, words in WORDS.items())


def table_line(rows: int) -> str:
    """Return how long a table takes to read and check."""
    rng = np.random.default_rng(0)
    turn = Rotation.from_rotvec(rng.uniform(-0.3, 0.3, (rows, 3)))
    t = rng.uniform(-0.2, 0.2, (rows, 3))
    n = np.array([0.1, 0.2, 1.0]) / np.sqrt(1.05)
    columns = {name: 1e3 * t[:, i] for i, name in enumerate("XYZ")}
    columns |= {name: turn.as_euler("ZYX", degrees=True)[:, i] for i, name in enumerate("ABC")}
    for beam in range(4):
        r, v = rng.uniform(-0.05, 0.05, 3), np.array([0.1 * beam, 0.0, 1.0])
        v /= np.linalg.norm(v)
        d = (1.0 - (t + turn.apply(r)) @ n) / (turn.apply(v) @ n)
        columns[f"range_{beam}"] = 1e3 * d + rng.standard_normal(rows)
    labels = {"plane": np.repeat(["A", "B"], [rows // 2, rows - rows // 2])}
    given = hl.LogFormat(pose_format="kuka", range_units="mm")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "log.csv"
        pl.DataFrame(labels | columns).write_csv(path)
        seconds = []
        for _ in range(3):
            begin = time.process_time()
            found = hl.read_log(path, given)
            seconds.append(time.process_time() - begin)
        size = path.stat().st_size / 1e6
    text = f"table of {len(found.ranges)} rows, {size:.0f} MB: {min(seconds):.2f} s"
    return text + ("" if min(seconds) <= MOST_SECONDS else f"  MISSES {MOST_SECONDS:g} s")


def bag_line(kind: str, load: str, megabytes: float, bar: Progress) -> str:
    """Return how much memory a bag takes, and how long."""
    with tempfile.TemporaryDirectory() as folder:
        path, size, messages = write_large(Path(folder), kind, load, 1e6 * megabytes, bar)
        words = ["convert", str(path), "--plane", "A", "--out", str(Path(folder) / "out.csv")]
        words += ["--frames", "base,hand"] if load == "tf" else []
        begin = time.perf_counter()
        run = subprocess.run(
            [sys.executable, "-c", MEASURED, *words], capture_output=True, text=True, check=True
        )
        seconds = time.perf_counter() - begin
        stations = len(hl.read_recording(Path(folder) / "out.csv").ranges)
    peak = int(run.stdout.split()[-1]) / 1024
    text = (
        f"{kind:5} {load:6} {size / 1e6:.0f} MB, {messages} messages, {stations} stations: "
        f"{peak:.0f} MB resident, {seconds:.0f} s"
    )
    return text + ("" if peak <= MOST_MEGABYTES else f"  MISSES {MOST_MEGABYTES:g} MB")


def main() -> None:
    """Print a line for every part as soon as it is done."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--parts", nargs="+", choices=PARTS, default=PARTS)
    parser.add_argument("--scenes", nargs="+", choices=("paper", "arm"), default=["paper", "arm"])
    parser.add_argument("--all", action="store_true")
    parser.add_argument("--rows", type=int, default=200_000)
    parser.add_argument("--megabytes", type=float, default=200.0)
    parser.add_argument("--loads", nargs="+", choices=LOADS, default=LOADS)
    given = parser.parse_args()
    with Progress() as bar:
        if "conventions" in given.parts:
            for line in conventions_lines(bar, given.scenes, every=given.all):
                bar.console.print(line, highlight=False, markup=False, soft_wrap=True)
        if "table" in given.parts:
            bar.console.print(table_line(given.rows), highlight=False, soft_wrap=True)
        if "bags" in given.parts:
            for load in given.loads:
                for kind in KINDS:
                    line = bag_line(kind, load, given.megabytes, bar)
                    bar.console.print(line, highlight=False, soft_wrap=True)


if __name__ == "__main__":
    main()
