r"""Choose the stations that shrink the uncertainty of the beams most.

The criteria, of the covariance C of the beams in units of the goal (or of natural units):

    A: trace;  D: logarithm of the determinant;  E: largest eigenvalue;
    spot: trace of the covariance of the laser spots at the working distance

Stations are taken one by one, each the best beside those before (greedy), and are then exchanged for
better ones while that helps (Fedorov). A and spot are tr(M C) with a fixed M; D and E have a different
M at every step, the gradient of the criterion. With the whitened rows A of a station, C becomes

    C - C A' inv(I + A C A') A C

after it (the update of a Kalman filter).
"""

from collections.abc import Iterable, Iterator
from typing import Literal

import numpy as np

from ..arrays import FloatArray, IntArray

Criterion = Literal["A", "D", "E", "spot"]
CRITERIA: tuple[Criterion, ...] = ("A", "D", "E", "spot")


def choose(
    rows: FloatArray,
    covariance: FloatArray,
    weight: FloatArray,
    count: int,
    criterion: Criterion = "A",
    *,
    exchange: bool = True,
    start: IntArray | None = None,
) -> IntArray:
    """Return chosen stations (M,) among candidates, in the order in which greedy choice takes them.

    Parameters
    ----------
    rows : (K, N, B, U)
        Whitened rows of every candidate, at the mean of the belief first and then at draws of it: the
        gain is averaged over all.
    covariance : (U, U) or (K, U, U)
        Before the first station.
    weight : (W, U)
        What is to become small: covariance of `weight @ x`.
    count : int
        How many to choose; no candidate is chosen twice.
    criterion : str
        "A" and "spot" differ by `weight` only.
    exchange : bool
        Whether to exchange stations afterwards.
    start : (count,), optional
        Candidates to start the exchange from, instead of those that greedy choice takes.
    """
    search = _Exchange(rows, covariance, weight, criterion)
    for step in range(min(count, rows.shape[1])):
        search.take(search.best() if start is None else int(start[step]))
    for _ in range(3 if exchange else 0):  # the first brings nearly all of the gain
        before = search.value()
        for place in range(len(search.chosen)):
            search.drop(place)
            search.take(search.best(), place)
        # A round of exchanges that lowers the criterion by less than this part is the last.
        if search.value() > before - 1e-3 * abs(before):
            break
    taken = np.array(search.chosen, dtype=np.intp)
    first = covariance if covariance.ndim == 2 else covariance[0]
    again = _Exchange(rows[:1, taken], first, weight, criterion)
    for _ in taken:
        again.take(again.best())
    return taken[again.chosen]


