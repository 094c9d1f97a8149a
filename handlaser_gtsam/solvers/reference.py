r"""An independent solution with SciPy, so that the factor graph can be contradicted.

It shares neither residual nor parametrisation with the rest of the package. In the world frame the
beam starts at o = R r + t and runs along w = R v; the range to the plane is

    s = -(n . o + b) / (n . w)

and, as in Wei and Hirzinger, a unit vector is two of its components: the one of largest magnitude at
the start is replaced by +-sqrt(1 - the squares of the others). Derivatives are SciPy's differences.
Covariances follow from Gauss-Markov, sigma^2 inv(J'J).

Weights, where readings differ in them or share the errors of a pose, are held while SciPy runs and then
updated at its solution, as is the noise of the readings that the residuals show: it is kept out of
what multiplies the range errors. How a pose moves a range is found by moving the pose.

Systematic errors can be unknowns: sizes a, each with a row a / p of its prior. They move the poses, or
they make the readings longer; what an error of size 1 does is held and updated as weights are
(`reference_errors`).
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.optimize import OptimizeResult, least_squares
from scipy.sparse import block_diag, csr_array, vstack
from scipy.spatial.transform import Rotation

from ..arrays import BoolArray, FloatArray, IntArray
from ..data.parameters import Parameters, RangeErrorPrior
from ..data.recording import Recording
from .reference_errors import ReferenceErrors

DENSE_UNKNOWNS = 200
"""Above this many unknowns the Jacobian is kept sparse."""
TOLERANCE = 1e-15
"""SciPy runs until nothing changes: its tolerances are below what doubles resolve."""
INNER_TOLERANCE = 1e-10
"""Tolerance of the iterative solution of a sparse step: SciPy's own stalls far from the optimum."""
REWEIGHTINGS = 4
"""Updates of the weights; each leaves about a thousandth of the error that the one before left."""
NOISE_LIMIT = 4.0
"""Standard deviations of a reading that count as noise; stated again, for nothing is shared."""
POSE_STEP = 1e-6
"""Step of the differences by a hand pose [rad, m], or by a shift of a ray [m]: about the cube root of
the rounding of doubles."""


UNIT = {"beam": slice(3, 6), "plane": slice(0, 3)}
"""Where a unit vector stands among the numbers of a variable."""


class Unknowns:
    """Variables as the unknowns of SciPy; of a unit vector one component follows from the others.

    Parameters
    ----------
    start : mapping of str to (n, width)
        Numbers of the variables of each kind: they choose which component of each unit vector follows.
    free : mapping of str to (n, width) or (width,) of bool, optional
        Which numbers are unknown, the others being zero; all of a kind where it is not given.

    Attributes
    ----------
    x0 : (q,)
        The unknowns at the start.
    place : mapping of str to (n, width)
        Where each number stands among the unknowns; -1 for none.
    """

    def __init__(
        self, start: Mapping[str, FloatArray], free: Mapping[str, BoolArray] | None = None
    ) -> None:
        self.place: dict[str, IntArray] = {}
        self._follows: dict[str, tuple[IntArray, IntArray, FloatArray]] = {}
        count = 0
        for kind, table in start.items():
            kept = np.array(np.broadcast_to((free or {}).get(kind, np.True_), table.shape))
            if kind in UNIT:
                rows = np.arange(len(table))
                follows = UNIT[kind].start + np.abs(table[:, UNIT[kind]]).argmax(axis=1)
                kept[rows, follows] = False
                self._follows[kind] = rows, follows, np.sign(table[rows, follows])
            self.place[kind] = np.where(kept, count + np.cumsum(kept).reshape(kept.shape) - 1, -1)
            count += int(kept.sum())
        self.x0 = np.concatenate([start[kind][at >= 0] for kind, at in self.place.items()])

    def at(self, x: FloatArray) -> dict[str, FloatArray]:
        """Return the numbers (n, width) of each kind at a vector of unknowns."""
        x = np.append(x, 0.0)
        tables = {kind: x[place] for kind, place in self.place.items()}
        for kind, (rows, follows, sign) in self._follows.items():
            square = 1.0 - (tables[kind][:, UNIT[kind]] ** 2).sum(axis=1)
            tables[kind][rows, follows] = sign * np.sqrt(np.maximum(square, 0.0))
        return tables

    def covariances(self, x: FloatArray, inverse: FloatArray) -> dict[str, FloatArray]:
        """Return the covariances (n, width, width) of the variables; `inverse` is the unknowns'."""
        padded, found = np.pad(inverse, (0, 1)), {}
        for kind, table in self.at(x).items():
            place = self.place[kind]
            lift = np.eye(table.shape[1]) * (place >= 0)[:, None]
            if kind in UNIT:
                rows, follows, _ = self._follows[kind]
                by_others = -table / table[rows, follows][:, None] * (place >= 0)
                lift[rows, follows, UNIT[kind]] = by_others[:, UNIT[kind]]
            own = padded[place[:, :, None], place[:, None]]
            found[kind] = lift @ own @ np.swapaxes(lift, 1, 2)
        return found


