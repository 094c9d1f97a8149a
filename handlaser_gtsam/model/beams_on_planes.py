r"""Beams that read planes from known hand poses: the common triple of sensor, target and robot, fused.

Beams of a station share its hand pose R, t, and stations of a plane its normal n with the tangent basis
u_1, u_2 and its centre c. All that a reading needs of its station are (R'a, (t - c) . a) for
a = n, u_1, u_2: the axes in homogeneous coordinates of the hand. All that it needs of its beam are
products of these with (r, 1), (v, 0) and the tangent basis of v likewise. With the range s the spot
lies at (R'u_i, (t - c) . u_i) . (r + s v, 1) along u_i.

Groups are the readings of a beam in a chunk of stations of one plane, all chunks of one size, so that
sums over readings are stacked products. Tests compare the rows with the general block (`range_blocks`)
and with `equation`.
"""

from collections.abc import Sequence
from copy import copy

import numpy as np

from ..arrays import BoolArray, FloatArray, IntArray
from ..data.parameters import Parameters
from ..data.readings import Readings, Regressors
from ..quantities import ROUNDING
from .block import Rows, Slot, Values, Weights
from .equation import GRAZING_LIMIT, corrected, range_error_derivatives
from .families import BEAM, OF_DIRECTION, OF_LOCATION, OF_RANGE_ERROR, PLANE, POSE, bases
from .weighting import Whitening

CHUNK_SLOTS = 32
"""Slots of a chunk; a plane with more stations has several chunks, so that few slots stay empty."""
OF_NORMAL, OF_HEIGHT, CENTRE = PLANE.places
"""Parts of a plane's numbers."""
HEIGHT: int = OF_HEIGHT.start


