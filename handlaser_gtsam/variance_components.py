r"""Estimates of the variances of readings and hand poses from residuals.

The covariance of the readings is C = C_0 + sum_k theta_k Q_k: known parts, and one unknown factor for
the range variance (of all beams or of each), one for the translations and one for the rotations of the
hand. With the Jacobian A of all unknowns and

    P = inv(C) - inv(C) A inv(A' inv(C) A) A' inv(C)

restricted maximum likelihood solves, by Fisher's scoring,

    sum_l tr(P Q_k P Q_l) theta_l = e' P Q_k P e - tr(P Q_k P C_0)

(Patterson and Thompson, Biometrika 1971). P removes whatever the unknowns can explain, so the
residuals e of any solution near the optimum do. Long recordings are represented by some of their
planes.
"""

from dataclasses import dataclass

import numpy as np

from . import model
from .arrays import BoolArray, FloatArray
from .parameters import Parameters, Terms, per_beam
from .recording import Readings
from .solvers.reduction import jacobian_columns
from .weighting import Variances, own_variances, slopes, stations_from_zero

ENOUGH = 3000
"""So many readings tell the variances."""
STEPS = 50
SETTLED = 1e-6
LEAST = 1e-8
"""A factor is never below this part of its start: a variance of zero has no inverse."""
CLOSE = 1e-3


RANGE, TRANSLATION, ROTATION = "range", "pose translation", "pose rotation"
AXES = {ROTATION: slice(0, 3), TRANSLATION: slice(3, 6)}
Part = tuple[str, int | None]


@dataclass(frozen=True, slots=True)
class Wanted:
    """Which variances are unknown: that of the readings, of each beam by itself, and of the poses."""

    ranges: bool = True
    by_beam: bool = False
    poses: bool = False


@dataclass(frozen=True, slots=True)
class Components:
    """Estimated variances.

    Attributes
    ----------
    variances : Variances
        With the estimates in place.
    parts : tuple of (str, int or None)
        `range`, `pose translation` or `pose rotation`, and the beam's index where it is of one.
    sigmas : (n,)
        Standard deviations: ranges [m], translation [m] and rotation [rad] an axis.
    errors : (n,)
        Their own standard deviations; infinite where the readings cannot tell.
    """

    variances: Variances
    parts: tuple[Part, ...]
    sigmas: FloatArray
    errors: FloatArray

    def close_to(self, other: "Components | None") -> bool:
        """Tell whether another estimate is nearly the same."""
        if other is None:
            return False
        errors = np.where(np.isfinite(self.errors), self.errors, 0.0)
        difference = np.abs(self.sigmas - other.sigmas)
        return bool((difference <= CLOSE * (self.sigmas + errors)).all())


def estimate_components(
    parameters: Parameters,
    readings: Readings,
    terms: Terms,
    variances: Variances,
    wanted: Wanted,
) -> Components:
    """Estimate the variances that are wanted, from the residuals at `parameters`.

    Parameters
    ----------
    parameters : Parameters
        A solution.
    readings : Readings
    terms : int, or one a beam
    variances : Variances
        Known ones, and where the estimates start.
    wanted : Wanted
    """
    part = _part(readings)
    grid = _Grid(parameters, part, terms, variances)
    parts = grid.parts(wanted)
    theta, fisher = _scored(grid, grid.known(wanted), np.array([grid.matrix(one) for one in parts]))
    inverse = np.linalg.pinv(fisher, hermitian=True, rcond=1e-12)
    spread = np.sqrt(2.0 * np.maximum(np.diagonal(inverse), 0.0))
    sigma = np.sqrt(theta) * np.array([grid.unit(one) for one in parts])
    # The standard deviation of a standard deviation: half that of the variance, relatively.
    errors = np.where(theta > 0.0, 0.5 * spread / np.maximum(theta, 1e-300) * sigma, np.inf)
    return Components(_scaled(variances, parts, np.maximum(theta, LEAST)), parts, sigma, errors)


