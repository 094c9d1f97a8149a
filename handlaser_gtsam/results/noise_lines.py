"""The noise and the range errors behind a calibration, in words."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from .lines import DEG, MM, some

if TYPE_CHECKING:
    from .calibration import Calibration, NoiseComponent


SHOWN = 4
KINDS = {
    "range": "a reading",
    "pose translation": "hand position",
    "pose rotation": "hand rotation",
}


def noise_words(result: Calibration, *, brief: bool = False) -> str:
    """Return the standard deviations behind the result: given, estimated, or carried by a prior.

    In brief, those of several beams are summed up by the least and the largest.
    """
    estimated = {one.name: one for one in result.noise_estimate}
    ranges = [one for one in result.noise_estimate if one.quantity == "range"]
    parts = [estimate_words(one) for one in ranges]
    if brief and len(parts) > 1:
        sigmas = [one.sigma * MM for one in ranges]
        parts = [f"a reading {min(sigmas):.2g} to {max(sigmas):.2g} mm, by beam (estimated)"]
    if not parts:
        how = "given" if result.fit.range_sigma_given else "estimated"
        parts = [f"a reading {result.fit.range_sigma * MM:.3g} mm ({how})"]
    poses = [estimate_words(one) for one in result.noise_estimate if one.quantity != "range"]
    words = ", ".join([*parts, *poses, *_given_poses(result, set(estimated))])
    carried = [_owner(one) for one in estimated.values() if one.prior_carries]
    if carried:
        words += f"; the prior decides that of {some(carried, SHOWN)}"
    return f"noise, standard deviations: {words}"


def estimate_words(one: NoiseComponent) -> str:
    """Return an estimated sigma with its own standard deviation."""
    scale, unit = (DEG, "deg") if one.quantity == "pose rotation" else (MM, "mm")
    name = _owner(one)
    if not math.isfinite(one.error):
        return f"{name} {one.sigma * scale:.2g} {unit} (estimated)"
    return f"{name} {one.sigma * scale:.2g} +- {one.error * scale:.1g} {unit} (estimated)"


def _owner(one: NoiseComponent) -> str:
    """Return what a sigma is of."""
    return KINDS[one.quantity] + ("" if one.beam is None else f" of beam {one.beam}")


def _given_poses(result: Calibration, estimated: set[str]) -> list[str]:
    """Return the pose sigmas that were not estimated."""
    pose = None if result.variances is None else result.variances.pose
    if result.fit.poses == "exact" or pose is None:
        return ["hand poses exact"]
    variance = np.einsum("sii->si", pose).mean(axis=0)
    turn, shift = (math.sqrt(float(variance[part].mean())) for part in (slice(3), slice(3, 6)))
    words = []
    if "pose translation" not in estimated:
        words.append(f"hand position {shift * MM:.2g} mm (given)")
    if "pose rotation" not in estimated:
        words.append(f"hand rotation {turn * DEG:.2g} deg (given)")
    return words


def zero_excluded(result: Calibration, beam: str) -> tuple[bool, bool]:
    """Tell whether the 95 % intervals of k1 and of k2 exclude zero."""
    interval = result.intervals(beam)
    if interval is None or not np.isfinite(interval[6:]).all():
        return False, False
    (low1, high1), (low2, high2) = interval[6:].tolist()
    return low1 > 0.0 or high1 < 0.0, low2 > 0.0 or high2 < 0.0


def range_error_words(result: Calibration) -> str:
    """Return which range errors differ from zero, and their learned scales."""
    if not any(beam.terms for beam in result.beams.values()):
        return "range errors: taken as zero"
    excluded = {name: zero_excluded(result, name) for name in result.beams}
    listed = []
    for index, term in enumerate(("k1", "k2")):
        names = [name for name, found in excluded.items() if found[index]]
        if names:
            listed.append(f"{term}{_beams(names, len(result.beams))}")
    words = (
        f"zero is excluded (95 %) for {' and '.join(listed)}" if listed else "zero is not excluded"
    )
    learned = result.range_error_scales
    if learned is None:
        return f"range errors, d + k1 d + k2 d^2: {words}"
    return f"range errors, learned scales k1 {learned.k1:.2g}, k2 {learned.k2_per_m:.2g}/m: {words}"


def _beams(names: list[str], beams: int) -> str:
    if len(names) == beams:
        return " of all beams" if beams > 1 else ""
    return f" of beam{'s' if len(names) > 1 else ''} {some(names, SHOWN)}"
