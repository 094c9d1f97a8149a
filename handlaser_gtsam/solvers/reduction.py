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
from scipy.linalg.lapack import dpotri

from .. import model
from ..arrays import BoolArray, FloatArray, IntArray
from ..data.parameters import Parameters, RangeErrorPrior
from ..data.recording import Readings
from ..model.weighting import Whitening

RANK = 1e-12
"""Information of a plane below this part of its largest is rounding."""
CERTAIN = 1e3
"""Where all pivots exceed what is needed so many times, all eigenvalues do exceed it."""
MANY_BEAMS = 4
"""Beams are eliminated first where their unknowns are so many times those of the planes."""


@dataclass(frozen=True, slots=True)
class NormalEquations:
    """H delta = -g in blocks, for residuals in metres; K copies.

    Attributes
    ----------
    blocks : (K, B, w, w)
        The own block of every beam in H_bb, with w = 5 + terms.
    border : (K, P, nb, 3)
        E_p, with nb = B w.
    plane : (K, P, 3, 3)
        H_pp.
    beam_gradient : (K, nb)
    plane_gradient : (K, P, 3)
    centres : (K, P, 3)
        Where the offset of each plane is taken [m].
    squares : (K,)
        The weighted sum of squares.
    coupled : (K, nb, nb) or None
        All of H_bb where readings of several beams are correlated; None where beams are independent.
    """

    blocks: FloatArray
    border: FloatArray
    plane: FloatArray
    beam_gradient: FloatArray
    plane_gradient: FloatArray
    centres: FloatArray
    squares: FloatArray
    coupled: FloatArray | None = None

    @property
    def beam(self) -> FloatArray:
        """H_bb (K, nb, nb) as dense matrices."""
        if self.coupled is not None:
            return self.coupled
        copies, beams, width = self.blocks.shape[:3]
        H = np.zeros((copies, beams, width, beams, width))
        each = np.arange(beams)
        H[:, each, :, each, :] = np.moveaxis(self.blocks, 1, 0)
        return H.reshape(copies, beams * width, beams * width)

    @property
    def diagonal(self) -> FloatArray:
        """The diagonal (K, nb) of H_bb."""
        return np.einsum("kbii->kbi", self.blocks).reshape(self.beam_gradient.shape)

    def picked(self, copies: IntArray) -> "NormalEquations":
        """Return the normal equations of some copies."""
        return NormalEquations(
            self.blocks[copies],
            self.border[copies],
            self.plane[copies],
            self.beam_gradient[copies],
            self.plane_gradient[copies],
            self.centres[copies],
            self.squares[copies],
            None if self.coupled is None else self.coupled[copies],
        )

    def with_prior(
        self, prior: RangeErrorPrior, range_errors: FloatArray, sigma: float
    ) -> "NormalEquations":
        """Return the only copy with a prior of the range errors (B, 2), beside residuals of a sigma."""
        beams, width = self.blocks.shape[1:3]
        terms = width - 5
        pull = (sigma / prior.sigma[:, :terms]) ** 2
        mean = 0.0 if prior.mean is None else prior.mean[:, :terms]
        blocks, gradient = self.blocks.copy(), self.beam_gradient.copy()
        rows = np.arange(5, width)
        blocks[0][:, rows, rows] += pull
        gradient.reshape(beams, width)[:, 5:] += pull * (range_errors[:, :terms] - mean)
        coupled = self.coupled
        if coupled is not None:
            coupled = coupled.copy()
            at = (np.arange(beams)[:, None] * width + rows).ravel()
            coupled[0][at, at] += pull.ravel()
        return replace(self, blocks=blocks, beam_gradient=gradient, coupled=coupled)

    def reduced(
        self,
        beam_unit: FloatArray,
        plane_unit: FloatArray,
        active: BoolArray | None = None,
        prior: FloatArray | None = None,
        floor: float | None = None,
    ) -> "ReducedInformation":
        """Return what the only copy says of the beams, planes eliminated, in the given units.

        Parameters
        ----------
        beam_unit : (nb,)
        plane_unit : (3,)
        active : (nb,) of bool, optional
            Unknowns; the others are range-error terms that a beam does not have.
        prior : (nb,), optional
            Information of every unknown beside the readings, in these units.
        floor : float, optional
            Information of a plane below this is none; `RANK` of its largest where not given.
        """
        rows = np.arange(len(beam_unit)) if active is None else np.flatnonzero(active)
        H = self.beam[0] if active is None else self.beam[0][np.ix_(rows, rows)]
        unit = beam_unit[rows]
        H = H * unit[:, None] * unit
        if prior is not None:
            H[np.diag_indices(len(rows))] += prior[rows]
        return eliminated(
            H,
            self.border[0][:, rows] * unit[:, None] * plane_unit,
            self.plane[0] * np.outer(plane_unit, plane_unit),
            self.beam_gradient[0][rows] * unit,
            self.plane_gradient[0] * plane_unit,
            floor,
        )


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

    def covariance(self, floor: float) -> FloatArray:
        """Return the inverse (n, n) of the only copy, along axes of at least `floor` information."""
        try:
            root = np.linalg.cholesky(self.matrix)
            if np.diagonal(root).min() ** 2 > CERTAIN * floor:
                return inverse_of(self.matrix)
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
        beam = -unit * _solve(scaled, (self.gradient * unit)[..., None])[..., 0]
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


