r"""How much later readings are stamped than poses of the same moment, from the motion itself.

With poses R(t), p(t) and readings d_i stamped t_i, a beam before a plane obeys at the right lag tau

    n . (p + R (r + d v)) + b = 0,    R and p at t_i - tau,

which, divided by the mean of n . R v, is linear in the products of mount and plane, whatever they are:

    d = d (R - R_mean) : M + R : N + p . q + c    (9 + 9 + 3 + 1 coefficients).

That lag leaves the smallest sum of squares S(tau), added over planes and beams. It is looked for near
the stated lag, and near offsets that velocities suggest (`candidate_offsets`). Motion that stops, turns
back or changes its speed identifies it; a sweep at constant speed does not. Where several offsets fit
alike, none is chosen unless it is near the stated lag.

From there on the lag is an unknown of the calibration itself, as systematic errors are that are free
(`results.freed`): with the residuals e of beams and planes solved at tau, of variance s^2, and what
these leave of the derivative of e by tau, a,

    tau <- tau - a'e / a'a,    var(tau) = s^2 / a'a.

The derivative is a difference over some steps of the recorded poses (`STEPS_APART`).

Before a plane, the rate of a range is linear in the hand's velocity w (6,), of its position and of its
turn in the world, with coefficients that change little unless the hand turns far. So an offset of two
clocks is where one set of coefficients explains the rates y_i of each beam best,

    rho(tau) = sum_i b_i' G^-1 b_i / y_i' y_i,    b_i(tau) = sum_t y_i(t) w(t - tau),    G = sum_t w w',

whether the arm stops or not. Where planes are turned far from one another one set explains little, but
an arm that stops shows when: an offset is also where hand and readings move at the same times.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.ndimage import median_filter
from scipy.spatial.transform import Rotation

from ...arrays import BoolArray, FloatArray, IntArray, evenly
from ...data.readings import Readings
from ...errors import InputError
from ...estimation.options import RANGE_ERROR_TERMS
from ...model.equation import residuals_or_infinite
from ...model.families import count_unknowns
from ...model.search import LevenbergOptions
from ...model.weighting import Variances, whitening
from ...quantities import (
    FAR_SIGMAS,
    MOST_ROUNDS,
    NUMBERS_AT_ONCE,
    ROUNDING,
    SAME_OPTIMUM,
    SINGULAR,
)
from ...results.projection import LinearRows, Projection
from ...solvers.many_problems import solve_together
from ...starts import find_start
from .motion import MOVES_M, MOVES_RAD, interpolated, neighbours
from .stands import Track

REACH = 0.5
"""Lags up to this [s] from an offset are looked for."""
COARSE, FINE = 0.04, 0.002
"""First and last steps of the search [s]."""
WORST_SIGMA = 0.01
"""A standard deviation above this [s] says that the motion does not tell the lag."""
INTERPOLATED = 1e-4
"""The interpolation between two poses may move the minimum by this much [s]."""
UNEXPLAINED = 0.1
"""A larger part of the variance of readings than this says that they do not follow the motion."""
STEPS_APART = 2.0
"""Steps between recorded poses to either side over which residuals are differenced. Poses that err by
0.3 mm moved the lag by 0.40, 0.09 and 0.08 ms (rms) with a sixteenth of a step, one and two."""
AS_GOOD = 4.0
"""What leaves less than this factor of the mean square of another fits as well: another offset as the
best one, and a calibration as the linear equation."""
STEP = 0.02
"""Step [s] in which velocities and rates are taken for offsets of two clocks."""
LONGEST_MOVE = 15.0
"""A longer move [s] is not the way from one plane to another, but of an arm that never stops."""
LEAST_READINGS = 264
"""Readings of a beam before a plane: twelve for each coefficient."""
MOST_READINGS = 1500
"""Readings of one plane and beam that are looked at, evenly spread."""


Part = tuple[int, IntArray, FloatArray, FloatArray]
"""A plane, beams (b,) before it, times (N,) [s] and readings (N, b) [m]."""


class _Candidate(NamedTuple):
    """The best lag near an offset [s], and the sum of squares that the linear equation leaves there.

    `variation` is the sum of squares of readings about their means; `number` counts readings.
    """

    lag: float
    squares: float
    variation: float
    number: int
    parts: list[Part]

    @property
    def gain(self) -> float:
        """How much likelier the readings are than if they did not follow the motion: a logarithm."""
        return float(self.number * np.log(self.variation / self.squares))

    def as_good_as(self, other: "_Candidate") -> bool:
        """Whether it leaves as little as another one, of readings that are not far fewer."""
        least = AS_GOOD * other.squares / other.number
        return self.squares < least * self.number and 2 * self.number > other.number


def estimated_lag(
    track: Track,
    time: FloatArray,
    d: FloatArray,
    plane_of: Callable[[FloatArray], IntArray],
    near: float = 0.0,
) -> tuple[float, float]:
    """Return how much later readings are stamped than poses of the same moment, and its sigma [s].

    Parameters
    ----------
    track : Track
    time : (N,)
        Stamps of readings [s], increasing.
    d : (N, B)
        Readings [m]; NaN where there is none.
    plane_of : callable
        Returns which plane each row looks at (N,), from times (N,) on the clock of the poses; -1 for
        rows that do not count.
    near : float
        Where the search begins [s]: of lags that fit alike, the one nearest to this is taken.

    Raises
    ------
    InputError
        Too few readings while the hand moves, or a motion that does not tell.
    """
    d = despiked(d)
    found, errors = [], []
    for offset in (near, *candidate_offsets(track, time, d)):
        try:
            found.append(_coarse(track, time, d, plane_of(time - offset), offset))
        except InputError as error:
            errors.append(error)
    if not found:
        raise errors[0]
    best = max(found, key=lambda one: one.gain)
    alike = [one for one in found if one.as_good_as(best)]
    other = next((one.lag for one in alike if abs(one.lag - best.lag) > REACH), best.lag)
    if near:
        best = min(alike, key=lambda one: abs(one.lag - near))
    elif abs(best.lag) > REACH and other != best.lag:  # the clocks are not one
        raise InputError(
            f"readings that fit the motion at lags of {best.lag:.6g} s and {other:.6g} s",
            "a motion that does not repeat; or a rough --lag-s, near which the lag is then looked for",
        )
    lag = _calibrated(track, best)
    if lag is None:
        expected = "a log with stops, turns and changes of speed before a plane; or state --lag-s"
        raise InputError("a motion that does not tell the lag of the readings", expected)
    value, sigma, varies = lag
    if not varies <= WORST_SIGMA:
        raise InputError(
            f"a lag that varies by some {1e3 * varies:.0f} ms in the recording",
            "clocks that run alike and are not set meanwhile; or parts of the log by themselves",
        )
    return value, float(np.hypot(sigma, varies))


def _coarse(
    track: Track, time: FloatArray, d: FloatArray, plane: IntArray, offset: float
) -> _Candidate:
    """Return the best lag within `REACH` of an offset [s].

    Raises
    ------
    InputError
        Too few readings there, or no minimum.
    """
    moments = time - offset
    if moments.max() < track.time[0] or moments.min() > track.time[-1]:
        raise InputError(
            f"clocks that do not overlap: poses from {track.time[0]:.10g} to {track.time[-1]:.10g} s, "
            f"readings from {moments.min():.10g} to {moments.max():.10g} s, and no offset at which "
            "readings follow the motion",
            "one clock and one unit (--time-units, --readings-time-units); or a rough --lag-s",
        )
    parts = _parts(track, time, d, plane, offset)
    if not parts:
        raise InputError(
            "too few readings while the hand moves to estimate the lag",
            f"some {LEAST_READINGS} of one beam before one plane, with stops, turns and changes of "
            "speed; or state --lag-s",
        )
    steps = round(REACH / COARSE)
    lags = offset + COARSE * np.arange(-steps, steps + 1)
    sums = np.array([_squares(track, parts, lag) for lag in lags])
    best = int(sums.argmin())
    if best in (0, len(lags) - 1):
        expected = "clocks that agree better; or a rough --lag-s, from which the search begins"
        raise InputError(f"no lag within {REACH:g} s at which readings follow the motion", expected)
    lag, squares, step = float(lags[best]), float(sums[best]), COARSE
    while step > FINE:
        step *= 0.5
        pair = [(_squares(track, parts, other), other) for other in (lag - step, lag + step)]
        squares, lag = min((squares, lag), *pair)
    variation = sum(float(own.var(axis=0).sum()) * len(own) for *_, own in parts)
    return _Candidate(lag, squares, variation, sum(own.size for *_, own in parts), parts)


def _calibrated(track: Track, candidate: _Candidate) -> tuple[float, float, float] | None:
    """Return the lag near a candidate at which a calibration of beams and planes fits best.

    With its standard deviation, and by how much it varies in the recording. None where none is found
    that fits about as well as the linear equation, or where none tells it.
    """
    if candidate.squares > UNEXPLAINED * candidate.variation:
        return None
    parts, lag = candidate.parts, candidate.lag
    readings = _readings(track, parts, lag)
    origins = readings.plane_means(readings.world_t_hand)
    local = readings.seen_from(origins)
    start = find_start(local, None, 0, effort="quick").parameters
    terms, free = RANGE_ERROR_TERMS["auto"], np.full((readings.beams, 2), np.inf)
    count = len(readings) - count_unknowns(readings, terms)
    how = whitening(start, local, Variances(np.ones(readings.beams)))
    apart = max(FINE, STEPS_APART * float(np.median(np.diff(track.time))))
    # A step of a thousandth of a standard deviation moves no minimum, and what a motion that repeats
    # leaves undetermined would take all steps.
    options = LevenbergOptions(max_iterations=60, step_tolerance=1e-3)
    for _ in range(MOST_ROUNDS):
        at, later, sooner = (
            _readings(track, parts, lag + shift).seen_from(origins)
            for shift in (0.0, apart, -apart)
        )
        solved = solve_together([at], [start], terms, 1.0, options=options)
        start = solved.parameters[0]
        e, after, before = (residuals_or_infinite(start, rows) for rows in (at, later, sooner))
        rate = (after - before) / (2.0 * apart)
        if not (np.isfinite(e).all() and np.isfinite(rate).all()):
            return None
        rows = LinearRows(start, at, how, free, at.station)
        rest = Projection(rows, free).rest(rate[:, None])[0][:, 0]
        square = max(float(rest @ rest), ROUNDING)
        sigma = float(np.hypot(np.sqrt(float(e @ e) / max(count, 1) / square), INTERPOLATED))
        step = -float(rest @ e) / square
        if abs(step) < SAME_OPTIMUM * sigma:
            break
        lag += float(np.clip(step, -COARSE, COARSE))
    if not (abs(step) < SAME_OPTIMUM * sigma <= SAME_OPTIMUM * WORST_SIGMA):
        return None
    if not 2.0 * solved.cost[0] <= AS_GOOD * candidate.squares:
        return None
    time = np.concatenate([own for _, _, own, _ in parts])[at.station]
    # Beside noise, each sixth of the recording is off by -rate'e / rate'rate.
    piece = np.searchsorted(np.linspace(time.min(), time.max(), 7)[1:-1], time)
    weight = np.bincount(piece, rate**2, 6)
    off = -np.bincount(piece, rate * e, 6) / np.maximum(weight, ROUNDING)
    noise = 6.0 * float(e @ e) / len(e)
    excess = (float(weight @ off**2) - noise) / float(weight.sum())
    return lag, sigma, float(np.sqrt(max(excess, 0.0)))


def _readings(track: Track, parts: list[Part], lag: float) -> Readings:
    """Return all readings with the poses of their times less the lag, each time a station."""
    columns, first = [], 0
    for index, beams_of_part, time, readings in parts:
        rotation, position = _poses(track, time - lag)
        R = rotation.as_matrix()
        station = np.arange(first, first + len(time))
        first += len(time)
        for number, d in zip(beams_of_part.tolist(), readings.T, strict=True):
            same = np.full((2, len(d)), [[index], [number]])
            columns.append((*same, station, d, R, position))
    plane, beam, station, d, R, t = (np.concatenate(own) for own in zip(*columns, strict=True))
    order = np.lexsort((station, beam, plane))
    beams, beam = np.unique(beam[order], return_inverse=True)
    planes, plane = np.unique(plane[order], return_inverse=True)
    rows = d[order], R[order], t[order]
    return Readings(station[order], beam, plane, *rows, len(beams), len(planes))


def _parts(
    track: Track, time: FloatArray, d: FloatArray, plane: IntArray, offset: float
) -> list[Part]:
    """Return the readings of each plane and beam that tell a lag near an offset [s]; of many, some."""
    parts: list[Part] = []
    moments = time - offset
    inside = (moments - REACH >= track.time[0]) & (moments + REACH <= track.time[-1]) & (plane >= 0)
    moves = _moves(track, moments)
    moves &= inside & _settled(time, plane, moves)
    for index in np.unique(plane[moves]).tolist():
        read = ((moves & (plane == index))[:, None] & ~np.isnan(d)).T
        # Beams that read at the same times share their poses.
        alike: dict[bytes, list[int]] = {}
        for beam, mine in enumerate(read):
            alike.setdefault(mine.tobytes(), []).append(beam)
        for beams in map(np.array, alike.values()):
            rows = np.flatnonzero(read[beams[0]])
            if len(rows) >= LEAST_READINGS:
                rows = rows[evenly(len(rows), MOST_READINGS)]
                parts.append((index, beams, time[rows], d[rows][:, beams]))
    return parts


def _settled(time: FloatArray, plane: IntArray, moves: BoolArray) -> BoolArray:
    """Tell which readings (N,) are before one plane whatever the lag: labels may go by their stamps.

    A label may be set on arrival, and the sensor reads on while the hand goes to another plane: of a
    move near whose beginning or end the label changes nothing is taken.
    """
    first = np.searchsorted(time, time - REACH)
    last = np.searchsorted(time, time + REACH, side="right") - 1
    settled = (plane[first] == plane) & (plane[last] == plane)
    move = np.cumsum(np.diff(moves, prepend=False))  # moves have odd numbers
    begin, end = np.searchsorted(move, move), np.searchsorted(move, move, side="right") - 1
    short = moves & (time[end] - time[begin] <= LONGEST_MOVE)
    return np.asarray(settled & ~np.isin(move, move[short & ~settled]))


def _moves(track: Track, time: FloatArray) -> BoolArray:
    """Tell at which times (N,) the hand moves or turns within `REACH` before or after."""
    times = time + np.array([[0.0], [-REACH], [REACH]])
    rows = np.clip(np.searchsorted(track.time, times), 0, len(track.time) - 1)
    shift = np.linalg.norm(track.position[rows[1:]] - track.position[rows[0]], axis=2)
    cosine = np.abs((track.quaternion[rows[1:]] * track.quaternion[rows[0]]).sum(axis=2))
    moves = (shift > MOVES_M) | (cosine < np.cos(0.5 * MOVES_RAD))
    return np.asarray(moves.any(axis=0))


def _squares(track: Track, parts: list[Part], lag: float) -> float:
    """Return the sum of squares that the linear equation leaves at a lag, over planes and beams."""
    total = 0.0
    for _, _, time, readings in parts:
        rotation, position = _poses(track, time - lag)
        R = rotation.as_matrix().reshape(-1, 9)
        turned, moved = R - R.mean(axis=0), position - position.mean(axis=0)
        for d in (readings - readings.mean(axis=0)).T:
            X = np.hstack((d[:, None] * turned, turned, moved, np.ones((len(d), 1)), d[:, None]))
            X /= np.maximum(np.linalg.norm(X, axis=0), ROUNDING)  # of a hand that does not turn
            # Products of columns lose half of the digits, and take a hundredth of the time.
            G = X.T @ X
            known = np.linalg.pinv(G[:-1, :-1], rcond=SINGULAR, hermitian=True)
            left = float(G[-1, -1] - G[-1, :-1] @ known @ G[:-1, -1])
            total += max(left, SINGULAR) * float(d @ d)
    return total


def _poses(track: Track, wanted: FloatArray) -> tuple[Rotation, FloatArray]:
    """Return rotations and positions (N, 3) at increasing times (N,) [s]."""
    first = int(np.searchsorted(track.time, wanted[0] - 1.0))
    last = int(np.searchsorted(track.time, wanted[-1] + 1.0))
    part = slice(first, last)
    way = neighbours(track.time[part], wanted)
    return interpolated(track.quaternion[part], track.position[part], *way)


def despiked(d: FloatArray) -> FloatArray:
    """Return readings (N, B) in the order of time, with NaN in place of single wild ones."""
    d = d.copy()
    for column in d.T:
        read = np.flatnonzero(~np.isnan(column))
        if len(read):
            off = np.abs(column[read] - median_filter(column[read], 5, mode="nearest"))
            # Off the median of five by ten times what nine in ten readings are.
            column[read[off > 10.0 * np.quantile(off, 0.9)]] = np.nan
    return d


def candidate_offsets(track: Track, time: FloatArray, d: FloatArray) -> list[float]:
    """Return by how much readings d (N, B) may be stamped later [s], a few offsets of either kind.

    Times (N,) increase. There is none where the hand or the readings rest all the time.
    """
    from scipy.signal import correlate, find_peaks  # takes half a second, and few logs need it

    spans = track.time[-1] - track.time[0], time[-1] - time[0]
    if min(spans) <= 0.0:
        return []
    step = max(STEP, 4.0 * sum(spans) / NUMBERS_AT_ONCE)  # longer ones, for the memory they need
    half = (
        5.0 * step
    )  # velocities are differences over this to either side, because readings have noise
    at, grid = np.arange(track.time[0], track.time[-1], step), np.arange(time[0], time[-1], step)
    (R, p), (S, s) = (_poses(track, at + side) for side in (half, -half))
    w = np.hstack((p - s, (R * S.inv()).as_rotvec()))
    w /= np.maximum(np.sqrt((w**2).mean(axis=0)), ROUNDING)
    y = np.zeros((len(grid), d.shape[1]))
    for rate, column in zip(y.T, d.T, strict=True):
        read = np.flatnonzero(~np.isnan(column))
        if len(read) > 1:
            late, early = (
                np.interp(grid + side, time[read], column[read]) for side in (half, -half)
            )
            most = FAR_SIGMAS * np.sqrt(((late - early) ** 2).mean())  # faster: a change of planes
            rate[:] = np.clip(late - early, -most, most)
            rate /= max(float(np.linalg.norm(rate)), SINGULAR)
    # A hand that does not turn, or moves in one plane, leaves directions without a velocity.
    inverse = np.linalg.pinv(w.T @ w, rcond=1e-3, hermitian=True)
    lags = np.arange(1 - len(w), len(y))
    explained = np.zeros(len(lags))
    for rate in y.T:
        b = np.stack([correlate(rate, column, method="fft") for column in w.T])
        explained += np.einsum("in,in->n", b, inverse @ b)
    together = correlate(_activity(y), _activity(w), method="fft")
    # Where less overlaps, both what a motion explains and what chance does are less.
    overlap = np.minimum(len(w) + lags, len(y)) - np.maximum(lags, 0)
    share = np.maximum(overlap / min(len(w), len(y)), 0.3)
    found: list[float] = []
    for height in (explained / share, together / np.sqrt(share)):
        peaks = find_peaks(height)[0]
        best = peaks[
            np.argsort(-height[peaks], kind="stable")[:6]
        ]  # a motion that repeats has several
        found += (time[0] - track.time[0] + step * lags[best]).tolist()
    return found


def _activity(columns: FloatArray) -> FloatArray:
    """Return where columns (M, k) of speeds move, 1, or rest, 0, less the mean (M,)."""
    speed = np.linalg.norm(columns, axis=1)
    # A tenth of the root mean square speed hardly moves.
    found = speed / (speed + 0.1 * max(float(np.sqrt((speed**2).mean())), SINGULAR))
    return np.asarray(found - found.mean())
