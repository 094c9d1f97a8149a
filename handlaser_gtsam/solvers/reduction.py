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
from ..arrays import BoolArray, FloatArray, IntArray, gathered
from ..data.parameters import Parameters, RangeErrorPrior
from ..data.recording import Readings
from ..model.weighting import Whitening
from .elimination import ReducedInformation, eliminated


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
        found: FloatArray = np.einsum("kbii->kbi", self.blocks)
        return found.reshape(self.beam_gradient.shape)

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
        pull, mean = (sigma / prior.sigma[:, : width - 5]) ** 2, prior.mean
        known, gradient = np.zeros((beams, width)), np.zeros((beams, width))
        known[:, 5:] = pull
        gradient[:, 5:] = pull * (range_errors - (0.0 if mean is None else mean))[:, : width - 5]
        return self.plus(known[..., None] * np.eye(width), gradient.ravel())

    def plus(
        self,
        beams: FloatArray,
        beam_gradient: FloatArray | float = 0.0,
        planes: FloatArray | float = 0.0,
    ) -> "NormalEquations":
        """Return the only copy with more information of single beams (B, w, w) and planes (P, 3, 3)."""
        coupled = self.coupled
        if coupled is not None:
            coupled, each = coupled.copy(), np.arange(len(beams))
            coupled.reshape(beams.shape[:2] * 2)[each, :, each, :] += beams
        return replace(
            self,
            blocks=self.blocks + beams,
            beam_gradient=self.beam_gradient + beam_gradient,
            plane=self.plane + planes,
            coupled=coupled,
        )

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
    return summed_equations(columns, centres, readings, copies, weights, whitening)


def summed_equations(
    columns: FloatArray,
    centres: FloatArray,
    readings: Readings,
    copies: int = 1,
    weights: FloatArray | None = None,
    whitening: Whitening | None = None,
) -> NormalEquations:
    """Return the normal equations of rows (5 + terms + 4, K N) as from `jacobian_columns`.

    Weights count beside a whitening that does not correlate readings.
    """
    heavy, width = columns, len(columns) - 4
    coupled = whitening is not None and whitening.is_coupled
    if whitening is not None:
        weights = whitening.squares() * (1.0 if weights is None else weights)
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
    products = _products(columns, heavy, starts)
    grid = np.zeros((copies, planes, beams, size, size))
    copy = np.repeat(np.arange(copies), len(blocks))
    grid[copy, np.tile(readings.plane[blocks], copies), np.tile(readings.beam[blocks], copies)] = (
        products
    )
    own = grid[..., :width, :].sum(axis=1)
    rest = grid[..., width : width + 3, width:].sum(axis=2)
    return NormalEquations(
        own[..., :width],
        grid[..., :width, width : width + 3].reshape(copies, planes, beams * width, 3),
        rest[..., :3],
        own[..., -1].reshape(copies, -1),
        rest[..., 3],
        centres.reshape(copies, planes, 3),
        products[:, -1, -1].reshape(copies, -1).sum(axis=1),
    )


def _products(left: FloatArray, right: FloatArray, starts: IntArray) -> FloatArray:
    """Return the products (blocks, m, m) of rows (m, N), summed over the blocks that begin at `starts`.

    Blocks are cut into pieces of about their mean length, which are multiplied as one stack.
    """
    sizes = np.diff(starts, append=left.shape[1])
    length = -(-left.shape[1] // len(starts))
    pieces = -(-sizes // length)
    first = np.cumsum(pieces) - pieces
    place = length * (np.arange(pieces.sum()) - first.repeat(pieces))[:, None] + np.arange(length)
    beyond = place >= sizes.repeat(pieces)[:, None]
    rows = np.where(beyond, 0, starts.repeat(pieces)[:, None] + place)
    stack = np.ascontiguousarray(left.T).take(rows, axis=0)
    stack[beyond] = 0.0
    products: FloatArray = np.swapaxes(stack, 1, 2) @ np.ascontiguousarray(right.T).take(
        rows, axis=0
    )
    return products if len(products) == len(starts) else np.add.reduceat(products, first)


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
    v_basis = gathered(model.tangent_basis(parameters.directions), readings.beam)
    n_basis = gathered(model.tangent_basis(parameters.normals), readings.plane)
    local = at.normal - at.offset[:, None] * gathered(centres, readings.plane)
    columns = np.empty((5 + terms + 4, len(readings)))
    columns[:3] = at.location.T
    np.einsum("ni,nij->jn", at.direction, v_basis, out=columns[3:5])
    columns[5:-4] = at.range_error[:, :terms].T
    np.einsum("ni,nij->jn", local, n_basis, out=columns[-4:-2])
    columns[-2], columns[-1] = at.offset, at.residual
    return columns, centres
