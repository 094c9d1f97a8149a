r"""Readings on a grid of beams and stations, and their rows at any parameters.

Beams of a station share its hand pose R, t, and stations of a plane its normal n with the tangent basis
u_1, u_2. All that a reading needs of its station are (R'a, t . a) for a = n, u_1, u_2: the axes in
homogeneous coordinates of the hand. All that it needs of its beam are products of these with (r, 1),
(v, 0) and the tangent basis of v likewise. With the range s the spot lies at (R'u_i, t . u_i) .
(r + s v, 1) along u_i.

Several problems of one shape are worked on together. The arrays are (problem, beam, cell): cells are
the slots of chunks of stations of one plane, all chunks of one size, so that the normal equations are
stacked products of the rows of a beam in a chunk. A test compares the rows with `model.linearize`.
"""

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace

import numpy as np

from .. import model
from ..arrays import BoolArray, FloatArray, IntArray
from ..data.parameters import Parameters
from ..data.readings import Readings, Regressors
from ..model.weighting import Whitening

CHUNK_SLOTS = 32
"""Slots of a chunk; a plane with more stations has several chunks, so that few slots stay empty."""
PLANE_COLUMNS = 4
"""Columns of a row after those by its beam: two tangents of the plane, its offset, the residual."""


@dataclass(frozen=True, slots=True)
class GridRows:
    """The rows of all readings of K problems.

    Attributes
    ----------
    columns : (w + 4, K, B, cells)
        Derivatives by the beam, along the plane's tangents and by its offset, then residuals [m]; zero
        where no reading counts.
    centres : (K, P, 3)
        Where the offset of each plane is taken: amid its laser spots [m].
    cosine : (K,)
        Of the incidence closest to grazing.
    bases : (K B + K P, 3, 2)
        Tangents of the directions, then of the normals, that steps are along.
    """

    columns: FloatArray
    centres: FloatArray
    cosine: FloatArray
    bases: FloatArray


@dataclass(slots=True)
class _Seen:
    """What the readings have in common at one point, (K, .., cells)."""

    turned: FloatArray
    """(R'a, t . a) for a = n, u_1, u_2: (K, 3, 4, cells)."""
    along: FloatArray
    """Products of these with (r, 1), (v, 0) and what else is asked of a beam: (K, 3, m, B, cells)."""
    c: FloatArray
    s: FloatArray
    cosine: FloatArray
    flattest: FloatArray
    """Of the absolute cosines: (K,)."""


