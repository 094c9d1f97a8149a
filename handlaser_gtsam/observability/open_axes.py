"""Which directions of an information matrix are undetermined, by how far one block of unknowns may go.

Along a unit vector over 400 beams that go together the standard deviation is twenty times as large as
for each: the beam, or the variable, counts, and not how many go together.
"""

import numpy as np

from ..arrays import BoolArray, FloatArray, IntArray
from ..quantities import SINGULAR


def open_axes(
    values: FloatArray, axes: FloatArray, block: IntArray, floor: float, rounding: float = 0.0
) -> BoolArray:
    """Return which axes are undetermined.

    Parameters
    ----------
    values : (K,)
        Information along orthogonal unit vectors, among them all with less than `floor`.
    axes : (n, K)
        These vectors, as columns.
    block : (n,)
        The number of the beam, or variable, that each unknown belongs to.
    floor : float
        Information that determines a block by itself. A direction that many share needs less.
    rounding : float
        Information below this counts as zero.
    """
    weak, lost = np.flatnonzero(values < floor), values < rounding
    # Variance of each block along each direction, as a part of the largest that it may have.
    moved = np.zeros((int(block.max()) + 1, len(weak)))
    np.add.at(moved, block, axes[:, weak] ** 2)
    moved *= floor / np.maximum(values[weak], SINGULAR * floor)
    moved[:, lost[weak]] = 0.0
    while (over := moved.sum(axis=1) > 1.0).any():
        most = np.unique(moved[over].argmax(axis=1))
        lost[weak[most]] = True
        moved[:, most] = 0.0
    return lost
