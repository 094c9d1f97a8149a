r"""The paper's reduction (Brown), batched in NumPy: planes are eliminated before beams.

The normal matrix is bordered block-diagonal. For every plane p, H_pp is 3 x 3 and its border E_p
couples it to the beams; the reduced system of the beams is

    S = H_bb - sum_p E_p inv(H_pp) E_p'

and costs time linear in the number of planes. Beam unknowns are ordered (r, v, k) a beam, 5 + terms
each, directions in the basis of `model.tangent_basis`; plane unknowns are (tangent of n, b).

The offset of a plane is taken at the middle of its laser spots instead of the world origin: that
changes neither S nor the solution, and keeps H_pp well conditioned far from the origin.
"""

from dataclasses import dataclass

import numpy as np

from .. import model
from ..arrays import FloatArray
from ..errors import GrazingBeamError
from ..parameters import Parameters
from ..recording import Readings


@dataclass(frozen=True, slots=True)
class NormalEquations:
    """H delta = -g in blocks, for residuals in metres and unit weights.

    Attributes
    ----------
    beam : (nb, nb)
        H_bb with nb = B (5 + terms).
    border : (P, nb, 3)
        E_p.
    plane : (P, 3, 3)
        H_pp.
    beam_gradient : (nb,)
    plane_gradient : (P, 3)
    centres : (P, 3)
        Where the offset of each plane is taken [m], world frame.
    """

    beam: FloatArray
    border: FloatArray
    plane: FloatArray
    beam_gradient: FloatArray
    plane_gradient: FloatArray
    centres: FloatArray


@dataclass(frozen=True, slots=True)
class Refined:
    """Parameters after some steps, and their sum of squared residuals [m^2]."""

    parameters: Parameters
    squares: float


def normal_equations(parameters: Parameters, readings: Readings, terms: int) -> NormalEquations:
    """Return the normal equations at `parameters`; raises GrazingBeamError like the model."""
    columns, centres = _columns(parameters, readings, terms)
    width, beams, planes = 5 + terms, readings.beams, readings.planes
    starts = readings.block_starts()
    size = width + 4
    products = np.zeros((len(starts), size, size))
    for i in range(size):
        sums = np.add.reduceat(columns[i] * columns[i:], starts, axis=1)
        products[:, i, i:] = sums.T
        products[:, i:, i] = sums.T
    beam_of, plane_of = readings.beam[starts], readings.plane[starts]
    beam_blocks = np.zeros((beams, width, width + 1))
    pick = [*range(width), size - 1]
    np.add.at(beam_blocks, beam_of, products[:, :width, pick])
    plane_blocks = np.zeros((planes, 3, 4))
    np.add.at(plane_blocks, plane_of, products[:, width : width + 3, width:])
    border = np.zeros((planes, beams, width, 3))
    border[plane_of, beam_of] = products[:, :width, width : width + 3]
    H = np.zeros((beams, width, beams, width))
    H[np.arange(beams), :, np.arange(beams), :] = beam_blocks[:, :, :width]
    return NormalEquations(
        H.reshape(beams * width, beams * width),
        border.reshape(planes, beams * width, 3),
        plane_blocks[:, :, :3],
        beam_blocks[:, :, width].ravel(),
        plane_blocks[:, :, 3],
        centres,
    )


def refine(start: Parameters, readings: Readings, terms: int, iterations: int) -> Refined | None:
    """Take up to `iterations` damped steps from `start`; None where a beam grazes its plane there."""
    squares = _squares(start, readings)
    if squares is None:
        return None
    parameters, damping = start, 1e-8
    for _ in range(iterations):
        normal = normal_equations(parameters, readings, terms)
        while damping < 1e6:
            trial = _step(parameters, normal, damping, terms)
            trial_squares = _squares(trial, readings) if trial.finite() else None
            if trial_squares is not None and trial_squares < squares:
                break
            damping *= 10.0
        else:
            break
        gain = squares - trial_squares
        parameters, squares, damping = trial, trial_squares, max(damping / 10.0, 1e-8)
        if gain <= 1e-9 * squares:
            break
    return Refined(parameters, squares)


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


def _columns(
    parameters: Parameters, readings: Readings, terms: int
) -> tuple[FloatArray, FloatArray]:
    """Return the rows of (J_beam, J_plane, e), transposed (5 + terms + 4, N), and the centres."""
    x = model.scene(parameters, readings)
    at = model.linearize(x, readings.distance)
    spots = at.normal / at.offset[:, None]
    count = np.bincount(readings.plane, minlength=readings.planes)
    sums = np.stack(
        [np.bincount(readings.plane, spots[:, i], readings.planes) for i in range(3)], 1
    )
    centres = sums / np.maximum(count, 1)[:, None]
    local = at.normal - at.offset[:, None] * centres[readings.plane]
    v_basis = model.tangent_basis(parameters.directions)[readings.beam]
    n_basis = model.tangent_basis(parameters.normals)[readings.plane]
    columns = (
        at.location,
        np.einsum("ni,nij->nj", at.direction, v_basis),
        at.range_error[:, :terms],
        np.einsum("ni,nij->nj", local, n_basis),
        at.offset[:, None],
        at.residual[:, None],
    )
    return np.ascontiguousarray(np.hstack(columns).T), centres


def _step(
    parameters: Parameters, normal: NormalEquations, damping: float, terms: int
) -> Parameters:
    beam = normal.beam + np.diag(_lift(damping, np.diagonal(normal.beam)))
    diagonal = np.einsum("pii->pi", normal.plane)
    plane = normal.plane + _lift(damping, diagonal)[:, :, None] * np.eye(3)
    right = np.concatenate((np.swapaxes(normal.border, 1, 2), normal.plane_gradient[..., None]), 2)
    solved = np.linalg.solve(plane, right)
    W, w = solved[..., :-1], solved[..., -1]
    E = np.swapaxes(normal.border, 0, 1).reshape(len(beam), -1)
    S = beam - E @ W.reshape(-1, len(beam))
    gradient = normal.beam_gradient - E @ w.ravel()
    beam_step = np.asarray(-np.linalg.lstsq(S, gradient, rcond=1e-14)[0], dtype=np.float64)
    plane_step: FloatArray = -w - W @ beam_step
    width = 5 + terms
    return apply_step(parameters, beam_step.reshape(-1, width), plane_step, normal.centres, terms)


def _lift(damping: float, diagonal: FloatArray) -> FloatArray:
    """Return what Marquardt's damping adds, at least a trace of it where a column is empty."""
    return damping * np.maximum(diagonal, 1e-12 * max(float(diagonal.max()), 1e-300))


def _squares(parameters: Parameters, readings: Readings) -> float | None:
    try:
        e = model.residuals(model.scene(parameters, readings), readings.distance)
    except GrazingBeamError:
        return None
    return float(e @ e)
