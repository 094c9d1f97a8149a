"""Signs that a calibration of beams before planes should not be believed, each with what to look at.

Their words stand in `messages.toml`; a new one is yielded by `fit_warnings`. Surveys have
`survey_warnings`.
"""

import math
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from difflib import get_close_matches

import numpy as np

from ..arrays import FloatArray
from ..data.noise import POSE_SIGMAS, Noise
from ..data.parameters import Parameters
from ..data.recording import Readings, Recording
from ..data.screening import rounding
from ..errors import CalibrationWarning
from ..estimation.joint_solution import NO_FIT
from ..estimation.scales import RANGE, ROTATION, TRANSLATION, NoiseComponent
from ..estimation.solution import Solution
from ..model.damped_search import LevenbergOptions
from ..model.distributions import (
    CONFIDENCE,
    FEW_DEGREES,
    SINGLE_LEVEL,
    UNLIKELY_EXCESS,
    chi2_cdf,
    chi2_sf,
)
from ..model.equation import cosines, plausible_range_errors, scene
from ..model.families import PLANE
from ..model.losses import GAUSSIAN
from ..model.sensor_limits import BY_LIMITS, LONG_RANGE
from ..observability.wording import BeamAndPlaneNames
from ..quantities import EXACT, FAR_SIGMAS, MANY_OUTLIERS, MM, TEN_TIMES
from ..solvers.beam_problem import LEAST_DAMPING, solve_together
from ..starts.beam_minima import MINIMUM_STARTS, beam_minima
from ..starts.choice import POOR_START
from ..starts.directions import direction_starts
from ..starts.rounds import LAST_STEPS, SAME_DIRECTION
from ..text import count
from .calibration_data import Beam, Fit
from .messages import Values, warned

FAR_BEAM = 3.0
"""A beam further from the hand's origin than this [m] is no robot's."""
NO_MOUNT = 10.0
"""A beam further away than this [m] is on no vehicle either: its millimetres were read as metres."""
COARSE = "coarse-readings"
"""The code of readings whose rounding alone explains why they fit so badly."""
DISPLACED = "displaced"
"""Code of the warning that a target, sensor or beam was moved amid the recording."""
RIVAL = "another-mount"
"""The code of beams of which another mount fits nearly as well."""
IMPLAUSIBLE = "implausible-range-error"
"""The code of readings that fit only with range errors that no sensor has."""
WORTH_REFINING = 100.0
"""Another minimum of one beam, the planes fixed, is refined where its chi2 is larger by at most
this."""


def ambiguous(warnings: Iterable[CalibrationWarning]) -> Iterator[str]:
    """Yield the words of mounts beside which another is so probable that no 95 % radius holds."""
    likely = -2.0 * math.log(1.0 - CONFIDENCE)  # chi2 more than that of the best
    for one in warnings:
        if one.code == RIVAL and float(one.values["chi2"]) < likely:
            yield one.message


def much_alike(names: Sequence[str], stations: Sequence[int]) -> Iterator[tuple[int, int]]:
    """Yield the numbers of a label that few stations have, and of one with more that it may misspell.

    These are no more stations than a plane has unknowns. Numbers tell labels apart: plate 1 is no
    misspelt plate 2.
    """
    plain = [re.sub(r"[\s_-]", "", name).casefold() for name in names]
    numbers = [re.findall(r"\d+", name) for name in names]
    for few in [i for i, own in enumerate(stations) if own <= PLANE.dim]:
        for other in [i for i, own in enumerate(stations) if own > stations[few]]:
            if numbers[few] == numbers[other] and get_close_matches(plain[few], [plain[other]]):
                yield few, other


