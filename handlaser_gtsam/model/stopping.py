"""When a least-squares search has arrived, judged by how fast its steps shrink."""

import numpy as np

COST_RESOLUTION = 1e-10
"""Changes of the cost below this part of it are rounding, not evidence."""
LEVEL_STEPS = 6
"""Steps in a row below the resolution of the cost that end a search: fewer occur before a minimum."""


class StoppingRule:
    """Follows the steps of one search.

    The length of a step is measured by its decrement -g . delta: twice the cost it should save, in
    squared standard deviations for unit weights.

    Parameters
    ----------
    tolerance : float
        Standard deviations that may be left to go.
    least_damping : float
        Damping at which a step counts as undamped.
    rounding_cost : float
        What rounding of the residuals alone adds to the cost.
    dof : int
        Degrees of freedom, for the variance of the residuals.
    """

    def __init__(
        self, tolerance: float, least_damping: float, rounding_cost: float, dof: int
    ) -> None:
        self.tolerance, self.least_damping = tolerance, least_damping
        self.rounding_cost, self.dof = rounding_cost, dof
        self._level = 0
        self._damping, self._decrement = -1.0, np.inf

    def resolution(self, cost: float) -> float:
        """Return the smallest change that shows in `cost`."""
        return COST_RESOLUTION * cost + self.rounding_cost

    def arrived(self, decrement: float | None, damping: float, cost: float) -> str | None:
        """Say why the search is over after a step, or None; `decrement` is None for no step."""
        if decrement is None:
            self._level = 0
            return None
        if self._little_left(decrement, damping, cost):
            return "converged"
        self._level = self._level + 1 if decrement <= self.resolution(cost) else 0
        # Where the model does not fit (large residuals), steps shrink slowly.
        return "the cost is level" if self._level >= LEVEL_STEPS else None

    def _little_left(self, decrement: float, damping: float, cost: float) -> bool:
        """Tell whether what is left after the step is below the tolerance.

        A step that is q times the one before it, at the same damping, leaves q / (1 - q) of its length.
        """
        before, self._decrement = self._decrement, decrement
        same, self._damping = damping == self._damping, damping
        if decrement <= self.rounding_cost:
            return True
        if same and decrement < before:
            shrink = float(np.sqrt(decrement / before))
        elif damping <= self.least_damping:
            shrink = 0.5
        else:
            return False
        left = np.sqrt(decrement) * shrink / (1.0 - shrink)
        return bool(left <= self.tolerance * np.sqrt(2.0 * cost / self.dof))