def by_poses(
    residuals: Callable[[FloatArray, FloatArray], FloatArray], R: FloatArray, t: FloatArray
) -> FloatArray:
    """Return derivatives (N, 6) of residuals (N,) by hand poses (M, 3, 3), (M, 3), in their frames."""
    columns = []
    for step in POSE_STEP * np.eye(6):
        turn = Rotation.from_rotvec(step[:3]).as_matrix()
        ahead = residuals(R @ turn, t + R @ step[3:])
        columns.append((ahead - residuals(R @ turn.T, t - R @ step[3:])) / (2.0 * POSE_STEP))
    return np.stack(columns, axis=1)


@dataclass(frozen=True, slots=True)
class ReferenceSolution:
    """What SciPy found.

    Attributes
    ----------
    parameters : Parameters
    beam_covariances : (B, 8, 8)
        Over (x, y, z, vx, vy, vz, k1, k2), for a range sigma of 1 m or the noise given.
    plane_covariances : (P, 4, 4)
        Over (nx, ny, nz, b), likewise.
    squares : float
        Sum of squared residuals [m^2], or in units of the noise given.
    iterations : int
        Jacobian evaluations.
    message : str
        SciPy's.
    sizes, size_sigmas : mapping of (str, str) to float
        Of systematic errors that are unknowns, by code and subject, with their standard deviations.
    """

    parameters: Parameters
    beam_covariances: FloatArray
    plane_covariances: FloatArray
    squares: float
    iterations: int
    message: str
    sizes: Mapping[tuple[str, str], float]
    size_sigmas: Mapping[tuple[str, str], float]


@dataclass(frozen=True, slots=True)
class ReferenceNoise:
    """What the readings err by, by beam and station of the recording.

    Attributes
    ----------
    range_sigma : (B,)
        [m]
    incidence_sigma : float
        [m]
    pose : (M, 6, 6) or None
        Covariance of the hand poses (rx, ry, rz, x, y, z), hand frame.
    """

    range_sigma: FloatArray
    incidence_sigma: float = 0.0
    pose: FloatArray | None = None


