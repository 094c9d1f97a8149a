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

LARGEST_WORK = 50_000_000
"""Readings times beam unknowns beyond which leverages are taken as zero."""
LEAST_FREEDOM = 1e-6
"""A reading with less than this part of its variance left checks nothing."""


def leverages(parameters: Parameters, readings: Readings, found: Observability) -> FloatArray:
    """Return h (N,) of all readings for the information behind `found` (of those that were used)."""
    reduced = found.reduced
    if len(readings) * len(reduced.beam_unit) > LARGEST_WORK:
        return np.zeros(len(readings))
    width = len(reduced.beam_unit) // readings.beams
    columns, _ = jacobian_columns(parameters, readings, width - 5, reduced.centres)
    own = columns[:width].T * reduced.beam_unit[:width]
    plane = columns[width : width + 3].T * reduced.plane_unit
    rows = -np.einsum("ni,nij->nj", plane, reduced.plane_response[readings.plane])
    place = readings.beam[:, None] * width + np.arange(width)
    np.put_along_axis(rows, place, np.take_along_axis(rows, place, 1) + own, 1)
    keep = reduced.determined
    along = rows @ (reduced.axes[:, keep] / np.sqrt(reduced.information[keep]))
    h: FloatArray = np.einsum("nk,nk->n", along, along)
    h += np.einsum("ni,nij,nj->n", plane, reduced.plane_inverse[readings.plane], plane)
    return h


def standardized(
    residual: FloatArray, leverage: FloatArray, used: BoolArray, range_sigma: float
) -> FloatArray:
    """Return residuals (N,) in their own standard deviations; zero where a reading checks nothing."""
    variance = np.where(used, 1.0 - leverage, 1.0 + leverage)
    checks = variance > LEAST_FREEDOM
    scale = range_sigma * np.sqrt(np.where(checks, variance, 1.0))
    return np.where(checks, residual / scale, 0.0)
