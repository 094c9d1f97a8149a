"""The rows of range factors: of one, or of many evaluated together."""

from dataclasses import dataclass
from itertools import pairwise

import gtsam
import numpy as np

from handlaser_gtsam.arrays import FloatArray, IntArray
from handlaser_gtsam.model.families import BEAM, DIRECTION, MOUNT_DIM, PLANE, POSE
from handlaser_gtsam.model.weighting import Whitening

PLANE_COLUMNS = slice(BEAM.dim, BEAM.dim + PLANE.dim)
"""Columns of a row by its plane, after those by its beam; tangents are GTSAM's."""
NORMAL_COLUMNS, OFFSET_COLUMN = slice(BEAM.dim, PLANE_COLUMNS.stop - 1), PLANE_COLUMNS.stop - 1
"""Columns of a row by the normal of its plane, and by its offset."""
POSE_COLUMNS = slice(PLANE_COLUMNS.stop, PLANE_COLUMNS.stop + POSE.dim)
"""Columns of a row by its hand pose."""


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

    def rows(self, how: Whitening | None, beam: IntArray) -> FloatArray:
        """Return whitened derivatives (N, 7 K + 3 or 9): by each of K beams, then plane and pose.

        `beam` (N,) is which of its factor's K beams each reading is of. They are the Jacobian itself,
        with K = 1, where all readings weigh the same.
        """
        if how is None:
            return self.jacobian
        rows, K = self.jacobian, int(beam.max()) + 1
        if K > 1:
            of_beams = np.zeros((len(rows), K, BEAM.dim))
            of_beams[np.arange(len(rows)), beam] = rows[:, : BEAM.dim]
            rows = np.hstack((of_beams.reshape(len(rows), -1), rows[:, BEAM.dim :]))
        return how.apply_rows(rows)


@dataclass(slots=True)
class Share:
    """What one factor hands out: whitened residuals [m], and their derivatives by each of its keys."""

    white: FloatArray
    derivatives: gtsam.JacobianVector


def evaluation(residual: FloatArray, jacobian: FloatArray, how: Whitening | None) -> Evaluation:
    """Return the evaluation of rows (N,) and (N, 10 or 16), whitened where asked for."""
    return Evaluation(residual, jacobian, residual if how is None else how.apply(residual))


def beam_columns(beam: int, terms: int) -> list[slice]:
    """Return the columns of location, direction and, if any, range error of a beam."""
    first = BEAM.dim * beam
    ends = [0, DIRECTION.start, MOUNT_DIM, *([MOUNT_DIM + terms] if terms else [])]
    return [slice(first + a, first + b) for a, b in pairwise(ends)]


def other_columns(beams: int, *, with_pose: bool) -> list[slice]:
    """Return the columns of the plane and, if any, the pose, which follow the beams."""
    first = BEAM.dim * beams
    plane, pose = slice(first, first + 3), slice(first + 3, first + 9)
    return [plane, pose] if with_pose else [plane]
