"""The rows of range factors: of one, or of many evaluated together."""

from dataclasses import dataclass

import numpy as np

from handlaser_gtsam.arrays import FloatArray
from handlaser_gtsam.model.weighting import Whitening

LOCATION, DIRECTION, RANGE_ERROR = slice(0, 3), slice(3, 5), slice(5, 7)
"""Columns of the variables of a beam in its row."""
NORMAL, OFFSET, PLANE, POSE = slice(7, 9), 9, slice(7, 10), slice(10, 16)
"""Columns of the plane and of the hand pose."""
BEAM = 7
"""Columns of one beam."""


@dataclass(frozen=True, slots=True)
class Evaluation:
    """Residuals and Jacobians of readings at one Values.

    Attributes
    ----------
    residual : (N,)
        [m].
    jacobian : (N, 10) or (N, 16)
        Columns of location, direction (2), range error (2), plane (3) and, where there are pose
        variables, pose (6), in GTSAM's tangent bases. One array: a block's rows lie together.
    white : (N,)
        Whitened residuals [m]; `residual` itself where all readings weigh the same.
    """

    residual: FloatArray
    jacobian: FloatArray
    white: FloatArray

    def rows(self, how: Whitening | None) -> FloatArray:
        """Return whitened derivatives (N, 7 K + 3 or 9): of each of K beams, then plane and pose.

        They are the Jacobian itself, with K = 1, where all readings weigh the same.
        """
        if how is None:
            return self.jacobian
        take, near = how.coefficients(), how.gathered(self.jacobian)
        beams = take[:, :, None] * near[:, :, :BEAM]
        others = np.einsum("nk,nkd->nd", take, near[:, :, BEAM:])
        return np.hstack((beams.reshape(len(take), -1), others))


@dataclass(slots=True)
class Share:
    """What one factor hands out: whitened residuals and derivatives, and the columns of its keys."""

    white: FloatArray
    rows: FloatArray
    columns: tuple[slice, ...]


def evaluation(residual: FloatArray, jacobian: FloatArray, how: Whitening | None) -> Evaluation:
    """Return the evaluation of rows (N,) and (N, 10 or 16), whitened where asked for."""
    return Evaluation(residual, jacobian, residual if how is None else how.apply(residual))


def beam_columns(beam: int, terms: int) -> list[slice]:
    """Return the columns of location, direction and, if any, range error of a beam."""
    first = BEAM * beam
    columns = [slice(first, first + 3), slice(first + 3, first + 5)]
    return columns + ([slice(first + 5, first + 5 + terms)] if terms else [])


def other_columns(beams: int, *, with_pose: bool) -> list[slice]:
    """Return the columns of the plane and, if any, the pose behind those of the beams."""
    first = BEAM * beams
    plane, pose = slice(first, first + 3), slice(first + 3, first + 9)
    return [plane, pose] if with_pose else [plane]
