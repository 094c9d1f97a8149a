"""One vectorised evaluation handed out to many factors, or to one.

While Python owns the Values, a driver evaluates every reading at once in NumPy and the factors only
hand out their rows. The sharing is scoped: it holds inside `with shared.handed_out(evaluation)` and
only for the Values of that evaluation; a factor met anywhere else evaluates its own block.

iSAM2 owns its Values and decides itself which factors to relinearise: two of them, or all. Within
one update they are all linearised at the same Values. So blocks evaluate themselves at first, and once
more than a few have been asked for, all of them are evaluated at once (`Gathering`).
"""

from collections.abc import Hashable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from itertools import accumulate, pairwise
from typing import TYPE_CHECKING, NamedTuple, TypeVar

import gtsam
import numpy as np

from handlaser_gtsam import model
from handlaser_gtsam.arrays import FloatArray, IntArray, gathered
from handlaser_gtsam.data.readings import Regressors
from handlaser_gtsam.errors import SolverError
from handlaser_gtsam.model.families import (
    BEAM,
    DIRECTION,
    MOUNT_DIM,
    PLANE,
    POSE,
)
from handlaser_gtsam.model.weighting import Whitening, joined

if TYPE_CHECKING:
    from .range_block import RangeBlock

Item = TypeVar("Item", bound=Hashable)

SLAB = 4096
"""Rows evaluated at once: their intermediate arrays stay in the processor's cache."""

FEW_BLOCKS = 10
"""Blocks that evaluate themselves before all are evaluated together: for few that takes longer."""


PLANE_COLUMNS = slice(BEAM.dim, BEAM.dim + PLANE.dim)
"""Columns of a row by its plane, after those by its beam; tangents are GTSAM's."""
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


class Share(NamedTuple):  # there are thousands, and a frozen dataclass takes three times as long
    """What one factor hands out of a shared evaluation.

    Attributes
    ----------
    white : (n,)
        Whitened residuals [m].
    parts : arrays (n, dim)
        Their derivatives by each of the factor's keys.
    matrices : arrays (n, dim)
        Where to write these before `derivatives`, which has the matrices, is handed out.
    derivatives : gtsam.JacobianVector
        Factors of one shape share it: GTSAM copies what it gets before it asks the next factor.
    """

    white: FloatArray
    parts: tuple[FloatArray, ...]
    matrices: list[FloatArray]
    derivatives: gtsam.JacobianVector


@dataclass(frozen=True, slots=True)
class Alike:
    """Blocks of the same shape, whose rows lie together as they are handed out.

    Attributes
    ----------
    index : (G, n)
        Rows of each of G blocks in the shared evaluation.
    white : (G, n)
    rows : (D, G, n)
        Derivatives; a block and some of the columns are a matrix in GTSAM's order.
    """

    index: IntArray
    white: FloatArray
    rows: FloatArray