class ReferenceProblem:
    """Residuals of a recording over the paper's parameters.

    Parameters
    ----------
    recording : Recording
    start : Parameters
        Also chooses which component of each unit vector follows from the others.
    terms : int, or one a beam
        Range-error terms.
    prior : RangeErrorPrior, optional
        Of the range errors, beside weighted residuals.
    errors : mapping of str to float, optional
        Systematic errors that are unknowns, of `reference_errors.ERRORS`, with the sigmas of their
        priors.
    used : (M, B) of bool, optional
        Which of the readings are solved; all of them where not given. The errors are defined by those
        between the smallest and the largest of these.
    """

    def __init__(
        self,
        recording: Recording,
        start: Parameters,
        terms: int | tuple[int, ...],
        prior: RangeErrorPrior | None = None,
        errors: Mapping[str, float] | None = None,
        used: BoolArray | None = None,
    ) -> None:
        beams = len(recording.beam_names)
        terms = (terms,) * beams if isinstance(terms, int) else terms
        used = ~np.isnan(recording.ranges) if used is None else used
        low, high = recording.ranges[used].min(), recording.ranges[used].max()
        seen = (recording.ranges >= low) & (recording.ranges <= high)
        self.station, self.beam = np.nonzero(seen)
        self.used = used[seen]
        self.plane = recording.plane_of_station[self.station]
        self.d = recording.ranges[self.station, self.beam]
        samples = (
            np.ones(recording.ranges.shape) if recording.samples is None else recording.samples
        )
        self.samples = samples[self.station, self.beam]
        self.errors = ReferenceErrors(errors or {}, recording, seen)
        active = [[True] * 6 + [n > 0, n > 1] for n in terms]
        tables = {
            "beam": np.hstack(start.beams),
            "plane": np.column_stack((start.normals, start.offsets)),
            "size": np.zeros((len(self.errors.sigma), 1)),
        }
        self.unknowns = Unknowns(tables, {"beam": np.array(active)})
        self.x0 = self.unknowns.x0
        self.per_size = np.zeros((len(self.d), len(self.errors.sigma)))
        self.whiten: csr_array | None = None
        self.base = self.level = self.d
        # One more row for every range error of which something is known: k / its sigma.
        of_errors = self.unknowns.place["beam"][:, 6:]
        known = (of_errors >= 0) & (prior is not None)
        self.prior_at = of_errors[known]
        sigma = np.ones((beams, 2)) if prior is None else prior.sigma
        self.prior_sigma = sigma[known]

    def unpack(self, x: FloatArray) -> Parameters:
        """Return the parameter vector as beams and planes."""
        at = self.unknowns.at(x)
        r, v, k = np.split(at["beam"], (3, 6), axis=1)
        return Parameters(r, v, k, at["plane"][:, :3], at["plane"][:, 3])

    def sizes(self, x: FloatArray) -> FloatArray:
        """Return the sizes (q,) of the systematic errors."""
        return x[len(x) - len(self.errors.sigma) :]

    def residuals(self, x: FloatArray) -> FloatArray:
        """Return predicted less corrected ranges of the readings used.

        In metres, or in sigmas, with rows of the priors, once there are weights.
        """
        k, size = self.unknowns.at(x)["beam"][self.beam, 6:], self.sizes(x)
        s = self._ranges(x, *self.errors.hands(size))[0]
        longer = self.per_size @ size
        level = self.level - longer
        residual = s - (self.base - longer + level * (k[:, 0] + k[:, 1] * level))
        residual = residual[self.used]
        if self.whiten is None:
            return np.asarray(residual)
        known = x[self.prior_at] / self.prior_sigma
        return np.concatenate((self.whiten @ residual, known, size / self.errors.sigma))

    def _ranges(self, x: FloatArray, R: FloatArray, t: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return ranges [m] and cosines of incidence from hand poses (M, 3, 3), (M, 3)."""
        at = self.unknowns.at(x)
        beam, plane, R = at["beam"][self.beam], at["plane"][self.plane], R[self.station]
        n = plane[:, :3]
        origin = np.matmul(R, beam[:, :3, None])[..., 0] + t[self.station]
        cosine = (n * np.matmul(R, beam[:, 3:6, None])[..., 0]).sum(axis=1)
        s: FloatArray = -((n * origin).sum(axis=1) + plane[:, 3]) / cosine
        return s, cosine

    def weigh(self, x: FloatArray, noise: ReferenceNoise) -> None:
        """Weigh the readings of each station together, at `x`."""
        beam, size = self.unknowns.at(x)["beam"][self.beam], self.sizes(x)
        k1, k2 = beam[:, 6], beam[:, 7]
        R, t = self.errors.hands(size)
        s, cosine = self._ranges(x, R, t)
        slope = 1.0 + k1 + 2.0 * k2 * self.d
        expected = self.d + (s - self.d * (1.0 + k1 + k2 * self.d)) / slope
        spot = beam[:, :3] + s[:, None] * beam[:, 3:6]
        spot = np.matmul(R[self.station], spot[:, :, None])[..., 0] + t[self.station]
        self.per_size = self.errors.longer(self.d, expected, cosine, slope, spot)
        longer = self.per_size @ size
        d = self.d - longer
        slope = (1.0 + k1 + 2.0 * k2 * d) / np.sqrt(self.samples)
        tangent = np.sqrt(np.maximum(cosine**-2 - 1.0, 0.0))
        sigma = noise.range_sigma[self.beam]
        of_reading = slope * sigma**2 / np.sqrt(self.samples)
        variance = (slope * sigma) ** 2 + (noise.incidence_sigma * tangent) ** 2
        true = d * (1.0 + k1 + k2 * d)
        residual = s - true
        level = d.copy()
        J = None
        if noise.pose is not None:
            J = by_poses(lambda R, t: self._ranges(x, R, t)[0], R, t)
        blocks, order = [], []
        for station in np.unique(self.station[self.used]):
            rows = np.flatnonzero((self.station == station) & self.used)
            C = np.diag(variance[rows])
            if J is not None and noise.pose is not None:
                C += J[rows] @ noise.pose[station] @ J[rows].T
            blocks.append(csr_array(np.linalg.inv(np.linalg.cholesky(C))))
            order.append(rows)
            noise_of = of_reading[rows] * np.linalg.solve(C, residual[rows])
            level[rows] += np.clip(noise_of, -NOISE_LIMIT * sigma[rows], NOISE_LIMIT * sigma[rows])
        self.base = true - level * (k1 + k2 * level) + longer
        self.level = level + longer
        inverse = np.argsort(np.concatenate(order))
        self.whiten = csr_array(block_diag(blocks, format="csr")[:, inverse])

    def sparsity(self) -> csr_array | None:
        """Return which unknowns each residual depends on; None where they are few."""
        if len(self.x0) <= DENSE_UNKNOWNS:
            return None
        place = self.unknowns.place
        sizes = place["size"][:, 0]
        parts = place["beam"][self.beam], place["plane"][self.plane]
        columns = np.hstack((*parts, np.tile(sizes, (len(self.d), 1))))[self.used]
        rows = np.broadcast_to(np.arange(len(columns))[:, None], columns.shape)
        depends = self._pattern(rows[columns >= 0], columns[columns >= 0], len(columns))
        if self.whiten is None:
            return depends
        known = np.concatenate((self.prior_at, sizes))
        prior = self._pattern(np.arange(len(known)), known, len(known))
        return csr_array(vstack((abs(self.whiten) @ depends, prior)))

    def _pattern(self, rows: IntArray, columns: IntArray, count: int) -> csr_array:
        return csr_array((np.ones(len(rows)), (rows, columns)), shape=(count, len(self.x0)))


def minimize(
    residuals: Callable[[FloatArray], FloatArray],
    x0: FloatArray,
    sparsity: csr_array | None = None,
    differences: Literal["2-point", "3-point"] = "3-point",
    tolerance: float = TOLERANCE,
) -> OptimizeResult:
    """Return SciPy's least-squares solution from `x0`, derivatives by differences."""
    return least_squares(
        residuals,
        x0,
        jac=differences,
        jac_sparsity=sparsity,
        method="trf",
        x_scale="jac",
        tr_options={} if sparsity is None else {"atol": INNER_TOLERANCE, "btol": INNER_TOLERANCE},
        ftol=tolerance,
        xtol=tolerance,
        gtol=tolerance,
    )


def gauss_newton_end(solution: OptimizeResult) -> tuple[FloatArray, FloatArray]:
    """Return the unknowns (n,) of SciPy's solution after a last step, and inv(J'J) (n, n).

    SciPy stops where the cost shows no change: a last Gauss-Newton step goes beyond its digits.
    """
    J = np.asarray(solution.jac @ np.eye(len(solution.x)))  # sparse or not
    scale = np.linalg.norm(J, axis=0)
    scale = np.where(scale > 0.0, scale, 1.0)
    J = J / scale
    step = np.linalg.lstsq(J, np.asarray(solution.fun), rcond=1e-12)[0] / scale
    inverse = np.linalg.pinv(J.T @ J, hermitian=True, rcond=1e-15) / np.outer(scale, scale)
    return np.asarray(solution.x - step), inverse


def solve_reference(
    recording: Recording,
    start: Parameters,
    terms: int | tuple[int, ...],
    noise: ReferenceNoise | None = None,
    prior: RangeErrorPrior | None = None,
    errors: Mapping[str, float] | None = None,
    used: BoolArray | None = None,
) -> ReferenceSolution:
    """Solve `recording` from `start` with `terms` range-error terms, and its covariances.

    Central differences cost twice as much as forward ones and agree with exact derivatives to a
    millionth of a standard deviation and better. With `noise`, covariances and squares are in its
    units, without it for a range sigma of 1 m. A `prior` of the range errors, or systematic `errors`
    that are unknowns (with the sigmas of their priors), need `noise`; see `ReferenceProblem` for
    `errors` and `used`.
    """
    problem = ReferenceProblem(recording, start, terms, prior, errors, used)
    if errors and noise is not None:
        problem.weigh(problem.x0, noise)
    solution = minimize(problem.residuals, problem.x0, problem.sparsity())
    if noise is not None:
        for _ in range(REWEIGHTINGS):
            problem.weigh(solution.x, noise)
            solution = minimize(problem.residuals, solution.x, problem.sparsity())
    best, inverse = gauss_newton_end(solution)
    covariances = problem.unknowns.covariances(solution.x, inverse)
    sigmas = np.sqrt(covariances["size"].ravel())
    return ReferenceSolution(
        problem.unpack(best),
        covariances["beam"],
        covariances["plane"],
        2.0 * float(solution.cost),
        int(solution.njev),
        str(solution.message),
        dict(zip(problem.errors.members, problem.sizes(best).tolist(), strict=True)),
        dict(zip(problem.errors.members, sigmas.tolist(), strict=True)),
    )
