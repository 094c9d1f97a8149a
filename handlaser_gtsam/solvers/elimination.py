"""What readings say of the beams once planes are eliminated; linear algebra, whatever the model."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve
from scipy.linalg.lapack import dposv, dpotri
from scipy.sparse.linalg import LinearOperator, eigsh

from ..arrays import FloatArray

LARGE = 400
"""Unknowns of the beams beyond which not all eigenvalues are computed where nothing is undetermined."""
NEARLY = 1e-2
"""The relative accuracy of the extreme eigenvalues of so many unknowns."""
FEW = (1, 16)
"""How many of these are sought from below, until one is large enough."""
RANK = 1e-12
"""Information of a plane below this part of its largest is rounding."""
NOTHING = 1e-280
"""Information of an unknown below this is none, as where no reading of a plane counts."""
NEARLY_TOLD = 1e6
"""Where the others leave less than one such part of an unknown, a plain inverse loses many digits."""
CERTAIN = 1e3
"""Where all pivots exceed what is needed so many times, all eigenvalues do exceed it."""


@dataclass(frozen=True, slots=True)
class ReducedInformation:
    """What readings say of the beams once planes are eliminated; leading axes are copies.

    Attributes
    ----------
    matrix : (..., n, n)
        Information of the beams, S.
    gradient : (..., n)
        Of half the sum of squares at the linearisation: the step of the beams is -inv(S) gradient.
    plane_values : (..., P, 3)
        Information of the planes along their own axes, ascending.
    plane_axes : (..., P, 3, 3)
        These axes, as columns.
    plane_inverse : (..., P, 3, 3)
        Covariances of the planes for known beams; zero along what the readings do not determine.
    plane_response : (..., P, 3, n)
        A step x of the beams moves a plane by -plane_response x.
    plane_step : (..., P, 3)
        Steps of the planes for beams that stay.
    plane_saved : (...)
        By how much these lower the sum of squares.
    """

    matrix: FloatArray
    gradient: FloatArray
    plane_values: FloatArray
    plane_axes: FloatArray
    plane_inverse: FloatArray
    plane_response: FloatArray
    plane_step: FloatArray
    plane_saved: FloatArray

    def covariance(self, floor: float, least: float = 0.0) -> FloatArray:
        """Return the inverse (n, n) of the only copy, along axes of at least `floor` information.

        All have that where the least eigenvalue is known to.
        """
        try:
            root = np.linalg.cholesky(self.matrix)
            if least >= floor or np.diagonal(root).min() ** 2 > CERTAIN * floor:
                return _inverse_of_root(root)
        except np.linalg.LinAlgError:
            pass
        values, axes = np.linalg.eigh(self.matrix)
        known = values >= floor
        found: FloatArray = (axes[:, known] / values[known]) @ axes[:, known].T
        return found

    def step(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the steps of beams (..., n) and planes (..., P, 3), and the decrement -g' delta.

        The decrement is what the step saves of the sum of squares.
        """
        unit = 1.0 / np.sqrt(np.maximum(np.einsum("...ii->...i", self.matrix), 1e-300))
        scaled = self.matrix * unit[..., :, None] * unit[..., None, :]
        beam = -unit * solve_stack(scaled, (self.gradient * unit)[..., None])[..., 0]
        plane = self.plane_step - np.einsum("...pij,...j->...pi", self.plane_response, beam)
        return beam, plane, self.plane_saved - (self.gradient * beam).sum(axis=-1)


def eliminated(
    beam: FloatArray,
    border: FloatArray,
    plane: FloatArray,
    beam_gradient: FloatArray,
    plane_gradient: FloatArray,
    floor: float | None = None,
) -> ReducedInformation:
    """Eliminate planes; blocks as those of `NormalEquations`, with any leading axes.

    Information of a plane below `floor` is none; below `RANK` of its largest where that is not given.
    """
    values, axes = np.linalg.eigh(plane)
    least = RANK * np.maximum(values[..., -1:], 0.0) if floor is None else floor
    known = (values >= least) & (values > 0.0)
    weight = np.where(known, 1.0 / np.where(known, values, 1.0), 0.0)
    inverse = (axes * weight[..., None, :]) @ np.swapaxes(axes, -1, -2)
    response = inverse @ np.swapaxes(border, -1, -2)
    step = -np.einsum("...pij,...pj->...pi", inverse, plane_gradient)
    flat = np.swapaxes(border, -3, -2).reshape(*beam.shape[:-1], -1)
    matrix = beam - flat @ response.reshape(*beam.shape[:-2], -1, beam.shape[-1])
    return ReducedInformation(
        0.5 * (matrix + np.swapaxes(matrix, -1, -2)),
        beam_gradient + np.einsum("...pnj,...pj->...n", border, step),
        values,
        axes,
        inverse,
        response,
        step,
        -(plane_gradient * step).sum(axis=(-2, -1)),
    )


def inverse_of(matrix: FloatArray) -> FloatArray:
    """Return the inverse of a positive definite matrix (n, n), whatever the units of its rows."""
    return inverse_and_log_det(matrix)[0]


