"""The rows of many range factors, evaluated together."""

from dataclasses import dataclass

from handlaser_gtsam.arrays import FloatArray

LOCATION, DIRECTION, RANGE_ERROR = slice(0, 3), slice(3, 5), slice(5, 7)
NORMAL, OFFSET, PLANE, POSE = slice(7, 9), 9, slice(7, 10), slice(10, 16)


@dataclass(frozen=True, slots=True)
class Evaluation:
    """Residuals and Jacobians of all readings at one Values.

    Attributes
    ----------
    residual : (N,)
        [m].
    jacobian : (N, 10) or (N, 16)
        Columns of location, direction (2), range error (2), plane (3) and, where there are pose
        variables, pose (6), in GTSAM's tangent bases. One array: a block's rows lie together.
    """

    residual: FloatArray
    jacobian: FloatArray


@dataclass(frozen=True, slots=True)
class Share:
    """What one factor hands out of an evaluation: its rows, and the columns of each of its keys."""

    of: Evaluation
    rows: slice
    columns: tuple[slice, ...]
