r"""The paper's reduction (Brown), batched in NumPy: planes are eliminated before beams.

The normal matrix is bordered block-diagonal. For every plane p, H_pp is 3 x 3 and its border E_p
couples it to the beams; the reduced system of the beams is

    S = H_bb - sum_p E_p inv(H_pp) E_p'

and costs time linear in the number of planes. Beam unknowns are ordered (r, v, k) a beam, 5 + terms
each; plane unknowns are (tangent of n, b). Directions and normals move along the tangents of the rows:
`model.tangent_basis` or GTSAM's.

Several problems of one shape are worked on together, or several candidates for one, as copies: their
parameters stand one after the other, and every array of the normal equations has the copies first.

The offset of a plane is taken at the middle of its laser spots instead of the world origin: that
changes neither S nor the solution, and keeps H_pp well conditioned far from the origin.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from .. import model
from ..arrays import BoolArray, FloatArray, IntArray, gathered
from ..data.parameters import Parameters, RangeErrorPrior
from ..data.recording import Readings
from ..errors import GrazingBeamError
from ..model.weighting import Whitening
from .elimination import ReducedInformation, eliminated
from .grid import PLANE_COLUMNS, Grid, GridRows, Weighing, weighing_of


@dataclass(frozen=True, slots=True)
class NormalEquations:
    """H delta = -g in blocks, for residuals in metres; K copies.

    Attributes
    ----------
    blocks : (K, B, w, w)
        The diagonal block of every beam in H_bb, with w = 5 + terms.
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
        np.einsum("kibic->kibc", H)[:] = self.blocks
        return H.reshape(copies, beams * width, -1)

    @property
    def diagonal(self) -> FloatArray:
        """The diagonal (K, nb) of H_bb."""
        diagonal: FloatArray = np.einsum("kbii->kbi", self.blocks)
        return diagonal.reshape(self.beam_gradient.shape)

    def picked(self, copies: IntArray) -> "NormalEquations":
        """Return the normal equations of some copies."""
        if len(copies) == len(self.squares) and (np.diff(copies) > 0).all():
            return self
        arrays: list[Any] = [a if a is None else a[copies] for a in self._arrays()]
        return NormalEquations(*arrays)

    def put(self, copies: IntArray, others: "NormalEquations") -> "NormalEquations":
        """Return `others` at the places of some copies; those here may be written to for it."""
        if len(copies) == len(self.squares):
            return others
        for mine, new in zip(self._arrays(), others._arrays(), strict=True):
            if mine is not None:
                mine[copies] = new
        return self

    @classmethod
    def joined(cls, several: Sequence["NormalEquations"]) -> "NormalEquations":
        """Return the copies of several, one after the other."""
        if len(several) == 1:
            return several[0]
        parts = zip(*(normal._arrays() for normal in several), strict=True)
        arrays: list[Any] = [None if part[0] is None else np.concatenate(part) for part in parts]
        return cls(*arrays)

    def _arrays(self) -> list[Any]:
        return [getattr(self, name) for name in self.__dataclass_fields__]

    def with_prior(
        self, prior: RangeErrorPrior, range_errors: FloatArray, sigma: FloatArray
    ) -> "NormalEquations":
        """Return the same with a prior of the range errors (K B, 2), beside residuals of sigma (K,)."""
        copies, beams, width = self.blocks.shape[:3]
        terms = width - 5
        pull = (sigma[:, None, None] / prior.sigma[:, :terms]) ** 2
        mean = 0.0 if prior.mean is None else prior.mean[:, :terms]
        off = range_errors.reshape(copies, beams, 2)[..., :terms] - mean
        blocks, gradient = self.blocks.copy(), self.beam_gradient.copy()
        rows = np.arange(5, width)
        blocks[..., rows, rows] += pull
        gradient.reshape(copies, beams, width)[..., 5:] += pull * off
        squares, coupled = self.squares + (pull * off**2).sum(axis=(1, 2)), self.coupled
        if coupled is not None:
            coupled = coupled.copy()
            diagonal = (np.arange(beams)[:, None] * width + rows).ravel()
            coupled[:, diagonal, diagonal] += pull.reshape(copies, -1)
        return replace(
            self, blocks=blocks, beam_gradient=gradient, squares=squares, coupled=coupled
        )

    def plus(self, beams: FloatArray, beam_gradient: FloatArray) -> "NormalEquations":
        """Return the only copy with more information (B, w, w) of single beams, and gradient (nb,)."""
        coupled = self.coupled
        if coupled is not None:
            coupled, each = coupled.copy(), np.arange(len(beams))
            coupled.reshape(beams.shape[:2] * 2)[each, :, each, :] += beams
        return replace(
            self,
            blocks=self.blocks + beams,
            beam_gradient=self.beam_gradient + beam_gradient,
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
    readings: Readings | Grid,
    terms: int,
    weights: FloatArray | None = None,
    whitening: Whitening | None = None,
) -> NormalEquations:
    """Return the normal equations at `parameters`.

    Parameters
    ----------
    parameters : Parameters
        Of K problems: K B beams and K P planes, one problem after the other.
    readings : Readings or Grid
        Of each of K problems, or of all of them.
    terms : int
    weights : (K, N), optional
        Weights of the readings, 1 where not given. Readings of weight zero may graze their planes.
    whitening : Whitening, optional
        Of the readings of one problem, in place of weights.

    Raises
    ------
    GrazingBeamError
        A beam is parallel to its plane.
    """
    grid = readings if isinstance(readings, Grid) else Grid([readings])
    weighing = Weighing()
    if whitening is not None:
        weighing = weighing_of(grid, [whitening])
    elif weights is not None:
        weighing = Weighing(np.sqrt(grid.spread(weights)))
    normal, rows = grid_normal_equations(grid, parameters, terms, weighing)
    worst = float(rows.cosine.min())
    if not worst >= model.GRAZING_LIMIT:
        raise GrazingBeamError(worst, model.GRAZING_LIMIT)
    return normal


