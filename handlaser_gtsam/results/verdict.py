"""The verdict on a calibration: whether to use it, what it is good for, what would improve it most.

Its code is the first of these that holds, of surveys too: no calibration; a contradiction (of beams a
mount that no sensor has); a systematic error that moves a laser spot by more than the radius that holds
the spot with 95 %; another mount that is as probable; outside the limits of the user; a warning, or a
systematic error that was found or may hide (usable with care); usable.

Of improvements, what makes the stated numbers wrong comes first: a mistake of the file, a beam that was
moved, a systematic error, another mount that is as probable, many outliers, given sigmas that the
residuals contradict, a limit of the residuals, a freed error that the readings do not determine, a
systematic error that may hide, noise that is correlated in time, a robot whose errors change with the
pose of the hand. Then what the error is made of that exceeds its limit most, or else that of the spot:
its largest share, where that is more than half; otherwise, and where too few residuals alone say how
noisy the readings are, more stations.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from ..errors import CalibrationWarning
from ..estimation.errors_by_pose import SizesByPose
from ..model.distributions import FEW_DEGREES
from ..model.effects import EFFECTS, may_also_be
from ..quantities import IN_MM, IN_PERCENT, MANY_OUTLIERS
from ..text import count, some
from .calibration_data import CalibrationData
from .limits import LimitCheck, Limits, checked, hidden_errors, worst_of_each
from .lines import NAMES_IN_LINE
from .messages import MESSAGES, said
from .shared_errors import BY_POSE
from .spots import VarianceShares, freedom, spot_radii, variance_shares
from .systematic import SystematicError
from .warnings import DISPLACED, RIVAL, ambiguous

OPENING = MESSAGES["openings"]
"""How a sentence begins, by the code of its verdict."""
LADDER = "contradicted", "systematic-error", "undetermined", "outside-limits", "usable-with-care"
"""Codes of what was solved and is not simply usable: what makes numbers wrong comes before limits that
these exceed."""
MARKS = {"usable": "good", "usable-with-care": "care"}
"""Colours of the verdicts on what can be used; all others are bad."""
RANDOM_ONLY = "; random errors only: state [sensor] kind"
"""What stands beside a radius where nothing says which systematic errors are plausible."""
CAUSE = "file-mistake"
"""Code of the warning that names why readings do not fit."""
IMPOSSIBLE = ("column-twice", "far-beam")
"""Codes of warnings of mounts that no sensors have: two in one place, or one beyond any hand."""
WELL_CONDITIONED = 100.0
"""A condition number below this is the usual demand: no motion is missing then."""

DECIDES = 0.5
"""A cause of more than this part of the variance is worth the first word."""


@dataclass(frozen=True, slots=True)
class Improvement:
    """What would improve a calibration most.

    Attributes
    ----------
    code : str
        `systematic`, `another-mount`, `effect-undetermined`, `hidden`, `outliers`, `sigmas`,
        `limit-rms`, `stops`, `errors-by-pose`, `poses`, `range-span`, `motion`, `more-stations`,
        `more-motion`, `recording`, `displaced`, `column-twice`, `far-beam` or `file-mistake`; of
        surveys codes of warnings that say what to do, too.
    words : str
        What to do, without a full stop.
    number : float or None
        The number behind it: how many outliers, by how much residuals are larger than the sigmas say,
        the share of the variance of the spot error, or how many times as many stations.
    """

    code: str
    words: str
    number: float | None = None

    @property
    def clause(self) -> str:
        """The last part of a sentence."""
        return f"best improvement: {clause(self.words)}"


def improvement(
    calibration: CalibrationData,
    shares: VarianceShares | None,
    harmful: SystematicError | None,
    failed: tuple[LimitCheck, ...],
    doubtful: SystematicError | None = None,
) -> Improvement:
    """Return the one thing that would improve a converged calibration most.

    Parameters
    ----------
    calibration : CalibrationData
    shares : VarianceShares or None
        Of the location or direction that exceeds its limit most; of the spot of the worst beam where
        none does.
    harmful : SystematicError or None
        The systematic error found that harms most.
    failed : tuple of LimitCheck
        Limits that are exceeded.
    doubtful : SystematicError, optional
        The one that may be there unnoticed, where that counts for more than the noise.
    """
    fit = calibration.fit
    total = fit.readings + fit.outliers
    codes = {one.code for one in calibration.warnings}
    undetermined = next((one for one in calibration.effects if not one.determined), None)
    mistake = _undone(calibration)
    if mistake is not None:
        return mistake
    moved = moved_beam_of(calibration.warnings)
    if moved is not None:
        target, station = moved.values["target"], moved.values["station"]
        return improvement_of(f"{DISPLACED}:mount", target=target, station=station)
    if harmful is not None:
        return Improvement("systematic", harmful.remedy)
    if any(ambiguous(calibration.warnings)):
        return improvement_of(RIVAL)
    if fit.outliers > MANY_OUTLIERS * total:
        return improvement_of("outliers", fit.outliers, total=total)
    for one in calibration.warnings:
        if one.code in ("sigmas-too-small", "sigmas-too-large"):
            return better_sigmas(float(one.values.get("times", fit.sigma0)))
    if any(one.quantity == "rms" for one in failed):
        return improvement_of("limit-rms")
    if undetermined is not None:
        code = undetermined.code
        return improvement_of("effect-undetermined", code=code, reveal=EFFECTS[code].reveal)
    if doubtful is not None:
        return improvement_of("hidden", reveal=EFFECTS[doubtful.code].reveal)
    if "correlated-in-time" in codes:
        return improvement_of("stops")
    if BY_POSE in codes:
        return improvement_of(BY_POSE)
    few = freedom(calibration) < FEW_DEGREES
    if shares is not None and not few:  # what would lower the largest share
        condition = calibration.observability.condition
        shown = condition is not None and condition > WELL_CONDITIONED
        weakest = shares.weakest if shown else 0.0
        causes = {"poses": shares.poses, "range-span": shares.range_error}
        causes[f"motion:{shares.weakest_quantity}"] = weakest
        worst = max(causes, key=lambda one: np.nan_to_num(causes[one], nan=-1.0))
        if causes[worst] > DECIDES:
            return of_share(worst, causes[worst], calibration.errors_by_pose)
    if few and not failed:
        return improvement_of("more-stations:few", dof=fit.dof)
    return more_stations(failed)


def moved_beam_of(warnings: tuple[CalibrationWarning, ...]) -> CalibrationWarning | None:
    """Return the warning of a beam that was moved amid the recording; None where none was."""
    return next((one for one in warnings if one.code == DISPLACED), None)


def far_moved_beam_of(warnings: tuple[CalibrationWarning, ...]) -> CalibrationWarning | None:
    """Return the same of a beam that was moved by more than its spot is unsure."""
    moved = moved_beam_of(warnings)
    return moved if moved is not None and float(moved.values["times"]) > 1.0 else None


def code_of(*holds: bool) -> str:
    """Return the first code of the `LADDER` that holds, or `usable`."""
    return next((code for code, one in zip(LADDER, holds, strict=True) if one), "usable")


def _undone(calibration: CalibrationData) -> Improvement | None:
    """Return the mistake of the file that is to be undone; None where none is known."""
    return next(
        (Improvement(one.code, clause(one.message)) for one in _mistakes(calibration)), None
    )


def _mistakes(calibration: CalibrationData) -> list[CalibrationWarning]:
    """Return what is wrong with the file, or must be because of the mounts that follow."""
    return [one for one in calibration.warnings if one.code in (CAUSE, *IMPOSSIBLE)]


def more_stations(failed: tuple[LimitCheck, ...]) -> Improvement:
    """Return how many times as many stations meet limits that are exceeded, or halve the error."""
    if not failed:
        return improvement_of("more-stations", 4.0)
    times = max(one.ratio for one in failed) ** 2
    rounded = f"{math.ceil(10.0 * times) / 10.0:.1f}" if times < 10.0 else f"{math.ceil(times)}"
    return improvement_of("more-stations:limits", times, times=rounded)


def improvement_of(message: str, number: float | None = None, **words: float | str) -> Improvement:
    """Return an improvement by its code, with a suffix where one code has several words."""
    if number is not None:
        words = {"number": number, **words}
    return Improvement(message.partition(":")[0], said(f"best:{message}", **words), number)


def better_sigmas(times: float) -> Improvement:
    """Return sigmas that fit, where errors are `times` as large: infinitely beside a given zero."""
    if math.isinf(times):
        return improvement_of("sigmas:zero")
    return improvement_of("sigmas", times)


def of_share(worst: str, share: float, by_pose: SizesByPose | None) -> Improvement:
    """Return what lowers the largest share of the variance, given errors that change with the pose."""
    percent = IN_PERCENT * min(share, 0.99)
    if worst == "poses" and by_pose is not None and by_pose.doubt_the_stated:
        return improvement_of("poses:stated", share, percent=percent, growth=by_pose.growth)
    return improvement_of(worst, share, percent=percent)


@dataclass(frozen=True, slots=True)
class Verdict:
    """Whether a calibration can be used.

    Attributes
    ----------
    code : str
        `usable`; `usable-with-care`: there are warnings, or a systematic error was found or may hide;
        `outside-limits`; `systematic-error`: one was found that moves a laser spot out of the radius
        that holds it with 95 %; `contradicted`: a plane that was
        left out contradicts the beams found without it, or readings of a survey what is known, or two
        beams have one mount, or one is farther away than any hand reaches;
        `undetermined`, or another mount is about as probable; `no-fit`: the readings
        contradict each other, whatever the motion, or fit only a mount or a range error that no sensor
        has, or are too coarse; `not-converged`.
    findings : tuple of str
        The parts of the sentence.
    best : Improvement
        What would improve it most.
    reading : float
        The working distance [m].
    spot_beam : str
        The beam, or the sensor, whose spot is least certain; empty where there is no covariance.
    spot_error : float or None
        The radius [m] around its stated place that holds that spot with 95 %, from the calibration
        alone.
    harmful : SystematicError or None
        The systematic error found that moves a laser spot most, by the radius of 95 % of that spot;
        none that a clearer one explains.
    hidden : SystematicError or None
        The one that may be there unnoticed and moves a laser spot most, as far as is plausible.
    hidden_error : float or None
        How far [m]; None where nothing says what is plausible.
    limits : tuple of LimitCheck
        Every value that has a limit.
    shares : VarianceShares or None
        What the spot error is made of.
    confirmed_by : int
        How many planes were held out and agree.
    causes : tuple of CalibrationWarning
        Why it is not usable, or usable with care: each with a code and its numbers.
    """

    code: str
    findings: tuple[str, ...]
    best: Improvement
    reading: float
    spot_beam: str = ""
    spot_error: float | None = None
    harmful: SystematicError | None = None
    hidden: SystematicError | None = None
    hidden_error: float | None = None
    limits: tuple[LimitCheck, ...] = ()
    shares: VarianceShares | None = None
    confirmed_by: int = 0
    causes: tuple[CalibrationWarning, ...] = ()

    @property
    def usable(self) -> bool:
        """Whether the calibration can be used."""
        return self.code in MARKS

    @property
    def opening(self) -> str:
        """What the verdict is, in a few words."""
        return OPENING[self.code]

    @property
    def mark(self) -> str:
        """Its colour: `good`, `care` or `bad`."""
        return MARKS.get(self.code, "bad")

    @property
    def sentence(self) -> str:
        """All of it in one sentence."""
        planes = f", confirmed by {count(self.confirmed_by, 'plane')} left out"
        confirmed = planes if self.confirmed_by else ""
        words = "; ".join(self.findings)
        return f"{self.opening}{confirmed}: {words}."

    def says(self, message: str) -> bool:
        """Tell whether its sentence says what a warning says."""
        return clause(message) in self.sentence

    @property
    def worst_limits(self) -> tuple[LimitCheck, ...]:
        """Of every quantity with a limit, the value nearest to it or furthest beyond."""
        return worst_of_each(self.limits)

    @property
    def exceeded(self) -> tuple[str, ...]:
        """Which limits are exceeded, in words."""
        return tuple(one.failure for one in self.limits if not one.held)


def verdict(
    calibration: CalibrationData,
    limits: Limits | None = None,
    reading: float | None = None,
) -> Verdict:
    """Return the verdict on a calibration.

    Parameters
    ----------
    calibration : CalibrationData
    limits : Limits, optional
        What its user demands.
    reading : float, optional
        The working distance [m]; the median reading where not given.
    """
    reading = calibration.fit.median_reading if reading is None else reading
    if calibration.status != "converged":
        return _none(calibration, reading)
    radii = spot_radii(calibration, reading)
    beam = max(radii, key=lambda name: radii[name], default="")
    checks = checked(calibration, limits or Limits())
    failed = tuple(one for one in checks if not one.held)
    harmful, excess = _most_harmful(calibration, radii, reading)
    shares = variance_shares(calibration, beam, reading) if beam else None
    hiding = hidden_errors(calibration)  # where a plausible size is known
    hidden = max(hiding, key=lambda one: one.moved(reading, unnoticed=True), default=None)
    beyond = None if hidden is None else hidden.moved(reading, unnoticed=True)
    limiting = max((one for one in failed if one.subject), key=lambda one: one.ratio, default=None)
    # Where noise alone would hold the limit, what may hide is the cause.
    hides = limiting is not None and limiting.random <= limiting.limit
    hides = hides or (beyond or 0.0) > max(radii.values(), default=np.inf)
    doubtful = hidden if hides else None
    code = code_of(
        any(one.code in IMPOSSIBLE for one in calibration.warnings),
        excess > 1.0 or far_moved_beam_of(calibration.warnings) is not None,
        any(ambiguous(calibration.warnings)),
        bool(failed),
        bool(harmful or calibration.warnings or doubtful),
    )
    asked = shares
    if limiting is not None:
        of: Literal["location", "direction"]
        of = "direction" if limiting.quantity == "direction_sigma" else "location"
        owner = limiting.subject.removeprefix("beam ")
        asked = variance_shares(calibration, owner, reading, of)
    best = improvement(calibration, asked, harmful, failed, doubtful)
    found = Verdict(
        code,
        (),
        best,
        reading,
        spot_beam=beam,
        spot_error=radii.get(beam),
        harmful=harmful,
        hidden=hidden,
        hidden_error=beyond,
        limits=checks,
        shares=shares,
    )
    named = _mistakes(calibration)
    words = (clause(warning.message) for warning in named)
    causes = (*named, *_causes(found, calibration))
    return replace(found, findings=(*words, *_findings(found, calibration)), causes=causes)


def _causes(judged: Verdict, calibration: CalibrationData) -> Iterator[CalibrationWarning]:
    """Yield what keeps a solved calibration from being simply usable, beside mistakes of the file."""
    yield from failures_of(judged.limits)
    error = judged.harmful
    if error is not None:
        yield CalibrationWarning(error.code, error.message, error.values)
    hidden = judged.hidden
    if hidden is not None and judged.best.code == "hidden":
        values = {"size": hidden.unnoticed, "shift": judged.hidden_error or 0.0}
        yield CalibrationWarning(hidden.code, hidden.message, values)
    known = _mistakes(calibration)
    yield from (warning for warning in calibration.warnings if warning not in known)


def _most_harmful(
    calibration: CalibrationData, radii: dict[str, float], reading: float
) -> tuple[SystematicError | None, float]:
    """Return the found systematic error that moves a spot most, in units of the spot's 95 % radius.

    Errors that a clearer one explains do not count; one of unknown effect counts with zero.
    """
    worst, most = None, -1.0
    for one in calibration.systematic:
        if not one.found or one.explained_by:
            continue
        shifts = dict(zip(calibration.beams, one.spots(reading, unnoticed=False), strict=True))
        ratios = [shifts[beam] / radius for beam, radius in radii.items() if radius > 0.0]
        ratio = max((float(x) for x in ratios if np.isfinite(x)), default=0.0)
        if ratio > most:
            worst, most = one, ratio
    return worst, max(most, 0.0)


def _findings(found: Verdict, calibration: CalibrationData) -> Iterator[str]:
    """Yield the parts of the sentence on what converged."""
    warnings = len(calibration.warnings) - len(_mistakes(calibration))
    if found.code == "outside-limits":
        yield failures(found.limits)
    moved = far_moved_beam_of(calibration.warnings)
    if found.code == "systematic-error" and moved is not None:
        yield clause(moved.message)
    elif found.code == "systematic-error" and found.harmful is not None:
        yield clause(found.harmful.message)
    elif found.code == "undetermined":
        yield from map(clause, ambiguous(calibration.warnings))
    elif found.spot_error is not None and found.code != "contradicted":
        spot, at = _mm(found.spot_error), _mm(found.reading)
        random = RANDOM_ONLY if calibration.sensor_kind is None else ""
        yield said("verdict:spot", spot=spot, beam=found.spot_beam, at=at, random=random)
        if found.hidden is not None and found.hidden_error is not None:
            error = EFFECTS[found.hidden.code].with_size(found.hidden.unnoticed)
            yield said("verdict:hidden", up=_mm(found.spot_error + found.hidden_error), error=error)
    if found.exceeded and found.code != "outside-limits":
        yield failures(found.limits)
    if found.code == "usable-with-care" and found.harmful is not None:
        one = found.harmful
        others = f" ({may_also_be(one.alike)})" if one.alike else ""
        yield f"the readings show {EFFECTS[one.code].with_size(one.size, one.subject)}{others}"
    if found.usable and found.limits:
        nearest = max(found.limits, key=lambda one: one.ratio)
        yield f"within the limits ({nearest.comparison})"
    if found.code == "usable-with-care" and warnings:
        yield f"see the {'warning' if warnings == 1 else f'{warnings} warnings'}"
    if found.best.code not in (CAUSE, *IMPOSSIBLE):  # which is said already
        yield found.best.clause


def _none(calibration: CalibrationData, reading: float) -> Verdict:
    """Return the verdict on what did not converge."""
    found = calibration.observability
    if calibration.status != "unobservable":
        best = _undone(calibration) or improvement_of("recording")
        says_why = any(one.message == calibration.message for one in calibration.warnings)
        code = "no-fit" if says_why else "not-converged"
        words = clause(calibration.message).removeprefix("the readings do not fit: ")
        causes = calibration.warnings
        if not says_why:
            causes = (CalibrationWarning(code, calibration.message), *causes)
        return Verdict(code, (words,), best, reading, causes=causes)
    words, (what, *more) = found.advice[0], found.undetermined
    others = list(dict.fromkeys(one.partition(":")[0] for one in more))
    what += f"; and unknowns of {some(others, NAMES_IN_LINE)}" if others else ""
    best = Improvement("more-motion", words)
    causes = CalibrationWarning("undetermined", calibration.message), *calibration.warnings
    return Verdict("undetermined", (clause(what), clause(words)), best, reading, causes=causes)


def failures(checks: tuple[LimitCheck, ...]) -> str:
    """Return the worst failure of every quantity, and how many there are."""
    failed = tuple(one for one in checks if not one.held)
    worst = worst_of_each(failed)
    more = len(failed) - len(worst)
    return ", ".join(one.failure for one in worst) + (
        f", and {more} more beyond their limits" if more else ""
    )


def failures_of(checks: tuple[LimitCheck, ...]) -> Iterator[CalibrationWarning]:
    """Yield the limits that are exceeded, each with its numbers."""
    for check in checks:
        if not check.held:
            values: dict[str, float | str] = {
                "quantity": check.quantity,
                "subject": check.subject,
                "value": check.value,
                "limit": check.limit,
            }
            yield CalibrationWarning("outside-limits", check.failure, values)


def clause(words: str) -> str:
    """Return words without a full stop."""
    return words.rstrip(". ")


def _mm(value: float) -> str:
    return f"{value * IN_MM:.2g}" if value < 0.01 else f"{value * IN_MM:.0f}"
