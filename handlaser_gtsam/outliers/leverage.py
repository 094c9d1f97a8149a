r"""How much each reading pulls the solution to itself.

With unit weights the variance of a predicted range is h = J inv(J'J) J', its leverage. The residual of
a reading that was used has variance sigma^2 (1 - h), and sigma^2 (1 + h) if it was not. With S the
covariance of the beams, W_p the response of a plane and P_p its covariance for known beams, a reading
with the derivatives a by its beam i and c by its plane has

    h = a' S_ii a - 2 a' (S W_p')_i c + c' (W_p S W_p' + P_p) c

so that nothing grows with the readings times the unknowns.
"""

import numpy as np

from ..arrays import BoolArray, FloatArray
from ..data.parameters import Parameters
from ..data.recording import Readings
from ..observability.rank import Observability
from ..quantities import NEGLIGIBLE
from ..solvers.beam_problem import jacobian_columns

LARGEST_LEVERAGES = 50_000_000
"""Readings times beam unknowns beyond which leverages are taken as zero: a single reading weighs little
there, and the information takes too long to invert."""


def leverages(
    parameters: Parameters, readings: Readings, observability: Observability
) -> FloatArray:
    """Return h (N,) of all readings for the information `observability` of the readings in use."""
    active = observability.active.reshape(readings.beams, -1)
    width = active.shape[1]
    columns = jacobian_columns(parameters, readings, width - 5, observability.centres)
    unit = observability.padded(observability.beam_unit).reshape(active.shape)
    rows_of_beams = np.ascontiguousarray(columns[:width].T * unit[readings.beam])
    plane = columns[width : width + 3].T * observability.plane_unit
    S, W = observability.covariance(), observability.information.local_response
    follow = S @ np.swapaxes(W, 1, 2)
    rest = observability.information.local_inverse + W @ follow
    beams = np.zeros((readings.beams, width, width))
    across = np.zeros((readings.planes, readings.beams, width, 3))
    ends = np.cumsum(active.sum(axis=1))
    for i, end in enumerate(ends.tolist()):
        rows, has = slice(end - int(active[i].sum()), end), np.flatnonzero(active[i])
        beams[i][np.ix_(has, has)] = S[rows, rows]
        across[:, i, has] = follow[:, rows]
    h = np.empty(len(readings))
    for i, own in enumerate(beams):
        rows_of_beam = np.flatnonzero(readings.beam == i)
        a = rows_of_beams[rows_of_beam]
        h[rows_of_beam] = _dot(a @ own, a)
    # What a plane says beside the beam and by itself, of which the former counts twice.
    pulled = rows_of_beams[:, None] @ across[readings.plane, readings.beam]
    own_pull = plane[:, None] @ rest[readings.plane]
    h += _dot((own_pull - 2.0 * pulled)[:, 0], plane)
    # It is a variance: where hardly anything is determined, differences of large numbers are rounding.
    return np.maximum(h, 0.0)


def _dot(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return the products (N,) of the rows of a and b (N, i)."""
    products: FloatArray = np.einsum("ni,ni->n", a, b)
    return products


def standardized(
    residual: FloatArray, leverage: FloatArray, used: BoolArray, range_sigma: float
) -> FloatArray:
    """Return residuals (N,) in their own standard deviations; zero where a reading checks nothing."""
    variance = np.where(used, 1.0 - leverage, 1.0 + leverage)
    checks = variance > NEGLIGIBLE
    scale = range_sigma * np.sqrt(np.where(checks, variance, 1.0))
    return np.where(checks, residual / scale, 0.0)
