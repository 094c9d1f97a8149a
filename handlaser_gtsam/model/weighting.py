r"""How readings err together: the covariance of a station's readings, and its inverse root.

The residuals of the readings d of one station have, to first order, the covariance

    C = diag((g'(d) sigma)^2 / m + (tau tan a)^2) + J S J'

with the slope g'(d) of the corrected reading, m the number of independent readings that d is
the mean of (else one), sigma the range sigma of the beam, tau the
incidence sigma, a the angle of incidence, S the covariance (6, 6) of the hand pose and J the derivative
of the residuals by it. J S J' couples the readings of a station. Stations are independent.

With D the diagonal part and U U' = inv(sqrt(D)) J S J' inv(sqrt(D)), C is sqrt(D) (I + U U') sqrt(D).
U has six columns, however many readings a station has. With the Cholesky factor L of I + U'U,

    inv(I + U U') = I - V V',    V = U inv(L'),

which is all that weights need. With the eigenvectors A and eigenvalues m of V'V, its symmetric root is

    I - E E',    E = V A / sqrt(1 + sqrt(1 - m)),

so that R = (I - E E') inv(sqrt(D)) has R C R' = I.

Noise is kept out of the columns of the range errors. The residual e = s - g(d) errs by -g'(d) eps,
where eps is the noise of the reading d. Its derivatives by the range errors, -d and -d^2, hold the same
noise: least squares over N readings then pull k1 by about sqrt(N) sigma / spread of the readings, in
its standard deviations, however large N is (errors in variables; Fuller, Measurement Error Models,
1987).
The residuals of a station themselves say what the noise probably is,

    E[eps | e] = -g'(d) sigma^2 inv(C) e,

and a reading freed of it, l = d - E[eps | e], is uncorrelated with e. Where the range error is taken at
that, e = s - (c + g(l) - l), nothing is pulled, to first order. With c = g(d) - g(l) + l at the
parameters where this is done, residuals stay there what they are.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.sparse import csr_array

from ..arrays import FloatArray, IntArray, renumbered
from ..data.parameters import Parameters
from ..data.readings import Readings, Regressors
from ..data.value import Value
from ..quantities import FAR_SIGMAS, NEGLIGIBLE
from . import equation
from .equation import corrected, residuals, scene
from .families import POSE

LEAST_OWN = 1e-8
"""Least part of a reading's variance that is its own: readings of a station that the hand alone moves
would be known relative to each other without any noise."""


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


@dataclass(frozen=True, eq=False, repr=False)  # no slots: the root is made when it is needed
class Whitening(Value):
    """Makes the residuals of readings independent and equally precise.

    R = (I - E E') diag(root) has R C R' = sigma^2 I.

    Attributes
    ----------
    root : (N,)
        sigma over the standard deviation of each reading's own noise.
    sigma : float
        Standard deviation of a whitened residual [m]: the typical one of a reading.
    station : (N,)
        Number of each reading's station.
    common : (N, 6) or None
        V, which couples the readings of a station. None where hand poses do not err.
    """

    root: FloatArray
    sigma: float
    station: IntArray
    common: FloatArray | None = None

    @property
    def is_coupled(self) -> bool:
        """Whether readings are correlated with others of their station."""
        return self.common is not None

    def of_rows(self, rows: IntArray) -> "Whitening":
        """Return the whitening of some readings: of whole stations, in any order."""
        station = renumbered(self.station[rows])
        common = None if self.common is None else self.common[rows]
        return Whitening(self.root[rows], self.sigma, station, common)

    def apply_rows(self, rows: FloatArray) -> FloatArray:
        """Return whitened rows (N, D)."""
        scaled = self.root[:, None] * rows
        return scaled if self.common is None else scaled - self._E @ (self._E.T @ scaled)

    def apply(self, residual: FloatArray) -> FloatArray:
        """Return whitened residuals (N,) [m]."""
        return self.apply_rows(residual[:, None])[:, 0]

    def weighed(self, rows: FloatArray) -> FloatArray:
        """Return sigma^2 inv(C) = R' R times rows (N, D)."""
        if self.common is None:
            return self.root[:, None] ** 2 * rows
        scaled = self.root[:, None] * rows
        weighed: FloatArray = self.root[:, None] * (scaled - self._V @ (self._V.T @ scaled))
        return weighed

    def information(self, rows: csr_array) -> FloatArray:
        """Return J' sigma^2 inv(C) J (n, n) for sparse rows J (N, n)."""
        scaled = rows.multiply(self.root[:, None]).tocsr()
        whole = (scaled.T @ scaled).toarray()
        if self.common is None:
            return np.asarray(whole)
        common = self._V.T @ scaled
        return np.asarray(whole - (common.T @ common).toarray())

    def log_det(self) -> float:
        """Return log det of C, in units of sigma^2."""
        own = -2.0 * float(np.log(self.root).sum())
        return (
            own if self.common is None else own - float(np.log1p(-self._squares_of_common[0]).sum())
        )

    def squares(self) -> FloatArray:
        """Return what a reading (N,) weighs by itself: the diagonal of sigma^2 inv(C)."""
        squares: FloatArray = self.root**2
        return squares if self.common is None else squares * (1.0 - (self.common**2).sum(axis=1))

    def coloured(self, white: FloatArray) -> FloatArray:
        """Return rows (N, D) that `apply_rows` makes `white`."""
        if self.common is None:
            return white / self.root[:, None]
        E = self._E
        # Orthogonal columns: inv(I - E E') = I + E inv(I - E'E) E', with E'E diagonal in a station.
        length = np.asarray(E.multiply(E).sum(axis=0)).ravel()[:, None]
        free = white + E @ ((E.T @ white) / (1.0 - length))
        return np.asarray(free / self.root[:, None])

    @cached_property
    def _V(self) -> csr_array:
        assert self.common is not None
        return self._sparse(self.common)

    @cached_property
    def _E(self) -> csr_array:
        assert self.common is not None
        values, axes = self._squares_of_common
        axes = axes / np.sqrt(1.0 + np.sqrt(1.0 - values))[:, None]
        return self._sparse((self.common[:, None] @ axes[self.station])[:, 0])

    @cached_property
    def _squares_of_common(self) -> tuple[FloatArray, FloatArray]:
        """Eigenvalues (S, 6) and eigenvectors (S, 6, 6) of V'V of every station."""
        assert self.common is not None
        V = self.common
        order = np.argsort(self.station, kind="stable")
        first = np.flatnonzero(np.diff(self.station[order], prepend=-1))
        outer = V[order, :, None] * V[order, None, :]
        values, axes = np.linalg.eigh(np.add.reduceat(outer, first))
        return np.clip(values, 0.0, 1.0), axes

    def _sparse(self, common: FloatArray) -> csr_array:
        """Return columns (N, 6) as (N, 6 S), in which each station has six columns of its own."""
        count, width = common.shape
        columns = (width * self.station[:, None] + np.arange(width)).ravel()
        shape = count, width * (int(self.station.max()) + 1)
        return csr_array((common.ravel(), columns, width * np.arange(count + 1)), shape=shape)


def joined(whitenings: Sequence[Whitening]) -> Whitening:
    """Return one whitening of the rows of several, one after the other; sigma of the first."""
    first, common = 0, []
    station = []
    for part in whitenings:
        station.append(first + part.station)
        first += int(part.station.max()) + 1
        common.append(np.zeros((len(part.root), POSE.dim)) if part.common is None else part.common)
    coupled = any(part.is_coupled for part in whitenings)
    return Whitening(
        np.concatenate([part.root for part in whitenings]),
        whitenings[0].sigma,
        np.concatenate(station),
        np.concatenate(common) if coupled else None,
    )


def whitening(parameters: Parameters, readings: Readings, variances: Variances) -> Whitening:
    """Return the whitening of `readings` at `parameters`.

    Raises
    ------
    GrazingBeamError
        A beam is parallel to its plane.
    """
    sensor, station = own_variances(parameters, readings, variances), renumbered(readings.station)
    if variances.pose is None:
        typical = float(np.median(sensor))
        return Whitening(np.sqrt(typical / sensor), float(np.sqrt(typical)), station)
    linear = equation.linearize(
        equation.scene(parameters, readings), readings.distance, with_pose=True
    )
    return coupled(sensor, moved_with_poses(linear.pose, variances.pose, readings.station), station)


def coupled(sensor: FloatArray, moved: FloatArray, station: IntArray) -> Whitening:
    """Return the whitening of readings with variances (N,) of their own, and common errors.

    `moved` (N, 6) is how residuals follow errors of unit variance, which are the same for all readings
    of a station (N,); stations are numbered without gaps.
    """
    variance = sensor + (moved**2).sum(axis=1)
    typical = float(np.median(variance))
    if int(station.max()) + 1 == len(station):
        # Errors of the pose are noise of the only reading then.
        return Whitening(np.sqrt(typical / variance), float(np.sqrt(typical)), station)
    root = np.sqrt(typical / np.maximum(sensor, LEAST_OWN * variance))
    common = _common_columns(moved * (root / np.sqrt(typical))[:, None], station)
    return Whitening(root, float(np.sqrt(typical)), station, common)


def moved_with_poses(pose: FloatArray, covariance: FloatArray, station: IntArray) -> FloatArray:
    """Return derivatives (N, 6) by the hand poses times roots of the covariances of their stations."""
    if (covariance == covariance[0]).all():
        return np.asarray(pose @ covariance_roots(covariance[:1])[0])
    return np.asarray((pose[:, None] @ covariance_roots(covariance)[station])[:, 0])


def _common_columns(U: FloatArray, station: IntArray) -> FloatArray:
    """Return V (N, 6) of the module's docstring for U (N, 6), by station."""
    order = np.argsort(station, kind="stable")
    count = np.bincount(station)
    place = np.empty_like(station)  # of each reading in its station
    place[order] = np.arange(len(order)) - np.repeat(np.cumsum(count) - count, count)
    table = np.zeros((U.shape[1], 1, count.max(), len(count)))
    table[:, 0, place, station] = U.T
    return np.ascontiguousarray(without_common(table)[0][:, 0, place, station].T)


def without_common(U: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return V with I - V V' = inv(I + U U') for every station, and the sums of log det(I + U U').

    Parameters
    ----------
    U : (6, K, B, M)
        Of K problems and the readings of B beams at M stations.

    Returns
    -------
    V : (6, K, B, M)
    log_det : (K,)
    """
    # V is U over the transposed Cholesky factor of I + U'U, of all stations at once. Where errors of
    # the hand are 1e8 times those of a reading, rounding makes it indefinite, which LAPACK refuses.
    V, width = U.copy(), len(U)
    A = np.empty((width, width, *U.shape[1:2], U.shape[3]))
    for i in range(width):
        np.einsum("jkbm,kbm->jkm", U[: i + 1], U[i], out=A[i, : i + 1])
        A[i, i] += 1.0
    log_det = np.zeros(U.shape[1])
    for i in range(width):
        np.maximum(A[i, i], 1.0, out=A[i, i])  # a pivot of I + U'U, but for rounding
        log_det += np.log(A[i, i]).sum(axis=1)
        A[i:, i] /= np.sqrt(A[i, i])
        V[i] /= A[i, i][:, None]
        for j in range(i + 1, width):
            A[j, i + 1 : j + 1] -= A[j, i] * A[i + 1 : j + 1, i]
            V[j] -= A[j, i][:, None] * V[i]
    return V, log_det


def covariance_roots(covariance: FloatArray) -> FloatArray:
    """Return L (M, d, d), read-only, with L L' the covariance; once where all are one."""
    if len(covariance) > 1 and (covariance == covariance[0]).all():
        return np.broadcast_to(covariance_roots(covariance[:1]), covariance.shape)
    values, axes = np.linalg.eigh(covariance)
    root: FloatArray = axes * np.sqrt(np.maximum(values, 0.0))[:, None, :]
    return root


def without_exact_axes(covariance: FloatArray, length: float) -> FloatArray:
    """Return covariances (M, 6, 6) of poses with a variance along every axis, as an elimination needs.

    An axis without error gets a negligible part of the largest variance; rotations are compared with
    translations at a typical range [m].
    """
    unit = POSE.natural_units(length) / length
    values, axes = np.linalg.eigh(covariance / np.outer(unit, unit))
    values = np.maximum(values, NEGLIGIBLE * values[:, -1:])
    whole: FloatArray = (axes * values[:, None, :]) @ np.swapaxes(axes, 1, 2)
    return whole * np.outer(unit, unit)


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
    constant, linear = 1.0 + parameters.range_errors[:, 0], 2.0 * parameters.range_errors[:, 1]
    slope: FloatArray = linear.take(readings.beam) * readings.distance
    slope += constant.take(readings.beam)
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


def weighed(
    readings: Readings, parameters: Parameters, variances: Variances, terms: int
) -> tuple[Readings, Whitening]:
    """Return the readings with the regressors of their range errors, and their whitening.

    The readings are returned as they are where they have no range-error `terms`, else
    `freed_of_noise`, which may raise.
    """
    how = whitening(parameters, readings, variances)
    return (freed_of_noise(readings, parameters, variances, how) if terms else readings), how


def freed_of_noise(
    readings: Readings, parameters: Parameters, variances: Variances, how: Whitening
) -> Readings:
    """Return readings of which the range error is taken without their probable noise.

    Parameters
    ----------
    readings : Readings
    at : Parameters
        Where the noise is judged.
    variances : Variances
    how : Whitening
        Of the readings at these parameters, errors of the hand poses included.

    Raises
    ------
    GrazingBeamError
        A beam is parallel to its plane.
    """
    d, x = readings.distance, scene(parameters, readings)
    variance = variances.range_sigma[readings.beam] ** 2
    if readings.samples is not None:
        variance = variance / readings.samples
    heavy = how.weighed(residuals(x, d)[:, None])[:, 0] / how.sigma**2
    share = slopes(parameters, readings) * variance
    most = FAR_SIGMAS * np.sqrt(variance)  # a larger residual is no noise
    level = d + np.clip(share * heavy, -most, most)
    constant = corrected(d, x.k) - level * (x.k[:, 0] + x.k[:, 1] * level)
    return readings.with_regressors(Regressors(constant, level))
