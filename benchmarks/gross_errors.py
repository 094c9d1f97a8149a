"""Whether wrong plane labels and readings that are codes are found, and nothing else is accused.

    python -m benchmarks.gross_errors [--runs 100] [--jobs 1] [--first-seed 0] [--given]
                                      [--labels 14 20 30] [--codes 0 0.999 8.191 65.535 65535] [--more]

The scenes are those of `benchmarks.right_angles`: an arm with joint errors and ray-cast plates, a
table and a wall at right angles, four beams. --labels counts the stations before each plate of which
one has the label of the other; --codes are the readings [m] that replace three and ten of 112, before
two plates at right angles, and before six; --more adds two and three wrong labels, an exchange, few
stations, other planes, and no gross errors at all. --given states the range sigma.

A run is `solved` when its status is converged and every coordinate of every beam lies within five of
its standard deviations and within 20 mm and 2 degrees of the truth, with no more than one good
reading of 25 rejected. Wrong labels are `named` when the warnings name these stations, each with the
plane that it sees, and no other. A `wrong hint` is a way to read the file or a label that is wrong.
Runs `within 5 sigma` are those without the limits of 20 mm and 2 degrees, which a recording misses
where its motion tells no more. Of the runs that are not right it is counted in how many the gross
errors have no part: the result is that of the same recording with the bad readings taken out by hand.
"""

import argparse
import math
import re
import time
from collections import Counter
from dataclasses import dataclass, field
from functools import partial

import numpy as np

import handlaser_gtsam as hl
from benchmarks.right_angles import Scene, Truth, coded, exchanged, plates, relabelled, stations_of
from benchmarks.studies import Studies, add_options
from handlaser_gtsam.arrays import BoolArray, FloatArray

FAR = 5.0
MOST_LOCATION, MOST_TURN = 0.02, math.radians(2.0)
MOST_LOST = 0.04
LABEL = re.compile(r"station (\S+) is labelled plane (\S+) but fits plane (\S+):")
HINT = "read so, the readings fit"


@dataclass(frozen=True, slots=True)
class Case:
    """A scene and its gross errors: wrong labels, an exchange of two, or readings that are a code."""

    name: str
    scene: Scene = field(default_factory=Scene)
    wrong: int = 0
    exchange: bool = False
    code: float = math.nan
    count: int = 0


@dataclass(frozen=True, slots=True)
class Judged:
    """Whether one run was solved, its labels named, without a wrong hint; and what went wrong."""

    seed: int
    within: bool
    solved: bool
    named: bool
    hinted: bool
    why: str
    seconds: float
    by_hand: bool = False
    """Whether a result that is not right is what taking the bad readings out by hand gives."""


def made(case: Case, seed: int) -> tuple[hl.Recording, Truth, dict[str, str], BoolArray]:
    """Return a recording, its truth, what the stations of wrong label see, and the bad readings."""
    recording, truth = plates(case.scene, np.random.default_rng(seed))
    rng = np.random.default_rng((seed, 1))
    seen: dict[str, str] = {}
    bad = np.zeros(recording.ranges.shape, dtype=bool)
    if case.wrong:
        recording, seen = relabelled(recording, case.wrong, rng)
    if case.exchange:
        recording, seen = exchanged(recording, rng)
    if case.count:
        recording, bad = coded(recording, case.count, case.code, rng)
    bad[stations_of(recording, seen)] = True
    return recording, truth, seen, bad


def run_once(case: Case, given: bool, seed: int) -> Judged:
    """Calibrate one recording and compare with the truth."""
    recording, truth, seen, bad = made(case, seed)
    since = time.perf_counter()
    noise = hl.Noise(case.scene.range_sigma if given else None)
    try:
        result = hl.calibrate(recording, noise)
    except hl.HandlaserError as error:
        return Judged(seed, False, False, False, False, str(error), time.perf_counter() - since)
    seconds = time.perf_counter() - since
    why = _missed(result, truth) or _lost(result, recording, bad)
    accused = {m[1]: m[3] for one in result.warnings if (m := LABEL.search(one.message))}
    hinted = any(HINT in one.message for one in result.warnings) or bool(
        accused.keys() - seen.keys()
    )
    named = accused == seen
    if not named:
        why = why or f"accused {accused}, wrong are {seen}"
    solved = not _missed(result, truth) and not why.startswith("lost")
    by_hand = not solved and named and _same(result, hl.calibrate(recording.without(bad), noise))
    within = result.status == "converged" and _sigmas(result, truth) <= FAR
    return Judged(seed, within, solved, named, hinted, why, seconds, by_hand)


def _same(one: hl.Calibration, other: hl.Calibration) -> bool:
    """Tell whether two results agree within a tenth of a standard deviation."""
    if other.status != "converged":
        return False
    pairs = [(beam, other.beams[name]) for name, beam in one.beams.items()]
    return all(
        b.sigma is not None
        and (np.abs(a.location - b.location) <= 0.1 * b.sigma[:3]).all()
        and (np.abs(a.direction - b.direction) <= 0.1 * b.sigma[3:6]).all()
        for a, b in pairs
    )