class Grid:
    """Readings of problems of one shape: the same beams, planes and stations, row by row.

    Parameters
    ----------
    problems : sequence of Readings
        A single element where all problems share their readings: the parameters then say how many
        problems there are.
    """

    def __init__(self, problems: Sequence[Readings]) -> None:
        shape = problems[0]
        self.beams, self.planes = shape.beams, shape.planes
        rows, station, planes = _stations(shape)
        sizes = np.bincount(planes, minlength=self.planes)
        self.slots = int(min(sizes.max(), CHUNK_SLOTS))
        self._sizes: FloatArray = np.maximum(self.beams * sizes, 1).astype(float)
        chunks = np.maximum(-(-sizes // self.slots), 1)
        self.first: IntArray = np.cumsum(chunks) - chunks
        self._first_cell: IntArray = self.first * self.slots
        self.plane: IntArray = np.repeat(np.arange(self.planes), chunks * self.slots)
        place = np.arange(len(planes)) + (self._first_cell - np.cumsum(sizes) + sizes)[planes]
        self.cells = len(self.plane)
        self.place: IntArray = place[station]
        self._index = shape.beam * self.cells + self.place
        self.read: BoolArray | None = None
        if len(shape) < self.beams * self.cells:
            self.read = self.spread(np.ones((1, len(shape)))) > 0.0
        self.distance = self.spread(np.array([p.distance for p in problems]))
        self.measured: FloatArray | Regressors = self.distance
        if shape.regressors is not None:
            regressors = [p.regressors for p in problems if p.regressors is not None]
            self.measured = Regressors(
                self.spread(np.array([p.constant for p in regressors])),
                self.spread(np.array([p.level for p in regressors])),
            )
        self._by_k = np.array(model.range_error_derivatives(self.measured))
        self.poses = np.zeros((len(problems), 3, 4, self.cells))
        for k, problem in enumerate(problems):
            self.poses[k, :, :3, place] = problem.world_R_hand[rows]
            self.poses[k, :, 3, place] = problem.world_t_hand[rows]

    def picked(self, problems: IntArray) -> "Grid":
        """Return the grid of some of the problems."""
        new = copy(self)
        new.distance, new.poses = self.distance[problems], self.poses[problems]
        new.measured, new._by_k = self.measured[problems], self._by_k[:, problems]
        return new

    def spread(self, values: FloatArray) -> FloatArray:
        """Return values (K, N) of readings on the grid (K, B, cells), zero where there is none."""
        grid = np.zeros((len(values), self.beams * self.cells))
        grid[:, self._index] = values
        return grid.reshape(len(values), self.beams, -1)

    def gathered(self, grid: FloatArray) -> FloatArray:
        """Return the values (K, N) of the readings from values on the grid (K, B, cells)."""
        values: FloatArray = grid.reshape(len(grid), -1)[:, self._index]
        return values

    def residuals(self, parameters: Parameters) -> tuple[FloatArray, FloatArray]:
        """Return residuals [m] and cosines of the incidence (K, B, cells) at parameters of K problems.

        Parameters stand one problem after the other. Residuals of beams that graze mean nothing.
        """
        seen = self._seen(
            parameters, parameters.normals[:, :, None], parameters.directions[:, None], self.read
        )
        return self._residual(seen, parameters), seen.cosine

    def facing(self, parameters: Parameters) -> Parameters:
        """Return parameters of K problems with the normals of all planes away from the sensors."""
        _, cosine = self.residuals(parameters)
        cosine = cosine if self.read is None else cosine * self.read
        ahead = np.add.reduceat(cosine.sum(axis=1), self._first_cell, axis=1)
        sign = np.where(ahead.ravel() < 0.0, -1.0, 1.0)
        return replace(
            parameters,
            normals=parameters.normals * sign[:, None],
            offsets=parameters.offsets * sign,
        )

    def rows(
        self,
        parameters: Parameters,
        terms: int,
        counted: BoolArray | None = None,
        bases: FloatArray | None = None,
    ) -> GridRows:
        """Return the rows of all readings at parameters of K problems, one after the other.

        Parameters
        ----------
        parameters : Parameters
        terms : int
        counted : (K, B, cells), optional
            Readings that count; the others may graze their planes.
        bases : (K B + K P, 3, 2), optional
            Tangents of the directions, then of the normals; `model.tangent_basis` where not given.
        """
        counted = self.read if counted is None else counted
        if bases is None:
            bases = model.tangent_basis(np.concatenate((parameters.directions, parameters.normals)))
        v_basis, basis = bases[: len(parameters.directions)], bases[len(parameters.directions) :]
        axes = np.concatenate((parameters.normals[:, :, None], basis), axis=2)
        turns = np.concatenate((parameters.directions[:, None], v_basis.swapaxes(1, 2)), axis=1)
        seen = self._seen(parameters, axes, turns, counted)
        c, s, along = seen.c, seen.s, seen.along
        copies, width = len(c), 5 + terms
        columns = np.empty((width + PLANE_COLUMNS, *c.shape))
        np.multiply(c, seen.turned[:, 0, :3].transpose(1, 0, 2)[:, :, None], out=columns[:3])
        np.multiply(s * c, along[:, 0, 2:].transpose(1, 0, 2, 3), out=columns[3:5])
        columns[5:width] = self._by_k[:terms]
        spot = s[:, None] * along[:, 1:, 1]
        spot += along[:, 1:, 0]
        spot = spot.transpose(1, 0, 2, 3)
        middle = self._plane_means(spot, counted)
        spot -= middle.take(self.plane, axis=-1)[:, :, None]
        np.multiply(c, spot, out=columns[width : width + 2])
        columns[-2], columns[-1] = c, self._residual(seen, parameters)
        if counted is not None:
            columns *= counted
        centres = (basis @ middle.transpose(1, 2, 0).reshape(-1, 2, 1))[..., 0]
        centres -= parameters.offsets[:, None] * parameters.normals
        return GridRows(columns, centres.reshape(copies, -1, 3), seen.flattest, bases)

    def reach(self) -> FloatArray:
        """Return the largest coordinate of a hand plus the largest reading [m] of each problem (K,)."""
        positions = np.abs(self.poses[:, :, 3]).max(axis=(1, 2))
        reach: FloatArray = positions + np.abs(self.distance).max(axis=(1, 2))
        return reach

    def by_block(self, columns: FloatArray) -> FloatArray:
        """Return columns (q, K, B, cells) by chunk and beam: (K, chunks, B, q, slots)."""
        parted = columns.reshape(*columns.shape[:3], -1, self.slots)
        return parted.transpose(1, 3, 2, 0, 4)

    def by_plane(self, sums: FloatArray) -> FloatArray:
        """Return sums over chunks (K, chunks, ...) as sums over planes (K, P, ...)."""
        if sums.shape[1] == self.planes:
            return sums
        total: FloatArray = np.add.reduceat(sums, self.first, axis=1)
        return total

    def _plane_means(self, values: FloatArray, counted: BoolArray | None) -> FloatArray:
        """Return means (q, K, P) over the readings of every plane of values (q, K, B, cells)."""
        first = self._first_cell
        if counted is None:
            return np.asarray(np.add.reduceat(values.sum(axis=2), first, axis=2) / self._sizes)
        size = np.add.reduceat(counted.sum(axis=1), first, axis=1)
        total = np.add.reduceat((values * counted).sum(axis=2), first, axis=2)
        return np.asarray(total / np.maximum(size, 1))

    def _residual(self, seen: _Seen, parameters: Parameters) -> FloatArray:
        k = parameters.range_errors.reshape(len(seen.c), self.beams, 1, 2)
        return seen.s - model.corrected(self.measured, k)

    def _seen(
        self, parameters: Parameters, axes: FloatArray, turns: FloatArray, counted: BoolArray | None
    ) -> _Seen:
        """Return what readings have in common.

        For axes (K P, 3, q) of the planes, the normal first, and turns (K B, m - 1, 3) of the beams,
        the direction first.
        """
        copies, beams = len(parameters.locations) // self.beams, self.beams
        by_plane = axes.reshape(copies, self.planes, 3, -1).transpose(0, 2, 3, 1)
        turned = np.einsum("kjic,kjac->kaic", self.poses, by_plane.take(self.plane, axis=-1))
        arms = np.zeros((copies, turns.shape[1] + 1, beams, 4))
        arms[:, 0, :, :3] = parameters.locations.reshape(copies, beams, 3)
        arms[:, 0, :, 3] = 1.0
        arms[:, 1:, :, :3] = turns.reshape(copies, beams, -1, 3).swapaxes(1, 2)
        along = arms.reshape(copies, 1, -1, 4) @ turned
        along = along.reshape(*turned.shape[:2], -1, beams, self.cells)
        cosine = along[:, 0, 1]
        if counted is not None:
            cosine = np.where(counted, cosine, 1.0)
        steep = np.abs(cosine)
        flattest = steep.reshape(copies, -1).min(axis=1)
        finite = cosine
        if not (flattest >= model.GRAZING_LIMIT).all():
            # The cosine says what grazes; here the range only has to stay finite.
            finite = np.where(steep < model.GRAZING_LIMIT, model.GRAZING_LIMIT, cosine)
        c = -1.0 / finite
        height = parameters.offsets.reshape(copies, -1).take(self.plane, axis=1)
        s = (along[:, 0, 0] + height[:, None]) * c
        return _Seen(turned, along, c, s, cosine, flattest)


@dataclass(frozen=True, slots=True)
class Weighing:
    """How the readings of K problems, or of all alike, weigh on a grid.

    Attributes
    ----------
    root : (K, B, cells) or None
        Roots of weights of independent readings; zero for those that do not count.
    matrix : (K, cells, B, B) or None
        Weights of the readings of a station, where they are correlated.
    """

    root: FloatArray | None = None
    matrix: FloatArray | None = None

    def picked(self, rows: IntArray) -> "Weighing":
        """Return the weighing of some problems."""
        arrays = (self.root, self.matrix)
        return Weighing(*(a if a is None or len(a) == 1 else a[rows] for a in arrays))


def weighing_of(grid: Grid, whitenings: Sequence[Whitening]) -> Weighing:
    """Return the weighing of whitenings, one a problem, or one for all."""
    if not whitenings[0].is_coupled:
        weights = np.array([how.squares() for how in whitenings])
        return Weighing(np.sqrt(grid.spread(weights)))
    root = grid.spread(np.array([how.root for how in whitenings])).swapaxes(1, 2)[..., None]
    E = np.stack([grid.spread(how.common.T) for how in whitenings if how.common is not None])
    E = E.transpose(0, 3, 2, 1)
    W = np.eye(grid.beams) - E @ E.swapaxes(2, 3)
    return Weighing(matrix=root * (W @ W) * root.swapaxes(2, 3))


def _stations(readings: Readings) -> tuple[IntArray, IntArray, IntArray]:
    """Return a row of each pair of plane and station, its number for each row (N,), and its plane."""
    count = int(readings.station.max()) + 1
    pairs = readings.plane * count + readings.station
    order = np.argsort(pairs, kind="stable")
    ordered = pairs[order]
    new = np.concatenate(([True], ordered[1:] > ordered[:-1]))
    number = np.empty_like(pairs)
    number[order] = np.cumsum(new) - 1
    first = np.flatnonzero(new)
    return order[first], number, ordered[first] // count
