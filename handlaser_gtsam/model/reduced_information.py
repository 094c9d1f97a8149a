"""What rows say of the unknowns that stay once local members are eliminated (`eliminated`).

Linear algebra alone, for ranks and covariances; the steps of a search eliminate in `reduction`.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve
from scipy.linalg.lapack import dposv, dpotri
from scipy.sparse.linalg import LinearOperator, eigsh

from ..arrays import FloatArray
from ..quantities import SINGULAR, TINY

LARGE_MATRIX = 400
"""With more unknowns, Cholesky factors and a few eigenvalues take less time than all eigenvalues."""
MANY_MATRICES = 64
"""From this number of 3 x 3 matrices on, cofactors take less time than LAPACK: a tenth for 1000."""
SURE_INFLATION = 1e3
"""Up to this variance inflation cofactors of 3 x 3 matrices have ten digits."""


@dataclass(frozen=True, slots=True)
class ReducedInformation:
    """What rows say of what stays once local members are eliminated; leading axes are copies.

    Attributes
    ----------
    matrix : (..., n, n)
        Information of what stays, S.
    gradient : (..., n)
        Gradient of half the sum of squares at the linearisation: the step of what stays is
        -inv(S) gradient.
    local_values : (..., m, d)
        Information of the local members along their own axes, ascending.
    local_axes : (..., m, d, d)
        These axes, as columns.
    local_inverse : (..., m, d, d)
        Covariances of the local members, were all else known; zero along what rows do not determine.
    local_response : (..., m, d, n)
        A step x of what stays moves a local member by -local_response x.
    local_step : (..., m, d)
        Steps of the local members while all else stays.
    local_saved : (...)
        By how much these lower the sum of squares.
    """

    matrix: FloatArray
    gradient: FloatArray
    local_values: FloatArray
    local_axes: FloatArray
    local_inverse: FloatArray
    local_response: FloatArray
    local_step: FloatArray
    local_saved: FloatArray

    @classmethod
    def joined(cls, parts: "Sequence[ReducedInformation]") -> "ReducedInformation":
        """Return one of several, one after the other along the leading axis."""
        if len(parts) == 1:
            return parts[0]
        names = cls.__dataclass_fields__
        return cls(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))

    def covariance(self, floor: float, least: float = 0.0) -> FloatArray:
        """Return the inverse (n, n) of the only copy, along axes of at least `floor` information.

        No axis is tested where the caller knows that the least eigenvalue is `least` >= `floor`.
        """
        try:
            root = np.linalg.cholesky(self.matrix)
            # Where all pivots exceed a bound by far, all eigenvalues exceed the bound.
            if least >= floor or np.diagonal(root).min() ** 2 > 1e3 * floor:
                return _inverse_of_root(root)
        except np.linalg.LinAlgError:
            pass
        values, axes = np.linalg.eigh(self.matrix)
        known = values >= floor
        inverse: FloatArray = (axes[:, known] / values[known]) @ axes[:, known].T
        return inverse

    def step(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the steps (..., n) and (..., m, d), and the decrement -g' delta.

        The decrement is the decrease of the sum of squares by the step.
        """
        unit = 1.0 / np.sqrt(np.maximum(np.einsum("...ii->...i", self.matrix), TINY))
        scaled = self.matrix * unit[..., :, None] * unit[..., None, :]
        beam = -unit * solve_stack(scaled, (self.gradient * unit)[..., None])[..., 0]
        plane = self.local_step - np.einsum("...pij,...j->...pi", self.local_response, beam)
        return beam, plane, self.local_saved - (self.gradient * beam).sum(axis=-1)


def eliminated(
    matrix: FloatArray,
    border: FloatArray,
    local: FloatArray,
    gradient: FloatArray,
    local_gradient: FloatArray,
    floor: float | None = None,
) -> ReducedInformation:
    """Eliminate local members from normal equations (`reduction.Normal`), with any leading axes.

    Information of a member below `floor` counts as zero; the default is `SINGULAR` times its largest.
    """
    values, axes = np.linalg.eigh(local)
    least = SINGULAR * np.maximum(values[..., -1:], 0.0) if floor is None else floor
    known = (values >= least) & (values > 0.0)
    weight = np.where(known, 1.0 / np.where(known, values, 1.0), 0.0)
    inverse = (axes * weight[..., None, :]) @ np.swapaxes(axes, -1, -2)
    response = inverse @ border
    step = -np.einsum("...mij,...mj->...mi", inverse, local_gradient)
    n = matrix.shape[-1]
    flat = border.reshape(*matrix.shape[:-2], -1, n)
    S = matrix - np.swapaxes(flat, -1, -2) @ response.reshape(flat.shape)
    return ReducedInformation(
        0.5 * (S + np.swapaxes(S, -1, -2)),
        gradient + np.einsum("...mjn,...mj->...n", border, step),
        values,
        axes,
        inverse,
        response,
        step,
        -(local_gradient * step).sum(axis=(-2, -1)),
    )


def inverse_of(matrix: FloatArray) -> FloatArray:
    """Return the inverse of a positive definite matrix (n, n), whatever the units of its rows.

    Raises
    ------
    numpy.linalg.LinAlgError
        It is not positive definite.
    """
    scale = np.sqrt(np.diagonal(matrix))
    if not (np.isfinite(scale).all() and scale.all()):
        raise np.linalg.LinAlgError("the information is singular")
    root = np.linalg.cholesky(matrix / scale[:, None] / scale)
    inverse = _inverse_of_root(root)
    inverse /= scale[:, None] * scale
    return inverse


