"""Which readings a calibration uses, and their joint solution.

Readings outside the sensor's range are rejected first, then outliers, then readings that meet their
plane too flat. Outliers are tested again with the final model: range errors may have looked like them.
Once the choice rests, `SolutionTask.finished` has GTSAM end the solution, and integrates over scales.
"""

from dataclasses import dataclass, replace

import numpy as np

from ..arrays import BoolArray, IntArray
from ..data.noise import SIGMAS, Noise
from ..data.parameters import Parameters
from ..data.recording import Readings, Recording
from ..model import sensor_limits as limits
from ..model.distributions import SINGLE_LEVEL, chi2_sf, gaussian_sf, student_quantile
from ..model.equation import residuals_or_infinite as residuals
from ..model.families import count_unknowns
from ..model.weighting import reading_sigmas
from ..observability.motion import poor_motion
from ..outliers.consensus import Consensus, find_consensus
from ..outliers.reading_tests import cut, enough, judge, test
from ..quantities import MEDIAN_TO_SIGMA, MOST_ROUNDS
from ..starts import find_start
from .joint_solution import SolutionTask, settle
from .options import CalibrationOptions
from .solution import Solution


@dataclass(frozen=True, slots=True)
class Selection:
    """The readings that were used, and their solution.

    Attributes
    ----------
    used : (N,) of bool
    outside, flat : (N,) of bool
        Rejected by the sensor's limits; every other reading that is not used is an outlier.
    method : str
        Method of the start that led to the solution.
    tried : tuple of (str, float)
        Every start that was tried, with the rms of its residuals [m].
    solution : Solution
        Solution of the readings `used`, in their order.
    contradicted : tuple of str
        Fields of the noise that the readings contradict: they were estimated.
    """

    used: BoolArray
    outside: BoolArray
    flat: BoolArray
    method: str
    tried: tuple[tuple[str, float], ...]
    solution: Solution
    contradicted: tuple[str, ...]

    def outliers(self) -> BoolArray:
        """Return which readings (N,) were rejected because the others contradict them."""
        return ~(self.used | self.outside | self.flat)


def select(
    recording: Recording,
    readings: Readings,
    noise: Noise,
    options: CalibrationOptions,
    start: Parameters | None = None,
    taken: BoolArray | None = None,
) -> Selection:
    """Choose readings and solve them jointly, from a start or from one that is sought.

    The first solution from a given start takes the readings `taken` (N,), or all that it can predict.

    Raises
    ------
    InputError
        The sensor's limits leave a beam or a plane without readings.
    """
    inside = options.sensor.can_read(readings.distance)
    limits.require_all(recording, readings.subset(np.flatnonzero(inside)))
    rows = np.flatnonzero(inside)
    part = readings.subset(rows)
    if start is None:
        first = _first(part, noise, options)
    else:  # all readings count that the given start can predict
        k = np.where(np.arange(2) < options.terms, start.range_errors, 0.0)
        start = replace(start, range_errors=k)
        kept = np.isfinite(residuals(start, part))
        if taken is not None:
            kept &= taken[rows]
        first = Consensus((), kept, start, "given", _scale(part, start))
    used, flat = inside.copy(), np.zeros_like(inside)
    used[rows] = first.kept

    def solved(start: Parameters, used: BoolArray) -> SolutionTask:
        chosen = readings.subset(np.flatnonzero(used))
        limits.require_all(recording, chosen)
        return settle(chosen, start, noise, options, first.range_sigma)

    settled = solved(first.parameters, used)
    if (used != inside).any() and not settled.solution.observability.full:
        whole = solved(first.parameters, inside)
        if _needs_what_was_rejected(whole.solution, settled.solution, noise):
            used, settled = inside.copy(), whole
    given, noise = noise, settled.noise
    for _ in range(MOST_ROUNDS):
        before, solution = used.copy(), settled.solution
        if options.outliers == "reject":
            used = _tested(readings, inside & ~flat, used, solution, noise)
        flat = np.zeros_like(inside)
        if solution.observability.full:  # else the incidence is any
            at, sensor = solution.parameters, options.sensor
            flat = inside & ~limits.within_incidence(readings, at, sensor)
        used &= ~flat
        if (used == before).all():
            break
        again = solved(solution.parameters, used)
        if _needs_what_was_rejected(solution, again.solution, noise):
            used = before
            break
        settled, noise = again, again.noise
    gone = tuple(name for name in SIGMAS if getattr(noise, name) != getattr(given, name))
    how = first.method, first.tried
    return Selection(used, ~inside, flat, *how, settled.finished(), gone)