def misfit(
    recording: Recording, readings: Readings, parameters: Parameters, fit: Fit
) -> CalibrationWarning | None:
    """Say that the readings that were used do not fit at all, where that is so; None otherwise."""
    beams = recording.beam_names
    for name, (lost, readings_of) in zip(beams, lost_of_beams(fit, beams), strict=True):
        # A beam that loses half of its readings or more is not calibrated: another solution would do
        # as well.
        if lost and 2 * lost >= readings_of:
            values: Values = {"beam": name, "rejected": lost, "readings": readings_of}
            return warned("contradicting-beam", values)
    if fit.range_sigma_given and fit.dof > 0 and fit.sigma0 > TEN_TIMES:
        return warned("no-fit:sigmas", {"sigma0": fit.sigma0})
    if not plausible_range_errors(parameters, readings):
        return warned(IMPLAUSIBLE)
    spread = readings.spread()
    if fit.dof <= 0 or fit.rms <= NO_FIT * spread:
        return None
    half = rounding(readings.distance)
    if fit.rms <= half:
        return warned(COARSE, {"rounding_m": 2.0 * half, "spread_m": spread})
    return poor_fit(readings, fit)


def poor_fit(readings: Readings, fit: Fit) -> CalibrationWarning:
    """Say how far the readings are from fitting."""
    return warned("no-fit:spread", {"rms_m": fit.rms, "spread_m": readings.spread()})


def implausible_mounts(
    readings: Readings, parameters: Parameters, names: BeamAndPlaneNames
) -> CalibrationWarning | None:
    """Say that beams lie where none can be: far from the hand, or on both sides of a plane."""
    far = float(np.linalg.norm(parameters.locations, axis=1).max())
    if far > NO_MOUNT:
        return warned("far-beam:no-mount", {"distance_m": far})
    ahead = cosines(scene(parameters, readings)) > 0.0
    # Whether a beam hits a plane from the front, and from the back.
    hits = np.zeros((2, readings.planes, readings.beams), dtype=bool)
    hits[(~ahead).astype(int), readings.plane, readings.beam] = True
    from_both = np.flatnonzero(hits.any(axis=2).all(axis=0))
    if not from_both.size:
        return None
    name = names.sorted_planes()[from_both[0]]
    labels, distance = names.sorted_beams(), np.linalg.norm(parameters.locations, axis=1)
    first, second = np.where(hits[:, from_both[0]], distance, -1.0).argmax(axis=1).tolist()
    culprit = labels[max(first, second, key=lambda i: distance[i])]
    values = {"plane": name, "beam": culprit, "first": labels[first], "second": labels[second]}
    if first == second:
        return warned("two-sides:beam", values)
    return warned("two-sides", values)


def lost_of_beams(fit: Fit, names: Sequence[str]) -> list[tuple[int, int]]:
    """Return how many readings of every beam contradict the rest, and how many it has in all."""
    out = Counter(one.sensor for one in fit.rejected if one.reason not in BY_LIMITS)
    kept = (~np.isnan(fit.residuals)).sum(axis=0).tolist()
    return [(out[name], out[name] + left) for name, left in zip(names, kept, strict=True)]


def suspicious(readings: Readings, fit: Fit) -> bool:
    """Tell whether the fit is so poor that the file may have been read the wrong way."""
    if fit.dof <= 0:
        return False
    far = fit.range_sigma_given and fit.sigma0 > TEN_TIMES
    least = max(POOR_START * readings.spread(), rounding(readings.distance))
    return bool(far or fit.rms > least)


