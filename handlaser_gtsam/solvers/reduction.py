r"""The paper's reduction (Brown), batched in NumPy: planes are eliminated before beams.

The normal matrix is bordered block-diagonal. For every plane p, H_pp is 3 x 3 and its border E_p
couples it to the beams; the reduced system of the beams is

    S = H_bb - sum_p E_p inv(H_pp) E_p'

and costs time linear in the number of planes. Beam unknowns are ordered (r, v, k) a beam, 5 + terms
each, directions in the basis of `model.tangent_basis`; plane unknowns are (tangent of n, b).

Several candidates for the same readings are worked on together, as copies: their parameters stand one
after the other, and every array of the normal equations has the copies first.

The offset of a plane is taken at the middle of its laser spots instead of the world origin: that
changes neither S nor the solution, and keeps H_pp well conditioned far from the origin.
"""

from dataclasses import dataclass, replace

import numpy as np

from .. import model
from ..arrays import BoolArray, FloatArray, IntArray
from ..data.parameters import Parameters
from ..data.recording import Readings
from ..model.weighting import Whitening


@dataclass(frozen=True, slots=True)
class NormalEquations:
    """H delta = -g in blocks, for residuals in metres; K copies.

    Attributes
    ----------
    beam : (K, nb, nb)
        H_bb with nb = B (5 + terms).
    border : (K, P, nb, 3)
        E_p.
    plane : (K, P, 3, 3)
        H_pp.
    beam_gradient : (K, nb)
    plane_gradient : (K, P, 3)
    centres : (K, P, 3)
        Where the offset of each plane is taken [m].
    """

    beam: FloatArray
    border: FloatArray
    plane: FloatArray
    beam_gradient: FloatArray
    plane_gradient: FloatArray
    centres: FloatArray

    def picked(self, copies: IntArray) -> "NormalEquations":
        """Return the normal equations of some copies."""
        return NormalEquations(
            self.beam[copies],
            self.border[copies],
            self.plane[copies],
            self.beam_gradient[copies],
            self.plane_gradient[copies],
            self.centres[copies],
        )


def normal_equations(
    parameters: Parameters, readings: Readings, terms: int, weights: FloatArray | None = None
) -> NormalEquations:
    """Return the normal equations at `parameters`; raises GrazingBeamError like the model.

    Parameters
    ----------
    parameters : Parameters
        Of K copies: K B beams and K P planes, copy after copy.
    readings : Readings
        Of one copy.
    terms : int
    weights : (K N,), optional
        Of the readings; one where not given.
    """
    copies = len(parameters.locations) // readings.beams
    counted = None if weights is None else weights > 0.0
    many = readings.copies(copies)
    columns, centres = jacobian_columns(parameters, many, terms, counted=counted)
    if weights is not None:
        columns *= np.sqrt(weights)
    width, beams, planes = 5 + terms, readings.beams, readings.planes
    blocks, size = readings.block_starts(), width + 4
    starts = (np.arange(copies)[:, None] * len(readings) + blocks).ravel()
    products = np.zeros((len(starts), size, size))
    for i in range(size):
        sums = np.add.reduceat(columns[i] * columns[i:], starts, axis=1)
        products[:, i, i:] = sums.T
        products[:, i:, i] = sums.T
    copy = np.repeat(np.arange(copies), len(blocks))
    beam_of = np.tile(readings.beam[blocks], copies)
    plane_of = np.tile(readings.plane[blocks], copies)
    beam_blocks = np.zeros((copies, beams, width, width + 1))
    pick = [*range(width), size - 1]
    np.add.at(beam_blocks, (copy, beam_of), products[:, :width, pick])
    plane_blocks = np.zeros((copies, planes, 3, 4))
    np.add.at(plane_blocks, (copy, plane_of), products[:, width : width + 3, width:])
    border = np.zeros((copies, planes, beams, width, 3))
    border[copy, plane_of, beam_of] = products[:, :width, width : width + 3]
    H = np.zeros((copies, beams, width, beams, width))
    each = np.arange(beams)
    H[:, each, :, each, :] = np.moveaxis(beam_blocks[..., :width], 1, 0)
    return NormalEquations(
        H.reshape(copies, beams * width, beams * width),
        border.reshape(copies, planes, beams * width, 3),
        plane_blocks[..., :3],
        beam_blocks[..., width].reshape(copies, -1),
        plane_blocks[..., 3],
        centres.reshape(copies, planes, 3),
    )


def whitened_normal_equations(
    parameters: Parameters, readings: Readings, terms: int, whitening: Whitening
) -> NormalEquations:
    """Return the normal equations of whitened readings; raises GrazingBeamError like the model."""
    columns, centres = jacobian_columns(parameters, readings, terms)
    width, blocks = 5 + terms, readings.beams
    take, near = whitening.coefficients(), whitening.gathered(columns.T)
    beam = (take[:, :, None] * near[:, :, :width]).reshape(len(readings), -1)
    rest = np.einsum("nk,nkd->nd", take, near[:, :, width:])
    plane, residual = rest[:, :3], rest[:, 3]
    starts = np.searchsorted(readings.plane, np.arange(readings.planes))
    border = np.empty((1, readings.planes, blocks * width, 3))
    for column in range(3):
        products = beam * plane[:, column, None]
        border[0, :, :, column] = np.add.reduceat(products, starts)
    squares = np.add.reduceat(plane[:, :, None] * plane[:, None, :], starts)
    return NormalEquations(
        (beam.T @ beam)[None],
        border,
        squares[None],
        (beam.T @ residual)[None],
        np.add.reduceat(plane * residual[:, None], starts)[None],
        centres[None],
    )


