"""How the unknowns of the beams correlate, and which of them the recording hardly tells apart."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..arrays import FloatArray
from ..model.families import BEAM, OF_DIRECTION, OF_RANGE_ERROR
from ..model.joint import JointCovariance

STRONG = 0.95
"""Two unknowns whose correlation is larger in size are hardly distinguished: each would be known three
times as well if the other were known."""


@dataclass(frozen=True, slots=True)
class Coordinate:
    """One of the numbers of a beam, as its family counts them."""

    beam: str
    number: int

    def __str__(self) -> str:
        """Return "beam NAME QUANTITY"."""
        return f"beam {self.beam} {BEAM.labels[self.number]}"


@dataclass(frozen=True, slots=True)
class Correlation:
    """Two unknowns and their correlation coefficient."""

    first: Coordinate
    second: Coordinate
    coefficient: float

    @property
    def advice(self) -> str:
        """What would tell the two apart."""
        if max(self.first.number, self.second.number) >= OF_RANGE_ERROR.start:
            return "measure over a wider span of ranges, or estimate fewer range-error terms"
        if self.first.beam != self.second.beam:
            return "add planes with other normals"
        return "turn the hand further, and vary the range"


def correlation_matrix(
    beams: Sequence[str], directions: FloatArray, covariance: FloatArray
) -> tuple[tuple[Coordinate, ...], FloatArray]:
    """Return the unknowns of beams that are estimated, and their correlations, a row each.

    Of the three components of a direction, the largest follows from the others and is no row.

    Parameters
    ----------
    beams : B names
    directions : (B, 3)
    covariance : (8 B, 8 B)
        Over (x, y, z, vx, vy, vz, k1, k2) of every beam, ambient.
    """
    width = BEAM.size
    variance = np.diagonal(covariance)
    keep = variance > 0.0
    for index, v in enumerate(directions):
        keep[width * index + OF_DIRECTION.start + int(np.abs(v).argmax())] = False
    rows = np.flatnonzero(keep)
    sigma = np.sqrt(variance[rows])
    unknowns = tuple(Coordinate(beams[row // width], row % width) for row in rows.tolist())
    return unknowns, covariance[np.ix_(rows, rows)] / np.outer(sigma, sigma)


def strong_correlations(joint: JointCovariance, limit: float = STRONG) -> tuple[Correlation, ...]:
    """Return the pairs of beam unknowns whose correlation exceeds `limit`, strongest first."""
    # The direction is perpendicular to its tangent plane; its sign does not matter here.
    directions = np.cross(joint.beam_bases[:, :, 0], joint.beam_bases[:, :, 1])
    unknowns, C = correlation_matrix(joint.beam_names, directions, joint.matrix(planes=[]))
    first, second = np.triu_indices(len(unknowns), 1)
    strong = np.flatnonzero(np.abs(C[first, second]) > limit)
    strong = strong[np.argsort(-np.abs(C[first, second])[strong], kind="stable")]
    return tuple(
        Correlation(unknowns[first[i]], unknowns[second[i]], float(C[first[i], second[i]]))
        for i in strong
    )