def _missed(result: hl.Calibration, truth: Truth) -> str:
    """Say how a result misses the truth; nothing where it does not."""
    if result.status != "converged":
        return f"{result.status}: {result.message[:70]}"
    z, found = _sigmas(result, truth), _found(result)
    if not z <= FAR:
        return f"{z:.1f} sigma off"
    away = np.abs(found[:, :3] - truth.locations).max()
    turn = np.arccos(np.clip((found[:, 3:6] * truth.directions).sum(axis=1), -1.0, 1.0)).max()
    if away > MOST_LOCATION or turn > MOST_TURN:
        return f"{away * 1e3:.1f} mm, {math.degrees(turn):.1f} deg off"
    return ""


def _found(result: hl.Calibration) -> FloatArray:
    beams = result.beams.values()
    return np.array([np.concatenate((b.location, b.direction, b.range_error)) for b in beams])


def _sigmas(result: hl.Calibration, truth: Truth) -> float:
    """Return by how many of its standard deviations the worst coordinate is off."""
    true = np.hstack((truth.locations, truth.directions, truth.range_errors))
    sigma = np.array([b.sigma for b in result.beams.values()])
    return float((np.abs(_found(result) - true) / np.where(sigma > 0.0, sigma, np.inf)).max())


def _lost(result: hl.Calibration, recording: hl.Recording, bad: BoolArray) -> str:
    """Say how many good readings were rejected, where those are many."""
    lost = sum(
        not bad[recording.station_names.index(r.station), recording.beam_names.index(r.sensor)]
        for r in result.fit.rejected
    )
    good = int((~bad).sum())
    return f"lost {lost} of {good} good readings" if lost > MOST_LOST * good else ""


def line(case: Case, runs: list[Judged]) -> str:
    """Return the figures of a case, and its first failures."""
    seconds: FloatArray = np.array([one.seconds for one in runs])
    counts = Counter(
        name
        for one in runs
        for name in ("within", "solved", "named", "hinted")
        if getattr(one, name)
    )
    both = sum(one.solved and one.named for one in runs)
    text = (
        f"{case.name}: {both} of {len(runs)} right (solved {counts['solved']}, "
        f"within 5 sigma {counts['within']}, named {counts['named']}), "
        f"wrong hints {counts['hinted']}; "
        f"{np.median(seconds):.2f} s, most {seconds.max():.2f} s"
    )
    by_hand = sum(one.by_hand for one in runs)
    if by_hand:
        text += f"; {by_hand} as wrong with the bad readings taken out by hand"
    failed = [one for one in runs if one.why or one.hinted]
    for one in failed[:8]:
        text += f"\n    seed {one.seed}: {one.why or 'wrong hint'}"
    return text


def label_cases(stations: list[int]) -> list[Case]:
    """Return one wrong label before two plates at right angles."""
    return [
        Case(f"1 wrong label, 2 x {count} stations", Scene(stations=count), wrong=1)
        for count in stations
    ]


def code_cases(codes: list[float]) -> list[Case]:
    """Return three and ten of 112 readings that are a code, before two plates and before six."""
    scenes = {"2 plates": Scene(), "6 plates": Scene(planes=6, stations=5)}
    return [
        Case(f"{count} readings of {code:g} m, {name}", scene, code=code, count=count)
        for name, scene in scenes.items()
        for code in codes
        for count in (3, 10)
    ]


def more_cases() -> list[Case]:
    """Return what else may be wrong with labels, and nothing."""
    general = Scene(general=True)
    return [
        Case("nothing wrong, 2 x 14", Scene()),
        Case("nothing wrong, 2 x 14 general", general),
        Case("2 wrong labels, 2 x 14", Scene(), wrong=2),
        Case("3 wrong labels, 2 x 20", Scene(stations=20), wrong=3),
        Case("labels exchanged, 2 x 14", Scene(), exchange=True),
        Case("1 wrong label, 2 x 8", Scene(stations=8), wrong=1),
        Case("1 wrong label, 2 x 14 general", general, wrong=1),
        Case("1 wrong label, 3 x 10", Scene(planes=3, stations=10), wrong=1),
        Case("1 wrong label, 4 x 10", Scene(planes=4, stations=10), wrong=1),
        Case("1 wrong label, 6 x 6", Scene(planes=6, stations=6), wrong=1),
        Case("3 wrong labels, 6 x 8", Scene(planes=6, stations=8), wrong=3),
    ]


def main() -> None:
    """Print a line a case as soon as it is done."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=100)
    add_options(parser, jobs=1)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--labels", type=int, nargs="*", default=[14, 20, 30])
    parser.add_argument(
        "--codes", type=float, nargs="*", default=[0.0, 0.999, 8.191, 65.535, 65535.0]
    )
    parser.add_argument("--more", action="store_true")
    parser.add_argument("--given", action="store_true")
    arguments = parser.parse_args()
    cases = label_cases(arguments.labels) + code_cases(arguments.codes)
    cases += more_cases() if arguments.more else []
    seeds = range(arguments.first_seed, arguments.first_seed + arguments.runs)
    with Studies.of(arguments) as studies:
        for case in cases:
            found = studies.each(case.name, partial(run_once, case, arguments.given), seeds)
            studies.show(line(case, found))


if __name__ == "__main__":
    main()