class _Grid:
    """Residuals, derivatives and covariance parts on a grid of stations by beams."""

    def __init__(
        self, parameters: Parameters, readings: Readings, terms: Terms, variances: Variances
    ) -> None:
        self.readings, self.variances = readings, variances
        station = stations_from_zero(readings)
        self.where = (station, readings.beam)
        self.shape = (int(station.max()) + 1, readings.beams)
        x = model.scene(parameters, readings)
        at = model.linearize(x, readings.distance, with_pose=True)
        self.slope = slopes(parameters, readings)
        self.fixed = own_variances(parameters, readings, variances)
        self.fixed = self.fixed - (self.slope * variances.range_sigma[readings.beam]) ** 2
        self.e = self._on_grid(at.residual)
        self.pose = self._on_grid(at.pose)
        self.read = self._on_grid(np.ones(len(readings)))
        self.A = self._on_grid(_dense_jacobian(parameters, readings, terms))
        self.S = np.zeros((self.shape[0], 6, 6))
        if variances.pose is not None:
            self.S[station] = variances.pose[readings.station]

    def _on_grid(self, rows: FloatArray) -> FloatArray:
        grid = np.zeros((*self.shape, *rows.shape[1:]))
        grid[self.where] = rows
        return grid

    def _diagonal(self, rows: FloatArray) -> FloatArray:
        on_grid: FloatArray = self._on_grid(rows)[:, :, None] * np.eye(self.shape[1])
        return on_grid

    def parts(self, wanted: Wanted) -> tuple[Part, ...]:
        """Return the parts whose variances are wanted."""
        found: list[Part] = []
        if wanted.by_beam:
            found += [(RANGE, beam) for beam in range(self.readings.beams)]
        elif wanted.ranges:
            found.append((RANGE, None))
        if wanted.poses:
            found += [(TRANSLATION, None), (ROTATION, None)]
        return tuple(found)

    def matrix(self, part: Part) -> FloatArray:
        """Return Q_k (S, B, B) of a part."""
        name, beam = part
        if name == RANGE:
            own = (self.slope * self.variances.range_sigma[self.readings.beam]) ** 2
            if beam is not None:
                own = np.where(self.readings.beam == beam, own, 0.0)
            return self._diagonal(own)
        J, axes = self.pose[:, :, AXES[name]], AXES[name]
        of_pose: FloatArray = J @ self.S[:, axes, axes] @ np.swapaxes(J, 1, 2)
        return of_pose

    def known(self, wanted: Wanted) -> FloatArray:
        """Return C_0 (S, B, B), with ones where a beam has no reading."""
        known = self._diagonal(self.fixed)
        known += (1.0 - self.read)[:, :, None] * np.eye(self.shape[1])
        if not (wanted.ranges or wanted.by_beam):
            known += self.matrix((RANGE, None))
        if not wanted.poses:
            known += self.pose @ self.S @ np.swapaxes(self.pose, 1, 2)
        return known

    def unit(self, part: Part) -> float:
        """Return the standard deviation behind a part: theta multiplies its square."""
        name, beam = part
        if name == RANGE:
            return float(self.variances.range_sigma[slice(None) if beam is None else beam].mean())
        trace = np.einsum("sii->s", self.S[:, AXES[name], AXES[name]]).mean()
        return float(np.sqrt(trace / 3.0))


def _scaled(variances: Variances, parts: tuple[Part, ...], theta: FloatArray) -> Variances:
    """Return `variances` with each part multiplied by its factor."""
    ranges, pose = variances.range_sigma.copy(), variances.pose
    factor = np.ones(6)
    for (name, beam), value in zip(parts, theta, strict=True):
        if name == RANGE:
            ranges[slice(None) if beam is None else beam] *= np.sqrt(value)
        else:
            factor[AXES[name]] = np.sqrt(value)
    if pose is not None and (factor != 1.0).any():
        pose = pose * np.outer(factor, factor)
    return Variances(ranges, variances.incidence_sigma, pose)