def damped_step(normal: NormalEquations, damping: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the steps (K, nb) of the beams and (K, P, 3) of the planes for damping (K,)."""
    lift = _lift(damping, np.einsum("kii->ki", normal.beam))
    plane_lift = _lift(damping, np.einsum("kpii->kpi", normal.plane))
    plane = normal.plane + plane_lift[..., None] * np.eye(3)
    right = np.concatenate((np.swapaxes(normal.border, 2, 3), normal.plane_gradient[..., None]), 3)
    solved = _solve(plane, right)
    W, w = solved[..., :-1], solved[..., -1]
    copies, size = normal.beam_gradient.shape
    E = np.swapaxes(normal.border, 1, 2).reshape(copies, size, -1)
    S = normal.beam + lift[..., None] * np.eye(size) - E @ W.reshape(copies, -1, size)
    gradient = normal.beam_gradient - (E @ w.reshape(copies, -1, 1))[..., 0]
    scale = 1.0 / np.sqrt(np.einsum("kii->ki", normal.beam) + lift)
    scaled = S * scale[:, :, None] * scale[:, None, :]
    beam = -scale * _solve(scaled, (gradient * scale)[..., None])[..., 0]
    return beam, -w - np.einsum("kpij,kj->kpi", W, beam)


def apply_step(
    parameters: Parameters, beam: FloatArray, plane: FloatArray, centres: FloatArray, terms: int
) -> Parameters:
    """Return `parameters` moved by beam (B, 5 + terms) and plane (P, 3) unknowns."""
    v, n = parameters.directions, parameters.normals
    turned_v = np.einsum("bij,bj->bi", model.tangent_basis(v), beam[:, 3:5])
    turned_n = np.einsum("pij,pj->pi", model.tangent_basis(n), plane[:, :2])
    k = parameters.range_errors.copy()
    k[:, :terms] += beam[:, 5:]
    normals = model.normalized(n + turned_n)
    at_centre = parameters.offsets + np.einsum("pi,pi->p", n, centres) + plane[:, 2]
    return Parameters(
        parameters.locations + beam[:, :3],
        model.normalized(v + turned_v),
        k,
        normals,
        at_centre - np.einsum("pi,pi->p", normals, centres),
    )


def jacobian_columns(
    parameters: Parameters,
    readings: Readings,
    terms: int,
    centres: FloatArray | None = None,
    counted: BoolArray | None = None,
) -> tuple[FloatArray, FloatArray]:
    """Return the rows of (J_beam, J_plane, e), transposed (5 + terms + 4, N), and the centres (P, 3).

    Offsets of planes are taken at `centres`: at the middle of the laser spots where not given.
    Readings that are not `counted` may graze their planes; their rows are finite and mean nothing.
    """
    x = model.scene(parameters, readings)
    if counted is not None and not counted.all():
        ahead = np.einsum("nij,nj->ni", x.R, x.v)
        x = replace(x, n=np.where(counted[:, None], x.n, ahead))
    at = model.linearize(x, readings.distance)
    if centres is None:
        centres = readings.plane_means(at.normal / at.offset[:, None])
    local = at.normal - at.offset[:, None] * centres[readings.plane]
    v_basis = model.tangent_basis(parameters.directions)[readings.beam]
    n_basis = model.tangent_basis(parameters.normals)[readings.plane]
    columns = np.hstack(
        (
            at.location,
            np.einsum("ni,nij->nj", at.direction, v_basis),
            at.range_error[:, :terms],
            np.einsum("ni,nij->nj", local, n_basis),
            at.offset[:, None],
            at.residual[:, None],
        )
    )
    return np.ascontiguousarray(columns.T), centres


def _lift(damping: FloatArray, diagonal: FloatArray) -> FloatArray:
    """Return what Marquardt's damping adds, at least a trace of it where a column is empty."""
    copies = len(diagonal)
    largest = np.maximum(diagonal.reshape(copies, -1).max(axis=1), 1e-300)
    shape = (copies,) + (1,) * (diagonal.ndim - 1)
    least = (1e-12 * largest).reshape(shape)
    lift: FloatArray = damping.reshape(shape) * np.maximum(diagonal, least)
    return lift


def _solve(A: FloatArray, rhs: FloatArray) -> FloatArray:
    """Return x of A x = rhs for stacks; the least-norm one where a matrix is singular."""
    try:
        solved = np.linalg.solve(A, rhs)
    except np.linalg.LinAlgError:
        solved = np.linalg.pinv(A, rcond=1e-14, hermitian=True) @ rhs
    return np.asarray(solved, dtype=np.float64)
