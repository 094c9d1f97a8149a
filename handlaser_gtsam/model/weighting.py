r"""How readings err together: the covariance of a station's readings, and its inverse root.

The residuals of the readings d of one station have, to first order, the covariance

    C = diag((g'(d) sigma)^2 / m + (tau tan a)^2) + J S J'

with g'(d) = 1 + k1 + 2 k2 d for the corrected reading, m the number of independent readings that d is
the mean of (else one), sigma the range sigma of the beam, tau the
incidence sigma, a the angle of incidence, S the covariance (6, 6) of the hand pose and J the derivative
of the residuals by it. J S J' couples the beams of a station. Stations are independent.

With D the diagonal part and U U' = inv(sqrt(D)) J S J' inv(sqrt(D)), C is sqrt(D) (I + U U') sqrt(D),
and R = inv(sqrt(I + U U')) inv(sqrt(D)) has R C R' = I. The root of I + U U' follows from the
eigenvectors of the smaller of U U' and U' U, so that it costs six columns, however many the beams.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..arrays import FloatArray, IntArray
from ..data.parameters import Parameters
from ..data.recording import Readings
from ..data.value import Value
from ..quantities import SINGULAR
from . import equation


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Variances(Value):
    """The parts of the covariance of the readings.

    Attributes
    ----------
    range_sigma : (B,)
        Range sigma of each beam [m].
    incidence_sigma : float
        [m]
    pose : (M, 6, 6) or None
        Covariance of the hand pose of every station (rx, ry, rz, x, y, z); None for exact poses.
    """

    range_sigma: FloatArray
    incidence_sigma: float = 0.0
    pose: FloatArray | None = None

    def for_stations(self, count: int) -> "Variances":
        """Return the variances for `count` stations: new ones have the covariance that all share."""
        if self.pose is None or len(self.pose) >= count:
            return self
        more = np.broadcast_to(self.pose[:1], (count - len(self.pose), 6, 6))
        return replace(self, pose=np.concatenate((self.pose, more)))

    def without_poses(self) -> "Variances":
        """Return the same for readings whose hand poses are known."""
        return replace(self, pose=None)


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Whitening(Value):
    """Makes the residuals of readings independent and equally precise.

    Attributes
    ----------
    root : (S, K, K)
        Inverse roots R of C / sigma^2, R C R' = sigma^2 I, a station, over K beams; beams without a
        reading there stand by themselves. Where poses do not err, every reading counts as a station.
    station, beam : (N,)
        Indices of each row of the readings in them.
    sigma : float
        Standard deviation of a whitened residual [m]: the typical one of a reading.
    """

    root: FloatArray
    station: IntArray
    beam: IntArray
    sigma: float

    @property
    def is_coupled(self) -> bool:
        """Whether readings are correlated with others of their station."""
        return bool(self.root.shape[1] > 1)

    def of_rows(self, rows: IntArray) -> "Whitening":
        """Return the whitening of whole stations, given by their rows, over the beams read there."""
        stations, station = np.unique(self.station[rows], return_inverse=True)
        beams, beam = np.unique(self.beam[rows], return_inverse=True)
        root = self.root[np.ix_(stations, beams, beams)]
        return Whitening(root, station.astype(np.intp), beam.astype(np.intp), self.sigma)

    def by_station(self, station: IntArray, beam: IntArray, beams: int) -> "Whitening":
        """Return the same over all beams of a station, given those (N,) of every row."""
        if self.is_coupled:
            return self
        root = np.tile(np.eye(beams), (int(station.max()) + 1, 1, 1))
        root[station, beam, beam] = self.coefficients()[:, 0]
        return Whitening(root, station, beam, self.sigma)

    def reordered(self, rows: IntArray) -> "Whitening":
        """Return the whitening of the same readings in another order."""
        return replace(self, station=self.station[rows], beam=self.beam[rows])

    def coefficients(self) -> FloatArray:
        """Return what each row (N,) takes of the K readings of its station, (N, K)."""
        rows: FloatArray = self.root[self.station, self.beam]
        return rows

    def gathered(self, rows: FloatArray) -> FloatArray:
        """Return, for every row of (N, ...), the rows of the K readings of its station, (N, K, ...)."""
        near: FloatArray = self._grid(rows)[self.station]
        return near

    def squares(self) -> FloatArray:
        """Return what a reading (N,) weighs by itself: the diagonal of sigma^2 / C."""
        squares: FloatArray = (self.root**2).sum(axis=1)[self.station, self.beam]
        return squares

    def matrix(self) -> FloatArray:
        """Return sigma^2 / C of every station, (S, K, K)."""
        matrix: FloatArray = np.swapaxes(self.root, 1, 2) @ self.root
        return matrix

    def inverse(self) -> "Whitening":
        """Return what gives back the rows that are whitened."""
        return replace(self, root=np.asarray(np.linalg.inv(self.root), dtype=np.float64))

    def transposed(self) -> "Whitening":
        """Return the whitening with transposed roots: applied to whitened rows it gives `weighed`."""
        return replace(self, root=np.swapaxes(self.root, 1, 2))

    def apply_rows(self, rows: FloatArray) -> FloatArray:
        """Return whitened rows (N, D)."""
        if not self.is_coupled:
            return self.coefficients() * rows
        white: FloatArray = (self.root @ self._grid(rows))[self.station, self.beam]
        return white

    def apply(self, residual: FloatArray) -> FloatArray:
        """Return whitened residuals (N,) [m]."""
        return self.apply_rows(residual[:, None])[:, 0]

    def weighed(self, rows: FloatArray) -> FloatArray:
        """Return sigma^2 inv(C) times rows (N, D)."""
        if not self.is_coupled:
            return self.coefficients() ** 2 * rows
        white = self.root @ self._grid(rows)
        heavy: FloatArray = (np.swapaxes(self.root, 1, 2) @ white)[self.station, self.beam]
        return heavy

    def _grid(self, rows: FloatArray) -> FloatArray:
        """Return rows (N, ...) by station and beam, (S, K, ...); zero where there is none."""
        grid = np.zeros((*self.root.shape[:2], *rows.shape[1:]))
        grid[self.station, self.beam] = rows
        return grid


def joined(whitenings: Sequence[Whitening]) -> Whitening:
    """Return one whitening of the rows of several, one after the other; sigma of the first.

    Every row keeps its slot among the beams of its station.
    """
    stations = [len(part.root) for part in whitenings]
    slots = max(part.root.shape[1] for part in whitenings)
    first = np.cumsum([0, *stations[:-1]])
    root = np.zeros((sum(stations), slots, slots))
    for a, part in zip(first, whitenings, strict=True):
        count = part.root.shape[1]
        root[a : a + len(part.root), :count, :count] = part.root
    return Whitening(
        root,
        np.concatenate([a + part.station for a, part in zip(first, whitenings, strict=True)]),
        np.concatenate([part.beam for part in whitenings]),
        whitenings[0].sigma,
    )


def whitening(parameters: Parameters, readings: Readings, variances: Variances) -> Whitening:
    """Return the whitening of `readings` at `parameters`.

    Raises
    ------
    GrazingBeamError
        A beam is parallel to its plane.
    """
    sensor = own_variances(parameters, readings, variances)
    if variances.pose is None:
        typical, alone = float(np.median(sensor)), np.arange(len(sensor))
        root = np.sqrt(typical / sensor)[:, None, None]
        return Whitening(root, alone, np.zeros_like(alone), float(np.sqrt(typical)))
    station = stations_from_zero(readings)
    where = (station, readings.beam)
    linear = equation.linearize(
        equation.scene(parameters, readings), readings.distance, with_pose=True
    )
    J = np.zeros((int(station.max()) + 1, readings.beams, 6))
    J[where] = linear.pose
    place = np.empty(len(J), dtype=np.intp)
    place[station] = readings.station
    S = variances.pose[place]
    variance = sensor + np.einsum("ni,ni->n", linear.pose, (J @ S)[where])
    typical = float(np.median(variance))
    scale = np.ones(J.shape[:2])
    scale[where] = np.sqrt(typical / np.maximum(sensor, SINGULAR * variance))
    root = _inverse_roots(J * (scale / np.sqrt(typical))[:, :, None], S) * scale[:, None, :]
    return Whitening(root, station, readings.beam, float(np.sqrt(typical)))


def _inverse_roots(J: FloatArray, S: FloatArray) -> FloatArray:
    """Return the symmetric inverse roots (M, K, K) of I + J S J', J (M, K, 6) and S (M, 6, 6)."""
    if J.shape[1] <= J.shape[2]:
        values, axes = np.linalg.eigh(J @ S @ np.swapaxes(J, 1, 2))
        part = 1.0 / _stretch(values)
        return np.asarray((axes * part) @ np.swapaxes(axes, 1, 2))
    U = J @ covariance_roots(S)
    values, axes = np.linalg.eigh(np.swapaxes(U, 1, 2) @ U)
    r, axes = _stretch(values), U @ axes  # axes of U U', each as long as the root of its value
    root = (axes / (-r * (1.0 + r))) @ np.swapaxes(axes, 1, 2)
    each = np.arange(J.shape[1])
    root[:, each, each] += 1.0
    return np.asarray(root)


