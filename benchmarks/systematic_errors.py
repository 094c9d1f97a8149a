"""Whether systematic errors are found, rightly named, and bounded as stated: Monte Carlo.

    python -m benchmarks.systematic_errors [--runs 200] [--jobs 2] [--codes ...] [--motion 0.16]
                                           [--given | --default]

The scene is the robot cell of `benchmarks.defaults` with 4 beams and a = 0.3. Every recording is
calibrated as it is; then again, with the same random numbers, with one systematic error of 1.5 times
the size that the result states as detectable, and of just that size: positive and negative in turn,
because what the tests linearise is not the same in both directions. For an error that is local to a
plane these are the size and the effect stated for the plane, beam or station where it is injected.

    found      any systematic error is found, at 1.5 times and at once the stated size
    named      of those found at 1.5 times: the one with the smallest p-value is the injected one, or
               one of the two is among those that the other cannot be told from
    r, v       actual change of r, and of v, over the stated external reliability at the stated size:
               regression through zero over all beams and recordings, and the rms of what remains, as
               a part of the rms of the stated
    false      recordings without a systematic error in which one is found, of any kind (first line) and
               of this
    confounded results that say that this error cannot be seen at all

--given states the noise, --default does not.
"""

import argparse
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

import handlaser_gtsam as hl
from benchmarks.defaults import stated_noise
from benchmarks.robot_cell import CODES, MOTION, Scene, cell
from benchmarks.studies import Studies, add_options
from handlaser_gtsam.arrays import FloatArray, IntArray
from handlaser_gtsam.model.weighting import Variances, Whitening, whitening

FACTORS = (1.5, 1.0)
"""Sizes injected, as multiples of the one that the result states as detectable."""
LOCAL = ("displaced", "beam-on-plane")
"""Errors of one plane: the result states its worst member, so the injected one is asked for."""


@dataclass(frozen=True, slots=True)
class Stated:
    """What a clean recording states of one systematic error.

    Attributes
    ----------
    code : str
    found, confounded : bool
    detectable : float
    shift : (2, B, 3)
        Change of r [m] and v [rad] by an error of the size `detectable`.
    """

    code: str
    found: bool
    confounded: bool
    detectable: float
    shift: FloatArray


@dataclass(frozen=True, slots=True)
class Clean:
    """A recording without a systematic error: mounts (2, B, 3), and what is stated of each error."""

    mounts: FloatArray
    stated: tuple[Stated, ...]

    def of(self, code: str) -> Stated | None:
        """Return what is stated of an error; None where nothing is."""
        return next((one for one in self.stated if one.code == code), None)


@dataclass(frozen=True, slots=True)
class Injected:
    """A recording with a systematic error.

    Attributes
    ----------
    found, named : bool
        Whether any is found, and whether it is the right one.
    change : (2, B, 3)
        By how much r [m] and v [rad] differ from those without it.
    stated : (2, B, 3)
        The same as the result without it states.
    """

    found: bool
    named: bool
    change: FloatArray
    stated: FloatArray


def calibrated(
    scene: Scene, given: bool, seed: int
) -> tuple[hl.Calibration, hl.Recording, tuple[int, int]] | None:
    """Return a calibration, its recording and the subject of its error; None where there is none."""
    recording, truth = cell(scene, np.random.default_rng(seed))
    noise = stated_noise(scene, truth) if given else hl.Noise()
    try:
        result = hl.calibrate(recording, noise)
    except hl.HandlaserError:
        return None
    if result.covariance is None:
        return None
    return result, recording, truth.subject


def mounts(result: hl.Calibration) -> FloatArray:
    """Return r and v of all beams, (2, B, 3)."""
    beams = result.beams.values()
    return np.array([[beam.location for beam in beams], [beam.direction for beam in beams]])


def run_clean(scene: Scene, given: bool, codes: Sequence[str], seed: int) -> Clean | None:
    """Calibrate a recording without a systematic error."""
    done = calibrated(scene, given, seed)
    if done is None:
        return None
    result, recording, _ = done
    stated = []
    for one in result.systematic:
        detectable, shift = one.detectable, np.array([one.location_shift, one.direction_shift])
        if one.code in LOCAL and one.code in codes and not one.confounded:
            detectable, shift = of_member(
                replace(scene, code=one.code), result, recording, given, seed
            )
        stated.append(Stated(one.code, one.found, one.confounded, detectable, shift))
    return Clean(mounts(result), tuple(stated))


def of_member(
    scene: Scene, result: hl.Calibration, recording: hl.Recording, given: bool, seed: int
) -> tuple[float, FloatArray]:
    """Return the detectable size, and its effect, of the error of `scene` with this seed."""
    from handlaser_gtsam.results.projection import LinearRows
    from handlaser_gtsam.results.score_tests import ScoreTests

    _, truth = cell(scene, np.random.default_rng(seed))
    plane, other = truth.subject
    rows = LinearRows(*linearization(result, recording))
    every = ScoreTests(rows, None if given else result.fit.dof)
    chosen = (every.codes == scene.code) & (every.plane == plane)
    if scene.code == "displaced":
        chosen &= every.position == plane * scene.stations + other
    else:
        chosen &= every.beam == other
    if not chosen.any():
        return math.inf, np.full((2, scene.beams, 3), np.nan)
    member = np.flatnonzero(chosen)[:1]
    size = every.detectable[member]
    return float(size[0]), np.concatenate(every.moves(member, size)[:2])


