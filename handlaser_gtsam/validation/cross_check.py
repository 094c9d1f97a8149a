"""Does an independent solver agree? Differences in units of the standard deviation."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from ..arrays import FloatArray
from ..checks import require_kind
from ..data.recording import Recording
from ..data.value import Value
from ..errors import InputError
from ..model.families import BEAM, PLANE
from ..model.sensors.mounted import SENSOR
from ..model.targets.point import POINT
from ..model.targets.sphere import SPHERE
from ..quantities import SINGULAR
from ..results.calibration import Calibration
from ..solvers.reference import ReferenceNoise, solve_reference
from ..solvers.reference_errors import ERRORS
from ..starts import find_start

COMPARED_PARTS = {
    SENSOR.name: {"rotation": slice(0, 3), "location": slice(3, 6), "range error": slice(6, None)},
    BEAM.name: {"location": slice(0, 3), "direction": slice(3, 6), "range error": slice(6, None)},
    PLANE.name: {"normal": slice(0, 3), "offset": slice(3, None)},
    SPHERE.name: {"centre": slice(0, 3), "radius": slice(3, None)},
    POINT.name: {"position": slice(0, None)},
}
"""What is compared at a time of each kind of variable."""


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class CrossCheck(Value):
    """Largest disagreement between the factor graph and the SciPy reference.

    Attributes
    ----------
    largest : float
        Largest difference of a parameter, in its standard deviations.
    parameter : str
        The parameter it belongs to.
    largest_sigma : float
        Largest relative difference of a standard deviation.
    sigma_parameter : str
        The parameter it belongs to.
    iterations : int
        Iterations of the reference.
    """

    largest: float
    parameter: str
    largest_sigma: float
    sigma_parameter: str
    iterations: int


def cross_check(calibration: Calibration, recording: Recording) -> CrossCheck:
    """Solve the readings of `calibration` again with SciPy, from a start of its own.

    Where scales were integrated over, the solution at the most probable ones is compared.

    Raises
    ------
    InputError
        The calibration did not converge, its loss is robust (SciPy solves least squares), or a
        systematic error was freed for which the reference has no formula.
    """
    of_surveys = "a Calibration; hl.validation.cross_check_survey takes the result of a Survey"
    require_kind("calibration", calibration, Calibration, of_surveys)
    require_kind("recording", recording, Recording)
    if calibration.status != "converged":
        raise InputError(f"a calibration that is {calibration.status}", "a converged one")
    if calibration.fit.loss != "gaussian":
        raise InputError(f"a {calibration.fit.loss} loss", "the gaussian loss, which SciPy checks")
    used = calibration.used_in(recording)
    start, solved = find_start(used.readings()).parameters, None
    errors = {effect.code: effect.prior_sigma for effect in calibration.effects}
    without = [code for code in errors if code not in ERRORS]
    if without:
        raise InputError(
            f"a freed {without[0]}", f"free of these, to be checked: {', '.join(ERRORS)}"
        )
    terms = tuple(beam.terms for beam in calibration.beams.values())
    variances, noise = calibration.variances, None
    if variances is not None:
        noise = ReferenceNoise(variances.range_sigma, variances.incidence_sigma, variances.pose)
    if calibration.recorded is not None:  # with the errors in it; their priors have units
        used, solved = calibration.recorded, ~np.isnan(calibration.fit.residuals)
        if noise is None:
            noise = ReferenceNoise(np.full(len(calibration.beams), calibration.fit.range_sigma))
    scaled = calibration.at_scales
    prior = None if scaled is None else scaled.range_error_prior
    reference = solve_reference(used, start, terms, noise, prior, errors, solved)
    own = calibration.parameters() if scaled is None else scaled.parameters
    joint = calibration.covariance if scaled is None else scaled.covariance
    if joint is None:
        raise InputError("a calibration without covariance", "a converged one")
    variance = calibration.fit.range_sigma**2 if noise is None else 1.0
    found = reference.parameters
    off = [ours - theirs for ours, theirs in zip(own.beams, found.beams, strict=True)]
    of_planes = np.column_stack((own.normals - found.normals, own.offsets - found.offsets))
    S, T = variance * reference.beam_covariances, variance * reference.plane_covariances
    beams = zip(calibration.beams, np.hstack(off), joint.all_beams(), S, strict=True)
    planes = zip(calibration.planes, of_planes, joint.all_planes(), T, strict=True)
    rows = [(f"beam {name}", *numbers, COMPARED_PARTS[BEAM.name]) for name, *numbers in beams]
    rows += [(f"plane {name}", *numbers, COMPARED_PARTS[PLANE.name]) for name, *numbers in planes]
    for effect in calibration.effects:
        member = effect.code, effect.subject
        off_size = np.array([effect.size - reference.sizes[member]])
        mine, other = (
            np.array([[sigma**2]]) for sigma in (effect.sigma, reference.size_sigmas[member])
        )
        rows.append((" ".join(member).strip(), off_size, mine, other, {"size": slice(0, 1)}))
    return compared(rows, reference.iterations)


def compared(
    variables: Iterable[tuple[str, FloatArray, FloatArray, FloatArray, Mapping[str, slice]]],
    iterations: int,
) -> CrossCheck:
    """Return the largest disagreement.

    Parameters
    ----------
    variables : iterable of (name, difference, covariance, other covariance, parts)
        Of each variable; parts by what they are, as `location`.
    iterations : int
        Of the reference.
    """
    rows = []
    for name, e, mine, other, parts in variables:
        for quantity, part in parts.items():
            if not e[part].size:
                continue
            # Along the principal axes; those without variance, along a unit vector or of a range error
            # that is not estimated, are omitted.
            variances, axes = np.linalg.eigh(mine[part, part])
            keep = variances > SINGULAR * variances[-1]
            sigma, axes = np.sqrt(variances[keep]), axes[:, keep]
            other_sigma = np.sqrt(np.einsum("ik,ij,jk->k", axes, other[part, part], axes))
            off, ratio = np.abs(axes.T @ e[part]) / sigma, np.abs(other_sigma / sigma - 1.0)
            along = zip(off.tolist(), ratio.tolist(), strict=True)
            rows += [(f"{name} {quantity}", *difference) for difference in along]
    worst = max(rows, key=lambda row: row[1])
    worst_sigma = max(rows, key=lambda row: row[2])
    return CrossCheck(worst[1], worst[0], worst_sigma[2], worst_sigma[0], iterations)
