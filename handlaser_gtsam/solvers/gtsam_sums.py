"""The sums of a reduction, eliminated by GTSAM: one step, and what is left of each local member.

A graph with a factor a plane and beam has every row once more in GTSAM. Where there are tens of
thousands of rows, or hundreds of beams that errors of the hand couple, their sums go to GTSAM instead:
one key for all that stays, one for a few local members, and a `HessianFactor` between the two.
"""

from dataclasses import dataclass
from math import isqrt

import gtsam
import numpy as np
from gtsam.symbol_shorthand import X
from scipy.linalg.lapack import dposv

from ..arrays import FloatArray
from ..model.reduced_information import inverse_of
from ..model.reduction import Normal
from ..quantities import TINY


@dataclass(frozen=True, slots=True)
class EliminatedSums:
    """What GTSAM's elimination of the sums gives, for rows in standard deviations.

    Attributes
    ----------
    step : (n,), local_step : (m, d)
        The step to the minimum.
    unit : (n,), local_unit : (m, d)
        Units of the unknowns in the following.
    information : (n, n)
        Of what stays.
    net : gtsam.GaussianBayesNet
        A conditional for a few local members each.
    """

    step: FloatArray
    local_step: FloatArray
    unit: FloatArray
    local_unit: FloatArray
    information: FloatArray
    net: gtsam.GaussianBayesNet

    def covariance(self) -> FloatArray:
        """Return the covariance (n, n) of what stays."""
        if not self.unit.size:
            return self.information
        return inverse_of(self.information) * (self.unit[:, None] * self.unit)

    def local_members(self) -> tuple[FloatArray, FloatArray]:
        """Return covariances (m, d, d) of the local members, were all else known, and their response.

        A step x of what stays moves a local member by -response x, (m, d, n).
        """
        (m, d), n = self.local_unit.shape, len(self.unit)
        conditionals = [self.net.at(key) for key in range(self.net.size())]
        together, number = members_of_key(n), np.arange(m)
        size = together * len(conditionals)
        R = np.array([one.R() for one in conditionals]).reshape(size, d, together, d)
        R = R[number, :, number % together]
        S = np.array([one.S() for one in conditionals]).reshape(size, d, n)[:m]
        root = self.local_unit[..., None] * np.linalg.inv(R)
        return root @ root.swapaxes(1, 2), root @ (S / self.unit)


def members_of_key(n: int) -> int:
    """Return how many local members share a key where n unknowns stay.

    A factor costs n^2 numbers whatever it has of local members, and several cost zeros between them.
    """
    return max(isqrt(n), 1)


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
    H, g, L, h = normal.matrix[0], normal.gradient[0], normal.local[0], normal.local_gradient[0]
    n, (m, d) = len(g), h.shape
    of_unknowns, of_members = np.einsum("ii->i", H), np.einsum("mii->mi", L)
    # Errors of the hand far above those of readings take out of the sums all but rounding.
    if min(of_unknowns.min(initial=0.0), of_members.min(initial=0.0)) < 0.0:
        raise np.linalg.LinAlgError("the information is rounding")
    # GTSAM compares pivots: every unknown in the unit of its own information.
    u, w = (1.0 / np.sqrt(np.maximum(own, TINY)) for own in (of_unknowns, of_members))
    together, number = members_of_key(n), np.arange(m)
    keys = -(-m // together)  # the last one has idle members, with a one on the diagonal
    size, width = keys * together, together * d
    local, border, own = (
        np.zeros((size, d, together, d)),
        np.zeros((size, d, n)),
        np.zeros((size, d)),
    )
    np.einsum("kii->ki", local.reshape(keys, width, width))[-1:] = 1.0
    local[number, :, number % together] = L * (w[:, :, None] * w[:, None])
    np.multiply(normal.border[0], w[..., None] * u, out=border[:m])
    np.multiply(h, -w, out=own[:m])
    local, own = local.reshape(keys, width, width), own.reshape(keys, width)
    border = border.reshape(keys, width, n).swapaxes(1, 2)
    stays = X(0)  # the others have numbers
    graph, nothing, zero = gtsam.GaussianFactorGraph(), np.zeros((n, n)), np.zeros(n)
    if n:
        graph.add(gtsam.HessianFactor(stays, H * (u[:, None] * u), -g * u, 0.0))
    for key in range(keys):
        if n:
            pair = stays, key, nothing, border[key], zero, local[key], own[key], 0.0
            graph.add(gtsam.HessianFactor(*pair))
        else:
            graph.add(gtsam.HessianFactor(key, local[key], own[key], 0.0))
    net, rest = graph.eliminatePartialSequential(gtsam.Ordering(list(range(keys))))
    information, step, known = nothing, zero, gtsam.VectorValues()
    if n:
        information, vector = rest.hessian(gtsam.Ordering([stays]))
        _, step, failed = dposv(information, vector)
        if failed:
            raise np.linalg.LinAlgError("the information is singular")
        known.insert(stays, step)
    moved = net.optimize(known)
    local_step = np.array([moved.at(key) for key in range(keys)]).reshape(size, d)[:m]
    return EliminatedSums(u * step, w * local_step, unit * u, unit * w, information, net)