def inverse_and_log_det(matrix: FloatArray) -> tuple[FloatArray, float]:
    """Return the inverse of a positive definite matrix, and the logarithm of its determinant.

    Raises
    ------
    numpy.linalg.LinAlgError
        It is not positive definite.
    """
    scale = np.sqrt(np.diagonal(matrix))
    if not (np.isfinite(scale).all() and scale.all()):
        raise np.linalg.LinAlgError("the information is singular")
    root = np.linalg.cholesky(matrix / scale[:, None] / scale)
    log_det = 2.0 * float(np.log(np.diagonal(root) * scale).sum())
    inverse = _inverse_of_root(root)
    inverse /= scale[:, None] * scale
    return inverse, log_det


def _inverse_of_root(root: NDArray[np.floating]) -> FloatArray:
    """Return the inverse (n, n) of root root', for a lower root; its transpose is LAPACK's order."""
    inverse, failed = dpotri(root.T, lower=0)
    if failed:
        raise np.linalg.LinAlgError("the information is singular")
    whole: FloatArray = inverse + inverse.T  # the other triangle is zero, as in the root
    whole[np.diag_indices(len(whole))] = np.diagonal(inverse)
    return whole


def solve_stack(A: FloatArray, rhs: FloatArray) -> FloatArray:
    """Return x of A x = rhs for stacks; the least-norm one where a matrix is singular."""
    try:
        solved = np.linalg.solve(A, rhs)
    except np.linalg.LinAlgError:
        solved = np.linalg.pinv(A, rcond=1e-14, hermitian=True) @ rhs
    return np.asarray(solved, dtype=np.float64)


def inverse_stack(A: FloatArray) -> FloatArray:
    """Return the inverses of symmetric matrices (..., n, n), without the axes that are rounding.

    An unknown that the others nearly tell, as where a plane has one station, makes the plain inverse
    useless. The units of the unknowns make no difference.
    """
    try:
        inverse = np.asarray(np.linalg.inv(A))
    except np.linalg.LinAlgError:
        inverse = np.full_like(A, np.nan)
    # What an unknown has of information, over what the others leave of it.
    alone = np.einsum("...ii,...ii->...i", A, inverse)
    if alone.min() > 0.0 and alone.max() < NEARLY_TOLD:
        return inverse
    poor = ~((alone > 0.0) & (alone < NEARLY_TOLD)).all(axis=-1)
    own = np.einsum("...ii->...i", A[poor])
    some = own > NOTHING
    scale = np.where(some, 1.0 / np.sqrt(np.where(some, own, 1.0)), 0.0)
    values, axes = np.linalg.eigh(A[poor] * scale[..., :, None] * scale[..., None, :])
    known = values > RANK
    weight = np.where(known, 1.0 / np.where(known, values, 1.0), 0.0)
    found = (axes * weight[..., None, :]) @ np.swapaxes(axes, -1, -2)
    inverse[poor] = found * scale[..., :, None] * scale[..., None, :]
    return inverse


def solve_definite(A: FloatArray, rhs: FloatArray) -> FloatArray:
    """Return x (K, n) of A x = rhs for symmetric A (K, n, n), by Cholesky's roots where they exist.

    The units of the unknowns make no difference.
    """
    found = np.empty_like(rhs)
    for k, (matrix, right) in enumerate(zip(A, rhs, strict=True)):
        _, found[k], failed = dposv(matrix.T, right)
        if failed:
            scale = 1.0 / np.sqrt(np.maximum(np.abs(np.diagonal(matrix)), 1e-300))
            scaled = matrix * scale[:, None] * scale
            found[k] = scale * solve_stack(scaled, (right * scale)[:, None])[:, 0]
    return found


def spectrum(matrix: FloatArray, floor: float) -> tuple[FloatArray, float, float, FloatArray]:
    """Return eigenvalues from below, the largest, their mean logarithm, and eigenvectors of the first.

    All of them, or of a large matrix those below `floor` and one beyond, if they are few.
    """
    if len(matrix) > LARGE and np.isfinite(floor):
        try:
            root = np.linalg.cholesky(matrix)
        except np.linalg.LinAlgError:
            root = None
        if root is not None:
            factor = (root.T, False)  # LAPACK's order: nothing is copied

            def inverse(x: FloatArray) -> FloatArray:
                found: FloatArray = cho_solve(factor, x, check_finite=False)
                return found

            solve = LinearOperator(matrix.shape, inverse, dtype=float)
            start = np.ones(len(matrix))
            for count in FEW:
                small, axes = eigsh(matrix, count, sigma=0.0, OPinv=solve, v0=start, tol=NEARLY)
                if small.max() >= floor:
                    top = eigsh(matrix, 1, v0=start, tol=NEARLY, return_eigenvectors=False)
                    mean_log = 2.0 * float(np.log(np.diagonal(root)).mean())
                    order = np.argsort(small)
                    return small[order], float(top[0]), mean_log, axes[:, order]
    values, axes = np.linalg.eigh(matrix)
    mean_log = float(np.log(np.maximum(values, 1e-300)).mean())
    return values, float(values[-1]), mean_log, axes
