"""What a person sees of a validation."""

import math
from collections.abc import Iterator

from ..diagnosis.hold_out import HoldOut
from ..diagnosis.validation import Prediction, Validation

MM = 1e3
UNLIKELY = 1e-3


def validation_lines(result: Validation) -> Iterator[str]:
    """Yield the lines of a validation."""
    fit = result.calibration.fit
    yield (
        f"residuals of the calibration itself: rms {fit.rms * MM:.4g} mm, "
        f"largest {fit.largest * MM:.4g} mm"
    )
    for one in result.planes:
        if one.result is None:
            yield f"without plane {one.plane}: no calibration: {one.message}"
            continue
        held = one.result
        yield (
            f"without plane {one.plane}: its readings fit within rms {held.rms * MM:.4g} mm, largest "
            f"{held.largest * MM:.4g} mm; the beams agree with p = {held.p_value:.2g}"
        )
    if result.splits:
        yield from _splits(result.splits)
    if result.reconstruction is not None and result.without_range_error is not None:
        yield (
            "plane from all beams at one station, ranges at the others: "
            f"{_errors(result.reconstruction)}; without range error "
            f"{_errors(result.without_range_error)}"
        )
    else:
        yield "no station has three beams that span a plane: nothing to reconstruct"


def hold_out_lines(found: HoldOut) -> Iterator[str]:
    """Yield the lines of a hold-out test."""
    yield (
        f"{found.readings} readings, planes fitted, beams as calibrated: rms {found.rms * MM:.4g} mm, "
        f"largest {found.largest * MM:.4g} mm"
    )
    noise = "" if math.isnan(found.noise_p_value) else f", p = {found.noise_p_value:.2g}"
    yield f"noise and model with free beams: chi2/dof {found.chi2:.1f}/{found.dof}{noise}"
    if found.noise_p_value < UNLIKELY:
        yield (
            "WARNING: the readings contradict noise and model even with free beams: look for outliers "
            "and wrong plane labels, or state larger sigmas, before you believe what follows"
        )
    if found.drift_dof == 0:
        yield "the recording says nothing about the beams: add stations with more varied orientations"
        return
    yield (
        f"does the calibration hold: chi2 {found.drift:.1f} of {found.drift_dof} degrees of freedom, "
        f"p = {found.p_value:.2g}"
    )
    for beam in found.beams:
        shift = math.dist((0.0, 0.0, 0.0), tuple(beam.shift))
        yield (
            f"beam {beam.name} alone moved: p = {beam.p_value:.2g}; it would have moved by "
            f"{shift * MM:.3g} mm and turned by {math.degrees(beam.turn):.3g} deg"
        )


def _splits(splits: tuple[Prediction, ...]) -> Iterator[str]:
    tests = sum(one.tests for one in splits)
    rms = math.sqrt(sum(one.tests * one.rms**2 for one in splits) / tests)
    unit = math.sqrt(sum(one.tests * one.standardized**2 for one in splits) / tests)
    largest = max(one.largest for one in splits)
    yield (
        f"30 % of the stations from the other 70 %, {len(splits)} times: rms {rms * MM:.4g} mm, "
        f"largest {largest * MM:.4g} mm, {unit:.2f} of the predicted standard deviations"
    )


def _errors(one: Prediction) -> str:
    return f"rms {one.rms * MM:.4g} mm, largest {one.largest * MM:.4g} mm of {one.tests}"
