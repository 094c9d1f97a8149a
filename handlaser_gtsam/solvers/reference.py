r"""An independent solution with SciPy, so that the factor graph can be contradicted.

It shares neither residual nor parametrisation with the rest of the package. In the world frame the
beam starts at o = R r + t and runs along w = R v; the range to the plane is

    s = -(n . o + b) / (n . w)

and, as in Wei and Hirzinger, a unit vector is two of its components: the one of largest magnitude at
the start is replaced by +-sqrt(1 - the squares of the others). Derivatives are SciPy's differences.
Covariances follow from Gauss-Markov, sigma^2 inv(J'J).
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.optimize import OptimizeResult, least_squares
from scipy.sparse import csr_array

from ..arrays import FloatArray, IntArray
from ..parameters import Parameters
from ..recording import Recording

DENSE_UNKNOWNS = 200
"""Above this many unknowns the Jacobian is kept sparse."""
TOLERANCE = 1e-15
INNER_TOLERANCE = 1e-10
"""Of the iterative solution of a sparse step; SciPy's own default stalls far from the optimum."""

Differences = Literal["2-point", "3-point"]


@dataclass(frozen=True, slots=True)
class ReferenceSolution:
    """What SciPy found.

    Attributes
    ----------
    parameters : Parameters
    beam_covariances : (B, 8, 8)
        Over (x, y, z, vx, vy, vz, k1, k2), for a range sigma of 1 m.
    plane_covariances : (P, 4, 4)
        Over (nx, ny, nz, b), for a range sigma of 1 m.
    squares : float
        Sum of squared residuals [m^2].
    iterations : int
        Jacobian evaluations.
    message : str
        SciPy's.
    """

    parameters: Parameters
    beam_covariances: FloatArray
    plane_covariances: FloatArray
    squares: float
    iterations: int
    message: str


@dataclass(frozen=True, slots=True)
class _UnitVectors:
    """Unit vectors (K, 3) as two components each: which are kept, which one follows, its sign."""

    kept: IntArray
    follows: IntArray
    sign: FloatArray

    @classmethod
    def of(cls, start: FloatArray) -> "_UnitVectors":
        follows = np.abs(start).argmax(axis=1)
        kept = np.array([[i for i in range(3) if i != f] for f in follows], dtype=np.intp)
        return cls(kept, follows, np.sign(start[np.arange(len(start)), follows]))

    def pack(self, vectors: FloatArray) -> FloatArray:
        return np.take_along_axis(vectors, self.kept, axis=1)

    def unpack(self, pairs: FloatArray) -> FloatArray:
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


