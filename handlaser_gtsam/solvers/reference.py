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

from collections.abc import Mapping
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


@dataclass(frozen=True, slots=True)
class UnitVectors:
    """Unit vectors (K, 3) as two components each: which are kept, which one follows, its sign."""

    kept: IntArray
    follows: IntArray
    sign: FloatArray

    @classmethod
    def of(cls, start: FloatArray) -> "UnitVectors":
        """Return how unit vectors near `start` (K, 3) are written."""
        follows = np.abs(start).argmax(axis=1)
        kept = np.array([[i for i in range(3) if i != f] for f in follows], dtype=np.intp)
        kept = kept.reshape(-1, 2)
        return cls(kept, follows, np.sign(start[np.arange(len(start)), follows]))

    def pack(self, vectors: FloatArray) -> FloatArray:
        """Return the pairs (K, 2) of vectors (K, 3)."""
        return np.take_along_axis(vectors, self.kept, axis=1)

    def unpack(self, pairs: FloatArray) -> FloatArray:
        """Return the vectors (K, 3) of pairs (K, 2)."""
        vectors = np.zeros((len(pairs), 3))
        np.put_along_axis(vectors, self.kept, pairs, axis=1)
        third = np.sqrt(np.maximum(1.0 - (pairs**2).sum(axis=1), 0.0))
        vectors[np.arange(len(pairs)), self.follows] = self.sign * third
        return vectors

    def derivative(self, vectors: FloatArray) -> FloatArray:
        """Return d vector / d pair, (K, 3, 2)."""
        rows = np.arange(len(vectors))
        D = np.zeros((len(vectors), 3, 2))
        for column in range(2):
            D[rows, self.kept[:, column], column] = 1.0
        third = vectors[rows, self.follows]
        D[rows, self.follows] = -self.pack(vectors) / third[:, None]
        return D


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
        self.beams, self.planes = len(recording.beam_names), len(recording.plane_names)
        self.terms = (terms,) * self.beams if isinstance(terms, int) else terms
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
        self.directions = UnitVectors.of(start.directions)
        self.normals = UnitVectors.of(start.normals)
        self.active = np.array([[True] * 5 + [n > 0, n > 1] for n in self.terms])
        beam = (start.locations, self.directions.pack(start.directions), start.range_errors)
        plane_part = np.column_stack((self.normals.pack(start.normals), start.offsets))
        self.errors = ReferenceErrors(errors or {}, recording, seen)
        none = np.zeros_like(self.errors.sigma)
        self.x0 = np.concatenate((np.hstack(beam)[self.active], plane_part.ravel(), none))
        self.split = int(self.active.sum())
        self.last = self.split + 3 * self.planes
        self.per_size = np.zeros((len(self.d), len(none)))
        self.whiten: csr_array | None = None
        self.base = self.level = self.d
        # One more row for every range error of which something is known: k / its sigma.
        known = self.active[:, 5:] & (prior is not None)
        self.number = np.full((self.beams, 7), -1)
        self.number[self.active] = np.arange(self.split)
        self.prior_at = self.number[:, 5:][known]
        sigma = np.ones((self.beams, 2)) if prior is None else prior.sigma
        self.prior_sigma = sigma[known]

    def _beams(self, x: FloatArray) -> FloatArray:
        full = np.zeros((self.beams, 7))
        full[self.active] = x[: self.split]
        return full

    def _planes(self, x: FloatArray) -> FloatArray:
        return x[self.split : self.last].reshape(self.planes, 3)

    def unpack(self, x: FloatArray) -> Parameters:
        """Return the parameter vector as beams and planes."""
        beam, plane = self._beams(x), self._planes(x)
        directions = self.directions.unpack(beam[:, 3:5])
        return Parameters(
            beam[:, :3],
            directions,
            beam[:, 5:],
            self.normals.unpack(plane[:, :2]),
            plane[:, 2],
        )

    def residuals(self, x: FloatArray) -> FloatArray:
        """Return predicted less corrected ranges of the readings used.

        In metres, or in sigmas, with rows of the priors, once there are weights.
        """
        beam = self._beams(x)[self.beam]
        s = self._ranges(x, *self._poses(x))[0]
        longer = self.per_size @ x[self.last :]
        level = self.level - longer
        residual = s - (self.base - longer + level * (beam[:, 5] + beam[:, 6] * level))
        residual = residual[self.used]
        if self.whiten is None:
            return np.asarray(residual)
        of_errors = x[self.last :] / self.errors.sigma
        known = x[self.prior_at] / self.prior_sigma
        return np.concatenate((self.whiten @ residual, known, of_errors))

    def _poses(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the true hand poses of all readings, at the sizes of errors that move the hand."""
        R, t = self.errors.hands(x[self.last :])
        return R[self.station], t[self.station]

    def _ranges(self, x: FloatArray, R: FloatArray, t: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return ranges [m] and cosines of incidence from given hand poses."""
        beam, plane = self._beams(x), self._planes(x)
        n = self.normals.unpack(plane[:, :2])[self.plane]
        v = self.directions.unpack(beam[:, 3:5])[self.beam]
        origin = np.matmul(R, beam[self.beam, :3, None])[..., 0] + t
        cosine = (n * np.matmul(R, v[:, :, None])[..., 0]).sum(axis=1)
        s: FloatArray = -((n * origin).sum(axis=1) + plane[self.plane, 2]) / cosine
        return s, cosine

    def weigh(self, x: FloatArray, noise: ReferenceNoise) -> None:
        """Weigh the readings of each station together, at `x`."""
        beam = self._beams(x)[self.beam]
        R, t = self._poses(x)
        s, cosine = self._ranges(x, R, t)
        slope = 1.0 + beam[:, 5] + 2.0 * beam[:, 6] * self.d
        expected = self.d + (s - self.d * (1.0 + beam[:, 5] + beam[:, 6] * self.d)) / slope
        v = self.directions.unpack(self._beams(x)[:, 3:5])[self.beam]
        spot = np.matmul(R, (beam[:, :3] + s[:, None] * v)[:, :, None])[..., 0] + t
        self.per_size = self.errors.longer(self.d, expected, cosine, slope, spot)
        longer = self.per_size @ x[self.last :]
        d = self.d - longer
        slope = (1.0 + beam[:, 5] + 2.0 * beam[:, 6] * d) / np.sqrt(self.samples)
        tangent = np.sqrt(np.maximum(cosine**-2 - 1.0, 0.0))
        of_reading = slope * noise.range_sigma[self.beam] ** 2 / np.sqrt(self.samples)
        variance = (slope * noise.range_sigma[self.beam]) ** 2
        variance += (noise.incidence_sigma * tangent) ** 2
        true = d * (1.0 + beam[:, 5] + beam[:, 6] * d)
        residual = s - true
        level = d.copy()
        J = np.zeros((len(self.d), 6))
        for axis in range(6 if noise.pose is not None else 0):
            step = np.eye(6)[axis] * POSE_STEP
            sides = []
            for sign in (1.0, -1.0):
                turn = Rotation.from_rotvec(sign * step[:3]).as_matrix()
                moved = t + sign * np.matmul(R, step[3:])
                sides.append(self._ranges(x, R @ turn, moved)[0])
            J[:, axis] = (sides[0] - sides[1]) / (2.0 * POSE_STEP)
        blocks, order = [], []
        for station in np.unique(self.station[self.used]):
            rows = np.flatnonzero((self.station == station) & self.used)
            C = np.diag(variance[rows])
            if noise.pose is not None:
                C += J[rows] @ noise.pose[station] @ J[rows].T
            blocks.append(csr_array(np.linalg.inv(np.linalg.cholesky(C))))
            order.append(rows)
            noise_of = of_reading[rows] * np.linalg.solve(C, residual[rows])
            most = NOISE_LIMIT * noise.range_sigma[self.beam[rows]]
            level[rows] += np.clip(noise_of, -most, most)
        self.base = true - level * (beam[:, 5] + beam[:, 6] * level) + longer
        self.level = level + longer
        inverse = np.argsort(np.concatenate(order))
        self.whiten = csr_array(block_diag(blocks, format="csr")[:, inverse])

    def sparsity(self) -> csr_array:
        """Return which unknowns each residual depends on."""
        of_plane = self.split + self.plane[:, None] * 3 + np.arange(3)
        errors = self.last + np.arange(len(self.errors.sigma))
        columns = np.hstack((self.number[self.beam], of_plane, np.tile(errors, (len(self.d), 1))))
        columns = columns[self.used]
        rows = np.repeat(np.arange(len(columns)), columns.shape[1])
        seen = columns.ravel() >= 0
        shape = (len(columns), len(self.x0))
        depends = csr_array((np.ones(seen.sum()), (rows[seen], columns.ravel()[seen])), shape=shape)
        if self.whiten is None:
            return depends
        known = np.concatenate((self.prior_at, errors))
        more = np.arange(len(known))
        prior = csr_array((np.ones(len(more)), (more, known)), shape=(len(more), len(self.x0)))
        return csr_array(vstack((abs(self.whiten) @ depends, prior)))

    def covariances(
        self, x: FloatArray, inverse: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return ambient covariances of beams (B, 8, 8) and planes (P, 4, 4), and of errors (q, q).

        At the unknowns x with their covariance `inverse`: for a sigma of 1 m, or of the weights where
        there are any.
        """
        optimum = self.unpack(x)
        beams, planes = np.zeros((self.beams, 8, 8)), np.zeros((self.planes, 4, 4))
        Dv = self.directions.derivative(optimum.directions)
        Dn = self.normals.derivative(optimum.normals)
        first = np.cumsum([0, *self.active.sum(axis=1)])
        for i in range(self.beams):
            lift = np.zeros((8, 7))
            lift[:3, :3], lift[3:6, 3:5], lift[6:, 5:] = np.eye(3), Dv[i], np.eye(2)
            lift = lift[:, self.active[i]]
            block = slice(first[i], first[i + 1])
            beams[i] = lift @ inverse[block, block] @ lift.T
        for p in range(self.planes):
            lift = np.zeros((4, 3))
            lift[:3, :2], lift[3, 2] = Dn[p], 1.0
            block = slice(self.split + 3 * p, self.split + 3 * p + 3)
            planes[p] = lift @ inverse[block, block] @ lift.T
        return beams, planes, inverse[self.last :, self.last :]


def minimize(
    problem: ReferenceProblem, differences: Literal["2-point", "3-point"]
) -> OptimizeResult:
    """Return SciPy's least-squares solution of `problem`, derivatives by differences."""
    large = len(problem.x0) > DENSE_UNKNOWNS
    return least_squares(
        problem.residuals,
        problem.x0,
        jac=differences,
        jac_sparsity=problem.sparsity() if large else None,
        method="trf",
        x_scale="jac",
        tr_options={"atol": INNER_TOLERANCE, "btol": INNER_TOLERANCE} if large else {},
        ftol=TOLERANCE,
        xtol=TOLERANCE,
        gtol=TOLERANCE,
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
    solution = minimize(problem, "3-point")
    if noise is not None:
        for _ in range(REWEIGHTINGS):
            problem.weigh(solution.x, noise)
            problem.x0 = solution.x
            solution = minimize(problem, "3-point")
    best, inverse = gauss_newton_end(solution)
    beams, planes, of_errors = problem.covariances(solution.x, inverse)
    sigmas = np.sqrt(np.diagonal(of_errors))
    return ReferenceSolution(
        problem.unpack(best),
        beams,
        planes,
        2.0 * float(solution.cost),
        int(solution.njev),
        str(solution.message),
        dict(zip(problem.errors.members, best[problem.last :].tolist(), strict=True)),
        dict(zip(problem.errors.members, sigmas.tolist(), strict=True)),
    )