def _inverse_of_root(root: NDArray[np.floating]) -> FloatArray:
    """Return the inverse (n, n) of root root', for a lower root; its transpose is LAPACK's order."""
    inverse, failed = dpotri(root.T, lower=0)
    if failed:
        raise np.linalg.LinAlgError("the information is singular")
    whole: FloatArray = inverse + inverse.T  # the other triangle is zero, as in the root
    np.einsum("ii->i", whole)[:] *= 0.5
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

    The plain inverse is useless where the others nearly determine an unknown, as where a plane has one
    station. The units of the unknowns make no difference.
    """
    by_cofactors = A.shape[-1] == 3 and A.size >= 9 * MANY_MATRICES
    inverse = _inverse_by_cofactors(A) if by_cofactors else _plain_inverse(A)
    inflation = _inflation(A, inverse)
    if by_cofactors:
        unsure = ~((inflation > 0.0) & (inflation < SURE_INFLATION)).all(axis=-1)
        if unsure.any():
            inverse[unsure] = _plain_inverse(A[unsure])
            inflation[unsure] = _inflation(A[unsure], inverse[unsure])
    # Beyond 1 / sqrt(SINGULAR) half of all digits are lost.
    sound = (inflation > 0.0) & (inflation < SINGULAR**-0.5)
    if sound.all():
        return inverse
    poor = ~sound.all(axis=-1)
    diagonal = np.einsum("...ii->...i", A[poor])
    some = diagonal > TINY
    scale = np.where(some, 1.0 / np.sqrt(np.where(some, diagonal, 1.0)), 0.0)
    values, axes = np.linalg.eigh(A[poor] * scale[..., :, None] * scale[..., None, :])
    known = values > SINGULAR
    weight = np.where(known, 1.0 / np.where(known, values, 1.0), 0.0)
    restricted = (axes * weight[..., None, :]) @ np.swapaxes(axes, -1, -2)
    inverse[poor] = restricted * scale[..., :, None] * scale[..., None, :]
    return inverse


def _plain_inverse(A: FloatArray) -> FloatArray:
    """Return the inverses of matrices by LAPACK; NaN where one of them is singular."""
    try:
        return np.asarray(np.linalg.inv(A))
    except np.linalg.LinAlgError:
        return np.full_like(A, np.nan)


def _inverse_by_cofactors(A: FloatArray) -> FloatArray:
    """Return the inverses of symmetric matrices (..., 3, 3); anything where they are singular."""
    a = np.ascontiguousarray(np.moveaxis(A, (-2, -1), (0, 1)))
    cofactor = np.empty_like(a)
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        np.subtract(a[j, j] * a[k, k], a[j, k] ** 2, out=cofactor[i, i])
        np.subtract(a[i, k] * a[j, k], a[i, j] * a[k, k], out=cofactor[i, j])
        cofactor[j, i] = cofactor[i, j]
    with np.errstate(divide="ignore", invalid="ignore"):
        cofactor /= (a[0] * cofactor[0]).sum(axis=0)
    return np.ascontiguousarray(np.moveaxis(cofactor, (0, 1), (-2, -1)))


def _inflation(A: FloatArray, inverse: FloatArray) -> FloatArray:
    """Return the variance inflation (..., n) of each unknown."""
    return np.asarray(np.einsum("...ii,...ii->...i", A, inverse))


def solve_definite(A: FloatArray, rhs: FloatArray) -> FloatArray:
    """Return x (K, n) of A x = rhs for symmetric A (K, n, n), by Cholesky's roots where they exist.

    The units of the unknowns make no difference.
    """
    solved = np.empty_like(rhs)
    for k, (matrix, right) in enumerate(zip(A, rhs, strict=True)):
        _, solved[k], failed = dposv(matrix.T, right)
        if failed:
            scale = 1.0 / np.sqrt(np.maximum(np.abs(np.diagonal(matrix)), TINY))
            scaled = matrix * scale[:, None] * scale
            solved[k] = scale * solve_stack(scaled, (right * scale)[:, None])[:, 0]
    return solved


def spectrum(matrix: FloatArray, floor: float) -> tuple[FloatArray, float, float, FloatArray]:
    """Return eigenvalues from below, the largest, their mean logarithm, and eigenvectors of the first.

    All of them, or of a large matrix those below `floor` and one beyond, if they are few.
    """
    if len(matrix) > LARGE_MATRIX and np.isfinite(floor):
        try:
            root = np.linalg.cholesky(matrix)
        except np.linalg.LinAlgError:
            root = None
        if root is not None:
            inverse = partial(cho_solve, (root.T, False), check_finite=False)  # nothing is copied
            solve = LinearOperator(matrix.shape, inverse, dtype=float)
            start = np.ones(len(matrix))
            accuracy = 1e-2  # relative: they only meet a bound
            for count in (1, 16):  # more if the first are below the bound
                small, axes = eigsh(matrix, count, sigma=0.0, OPinv=solve, v0=start, tol=accuracy)
                if small.max() >= floor:
                    top = eigsh(matrix, 1, v0=start, tol=accuracy, return_eigenvectors=False)
                    mean_log = 2.0 * float(np.log(np.diagonal(root)).mean())
                    order = np.argsort(small)
                    return small[order], float(top[0]), mean_log, axes[:, order]
    values, axes = np.linalg.eigh(matrix)
    mean_log = float(np.log(np.maximum(values, TINY)).mean())
    return values, float(values[-1]), mean_log, axes
