r"""Least squares of any readings, relations and priors with SciPy.

Derivatives are SciPy's differences. Covariances follow from Gauss-Markov, inv(J'J) of residuals in
standard deviations. Errors of the hand are found by moving the poses: for the derivatives A of a
station's residuals by them, in standard deviations, the weight is the inverse root of I + A A', by its
singular values. What residuals on spheres are beyond the first order is taken at the most probable
errors, and adds what it may be from there on to the noise of a shot. Weights, this, the noise of the
readings that the residuals show, and what a systematic error of size 1 does, are held while SciPy runs
and then updated at its solution.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import combinations
from typing import Literal

import numpy as np
from scipy.optimize import OptimizeResult, least_squares
from scipy.sparse import csr_array, vstack
from scipy.spatial.transform import Rotation

from ...arrays import FloatArray, IntArray
from ...data.survey import Known
from .errors import SystematicErrors
from .readings import DIFFERENCE, Observed
from .unknowns import At, ReferenceUnknowns, relation_residuals

ERRORS_BEFORE = (0.05, 0.02, 0.1, 0.05)
"""Standard deviations of `RAY_ERRORS` before any reading; stated again, for nothing is shared."""
DENSE_UNKNOWNS = 200
"""Above this many unknowns the Jacobian is kept sparse."""
TOLERANCE = 1e-11
"""SciPy's; a Gauss-Newton step at the end takes its solution beyond."""
FROM_BESIDE = 100
"""Evaluations after which SciPy begins again at the start, where it does not arrive from beside it: it
takes about ten, unless rays miss their sphere there."""
STEPS_TO_HAND = 8
"""Of Gauss and Newton, to the most probable error of the hand at a station."""


@dataclass(frozen=True, slots=True, eq=False)
class ReferenceProblem:
    """What is solved.

    Attributes
    ----------
    observed : sequence of Observed
    hands : (M, 3, 3), (M, 3)
        Recorded hand poses.
    start, sigma : mapping of str to (n, ...)
        As of `ReferenceUnknowns`, by kinds of variables.
    pose : (M, 6, 6), optional
        Covariance of the hand poses (rx, ry, rz, x, y, z), hand frame; None for exact ones.
    aiming_sigma : float
        Of spots across their rays, about points [m].
    known : sequence of (Known, variables)
        Relations with the kind and number of each variable that they are of, and of a body first.
    errors : SystematicErrors, optional
        Whose sizes are unknowns.
    beside : float
        All unknowns begin so far [m], [rad] from the start, to either side.
    stops : (M,), optional
        The first station with the error of each pose, where several have one.
    own : (M, 6, 6), optional
        Covariance that the error of such a pose has beside by itself.
    """

    observed: Sequence[Observed]
    hands: tuple[FloatArray, FloatArray]
    start: Mapping[str, FloatArray]
    sigma: Mapping[str, FloatArray]
    pose: FloatArray | None = None
    aiming_sigma: float = 1.0
    known: Sequence[tuple[Known, Sequence[tuple[str, int]]]] = ()
    errors: SystematicErrors | None = None
    beside: float = 0.0
    stops: IntArray | None = None
    own: FloatArray | None = None


@dataclass(frozen=True, slots=True, eq=False)
class ReferenceSolution:
    """What SciPy found.

    Attributes
    ----------
    values : mapping of (kind, number) to (n,)
        Of each variable: of a sensor or body its turn [rad] and shift [m] from the start in its own
        frame, and the range errors that are unknown; of others as in `ReferenceProblem.start`.
    covariances : mapping of (kind, number) to (n, n)
        Over the same numbers.
    squares : float
        Sum of the squared residuals.
    iterations : int
        Jacobian evaluations.
    """

    values: Mapping[tuple[str, int], FloatArray]
    covariances: Mapping[tuple[str, int], FloatArray]
    squares: float
    iterations: int


