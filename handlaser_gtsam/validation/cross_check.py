"""Does an independent solver agree? Differences in units of the standard deviation."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ..arrays import FloatArray
from ..checks import require_kind
from ..data.parameters import Parameters
from ..data.recording import Recording
from ..data.value import Value
from ..errors import InputError
from ..model.joint import JointCovariance
from ..results.calibration import Calibration
from ..solvers.reference import ReferenceNoise, ReferenceSolution, solve_reference
from ..starts import find_start


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
        The calibration did not converge, or its loss is robust: SciPy solves least squares.
    """
    require_kind("calibration", calibration, Calibration)
    require_kind("recording", recording, Recording)
    if calibration.status != "converged":
        raise InputError(f"a calibration that is {calibration.status}", "a converged one")
    if calibration.fit.loss != "gaussian":
        raise InputError(f"a {calibration.fit.loss} loss", "the gaussian loss, which SciPy checks")
    used = calibration.used_in(recording)
    start = find_start(used.readings()).parameters
    terms = tuple(beam.terms for beam in calibration.beams.values())
    variances, noise = calibration.variances, None
    if variances is not None:
        noise = ReferenceNoise(variances.range_sigma, variances.incidence_sigma, variances.pose)
    scaled = calibration.at_scales
    prior = None if scaled is None else scaled.range_error_prior
    reference = solve_reference(used, start, terms, noise=noise, prior=prior)
    own = calibration.parameters() if scaled is None else scaled.parameters
    joint = calibration.covariance if scaled is None else scaled.covariance
    if joint is None:
        raise InputError("a calibration without covariance", "a converged one")
    variance = calibration.fit.range_sigma**2 if variances is None else 1.0
    rows = list(_rows(calibration, own, joint, reference, variance))
    worst = max(rows, key=lambda row: row[1])
    worst_sigma = max(rows, key=lambda row: row[2])
    return CrossCheck(worst[1], worst[0], worst_sigma[2], worst_sigma[0], reference.iterations)


def _rows(
    calibration: Calibration,
    own: Parameters,
    joint: JointCovariance,
    reference: ReferenceSolution,
    variance: float,
) -> Iterator[tuple[str, float, float]]:
    """Yield the rows of `compared` of every beam and plane; `variance` is the variance of a reading."""
    found = reference.parameters
    off = [ours - other for ours, other in zip(own.beams, found.beams, strict=True)]
    names = [f"beam {name}" for name in calibration.beams]
    theirs = variance * reference.beam_covariances
    terms = [beam.terms for beam in calibration.beams.values()]
    rows = zip(names, np.hstack(off), joint.all_beams(), theirs, terms, strict=True)
    for name, e, mine, other, count in rows:
        yield from compared(f"{name} location", e, mine, other, slice(0, 3))
        yield from compared(f"{name} direction", e, mine, other, slice(3, 6))
        yield from compared(f"{name} range error", e, mine, other, slice(6, 6 + count))
    difference = np.column_stack((own.normals - found.normals, own.offsets - found.offsets))
    names = [f"plane {name}" for name in calibration.planes]
    theirs = variance * reference.plane_covariances
    for name, e, mine, other in zip(names, difference, joint.all_planes(), theirs, strict=True):
        yield from compared(f"{name} normal", e, mine, other, slice(0, 3))
        yield from compared(f"{name} offset", e, mine, other, slice(3, 4))


def compared(
    name: str, difference: FloatArray, mine: FloatArray, other: FloatArray, part: slice
) -> list[tuple[str, float, float]]:
    """Return (name, difference in sigmas, relative difference of sigma) along the principal axes.

    Axes without variance (along a unit vector) are omitted.
    """
    if part.start == part.stop:
        return []
    variances, axes = np.linalg.eigh(mine[part, part])
    keep = variances > 1e-12 * variances[-1]
    sigma, axes = np.sqrt(variances[keep]), axes[:, keep]
    along = np.abs(axes.T @ difference[part]) / sigma
    other_sigma = np.sqrt(np.einsum("ik,ij,jk->k", axes, other[part, part], axes))
    ratio = np.abs(other_sigma / sigma - 1.0)
    return [(name, float(a), float(r)) for a, r in zip(along, ratio, strict=True)]
