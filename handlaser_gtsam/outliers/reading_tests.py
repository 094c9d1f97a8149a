r"""Which readings to reject: the ones that the others contradict (data snooping, as geodesy has it).

`screen` does so for starts; `estimation.selection` tests the readings of the final solution: by `test`
where one standard deviation holds for all, which may be estimated, else by `judge`.

From a candidate that fits most readings, the far ones are rejected, the rest is fitted again, and all
readings are tested again against that fit, until nothing changes. Candidates are compared by the
evidence for "Gaussian among m readings, anything within the span W for the others":

    2 (N - u) ln sigma + RSS / sigma^2 + 2 (N - m) price - 2 ln(share of each)

with the u unknowns integrated over, which fit as many readings whatever these are, so that rejecting a
reading has its price, ln(W / (sqrt(2 pi) sigma)): about 4 standard deviations.

How much a reading pulls the solution to itself is its leverage: with unit weights the variance of a
predicted range is h = J inv(J'J) J'. The residual of a reading that was used has variance
sigma^2 (1 - h), and sigma^2 (1 + h) if it was not. With S the covariance of the beams, W_p the response
of a plane and P_p its covariance for known beams, a reading with the derivatives a by its beam i and c
by its plane has

    h = a' S_ii a - 2 a' (S W_p')_i c + c' (W_p S W_p' + P_p) c

so that nothing grows with the readings times the unknowns.
"""

from typing import NamedTuple

import numpy as np

from .. import model
from ..arrays import BoolArray, FloatArray
from ..data.parameters import Parameters
from ..data.recording import Readings
from ..errors import GrazingBeamError
from ..model.equation import residuals_or_infinite as residuals
from ..model.families import MOUNT_DIM, count_unknowns
from ..observability.rank import Observability, observability
from ..quantities import EXACT, FAR_SIGMAS, MAJORITY, MOST_ROUNDS, NEGLIGIBLE
from ..solvers.beam_problem import jacobian_columns, refine
from ..starts.rounds import LAST_STEPS

LEAST_CUT = 3.0
"""The cut in standard deviations is at least this: Gaussian errors exceed it once in 370. It is
`FAR_SIGMAS` at most."""
MOST_SNOOPED = 3
"""Readings that are rejected one after the other at most. With one, 3 of 56 recordings with two gross
errors among 36 readings were usable and wrong, with three none."""
LARGEST_LEVERAGES = 50_000_000
"""Readings times beam unknowns beyond which leverages are taken as zero: a single reading weighs little
there, and the information takes too long to invert."""


class Screening(NamedTuple):
    """Which readings agree on one solution.

    Attributes
    ----------
    kept : (N,) of bool
    parameters : Parameters
        Fitted to the readings that were kept.
    range_sigma : float
        Standard deviation behind the test [m]: the larger of the given and the estimated one.
    evidence : float
        Criterion above; lower is better.
    """

    kept: BoolArray
    parameters: Parameters
    range_sigma: float
    evidence: float


def screen(
    readings: Readings,
    candidate: Parameters,
    terms: int,
    range_sigma: float | None,
    scale: float | None = None,
) -> Screening | None:
    """Reject readings that contradict the rest, from `candidate` on.

    Parameters
    ----------
    readings : Readings
    candidate : Parameters
    terms : int
    range_sigma : float, optional
        Given standard deviation of a reading [m].
    scale : float, optional
        Standard deviation of the good readings about `candidate` [m]; all count as good at first
        where it is not given.

    Returns
    -------
    Screening or None
        None where too few readings agree, or a plane or a beam is left without any.
    """
    kept = np.ones(len(readings), dtype=bool)
    if scale is not None:
        kept = np.abs(residuals(candidate, readings)) <= FAR_SIGMAS * scale
    parameters, sigma = candidate, 0.0
    seen: set[bytes] = set()
    for _ in range(MOST_ROUNDS):
        if not enough(readings, kept, terms):
            return None
        try:
            parameters, sigma, t = test(readings, kept, parameters, terms, range_sigma)
        except GrazingBeamError:
            return None
        before, kept = kept, np.abs(t) <= cut(readings, kept, sigma)
        if (kept == before).all() or kept.tobytes() in seen:
            kept = before
            break
        seen.add(kept.tobytes())
    if not model.plausible_range_errors(parameters, readings.subset(np.flatnonzero(kept))):
        return None
    return Screening(kept, parameters, sigma, evidence(readings, kept, parameters, terms, sigma))


