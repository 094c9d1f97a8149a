r"""Whether a beam has moved while planes came in, which one, and since when.

Near the present beams plane p, with itself fitted, knows of the beams x the information L_p and
h_p = L_p x_p. Over all planes, and what is known beside them, x = inv(T) h. If beam i has moved by d
before the planes A that came after some epoch, the score of d at x and its variance are

    s = h_A - L_A x,    M = L_A - L_A inv(T) L_A    (rows and columns of beam i),

and chi2 falls by s' M^+ s: chi-square distributed if nothing has moved, with as many degrees of freedom
as M has rank. Sums over A are differences of running totals, so that an epoch costs the same however
many planes there are. Every epoch and beam is a test; the smallest probability counts, times their
number.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from itertools import accumulate

import numpy as np
from scipy.special import betaln, gammaln

from .. import model
from ..arrays import BoolArray, FloatArray, IntArray
from ..data.parameters import Beams
from ..estimation.information import Information
from ..model.distributions import chi2_sf, f_sf
from ..model.families import BEAM, DIRECTION, MOUNT_DIM, modelled
from ..quantities import KNOWN
from .config import ProcessNoise, SessionConfig
from .reports import Moved

FALSE_ALARMS = 2e-5
"""Probability that a search finds a move where there is none; a session searches at every change."""


@dataclass(frozen=True, slots=True)
class DriftHistory:
    """Beams that unknowns are counted from, and what the planes know of them, in their order.

    Unknowns are in natural units: the typical range, 1 rad.

    Attributes
    ----------
    config : SessionConfig
    beams : Beams
    known : Information
        Information beside the planes.
    pieces : mapping of str to Information
        Information of each plane, by its name.
    """

    config: SessionConfig
    beams: Beams
    known: Information
    pieces: Mapping[str, Information] = field(default_factory=dict)

    @classmethod
    def empty(cls, config: SessionConfig, beams: Beams) -> "DriftHistory":
        """Return a history without planes, counted from these beams."""
        size = int(modelled(config.terms).sum())
        nothing = Information(np.zeros((size, size)), np.zeros(size), np.zeros(()))
        history = cls(config, beams, nothing)
        for link in config.links:
            history = replace(history, known=history.known + history.linked(link))
        return history

    def linked(self, link: ProcessNoise) -> Information:
        """Return what process noise between two beams says of all."""
        size, basis = len(self.unit), model.tangent_basis(self.beams[1])
        active, a, b = self.active.tolist(), link.before, link.now
        rows = [active.index(BEAM.dim * a + i) for i in range(MOUNT_DIM + self.config.terms[a])]
        other = [active.index(BEAM.dim * b + i) for i in range(MOUNT_DIM + self.config.terms[b])]
        J = np.zeros((len(rows), size))
        J[:, rows], J[:, other] = -np.eye(len(rows)), np.eye(len(rows))
        J[DIRECTION, other[DIRECTION]] = basis[a].T @ basis[b]
        shift, turn, stretch = (array[b] - array[a] for array in self.beams)
        error = np.concatenate((shift, basis[a].T @ turn, stretch[: self.config.terms[a]]))
        location, direction = [link.location_sigma] * 3, [link.direction_sigma] * 2
        sigmas = np.array([*location, *direction, *link.range_error_sigmas])[: len(rows)]
        J = J * self.unit / sigmas[:, None]
        return Information(J.T @ J, -J.T @ (error / sigmas), np.zeros(()))

    @property
    def mask(self) -> BoolArray:
        """Whether each of 7 unknowns a beam is estimated."""
        return modelled(self.config.terms).ravel()

    @property
    def active(self) -> IntArray:
        """Which of 7 unknowns a beam are estimated."""
        return np.flatnonzero(self.mask)

    @property
    def unit(self) -> FloatArray:
        """Natural units of the active unknowns."""
        return np.tile(BEAM.natural_units(self.config.length), len(self.config.terms))[self.active]

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

    def with_plane(self, name: str, piece: Information) -> "DriftHistory":
        """Return the history with one more plane, or with more known of one."""
        return replace(self, pieces={**self.pieces, name: piece})

    def without_plane(self, name: str) -> "DriftHistory":
        """Return the history without a plane, whether it is there or not."""
        pieces = {plane: piece for plane, piece in self.pieces.items() if plane != name}
        return replace(self, pieces=pieces)

    def recent(self) -> IntArray:
        """Return the epochs 1, 2, 4, ... planes ago, as numbers of planes before them."""
        count = len(self.pieces)
        back = 2 ** np.arange(max(count, 1).bit_length())
        return count - back[back < count]

    def search(
        self, dof: float, epochs: IntArray | None = None, false_alarms: float = FALSE_ALARMS
    ) -> Moved | None:
        """Return the beam that has moved; None where there is no clear sign of it.

        Parameters
        ----------
        dof : float
            Degrees of freedom behind the range sigma; infinite where it was given.
        epochs : (E,), optional
            Numbers of planes before the move; all where not given, and once any of them shows a move.
        false_alarms : float
            Probability of finding one where nothing has moved.
        """
        count = len(self.pieces)
        if epochs is None:
            epochs = np.arange(1, count)
        if not epochs.size:
            return None
        totals = list(accumulate(self.pieces.values()))
        whole = totals[-1]
        if np.linalg.eigvalsh(whole.matrix)[0] < KNOWN**-2:
            # Otherwise the process noise that is assumed of a move would count as a sign of one.
            whole = whole + self.known
        try:
            x = np.linalg.solve(whole.matrix, whole.vector)
            covariance = np.linalg.inv(whole.matrix)
        except np.linalg.LinAlgError:
            return None
        late = [totals[-1] - totals[epoch - 1] for epoch in epochs.tolist()]
        L = np.stack([information.matrix for information in late])
        s = np.stack([information.vector for information in late]) - L @ x
        M = L - L @ covariance @ L
        clearest = self._clearest(s, M, dof, epochs)
        if clearest.p_value >= false_alarms:
            return None
        if len(epochs) == count - 1:
            return clearest
        return self.search(dof, None, false_alarms)  # something has moved: look at every epoch

    def _clearest(self, s: FloatArray, M: FloatArray, dof: float, epochs: IntArray) -> Moved:
        beams = self.moves()
        values, axes = np.linalg.eigh(M[:, beams[:, :, None], beams[:, None, :]])
        along = np.einsum("ebji,ebj->ebi", axes, s[:, beams])
        keep = values > KNOWN**-2
        safe = np.where(keep, values, 1.0)
        rank = keep.sum(axis=2)
        statistic = np.where(keep, along**2 / safe, 0.0).sum(axis=2)
        moves = np.einsum("ebij,ebj->ebi", axes, np.where(keep, along / safe, 0.0))
        log_p = np.where(rank > 0, _log_p(statistic, np.maximum(rank, 1), dof), 0.0)
        best = np.unravel_index(int(np.argmin(log_p)), log_p.shape)
        d = moves[best] * self.unit[beams[best[1]]]
        return Moved(
            self.config.names[best[1]],
            list(self.pieces)[int(epochs[best[0]])],
            float(statistic[best]),
            min(float(np.exp(log_p[best])) * log_p.size, 1.0),
            d[:3],
            float(np.linalg.norm(d[3:])),
        )


def _log_p(statistic: FloatArray, rank: IntArray, dof: float) -> FloatArray:
    """Return the logarithm of the probability of a larger statistic, beyond the smallest number too."""
    with np.errstate(divide="ignore"):
        if np.isinf(dof):
            log_p = np.log(chi2_sf(statistic, rank))
            half = np.maximum(0.5 * statistic, 1.0)
            tail = (0.5 * rank - 1.0) * np.log(half) - half - gammaln(0.5 * rank)
        else:
            log_p = np.log(f_sf(statistic / rank, rank, dof))
            a = 0.5 * dof
            tail = a * np.log(dof / (dof + statistic)) - np.log(a) - betaln(a, 0.5 * rank)
    return np.where(np.isfinite(log_p), log_p, tail)


def turns(directions: FloatArray, history: DriftHistory) -> FloatArray:
    """Return the matrix from unknowns in the bases of a history to unknowns in the bases here."""
    here, there = model.tangent_basis(directions), model.tangent_basis(history.beams[1])
    turns = np.tile(np.eye(BEAM.dim), (len(directions), 1, 1))
    turns[:, DIRECTION, DIRECTION] = np.swapaxes(here, 1, 2) @ there
    whole = np.zeros((len(directions), BEAM.dim, len(directions), BEAM.dim))
    each = np.arange(len(directions))
    whole[each, :, each, :] = turns
    size, active = BEAM.dim * len(directions), history.active
    matrix: FloatArray = whole.reshape(size, size)[np.ix_(active, active)]
    return matrix
