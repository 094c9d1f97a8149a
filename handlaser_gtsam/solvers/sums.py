"""The sums of a reduction, eliminated by GTSAM: one step, and what is left of each local member.

A graph with a factor a plane and beam has every row once more in GTSAM. Where there are tens of
thousands of rows, or hundreds of beams that errors of the hand couple, their sums go to GTSAM instead:
one key for all that stays, and a `HessianFactor` between it and each local member.
"""

from dataclasses import dataclass

import gtsam
import numpy as np
from gtsam.symbol_shorthand import L, X

from ..arrays import FloatArray
from ..model.elimination import inverse_of
from ..model.reduction import Normal
from ..quantities import TINY


@dataclass(frozen=True, slots=True)
class EliminatedSums:
    """What GTSAM's elimination of the sums gives, for rows in standard deviations.

    Attributes
    ----------
    step : (n,), local_step : (m, d)
        The step to the minimum.
    covariance : (n, n)
        Of what stays.
    known : (m, d, d)
        Covariances of the local members, were all else known.
    response : (m, d, n)
        A step x of what stays moves a local member by -response x.
    """

    step: FloatArray
    local_step: FloatArray
    covariance: FloatArray
    known: FloatArray
    response: FloatArray


def eliminated_sums(normal: Normal, unit: float) -> EliminatedSums:
    """Let GTSAM eliminate the local members of the only problem.

    Parameters
    ----------
    normal : Normal
    unit : float
        Standard deviation of a whitened row.

    Raises
    ------
    RuntimeError, numpy.linalg.LinAlgError
        The system is indeterminate.
    """
    H, g, local, border, own = (array[0] / unit**2 for array in normal.arrays()[:5])
    n, m = len(g), len(local)
    # GTSAM compares pivots: every unknown in the unit of its own information.
    u = 1.0 / np.sqrt(np.maximum(np.diagonal(H), TINY))
    w = 1.0 / np.sqrt(np.maximum(np.einsum("mii->mi", local), TINY))
    H, g = H * u[:, None] * u, g * u
    local, own = local * w[:, :, None] * w[:, None], own * w
    border = border * w[..., None] * u
    graph, order = gtsam.GaussianFactorGraph(), [L(i) for i in range(m)]
    if n:
        graph.add(gtsam.HessianFactor(X(0), H, -g, 0.0))
    nothing, zero = np.zeros((n, n)), np.zeros(n)
    for i in range(m):
        if n:
            E = np.asfortranarray(border[i].T)
            factor = gtsam.HessianFactor(X(0), L(i), nothing, E, zero, local[i], -own[i], 0.0)
        else:
            factor = gtsam.HessianFactor(L(i), local[i], -own[i], 0.0)
        graph.add(factor)
    net, rest = graph.eliminatePartialSequential(gtsam.Ordering(order))
    conditionals = [net.at(i) for i in range(net.size())]
    d = local.shape[1]
    root = np.array([conditional.R() for conditional in conditionals]).reshape(m, d, d)
    root = w[..., None] * np.linalg.inv(root)
    S = np.array([conditional.S() for conditional in conditionals]).reshape(m, d, n)
    alone = np.array([conditional.d() for conditional in conditionals]).reshape(m, d, 1)
    response, alone = root @ S / u, (root @ alone)[..., 0]
    covariance = np.zeros((n, n))
    step = np.zeros(n)
    if n:
        information, vector = rest.hessian(gtsam.Ordering([X(0)]))
        inverse = inverse_of(information)
        covariance, step = inverse * u[:, None] * u, u * (inverse @ vector)
    return EliminatedSums(
        step, alone - response @ step, covariance, root @ root.swapaxes(1, 2), response
    )
