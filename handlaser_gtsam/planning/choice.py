r"""Choose the stations that shrink the uncertainty of the beams most.

The criteria, of the covariance C of the beams in units of the goal (or of natural units):

    A: trace;  D: logarithm of the determinant;  E: largest eigenvalue;
    spot: trace of the covariance of the laser spots at the working distance

Stations are taken one by one, each the best beside those before (greedy), and are then exchanged for
better ones while that helps (Fedorov). A and spot are tr(M C) with a fixed M; D and E have a different
M at every step, the gradient of the criterion. With the whitened rows A of a station, C becomes

    C - C A' inv(I + A C A') A C

after it (the update of a Kalman filter).

Errors of the hand that change with its pose are the same at all stations, and no unknowns. With F their
effect on whitened rows, and G the sum of A'F over all stations so far, they add C G G'C to the
covariance: a consider covariance (Schmidt, Advances in Control Systems 3, 1966, page 293).
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
    by_pose: FloatArray | None = None,
    exchange: bool = True,
    start: IntArray | None = None,
) -> IntArray:
    """Return chosen stations (M,) among candidates, in the order in which greedy choice takes them.

    Parameters
    ----------
    rows : (K, N, B, U + c)
        Whitened rows A and F of every candidate, at the mean of the belief first and then at draws of
        it: the gain is averaged over all.
    covariance : (U, U) or (K, U, U)
        Before the first station.
    weight : (W, U)
        What is to become small: covariance of `weight @ x`.
    count : int
        How many to choose; no candidate is chosen twice.
    criterion : str
        "A" and "spot" differ by `weight` only.
    by_pose : (U, c), optional
        G before the first station.
    exchange : bool
        Whether to exchange stations afterwards.
    start : (count,), optional
        Candidates to start the exchange from, instead of those that greedy choice takes.
    """
    by_pose = np.zeros((covariance.shape[-1], 0)) if by_pose is None else by_pose
    search = _Exchange(rows, covariance, weight, criterion, by_pose)
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
    again = _Exchange(rows[:1, taken], first, weight, criterion, by_pose)
    for _ in taken:
        again.take(again.best())
    return taken[again.chosen]


class _Exchange:
    """The covariance, and what its products with the candidates' rows say, as stations come and go.

    With W the weight, A C, S = I + A C A' and T = A C W' at the mean of the belief are kept for all
    candidates, and follow C by the same downdate; at draws of the belief only the best candidates are
    looked at.
    """

    def __init__(
        self,
        rows: FloatArray,
        covariance: FloatArray,
        weight: FloatArray,
        criterion: Criterion,
        by_pose: FloatArray,
    ) -> None:
        self.rows, self.F = np.split(rows, [covariance.shape[-1]], axis=-1)
        self.weight, self.criterion = weight, criterion
        self.C = np.broadcast_to(covariance, (len(rows), *covariance.shape[-2:])).copy()
        self.G = np.broadcast_to(by_pose, (len(rows), *by_pose.shape[-2:])).copy()
        self.identity = np.eye(rows.shape[2])
        self.flat = self.rows[0].reshape(-1, self.rows.shape[-1])
        self.AC = (self.flat @ self.C[0]).reshape(self.rows.shape[1:])
        self.T = self.AC @ weight.T
        self.S = self.identity + self.AC @ np.swapaxes(self.rows[0], 1, 2)
        self.chosen: list[int] = []

    def value(self) -> float:
        """Return the criterion at the mean."""
        return value(self.C[0], self.weight, self.criterion, self.G[0])

    def best(self) -> int:
        """Return the candidate that improves the criterion most."""
        gains = self._gains(slice(1), slice(None), self.AC[None], self.S[None], self.T[None])[0]
        gains[self.chosen] = -np.inf
        if len(self.rows) == 1:
            return int(gains.argmax())
        # Candidates that are compared at the draws of the belief, too: draws hardly bring up one
        # beyond.
        short = np.argsort(-gains)[:60]
        A = self.rows[1:, short]
        AC = A @ self.C[1:, None]
        S, T = self.identity + AC @ np.swapaxes(A, -1, -2), AC @ self.weight.T
        others = self._gains(slice(1, None), short, AC, S, T)
        total = gains[short] / gains[short[0]]
        total = total + (others / others.max(axis=1, keepdims=True)).sum(axis=0)
        return int(short[total.argmax()])

    def _gains(
        self, at: slice, some: slice | IntArray, AC: FloatArray, S: FloatArray, T: FloatArray
    ) -> FloatArray:
        """Return what some candidates (n,) gain at some of the mean and the draws (k, n)."""
        C, weight = self.C[at], self.weight
        if self.G.shape[-1]:
            # Of every candidate W C after it, and G.
            WC = (weight @ C)[:, None] - np.swapaxes(T, -1, -2) @ np.linalg.solve(S, AC)
            G = self.G[at, None] + np.swapaxes(self.rows[at, some], -1, -2) @ self.F[at, some]
            moved = WC @ G
            after = WC @ weight.T + moved @ np.swapaxes(moved, -1, -2)
            before = _of_all(C, weight, self.G[at])
            return _values(before, self.criterion)[:, None] - _values(after, self.criterion)
        if self.criterion in ("D", "E"):
            # With M = root root' the criterion falls by tr(M dC) to first order. For E that is the
            # gradient of the 8-norm of the eigenvalues, smooth where another becomes the largest.
            size, axes = np.linalg.eigh(weight @ C @ weight.T)
            power, unit = (-1.0, 1.0) if self.criterion == "D" else (8 - 1, size[:, -1:])
            root = axes * ((size / unit) ** (power / 2.0))[:, None]
            T = T @ root[:, None]
        if self.criterion == "D":
            gained = T @ np.swapaxes(T, -1, -2)
            return np.asarray(np.linalg.slogdet(S)[1] - np.linalg.slogdet(S - gained)[1])
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
        self.G += sign * (np.swapaxes(A, 1, 2) @ self.F[:, candidate])
        V = A @ self.C
        S = self.identity + sign * (V @ np.swapaxes(A, 1, 2))
        step = sign * np.linalg.solve(S, V)
        M = self.flat @ V[0].T
        if self.G.shape[-1]:
            self.AC -= (M @ step[0]).reshape(self.AC.shape)
        self.T -= (M @ (step[0] @ self.weight.T)).reshape(self.T.shape)
        left = (M @ (sign * np.linalg.inv(S[0]))).reshape(self.S.shape)
        self.S -= left @ np.swapaxes(M.reshape(self.S.shape), 1, 2)
        C = self.C - np.swapaxes(V, 1, 2) @ step
        self.C = 0.5 * (C + np.swapaxes(C, 1, 2))


def updates(
    covariance: FloatArray, by_pose: FloatArray, rows: Iterable[FloatArray]
) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Yield C (U, U) and G (U, c) before stations with whitened rows (M, B, U + c), and after each."""
    yield covariance, by_pose
    for station in rows:
        A, F = np.split(station, [len(covariance)], axis=1)
        V = A @ covariance
        S = np.eye(len(V)) + V @ A.T
        covariance = np.asarray(covariance - V.T @ np.linalg.solve(S, V))
        by_pose = by_pose + A.T @ F
        yield covariance, by_pose