def _needs_what_was_rejected(before: Solution, after: Solution, noise: Noise) -> bool:
    """Tell whether a rejection leaves something undetermined that readings which fit had determined.

    Of a few readings, one that decides alone is soon a little far from the others.
    """
    if noise.range_sigma is None or not before.observability.full or after.observability.full:
        return False
    return before.dof > 0 and float(chi2_sf(before.chi2, before.dof)) > SINGLE_LEVEL


def _first(readings: Readings, noise: Noise, options: CalibrationOptions) -> Consensus:
    """Return where the joint solution starts, which readings it takes, and their scale."""
    terms = options.terms
    # Residuals as small as the range sigma are good ones; larger ones may be errors of the poses.
    certain = noise.incidence_sigma == 0.0 and not options.counts_poses(noise)
    sigma = noise.range_sigma
    if options.outliers == "reject":
        consensus = find_consensus(readings, sigma, terms, certain)
    else:
        start = find_start(readings, sigma, terms, certain=certain)
        everything = np.ones(len(readings), dtype=bool)
        consensus = Consensus(start.tried, everything, start.parameters, start.method, None)
    motion = poor_motion(readings) if options.linearity is not None else None
    if motion is not None and motion.kind == "planar":
        # Range errors were free, which a prior will hold: elevations are any then, and end level.
        good = readings.subset(np.flatnonzero(consensus.kept))
        start = find_start(good, terms=0, effort="normal")
        consensus = consensus._replace(parameters=start.parameters, method=start.method)
    steep = np.isfinite(residuals(consensus.parameters, readings))
    scale = consensus.range_sigma or _scale(readings, consensus.parameters)
    return consensus._replace(kept=consensus.kept & steep, range_sigma=scale)


def _scale(readings: Readings, parameters: Parameters) -> float | None:
    """Return a standard deviation of the residuals [m] that outliers do not spoil."""
    e = np.abs(residuals(parameters, readings))
    total = len(e)
    unknowns = count_unknowns(readings, 0)
    sigma = MEDIAN_TO_SIGMA * float(np.median(e)) * np.sqrt(total / max(total - unknowns, 1))
    return float(sigma) if np.isfinite(sigma) and sigma > 0.0 else None


def _tested(
    readings: Readings, allowed: BoolArray, used: BoolArray, solution: Solution, noise: Noise
) -> BoolArray:
    """Return which allowed readings agree with the solution of the readings `used`."""
    rows: IntArray = np.flatnonzero(allowed)
    part, kept = readings.subset(rows), used[rows]
    terms = solution.terms
    if not solution.observability.full or not enough(part, kept, terms):
        return used
    if solution.variances is None:
        _, sigma, t = test(part, kept, solution.parameters, terms, noise.range_sigma)
    else:
        # The last stations may have no reading among those used.
        variances = solution.variances.for_stations(int(part.station.max()) + 1)
        sigmas = reading_sigmas(solution.parameters, part, variances)
        known = not solution.scales_estimated
        sigma, t = judge(part, kept, solution.parameters, terms, sigmas, known=known)
    far = cut(part, kept, sigma)
    if noise.range_sigma is None or solution.scales_estimated:
        # Few readings make their own scale small: what is far in units of it need not be an outlier.
        far = -float(student_quantile(gaussian_sf(far), max(solution.redundancy, 1)))
    agreeing = np.abs(t) <= far
    if not enough(part, agreeing, terms):
        return used
    tested = np.zeros_like(used)
    tested[rows] = agreeing
    return tested
