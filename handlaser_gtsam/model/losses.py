r"""Loss functions of a residual: how much an outlier may pull.

For u = e / (c sigma) with c = `tuning`, the loss rho counts like u^2 / 2 near zero, and the weight of
a reading in reweighted least squares is rho'(u) / u. The tunings give 95 % efficiency for Gaussian
residuals (Zhang, Parameter estimation techniques, 1997, table 1); GTSAM's `mEstimator` of the same name
has the same tuning.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from ..arrays import FloatArray
from ..checks import require_word

LossName = Literal["gaussian", "huber", "cauchy", "tukey"]

TUNING: dict[LossName, float] = {
    "gaussian": 1.0,
    "huber": 1.345,
    "cauchy": 2.3849,
    "tukey": 4.6851,
}


@dataclass(frozen=True, slots=True)
class Loss:
    """A loss function by name, with its tuning constant."""

    name: LossName = "gaussian"

    def __post_init__(self) -> None:
        require_word("loss", self.name, TUNING)

    @property
    def tuning(self) -> float:
        """The constant c of the module's docstring."""
        return TUNING[self.name]

    def cost(self, standardized: FloatArray) -> FloatArray:
        """Return c^2 rho(z / c) for residuals z in standard deviations; z^2 / 2 near zero."""
        z, c = np.abs(standardized), self.tuning
        if self.name == "huber":
            return np.where(z <= c, 0.5 * z * z, c * (z - 0.5 * c))
        if self.name == "cauchy":
            return np.asarray(0.5 * c * c * np.log1p((z / c) ** 2))
        if self.name == "tukey":
            inside = np.maximum(1.0 - (z / c) ** 2, 0.0)
            return np.asarray(c * c / 6.0 * (1.0 - inside**3))
        return 0.5 * z * z

    def weight(self, standardized: FloatArray) -> FloatArray:
        """Return rho'(u) / u, from 1 at zero towards 0 for outliers."""
        z, c = np.abs(standardized), self.tuning
        if self.name == "huber":
            return np.asarray(c / np.maximum(z, c))
        if self.name == "cauchy":
            return np.asarray(1.0 / (1.0 + (z / c) ** 2))
        if self.name == "tukey":
            return np.asarray(np.maximum(1.0 - (z / c) ** 2, 0.0) ** 2)
        return np.ones_like(z)

    def slope(self, standardized: FloatArray) -> FloatArray:
        """Return the derivative of z weight(z): how a reading still holds the estimate."""
        z, c = np.abs(standardized), self.tuning
        if self.name == "huber":
            return np.where(z <= c, 1.0, 0.0)
        if self.name == "cauchy":
            u = (z / c) ** 2
            return np.asarray((1.0 - u) / (1.0 + u) ** 2)
        if self.name == "tukey":
            u = (z / c) ** 2
            return np.where(u < 1.0, (1.0 - u) * (1.0 - 5.0 * u), 0.0)
        return np.ones_like(z)

    def variance_factor(self, standardized: FloatArray, unknowns: int) -> float:
        """Return what the covariance of least squares must be multiplied by (Huber, 1981, 7.6).

        mean(psi^2) / mean(psi')^2 with psi = z weight(z) and the mean of psi^2 over the degrees of
        freedom: near 1.05 for Gaussian residuals of unit variance.
        """
        psi = standardized * self.weight(standardized)
        free = max(len(standardized) - unknowns, 1)
        hold = max(float(self.slope(standardized).mean()), 1e-3)
        return float(psi @ psi) / free / hold**2


GAUSSIAN = Loss()
"""Least squares."""