def updated(covariance: FloatArray, rows: Iterable[FloatArray]) -> FloatArray:
    """Return the covariance (U, U) after stations with whitened rows (M, B, U)."""
    *_, (last, _) = updates(covariance, covariance[:, :0], rows)
    return last


def value(
    covariance: FloatArray,
    weight: FloatArray,
    criterion: Criterion,
    by_pose: FloatArray | None = None,
) -> float:
    """Return the criterion for C (U, U), a weight (W, U) and G (U, c)."""
    by_pose = covariance[:, :0] if by_pose is None else by_pose
    return float(_values(_of_all(covariance, weight, by_pose), criterion))


def _of_all(C: FloatArray, weight: FloatArray, G: FloatArray) -> FloatArray:
    """Return the covariance (..., W, W) of `weight @ x`."""
    WC = weight @ C
    moved = WC @ G
    return np.asarray(WC @ weight.T + moved @ np.swapaxes(moved, -1, -2))


def _values(covariance: FloatArray, criterion: Criterion) -> FloatArray:
    """Return the criterion (...) for covariances (..., W, W) of what is to become small."""
    if criterion == "D":
        return np.asarray(np.linalg.slogdet(covariance)[1])
    if criterion == "E":
        return np.asarray(np.linalg.eigvalsh(covariance)[..., -1])
    return np.asarray(np.trace(covariance, axis1=-2, axis2=-1))