class SharedEvaluation:
    """Evaluates the blocks of a graph together.

    Parameters
    ----------
    blocks : sequence of RangeBlock
        The error functions of the graph's range factors; their keys may be shared in any way.
    whitening : Whitening, optional
        Of all their rows together, where the blocks have one.
    measured : (N,) or Regressors, optional
        What residuals take of all their readings; asked of the blocks where not given.
    """

    def __init__(
        self,
        blocks: Sequence["RangeBlock"],
        whitening: Whitening | None = None,
        measured: FloatArray | Regressors | None = None,
    ) -> None:
        self.blocks, self.whitening = tuple(blocks), whitening
        sizes = np.array([len(block.distance) for block in blocks])
        self.first = np.cumsum(sizes) - sizes
        self.distance = np.concatenate([block.distance for block in blocks])
        self.measured: FloatArray | Regressors = self.distance if measured is None else measured
        if measured is None and any(isinstance(block.measured, Regressors) for block in blocks):
            self.measured = Regressors.joined([block.measured for block in blocks])
        self._R = np.asfortranarray(np.concatenate([block.world_R_hand for block in blocks]))
        self._t = np.asfortranarray(np.concatenate([block.world_t_hand for block in blocks]))
        counts = np.array([len(block.beams) for block in blocks])
        self.slot = np.concatenate([block.beam_of for block in blocks])
        self.beams, beam_of = _unique([beam for block in blocks for beam in block.beams])
        self.beam_of = beam_of[np.repeat(np.cumsum(counts) - counts, sizes) + self.slot]
        self.planes, plane_of = _unique([block.plane for block in blocks])
        self.poses, pose_of = _unique([block.pose for block in blocks])
        self.plane_of, self.pose_of = np.repeat(plane_of, sizes), np.repeat(pose_of, sizes)
        known = np.array([key is None for key in self.poses])
        self._posed = np.flatnonzero(~known[self.pose_of])
        self._terms: dict[int | None, int] = {}
        self._shares: dict[int, Share] = {}
        self._alike: list[Alike] = []

    def evaluate(self, values: gtsam.Values) -> Evaluation:
        """Return every row at `values`; raises like `RangeBlock.evaluate`."""
        (r, v, k), (R, t) = self._beams(values), self._hand_poses(values)
        plane = np.array([values.atOrientedPlane3(p).planeCoefficients() for p in self.planes])
        n, b = plane[:, :3], plane[:, 3]
        basis = model.tangent_basis(np.concatenate((v, n)))
        v_basis, n_basis = basis[: len(v)], basis[len(v) :]
        size, with_pose = len(self.distance), bool(self._posed.size)
        jacobian = np.empty((POSE_COLUMNS.stop if with_pose else PLANE_COLUMNS.stop, size)).T
        residual = np.empty(size)
        for first in range(0, size, SLAB):
            rows = slice(first, min(first + SLAB, size))
            of_beam, of_plane = self.beam_of[rows], self.plane_of[rows]
            x = model.Scene(
                R[rows],
                t[rows],
                gathered(r, of_beam),
                gathered(v, of_beam),
                gathered(n, of_plane),
                b.take(of_plane),
                gathered(k, of_beam),
            )
            linear = model.linearize(x, self.measured[rows], with_pose=with_pose)
            bases_of_rows = gathered(v_basis, of_beam), gathered(n_basis, of_plane)
            columns = model.tangent_columns(linear, *bases_of_rows, None, 2)
            jacobian[rows, : PLANE_COLUMNS.stop] = columns[:-1].T
            residual[rows] = columns[-1]
            if with_pose:
                jacobian[rows, POSE_COLUMNS] = linear.pose
        if not np.isfinite(residual).all():
            raise SolverError("residual of a range factor is not finite; expected finite values")
        white = residual if self.whitening is None else self.whitening.apply(residual)
        return Evaluation(residual, jacobian, white)

    def reach(self) -> float:
        """Return the largest coordinate of a known hand position plus the largest reading [m]."""
        return float(np.abs(self._t).max() + np.abs(self.distance).max())

    @contextmanager
    def handed_out(self, evaluation: Evaluation) -> Iterator[None]:
        """Let every block hand out its rows of `at` until the context ends."""
        try:
            self.hand_out(evaluation)
            yield
        finally:
            for block in self.blocks:
                block.prepared = None

    def hand_out(self, evaluation: Evaluation) -> None:
        """Let every block hand out its rows of `at` until somebody takes them back."""
        rows = evaluation.rows(self.whitening, self.slot)
        if not self._shares:
            self._prepare(rows.shape[1])
        for alike in self._alike:
            # Modes other than "raise" write to the output at once.
            np.take(evaluation.white, alike.index, out=alike.white, mode="clip")
            np.take(rows.T, alike.index, axis=1, out=alike.rows, mode="clip")
        for i, share in self._shares.items():
            self.blocks[i].prepared = share

    def _prepare(self, width: int) -> None:
        """Make what the blocks hand out, of rows with `width` derivatives.

        GTSAM takes a NumPy array as a matrix of its own, which costs more than to copy between
        matrices. So there are matrices of GTSAM for every shape, which are written through their views.
        """
        members: dict[tuple[int, tuple[int, ...], bool], list[int]] = {}
        for i, block in enumerate(self.blocks):
            shape = len(block.distance), self._terms_of(block), block.pose is not None
            members.setdefault(shape, []).append(i)
        for (size, _, _), blocks in members.items():
            columns = self.columns(self.blocks[blocks[0]])
            index = self.first[blocks][:, None] + np.arange(size)
            alike = Alike(index, np.empty(index.shape), np.empty((width, *index.shape)))
            self._alike.append(alike)
            empty = [np.zeros((size, of.stop - of.start)) for of in columns]
            derivatives = gtsam.JacobianVector(empty)
            matrices = [derivatives[i] for i in range(len(columns))]
            parts = zip(*[alike.rows[of].transpose(1, 2, 0) for of in columns], strict=True)
            for i, white, of_block in zip(blocks, alike.white, parts, strict=True):
                self._shares[i] = Share(white, of_block, matrices, derivatives)

    def columns(self, block: "RangeBlock") -> tuple[slice, ...]:
        """Return the columns of each key of a block, once the number of its range errors is known."""
        beams = int(self.slot.max()) + 1
        return _columns_of(self._terms_of(block), beams, block.pose is not None)

    def _terms_of(self, block: "RangeBlock") -> tuple[int, ...]:
        """Return the number of range-error terms of each beam of a block."""
        return tuple([self._terms[beam.range_error] for beam in block.beams])

    def _beams(self, values: gtsam.Values) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return locations, directions and range errors of the beams."""
        k, terms = np.zeros((len(self.beams), 2)), {}
        for i, beam in enumerate(self.beams):
            terms[beam.range_error], k[i] = range_error(values, beam.range_error)
        if terms != self._terms:  # what blocks hand out has another shape
            self._terms, self._shares, self._alike = terms, {}, []
        v = [values.atUnit3(beam.direction).point3() for beam in self.beams]
        return np.array([values.atPoint3(beam.location) for beam in self.beams]), np.array(v), k

    def _hand_poses(self, values: gtsam.Values) -> tuple[FloatArray, FloatArray]:
        if not self._posed.size:
            return self._R, self._t
        R, t, known = self._R.copy(), self._t.copy(), gtsam.Pose3()
        poses = [known if key is None else values.atPose3(key) for key in self.poses]
        index = self.pose_of[self._posed]
        R[self._posed] = np.array([pose.rotation().matrix() for pose in poses])[index]
        t[self._posed] = np.array([pose.translation() for pose in poses])[index]
        return R, t


@cache
def _columns_of(terms: tuple[int, ...], beams: int, with_pose: bool) -> tuple[slice, ...]:
    """Return the columns of a block's keys: of its beams with some terms, its plane and its pose."""
    columns = []
    for beam, count in enumerate(terms):
        ends = [0, DIRECTION.start, MOUNT_DIM, *([MOUNT_DIM + count] if count else [])]
        columns += [slice(BEAM.dim * beam + a, BEAM.dim * beam + b) for a, b in pairwise(ends)]
    others = accumulate((PLANE.dim, *([POSE.dim] if with_pose else [])), initial=BEAM.dim * beams)
    return (*columns, *(slice(a, b) for a, b in pairwise(others)))