def _stretch(values: FloatArray) -> FloatArray:
    """Return the roots (M, 1, d) of 1 + values (M, d) in ascending order, free of rounding."""
    return np.sqrt(1.0 + np.maximum(values, SINGULAR * values[:, -1:]))[:, None, :]


def covariance_roots(covariance: FloatArray) -> FloatArray:
    """Return L (M, d, d) with L L' the covariance."""
    values, axes = np.linalg.eigh(covariance)
    root: FloatArray = axes * np.sqrt(np.maximum(values, 0.0))[:, None, :]
    return root


def reading_sigmas(parameters: Parameters, readings: Readings, variances: Variances) -> FloatArray:
    """Return the standard deviation (N,) [m] of each reading's residual, pose included.

    Where a beam grazes its plane, and there is none, 1 m.
    """
    steep = np.abs(equation.cosines(equation.scene(parameters, readings))) >= equation.GRAZING_LIMIT
    rows = np.flatnonzero(steep)
    part = readings.subset(rows)
    variance = own_variances(parameters, part, variances)
    if variances.pose is not None:
        J = equation.linearize(equation.scene(parameters, part), part.distance, with_pose=True).pose
        S = variances.pose[part.station]
        variance = variance + np.einsum("ni,nij,nj->n", J, S, J)
    sigmas = np.ones(len(readings))
    sigmas[rows] = np.sqrt(variance)
    return sigmas