class BeamsOnPlanes:
    """Readings of problems of one shape: the same beams, planes and stations, row by row.

    Parameters
    ----------
    problems : sequence of Readings
        A single element where all problems share their readings: the values then say how many
        problems there are.
    whitenings : sequence of Whitening, optional
        One a problem, or one for all; all readings weigh 1 where there is none.

    Attributes
    ----------
    weights : Weights
    beams, planes, cells : int
        Cells are the slots of stations, chunk after chunk.
    plane : (cells,)
        The plane of each cell.
    read : (B, cells) of bool, or None
        Where there are readings; None where everywhere.
    """

    def __init__(
        self, problems: Sequence[Readings], whitenings: Sequence[Whitening] | None = None
    ) -> None:
        shape = problems[0]
        self.beams, self.planes = shape.beams, shape.planes
        rows, station, planes = shape.stations_of_planes
        sizes = np.bincount(planes, minlength=self.planes)
        self.slots_of_chunk = int(min(sizes.max(), CHUNK_SLOTS))
        chunks = np.maximum(-(-sizes // self.slots_of_chunk), 1)
        self._stations = np.maximum(sizes, 1)
        self.first: IntArray = (np.cumsum(chunks) - chunks) * self.slots_of_chunk
        self.plane: IntArray = np.repeat(np.arange(self.planes), chunks * self.slots_of_chunk)
        self.cells = len(self.plane)
        place = np.arange(len(planes)) + (self.first - np.cumsum(sizes) + sizes)[planes]
        self._index = shape.beam * self.cells + place[station]
        self.read: BoolArray | None = None
        if len(shape) < self.beams * self.cells:
            self.read = self.spread(np.ones((1, len(shape))))[0] > 0.0
        self.distance = self.spread(np.array([p.distance for p in problems]))
        self.measured: FloatArray | Regressors = self.distance
        if shape.regressors is not None:
            regressors = [p.regressors for p in problems if p.regressors is not None]
            self.measured = Regressors(
                self.spread(np.array([p.constant for p in regressors])),
                self.spread(np.array([p.level for p in regressors])),
            )
        self._by_k = np.array(range_error_derivatives(self.measured))
        # The first row stands for cells without a station, which have no pose.
        row, held = np.zeros(self.cells, dtype=np.intp), np.zeros(self.cells)
        row[place], held[place] = rows, 1.0
        self.poses = np.empty((len(problems), 3, 4, self.cells))
        for k, problem in enumerate(problems):
            problem.world_R_hand.transpose(1, 2, 0).take(row, axis=-1, out=self.poses[k, :, :3])
            problem.world_t_hand.T.take(row, axis=-1, out=self.poses[k, :, 3])
        if len(rows) < self.cells:
            self.poses *= held
        self.weights = Weights() if whitenings is None else self._weights(whitenings)
        by_chunk = self.plane[:: self.slots_of_chunk]
        beam = np.repeat(np.arange(self.beams), len(by_chunk))
        plane = np.concatenate([by_chunk] * self.beams)
        self._slots = (
            Slot(BEAM.name, beam, slice(0, BEAM.dim)),
            Slot(PLANE.name, plane, slice(BEAM.dim, BEAM.dim + PLANE.dim)),
        )

    @property
    def size(self) -> int:
        """Readings of one problem."""
        return len(self._index)

    @property
    def counts(self) -> dict[str, int]:
        """Members of each family."""
        return {BEAM.name: self.beams, PLANE.name: self.planes}

    def slots(self) -> tuple[Slot, ...]:
        """Return beam and plane of every group."""
        return self._slots

    def picked(self, problems: IntArray) -> "BeamsOnPlanes":
        """Return the readings of some of the problems."""
        new = copy(self)
        new.weights = self.weights.picked(problems)
        if len(self.poses) > 1:
            new.distance, new.poses = self.distance[problems], self.poses[problems]
            new.measured, new._by_k = self.measured[problems], self._by_k[:, problems]
        return new

    def spread(self, values: FloatArray) -> FloatArray:
        """Return values (K, N) of readings by beam and cell (K, B, cells), zero where there is none."""
        grid = np.zeros((len(values), self.beams * self.cells))
        grid[:, self._index] = values
        return grid.reshape(len(values), self.beams, -1)

    def evaluate(self, values: Values) -> Rows:
        """Return the rows of all readings [m]."""
        beams, planes = values[BEAM.name], values[PLANE.name]
        K = max(len(beams), len(self.poses))
        # One call for beams and planes: of small arrays it is the calls that take time.
        both = bases(np.concatenate((beams[..., OF_DIRECTION], planes[..., OF_NORMAL]), axis=1))
        arms = both[:, : self.beams].transpose(0, 3, 1, 2)
        turned, along, c, s, grazing = self._met(beams, planes, both[:, self.beams :], arms)
        columns = np.empty((BEAM.dim + PLANE.dim + 1, K, self.beams, self.cells))
        np.multiply(c, turned[:, 0, :3].transpose(1, 0, 2)[:, :, None], out=columns[:3])
        np.multiply(s * c, along[:, 0, 2:].transpose(1, 0, 2, 3), out=columns[3:5])
        columns[5 : BEAM.dim] = self._by_k
        spot = s[:, None] * along[:, 1:, 1]
        spot += along[:, 1:, 0]
        np.multiply(c, spot.transpose(1, 0, 2, 3), out=columns[BEAM.dim : BEAM.dim + 2])
        columns[-2] = c
        np.subtract(s, corrected(self.measured, beams[:, :, None, OF_RANGE_ERROR]), out=columns[-1])
        if self.read is not None:
            columns *= self.read
        shape = K, -1, self.slots_of_chunk
        impossible = None if grazing is None else grazing.reshape(shape)
        return Rows(columns.reshape(len(columns), *shape), impossible)

    def of_cells(self, values: IntArray) -> IntArray:
        """Return what the readings (N,) of each cell share (cells,); zero for none."""
        found = np.zeros(self.cells, dtype=np.intp)
        found[self._index % self.cells] = values
        return found

    def pose_columns(self, values: Values, columns: FloatArray) -> FloatArray:
        """Return derivatives (6, K, B, cells) by the hand poses, given those by all else."""
        beams = values[BEAM.name][:, :, None]
        columns = columns.reshape(len(columns), -1, self.beams, self.cells)
        s = columns[-1] + corrected(self.measured, beams[..., OF_RANGE_ERROR])
        spot = beams[..., OF_LOCATION] + s[..., None] * beams[..., OF_DIRECTION]
        covector = columns[:3]
        return np.concatenate((np.cross(np.moveaxis(spot, -1, 0), covector, axis=0), covector))

    def begun(self, problems: Sequence[Parameters]) -> Values:
        """Return parameters of K problems as values, planes about their points nearest to the hands."""
        values = values_of(problems)
        planes = values[PLANE.name]
        hands = np.add.reduceat(self.poses[:, :, 3], self.first, axis=2) / self._stations
        planes[..., CENTRE] = hands.transpose(0, 2, 1)
        planes[..., HEIGHT] += np.einsum("kpi,kpi->kp", planes[..., OF_NORMAL], planes[..., CENTRE])
        planes[..., CENTRE] -= planes[..., HEIGHT, None] * planes[..., OF_NORMAL]
        planes[..., HEIGHT] = 0.0
        return values

    def centred(self, values: Values) -> Values:
        """Return the same planes about centres amid their laser spots, where offsets are well known."""
        beams, planes = values[BEAM.name], values[PLANE.name]
        tangents = bases(planes[..., OF_NORMAL])
        none = np.empty((len(beams), 0, self.beams, 3))
        _, along, _, s, grazing = self._met(beams, planes, tangents, none)
        spot = (along[:, 1:, 0] + s[:, None] * along[:, 1:, 1]).transpose(1, 0, 2, 3)
        counted = np.ones(s.shape, dtype=bool) if self.read is None else self.read
        if grazing is not None:
            counted = counted & ~grazing
        sums = np.add.reduceat((spot * counted).sum(axis=2), self.first, axis=2)
        size = np.add.reduceat(np.broadcast_to(counted, s.shape).sum(axis=1), self.first, axis=1)
        middle = (sums / np.maximum(size, 1)).transpose(1, 2, 0)[..., None]
        moved = planes.copy()
        moved[..., CENTRE] += (tangents @ middle)[..., 0]
        moved[..., CENTRE] -= planes[..., [HEIGHT]] * planes[..., OF_NORMAL]
        moved[..., HEIGHT] = 0.0
        return {**values, PLANE.name: moved}

    def facing(self, values: Values) -> Values:
        """Return values with the normals of all planes away from the sensors."""
        beams, planes = values[BEAM.name], values[PLANE.name]
        normals = planes[..., OF_NORMAL].transpose(0, 2, 1).take(self.plane, axis=-1)
        turned = np.einsum("kjic,kjc->kic", self.poses[:, :, :3], normals)
        cosine = np.einsum("kic,kbi->kbc", turned, beams[..., OF_DIRECTION])
        cosine = cosine if self.read is None else cosine * self.read
        ahead = np.add.reduceat(cosine.sum(axis=1), self.first, axis=1)
        sign = np.where(ahead < 0.0, -1.0, 1.0)[..., None]
        turned_back = planes.copy()
        turned_back[..., : HEIGHT + 1] *= sign
        return {**values, PLANE.name: turned_back}

    def reach(self) -> FloatArray:
        """Return the largest coordinate of a hand plus the largest reading [m] of each problem (K,)."""
        positions = np.abs(self.poses[:, :, 3]).max(axis=(1, 2))
        reach: FloatArray = positions + np.abs(self.distance).max(axis=(1, 2))
        return reach

    def _met(
        self, beams: FloatArray, planes: FloatArray, tangents: FloatArray, arms: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, BoolArray | None]:
        """Return where the beams meet the planes.

        Parameters
        ----------
        beams, planes : (K, B, 8), (K, P, 7)
        tangents : (K, P, 3, 2)
            `bases` of the normals.
        arms : (K, q, B, 3)
            Further vectors of the beams.

        Returns
        -------
        turned : (K, 3, 4, cells)
            (R'a, (t - c) . a) for the axes a of the planes, the normal and its tangents.
        along : (K, 3, 2 + q, B, cells)
            Location, direction and the further vectors of the beams along these axes.
        c, s : (K, B, cells)
            -1 / cosine, and the range [m].
        grazing : (K, B, cells) of bool, or None
            Readings that graze their planes, if any do.
        """
        n, centre = planes[..., OF_NORMAL], planes[..., CENTRE]
        axes = np.concatenate((n[..., None], tangents), axis=3)
        by_axis = axes.transpose(0, 2, 3, 1).take(self.plane, axis=-1)
        turned = np.einsum("kjic,kjac->kaic", self.poses, by_axis)
        offsets = np.einsum("kpj,kpja->kap", centre, axes)
        turned[:, :, 3] -= offsets.take(self.plane, axis=-1)
        vectors = np.zeros((len(beams), 2 + arms.shape[1], self.beams, 4))
        vectors[:, 0, :, :3], vectors[:, 0, :, 3] = beams[..., OF_LOCATION], 1.0
        vectors[:, 1, :, :3], vectors[:, 2:, :, :3] = beams[..., OF_DIRECTION], arms
        along = vectors.reshape(len(beams), 1, -1, 4) @ turned
        along = along.reshape(len(along), 3, -1, self.beams, self.cells)
        cosine = along[:, 0, 1] if self.read is None else np.where(self.read, along[:, 0, 1], 1.0)
        steep, grazing = np.abs(cosine), None
        # A search may creep to the limit: where it ends must not be beyond by rounding.
        least = GRAZING_LIMIT * (1.0 + ROUNDING)
        if not steep.min() >= least:
            grazing = ~(steep >= least)
            cosine = np.where(grazing, GRAZING_LIMIT, cosine)
        c = -1.0 / cosine
        heights = planes[..., HEIGHT].take(self.plane, axis=1)[:, None]
        return turned, along, c, (along[:, 0, 0] + heights) * c, grazing

    def _weights(self, whitenings: Sequence[Whitening]) -> Weights:
        shape = self.beams * self.cells // self.slots_of_chunk, self.slots_of_chunk
        root = self.spread(np.array([how.root for how in whitenings])).reshape(-1, *shape)
        if all(how.common is None for how in whitenings):
            return Weights(root)
        none = np.zeros((self.size, POSE.dim))
        common = [none if how.common is None else how.common for how in whitenings]
        columns = np.stack([self.spread(V.T).reshape(-1, *shape) for V in common], axis=1)
        station = np.tile(np.arange(self.cells), self.beams).reshape(shape)
        return Weights(root, columns, station)


def values_of(problems: Sequence[Parameters]) -> dict[str, FloatArray]:
    """Return the beams and planes of K problems of one shape as values, planes about the origin."""
    beams = np.empty((len(problems), len(problems[0].locations), BEAM.size))
    planes = np.zeros((len(problems), len(problems[0].offsets), PLANE.size))
    beams[..., OF_LOCATION] = [p.locations for p in problems]
    beams[..., OF_DIRECTION] = [p.directions for p in problems]
    beams[..., OF_RANGE_ERROR] = [p.range_errors for p in problems]
    planes[..., OF_NORMAL] = [p.normals for p in problems]
    planes[..., HEIGHT] = [p.offsets for p in problems]
    return {BEAM.name: beams, PLANE.name: planes}


def parameters_of(values: Values) -> list[Parameters]:
    """Return the beams and planes of every problem."""
    beams, planes = values[BEAM.name], values[PLANE.name]
    offsets = planes[..., HEIGHT] - np.einsum(
        "kpi,kpi->kp", planes[..., OF_NORMAL], planes[..., CENTRE]
    )
    r, v, k = (
        np.ascontiguousarray(beams[..., part])
        for part in (OF_LOCATION, OF_DIRECTION, OF_RANGE_ERROR)
    )
    n = np.ascontiguousarray(planes[..., OF_NORMAL])
    return [Parameters.unchecked(*arrays) for arrays in zip(r, v, k, n, offsets, strict=True)]
