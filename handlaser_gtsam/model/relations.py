"""Relations: rows that tie a few variables, such as an angle between two planes that is known.

This is what a relation is; those that `[[known]]` states are in `known`.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from ..arrays import FloatArray, IntArray
from .block import Rows, Slot, Values, Weights
from .families import FAMILIES

Rule = Callable[..., tuple[FloatArray, Sequence[FloatArray]]]
"""Takes the numbers (K, size) of each member; returns residuals (K, S) in standard deviations, and for
each member their derivatives (K, S, dim) by its tangent coordinates."""


@dataclass(frozen=True, slots=True, eq=False)
class Relation:
    """Rows that tie members.

    Attributes
    ----------
    of : sequence of (family, member)
    rule : Rule
    """

    of: Sequence[tuple[str, int]]
    rule: Rule
    weights: Weights = field(default_factory=Weights)

    def slots(self) -> tuple[Slot, ...]:
        """Return the members, which the only group sees."""
        slots, first = [], 0
        for family, member in self.of:
            dim = FAMILIES[family].dim
            slots.append(Slot(family, np.array([member]), slice(first, first + dim)))
            first += dim
        return tuple(slots)

    def evaluate(self, values: Values) -> Rows:
        """Return the rows."""
        numbers = [values[family][:, member] for family, member in self.of]
        e, derivatives = self.rule(*numbers)
        columns = [np.moveaxis(J, 2, 0) for J in derivatives]
        return Rows(np.concatenate((*columns, e[None]))[:, :, None])

    def picked(self, problems: IntArray) -> "Relation":  # noqa: ARG002  (all have the same)
        """Return the same."""
        return self
