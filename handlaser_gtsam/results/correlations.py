"""Which unknowns of the beams the recording cannot tell apart, and which motion would."""

from dataclasses import dataclass

import numpy as np

from ..model.joint import BEAM_COORDINATES, JointCovariance

STRONG = 0.95
"""Correlations above this are worth a word."""
NAMES = ("location x", "location y", "location z", "direction x", "direction y", "direction z")
LABELS = (*NAMES, "k1", "k2")
"""In the order of `joint.BEAM_COORDINATES`."""
FIRST_ERROR = 6
"""Coordinates from here on are range errors."""


@dataclass(frozen=True, slots=True)
class Coordinate:
    """One of the eight coordinates of a beam, as `joint.BEAM_COORDINATES` counts them."""

    beam: str
    number: int

    def __str__(self) -> str:
        """Return "beam NAME QUANTITY"."""
        return f"beam {self.beam} {LABELS[self.number]}"


@dataclass(frozen=True, slots=True)
class Correlation:
    """Two unknowns and their correlation coefficient."""

    first: Coordinate
    second: Coordinate
    coefficient: float

    @property
    def advice(self) -> str:
        """What would tell the two apart."""
        if max(self.first.number, self.second.number) >= FIRST_ERROR:
            return "measure over a wider span of ranges, or estimate fewer range-error terms"
        if self.first.beam != self.second.beam:
            return "add planes with other normals"
        return "turn the hand further, and vary the range"


def strong_correlations(joint: JointCovariance, limit: float = STRONG) -> tuple[Correlation, ...]:
    """Return the pairs of beam unknowns whose correlation exceeds `limit`, strongest first.

    Of the three components of a direction, the largest follows from the others and is left out.
    """
    S = joint.matrix(planes=[])
    variance = np.diagonal(S)
    keep = variance > 0.0
    for beam, basis in enumerate(joint.beam_bases):
        # The component along which the tangent plane reaches least belongs to the largest one.
        keep[8 * beam + 3 + int(np.linalg.norm(basis, axis=1).argmin())] = False
    rows = np.flatnonzero(keep)
    sigma = np.sqrt(variance[rows])
    C = S[np.ix_(rows, rows)] / np.outer(sigma, sigma)
    first, second = np.triu_indices(len(rows), 1)
    strong = np.flatnonzero(np.abs(C[first, second]) > limit)
    strong = strong[np.argsort(-np.abs(C[first, second])[strong], kind="stable")]
    width = len(BEAM_COORDINATES)
    names = [Coordinate(joint.beam_names[row // width], row % width) for row in rows.tolist()]
    return tuple(
        Correlation(names[first[i]], names[second[i]], float(C[first[i], second[i]]))
        for i in strong
    )
