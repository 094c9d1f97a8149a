"""Columns of residuals without what the unknowns of a solution explain of them.

Planes are eliminated first, then beams, so that the cost is linear in readings and planes.
Systematic errors that are unknowns come last: they are few.
"""

from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_array

from ..arrays import BoolArray, FloatArray, IntArray
from ..data.parameters import Parameters
from ..data.recording import Readings
from ..model.effects.effect import SeenStations
from ..model.families import BEAM, MOUNT_DIM, PLANE
from ..model.geometry import tangent_basis
from ..model.joint import plane_lifts
from ..model.reduction import Normal
from ..model.weighting import Whitening
from ..solvers.beam_problem import jacobian_columns, linearized

SQUARE_ROUNDING = 1e-14
"""Information, or a square, below this part of the whole is lost in rounding."""


class FreedColumns(NamedTuple):
    """Systematic errors that are unknowns, each in units of the sigma of its zero-mean prior.

    Attributes
    ----------
    codes : tuple of str
        Of every unknown.
    columns : (N, q)
        Derivatives of the residuals [m].
    size : (q,)
        Estimated.
    """

    codes: tuple[str, ...]
    columns: FloatArray
    size: FloatArray


class Moves(NamedTuple):
    """How beams (B, 7, c), tangent, and planes (P, 4, c) by (n, b) follow further unknowns."""

    beams: FloatArray
    planes: FloatArray


class LinearRows(SeenStations):
    """The linear problem at a solution: readings as effects see them, and their derivatives.

    Raises GrazingBeamError like the model.

    Parameters
    ----------
    at, readings, position
        As of `SeenStations`.
    how : Whitening
        Of these rows, beam by beam in the order of the beams.
    prior : (B, 2)
        Standard deviations of the zero-mean prior on range errors [SI units]: infinite where a term
        is free, zero where it is not in the model.
    channel : (B,), optional
        As of `SeenStations`; the columns of the recording in their order where not given.
    freed : FreedColumns, optional
        Systematic errors that are unknowns.

    Attributes
    ----------
    J : (N, 10)
        Derivatives of the residuals by the unknowns of the own beam (7) and plane (3).
    residual : (N,)
    normal : Normal
        Of all unknowns.
    centres : (P, 3)
        Points at which the offsets of the planes are taken [m].
    """

    def __init__(
        self,
        at: Parameters,
        readings: Readings,
        how: Whitening,
        prior: FloatArray,
        position: IntArray,
        channel: IntArray | None = None,
        freed: FreedColumns | None = None,
    ) -> None:
        super().__init__(
            at, readings, position, np.arange(readings.beams) if channel is None else channel
        )
        self.how, self.prior, self.held = how, prior, prior == 0.0
        self.freed = freed or FreedColumns((), np.empty((len(readings), 0)), np.empty(0))
        self.normal, self.centres = linearized(at, readings, 2, how)
        columns = jacobian_columns(at, readings, 2, self.centres)
        self.J = np.ascontiguousarray(columns[: BEAM.dim + PLANE.dim].T)
        self.residual = columns[-1]

    @cached_property
    def sparse(self) -> csr_array:
        """The derivatives (N, 7 B + 3 P) by all unknowns."""
        readings = self.readings
        beam = BEAM.dim * readings.beam[:, None] + np.arange(BEAM.dim)
        plane = (
            BEAM.dim * readings.beams + PLANE.dim * readings.plane[:, None] + np.arange(PLANE.dim)
        )
        size = BEAM.dim * readings.beams + PLANE.dim * readings.planes
        starts = (BEAM.dim + PLANE.dim) * np.arange(len(readings) + 1)
        columns = np.hstack((beam, plane)).ravel()
        return csr_array((self.J.ravel(), columns, starts), shape=(len(readings), size))


