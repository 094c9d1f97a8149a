"""Which unknowns of the beams go together: the matrix of their correlations."""

from dataclasses import dataclass

import numpy as np

from ...arrays import FloatArray
from ..calibration_fields import LABELS, CalibrationData

FLAGGED = 0.8
"""Correlations above this are flagged: the two unknowns are hardly told apart."""
MOST_BEAMS = 8
"""Beams that are compared: a map of more is not readable."""


@dataclass(frozen=True, slots=True)
class Correlations:
    """Correlations of the unknowns of beams.

    Attributes
    ----------
    labels : tuple of (str, str)
        Beam and coordinate of every row.
    matrix : (n, n)
    """

    labels: tuple[tuple[str, str], ...]
    matrix: FloatArray


def correlations(
    names: tuple[str, ...], directions: FloatArray, covariance: FloatArray
) -> Correlations:
    """Return the correlations of the first beams.

    Of the three components of a direction, the largest follows from the others and is omitted; so is
    what is not estimated.

    Parameters
    ----------
    names : B names
    directions : (B, 3)
    covariance : (8 B, 8 B)
        Over (x, y, z, vx, vy, vz, k1, k2) of every beam, ambient.
    """
    names, S = names[:MOST_BEAMS], covariance[: 8 * MOST_BEAMS, : 8 * MOST_BEAMS]
    variance = np.diagonal(S)
    keep = variance > 0.0
    for index, v in enumerate(directions[:MOST_BEAMS]):
        keep[8 * index + 3 + int(np.abs(v).argmax())] = False
    rows = np.flatnonzero(keep)
    sigma = np.sqrt(variance[rows])
    labels = tuple((names[row // 8], LABELS[row % 8]) for row in rows.tolist())
    return Correlations(labels, S[np.ix_(rows, rows)] / np.outer(sigma, sigma))


def correlations_of(calibration: CalibrationData) -> Correlations | None:
    """Return the correlations of a calibration; None without a covariance."""
    joint = calibration.covariance
    if joint is None or calibration.status != "converged":
        return None
    names = joint.beam_names[:MOST_BEAMS]
    return correlations(names, calibration.parameters().directions, joint.matrix(names, []))
