r"""How much each reading pulls the solution to itself.

With unit weights the variance of a predicted range is h = J inv(J'J) J', its leverage. The residual of
a reading that was used has variance sigma^2 (1 - h), that of one left out sigma^2 (1 + h).
"""

import numpy as np

from ..arrays import BoolArray, FloatArray
from ..data.parameters import Parameters
from ..data.recording import Readings
from ..observability.rank import Observability
from ..solvers.reduction import jacobian_columns

MOST_WORK = 50_000_000
"""Readings times beam unknowns beyond which leverages are taken as zero: so many readings share so many
unknowns that one weighs little, and the information takes too long to invert."""
LEAST_FREEDOM = 1e-6
"""A reading with less than this part of its variance left checks nothing."""


def negligible(readings: Readings, terms: int) -> bool:
    """Tell whether leverages are taken as zero."""
    return len(readings) * readings.beams * (5 + terms) > MOST_WORK


def leverages(parameters: Parameters, readings: Readings, found: Observability) -> FloatArray:
    """Return h (N,) of all readings for the information behind `found` (of those that were used).

    A reading depends on its own beam and, through its plane, on all: with the covariance M of the beams
    and the response R of its plane, J = own - plane R and h = J M J' + plane inverse plane'. Per plane
    R M and R M R' are computed once, so that no row over all beams is kept.
    """
    reduced = found.reduced
    width = len(reduced.beam_unit) // readings.beams
    columns, _ = jacobian_columns(parameters, readings, width - 5, reduced.centres)
    own = columns[:width].T * reduced.beam_unit[:width]
    plane = columns[width : width + 3].T * reduced.plane_unit
    keep = reduced.determined
    root = reduced.axes[:, keep] / np.sqrt(reduced.information[keep])
    planes, at = np.unique(readings.plane, return_inverse=True)
    seen = reduced.plane_response[planes] @ root
    of_beam = root.reshape(readings.beams, width, -1)
    M = of_beam @ np.swapaxes(of_beam, 1, 2)
    of_plane = seen @ np.swapaxes(seen, 1, 2) + reduced.plane_inverse[planes]
    mixed = np.einsum("pik,bwk->pbiw", seen, of_beam, optimize=True)
    h: FloatArray = np.einsum("ni,nij,nj->n", own, M[readings.beam], own)
    h -= 2.0 * np.einsum("ni,niw,nw->n", plane, mixed[at, readings.beam], own)
    h += np.einsum("ni,nij,nj->n", plane, of_plane[at], plane)
    return h


def standardized(
    residual: FloatArray, leverage: FloatArray, used: BoolArray, range_sigma: float
) -> FloatArray:
    """Return residuals (N,) in their own standard deviations; zero where a reading checks nothing."""
    variance = np.where(used, 1.0 - leverage, 1.0 + leverage)
    checks = variance > LEAST_FREEDOM
    scale = range_sigma * np.sqrt(np.where(checks, variance, 1.0))
    return np.where(checks, residual / scale, 0.0)