def range_error(values: gtsam.Values, key: int | None) -> tuple[int, FloatArray]:
    """Return the number of terms under `key`, and (k1, k2); raises SolverError for three or more."""
    k = np.zeros(2)
    if key is None:
        return 0, k
    vector = values.atVector(key)
    if not 1 <= vector.size <= 2:
        name = gtsam.DefaultKeyFormatter(key)
        raise SolverError(f"range error {name} of {vector.size} terms; expected (k1,) or (k1, k2)")
    k[: vector.size] = vector
    return vector.size, k


def _unique(items: Sequence[Item]) -> tuple[list[Item], IntArray]:
    """Return the different items and, for each of `items`, its index among them."""
    number: dict[Item, int] = {}
    index = [number.setdefault(item, len(number)) for item in items]
    return list(number), np.array(index, dtype=np.intp)


class Gathering:
    """Counts how many blocks are asked for, and evaluates all of them when they are many."""

    def __init__(self, blocks: Sequence["RangeBlock"]) -> None:
        self.blocks, self._asked = blocks, 0

    def share(self, block: "RangeBlock", values: gtsam.Values) -> Share | None:
        """Return the rows of `block`, or None where it is to evaluate itself."""
        self._asked += 1
        if self._asked <= FEW_BLOCKS or len(self.blocks) <= 2 * FEW_BLOCKS:
            return None
        # From now on every block has what it hands out, and asks no more.
        whitenings = [one.whitening for one in self.blocks if one.whitening is not None]
        shared = SharedEvaluation(self.blocks, joined(whitenings))
        shared.hand_out(shared.evaluate(values))
        return block.prepared


@contextmanager
def evaluated_together(blocks: Sequence["RangeBlock"]) -> Iterator[None]:
    """Let the blocks evaluate together inside the context; the Values must not change in it."""
    gathering = Gathering(blocks)
    try:
        for block in blocks:
            block.gathering = gathering
        yield
    finally:
        for block in blocks:
            block.gathering = block.prepared = None
