r"""What readings say about the beams for several sets of noise scales at once, planes eliminated.

At one linearisation, with the Jacobians G (beams), H (planes) and Q (hand poses) and the residuals e of
the readings, a set of noise scales gives every station the covariance C = D + Q S Q' of its readings:
D of the sensor, S of the hand pose. With inv(C) by Woodbury's identity a station costs one inverse of
6 x 6 a set, whatever the number of its beams. Planes are independent given the beams, so they are
eliminated one by one, and what they say of the beams is added up:

    log L(x) = c + b' x - x' A x / 2,    x the beams' step from the linearisation,

c including the determinants of C and of the planes' information: the restricted likelihood of the
scales. Locations and offsets are in units of the typical range, and so is the inverse of k2.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .. import model
from ..arrays import FloatArray, IntArray
from ..data.parameters import Parameters
from ..data.recording import Readings
from ..data.value import Value
from ..model.families import BEAM, MOUNT_DIM
from ..model.weighting import Variances, covariance_roots, noise_slopes, own_variances
from ..quantities import NUMBERS_AT_ONCE


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class NoiseSet(Value):
    """One set of noise scales.

    Attributes
    ----------
    range_sigma : (B,)
        Of each beam [m].
    pose : (6,)
        Factors of the roots of the pose covariances: rotations, then translations.
    """

    range_sigma: FloatArray
    pose: FloatArray


@dataclass(frozen=True, slots=True)
class Information:
    """What the readings say of the beams for J sets of noise scales; sums over planes.

    Without the axis of the sets where the noise is known.

    Attributes
    ----------
    matrix : (J, n, n)
        A, in natural units.
    vector : (J, n)
        b.
    constant : (J,)
        c.
    """

    matrix: FloatArray
    vector: FloatArray
    constant: FloatArray

    def __add__(self, other: "Information") -> "Information":
        matrix, vector = self.matrix + other.matrix, self.vector + other.vector
        return Information(matrix, vector, self.constant + other.constant)

    def __sub__(self, other: "Information") -> "Information":
        matrix, vector = self.matrix - other.matrix, self.vector - other.vector
        return Information(matrix, vector, self.constant - other.constant)

    def __getitem__(self, sets: slice | None) -> "Information":
        """Return some sets; None adds the axis of the sets to information without it."""
        return Information(self.matrix[sets], self.vector[sets], self.constant[sets])


@dataclass(frozen=True, slots=True)
class PlaneResponse:
    """What became of the planes that were eliminated, for J sets of noise scales, natural units.

    Attributes
    ----------
    inverse : (J, P, 3, 3)
        Covariances for known beams.
    step : (J, P, 3)
        Steps for beams that stay.
    response : (J, P, 3, n)
        A step x of the beams moves a plane by -response x.
    """

    inverse: FloatArray
    step: FloatArray
    response: FloatArray


class LinearReadings:
    """Readings linearised at parameters, sorted by plane and station.

    Parameters
    ----------
    parameters : Parameters
        Planes in the frames of the readings.
    readings : Readings
    terms : int
        Range-error terms of every beam.
    length : float
        The typical range [m]: the natural unit of lengths.
    variances : Variances
        Its pose covariances are scaled; its range sigmas do not matter.

    Raises
    ------
    GrazingBeamError
        A beam grazes its plane.
    """

    def __init__(
        self,
        parameters: Parameters,
        readings: Readings,
        terms: int,
        length: float,
        variances: Variances,
    ) -> None:
        order = np.lexsort((readings.beam, readings.station, readings.plane))
        readings = readings.subset(order)
        lin = model.linearize(model.scene(parameters, readings), readings.measured, with_pose=True)
        self.centres = readings.plane_means(lin.normal / lin.offset[:, None])
        middle = self.centres[readings.plane]
        v_basis = model.tangent_basis(parameters.directions)[readings.beam]
        n_basis = model.tangent_basis(parameters.normals)[readings.plane]
        unit = BEAM.natural_units(length)[: MOUNT_DIM + terms]
        rows = model.tangent_columns(lin, v_basis, n_basis, middle, terms).T.copy()
        self.beam_rows = unit * rows[:, :-4]
        self.plane_rows = np.array([1.0, 1.0, length, 1.0]) * rows[:, -4:]
        self.beam, self.beams = readings.beam, readings.beams
        self.squared_slope = noise_slopes(parameters, readings) ** 2
        bare = Variances(np.zeros(readings.beams), variances.incidence_sigma)
        self.fixed = own_variances(parameters, readings, bare)
        change = (np.diff(readings.station) != 0) | (np.diff(readings.plane) != 0)
        self.first: IntArray = np.flatnonzero(np.concatenate(([True], change))).astype(np.intp)
        self.station = np.cumsum(np.concatenate(([0], change))).astype(np.intp)
        plane = readings.plane[self.first]
        self.first_station = np.searchsorted(plane, np.unique(plane))
        self.first_row = self.first[self.first_station]
        self.pose_rows = lin.pose
        self._sums: _Sums | None = None
        self.root: FloatArray | None = None
        if variances.pose is not None:
            self.root = covariance_roots(variances.pose[readings.station[self.first]])
        # Errors of the pose are then noise of the only reading.
        self.alone = self.root is not None and len(self.first) == len(readings)

    def information(self, sets: Sequence[NoiseSet]) -> tuple[Information, PlaneResponse]:
        """Return what the readings say for each set of noise scales."""
        parts = []
        if self.alone or self.fixed.any() or any(np.ptp(noise.range_sigma) > 0.0 for noise in sets):
            for noise in sets:
                variance = noise.range_sigma[self.beam] ** 2 * self.squared_slope + self.fixed
                pose = noise.pose
                if self.alone and self.root is not None:
                    moved = (self.pose_rows * pose)[:, None] @ self.root
                    variance, pose = variance + (moved**2).sum(axis=(1, 2)), np.zeros(6)
                parts.append(_Sums(self, 1.0 / variance).information(np.ones(1), pose[None]))
        else:
            if self._sums is None:
                self._sums = _Sums(self, 1.0 / self.squared_slope)
            sums = self._sums
            factor = np.array([noise.range_sigma[0] for noise in sets]) ** -2
            pose = np.array([noise.pose for noise in sets])
            size = len(self.first) * 6 * self.beams * self.beam_rows.shape[1]
            chunk = max(NUMBERS_AT_ONCE // size, 1)
            for a in range(0, len(sets), chunk):
                parts.append(sums.information(factor[a : a + chunk], pose[a : a + chunk]))
        both = [
            [np.concatenate([getattr(part[k], name) for part in parts]) for name in names]
            for k, names in enumerate(
                (("matrix", "vector", "constant"), ("inverse", "step", "response"))
            )
        ]
        return Information(*both[0]), PlaneResponse(*both[1])


class _Sums:
    """Weighted sums over readings, for weights that a set of scales multiplies by one factor."""

    def __init__(self, rows: LinearReadings, weight: FloatArray) -> None:
        self.rows, self.log_weight = rows, float(np.log(weight).sum())
        stations, beams, width = len(rows.first), rows.beams, rows.beam_rows.shape[1]
        self.size = beams * width
        weighted = rows.beam_rows * weight[:, None]
        mixed = np.zeros((stations, beams, width, 4))
        mixed[rows.station, rows.beam] = weighted[:, :, None] * rows.plane_rows[:, None, :]
        mixed = np.add.reduceat(mixed, rows.first_station)
        self.beam_plane = mixed.reshape(-1, self.size, 4)
        squares = weight[:, None, None] * rows.plane_rows[:, :, None] * rows.plane_rows[:, None, :]
        self.plane_plane = np.add.reduceat(squares, rows.first_row)
        self.beam_beam = np.zeros((self.size, self.size))
        for i in range(beams):
            mine, block = rows.beam == i, slice(i * width, i * width + width)
            self.beam_beam[block, block] = weighted[mine].T @ rows.beam_rows[mine]
        if rows.root is None or rows.alone:
            return
        q = rows.pose_rows
        wq = weight[:, None] * q
        self.pose_pose = np.add.reduceat(wq[:, :, None] * q[:, None, :], rows.first)
        grid = np.zeros((stations, beams, width, 6))
        grid[rows.station, rows.beam] = rows.beam_rows[:, :, None] * wq[:, None, :]
        self.beam_pose = grid.reshape(stations, self.size, 6)
        self.plane_pose = np.add.reduceat(rows.plane_rows[:, :, None] * wq[:, None, :], rows.first)

    def information(
        self, factor: FloatArray, pose: FloatArray
    ) -> tuple[Information, PlaneResponse]:
        """Return the information for weights times `factor` (J,) and pose factors (J, 6)."""
        f = factor[:, None, None]
        beam_beam = f * self.beam_beam
        beam_plane = f[..., None] * self.beam_plane
        plane_plane = f[..., None] * self.plane_plane
        log_det = -len(self.rows.beam) * np.log(factor) - self.log_weight
        if self.rows.root is not None and pose.any():
            starts, root = self.rows.first_station, pose[:, None, :, None] * self.rows.root
            back = np.swapaxes(root, 2, 3)
            # By its eigenvectors 1 + X keeps its digits where errors of the poses dwarf the sensor's.
            values, axes = np.linalg.eigh(f[..., None] * (back @ self.pose_pose @ root))
            values = np.maximum(values, 0.0)
            along = f[..., None] * (root @ axes) / np.sqrt(1.0 + values)[..., None, :]
            K = along @ np.swapaxes(along, 2, 3)
            log_det = log_det + np.log1p(values).sum(axis=(1, 2))
            KB = K @ np.swapaxes(self.beam_pose, 1, 2)
            KC = K @ np.swapaxes(self.plane_pose, 1, 2)
            flat = np.swapaxes(self.beam_pose, 0, 1).reshape(self.size, -1)
            beam_beam -= flat @ KB.reshape(len(f), -1, self.size)
            beam_plane -= np.add.reduceat(self.beam_pose @ KC, starts, axis=1)
            plane_plane -= np.add.reduceat(self.plane_pose @ KC, starts, axis=1)
        return _planes_eliminated(beam_beam, beam_plane, plane_plane, log_det)


def _planes_eliminated(
    beam_beam: FloatArray, beam_plane: FloatArray, plane_plane: FloatArray, log_det: FloatArray
) -> tuple[Information, PlaneResponse]:
    """Eliminate planes from (J, n, n), (J, P, n, 4) and (J, P, 4, 4); residuals stand last."""
    H, g = plane_plane[..., :3, :3], plane_plane[..., :3, 3]
    inverse = np.asarray(np.linalg.inv(H), dtype=np.float64)
    E = beam_plane[..., :3]
    response = inverse @ np.swapaxes(E, 2, 3)
    step = -np.einsum("jpab,jpb->jpa", inverse, g)
    sets, _, size = E.shape[:3]
    flat = np.swapaxes(E, 1, 2).reshape(sets, size, -1)
    matrix = beam_beam - flat @ response.reshape(sets, -1, size)
    vector = -beam_plane[..., 3].sum(axis=1) - np.einsum("jpna,jpa->jn", E, step)
    squares = plane_plane[..., 3, 3].sum(axis=1) + np.einsum("jpa,jpa->j", g, step)
    log_det = log_det + np.linalg.slogdet(H)[1].sum(axis=1)
    symmetric = 0.5 * (matrix + np.swapaxes(matrix, 1, 2))
    return (
        Information(symmetric, vector, -0.5 * (squares + log_det)),
        PlaneResponse(inverse, step, response),
    )
