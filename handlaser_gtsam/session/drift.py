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
from scipy.linalg import block_diag
from scipy.special import betaln, gammaln

from .. import model
from ..arrays import BoolArray, FloatArray, IntArray
from ..data.parameters import Beams
from ..estimation.information import Information
from ..model.distributions import chi2_sf, f_sf
from ..model.families import BEAM, DIRECTION, MOUNT_DIM, modelled
from ..quantities import KNOWN
from .config import SessionConfig
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
        """Return a history without planes, counted from these beams.

        What process noise between two beams says of all is known beside the planes.
        """
        size, basis = int(modelled(config.terms).sum()), model.tangent_basis(beams[1])
        known = Information(np.zeros((size, size)), np.zeros(size), np.zeros(()))
        history = cls(config, beams, known)
        place = np.cumsum(history.mask) - 1
        for link in config.links:
            a, b, own = link.before, link.now, np.arange(MOUNT_DIM + config.terms[link.before])
            rows, other = place[BEAM.dim * a + own], place[BEAM.dim * b + own]
            J = np.zeros((len(own), size))
            J[:, rows], J[:, other] = -np.eye(len(own)), np.eye(len(own))
            J[DIRECTION, other[DIRECTION]] = basis[a].T @ basis[b]
            shift, turn, stretch = (array[b] - array[a] for array in beams)
            error = np.concatenate((shift, basis[a].T @ turn, stretch))[: len(own)]
            mount = [link.location_sigma] * 3 + [link.direction_sigma] * 2
            sigmas = np.array([*mount, *link.range_error_sigmas])[: len(own)]
            J = J * history.unit / sigmas[:, None]
            known = known + Information(J.T @ J, -J.T @ (error / sigmas), np.zeros(()))
        return replace(history, known=known)

    @property
    def mask(self) -> BoolArray:
        """Whether each of 7 unknowns a beam is estimated."""
        return modelled(self.config.terms).ravel()

    @property
    def unit(self) -> FloatArray:
        """Natural units of the active unknowns."""
        return np.tile(BEAM.natural_units(self.config.length), len(self.config.terms))[self.mask]

    def moves(self) -> IntArray:
        """Return which of the active unknowns belong to the mount of each beam, (B, 5)."""
        active = np.flatnonzero(self.mask)
        return np.flatnonzero(active % BEAM.dim < MOUNT_DIM).reshape(-1, MOUNT_DIM)

    def coordinates(self, beams: Beams) -> FloatArray:
        """Return the unknowns of other beams."""
        shift, turn, stretch = (there - here for there, here in zip(beams, self.beams, strict=True))
        tilt = np.einsum("bij,bi->bj", model.tangent_basis(self.beams[1]), turn)
        return np.asarray(np.hstack((shift, tilt, stretch)).ravel()[self.mask] / self.unit)

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

    def search(self, dof: float, epochs: IntArray | None = None) -> Moved | None:
        """Return the beam that has moved; None where there is no clear sign of it.

        Parameters
        ----------
        dof : float
            Degrees of freedom behind the range sigma; infinite where it was given.
        epochs : (E,), optional
            Numbers of planes before the move; all where not given, and once any of them shows a move.
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
        beams = self.moves()
        values, axes = np.linalg.eigh(M[:, beams[:, :, None], beams[:, None, :]])
        along = np.einsum("ebji,ebj->ebi", axes, s[:, beams])
        keep = values > KNOWN**-2
        safe = np.where(keep, values, 1.0)
        rank = keep.sum(axis=2)
        statistic = np.where(keep, along**2 / safe, 0.0).sum(axis=2)
        log_p = np.where(rank > 0, _log_p(statistic, np.maximum(rank, 1), dof), 0.0)
        best = np.unravel_index(int(np.argmin(log_p)), log_p.shape)
        p_value = min(float(np.exp(log_p[best])) * log_p.size, 1.0)
        if p_value >= FALSE_ALARMS:
            return None
        if len(epochs) < count - 1:
            return self.search(dof)  # something has moved: look at every epoch
        d = axes[best] @ np.where(keep, along / safe, 0.0)[best] * self.unit[beams[best[1]]]
        return Moved(
            self.config.names[best[1]],
            list(self.pieces)[int(epochs[best[0]])],
            float(statistic[best]),
            p_value,
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
    return np.asarray(block_diag(*turns)[np.ix_(history.mask, history.mask)])
