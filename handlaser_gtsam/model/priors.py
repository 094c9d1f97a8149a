"""Gaussian priors of vector coordinates, as a block."""

from dataclasses import dataclass, field

import numpy as np

from ..arrays import FloatArray, IntArray
from .block import Rows, Slot, Values, Weights
from .families import FAMILIES


@dataclass(frozen=True, slots=True, eq=False)
class VectorPrior:
    """Independent Gaussians of the last coordinates of all members of a family.

    Attributes
    ----------
    family : str
        Its last part is a vector.
    root : (K, n, q)
        One over the standard deviation of the last q coordinates of each member; zero where nothing is
        known.
    mean : (n, q)
    """

    family: str
    root: FloatArray
    mean: FloatArray
    weights: Weights = field(default_factory=Weights)

    def slots(self) -> tuple[Slot, ...]:
        """Return the members, one a group."""
        members = np.arange(self.root.shape[1])
        return (Slot(self.family, members, slice(0, FAMILIES[self.family].dim)),)

    def evaluate(self, values: Values) -> Rows:
        """Return a row a coordinate."""
        dim, q = FAMILIES[self.family].dim, self.root.shape[2]
        off = values[self.family][..., -q:] - self.mean
        columns = np.zeros((dim + 1, *off.shape))
        for i in range(q):
            columns[dim - q + i, ..., i] = self.root[..., i]
        columns[-1] = self.root * off
        return Rows(columns)

    def picked(self, problems: IntArray) -> "VectorPrior":
        """Return the priors of some problems."""
        root = self.root if len(self.root) == 1 else self.root[problems]
        return VectorPrior(self.family, root, self.mean, self.weights.picked(problems))
