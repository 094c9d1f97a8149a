"""Does any file change its meaning, or end in a traceback? Thousands of mutated files say.

    python -m benchmarks.fuzz
    python -m benchmarks.fuzz --recordings 50000 --rigs 5000 --results 5000 --first-seed 0

Every file follows from its seed (`benchmarks.mutated_*`), is read by the package, and judged by readers
that share nothing with it (`benchmarks.plain_readers`): it must be refused in one line of printable
text, or be read as it plainly stands, with one station for every line. Files that are only written in
an unusual way must be read. Of a recording whose end was lost, what is read must be what was written.
"""

import argparse
import collections
import random
import sys
import tempfile
import time
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.progress import track

import handlaser_gtsam as hl

from .judged_readers import Outcome, WrongError, judge_recording, judge_result, judge_rig
from .mutated_fields import mutated_text, result_text, rig_text
from .mutated_tables import cut_recording, harmless_recording, mutated_recording
from .plain_readers import plain_recording

NANOMETRE = 1e-9
"""A number that is cut behind so many metres is none the worse."""
Judge = Callable[[Path, random.Random], Outcome]


def recording(path: Path, rng: random.Random) -> Outcome:
    """Judge one mutated recording."""
    return judge_recording(path, mutated_recording(rng))


def harmless(path: Path, rng: random.Random) -> Outcome:
    """Judge one recording that must be read."""
    if judge_recording(path, harmless_recording(rng)) == "refused":
        raise WrongError("refused, though it only is written in an unusual way")
    return "read"


def cut(path: Path, rng: random.Random) -> Outcome:
    """Judge one recording whose end was lost: what is read is what was written."""
    whole, left = cut_recording(rng)
    outcome = judge_recording(path, left)
    if outcome == "read":
        written, found = plain_recording(whole), hl.read_recording(path)
        part = written.ranges[: len(found.ranges)]
        moved = written.positions[: len(found.ranges)] - found.world_t_hand
        if not (np.isnan(part) == np.isnan(found.ranges)).all():
            raise WrongError("a reading was lost with the end of its line")
        if np.nanmax(np.abs(part - found.ranges)) > NANOMETRE or np.abs(moved).max() > NANOMETRE:
            raise WrongError("a number lost digits with the end of its line")
    return outcome


def rig(path: Path, rng: random.Random) -> Outcome:
    """Judge one mutated rig file."""
    return judge_rig(path, mutated_text(rig_text(rng), rng))


def result(path: Path, rng: random.Random) -> Outcome:
    """Judge one mutated result."""
    return judge_result(path, mutated_text(result_text(rng), rng))


def untouched(path: Path, rng: random.Random) -> Outcome:
    """Judge a rig file and a result to which nothing happened."""
    if judge_rig(path, rig_text(rng).encode()) == "refused":
        raise WrongError("a good rig file was refused")
    if judge_result(path, result_text(rng).encode()) == "refused":
        raise WrongError("a good result was refused")
    return "read"


def main() -> None:
    """Run as many files of each kind as asked; exit with 1 where one was judged wrong."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--recordings", type=int, default=2000)
    parser.add_argument("--rigs", type=int, default=500)
    parser.add_argument("--results", type=int, default=500)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--keep", type=Path, help="Folder for the files that were judged wrong.")
    arguments = parser.parse_args()
    warnings.simplefilter("error")
    kinds: tuple[tuple[str, Judge, int], ...] = (
        ("recordings", recording, arguments.recordings),
        ("recordings, harmless", harmless, arguments.recordings // 10),
        ("recordings, cut", cut, arguments.recordings // 5),
        ("rigs", rig, arguments.rigs),
        ("results", result, arguments.results),
        ("rigs and results, good", untouched, (arguments.rigs + arguments.results) // 20),
    )
    wrong = sum(_run(name, judge, count, arguments) for name, judge, count in kinds)
    sys.exit(1 if wrong else 0)


def _run(name: str, judge: Judge, count: int, arguments: argparse.Namespace) -> int:
    """Judge so many files of a kind, print what became of them, and return how many were wrong."""
    outcomes: collections.Counter[str] = collections.Counter()
    begin, console = time.perf_counter(), Console(stderr=True)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "file"
        seeds = range(arguments.first_seed, arguments.first_seed + count)
        for seed in track(seeds, name, console=console):
            try:
                outcomes[judge(path, random.Random(f"{name} {seed}"))] += 1
            except WrongError as error:
                outcomes["wrong"] += 1
                print(f"{name}, seed {seed}: {error}")
                if arguments.keep is not None:
                    arguments.keep.mkdir(parents=True, exist_ok=True)
                    (arguments.keep / f"{name} {seed}").write_bytes(path.read_bytes())
    seconds = time.perf_counter() - begin
    read, refused = outcomes["read"], outcomes["refused"]
    print(f"{name}: {read} read, {refused} refused, {outcomes['wrong']} wrong; {seconds:.0f} s")
    return outcomes["wrong"]


if __name__ == "__main__":
    main()