def fit_warnings(
    readings: Readings,
    fit: Fit,
    noise: Noise,
    solution: Solution,
    names: Sequence[str],
    as_one: float,
) -> Iterator[CalibrationWarning]:
    """Yield the warnings that a fit deserves, beside the warning of `misfit`, the gravest first.

    `names` are the beams' in the order of the readings; `as_one` is how many readings count as one.
    """
    outliers, total = fit.outliers, fit.readings + fit.outliers
    if outliers > MANY_OUTLIERS * total:
        yield warned("many-outliers", {"rejected": outliers, "readings": total})
    median = float(np.median(readings.distance))
    if median > LONG_RANGE:
        yield warned("long-ranges", {"median_m": median})
    far = float(np.linalg.norm(solution.best.locations, axis=1).max())
    if FAR_BEAM < far <= NO_MOUNT:
        yield warned("far-beam", {"distance_m": far})
    yield from _same_mounts(readings, solution.best, fit, names)
    treated = solution.variances is not None and solution.variances.pose is not None
    # Systematic errors that are unknowns count in the degrees of freedom of the fit alone.
    spare = min(solution.redundancy, fit.dof)
    yield from _wrong_sigmas(fit, spare, as_one, treated=treated)
    # Of a poor fit, the errors of the poses were not looked at.
    if not treated and fit.rms <= NO_FIT * readings.spread():
        sigmas = _going_together(fit)
        if sigmas > FAR_SIGMAS:
            yield warned("poses-err", {"standard_deviations": sigmas})
        if noise.poses_uncertain:
            yield warned("poses-taken-as-exact")
    yield from large_pose_errors(solution.scales)
    yield from _rough_beams(solution.scales, names)
    yield from far_reading(fit)
    if spare < FEW_DEGREES:
        some = f"only {count(spare, 'reading')} more than"
        more = some if spare > 0 else "no more readings than"
        if not fit.range_sigma_given:
            yield warned("few-readings", {"redundancy": spare}, more=more)
        elif solution.observability.full:
            yield warned("few-readings:given", {"redundancy": spare}, more=more)


def _rough_beams(
    learned: Iterable[NoiseComponent], names: Sequence[str]
) -> Iterator[CalibrationWarning]:
    """Warn of beams for which a range sigma was learned apart from the common one."""
    of_ranges = {one.beam: one.sigma for one in learned if one.quantity == RANGE}
    others = of_ranges.pop(None, None)
    for beam, sigma in of_ranges.items():
        if others is not None and beam is not None:
            values: Values = {"beam": names[int(beam)], "sigma": sigma, "others": others}
            yield warned("rough-beam:own", values)


def far_reading(fit: Fit) -> Iterator[CalibrationWarning]:
    """Warn of the reading that is farthest off, where that is no accident."""
    (station, beam), sigmas = fit.max_standardized_residual_at, fit.max_standardized_residual
    if fit.dof > 0 and sigmas > FAR_SIGMAS:
        yield warned("far-reading", {"station": station, "beam": beam, "sigmas": sigmas})


def large_pose_errors(learned: Iterable[NoiseComponent]) -> Iterator[CalibrationWarning]:
    """Warn of errors of poses that no robot of its kind has: they stand for others."""
    for one in learned:
        at_least = one.sigma - 2.0 * float(np.nan_to_num(one.error))
        if one.quantity != RANGE and at_least > TEN_TIMES * one.usual:
            which = "rotation" if one.quantity == ROTATION else "position"
            values = {"sigma": one.sigma, "expected": one.usual}
            yield warned(f"large-pose-errors:{which}", values, times=one.sigma / one.usual)


def large_range_error(
    k: FloatArray, typical: float, linearity: float, names: Sequence[str]
) -> Iterator[CalibrationWarning]:
    """Warn of a range error that no sensor of such a linearity has: it stands for another form.

    Readings that are too short beyond some range, for one, fit k1 and k2 that are far too large, and a
    wrong mount, with hardly larger residuals. Where all readings err by the same part, both share it.

    Parameters
    ----------
    k : (B, 2)
        k1 and k2 of each beam.
    typical : float
        Typical range [m].
    linearity : float
    names : B strings
    """
    first, second = k[:, 0], k[:, 1] * typical
    size = np.abs([first, second, first + second]).max(axis=0)
    beam = int(size.argmax())
    if size[beam] > TEN_TIMES * linearity:
        values: Values = {"beam": names[beam], "size": float(size[beam]), "expected": linearity}
        yield warned("large-range-error", values)