def own_variances(parameters: Parameters, readings: Readings, variances: Variances) -> FloatArray:
    """Return the variance (N,) [m^2] of each reading's residual, without the error of the pose."""
    slope = noise_slopes(parameters, readings)
    variance: FloatArray = (slope * variances.range_sigma[readings.beam]) ** 2
    if variances.incidence_sigma > 0.0:
        cosine = equation.cosines(equation.scene(parameters, readings))
        variance = variance + variances.incidence_sigma**2 * (1.0 / cosine**2 - 1.0)
    return variance


def slopes(parameters: Parameters, readings: Readings) -> FloatArray:
    """Return g'(d) (N,): by how much an error of a reading, or of a mean, changes a residual."""
    k = parameters.range_errors[readings.beam]
    slope: FloatArray = 1.0 + k[:, 0] + 2.0 * k[:, 1] * readings.distance
    return slope


def noise_slopes(parameters: Parameters, readings: Readings) -> FloatArray:
    """Return g'(d) / sqrt(m) (N,): what the noise of one of m averaged readings does to a residual."""
    slope = slopes(parameters, readings)
    return slope if readings.samples is None else slope / np.sqrt(readings.samples)


def unequal(variances: Variances, terms: int, readings: Readings) -> bool:
    """Tell whether residuals differ in their weights, or are correlated.

    Range errors of any `terms` make them differ: they change what noise does to a residual. So do
    readings that are means of several.
    """
    return bool(
        terms
        or readings.samples is not None
        or variances.pose is not None
        or variances.incidence_sigma > 0.0
        or np.ptp(variances.range_sigma) > 0.0
    )


def stations_from_zero(readings: Readings) -> IntArray:
    """Return the number (N,) of every reading's station among those that have readings."""
    _, station = np.unique(readings.station, return_inverse=True)
    return station.astype(np.intp)
