"""The noise and the range errors behind a calibration, in words."""

import math

import numpy as np

from ...quantities import IN_DEG, IN_MM
from ...text import some
from ..calibration_fields import CalibrationData
from ..lines import NAMES_IN_LINE, small_mm
from ..reports import NoiseComponent

PRIOR = "the prior decides"
"""Stands beside a sigma of which the recording says little."""
KINDS = {
    "range": "a reading",
    "pose translation": "hand position",
    "pose rotation": "hand rotation",
}


def noise_words(result: CalibrationData) -> str:
    """Return the standard deviations behind the result: given, estimated, or carried by a prior.

    The sigmas of many beams are summed up by the least and the largest.
    """
    estimated = result.noise_estimate
    ranges = [component for component in estimated if component.quantity == "range"]
    parts = [_estimate(component) for component in ranges]
    if len(parts) > NAMES_IN_LINE:
        sigmas = [component.sigma * IN_MM for component in ranges]
        some_by_prior = any(component.prior_carries for component in ranges)
        how = f"estimated; {PRIOR} some" if some_by_prior else "estimated"
        parts = [f"a reading {min(sigmas):.2g} to {max(sigmas):.2g} mm, by beam ({how})"]
    if not parts:
        how = "given" if result.fit.range_sigma_given else "estimated"
        parts = [f"a reading {small_mm(result.fit.range_sigma, 3)} ({how})"]
    parts += [_estimate(component) for component in estimated if component.quantity != "range"]
    return ", ".join([*parts, *_given_poses(result)])


def _estimate(one: NoiseComponent) -> str:
    """Return an estimated sigma with its own standard deviation."""
    scale, unit = (IN_DEG, "deg") if one.quantity == "pose rotation" else (IN_MM, "mm")
    error = f" +- {one.error * scale:.1g}" if math.isfinite(one.error) else ""
    owner = KINDS[one.quantity] + ("" if one.beam is None else f" of beam {one.beam}")
    how = PRIOR if one.prior_carries else "estimated"
    return f"{owner} {one.sigma * scale:.2g}{error} {unit} ({how})"


def _given_poses(result: CalibrationData) -> list[str]:
    """Return the pose sigmas that were not estimated."""
    pose = None if result.variances is None else result.variances.pose
    if result.fit.poses == "exact" or pose is None:
        variables = result.fit.poses == "estimated"
        return ["hand poses as variables of the graph" if variables else "hand poses exact"]
    variance, estimated = np.einsum("sii->si", pose).mean(axis=0), result.noise_estimate
    given = {
        "pose translation": f"{math.sqrt(float(variance[3:].mean())) * IN_MM:.2g} mm",
        "pose rotation": f"{math.sqrt(float(variance[:3].mean())) * IN_DEG:.2g} deg",
    }
    found = {one.quantity for one in estimated}
    return [f"{KINDS[one]} {size} (given)" for one, size in given.items() if one not in found]


def zero_excluded(result: CalibrationData, beam: str) -> tuple[bool, bool]:
    """Tell whether the 95 % intervals of k1 and of k2 exclude zero."""
    interval = result.intervals(beam)
    if interval is None or not np.isfinite(interval[6:]).all():
        return False, False
    k1, k2 = ((interval[6:, 0] > 0.0) | (interval[6:, 1] < 0.0)).tolist()
    return k1, k2


def range_error_words(result: CalibrationData) -> str:
    """Return which range errors differ from zero, and their learned scales."""
    if not any(beam.terms for beam in result.beams.values()):
        return "taken as zero"
    excluded = {name: zero_excluded(result, name) for name in result.beams}
    listed = []
    for index, term in enumerate(("k1", "k2")):
        names = [name for name, found in excluded.items() if found[index]]
        if names:
            listed.append(f"{term}{_beams(names, len(excluded))}")
    words = "zero is not excluded"
    if listed:
        words = f"zero is excluded (95 %) for {' and '.join(listed)}"
    learned = result.range_error_scales
    form = "d + k1 d + k2 d^2"
    if learned is not None:
        form = f"learned scales k1 {learned.k1:.2g}, k2 {learned.k2_per_m:.2g}/m"
    return f"{form}: {words}"


def _beams(names: list[str], beams: int) -> str:
    if len(names) == beams:
        return " of all beams" if beams > 1 else ""
    return f" of beam{'s' if len(names) > 1 else ''} {some(names, NAMES_IN_LINE)}"
