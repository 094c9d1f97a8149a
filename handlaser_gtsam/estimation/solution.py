"""What a joint solution is: where the search ended, how readings weigh there, what is determined."""

from dataclasses import dataclass
from typing import Literal

import gtsam

from ..arrays import FloatArray
from ..data.parameters import Parameters, RangeErrorPrior
from ..data.readings import Readings
from ..model.joint import JointCovariance
from ..model.losses import GAUSSIAN, Loss
from ..model.weighting import Variances, Whitening
from ..observability.rank import Observability
from ..solvers.graph import CalibrationGraph, read_parameters
from ..solvers.graph_levenberg import LevenbergResult, Status
from .posterior import Posterior
from .scales import NoiseComponent


@dataclass(frozen=True, slots=True)
class Minimum:
    """Where a solver ended.

    Attributes
    ----------
    readings : Readings
        With the regressors of the range errors, every plane in its frame.
    terms : tuple of int
        Range-error terms of each beam.
    loss : Loss
    sigma : float
        Standard deviation of a whitened residual [m].
    parameters : Parameters
    status, message : str
    cost : float
        Half the sum of squares in standard deviations, or its robust loss.
    iterations : int
        Accepted steps.
    first_step : float
        Length of the first trial step [standard deviations].
    residual, white : (N,)
        Plain and whitened [m].
    graph : CalibrationGraph, optional
        Where GTSAM solved.
    values : gtsam.Values, optional
        Its values.
    """

    readings: Readings
    terms: tuple[int, ...]
    loss: Loss
    sigma: float
    parameters: Parameters
    status: Status
    message: str
    cost: float
    iterations: int
    first_step: float
    residual: FloatArray
    white: FloatArray
    graph: CalibrationGraph | None = None
    values: gtsam.Values | None = None

    @classmethod
    def of_graph(cls, graph: CalibrationGraph, result: LevenbergResult) -> "Minimum":
        """Return where a solver of the graph ended."""
        return cls(
            graph.readings,
            graph.terms,
            graph.loss,
            graph.range_sigma,
            read_parameters(graph, result.values),
            result.status,
            result.message,
            result.cost,
            result.iterations,
            result.history[0].step if result.history else 0.0,
            *result.residuals(),
            graph,
            result.values,
        )

    @property
    def estimates_poses(self) -> bool:
        """Whether hand poses are variables."""
        return self.graph is not None and bool(self.graph.poses)


@dataclass(frozen=True, slots=True)
class Solution:
    """One joint solution and its diagnosis.

    Attributes
    ----------
    at : Minimum
        At the most probable scales.
    observability : Observability
    variances : Variances or None
        Variances behind the weights; None where all readings weigh the same.
    whitening : Whitening or None
        Whitening of the readings, in their order, poses eliminated; None where all weigh the same.
    prior : RangeErrorPrior or None
        Prior of the range errors, at the most probable scales.
    posterior : Posterior or None
        The estimate with the scales integrated over; None where none but a common sigma is unknown,
        under a robust loss, and where the solution is not fully determined or fits exactly.
    scales : tuple of NoiseComponent
        Scales of the noise that were learned. Empty where a common range sigma alone is unknown and
        range errors have no learned prior: then the residuals tell it.
    joint : JointCovariance or None
        GTSAM's covariance for `at.sigma`, offsets in the frames of the readings; None where GTSAM has
        not eliminated: something is undetermined, the loss is robust, its last search did not
        converge, its step on the sums was not short, or its Cholesky calls a sound system
        indeterminate.
    """

    at: Minimum
    observability: Observability
    variances: Variances | None = None
    whitening: Whitening | None = None
    prior: RangeErrorPrior | None = None
    posterior: Posterior | None = None
    scales: tuple[NoiseComponent, ...] = ()
    joint: JointCovariance | None = None

    @property
    def parameters(self) -> Parameters:
        """Beams and planes at the most probable scales."""
        return self.at.parameters

    @property
    def terms(self) -> int:
        """Most range-error terms of a beam."""
        return max(self.at.terms)

    @property
    def scales_estimated(self) -> bool:
        """Whether scales of the noise were estimated."""
        return bool(self.scales)

    @property
    def poses(self) -> Literal["exact", "marginalised", "estimated"]:
        """How errors of the hand poses counted."""
        if self.variances is None or self.variances.pose is None:
            return "exact"
        return "estimated" if self.at.estimates_poses else "marginalised"

    @property
    def chi2(self) -> float:
        """Sum of squared residuals in units of the problem's sigma, with the priors of poses and k."""
        if self.at.estimates_poses and self.at.loss == GAUSSIAN:
            return 2.0 * self.at.cost
        chi2 = float(self.at.white @ self.at.white) / self.at.sigma**2
        if self.prior is not None:
            chi2 += self.prior.chi2(self.parameters.range_errors)
        return chi2

    @property
    def dof(self) -> int:
        """Readings and priors of range errors, less unknowns that are determined."""
        priors = 0 if self.prior is None else self.prior.rows(self.terms)
        return len(self.at.residual) + priors - self.observability.rank

    @property
    def redundancy(self) -> int:
        """How many readings there are beyond all unknowns that are determined."""
        return len(self.at.residual) - self.observability.rank

    @property
    def best(self) -> Parameters:
        """The estimate: the mean over the scales where these are integrated over."""
        return self.parameters if self.posterior is None else self.posterior.parameters