def grid_normal_equations(
    grid: Grid, parameters: Parameters, terms: int, weighing: Weighing
) -> tuple[NormalEquations, GridRows]:
    """Return the normal equations of K problems, and the rows they are summed of."""
    rows = grid.rows(parameters, terms, None if weighing.root is None else weighing.root > 0.0)
    return summed_equations(grid, rows.columns, rows.centres, weighing), rows


def summed_equations(
    grid: Grid, columns: FloatArray, centres: FloatArray, weighing: Weighing
) -> NormalEquations:
    """Return the normal equations of rows of K problems; see `grid.Rows`."""
    if weighing.matrix is not None:
        return _coupled(columns, centres, grid, weighing.matrix)
    blocks = grid.by_block(columns if weighing.root is None else columns * weighing.root)
    return _summed(grid.by_plane(blocks @ np.swapaxes(blocks, -1, -2)), centres)


def _summed(products: FloatArray, centres: FloatArray) -> NormalEquations:
    """Return the normal equations from the products (K, P, B, q, q) of the columns of every block."""
    copies, planes, beams, size, _ = products.shape
    width = size - PLANE_COLUMNS
    of_beams = products[..., :width, :].sum(axis=1)
    rest = products[..., width:, width:].sum(axis=2)
    return NormalEquations(
        of_beams[..., :width],
        products[..., :width, width:-1].reshape(copies, planes, beams * width, 3),
        rest[..., :3, :3],
        of_beams[..., -1].reshape(copies, -1),
        rest[..., :3, 3],
        centres,
        rest[..., 3, 3].sum(axis=1),
    )


def _coupled(
    columns: FloatArray, centres: FloatArray, grid: Grid, weight: FloatArray
) -> NormalEquations:
    """Return the normal equations of readings that are correlated within their stations."""
    beams, copies = grid.beams, columns.shape[1]
    width = len(columns) - PLANE_COLUMNS
    by_cell = np.ascontiguousarray(columns.transpose(1, 3, 2, 0))
    heavy = (weight @ by_cell[..., width:]).transpose(3, 0, 2, 1)
    free = np.swapaxes(grid.by_block(heavy), -1, -2)
    border = grid.by_plane(grid.by_block(columns[:width]) @ free)
    rest = grid.by_plane((grid.by_block(columns[width:]) @ free).sum(axis=2))
    H = np.empty((copies, beams, width, beams, width))
    for i in range(beams):
        there = weight[:, :, i, :, None] * by_cell[..., :width]
        here = np.swapaxes(by_cell[:, :, i, :width], 1, 2)
        H[:, i] = (here @ there.reshape(copies, grid.cells, -1)).reshape(
            copies, width, beams, width
        )
    each = np.arange(beams)
    return NormalEquations(
        np.moveaxis(H[:, each, :, each], 0, 1),
        border[..., :3].reshape(copies, grid.planes, -1, 3),
        rest[..., :3, :3],
        border[..., 3].sum(axis=1).reshape(copies, -1),
        rest[..., :3, 3],
        centres,
        rest[..., 3, 3].sum(axis=1),
        H.reshape(copies, beams * width, beams * width),
    )


def jacobian_columns(
    parameters: Parameters,
    readings: Readings,
    terms: int,
    centres: FloatArray | None = None,
) -> tuple[FloatArray, FloatArray]:
    """Return the rows of (J_beam, J_plane, e), transposed (5 + terms + 4, N), and the centres (P, 3).

    Offsets of planes are taken at `centres`: at the middle of the laser spots where not given.
    """
    x = model.scene(parameters, readings)
    linear = model.linearize(x, readings.measured)
    if centres is None:
        centres = readings.plane_means(linear.normal / linear.offset[:, None])
    v_basis = gathered(model.tangent_basis(parameters.directions), readings.beam)
    n_basis = gathered(model.tangent_basis(parameters.normals), readings.plane)
    middle = gathered(centres, readings.plane)
    return model.tangent_columns(linear, v_basis, n_basis, middle, terms), centres
