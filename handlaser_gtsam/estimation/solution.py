"""One joint solution: what was solved, where it ended, and what is determined there."""

from dataclasses import dataclass
from typing import Literal

from ..data.parameters import Parameters, RangeErrorPrior
from ..model.losses import GAUSSIAN
from ..model.weighting import Variances, Whitening
from ..observability.rank import Observability
from ..solvers.graph import CalibrationGraph
from ..solvers.levenberg import LevenbergResult
from .posterior import Posterior, ScaleEstimate


@dataclass(frozen=True, slots=True)
class Solution:
    """One joint solution and its diagnosis.

    Attributes
    ----------
    problem : CalibrationGraph
    result : LevenbergResult
    parameters : Parameters
        At the most probable scales.
    observability : Observability
    variances : Variances or None
        Variances behind the weights; None where all readings weigh the same.
    whitening : Whitening or None
        Whitening of the readings, in their order, poses eliminated; None where all weigh the same.
    prior : RangeErrorPrior or None
        Prior of the range errors, at the most probable scales.
    posterior : Posterior or None
        The estimate with the scales integrated over; None where only a common sigma is unknown.
    """

    problem: CalibrationGraph
    result: LevenbergResult
    parameters: Parameters
    observability: Observability
    variances: Variances | None = None
    whitening: Whitening | None = None
    prior: RangeErrorPrior | None = None
    posterior: Posterior | None = None
    scales: tuple[ScaleEstimate, ...] = ()
    """Scales of the noise that were estimated, beside a common one of all readings."""

    @property
    def scales_estimated(self) -> bool:
        """Whether there are any."""
        return bool(self.scales)

    @property
    def poses(self) -> Literal["exact", "marginalised", "estimated"]:
        """How errors of the hand poses counted."""
        if self.variances is None or self.variances.pose is None:
            return "exact"
        return "estimated" if self.problem.poses else "marginalised"

    @property
    def chi2(self) -> float:
        """Sum of squared residuals in units of the problem's sigma, with the priors of poses and k."""
        if self.problem.poses and self.problem.loss == GAUSSIAN:
            return 2.0 * self.result.cost
        chi2 = float(self.result.white @ self.result.white) / self.problem.range_sigma**2
        if self.prior is not None:
            chi2 += self.prior.chi2(self.parameters.range_errors)
        return chi2

    @property
    def dof(self) -> int:
        """Readings and priors of range errors, less unknowns that are determined."""
        priors = 0 if self.prior is None else self.prior.rows(max(self.problem.terms))
        return len(self.result.residual) + priors - self.observability.rank

    @property
    def redundancy(self) -> int:
        """How many readings there are beyond all unknowns that are determined."""
        return len(self.result.residual) - self.observability.rank

    @property
    def best(self) -> Parameters:
        """The estimate: the mean over the scales where these are integrated over."""
        return self.parameters if self.posterior is None else self.posterior.parameters
