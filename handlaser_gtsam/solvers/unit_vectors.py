"""Unit vectors as two of their components, as in Wei and Hirzinger; for the SciPy reference only."""

from dataclasses import dataclass

import numpy as np

from ..arrays import FloatArray, IntArray


@dataclass(frozen=True, slots=True)
class UnitVectors:
    """Unit vectors (K, 3) as two components each: which are kept, which one follows, its sign."""

    kept: IntArray
    follows: IntArray
    sign: FloatArray

    @classmethod
    def of(cls, start: FloatArray) -> "UnitVectors":
        """Return how unit vectors near `start` (K, 3) are written."""
        follows = np.abs(start).argmax(axis=1)
        kept = np.array([[i for i in range(3) if i != f] for f in follows], dtype=np.intp)
        kept = kept.reshape(-1, 2)
        return cls(kept, follows, np.sign(start[np.arange(len(start)), follows]))

    def pack(self, vectors: FloatArray) -> FloatArray:
        """Return the pairs (K, 2) of vectors (K, 3)."""
        return np.take_along_axis(vectors, self.kept, axis=1)

    def unpack(self, pairs: FloatArray) -> FloatArray:
        """Return the vectors (K, 3) of pairs (K, 2)."""
        vectors = np.zeros((len(pairs), 3))
        np.put_along_axis(vectors, self.kept, pairs, axis=1)
        third = np.sqrt(np.maximum(1.0 - (pairs**2).sum(axis=1), 0.0))
        vectors[np.arange(len(pairs)), self.follows] = self.sign * third
        return vectors

    def derivative(self, vectors: FloatArray) -> FloatArray:
        """Return d vector / d pair, (K, 3, 2)."""
        rows = np.arange(len(vectors))
        D = np.zeros((len(vectors), 3, 2))
        for column in range(2):
            D[rows, self.kept[:, column], column] = 1.0
        third = vectors[rows, self.follows]
        D[rows, self.follows] = -self.pack(vectors) / third[:, None]
        return D
