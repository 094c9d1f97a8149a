"""The verdict on the calibration of a survey, in the terms of that on beams before planes.

The warnings that it judges are made in `survey_warnings.py`.

Its findings name every sensor and beam with the radius around its spot at its working distance. What
would improve it most is looked for in the same order: what makes the stated numbers wrong, then the
largest share of the variance of the spot that is least certain.
"""

import math
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np

from ..errors import CalibrationWarning
from ..estimation.estimate import covariance_along, information_axes
from ..text import some
from .limits import LimitCheck, Limits, sigmas_checked
from .lines import NAMES_IN_LINE
from .messages import said
from .shared_errors import BY_POSE
from .survey_misfit import FALSE_RELATION, MISREAD, NO_FIT
from .survey_motion import MORE_STATIONS
from .survey_relations import said_by_readings
from .verdict import (
    DECIDES,
    Improvement,
    Verdict,
    better_sigmas,
    clause,
    code_of,
    failures,
    failures_of,
    far_moved_beam_of,
    improvement_of,
    more_stations,
    of_share,
)
from .warnings import DISPLACED, RIVAL, ambiguous

if TYPE_CHECKING:
    from .survey import SurveyCalibration

FEW = "few-readings"
"""Code of the warning that hardly more readings than unknowns tell the noise."""
TOO_FEW = "too-few-readings"
"""Code of the warning that a beam has fewer readings than unknowns: another mount may fit as well."""
CAUSES = (*MISREAD, FALSE_RELATION, DISPLACED, "sigmas-too-small", "range-error")
"""Codes of warnings that say why shots do not fit each other.

A false relation looks like errors of readings, too, so that the last three are no causes beside it.
"""
WHY_LOST = ("no-edge", "too-few-points")
"""Codes of warnings that say why shots are lost."""


def survey_verdict(result: "SurveyCalibration", limits: Limits | None = None) -> Verdict:
    """Return the verdict on the calibration of a survey.

    Parameters
    ----------
    result : SurveyCalibration
    limits : Limits, optional
        What its user demands. A limit of the rms residual is none of a survey, whose readings weigh
        differently.
    """
    if result.status != "converged":
        return _of_no_calibration(result)
    limits = limits or Limits()
    checks = tuple(
        check
        for one in result.mounts
        for check in sigmas_checked(one.subject, one.largest_sigmas, one.largest_sigmas, limits)
    )
    failed = tuple(one for one in checks if not one.held)
    # The range error found that moves the spot of its sensor most, in units of the 95 % radius there.
    moves = [
        (abs(error.size) * error.spot_shift / sensor.spot_error, sensor.name)
        for sensor in result.sensors.values()
        for error in sensor.errors.values()
        if error.found
    ]
    excess, harmful = max(moves, key=lambda one: one[0], default=(0.0, ""))
    errors = [one for one in result.warnings if one.code == "range-error"]
    named = [one for one in errors if one.values["sensor"] == harmful]
    false = [one.message for one in result.warnings if one.code == FALSE_RELATION]
    unsure = [one.message for one in result.warnings if one.code == TOO_FEW]
    unsure += ambiguous(result.warnings)
    moved = far_moved_beam_of(result.warnings)
    harms = moved is not None or excess > 1.0
    code = code_of(bool(false), harms, bool(unsure), bool(failed), bool(result.warnings))
    why = {
        "contradicted": false,
        "systematic-error": [one.message for one in (named if moved is None else [moved])],
        "undetermined": unsure,
        "outside-limits": [failures(checks)],
    }
    findings = [clause(one) for one in why.get(code, [])[:1]]
    findings += _said_by_readings(result)
    findings += [some(list(_located(result)), NAMES_IN_LINE)]
    if code == "usable-with-care":
        findings.append(clause([*named, *result.warnings][0].message))
    best = _improvement(result, named, failed)
    if failed and code != "outside-limits":
        findings.append(failures(checks))
    if code in ("usable", "usable-with-care", "outside-limits"):
        findings.append(best.clause)
    worst = max(result.mounts, key=lambda one: one.spot_error)
    return Verdict(
        code,
        tuple(findings),
        best,
        worst.reading,
        spot_beam=worst.name,
        spot_error=worst.spot_error,
        limits=checks,
        causes=(*failures_of(checks), *result.warnings),
    )


