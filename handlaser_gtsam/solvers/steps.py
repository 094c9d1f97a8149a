"""Steps of Gauss and Newton from normal equations, the smaller side eliminated last."""

import numpy as np

from .. import model
from ..arrays import FloatArray
from ..data.parameters import Parameters, RangeErrorPrior
from ..data.recording import Readings
from ..model.weighting import Whitening
from ..quantities import SINGULAR, TINY
from .elimination import inverse_stack, solve_definite, solve_stack
from .normal_equations import NormalEquations, normal_equations

UNKNOWNS_RATIO = 4
"""Beams are eliminated first where they have more than this many times the unknowns of the planes."""


def damped_step(normal: NormalEquations, damping: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the steps (K, nb) of the beams and (K, P, 3) of the planes for damping (K,)."""
    damped, plane = bool(damping.any()), normal.plane
    if damped:
        plane = plane + _lift(damping, np.einsum("kpii->kpi", plane))[..., None] * np.eye(3)
    copies, planes = plane.shape[:2]
    size = normal.beam_gradient.shape[1]
    if normal.coupled is None and size > UNKNOWNS_RATIO * 3 * planes:
        return _beams_first(normal, _lift(damping, normal.diagonal), plane)
    # All that the planes answer to: a unit of every unknown of the beams, and the gradients.
    right = np.concatenate((normal.border.swapaxes(2, 3), normal.plane_gradient[..., None]), axis=3)
    answer = (inverse_stack(plane) @ right).reshape(copies, -1, size + 1)
    taken = right.reshape(answer.shape)[..., :size].swapaxes(1, 2) @ answer
    S = normal.beam - taken[..., :size]
    if damped:
        np.einsum("kii->ki", S)[:] += _lift(damping, normal.diagonal)
    step = solve_definite(S, taken[..., size] - normal.beam_gradient)
    moved = answer[..., size] + (answer[..., :size] @ step[..., None])[..., 0]
    return step, -moved.reshape(copies, planes, 3)


def newton_step(
    parameters: Parameters,
    readings: Readings,
    terms: int,
    whitening: Whitening,
    prior: RangeErrorPrior | None = None,
) -> tuple[Parameters, float]:
    """Return where an undamped step leads, and its length sqrt(-g' delta) [standard deviations]."""
    normal = normal_equations(parameters, readings, terms, whitening=whitening)
    if prior is not None:
        normal = normal.with_prior(prior, parameters.range_errors, np.array([whitening.sigma]))
    beam, plane = damped_step(normal, np.zeros(1))
    saved = -float((normal.beam_gradient * beam).sum() + (normal.plane_gradient * plane).sum())
    by_beam = beam.reshape(readings.beams, -1)
    moved = apply_step(parameters, by_beam, plane[0], normal.centres[0], terms)
    return moved, float(np.sqrt(max(saved, 0.0))) / whitening.sigma


def _beams_first(
    normal: NormalEquations, lift: FloatArray, plane: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Solve with the beams eliminated before few planes: the cost is linear in their number."""
    copies, beams, width = normal.blocks.shape[:3]
    planes = plane.shape[1]
    E = np.moveaxis(normal.border.reshape(copies, planes, beams, width, 3), 1, 3)
    E = E.reshape(copies, beams, width, planes * 3)
    blocks = normal.blocks + lift.reshape(copies, beams, width, 1) * np.eye(width)
    gradient = normal.beam_gradient.reshape(copies, beams, width, 1)
    scale = 1.0 / np.sqrt(np.einsum("kbii->kbi", blocks))[..., None]
    right = scale * np.concatenate((E, gradient), axis=3)
    solved = scale * solve_stack(blocks * scale * np.swapaxes(scale, 2, 3), right)
    H = np.zeros((copies, planes, 3, planes, 3))
    each = np.arange(planes)
    H[:, each, :, each, :] = np.moveaxis(plane, 1, 0)
    S = H.reshape(copies, 3 * planes, 3 * planes)
    S = S - np.einsum("kbwi,kbwj->kij", E, solved[..., :-1], optimize=True)
    g = normal.plane_gradient.reshape(copies, -1)
    g = g - np.einsum("kbwi,kbw->ki", E, solved[..., -1])
    unit = 1.0 / np.sqrt(np.maximum(np.einsum("kpii->kpi", plane).reshape(copies, -1), TINY))
    scaled = S * unit[:, :, None] * unit[:, None, :]
    y = -unit * solve_stack(scaled, (g * unit)[..., None])[..., 0]
    x = -solved[..., -1] - np.einsum("kbwi,ki->kbw", solved[..., :-1], y)
    return x.reshape(copies, -1), y.reshape(copies, planes, 3)


def apply_step(
    parameters: Parameters,
    beam: FloatArray,
    plane: FloatArray,
    centres: FloatArray,
    terms: int,
    bases: FloatArray | None = None,
) -> Parameters:
    """Return `parameters` moved by beam (B, 5 + terms) and plane (P, 3) unknowns.

    Parameters
    ----------
    bases : (B + P, 3, 2), optional
        Tangents of the directions, then of the normals, where they are at hand.
    """
    v, n = parameters.directions, parameters.normals
    unit = np.concatenate((v, n))
    turn = np.concatenate((beam[:, 3:5], plane[:, :2]))
    bases = model.tangent_basis(unit) if bases is None else bases
    moved = unit + (bases @ turn[..., None])[..., 0]
    moved /= np.sqrt(np.einsum("ni,ni->n", moved, moved))[:, None]
    k = parameters.range_errors.copy()
    k[:, :terms] += beam[:, 5:]
    normals = moved[len(v) :]
    # The offset at the centre moves by its own step alone.
    turned = np.einsum("pi,pi->p", n - normals, centres)
    offsets = parameters.offsets + plane[:, 2] + turned
    locations = parameters.locations + beam[:, :3]
    return Parameters.unchecked(locations, moved[: len(v)], k, normals, offsets)


def _lift(damping: FloatArray, diagonal: FloatArray) -> FloatArray:
    """Return what Marquardt's damping adds, at least a trace of it where a column is empty."""
    copies = len(diagonal)
    largest = np.maximum(diagonal.reshape(copies, -1).max(axis=1), TINY)
    shape = (copies,) + (1,) * (diagonal.ndim - 1)
    least = (SINGULAR * largest).reshape(shape)
    lift: FloatArray = damping.reshape(shape) * np.maximum(diagonal, least)
    return lift