def normal_equations(
    parameters: Parameters,
    readings: Readings,
    terms: int,
    weights: FloatArray | None = None,
    whitening: Whitening | None = None,
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
    whitening : Whitening, optional
        Of the readings of one copy, in place of weights.
    """
    copies = len(parameters.locations) // readings.beams
    counted = None if weights is None else weights > 0.0
    many = readings.copies(copies)
    columns, centres = jacobian_columns(parameters, many, terms, counted=counted)
    heavy, width = columns, 5 + terms
    coupled = whitening is not None and whitening.is_coupled
    if whitening is not None:
        weights = whitening.squares()
    if coupled and whitening is not None:
        heavy = columns.copy()
        heavy[width:] = whitening.weighed(columns[width:].T).T
    elif weights is not None:
        heavy = columns * weights
    found = _summed(columns, heavy, centres, readings, copies)
    if not coupled or whitening is None:
        return found
    H = _coupled(columns[:width], readings, whitening)
    each = np.arange(readings.beams)
    blocks = H.reshape(readings.beams, width, readings.beams, width)[each, :, each]
    return replace(found, blocks=blocks[None], coupled=H[None])


def _summed(
    columns: FloatArray,
    heavy: FloatArray,
    centres: FloatArray,
    readings: Readings,
    copies: int,
) -> NormalEquations:
    """Return the sums over the blocks of readings that share plane and beam."""
    beams, planes, size = readings.beams, readings.planes, len(columns)
    width, blocks = size - 4, readings.block_starts()
    starts = (np.arange(copies)[:, None] * len(readings) + blocks).ravel()
    products = np.empty((len(starts), size, size))
    for i in range(size):
        products[:, i, i:] = np.add.reduceat(columns[i] * heavy[i:], starts, axis=1).T
    copy = np.repeat(np.arange(copies), len(blocks))
    beam_of = np.tile(readings.beam[blocks], copies)
    plane_of = np.tile(readings.plane[blocks], copies)
    own = np.zeros((copies, beams, width, width + 1))
    np.add.at(own, (copy, beam_of), products[:, :width, [*range(width), size - 1]])
    rest = np.zeros((copies, planes, 3, 4))
    np.add.at(rest, (copy, plane_of), products[:, width : width + 3, width:])
    for blocks_of in (own, rest):  # the lower triangles were not summed
        for i in range(1, blocks_of.shape[2]):
            blocks_of[:, :, i, :i] = blocks_of[:, :, :i, i]
    border = np.zeros((copies, planes, beams, width, 3))
    border[copy, plane_of, beam_of] = products[:, :width, width : width + 3]
    return NormalEquations(
        own[..., :width],
        border.reshape(copies, planes, beams * width, 3),
        rest[..., :3],
        own[..., width].reshape(copies, -1),
        rest[..., 3],
        centres.reshape(copies, planes, 3),
        products[:, -1, -1].reshape(copies, -1).sum(axis=1),
    )


def _coupled(columns: FloatArray, readings: Readings, how: Whitening) -> FloatArray:
    """Return all of H_bb (nb, nb) of correlated readings, from the beams' columns (w, N)."""
    width, beams = len(columns), readings.beams
    grid = np.zeros((*how.root.shape[:2], width))
    grid[how.station, how.beam] = columns.T
    weight = how.root @ how.root
    H = np.empty((beams, width, beams, width))
    for i in range(beams):
        heavy = weight[:, i, :, None] * grid
        H[i] = (grid[:, i].T @ heavy.reshape(len(grid), -1)).reshape(width, beams, width)
    return H.reshape(beams * width, beams * width)


def damped_step(normal: NormalEquations, damping: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the steps (K, nb) of the beams and (K, P, 3) of the planes for damping (K,)."""
    lift = _lift(damping, normal.diagonal)
    plane_lift = _lift(damping, np.einsum("kpii->kpi", normal.plane))
    plane = normal.plane + plane_lift[..., None] * np.eye(3)
    copies, planes = normal.plane.shape[:2]
    size = normal.beam_gradient.shape[1]
    if normal.coupled is None and size > MANY_BEAMS * 3 * planes:
        return _beams_first(normal, lift, plane)
    right = np.concatenate((np.swapaxes(normal.border, 2, 3), normal.plane_gradient[..., None]), 3)
    solved = _solve(plane, right)
    W, w = solved[..., :-1], solved[..., -1]
    E = np.swapaxes(normal.border, 1, 2).reshape(copies, size, -1)
    beam = np.array(normal.beam)
    beam[:, np.arange(size), np.arange(size)] += lift
    S = beam - E @ W.reshape(copies, -1, size)
    gradient = normal.beam_gradient - (E @ w.reshape(copies, -1, 1))[..., 0]
    scale = 1.0 / np.sqrt(np.einsum("kii->ki", beam))
    scaled = S * scale[:, :, None] * scale[:, None, :]
    step = -scale * _solve(scaled, (gradient * scale)[..., None])[..., 0]
    return step, -w - np.einsum("kpij,kj->kpi", W, step)


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
        normal = normal.with_prior(prior, parameters.range_errors, whitening.sigma)
    beam, plane = damped_step(normal, np.zeros(1))
    saved = -float((normal.beam_gradient * beam).sum() + (normal.plane_gradient * plane).sum())
    own = beam.reshape(readings.beams, -1)
    moved = apply_step(parameters, own, plane[0], normal.centres[0], terms)
    return moved, float(np.sqrt(max(saved, 0.0))) / whitening.sigma


def _beams_first(
    normal: NormalEquations, lift: FloatArray, plane: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Solve with the beams eliminated before few planes: the cost is linear in their number."""
    copies, beams, width = normal.blocks.shape[:3]
    planes = plane.shape[1]
    E = np.moveaxis(normal.border.reshape(copies, planes, beams, width, 3), 1, 3)
    E = E.reshape(copies, beams, width, planes * 3)
    own = normal.blocks + lift.reshape(copies, beams, width, 1) * np.eye(width)
    gradient = normal.beam_gradient.reshape(copies, beams, width, 1)
    scale = 1.0 / np.sqrt(np.einsum("kbii->kbi", own))[..., None]
    right = scale * np.concatenate((E, gradient), axis=3)
    solved = scale * _solve(own * scale * np.swapaxes(scale, 2, 3), right)
    H = np.zeros((copies, planes, 3, planes, 3))
    each = np.arange(planes)
    H[:, each, :, each, :] = np.moveaxis(plane, 1, 0)
    S = H.reshape(copies, 3 * planes, 3 * planes)
    S = S - np.einsum("kbwi,kbwj->kij", E, solved[..., :-1], optimize=True)
    g = normal.plane_gradient.reshape(copies, -1)
    g = g - np.einsum("kbwi,kbw->ki", E, solved[..., -1])
    unit = 1.0 / np.sqrt(np.maximum(np.einsum("kpii->kpi", plane).reshape(copies, -1), 1e-300))
    scaled = S * unit[:, :, None] * unit[:, None, :]
    y = -unit * _solve(scaled, (g * unit)[..., None])[..., 0]
    x = -solved[..., -1] - np.einsum("kbwi,ki->kbw", solved[..., :-1], y)
    return x.reshape(copies, -1), y.reshape(copies, planes, 3)


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
    v_basis = model.tangent_basis(parameters.directions)[readings.beam]
    n_basis = model.tangent_basis(parameters.normals)[readings.plane]
    local = at.normal - at.offset[:, None] * centres[readings.plane]
    columns = np.empty((5 + terms + 4, len(readings)))
    columns[:3] = at.location.T
    np.einsum("ni,nij->jn", at.direction, v_basis, out=columns[3:5])
    columns[5:-4] = at.range_error[:, :terms].T
    np.einsum("ni,nij->jn", local, n_basis, out=columns[-4:-2])
    columns[-2], columns[-1] = at.offset, at.residual
    return columns, centres


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
    inverse, failed = dpotri(root, lower=1)
    if failed:
        raise np.linalg.LinAlgError("the information is singular")
    inverse = np.tril(inverse)
    inverse += np.tril(inverse, -1).T
    inverse /= scale[:, None] * scale
    return inverse, 2.0 * float(np.log(np.diagonal(root) * scale).sum())


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
