"""The damped linear system of one step, (H + lambda diag(H)) delta = -g, eliminated by GTSAM."""

from collections.abc import Callable
from dataclasses import dataclass

import gtsam
import numpy as np

from ..arrays import FloatArray
from ..quantities import SINGULAR

Squares = Callable[[], dict[int, FloatArray]]
"""Returns, for every key, the squared lengths of its Jacobian columns [standard deviations]."""


@dataclass(frozen=True, slots=True)
class Step:
    """A step of all variables.

    Attributes
    ----------
    delta : gtsam.VectorValues
    decrement : float
        -g . delta: twice the cost the step should save, in squared standard deviations.
    """

    delta: gtsam.VectorValues
    decrement: float


class LinearSystem:
    """A linearised graph."""

    def __init__(
        self, linear: gtsam.GaussianFactorGraph, ordering: gtsam.Ordering, squares: Squares
    ) -> None:
        self.linear, self.ordering, self.squares = linear, ordering, squares

    def solved(self, damping: float) -> Step | None:
        """Return the step; None where the system is singular."""
        damped = self.linear
        if damping > 0.0:
            damped = gtsam.GaussianFactorGraph()
            damped.push_back(self.linear)
            for key, columns in self.squares().items():
                # Marquardt's damping needs at least a trace where a column is empty.
                squares, dim = np.maximum(columns, SINGULAR * columns.max()), len(columns)
                unit = gtsam.noiseModel.Unit.Create(dim)
                damped.add(key, np.diag(np.sqrt(damping * squares)), np.zeros(dim), unit)
        try:
            delta = damped.optimize(self.ordering)
        except RuntimeError:  # GTSAM's indeterminate linear system
            return None
        return _checked(delta, -self.linear.gradientAtZero().dot(delta))


def squared_columns(linear: gtsam.GaussianFactorGraph) -> dict[int, FloatArray]:
    """Return, for every key, the squared lengths of its whitened Jacobian columns."""
    sizes = linear.gradientAtZero()
    total: dict[int, FloatArray] = {}
    for factor in (linear.at(i) for i in range(linear.size()) if linear.exists(i)):
        first, squares = 0, (factor.jacobian()[0] ** 2).sum(axis=0)
        for key in factor.keys():  # noqa: SIM118
            dim = sizes.at(key).size
            total[key] = total.get(key, np.zeros(dim)) + squares[first : first + dim]
            first += dim
    return total


def _checked(delta: gtsam.VectorValues, decrement: float) -> Step | None:
    return Step(delta, decrement) if np.isfinite(decrement) and decrement >= 0.0 else None
