"""Beams that all unknowns of a session are counted from, and the information of one plane on them."""

from dataclasses import dataclass

import numpy as np

from .. import model
from ..arrays import BoolArray, FloatArray, IntArray
from ..data.parameters import Beams
from ..estimation.information import Information
from ..model.families import BEAM, MOUNT_DIM, modelled
from ..model.reduction import Normal


@dataclass(frozen=True, slots=True)
class Reference:
    """Beams that unknowns are counted from, in natural units: the typical range, 1 rad.

    Attributes
    ----------
    names : tuple of str
    beams : Beams
    terms : tuple of int
    length : float
        [m]
    """

    names: tuple[str, ...]
    beams: Beams
    terms: tuple[int, ...]
    length: float

    @property
    def mask(self) -> BoolArray:
        """Whether each of 7 unknowns a beam is estimated."""
        return modelled(self.terms).ravel()

    @property
    def active(self) -> IntArray:
        """Which of 7 unknowns a beam are estimated."""
        return np.flatnonzero(self.mask)

    @property
    def unit(self) -> FloatArray:
        """Natural units of the active unknowns."""
        return np.tile(BEAM.natural_units(self.length), len(self.terms))[self.active]

    def moves(self) -> IntArray:
        """Return which of the active unknowns belong to the mount of each beam, (B, 5)."""
        active = self.active
        return np.flatnonzero(active % BEAM.dim < MOUNT_DIM).reshape(-1, MOUNT_DIM)

    def coordinates(self, beams: Beams) -> FloatArray:
        """Return the unknowns of other beams."""
        basis = model.tangent_basis(self.beams[1])
        x = np.hstack(
            (
                beams[0] - self.beams[0],
                np.einsum("bij,bi->bj", basis, beams[1] - self.beams[1]),
                beams[2] - self.beams[2],
            )
        )
        coordinates: FloatArray = x.ravel()[self.active] / self.unit
        return coordinates


def plane_information(
    normal: Normal, sigma: float, beams: Beams, reference: Reference
) -> Information:
    """Return the information of one plane on the beams, (n, n) and (n,), in natural units.

    Parameters
    ----------
    normal : Normal
        Normal equations of that plane alone, fitted, with 2 range-error terms.
    sigma : float
        Standard deviation of a whitened residual [m].
    beams : Beams
        Beams at which they were taken.
    reference : Reference
    """
    plane_unit, unit = np.array([1.0, 1.0, reference.length]), np.ones(len(reference.mask))
    unit[reference.mask] = reference.unit
    reduced = normal.reduced(unit, plane_unit, reference.mask)
    turn = turns(beams[1], reference)
    L = turn.T @ reduced.matrix @ turn / sigma**2
    gradient = turn.T @ reduced.gradient / sigma**2
    return Information(L, L @ reference.coordinates(beams) - gradient, np.zeros(()))


def turns(directions: FloatArray, reference: Reference) -> FloatArray:
    """Return the matrix from unknowns in the bases of the reference to unknowns in the bases here."""
    here, there = model.tangent_basis(directions), model.tangent_basis(reference.beams[1])
    turns = np.tile(np.eye(BEAM.dim), (len(directions), 1, 1))
    turns[:, 3:5, 3:5] = np.swapaxes(here, 1, 2) @ there
    whole = np.zeros((len(directions), BEAM.dim, len(directions), BEAM.dim))
    each = np.arange(len(directions))
    whole[each, :, each, :] = turns
    size, active = BEAM.dim * len(directions), reference.active
    matrix: FloatArray = whole.reshape(size, size)[np.ix_(active, active)]
    return matrix
