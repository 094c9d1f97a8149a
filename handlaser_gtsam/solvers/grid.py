r"""Readings on a grid of beams and stations, and their rows at any parameters.

Beams of a station share its hand pose R, t, and stations of a plane its normal n with the tangent basis
u_1, u_2. All that a reading needs of its station are R'n, R'u_1, R'u_2 and the products of t with n,
u_1 and u_2; all that it needs of its beam are products of the first three with r, v and the tangent
basis of v. With the range s the spot lies at R'u_i . (r + s v) + u_i . t along u_i.

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

LONGEST = 32
"""Slots of a chunk; a plane with more stations has several, so that unequal planes waste little."""
FREE = 4
"""Columns beside those of the beam: along the plane's tangents, its offset, and the residual."""


@dataclass(frozen=True, slots=True)
class Rows:
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
    """

    columns: FloatArray
    centres: FloatArray
    cosine: FloatArray


@dataclass(frozen=True, slots=True)
class _Seen:
    """What the readings have in common at one point, (K, .., cells)."""

    turned: FloatArray
    """R'n, R'u_1, R'u_2: (K, 3, 3, cells), the coordinates second."""
    along: FloatArray
    """Products of these with r, then v: (K, 3, 2 B, cells)."""
    off: FloatArray
    """t along n, u_1, u_2: (K, 3, cells)."""
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
        Only one where all problems have the same: how many these are is then told by the parameters.
    """

    def __init__(self, problems: Sequence[Readings]) -> None:
        one = problems[0]
        rows, station, planes = _stations(one)
        sizes = np.bincount(planes, minlength=one.planes)
        self.beams, self.planes, self.slots = one.beams, one.planes, int(min(sizes.max(), LONGEST))
        self._sizes: FloatArray = np.maximum(one.beams * sizes, 1).astype(float)
        chunks = np.maximum(-(-sizes // self.slots), 1)
        self.first: IntArray = np.cumsum(chunks) - chunks
        self._first_cell: IntArray = self.first * self.slots
        self.plane: IntArray = np.repeat(np.arange(one.planes), chunks * self.slots)
        place = np.arange(len(planes)) + (self._first_cell - np.cumsum(sizes) + sizes)[planes]
        self.cells = len(self.plane)
        self.place: IntArray = place[station]
        self._at = one.beam * self.cells + self.place
        self.read: BoolArray | None = None
        if len(one) < self.beams * self.cells:
            self.read = self.spread(np.ones((1, len(one)))) > 0.0
        self.distance = self.spread(np.array([p.distance for p in problems]))
        self.measured: FloatArray | Regressors = self.distance
        if one.regressors is not None:
            own = [p.regressors for p in problems if p.regressors is not None]
            self.measured = Regressors(
                self.spread(np.array([each.constant for each in own])),
                self.spread(np.array([each.level for each in own])),
            )
        self._by_k = np.array(model.range_error_derivatives(self.measured))
        self.R = np.zeros((len(problems), 3, 3, self.cells))
        self.t = np.zeros((len(problems), 3, self.cells))
        self.R[..., place] = np.array([p.world_R_hand[rows] for p in problems]).transpose(
            0, 2, 3, 1
        )
        self.t[..., place] = np.array([p.world_t_hand[rows] for p in problems]).transpose(0, 2, 1)

    def picked(self, problems: IntArray) -> "Grid":
        """Return the grid of some of the problems."""
        new = copy(self)
        new.distance, new.R, new.t = (a[problems] for a in (self.distance, self.R, self.t))
        new.measured, new._by_k = self.measured[problems], self._by_k[:, problems]
        return new

    def spread(self, values: FloatArray) -> FloatArray:
        """Return values (K, N) of readings on the grid (K, B, cells), zero where there is none."""
        grid = np.zeros((len(values), self.beams * self.cells))
        grid[:, self._at] = values
        return grid.reshape(len(values), self.beams, -1)

    def gathered(self, grid: FloatArray) -> FloatArray:
        """Return what stands on the grid (K, B, cells), a reading each: (K, N)."""
        values: FloatArray = grid.reshape(len(grid), -1)[:, self._at]
        return values

    def residuals(self, at: Parameters) -> tuple[FloatArray, FloatArray]:
        """Return residuals [m] and cosines of the incidence (K, B, cells) at parameters of K problems.

        Parameters stand one problem after the other. Residuals of beams that graze mean nothing.
        """
        seen = self._seen(at, at.normals[:, :, None], self.read)
        return self._residual(seen, at), seen.cosine

    def facing(self, at: Parameters) -> Parameters:
        """Return parameters of K problems with the normals of all planes away from the sensors."""
        _, cosine = self.residuals(at)
        cosine = cosine if self.read is None else cosine * self.read
        ahead = np.add.reduceat(cosine.sum(axis=1), self._first_cell, axis=1)
        sign = np.where(ahead.ravel() < 0.0, -1.0, 1.0)
        return replace(at, normals=at.normals * sign[:, None], offsets=at.offsets * sign)

    def rows(self, at: Parameters, terms: int, counted: BoolArray | None = None) -> Rows:
        """Return the rows of all readings at parameters of K problems, one after the other.

        Parameters
        ----------
        at : Parameters
        terms : int
        counted : (K, B, cells), optional
            Readings that count; the others may graze their planes.
        """
        counted = self.read if counted is None else counted
        bases = model.tangent_basis(np.concatenate((at.normals, at.directions)))
        basis, v_basis = bases[: len(at.normals)], bases[len(at.normals) :]
        v_basis = v_basis.reshape(-1, self.beams, 3, 2)
        seen = self._seen(at, np.concatenate((at.normals[:, :, None], basis), axis=2), counted)
        c, s, turned, along = seen.c, seen.s, seen.turned, seen.along
        copies, width = len(c), 5 + terms
        columns = np.empty((width + FREE, *c.shape))
        np.multiply(c, turned[:, 0].transpose(1, 0, 2)[:, :, None], out=columns[:3])
        v_along = v_basis.transpose(0, 1, 3, 2).reshape(copies, -1, 3) @ turned[:, 0]
        across = v_along.reshape(copies, self.beams, 2, -1).transpose(2, 0, 1, 3)
        np.multiply(s * c, across, out=columns[3:5])
        columns[5:width] = self._by_k[:terms]
        spot = s[:, None] * along[:, 1:, self.beams :]
        spot += along[:, 1:, : self.beams]
        spot += seen.off[:, 1:, None]
        spot = spot.transpose(1, 0, 2, 3)
        middle = self._plane_means(spot, counted)
        spot -= middle.take(self.plane, axis=-1)[:, :, None]
        np.multiply(c, spot, out=columns[width : width + 2])
        columns[-2], columns[-1] = c, self._residual(seen, at)
        if counted is not None:
            columns *= counted
        centres = (basis @ middle.transpose(1, 2, 0).reshape(-1, 2, 1))[..., 0]
        centres -= at.offsets[:, None] * at.normals
        return Rows(columns, centres.reshape(copies, -1, 3), seen.flattest)

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

    def _residual(self, seen: _Seen, at: Parameters) -> FloatArray:
        k = at.range_errors.reshape(len(seen.c), self.beams, 1, 2)
        return seen.s - model.corrected(self.measured, k)

    def _seen(self, at: Parameters, axes: FloatArray, counted: BoolArray | None) -> _Seen:
        """Return what readings have in common for axes (K P, 3, q) of the planes, the normal first."""
        copies = len(at.locations) // self.beams
        by_plane = axes.reshape(copies, self.planes, 3, -1).transpose(0, 2, 3, 1)
        by_cell = by_plane.take(self.plane, axis=-1)
        turned = np.einsum("kjic,kjac->kaic", self.R, by_cell)
        off = np.einsum("kjc,kjac->kac", self.t, by_cell)
        arms = np.concatenate(
            (at.locations.reshape(copies, -1, 3), at.directions.reshape(copies, -1, 3)), axis=1
        )
        along = arms[:, None] @ turned
        cosine = along[:, 0, self.beams :]
        if counted is not None:
            cosine = np.where(counted, cosine, 1.0)
        steep = np.abs(cosine)
        flattest = steep.reshape(copies, -1).min(axis=1)
        finite = cosine
        if not (flattest >= model.GRAZING_LIMIT).all():
            # What grazes is told by its cosine; here it only has to stay finite.
            finite = np.where(steep < model.GRAZING_LIMIT, model.GRAZING_LIMIT, cosine)
        c = -1.0 / finite
        height = off[:, 0] + at.offsets.reshape(copies, -1).take(self.plane, axis=1)
        s = (along[:, 0, : self.beams] + height[:, None]) * c
        return _Seen(turned, along, off, c, s, cosine, flattest)


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
        of = (self.root, self.matrix)
        return Weighing(*(a if a is None or len(a) == 1 else a[rows] for a in of))


def weighing_of(grid: Grid, whitenings: Sequence[Whitening]) -> Weighing:
    """Return the weighing of whitenings, one a problem, or one for all."""
    if not whitenings[0].is_coupled:
        weights = np.array([how.squares() for how in whitenings])
        return Weighing(np.sqrt(grid.spread(weights)))
    matrix = np.zeros((len(whitenings), grid.cells, grid.beams, grid.beams))
    for k, how in enumerate(whitenings):
        cell = np.empty(len(how.root), dtype=np.intp)
        cell[how.station] = grid.place
        matrix[k, cell] = how.root @ how.root
    return Weighing(matrix=matrix)


def _stations(readings: Readings) -> tuple[IntArray, IntArray, IntArray]:
    """Return a row of each pair of plane and station, its number for each row (N,), and its plane."""
    count = int(readings.station.max()) + 1
    pairs, rows, number = np.unique(
        readings.plane * count + readings.station, return_index=True, return_inverse=True
    )
    return rows, number, pairs // count