def _scored(grid: _Grid, known: FloatArray, unknown: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the factors theta, and the matrix tr(P Q_k P Q_l) at them."""
    theta = np.ones(len(unknown))
    for _ in range(STEPS):
        fisher, right = _normal(grid, known + np.tensordot(theta, unknown, 1), known, unknown)
        new = _non_negative(fisher, right, LEAST)
        step = np.abs(new - theta).max() / max(float(new.max()), LEAST)
        theta = np.maximum(new, LEAST)
        if step < SETTLED:
            break
    return np.where(theta <= LEAST, 0.0, theta), fisher


def _normal(
    grid: _Grid, C: FloatArray, known: FloatArray, unknown: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the matrix and the right side of one scoring step at the covariance `C`."""
    inverse = np.linalg.inv(C)
    W = inverse @ grid.A
    M = np.einsum("sbp,sbq->pq", grid.A, W, optimize=True)
    scale = 1.0 / np.sqrt(np.maximum(np.diagonal(M), 1e-300))
    M_inverse = np.linalg.pinv(M * np.outer(scale, scale), rcond=1e-13, hermitian=True)
    M_inverse *= np.outer(scale, scale)
    e = grid.e[:, :, None]
    Pe = (inverse @ e - W @ (M_inverse @ np.einsum("sbp,sbq->pq", W, e)))[:, :, 0]
    every = [*unknown, known]
    QW = [Q @ W for Q in every]
    CQ = [inverse @ Q for Q in every]
    G = [M_inverse @ np.einsum("sbp,sbq->pq", W, one, optimize=True) for one in QW]
    n = len(unknown)
    traces = np.empty((n, n + 1))
    for k in range(n):
        for j in range(n + 1):
            direct = float(np.einsum("sab,sba->", CQ[k], CQ[j]))
            mixed = np.einsum("sbp,sbc,scq->pq", QW[k], inverse, QW[j], optimize=True)
            cross = float(np.einsum("pq,qp->", M_inverse, mixed))
            traces[k, j] = direct - 2.0 * cross + float(np.einsum("pq,qp->", G[k], G[j]))
    squares = np.array([float(np.einsum("sb,sbc,sc->", Pe, Q, Pe)) for Q in unknown])
    return traces[:, :n], squares - traces[:, n]


def _non_negative(fisher: FloatArray, right: FloatArray, least: float) -> FloatArray:
    """Solve for factors; those that would be negative are set to `least`, one after the other."""
    free: BoolArray = np.ones(len(right), dtype=bool)
    theta = np.full(len(right), least)
    while free.any():
        reduced = right[free] - fisher[np.ix_(free, ~free)] @ theta[~free]
        solved = np.linalg.lstsq(fisher[np.ix_(free, free)], reduced, rcond=1e-12)[0]
        if (solved >= least).all():
            theta[free] = solved
            break
        worst = np.flatnonzero(free)[int(np.argmin(solved))]
        free[worst] = False
    return theta


def _part(readings: Readings) -> Readings:
    """Return the readings of as many planes, evenly chosen, as have `ENOUGH`."""
    if len(readings) <= ENOUGH:
        return readings
    count = max(readings.planes * ENOUGH // len(readings), 1)
    planes = np.unique(np.linspace(0, readings.planes - 1, count).round().astype(int))
    rows = np.flatnonzero(np.isin(readings.plane, planes))
    if len(rows) > 2 * ENOUGH:  # one long plane
        stations = np.unique(readings.station[rows])
        keep = stations[:: len(rows) // ENOUGH]
        rows = rows[np.isin(readings.station[rows], keep)]
    return readings.subset(rows)


def _dense_jacobian(parameters: Parameters, readings: Readings, terms: Terms) -> FloatArray:
    """Return the derivatives (N, 7 B + 3 P') by all unknowns, P' the planes that are read.

    Columns of range-error terms that a beam does not have are zero.
    """
    columns, _ = jacobian_columns(parameters, readings, 2)
    counts = np.array(per_beam(terms, readings.beams))[readings.beam]
    columns[5] *= counts > 0
    columns[6] *= counts > 1
    width = 7
    planes, plane = np.unique(readings.plane, return_inverse=True)
    first = readings.beams * width
    dense = np.zeros((len(readings), first + 3 * len(planes)))
    rows = np.arange(len(readings))[:, None]
    dense[rows, readings.beam[:, None] * width + np.arange(width)] = columns[:width].T
    dense[rows, first + 3 * plane[:, None] + np.arange(3)] = columns[width : width + 3].T
    return dense