def _of_no_calibration(result: "SurveyCalibration") -> Verdict:
    """Return the verdict on what is undetermined, contradicted or has not converged."""
    codes = {one.code for one in result.warnings}
    among = (*MISREAD, FALSE_RELATION) if FALSE_RELATION in codes else CAUSES
    if any(one.code == NO_FIT and "lost" in one.values for one in result.warnings):
        among = (*among, *WHY_LOST)
    causes = [one for one in result.warnings if one.code in among]
    why = result.undetermined[:2] or (result.message,)
    if NO_FIT not in codes:  # which names its causes
        named = (one.message for one in causes if one.message not in result.message)
        why = (*named, *why)
    code = {"undetermined": "undetermined", "not_converged": "not-converged"}.get(
        result.status, "no-fit"
    )
    if FALSE_RELATION in codes and not codes & {NO_FIT, *MISREAD}:
        code = "contradicted"
    best = improvement_of("recording")
    if result.advice:
        what = "more-stations" if result.advice[0] == MORE_STATIONS else "more-motion"
        best = Improvement(what, "; ".join(result.advice))
    elif causes:  # each says what to do
        best = Improvement(causes[0].code, clause(causes[0].message))
    findings = (*dict.fromkeys(clause(one) for one in why), *_said_by_readings(result))
    return Verdict(code, findings, best, math.nan, causes=result.warnings)


def _said_by_readings(result: "SurveyCalibration") -> list[str]:
    """Return what the readings say in place of the first relation that they contradict."""
    return [f"without it {measured}" for _, measured in said_by_readings(result)][:1]


def _located(result: "SurveyCalibration") -> Iterator[str]:
    """Say how well the spot of each sensor and beam is known.

    With the range error that may move the spot of a sensor most unnoticed, by more than what is stated.
    """
    hidden = {sensor.subject: sensor.hidden for sensor in result.sensors.values()}
    for one in result.mounts:
        code, moved = hidden.get(one.subject, ("", 0.0))
        spot, at = one.spot_error, one.reading
        only = said("verdict:random-only", code=code, moved=moved) if moved > spot else ""
        yield said("verdict:mount", name=one.subject, spot=spot, at=at, only=only)


def _improvement(
    result: "SurveyCalibration", named: Sequence[CalibrationWarning], failed: tuple[LimitCheck, ...]
) -> Improvement:
    """Return the one thing that would improve a converged calibration most.

    `named` are the warnings of range errors of the sensor whose spot one moves most.
    """
    warnings = {one.code: one for one in reversed(result.warnings)}
    if FALSE_RELATION in warnings:
        return improvement_of(FALSE_RELATION)
    if DISPLACED in warnings:
        target, station = (warnings[DISPLACED].values[of] for of in ("target", "station"))
        of_mount = target in {one.subject for one in result.mounts}
        whose = "target" if target in result.targets else "mount" if of_mount else "hand"
        return improvement_of(f"{DISPLACED}:{whose}", target=target, station=station)
    for one in named:
        return improvement_of("range-error", sensor=one.values["sensor"], free=one.values["free"])
    if any(ambiguous(result.warnings)):
        return improvement_of(RIVAL)
    if "many-rejected" in warnings:
        out = warnings["many-rejected"].values["shots"]
        total = warnings["many-rejected"].values["total"]
        return improvement_of("outliers:shots", float(out), total=total)
    for how in ("small", "large"):
        if f"sigmas-too-{how}" in warnings:
            return better_sigmas(float(warnings[f"sigmas-too-{how}"].values["times"]))
    if BY_POSE in warnings:
        return improvement_of(BY_POSE)
    if FEW in warnings and "spare" in warnings[FEW].values:
        return improvement_of("more-stations:few", dof=f"{warnings[FEW].values['spare']:.1f}")
    share = _pose_share(result)
    if share > DECIDES:
        return of_share("poses", share, result.errors_by_pose)
    return more_stations(failed)


def _pose_share(result: "SurveyCalibration") -> float:
    """Return the part of the variance of the least certain spot that errors of the hand make.

    The variance is homogeneous in the variances of the readings and of the hand poses, so that its
    logarithmic derivative by the latter is their share, as in `spots`.
    """
    number, found = int(np.argmax([one.spot_error for one in result.mounts])), result._found
    family, member = list(found.rows.mounts)[number]
    J, variances = result.mounts[number].spot_by(), []
    for times in (0.5, 2.0):
        problem = found.problem(times)
        axes = information_axes(problem, problem.start)
        # Range errors of a sensor stand after the unknowns of where it is.
        first = int(problem.places().place[family][member])
        variances.append(float(np.trace(covariance_along(axes, J, first))))
    low, high = variances
    return math.log(high / low) / (2.0 * math.log(2.0)) if low > 0.0 else 0.0