def _same_mounts(
    readings: Readings, parameters: Parameters, fit: Fit, names: Sequence[str]
) -> Iterator[CalibrationWarning]:
    """Warn of two beams in one place: a channel logged twice, with noise of its own.

    No two sensors fit within a millimetre of each other, and point the same way to 0.01 rad. Beams that
    never read at one station may be two states of one sensor, before it moved and after.
    """
    order = np.argsort(parameters.locations[:, 0], kind="stable").tolist()
    for number, i in enumerate(order):
        for j in order[number + 1 :]:
            apart = parameters.locations[j] - parameters.locations[i]
            if apart[0] > MM:
                break
            turned = parameters.directions[j] - parameters.directions[i]
            near = np.linalg.norm(apart) < min(MM, 0.1 * fit.typical_range)
            if not near or np.linalg.norm(turned) >= 10.0 * MM:
                continue
            stations = [readings.station[readings.beam == beam] for beam in (i, j)]
            if np.intersect1d(*stations).size:
                yield warned("column-twice", {"first": names[i], "second": names[j]})


def _wrong_sigmas(
    fit: Fit, redundancy: int, as_one: float, *, treated: bool
) -> Iterator[CalibrationWarning]:
    """Warn of given sigmas that chi2 contradicts; `treated` where errors of the poses are counted.

    `as_one` readings tell as much as one that is independent. Where that is more than one, the unknowns
    follow the errors that readings share, so that a small chi2 is no sign of sigmas too large.

    Range errors smaller than their prior says, as of sensors without any, make chi2 smaller by up to
    what there are: so it is too small only where it is so for the readings alone.
    """
    if not (fit.range_sigma_given and fit.dof > 0):
        return
    larger, smaller = float(chi2_sf(fit.chi2 / as_one, fit.dof / as_one)), 1.0
    if redundancy > 0 and as_one == 1.0:
        smaller = float(chi2_cdf(fit.chi2, redundancy))
    if larger < SINGLE_LEVEL:
        remedy = "" if treated else "state the robot's sigmas or "
        values = {"sigma0": fit.sigma0, "p_value": larger}
        yield warned("sigmas-too-small", values, remedy=remedy)
    elif smaller < SINGLE_LEVEL:
        yield warned("sigmas-too-large", {"sigma0": fit.sigma0, "p_value": smaller})