def snooped(
    readings: Readings, candidate: Parameters, terms: int, range_sigma: float | None
) -> Screening | None:
    """Reject the worst reading of a fit to all, then the worst of the rest, as the evidence says.

    Of few readings several are soon far from a fit that one gross error pulls, and a screening from
    elsewhere may keep it. The worst, in standard deviations of its own residual, is that one (Baarda,
    A Testing Procedure for Use in Geodetic Networks, 1968). Parameters are as of `screen`.

    Returns
    -------
    Screening or None
        The strongest evidence of all steps; None where too few readings are left at the first.
    """
    kept, parameters, best = np.ones(len(readings), dtype=bool), candidate, None
    for _ in range(MOST_SNOOPED + 1):
        if not enough(readings, kept, terms):
            break
        try:
            parameters, sigma, t = test(readings, kept, parameters, terms, range_sigma)
        except GrazingBeamError:
            break
        good = readings.subset(np.flatnonzero(kept))
        if not kept.all() and model.plausible_range_errors(parameters, good):
            by_rest = evidence(readings, kept, parameters, terms, sigma)
            if best is None or by_rest < best.evidence:
                best = Screening(kept.copy(), parameters, sigma, by_rest)
        kept[np.argmax(np.where(kept, np.abs(t), 0.0))] = False
    return best


def sigma_of(
    readings: Readings, residual: FloatArray, terms: int, range_sigma: float | None
) -> float:
    """Return the sigma [m] of the residuals of agreeing readings, at least the given one."""
    free = max(len(residual) - count_unknowns(readings, terms), 1)
    estimated = float(np.sqrt((residual @ residual) / free))
    return max(range_sigma or 0.0, estimated, EXACT * readings.largest_range())


def price(distance: FloatArray, range_sigma: float) -> float:
    """Return ln(W / (sqrt(2 pi) sigma)) for the span W of readings: the price of rejecting one.

    That is the logarithm of a ratio of densities: of an exact reading with the standard deviation
    sigma [m], and of a reading that may be anything within the span.
    """
    span = max(float(np.ptp(distance)), range_sigma)
    return float(np.log(span / (np.sqrt(2.0 * np.pi) * range_sigma)))


def cut(readings: Readings, kept: BoolArray, range_sigma: float) -> float:
    """Return the standard deviations beyond which readings are outliers, by the share of outliers.

    A residual of z standard deviations is as likely from a gross error as from a good reading where
    z^2 / 2 = ln(W (1 - share) / (sqrt(2 pi) sigma share)),

    and the cut is half a standard deviation below: a gross error that is kept costs more than a good
    reading that is rejected.
    """
    share = (int((~kept).sum()) + 1) / (len(kept) + 2)
    odds = price(readings.distance, range_sigma) + np.log((1.0 - share) / share)
    even = float(np.sqrt(2.0 * max(odds, 0.0)))
    return min(max(even - 0.5, LEAST_CUT), FAR_SIGMAS)


def test(
    readings: Readings, kept: BoolArray, start: Parameters, terms: int, range_sigma: float | None
) -> tuple[Parameters, float, FloatArray]:
    """Fit the `kept` readings from `start`; return parameters, sigma and residuals in their sigmas."""
    part = readings.subset(np.flatnonzero(kept))
    refined = refine(start, part, terms, LAST_STEPS)
    parameters = start if refined is None else refined.parameters
    sigma, t = judge(readings, kept, parameters, terms, np.full(len(readings), range_sigma or 0.0))
    return parameters, sigma, t


