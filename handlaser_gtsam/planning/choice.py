r"""Choose the stations that shrink the uncertainty of the mounts most, and forecast what they bring.

The residuals of one station are A x, with x the deviation of the unknowns and A (B, U) whitened. From
the covariance C before the station follows

    C - C A' inv(I + A C A') A C

after it (the update of a Kalman filter). The criterion is tr(W C W'): the sum of the variances of what
is to become small, W x. Stations are taken one by one, each the best beside those before (greedy), and
are then exchanged for better ones (Fedorov).
"""

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from ..arrays import FloatArray, IntArray
from ..quantities import KNOWN
from ..results.spot_error import radius
from .goal import Forecast, Goal, Mount, goal_rows


class Known(NamedTuple):
    """What is known before the next stations, and what they are chosen for.

    Attributes
    ----------
    covariance : (U, U)
        Of all unknowns.
    mounts : sequence of Mount
        What the goal asks of every beam or sensor.
    goal : Goal
    distance : float
        Working distance of the spots [m].
    unit : (U,), optional
        Natural units of the unknowns, where some of them are still undetermined.
    """

    covariance: FloatArray
    mounts: Sequence[Mount]
    goal: Goal
    distance: float
    unit: FloatArray | None = None

    def chosen(self, rows: FloatArray, count: int) -> IntArray:
        """Return the best stations by `choose`, of those with whitened rows (N, B, U)."""
        return choose(rows, self.covariance, goal_rows(self.goal, self.mounts), count)

    def enough(self, rows: FloatArray, count: int) -> IntArray:
        """Return the best stations, as many as reach the goal where it states anything."""
        for _ in range(2):  # the fewer that the goal takes are chosen for themselves
            chosen = self.chosen(rows, count)
            reached = self.forecast(rows[chosen]).reaches(self.goal)
            if reached is None:
                break
            count = max(reached, 1)
        return chosen[:count]

    def forecast(self, rows: FloatArray) -> Forecast:
        """Return what will be known after each of some stations; NaN while anything is undetermined."""
        sigmas, determined, unit = [], False, self.unit
        for C in updates(self.covariance, rows):
            if not determined:  # as a calibration judges it
                determined = unit is None or bool(
                    np.linalg.eigvalsh(C / np.outer(unit, unit))[-1] < KNOWN**2
                )
            location = max(np.diagonal(m.location @ C @ m.location.T).max() for m in self.mounts)
            turns = (m.turns @ C @ np.swapaxes(m.turns, 1, 2) for m in self.mounts)
            direction = max(np.linalg.eigvalsh(turn).max() for turn in turns)
            spot = max(radius(m.spot @ C @ m.spot.T) for m in self.mounts)
            known = math.sqrt(location), math.sqrt(direction), spot
            sigmas.append(known if determined else (math.nan,) * 3)
        location, direction, spot = np.array(sigmas).T
        return Forecast(location, direction, spot, self.distance)


def updates(covariance: FloatArray, rows: FloatArray) -> Iterator[FloatArray]:
    """Yield the covariance (U, U) before stations with whitened rows (M, B, U), and after each."""
    yield covariance
    for station in rows:
        V = station @ covariance
        S = np.eye(len(V)) + V @ station.T
        covariance = np.asarray(covariance - V.T @ np.linalg.solve(S, V))
        yield covariance


def updated(covariance: FloatArray, rows: FloatArray) -> FloatArray:
    """Return the covariance (U, U) after stations with whitened rows (M, B, U)."""
    *_, last = updates(covariance, rows)
    return last


def choose(rows: FloatArray, covariance: FloatArray, weight: FloatArray, count: int) -> IntArray:
    """Return chosen stations (M,) among candidates, in the order in which greedy choice takes them.

    Parameters
    ----------
    rows : (N, B, U)
        Whitened rows of every candidate.
    covariance : (U, U)
        Before the first station.
    weight : (W, U)
        What is to become small: the covariance of `weight @ x`.
    count : int
        How many to choose; no candidate is chosen twice.
    """
    search = _Search(rows, covariance, weight)
    chosen: list[int] = []
    for _ in range(min(count, len(rows))):
        chosen.append(search.best(chosen))
        search.update(chosen[-1], 1.0)
    for _ in range(2):  # the first round brings nearly all of the gain
        for place in range(len(chosen)):
            search.update(chosen[place], -1.0)
            chosen[place] = search.best(chosen[:place] + chosen[place + 1 :])
            search.update(chosen[place], 1.0)
    left = np.array(chosen, dtype=np.intp)
    again, order = _Search(rows[left], covariance, weight), list[int]()
    for _ in left:
        order.append(again.best(order))
        again.update(order[-1], 1.0)
    return left[order]


class _Search:
    """The covariance, and what its products with the candidates' rows say, as stations come and go.

    With A the rows of a candidate and W the weight, S = I + A C A' and T = A C W' are kept for all
    candidates, and follow C by the same update.
    """

    def __init__(self, rows: FloatArray, covariance: FloatArray, weight: FloatArray) -> None:
        self.rows, self.weight, self.C = rows, weight, covariance
        self.identity = np.eye(rows.shape[1])
        self.flat = rows.reshape(-1, rows.shape[2])
        AC = self.flat @ covariance
        self.T = (AC @ weight.T).reshape(*rows.shape[:2], -1)
        self.S = self.identity + AC.reshape(rows.shape) @ np.swapaxes(rows, 1, 2)

    def best(self, taken: list[int]) -> int:
        """Return the candidate that lowers the criterion most, by tr(T' inv(S) T), beside others."""
        gains = (self.T * (np.linalg.inv(self.S) @ self.T)).sum(axis=(1, 2))
        gains[taken] = -np.inf
        return int(gains.argmax())

    def update(self, candidate: int, sign: float) -> None:
        """Add a candidate with a sign of 1, or remove it with -1."""
        A = self.rows[candidate]
        V = A @ self.C
        K = sign * np.linalg.inv(self.identity + sign * (V @ A.T))
        M = self.flat @ V.T
        self.T -= (M @ (K @ (V @ self.weight.T))).reshape(self.T.shape)
        self.S -= (M @ K).reshape(self.S.shape) @ np.swapaxes(M.reshape(self.S.shape), 1, 2)
        C = self.C - V.T @ (K @ V)
        self.C = 0.5 * (C + C.T)
