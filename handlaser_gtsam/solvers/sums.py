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
    graph = gtsam.GaussianFactorGraph()
    graph.push_back(gtsam.HessianFactor(X(0), H, -g, 0.0))
    nothing, zero = np.zeros((n, n)), np.zeros(n)
    for i in range(m):
        E = np.asfortranarray(border[i].T)
        graph.push_back(gtsam.HessianFactor(X(0), L(i), nothing, E, zero, local[i], -own[i], 0.0))
    net, rest = graph.eliminatePartialSequential(gtsam.Ordering([L(i) for i in range(m)]))
    conditionals = [net.at(i) for i in range(net.size())]
    root = np.linalg.inv(np.array([conditional.R() for conditional in conditionals]))
    response = root @ np.array([conditional.S() for conditional in conditionals])
    alone = (root @ np.array([conditional.d() for conditional in conditionals])[..., None])[..., 0]
    information, vector = rest.hessian(gtsam.Ordering([X(0)]))
    covariance = inverse_of(information)
    step = covariance @ vector
    return EliminatedSums(
        step, alone - response @ step, covariance, root @ root.swapaxes(1, 2), response
    )
