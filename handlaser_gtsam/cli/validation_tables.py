"""What a person sees of a validation."""

import math
from collections.abc import Iterator

from ..model.distributions import FAMILY_LEVEL, SINGLE_LEVEL, chance, contradicted
from ..quantities import IN_MM
from ..results.description.description import Description
from ..results.description.rendering import full_table
from ..results.reports import Fit
from ..results.verdict import Verdict
from ..validation.hold_out import HoldOut
from ..validation.leave_out import Validation
from ..validation.prediction import Prediction, pooled


def validation_lines(result: Validation, verdict: Verdict, width: int) -> Iterator[str]:
    """Yield the lines of a validation, the verdict first."""
    yield verdict.sentence
    fit = result.calibration.fit
    yield f"residuals of the calibration itself: {_size(fit)}"
    yield from _left_out_lines(result)
    if result.splits:
        every = pooled(result.splits)
        yield (
            f"30 % of the stations from the other 70 %, {len(result.splits)} times: {_size(every)}, "
            f"{every.standardized:.2f} of the predicted standard deviations"
        )
    if result.reconstruction is not None and result.without_range_error is not None:
        yield (
            "plane from all beams at one station, ranges at the others: "
            f"{_size(result.reconstruction)} of {result.reconstruction.tests}; without range error "
            f"{_size(result.without_range_error)} of {result.without_range_error.tests}"
        )
    else:
        yield "no station has three beams that span a plane: nothing to reconstruct"
    for one in verdict.exceeded:
        yield f"limit exceeded: {one}"
    described = Description(result.calibration, verdict)
    if described.systematic is not None:
        yield from full_table("systematic errors", described.systematic, width)
    for warning in result.calibration.warnings:
        yield f"WARNING: {warning}"


def _left_out_lines(result: Validation) -> Iterator[str]:
    p_values = {one.plane: one.result.p_value for one in result.planes if one.result is not None}
    against = contradicted(p_values)
    for one in result.planes:
        if one.result is None:
            yield f"without plane {one.plane}: no calibration: {one.message}"
            continue
        held = one.result
        yield (
            f"without plane {one.plane}: its readings fit within {_size(held)}; "
            f"{_agreement(one.plane, held, against)}"
        )


def _agreement(plane: str, held: HoldOut, against: tuple[str, ...]) -> str:
    """Say whether the beams found without a plane agree with it, as the exit code has it."""
    if math.isnan(held.p_value):
        return "it says nothing about the beams"
    verb = "agree with it"
    if plane in against:
        verb = "contradict it"
    elif held.p_value < FAMILY_LEVEL:
        verb = "hardly agree with it"
    return (
        f"the beams found without it {verb}: a difference this large comes by chance "
        f"{chance(held.p_value)} such recordings (p = {held.p_value:.2g})"
    )


def hold_out_lines(found: HoldOut) -> Iterator[str]:
    """Yield the lines of a hold-out test, its verdict first."""
    yield hold_out_sentence(found)
    yield f"{found.readings} readings, planes fitted, beams as calibrated: {_size(found)}"
    noise = "" if math.isnan(found.noise_p_value) else f", p = {found.noise_p_value:.2g}"
    yield f"noise and model with free beams: chi2/dof {found.chi2:.1f}/{found.dof}{noise}"
    if found.noise_p_value < SINGLE_LEVEL:
        yield (
            "WARNING: the readings contradict noise and model even with free beams: look for outliers "
            "and wrong plane labels, or state larger sigmas, before you believe what follows"
        )
    if found.drift_dof == 0:
        return
    yield f"movement of the beams: chi2 {found.drift:.1f} of {found.drift_dof} degrees of freedom"
    for beam in found.beams:
        shift = math.hypot(*beam.shift)
        yield (
            f"beam {beam.name} alone moved: p = {beam.p_value:.2g}; it would have moved by "
            f"{shift * IN_MM:.3g} mm and turned by {math.degrees(beam.turn):.3g} deg"
        )


def hold_out_sentence(found: HoldOut) -> str:
    """Say whether a calibration holds for a recording, and what p means."""
    if found.drift_dof == 0 or math.isnan(found.p_value):
        return (
            "Not tested: the recording says nothing about the beams; add stations with more varied "
            "orientations."
        )
    opening = "The calibration holds"
    if found.p_value < SINGLE_LEVEL:
        opening = "The calibration does not hold"
    elif found.p_value < FAMILY_LEVEL:
        opening = "The calibration hardly holds"
    return (
        f"{opening}: a difference this large would come by chance {chance(found.p_value)} such "
        f"recordings (p = {found.p_value:.2g})."
    )


def _size(errors: Fit | HoldOut | Prediction) -> str:
    return f"rms {errors.rms * IN_MM:.4g} mm, largest {errors.max_residual * IN_MM:.4g} mm"
