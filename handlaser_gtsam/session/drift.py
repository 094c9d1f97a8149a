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

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import accumulate

import numpy as np
from scipy.special import betaln, gammaln

from .. import model
from ..arrays import FloatArray, IntArray
from ..data.value import Value
from ..estimation.information import Information
from ..model.distributions import chi2_sf, f_sf
from ..model.families import BEAM, MOUNT_DIM
from ..quantities import KNOWN
from .reference import Reference

FALSE_ALARMS = 2e-5
"""Probability that a search finds a move where there is none; a session searches at every change."""


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Moved(Value):
    """A beam that has moved.

    Attributes
    ----------
    beam : str
    since : str
        The first plane that saw it moved.
    statistic : float
        Fall of chi2.
    p_value : float
        Probability of so clear a sign if nothing has moved, all epochs and beams considered.
    shift : (3,)
        Move of its location [m]; NaN where it has moved so far that planes fit only without it.
    turn : float
        Turn of its direction [rad]; NaN likewise.
    """

    beam: str
    since: str
    statistic: float
    p_value: float
    shift: FloatArray
    turn: float


@dataclass(frozen=True, slots=True)
class DriftHistory:
    """Running totals of the information of the planes, in the order in which they came.

    Attributes
    ----------
    reference : Reference
    known : Information
        Information beside the planes.
    planes : tuple of str
    pieces : tuple of Information
        Information of each plane.
    totals : tuple of Information
        Information of the first 1, 2, ... planes.
    """

    reference: Reference
    known: Information
    planes: tuple[str, ...] = ()
    pieces: tuple[Information, ...] = ()
    totals: tuple[Information, ...] = ()

    @classmethod
    def empty(
        cls, reference: Reference, links: Sequence[tuple[int, int, FloatArray]]
    ) -> "DriftHistory":
        """Return a history without planes.

        Parameters
        ----------
        reference : Reference
        links : sequence of (beam, beam, sigmas (7,))
            Process noise between two beams, in SI units.
        """
        size = len(reference.unit)
        matrix, vector = np.zeros((size, size)), np.zeros(size)
        active = reference.active.tolist()
        basis = model.tangent_basis(reference.beams[1])
        for a, b, sigmas in links:
            rows = [active.index(BEAM.dim * a + i) for i in range(MOUNT_DIM + reference.terms[a])]
            other = [active.index(BEAM.dim * b + i) for i in range(MOUNT_DIM + reference.terms[b])]
            J = np.zeros((len(rows), size))
            J[:, rows], J[:, other] = -np.eye(len(rows)), np.eye(len(rows))
            J[3:5, other[3:5]] = basis[a].T @ basis[b]
            error = np.concatenate(
                (
                    reference.beams[0][b] - reference.beams[0][a],
                    basis[a].T @ (reference.beams[1][b] - reference.beams[1][a]),
                    (reference.beams[2][b] - reference.beams[2][a])[: reference.terms[a]],
                )
            )
            J = J * reference.unit / sigmas[: len(rows), None]
            matrix += J.T @ J
            vector -= J.T @ (error / sigmas[: len(rows)])
        return cls(reference, Information(matrix, vector, np.zeros(())))

    def with_plane(self, name: str, piece: Information) -> "DriftHistory":
        """Return the history with one more plane, or with more known of one."""
        if name not in self.planes:
            total = piece + self.totals[-1] if self.totals else piece
            return DriftHistory(
                self.reference,
                self.known,
                (*self.planes, name),
                (*self.pieces, piece),
                (*self.totals, total),
            )
        index = self.planes.index(name)
        return self._summed(self.planes, (*self.pieces[:index], piece, *self.pieces[index + 1 :]))

    def with_planes(self, planes: Sequence[str], pieces: Sequence[Information]) -> "DriftHistory":
        """Return the history of these planes and no others."""
        return self._summed(tuple(planes), tuple(pieces))

    def without_plane(self, name: str) -> "DriftHistory":
        """Return the history without a plane, whether it is there or not."""
        if name not in self.planes:
            return self
        index = self.planes.index(name)
        planes = self.planes[:index] + self.planes[index + 1 :]
        return self._summed(planes, self.pieces[:index] + self.pieces[index + 1 :])

    def _summed(self, planes: tuple[str, ...], pieces: tuple[Information, ...]) -> "DriftHistory":
        totals = tuple(accumulate(pieces))
        return DriftHistory(self.reference, self.known, planes, pieces, totals)

    def recent(self) -> IntArray:
        """Return the epochs 1, 2, 4, ... planes ago, as numbers of planes before them."""
        count = len(self.planes)
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
        count = len(self.planes)
        if epochs is None:
            epochs = np.arange(1, count)
        if not epochs.size:
            return None
        whole = self.totals[-1]
        if np.linalg.eigvalsh(whole.matrix)[0] < KNOWN**-2:
            # Otherwise the process noise that is assumed of a move would count as a sign of one.
            whole = whole + self.known
        try:
            x = np.linalg.solve(whole.matrix, whole.vector)
            covariance = np.linalg.inv(whole.matrix)
        except np.linalg.LinAlgError:
            return None
        late = [self.totals[-1] - self.totals[epoch - 1] for epoch in epochs.tolist()]
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
        beams = self.reference.moves()
        values, axes = np.linalg.eigh(M[:, beams[:, :, None], beams[:, None, :]])
        along = np.einsum("ebji,ebj->ebi", axes, s[:, beams])
        keep = values > KNOWN**-2
        safe = np.where(keep, values, 1.0)
        rank = keep.sum(axis=2)
        statistic = np.where(keep, along**2 / safe, 0.0).sum(axis=2)
        moves = np.einsum("ebij,ebj->ebi", axes, np.where(keep, along / safe, 0.0))
        log_p = np.where(rank > 0, _log_p(statistic, np.maximum(rank, 1), dof), 0.0)
        best = np.unravel_index(int(np.argmin(log_p)), log_p.shape)
        d = moves[best] * self.reference.unit[beams[best[1]]]
        return Moved(
            self.reference.names[best[1]],
            self.planes[int(epochs[best[0]])],
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
