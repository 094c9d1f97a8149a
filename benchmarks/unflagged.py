"""Whether wrong numbers go by unflagged: recordings with readings that are not what they seem.

    python -m benchmarks.unflagged [--runs 50] [--jobs 2] [--kinds gaussian held ...] [--seeds]

Every kind of `benchmarks.odd_readings` is calibrated with the range sigma given and with nothing given.
A line tells, for each kind: how many converged, how many of these with a warning, and how many were
refused, undetermined or did not fit; how many of those without any warning have a coordinate of a beam
beyond five of its standard deviations, and how far the worst is; and how many of those with a warning.
At most one in 200 of all results without a warning may; the exit code is 1 where more do.
--seeds names the recordings behind these, with the codes of their warnings.
"""

import argparse
import sys
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

import handlaser_gtsam as hl
from benchmarks.odd_readings import KINDS, SIGMA, OddScene, odd_scene
from benchmarks.studies import Studies, add_options

FAR = 5.0
"""Standard deviations that no error of an honest result exceeds in a few hundred recordings."""
MOST_UNFLAGGED = 200
"""One in so many results without a warning may have a coordinate beyond them."""
LEAST_SHARE = 1e-6
"""A standard deviation below this part of the largest of its kind is rounding."""


@dataclass(frozen=True, slots=True)
class Outcome:
    """What became of one recording.

    Attributes
    ----------
    kind : str
    seed : int
    given : bool
        Whether the range sigma was.
    status : str
        Of the calibration, or `refused`.
    codes : tuple of str
        Of the warnings, or of the refusal where it has one.
    farthest : float
        Largest error of a coordinate of a beam in its standard deviation; zero where there is none.
    """

    kind: str
    seed: int
    given: bool
    status: str
    codes: tuple[str, ...]
    farthest: float

    @property
    def unflagged(self) -> bool:
        """Whether there is a result without any warning."""
        return self.status == "converged" and not self.codes


def outcome(kind: str, given: bool, seed: int) -> Outcome:
    """Calibrate one recording and compare it with the truth."""
    scene = odd_scene(kind, seed)
    noise = hl.Noise(SIGMA) if given else hl.Noise()
    try:
        found = hl.calibrate(scene.recording, noise)
    except hl.HandlaserError as error:
        return Outcome(kind, seed, given, "refused", (str(getattr(error, "code", "")),), 0.0)
    codes = tuple(one.code for one in found.warnings)
    return Outcome(kind, seed, given, found.status, codes, farthest(found, scene))


def farthest(found: hl.Calibration, scene: OddScene) -> float:
    """Return the largest error of a coordinate of a beam in units of its standard deviation."""
    truth, worst = scene.truth, 0.0
    if found.status != "converged":
        return worst
    for i, beam in enumerate(found.beams.values()):
        if beam.sigma is None:
            continue
        for mine, right, sigma in (
            (beam.location, truth.locations[i], beam.sigma[:3]),
            (beam.direction, truth.directions[i], beam.sigma[3:6]),
            (beam.range_error, truth.range_errors[i], beam.sigma[6:]),
        ):
            told = sigma > LEAST_SHARE * sigma.max()
            worst = max(worst, float((np.abs(mine - right)[told] / sigma[told]).max(initial=0.0)))
    return worst


def line(kind: str, given: bool, found: Sequence[Outcome]) -> str:
    """Return the line of a kind."""
    converged = [one for one in found if one.status == "converged"]
    silent = [one for one in found if one.unflagged]
    flagged = [one for one in converged if one.codes]
    wrong = [one for one in silent if one.farthest > FAR]
    known = [one for one in flagged if one.farthest > FAR]
    worst = max((one.farthest for one in silent), default=0.0)
    often = Counter(code for one in found for code in set(one.codes)).most_common(3)
    return (
        f"{kind:<14}{'given' if given else 'not':<7}{len(converged):>4}{len(flagged):>6}"
        f"{len(found) - len(converged):>6}{len(silent):>6}{len(wrong):>5}{worst:>7.1f}{len(known):>6}"
        f"   {', '.join(f'{code} {count}' for code, count in often)}"
    )


def study(kinds: Sequence[str], runs: int, studies: Studies, *, seeds: bool) -> bool:
    """Print a line for every kind; return whether few enough wrong results carry no warning."""
    everything: list[Outcome] = []
    studies.show("kind          sigma  conv  warn  none silent  >5  worst  warn>5   warnings")
    for kind in kinds:
        for given in (True, False):
            found = studies.each(kind, partial(outcome, kind, given), range(runs))
            studies.show(line(kind, given, found))
            for one in found if seeds else ():
                if one.farthest > FAR:
                    codes = ", ".join(one.codes) or "NO WARNING"
                    studies.show(f"    seed {one.seed}: {one.farthest:.1f} sigma, {codes}")
            everything += found
    silent = [one for one in everything if one.unflagged]
    wrong = sum(one.farthest > FAR for one in silent)
    studies.show(f"of {len(silent)} results without a warning {wrong} beyond {FAR:g} sigma")
    return wrong * MOST_UNFLAGGED <= len(silent)


def main() -> None:
    """Read the command line and print the study."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=50)
    add_options(parser, jobs=2)
    parser.add_argument("--kinds", nargs="+", choices=KINDS, default=KINDS)
    parser.add_argument("--seeds", action="store_true")
    given = parser.parse_args()
    with Studies.of(given) as studies:
        held = study(given.kinds, given.runs, studies, seeds=given.seeds)
    sys.exit(0 if held else 1)


if __name__ == "__main__":
    main()