def judge(
    readings: Readings,
    kept: BoolArray,
    parameters: Parameters,
    terms: int,
    sigmas: FloatArray,
    *,
    known: bool = True,
) -> tuple[float, FloatArray]:
    """Return a typical sigma [m], and the residuals (N,) in their own sigmas.

    Parameters
    ----------
    readings : Readings
    kept : (N,) of bool
        Readings that `parameters` were fitted to.
    parameters : Parameters
    terms : int
    sigmas : (N,)
        Standard deviation of each reading [m]; zero where it is unknown. Larger residuals than
        these explain scale them.
    known : bool
        Whether smaller residuals do not scale them.
    """
    e = residuals(parameters, readings)
    unit = np.where(sigmas > 0.0, sigmas, 1.0)
    free = max(int(kept.sum()) - count_unknowns(readings, terms), 1)
    met = kept & np.isfinite(e)  # a beam that grazes its plane here has no residual
    z = e[met] / unit[met]
    estimated = float(np.sqrt((z @ z) / free))
    typical = float(np.median(unit[kept]))
    least = 1.0 if known and (sigmas > 0.0).all() else 0.0
    scale = max(least, estimated, EXACT * readings.largest_range() / typical)
    h = np.zeros(len(readings))
    if len(readings) * readings.beams * (MOUNT_DIM + terms) <= LARGEST_LEVERAGES:
        observed = observability(parameters, readings.subset(np.flatnonzero(kept)), terms, 0.0)
        steep = np.flatnonzero(np.isfinite(e))
        h[steep] = leverages(parameters, readings.subset(steep), observed)
    t = standardized(e / unit, h, kept, scale)
    # Far from the spots of its plane, or along it, the prediction is so vague that gross errors would
    # pass, and the fit would follow them.
    predicted = scale * unit * np.sqrt(1.0 + h)
    vague = FAR_SIGMAS * predicted > 0.5 * float(np.ptp(readings.distance[kept]))
    t[~kept & vague] = np.inf
    # Far beyond the others a reading decides a range error alone, and would be consistent with any.
    t[~model.plausible_corrections(parameters, readings)] = np.inf
    return scale * typical, t


def enough(readings: Readings, kept: BoolArray, terms: int) -> bool:
    """Tell whether the `kept` readings are a majority, and enough for every beam and plane."""
    if kept.sum() < max(MAJORITY * len(readings), count_unknowns(readings, terms) + 1):
        return False
    beams = np.bincount(readings.beam[kept], minlength=readings.beams)
    planes = np.bincount(readings.plane[kept], minlength=readings.planes)
    return bool(beams.all() and planes.all())


def evidence(
    readings: Readings, kept: BoolArray, parameters: Parameters, terms: int, range_sigma: float
) -> float:
    """Return the criterion of readings that are `kept` (N,), with a standard deviation [m]."""
    e = residuals(parameters, readings)[kept]
    total, good = len(kept), int(kept.sum())
    bad = total - good
    inside = float(e @ e) / range_sigma**2
    outside = 2.0 * bad * price(readings.distance, range_sigma)
    shares = sum(m * np.log(m / total) for m in (good, bad) if m)
    spare = total - count_unknowns(readings, terms)
    return float(2.0 * spare * np.log(range_sigma) + inside + outside - 2.0 * shares)


def leverages(
    parameters: Parameters, readings: Readings, observability: Observability
) -> FloatArray:
    """Return h (N,) of all readings for the information `observability` of the readings in use."""
    active, beams = observability.active, readings.beams
    width, each = len(active) // beams, np.arange(beams)
    columns = jacobian_columns(parameters, readings, width - 5, observability.centres)
    unit = observability.padded(observability.beam_unit).reshape(beams, width)
    rows_of_beams = np.ascontiguousarray(columns[:width].T * unit[readings.beam])
    plane = columns[width : width + 3].T * observability.plane_unit
    S, W = observability.covariance(), observability.information.local_response
    follow = S @ np.swapaxes(W, 1, 2)
    rest = observability.information.local_inverse + W @ follow
    padded, across = np.zeros((len(active),) * 2), np.zeros((readings.planes, len(active), 3))
    padded[np.ix_(active, active)], across[:, active] = S, follow
    of_beams = padded.reshape(beams, width, beams, width)[each, :, each]
    of_both = across.reshape(readings.planes, beams, width, 3)
    h = np.empty(len(readings))
    for i, own in enumerate(of_beams):
        rows_of_beam = np.flatnonzero(readings.beam == i)
        a = rows_of_beams[rows_of_beam]
        h[rows_of_beam] = ((a @ own) * a).sum(axis=1)
    # What a plane says beside the beam and by itself, of which the former counts twice.
    pulled = rows_of_beams[:, None] @ of_both[readings.plane, readings.beam]
    own_pull = plane[:, None] @ rest[readings.plane]
    h += ((own_pull - 2.0 * pulled)[:, 0] * plane).sum(axis=1)
    # It is a variance: where hardly anything is determined, differences of large numbers are rounding.
    return np.maximum(h, 0.0)


def standardized(
    residual: FloatArray, leverage: FloatArray, used: BoolArray, range_sigma: float
) -> FloatArray:
    """Return residuals (N,) in their own standard deviations; zero where a reading checks nothing."""
    variance = np.where(used, 1.0 - leverage, 1.0 + leverage)
    checks = variance > NEGLIGIBLE
    scale = range_sigma * np.sqrt(np.where(checks, variance, 1.0))
    return np.where(checks, residual / scale, 0.0)