class Residuals:
    """Residuals of a problem in standard deviations, relations and priors last.

    Parameters
    ----------
    problem : ReferenceProblem

    Attributes
    ----------
    unknowns : ReferenceUnknowns
    """

    def __init__(self, problem: ReferenceProblem) -> None:
        self.problem = problem
        self.unknowns = ReferenceUnknowns(problem.start, problem.sigma)
        self._station = np.concatenate(
            [np.tile(one.station[one.solved], one.rows) for one in problem.observed]
        )
        self._pose = self._station
        if problem.stops is not None:
            self._station = problem.stops[self._pose]
        kinds = [np.full(one.rows * len(one.solved), one.target_kind) for one in problem.observed]
        self._on_sphere = np.concatenate(kinds) == "sphere"
        self._curved = np.zeros(len(self._station))
        self._shot = self._shots()
        self._weights: list[tuple[IntArray, FloatArray, FloatArray]] = []
        self._known = np.flatnonzero(np.isfinite(self.unknowns.sigma))
        self.weigh(self.unknowns.x0)

    @property
    def vary(self) -> bool:
        """Whether weights, or what they are held with, depend on the unknowns."""
        problem = self.problem
        range_errors = (self.unknowns.place["sensor"][:, 6:] >= 0).any()
        noise = (one.of_reading or one.sigma_across for one in problem.observed)
        return problem.pose is not None or bool(range_errors) or any(noise)

    def __call__(self, x: FloatArray) -> FloatArray:
        """Return all residuals at a vector of unknowns."""
        at = self.unknowns.at(x)
        e = self._whitened(self._curved + self._readings(at, *self._hands(at)))
        relations = [relation_residuals(*one, at) for one in self.problem.known]
        return np.concatenate((e, *relations, (x / self.unknowns.sigma)[self._known]))

    def weigh(self, x: FloatArray) -> None:
        """Update the weights at a vector of unknowns."""
        problem, at = self.problem, self.unknowns.at(x)
        R, t = self._hands(at)
        self._counted = [one.counted(at, R, t, problem.errors) for one in problem.observed]
        if problem.pose is not None:
            A = by_poses(partial(self._readings, at), R, t)
            rest = np.empty((len(A), 0))
            if self._on_sphere.any():
                self._curved, rest = self._beyond_first_order(at, R, t, A)
            order = np.argsort(self._station, kind="stable")
            stations, first = np.unique(self._station[order], return_index=True)
            self._weights = []
            for station, rows in zip(stations, np.split(order, first[1:]), strict=True):
                parts, pose = [A[rows] @ _root(problem.pose[station])], self._pose[rows]
                if problem.own is not None:
                    for one in np.unique(pose):
                        parts.append(A[rows] @ _root(problem.own[one]) * (pose == one)[:, None])
                for shot in np.unique(self._shot[rows]):
                    parts.append(rest[rows] * (self._shot[rows] == shot)[:, None])
                U, size, _ = np.linalg.svd(np.hstack(parts), full_matrices=False)
                self._weights.append((rows, U, 1.0 - 1.0 / np.sqrt(1.0 + size**2)))
        heavy = self._whitened(self._whitened(self._curved + self._readings(at, R, t)))
        end = 0
        for i, one in enumerate(problem.observed):
            begin, end = end, end + one.rows * len(one.solved)
            if one.of_reading:
                self._counted[i] = one.freed_of_noise(at, self._counted[i], heavy[begin:end])

    def sparsity(self) -> csr_array | None:
        """Return which unknowns each residual depends on; None where they are few."""
        count = len(self.unknowns.x0)
        if count <= DENSE_UNKNOWNS:
            return None
        place = self.unknowns.place
        sizes, depends = place["size"][:, 0], []
        for one in self.problem.observed:
            of_sensor = place[one.sensor_kind][one.sensor[one.solved]]
            of_target = place[one.target_kind][one.target[one.solved]]
            each = np.tile(np.hstack((of_sensor, of_target)), (one.rows, 1))
            depends += [np.concatenate((columns, sizes)) for columns in each]
        readings = _pattern(depends, count)
        if self._weights:  # all residuals of a station are mixed
            stations = _pattern(self._station[:, None], int(self._station.max()) + 1)
            readings = stations @ (stations.T @ readings)
        x0 = self.unknowns.at(self.unknowns.x0)
        others = []
        for known, variables in self.problem.known:
            columns = np.concatenate([place[kind][number] for kind, number in variables])
            others += [columns] * len(relation_residuals(known, variables, x0))
        others += list(self._known[:, None])
        return csr_array(vstack((readings, _pattern(others, count))))

    def _hands(self, at: At) -> tuple[FloatArray, FloatArray]:
        """Return the hand poses that systematic errors leave."""
        errors = self.problem.errors
        return self.problem.hands if errors is None else errors.hands(at.numbers["size"].ravel())

    def _readings(self, at: At, R: FloatArray, t: FloatArray) -> FloatArray:
        """Return the residuals of all readings, each in its own standard deviations."""
        pairs = zip(self.problem.observed, self._counted, strict=True)
        aiming = self.problem.aiming_sigma
        return np.concatenate([one.residuals(at, R, t, how, aiming) for one, how in pairs])

    def _shots(self) -> IntArray:
        """Return numbers (N,) of what errors of the second order are common to."""
        parts, count = [], 0
        for one in self.problem.observed:
            rows = one.solved
            keys = np.stack((one.station, one.target, one.sensor))[:, rows]
            _, shot = np.unique(keys, axis=1, return_inverse=True)
            shot = shot.reshape(-1)  # numpy 2.0 keeps the axes
            if one.single is not None:
                by_itself = len(rows) + np.arange(len(rows))
                shot = np.where(one.single[rows], by_itself, shot)
            parts.append(np.tile(count + shot, one.rows))
            count += 2 * len(rows)
        return np.concatenate(parts)

    def _beyond_first_order(
        self, at: At, R: FloatArray, t: FloatArray, A: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return by how much residuals (N,) on spheres are not linear in the error of the hand.

        It is taken at the most probable errors of the hand poses (M, 3, 3), (M, 3), unknowns as they
        are; A (N, 6) are the derivatives of the residuals at the recorded poses. The mean of what is
        curved from there on is added, and a root (N, 27) of its covariance returned.
        """
        problem, begun, curved = self.problem, self._readings(at, R, t), self._on_sphere
        assert problem.pose is not None
        stops = np.arange(len(R)) if problem.stops is None else problem.stops
        x, root = np.zeros((len(R), 6)), np.stack([_root(C) for C in problem.pose])
        C = np.zeros_like(root)

        def moved(x: FloatArray) -> tuple[FloatArray, FloatArray]:
            turned = R @ Rotation.from_rotvec(x[stops, :3]).as_matrix()
            return turned, t + np.einsum("mij,mj->mi", R, x[stops, 3:])

        def beyond(x: FloatArray) -> FloatArray:
            linear = np.einsum("ni,ni->n", A, x[self._station])
            return np.where(curved, self._readings(at, *moved(x)) - begun - linear, 0.0)

        for _ in range(STEPS_TO_HAND):
            by_pose = A.copy()
            by_pose[curved] = by_poses(partial(self._readings, at), *moved(x))[curved]
            left = begun + beyond(x) + np.einsum("ni,ni->n", A - by_pose, x[self._station])
            for station in np.unique(self._station[curved]):
                rows, L = self._station == station, root[station]
                whole = np.vstack((by_pose[rows] @ L, np.eye(6)))
                z = np.linalg.lstsq(whole, -np.append(left[rows], np.zeros(6)), rcond=None)[0]
                x[station], C[station] = L @ z, L @ _root(np.linalg.inv(whole.T @ whole))
        middle, columns = beyond(x), []
        steps = [C[..., k] for k in range(6)]
        ahead, behind = ([beyond(x + sign * step) for step in steps] for sign in (1.0, -1.0))
        second = [a + b - 2.0 * middle for a, b in zip(ahead, behind, strict=True)]
        columns += [0.5 * (a - b) for a, b in zip(ahead, behind, strict=True)]
        columns += [one / np.sqrt(2.0) for one in second]
        for one, other in combinations(steps, 2):
            with_, against = one + other, one - other
            pairs = (
                beyond(x + with_) + beyond(x - with_) - beyond(x + against) - beyond(x - against)
            )
            columns.append(0.25 * pairs)
        return middle + 0.5 * np.sum(second, axis=0), np.stack(columns, axis=1)

    def _whitened(self, e: FloatArray) -> FloatArray:
        for rows, U, shrink in self._weights:
            e[rows] -= U @ (shrink * (U.T @ e[rows]))
        return e


def _root(covariance: FloatArray) -> FloatArray:
    variances, axes = np.linalg.eigh(covariance)
    return np.asarray(axes * np.sqrt(np.maximum(variances, 0.0)))


def _pattern(columns: Sequence[IntArray] | IntArray, count: int) -> csr_array:
    """Return a sparse matrix with ones in some columns of each row; columns below zero are none."""
    rows = np.repeat(np.arange(len(columns)), [len(some) for some in columns])
    column = np.concatenate([np.zeros(0, int), *columns])
    ones = np.ones(int((column >= 0).sum()))
    return csr_array((ones, (rows[column >= 0], column[column >= 0])), (len(columns), count))


def by_poses(
    residuals: Callable[[FloatArray, FloatArray], FloatArray], R: FloatArray, t: FloatArray
) -> FloatArray:
    """Return derivatives (N, 6) of residuals (N,) by hand poses (M, 3, 3), (M, 3), in their frames."""
    columns = []
    for step in DIFFERENCE * np.eye(6):
        turn = Rotation.from_rotvec(step[:3]).as_matrix()
        ahead = residuals(R @ turn, t + R @ step[3:])
        columns.append((ahead - residuals(R @ turn.T, t - R @ step[3:])) / (2.0 * DIFFERENCE))
    return np.stack(columns, axis=1)


def minimize(
    residuals: Residuals,
    x0: FloatArray,
    differences: Literal["2-point", "3-point"] = "3-point",
    most: int | None = None,
) -> OptimizeResult:
    """Return SciPy's least-squares solution from `x0`, or where it is after `most` evaluations.

    Derivatives are differences: central ones cost twice as much as forward ones and agree with exact
    derivatives to a millionth of a standard deviation and better.
    """
    sparsity = residuals.sparsity()
    return least_squares(
        residuals,
        x0,
        jac=differences,
        jac_sparsity=sparsity,
        method="trf",
        x_scale="jac",
        # Its own tolerance of the iterative solution of a sparse step stalls far from the optimum.
        tr_options={} if sparsity is None else {"atol": TOLERANCE, "btol": TOLERANCE},
        ftol=TOLERANCE,
        xtol=TOLERANCE,
        gtol=TOLERANCE,
        max_nfev=most,
    )


def solve(problem: ReferenceProblem) -> ReferenceSolution:
    """Solve a problem, from its start or beside it."""
    residuals = Residuals(problem)
    first = residuals.unknowns.x0
    beside = first + problem.beside * (-1.0) ** np.arange(len(first))
    found = minimize(residuals, beside, most=FROM_BESIDE)
    # Where rays miss a sphere, say, it is caught.
    if found.status == 0 or 2.0 * found.cost > (residuals(first) ** 2).sum():
        found = minimize(residuals, first)
    iterations = int(found.njev)
    # Each update of the weights leaves about a thousandth of the error that the one before left.
    for _ in range(4 if residuals.vary else 0):
        residuals.weigh(np.asarray(found.x))
        found = minimize(residuals, np.asarray(found.x))
        iterations += int(found.njev)
    # SciPy stops where the cost shows no change: a last Gauss-Newton step goes beyond its digits.
    J = np.asarray(found.jac @ np.eye(len(first)))  # sparse or not
    scale = np.linalg.norm(J, axis=0)
    scale = np.where(scale > 0.0, scale, 1.0)
    J = J / scale
    step = np.linalg.lstsq(J, np.asarray(found.fun), rcond=1e-12)[0] / scale
    inverse = np.linalg.pinv(J.T @ J, hermitian=True, rcond=1e-15) / np.outer(scale, scale)
    values, covariances = residuals.unknowns.by_variable(np.asarray(found.x - step), inverse)
    return ReferenceSolution(values, covariances, 2.0 * float(found.cost), iterations)
