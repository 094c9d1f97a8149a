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
    try:
        inverse = np.asarray(np.linalg.inv(A))
    except np.linalg.LinAlgError:
        inverse = np.full_like(A, np.nan)
    # The variance inflation of each unknown. Beyond 1 / sqrt(SINGULAR) half of all digits are lost.
    inflation = np.einsum("...ii,...ii->...i", A, inverse)
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
