"""Blocks of shots in a few rows each: ranges whose noise is correlated, and what range errors leave."""

from dataclasses import dataclass, field, replace

import numpy as np

from ..arrays import FloatArray, IntArray
from ..data.survey import RAY_ERRORS
from .block import Rows, Slot, Values, Weights
from .ranges import Ranges
from .sensors.mounted import SENSOR


@dataclass(frozen=True, slots=True, eq=False)
class Mixed:
    """Ranges whose readings within a group are correlated.

    Attributes
    ----------
    ranges : Ranges
    mix : (G, S, T)
        Residuals times this matrix are independent; columns of zeros stand for no row.
    weights : Weights
        Of the mixed rows.
    """

    ranges: Ranges
    mix: FloatArray
    weights: Weights = field(default_factory=Weights)

    def slots(self) -> tuple[Slot, ...]:
        """Return the slots of the ranges."""
        return self.ranges.slots()

    def evaluate(self, values: Values) -> Rows:
        """Return the mixed rows."""
        rows = self.ranges.evaluate(values)
        impossible = rows.impossible
        if impossible is not None:
            impossible = np.broadcast_to(
                impossible.any(axis=2, keepdims=True),
                (*impossible.shape[:2], self.mix.shape[2]),
            )
        return Rows((rows.columns[..., None, :] @ self.mix)[..., 0, :], impossible)

    def picked(self, problems: IntArray) -> "Mixed":
        """Return the block of some problems."""
        ranges, weights = self.ranges.picked(problems), self.weights.picked(problems)
        return replace(self, ranges=ranges, weights=weights)


@dataclass(frozen=True, slots=True, eq=False)
class Unexplained:
    """What the range error of a sensor does to a shot beside moving its shape.

    Attributes
    ----------
    member : (G,)
        Sensors.
    residual : (G, T)
        Without range errors.
    by_error : (G, T, 4)
        Their derivatives.
    weights : Weights
    """

    member: IntArray
    residual: FloatArray
    by_error: FloatArray
    weights: Weights = field(default_factory=Weights)

    def slots(self) -> tuple[Slot, ...]:
        """Return the sensors."""
        return (Slot(SENSOR.name, self.member, slice(0, SENSOR.dim)),)

    def evaluate(self, values: Values) -> Rows:
        """Return the rows."""
        errors = values[SENSOR.name][:, self.member][..., -len(RAY_ERRORS) :]
        e = self.residual + np.einsum("kgi,gti->kgt", errors, self.by_error)
        columns = np.zeros((SENSOR.dim + 1, *e.shape))
        columns[-1 - len(RAY_ERRORS) : -1] = np.moveaxis(self.by_error, 2, 0)[:, None]
        columns[-1] = e
        return Rows(columns)

    def picked(self, problems: IntArray) -> "Unexplained":
        """Return the block of some problems."""
        return replace(self, weights=self.weights.picked(problems))
