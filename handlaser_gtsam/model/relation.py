"""Relations: rows that tie a few variables, such as an angle between two planes that is known.

This is what a relation is; those that `[[known]]` states are in `known_relations`.

A relation is its residuals, and nothing else: derivatives follow from a step along an imaginary axis,
f(x + i h u) = f(x) + i h f'(x) u + O(h^2). No digit is lost, as no difference is formed (Squire and
Trapp, SIAM Review 40(1), 1998, doi 10.1137/S003614459631241X).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ..arrays import FloatArray
from ..errors import InputError
from ..quantities import SINGULAR
from .block import Rows, Slot, Values, Weights
from .families import FAMILIES
from .range_blocks import slots_of

Numbers = NDArray[np.complex128]
"""Numbers (..., size) of members: real, or with a small imaginary part."""
Rule = Callable[..., Numbers]
"""Takes the numbers (..., size) of each member; returns residuals (..., S) in standard deviations.

It is a formula of +, *, `sqrt` and the like, which hold for complex numbers: no absolute value, and no
comparison but of real parts."""


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
        return slots_of(*((family, np.array([member])) for family, member in self.of))

    def evaluate(self, values: Values) -> Rows:
        """Return the rows.

        Raises
        ------
        InputError
            The rule returns no array of residuals.
        """
        slots = self.slots()
        numbers = []
        for slot in slots:
            x = values[slot.family][:, slot.member[0]]
            # A row with a step along each tangent coordinate of all members, and one without.
            stepped = np.zeros((slots[-1].columns.stop + 1, *x.shape), dtype=complex)
            stepped[:] = x
            tangents = FAMILIES[slot.family].tangents_at(x)
            stepped[slot.columns] += 1j * SINGULAR * np.moveaxis(tangents, -1, 0)
            numbers.append(stepped)
        e = self.rule(*numbers)
        if not isinstance(e, np.ndarray):
            raise InputError(
                f"a rule that returns a {type(e).__name__}",
                "the residuals alone: their derivatives follow from them",
            )
        columns: FloatArray = e.imag / SINGULAR
        columns[-1] = e[-1].real
        return Rows(columns[:, :, None])