class Projection:
    """Takes out of columns what the unknowns explain; planes are eliminated first, then beams.

    Unknowns are scaled by the square roots of their own information, so that their units do not
    matter. `prior` is the one of the rows, or another one; so is `how`.
    """

    def __init__(self, rows: LinearRows, prior: FloatArray, how: Whitening | None = None) -> None:
        self.J, self.how, self.readings = rows.sparse, how or rows.how, rows.readings
        self.normals, self.centres = rows.at.normals, rows.centres
        self.pull = np.zeros((rows.readings.beams, BEAM.dim))
        finite = np.isfinite(prior) & (prior > 0.0)
        self.pull[:, MOUNT_DIM:][finite] = self.how.sigma / prior[finite]
        active = np.ones_like(self.pull, dtype=bool)
        active[:, MOUNT_DIM:] = prior > 0.0
        self._invert(rows.normal, active.ravel())
        # Of the freed errors: what beams and planes leave of them, weighed, and their own information.
        self.freed, freed = rows.freed, rows.freed.columns
        self.freed_rest, self.freed_pulled, self.freed_moved = self.beside(freed)
        self.freed_heavy = self.how.weighed(self.freed_rest)
        known = self.freed_rest.T @ self.freed_heavy + self.freed_pulled.T @ self.freed_pulled
        self.freed_inverse = np.linalg.inv(known + self.how.sigma**2 * np.eye(freed.shape[1]))

    def _invert(self, normal: Normal, active: BoolArray) -> None:
        """Invert the information of beams, whose unknowns (7 B,) are `active`, and planes."""
        diagonal = np.diagonal(normal.matrix[0]) + self.pull.ravel() ** 2
        used = active & (diagonal > 0.0)
        self.unknowns = int(used.sum()) + PLANE.dim * self.readings.planes
        unit = 1.0 / np.sqrt(np.where(used, diagonal, np.inf))
        plane_unit = 1.0 / np.sqrt(np.einsum("pii->i", normal.local[0]) / self.readings.planes)
        known = (self.pull.ravel() * unit) ** 2
        reduced = normal.reduced(unit, plane_unit, used, known)
        inverse = reduced.covariance(SQUARE_ROUNDING * float(used.sum()))
        self.beam_inverse = np.zeros((len(unit), len(unit)))
        self.beam_inverse[np.ix_(used, used)] = inverse * np.outer(unit[used], unit[used])
        self.plane_inverse = reduced.local_inverse * np.outer(plane_unit, plane_unit)
        self.response = np.zeros((self.readings.planes, PLANE.dim, len(unit)))
        self.response[:, :, used] = plane_unit[:, None] * reduced.local_response / unit[used]

    def log_det_inverse(self) -> float:
        """Return log det of the covariance of all unknowns: of beams and planes in units of sigma^2."""
        used = np.flatnonzero(self.beam_inverse.any(axis=0))
        of_beams = np.linalg.slogdet(self.beam_inverse[np.ix_(used, used)])[1]
        of_freed = np.linalg.slogdet(self.how.sigma**2 * self.freed_inverse)[1]
        return float(of_beams + np.linalg.slogdet(self.plane_inverse)[1].sum() + of_freed)

    def prior_residuals(self, at: Parameters) -> FloatArray:
        """Return the rows (7 B + q, 1) of the priors of range errors and of freed errors."""
        pulled = self.pull.copy()
        pulled[:, MOUNT_DIM:] *= at.range_errors
        return np.concatenate((pulled.ravel(), self.how.sigma * self.freed.size))[:, None]

    def rest(
        self, columns: FloatArray, pulled: FloatArray | None = None
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return columns (N, c), and `pulled` (7 B + q, c) in the priors, without what is explained.

        All unknowns explain: beams, planes and the q freed errors. The third array (7 B + 3 P, c) has
        the beams and planes that explain the rest.
        """
        own = self.pull.size
        if pulled is None:
            pulled = np.zeros((own + len(self.freed.size), columns.shape[1]))
        rest, of_beams, moved = self.beside(columns, pulled[:own])
        if not len(self.freed.size):
            return rest, of_beams, moved
        sigma = self.how.sigma
        products = self.freed_heavy.T @ rest + self.freed_pulled.T @ of_beams
        freed = self.freed_inverse @ (products + sigma * pulled[own:])
        of_priors = of_beams - self.freed_pulled @ freed, pulled[own:] - sigma * freed
        return (
            rest - self.freed_rest @ freed,
            np.concatenate(of_priors),
            moved - self.freed_moved @ freed,
        )

    def beside(
        self, columns: FloatArray, pulled: FloatArray | None = None
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Do as `rest`, but for what freed errors explain.

        Columns are projected twice, which removes what rounding leaves of the first projection.
        """
        rest = columns.copy()
        pulled = np.zeros((self.pull.size, columns.shape[1])) if pulled is None else pulled.copy()
        moved = np.zeros((self.J.shape[1], columns.shape[1]))
        if not columns.shape[1]:
            return rest, pulled, moved
        pull = self.pull.reshape(-1, 1)
        for _ in range(2):
            gradient = self.J.T @ self.how.weighed(rest)
            gradient[: self.pull.size] += pull * pulled
            step = self.following(gradient)
            rest -= self.J @ step
            pulled -= pull * step[: self.pull.size]
            moved += step
        return rest, pulled, moved

    def following(self, gradient: FloatArray) -> FloatArray:
        """Return the beams and planes (7 B + 3 P, c) that follow from gradients by them."""
        response = self.response.reshape(-1, self.pull.size)
        beams, planes = np.split(gradient, [self.pull.size])
        planes = planes.reshape(self.readings.planes, PLANE.dim, -1)
        x = self.beam_inverse @ (beams - response.T @ planes.reshape(len(response), -1))
        y = (self.plane_inverse @ planes).reshape(len(response), -1) - response @ x
        return np.concatenate((x, y))

    def moves(self, unknowns: FloatArray) -> "Moves":
        """Return moves of beams and planes (7 B + 3 P, c) with planes by (n, b)."""
        beams, planes = np.split(unknowns, [self.pull.size])
        lifts = plane_lifts(tangent_basis(self.normals), self.centres)
        return Moves(
            beams.reshape(self.readings.beams, BEAM.dim, -1),
            lifts @ planes.reshape(self.readings.planes, PLANE.dim, -1),
        )

    def weighed_rest(self, columns: FloatArray) -> FloatArray:
        """Return what the unknowns leave of columns (N, c), times sigma^2 inv(C), but for rounding."""
        if self.freed.codes:
            return self.perpendicular(columns)[0]
        step = self.following(self.J.T @ self.how.weighed(columns))
        return self.how.weighed(columns - self.J @ step)

    def perpendicular(self, columns: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return what the `rest` of columns (N, q) weighs, and how the beams move.

        Returns
        -------
        heavy : (N, q)
            The rest times sigma^2 inv(C).
        moved : (7 B, q)
            The beams' part of the unknowns that explain what is not left.
        """
        rest, _, moved = self.rest(columns)
        return self.how.weighed(rest), moved[: self.pull.size]

    def of_residuals(self, rows: LinearRows) -> tuple[FloatArray, float]:
        """Return what the `rest` of the residuals (N,) weighs, and its square, the priors included."""
        residual, priors = rows.residual[:, None], self.prior_residuals(rows.at)
        rest, pulled, _ = self.rest(residual, priors)
        heavy = self.how.weighed(rest)
        return heavy[:, 0], float((rest * heavy).sum() + (pulled**2).sum())


class CoupledProjection(Projection):
    """The same for a whitening that couples readings before several planes: nothing is eliminated.

    `beam_inverse` is of beams and planes together, and no plane is left for `plane_inverse`.
    """

    def _invert(self, normal: Normal, active: BoolArray) -> None:
        """Invert the information of beams and planes together; `normal` is of other weights."""
        del normal
        own = self.pull.size
        information = self.how.information(self.J)
        information[np.arange(own), np.arange(own)] += self.pull.ravel() ** 2
        diagonal = np.diagonal(information)
        active = np.append(active, np.ones(len(diagonal) - own, dtype=bool))
        used = np.flatnonzero(active & (diagonal > 0.0))
        self.unknowns = len(used)
        unit = 1.0 / np.sqrt(diagonal[used])
        scaled = np.linalg.inv(information[np.ix_(used, used)] * np.outer(unit, unit))
        self.beam_inverse = np.zeros_like(information)
        self.beam_inverse[np.ix_(used, used)] = scaled * np.outer(unit, unit)
        self.plane_inverse = np.empty((0, PLANE.dim, PLANE.dim))

    def following(self, gradient: FloatArray) -> FloatArray:
        """Return the beams and planes (7 B + 3 P, c) that follow from gradients by them."""
        return np.asarray(self.beam_inverse @ gradient)