class ReferenceProblem:
    """Residuals of a recording over the paper's parameters.

    Parameters
    ----------
    recording : Recording
    start : Parameters
        Also chooses which component of each unit vector follows from the others.
    terms : int
        Range-error terms of every beam.
    """

    def __init__(self, recording: Recording, start: Parameters, terms: int) -> None:
        self.terms = terms
        self.station, self.beam = np.nonzero(~np.isnan(recording.ranges))
        self.plane = recording.plane_of_station[self.station]
        self.d = recording.ranges[self.station, self.beam]
        self.R = recording.world_R_hand[self.station]
        self.t = recording.world_t_hand[self.station]
        self.beams, self.planes = len(recording.beam_names), len(recording.plane_names)
        self.directions = _UnitVectors.of(start.directions)
        self.normals = _UnitVectors.of(start.normals)
        beams = (start.locations, self.directions.pack(start.directions))
        beam_part = np.hstack((*beams, start.range_errors[:, :terms]))
        plane_part = np.column_stack((self.normals.pack(start.normals), start.offsets))
        self.x0 = np.concatenate((beam_part.ravel(), plane_part.ravel()))

    def unpack(self, x: FloatArray) -> Parameters:
        """Return the parameter vector as beams and planes."""
        split = self.beams * (5 + self.terms)
        beam, plane = x[:split].reshape(self.beams, -1), x[split:].reshape(self.planes, 3)
        k = np.zeros((self.beams, 2))
        k[:, : self.terms] = beam[:, 5:]
        directions = self.directions.unpack(beam[:, 3:5])
        return Parameters(
            beam[:, :3], directions, k, self.normals.unpack(plane[:, :2]), plane[:, 2]
        )

    def residuals(self, x: FloatArray) -> FloatArray:
        """Return predicted less corrected ranges [m] (N,)."""
        split = self.beams * (5 + self.terms)
        beam = x[:split].reshape(self.beams, -1)
        plane = x[split:].reshape(self.planes, 3)[self.plane]
        n = self.normals.unpack(x[split:].reshape(self.planes, 3)[:, :2])[self.plane]
        v = self.directions.unpack(beam[:, 3:5])[self.beam]
        row = beam[self.beam]
        origin = np.matmul(self.R, row[:, :3, None])[..., 0] + self.t
        along = np.matmul(self.R, v[:, :, None])[..., 0]
        s = -((n * origin).sum(axis=1) + plane[:, 2]) / (n * along).sum(axis=1)
        true = self.d.copy()
        for power in range(self.terms):
            true += row[:, 5 + power] * self.d ** (power + 1)
        residual: FloatArray = s - true
        return residual

    def sparsity(self) -> csr_array:
        """Return which unknowns each residual depends on."""
        width = 5 + self.terms
        first_plane = self.beams * width
        columns = np.hstack(
            (
                self.beam[:, None] * width + np.arange(width),
                first_plane + self.plane[:, None] * 3 + np.arange(3),
            )
        )
        rows = np.repeat(np.arange(len(self.d)), columns.shape[1])
        shape = (len(self.d), len(self.x0))
        return csr_array((np.ones(rows.size), (rows, columns.ravel())), shape=shape)

    def covariances(self, solution: OptimizeResult) -> tuple[FloatArray, FloatArray]:
        """Return ambient covariances of beams (B, 8, 8) and planes (P, 4, 4) for sigma = 1 m."""
        J = np.asarray(solution.jac @ np.eye(len(solution.x)))  # sparse or not
        scale = np.linalg.norm(J, axis=0)
        inverse = np.linalg.pinv((J / scale).T @ (J / scale), hermitian=True, rcond=1e-15)
        inverse /= np.outer(scale, scale)
        found, width = self.unpack(solution.x), 5 + self.terms
        beams, planes = np.zeros((self.beams, 8, 8)), np.zeros((self.planes, 4, 4))
        Dv, Dn = (
            self.directions.derivative(found.directions),
            self.normals.derivative(found.normals),
        )
        for i in range(self.beams):
            lift = np.zeros((8, width))
            lift[:3, :3], lift[3:6, 3:5] = np.eye(3), Dv[i]
            lift[6 : 6 + self.terms, 5:] = np.eye(self.terms)
            own = slice(i * width, (i + 1) * width)
            beams[i] = lift @ inverse[own, own] @ lift.T
        for p in range(self.planes):
            lift = np.zeros((4, 3))
            lift[:3, :2], lift[3, 2] = Dn[p], 1.0
            own = slice(self.beams * width + 3 * p, self.beams * width + 3 * p + 3)
            planes[p] = lift @ inverse[own, own] @ lift.T
        return beams, planes


def minimize(problem: ReferenceProblem, differences: Differences = "2-point") -> OptimizeResult:
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


def solve_reference(
    recording: Recording, start: Parameters, terms: int, differences: Differences = "3-point"
) -> ReferenceSolution:
    """Solve `recording` from `start` with `terms` range-error terms, and its covariances.

    Central differences cost twice as much as forward ones and agree with exact derivatives to a
    millionth of a standard deviation and better.
    """
    problem = ReferenceProblem(recording, start, terms)
    solution = minimize(problem, differences)
    beams, planes = problem.covariances(solution)
    return ReferenceSolution(
        problem.unpack(solution.x),
        beams,
        planes,
        2.0 * float(solution.cost),
        int(solution.njev),
        str(solution.message),
    )