def linearization(
    result: hl.Calibration, recording: hl.Recording
) -> tuple[hl.Parameters, hl.data.Readings, Whitening, FloatArray, IntArray]:
    """Return a solution, its readings, weights, the prior on k, and the order of the stations in time.

    Beams and planes keep the order of the recording, and every plane has a frame amid its stations.
    """
    readings = recording.readings()
    used = ~np.isnan(result.fit.residuals[readings.station, readings.beam])
    origins = readings.plane_means(readings.world_t_hand)
    readings = readings.subset(np.flatnonzero(used)).seen_from(origins)
    scaled = result.at_scales
    at = result.parameters() if scaled is None else scaled.parameters
    at = replace(at, offsets=at.offsets + (at.normals * origins).sum(axis=1))
    variances = result.variances or Variances(np.full(readings.beams, result.fit.range_sigma))
    prior = np.full((readings.beams, 2), np.inf)
    if scaled is not None and scaled.range_error_prior is not None:
        prior = scaled.range_error_prior.sigma
    return at, readings, whitening(at, readings, variances), prior, readings.station


def run_injected(
    scene: Scene, given: bool, factor: float, argument: tuple[int, Clean]
) -> Injected | None:
    """Calibrate a recording with an error of a multiple of its detectable size."""
    seed, clean = argument
    stated = clean.of(scene.code)
    if stated is None or not math.isfinite(stated.detectable):
        return None
    factor *= (-1.0) ** seed
    done = calibrated(replace(scene, size=factor * stated.detectable), given, seed)
    if done is None:
        return Injected(False, False, np.full_like(clean.mounts, np.nan), factor * stated.shift)
    result, _, _ = done
    change = mounts(result) - clean.mounts
    found = [one for one in result.systematic if one.found]
    if not found:
        return Injected(False, False, change, factor * stated.shift)
    first = min(found, key=lambda one: one.p_value)
    code, alike = scene.code, {one.code: one.alike for one in result.systematic}
    named = code == first.code or code in first.alike or first.code in alike.get(code, ())
    return Injected(True, named, change, factor * stated.shift)


def regression(runs: list[Injected], which: int) -> tuple[float, float]:
    """Return the slope of the actual change of r (0) or v (1) over the stated, and what remains."""
    stated = np.array([one.stated[which] for one in runs]).ravel()
    change = np.array([one.change[which] for one in runs]).ravel()
    seen = np.isfinite(stated) & np.isfinite(change)
    stated, change = stated[seen], change[seen]
    if not stated.any():
        return math.nan, math.nan
    slope = float(stated @ change / (stated @ stated))
    rest = change - slope * stated
    return slope, math.sqrt(float(rest @ rest / (stated @ stated)))


def line(code: str, clean: list[Clean], runs: list[list[Injected | None]]) -> str:
    """Return the numbers of one kind of error."""
    said = [one.of(code) for one in clean]
    untested = sum(one is None for one in said)
    confounded = sum(one is not None and one.confounded for one in said)
    false = sum(one is not None and one.found for one in said)
    tail = f"false {false}, confounded {confounded}" + (f", untested {untested}" * bool(untested))
    large, just = ([one for one in each if one is not None] for each in runs)
    if not large:
        return f"{code:17}: of {len(clean)}: {tail}"
    found = [one for one in large if one.found]
    words = []
    for which, name in enumerate("rv"):
        slope, rest = regression(just, which)
        words.append(f"{name} {slope:.3f} (rest {rest:.2f})")
    return (
        f"{code:17}: found {share(len(found), len(large))} at 1.5 times, "
        f"named {share(sum(one.named for one in found), len(found))}, "
        f"found {share(sum(one.found for one in just), len(just))} at once, "
        f"effect on {', '.join(words)}; of {len(clean)}: {tail}"
    )


def share(count: int, of: int) -> str:
    """Return a percentage."""
    return f"{100.0 * count / of:5.1f} %" if of else "    - %"


def study(scene: Scene, codes: Sequence[str], given: bool, runs: int, studies: Studies) -> None:
    """Print a line of false alarms, and a line for every kind of error."""
    tried = studies.each("none", partial(run_clean, scene, given, codes), range(runs))
    seeds = [(seed, one) for seed, one in enumerate(tried) if one is not None]
    clean = [one for _, one in seeds]
    alarms = sum(any(said.found for said in one.stated) for one in clean)
    studies.show(
        f"no systematic error: found in {share(alarms, len(clean))} of {len(clean)} recordings "
        f"(at most 1 %), fail {runs - len(clean)}",
    )
    for code in codes:
        every = []
        for factor in FACTORS:
            run = partial(run_injected, replace(scene, code=code), given, factor)
            every.append(studies.each(f"{code} x {factor:g}", run, seeds))
        studies.show(line(code, clean, every))


def main() -> None:
    """Print a line for every kind of error as soon as it is done."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=200)
    add_options(parser)
    parser.add_argument("--codes", nargs="+", choices=CODES, default=CODES)
    parser.add_argument("--motion", type=float, default=MOTION, help="see robot_cell.Scene")
    noise = parser.add_mutually_exclusive_group()
    noise.add_argument("--given", action="store_true", help="state the noise")
    noise.add_argument("--default", action="store_false", dest="given", help="state nothing")
    arguments = parser.parse_args()
    scene = Scene(beams=4, a=0.3, motion=arguments.motion)
    with Studies.of(arguments) as studies:
        study(scene, arguments.codes, arguments.given, arguments.runs, studies)


if __name__ == "__main__":
    main()