class _Exchange:
    """The covariance, and what its products with the candidates' rows say, as stations come and go.

    With A the rows of a candidate and W the weight, S = I + A C A' and T = A C W' at the mean of the
    belief are kept for all candidates, and follow C by the same downdate; at draws of the belief only
    the best candidates are looked at.
    """

    def __init__(
        self, rows: FloatArray, covariance: FloatArray, weight: FloatArray, criterion: Criterion
    ) -> None:
        self.rows, self.weight, self.criterion = rows, weight, criterion
        self.C = np.broadcast_to(covariance, (len(rows), *covariance.shape[-2:])).copy()
        self.identity = np.eye(rows.shape[2])
        self.flat = rows[0].reshape(-1, rows.shape[-1])
        AC = self.flat @ self.C[0]
        self.T = (AC @ weight.T).reshape(*rows.shape[1:3], -1)
        self.S = self.identity + AC.reshape(rows.shape[1:]) @ np.swapaxes(rows[0], 1, 2)
        self.chosen: list[int] = []

    def value(self) -> float:
        """Return the criterion at the mean."""
        return value(self.C[0], self.weight, self.criterion)

    def best(self) -> int:
        """Return the candidate that improves the criterion most."""
        gains = self._gains(self.S, self.T, self.C[:1])
        gains[self.chosen] = -np.inf
        if len(self.rows) == 1:
            return int(gains.argmax())
        # Candidates that are compared at the draws of the belief, too: draws hardly bring up one
        # beyond.
        short = np.argsort(-gains)[:60]
        A, C = self.rows[1:, short], self.C[1:]
        AC = A @ C[:, None]
        S, T = self.identity + AC @ np.swapaxes(A, -1, -2), AC @ self.weight.T
        others = self._gains(S, T, C)
        total = gains[short] / gains[short[0]]
        total = total + (others / others.max(axis=1, keepdims=True)).sum(axis=0)
        return int(short[total.argmax()])

    def _gains(self, S: FloatArray, T: FloatArray, C: FloatArray) -> FloatArray:
        """Return what candidates gain (..., N), given their S (..., N, B, B) and T (..., N, B, W)."""
        if self.criterion in ("D", "E"):
            # With M = root root' the criterion falls by tr(M dC) to first order. For E that is the
            # gradient of the 8-norm of the eigenvalues, smooth where another becomes the largest.
            size, axes = np.linalg.eigh(self.weight @ C @ self.weight.T)
            power, unit = (-1.0, 1.0) if self.criterion == "D" else (8 - 1, size[:, -1:])
            root = axes * ((size / unit) ** (power / 2.0))[:, None]
            T = T @ (root[0] if T.ndim == 3 else root[:, None])
        if self.criterion == "D":
            G = T @ np.swapaxes(T, -1, -2)
            return np.asarray(np.linalg.slogdet(S)[1] - np.linalg.slogdet(S - G)[1])
        return np.asarray((T * (np.linalg.inv(S) @ T)).sum(axis=(-2, -1)))  # tr(T' inv(S) T)

    def take(self, candidate: int, place: int | None = None) -> None:
        """Add a candidate, at its place in the order."""
        self._update(candidate, 1.0)
        self.chosen.insert(len(self.chosen) if place is None else place, candidate)

    def drop(self, place: int) -> None:
        """Remove what was taken at a place."""
        self._update(self.chosen.pop(place), -1.0)

    def _update(self, candidate: int, sign: float) -> None:
        A = self.rows[:, candidate]
        V = A @ self.C
        S = self.identity + sign * (V @ np.swapaxes(A, 1, 2))
        step = sign * np.linalg.solve(S, V)
        M = self.flat @ V[0].T
        self.T -= (M @ (step[0] @ self.weight.T)).reshape(self.T.shape)
        left = (M @ (sign * np.linalg.inv(S[0]))).reshape(self.S.shape)
        self.S -= left @ np.swapaxes(M.reshape(self.S.shape), 1, 2)
        C = self.C - np.swapaxes(V, 1, 2) @ step
        self.C = 0.5 * (C + np.swapaxes(C, 1, 2))


def updates(covariance: FloatArray, rows: Iterable[FloatArray]) -> Iterator[FloatArray]:
    """Yield the covariance (U, U) before stations with whitened rows (M, B, U), and after each."""
    yield covariance
    for station in rows:
        V = station @ covariance
        S = np.eye(len(V)) + V @ station.T
        covariance = np.asarray(covariance - V.T @ np.linalg.solve(S, V))
        yield covariance


def updated(covariance: FloatArray, rows: Iterable[FloatArray]) -> FloatArray:
    """Return the covariance (U, U) after stations with whitened rows (M, B, U)."""
    *_, last = updates(covariance, rows)
    return last


def value(covariance: FloatArray, weight: FloatArray, criterion: Criterion) -> float:
    """Return the criterion for a covariance (U, U) and a weight (W, U)."""
    C = weight @ covariance @ weight.T
    if criterion == "D":
        return float(np.linalg.slogdet(C)[1])
    if criterion == "E":
        return float(np.linalg.eigvalsh(C)[-1])
    return float(np.trace(C))