def _going_together(fit: Fit) -> float:
    """Return how far the products of residuals of one station are from a mean of zero, in sigmas.

    Independent readings have products of mean zero, or a little below as all fit the same planes; an
    error of the pose moves all beams of its station.
    """
    e = np.nan_to_num(fit.residuals)
    seen = (~np.isnan(fit.residuals)).sum(axis=1)
    pairs = float((seen * (seen - 1) // 2).sum())
    variance = float((e**2).sum() / max(seen.sum(), 1))
    if pairs == 0.0 or variance <= 0.0:
        return 0.0
    products = 0.5 * float((e.sum(axis=1) ** 2 - (e**2).sum(axis=1)).sum())
    return products / (variance * float(np.sqrt(pairs)))


def rival_warnings(
    used: Readings,
    solution: Solution,
    fit: Fit,
    beams: Mapping[str, Beam],
    names: BeamAndPlaneNames,
) -> Iterator[CalibrationWarning]:
    """Yield warnings of mounts that are nearly as probable, and not within what is stated.

    At most one of each beam, the most probable.
    """
    sigmas = {
        name: beam.direction_sigma
        for name, beam in beams.items()
        if beam.direction_sigma is not None
    }
    if len(sigmas) < len(beams) or solution.at.loss != GAUSSIAN:
        return
    if not solution.observability.full or fit.dof <= 0:
        return
    if fit.rms <= EXACT * used.largest_range():
        return
    at = solution.parameters
    starts = [at, *_other_mounts(at, used, fit.range_sigma)]
    if used.beams == 1 and solution.redundancy < solution.observability.unknowns:
        # Planes rest on few readings of one beam, and go with its mount: from all around.
        starts += direction_starts(used, 2 * MINIMUM_STARTS)
    if len(starts) == 1:
        return
    how = fit.range_sigma if solution.whitening is None else [solution.whitening] * len(starts)
    options = LevenbergOptions(LAST_STEPS, least_damping=LEAST_DAMPING)
    each = [used] * len(starts)
    ends = solve_together(each, starts, solution.terms, how, solution.prior, options)
    here, worse = ends.parameters[0], 2.0 * (ends.cost - ends.cost[0])
    named = set[str]()
    for k in np.argsort(worse, kind="stable").tolist():
        there, chi2 = ends.parameters[k], float(worse[k])
        if chi2 > UNLIKELY_EXCESS:
            return
        turn = np.linalg.norm(there.directions - here.directions, axis=1)
        near = np.linalg.norm(there.locations, axis=1) < FAR_BEAM
        for name, beam in names.beams:
            if name not in named and near[beam] and turn[beam] >= FAR_SIGMAS * sigmas[name]:
                named.add(name)
                values: Values = {
                    "beam": name,
                    "turn_deg": float(np.degrees(turn[beam])),
                    "chi2": chi2,
                }
                yield warned(RIVAL, values, more=max(chi2, 0.0))


def _other_mounts(at: Parameters, used: Readings, sigma: float) -> Iterator[Parameters]:
    """Yield parameters with one beam in another minimum for the planes as they are."""
    locations, directions, squares, now = beam_minima(at, used)
    turned = np.linalg.norm(directions - at.directions[:, None], axis=2)
    each = np.bincount(used.beam, minlength=used.beams)
    # A mount that grazes a plane has no square, neither another one nor, with steep readings, this one.
    worse, other = np.full(squares.shape, np.inf), np.isfinite(squares) & (turned > SAME_DIRECTION)
    np.subtract(squares, now[:, None], out=worse, where=other)
    worse *= each[:, None] / sigma**2
    # Each takes a solution of all unknowns.
    for beam in np.argsort(worse.min(axis=1))[:4].tolist():
        one = int(np.argmin(worse[beam]))
        if worse[beam, one] > WORTH_REFINING:
            return
        r, v = at.locations.copy(), at.directions.copy()
        r[beam], v[beam] = locations[beam, one], directions[beam, one]
        yield replace(at, locations=r, directions=v)


def contradicted_sigmas(
    stated: Noise,
    contradicted: Sequence[str],
    range_sigma: float,
    learned: Iterable[NoiseComponent],
) -> Iterator[CalibrationWarning]:
    """Warn of sigmas of noise that readings contradict; `range_sigma` or others were learned."""
    if stated.range_sigma is not None and "range_sigma" in contradicted:
        yield contradicted_readings(stated.range_sigma, range_sigma)
    if any(name in contradicted for name in POSE_SIGMAS):
        sizes = {one.quantity: one.sigma for one in learned}
        yield contradicted_poses(stated, sizes.get(ROTATION, 0.0), sizes.get(TRANSLATION, 0.0))


def contradicted_readings(stated: float, learned: float, of: str = "") -> CalibrationWarning:
    """Warn that the readings contradict their stated sigma [m]: another one was learned."""
    values = {"stated": stated, "sigma": learned, "times": learned / stated}
    return warned("sigmas-too-small:range", values, of=of)


def contradicted_poses(stated: Noise, turn: float, shift: float) -> CalibrationWarning:
    """Warn that the readings contradict the stated pose sigmas: these [rad], [m] were learned."""
    stated_shift, stated_turn = stated.standstill
    pairs = (shift, stated_shift), (turn, stated_turn)
    values = {
        "translation": shift,
        "rotation": turn,
        "stated_translation": stated_shift,
        "stated_rotation": stated_turn,
        "times": max(now / before if before > 0.0 else math.inf for now, before in pairs),
    }
    return warned("sigmas-too-small:poses", values)
