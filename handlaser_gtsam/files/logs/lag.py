r"""How much later readings are stamped than poses of the same moment, from the motion itself.

With poses R(t), p(t) and readings d_i stamped t_i, a beam before a plane obeys at the right lag tau

    n . (p + R (r + d v)) + b = 0,    R and p at t_i - tau,

which, divided by the mean of n . R v, is linear in the products of mount and plane, whatever they are:

    d = d (R - R_mean) : M + R : N + p . q + c    (9 + 9 + 3 + 1 coefficients).

That lag leaves the smallest sum of squares S(tau), added over planes and beams. It is looked for near
the stated lag, and near offsets that velocities suggest (`candidate_offsets`). Motion that stops, turns
back or changes its speed identifies it; a sweep at constant speed does not. Where several offsets fit
alike, none is chosen unless it is near the stated lag.

From there on the lag is an unknown beside beams and planes, which are solved here for it alone: with
the residuals e of beams and planes solved at tau, of variance s^2, and what these leave of the
derivative of e by tau, a,

    tau <- tau - a'e / a'a,    var(tau) = s^2 / a'a.

The derivative is a difference over some steps of the recorded poses (`STEPS_APART`).

Offsets of the two clocks are suggested by the velocities of the hand and the rates of readings. Before
a plane, the rate of a range is linear in the hand's velocity w (6,), of its position and of its
turn in the world, with coefficients that change little unless the hand turns far. The offset tau by
which readings are stamped later is looked for where one set of coefficients explains the rates y_i of
each beam best,

    rho(tau) = sum_i b_i' G^-1 b_i / y_i' y_i,    b_i(tau) = sum_t y_i(t) w(t - tau),    G = sum_t w w',

for all offsets at once by the Fourier transform. It does not matter whether the arm stops. Where planes
are turned far from one another one set of coefficients explains little, but an arm that stops shows
when: so the offset is looked for, too, where hand and readings move and rest at the same times. The
maxima of both are candidates only: the range equation judges them.
"""

import math
from collections.abc import Callable
from itertools import zip_longest
from typing import NamedTuple

import numpy as np
from scipy.ndimage import median_filter
from scipy.spatial.transform import Rotation

from ...arrays import BoolArray, FloatArray, IntArray, evenly
from ...data.readings import Readings
from ...errors import InputError
from ...estimation.options import RANGE_ERROR_TERMS
from ...model.damped_search import LevenbergOptions
from ...model.equation import residuals_or_infinite
from ...model.families import count_unknowns
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
from ...solvers.beam_problem import solve_together
from ...starts import find_start
from .motion import MOVES_M, MOVES_RAD, Track, interpolated, neighbours

REACH = 0.5
"""Lags up to this [s] from an offset are looked for."""
COARSE, FINE = 0.04, 0.002
"""First and last steps of the search [s]."""
WORST_SIGMA = 0.01
"""A standard deviation above this [s] says that the motion does not tell the lag, and so does a lag
that varies by more, and by more than chance makes of it (`SEEMS_TO_GROW`)."""
STEPS_APART = 2.0
"""Steps between recorded poses to either side over which residuals are differenced. Poses that err by
0.3 mm moved the lag by 0.40, 0.09 and 0.08 ms (rms) with a sixteenth of a step, one and two."""
AS_GOOD = 4.0
"""What leaves less than this factor of the mean square of another fits as well: another offset as the
best one, and a calibration as the linear equation."""
PIECES = 6
"""Pieces of a recording in which the lag should be the same."""
GROWING = 12.0
"""The square of by how much a lag varies that grows all the time, in parts of its variance."""
SEEMS_TO_GROW = 20.0
"""A lag that does not vary hardly seems to grow by more standard deviations of the lag: by 15 at most
in 60 recordings with noise of 0.3 to 1.5 mm."""
OPTIONS = LevenbergOptions(max_iterations=60, step_tolerance=1e-3)
"""Of each calibration: a step of a thousandth of a standard deviation moves no minimum, and what a
motion that repeats leaves undetermined would take all steps."""
LEAST_READINGS = 264
"""Readings of a beam before a plane: twelve for each coefficient."""
ENOUGH_READINGS = 1500
"""Readings of one plane and beam that are looked at, evenly spread."""


_Part = tuple[int, IntArray, FloatArray, FloatArray]
"""A plane, beams (b,) before it, times (N,) [s] and readings (N, b) [m]."""
STEP = 0.02
"""Step in which velocities and rates are taken [s]."""
HALF_WIDTH = 5
"""Velocities are differences over twice this number of steps, because readings have noise."""


class _Candidate(NamedTuple):
    """The best lag near an offset [s], and what the linear equation leaves there.

    Attributes
    ----------
    lag : float
    squares, variation : float
        Sums of squares that are left of readings, and of their differences from their means [m^2].
    number, covered : int
        How many readings they are, and how many they stand for.
    parts : list of _Part
    """

    lag: float
    squares: float
    variation: float
    number: int
    covered: int
    parts: list[_Part]

    @property
    def gain(self) -> float:
        """How much likelier the readings are than if they did not follow the motion: a logarithm."""
        return float(self.covered * np.log(self.variation / self.squares))


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
    # The likeliest; of those as good, the nearest to a stated lag. Where none is stated, and the
    # clocks are not one, those as good far from it are asked, too.
    best, others = max(found, key=lambda one: one.gain), []
    least, few = AS_GOOD * best.squares / best.number, 0.5 * best.covered
    alike = [one for one in found if one.squares < least * one.number and one.covered > few]
    if near:
        best = min(alike, key=lambda one: abs(one.lag - near))
    elif abs(best.lag) > REACH:
        others = [one for one in alike if abs(one.lag - best.lag) > REACH]
    lag = _calibrated(track, best)
    if lag is None:
        expected = "a log with stops, turns and changes of speed before a plane; or state --lag-s"
        raise InputError("a motion that does not tell the lag of the readings", expected)
    value, sigma, varies = lag
    if not _steady(lag):
        found_so = f"a lag that varies by some {1e3 * varies:.0f} ms in the recording"
        expected = (
            "clocks that run alike and are not set meanwhile; or parts of the log by themselves"
        )
        raise InputError(found_so, expected)
    tried = ((one.lag, _calibrated(track, one)) for one in others)
    fits = [other for other, lag in tried if lag is not None and _steady(lag)]
    if fits:
        more = f" and {len(fits) - 1} more" if len(fits) > 1 else ""
        raise InputError(
            f"readings that fit the motion at lags of {best.lag:.6g} s and {fits[0]:.6g} s{more}",
            "a motion that does not repeat; or a rough --lag-s, near which the lag is then looked for",
        )
    return value, float(np.hypot(sigma, varies / np.sqrt(GROWING)))


def _steady(lag: tuple[float, float, float]) -> bool:
    """Tell whether a lag, with its sigma and by how much it varies, is the same all the time."""
    _, sigma, varies = lag
    most = min(SEEMS_TO_GROW * sigma, math.sqrt(GROWING) * WORST_SIGMA)
    return varies <= max(most, WORST_SIGMA)


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
    parts, covered = _parts(track, time, d, plane, offset)
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
    count = sum(own.size for *_, own in parts)
    return _Candidate(lag, squares, variation, count, covered, parts)


def _calibrated(track: Track, candidate: _Candidate) -> tuple[float, float, float] | None:
    """Return the lag near a candidate at which a calibration of beams and planes fits best.

    With its standard deviation, and by how much it varies in the recording.

    None where none is found that fits about as well as the linear equation, or where none tells it.
    """
    # A larger part of the variance of readings than this says that they do not follow the motion.
    if candidate.squares > 0.1 * candidate.variation:
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
    for _ in range(MOST_ROUNDS):
        at, later, sooner = (
            _readings(track, parts, lag + shift).seen_from(origins)
            for shift in (0.0, apart, -apart)
        )
        solved = solve_together([at], [start], terms, 1.0, options=OPTIONS)
        start = solved.parameters[0]
        e, after, before = (residuals_or_infinite(start, rows) for rows in (at, later, sooner))
        rate = (after - before) / (2.0 * apart)
        if not (np.isfinite(e).all() and np.isfinite(rate).all()):
            return None
        rows = LinearRows(start, at, how, free, at.station)
        rest = Projection(rows, free).rest(rate[:, None])[0][:, 0]
        square = max(float(rest @ rest), ROUNDING)
        # The interpolation between two poses may move the minimum by this much [s].
        sigma = float(np.hypot(np.sqrt(float(e @ e) / max(count, 1) / square), 1e-4))
        step = -float(rest @ e) / square
        if abs(step) < SAME_OPTIMUM * sigma:
            break
        lag += float(np.clip(step, -COARSE, COARSE))
    if not (abs(step) < SAME_OPTIMUM * sigma <= SAME_OPTIMUM * WORST_SIGMA):
        return None
    time = np.concatenate([own for _, _, own, _ in parts])[at.station]
    # Beside noise, a piece of the recording is off by -rate'e / rate'rate.
    piece = np.searchsorted(np.linspace(time.min(), time.max(), PIECES + 1)[1:-1], time)
    told = np.bincount(piece, rate**2, PIECES)
    off = -np.bincount(piece, rate * e, PIECES) / np.maximum(told, ROUNDING)
    noise, varying = PIECES * float(e @ e) / len(e), float(told @ off**2)
    # The linear equation of each plane has more freedom, and follows a lag that varies.
    if not 2.0 * solved.cost[0] - varying <= AS_GOOD * candidate.squares:
        return None
    return lag, sigma, float(np.sqrt(GROWING * max(varying - noise, 0.0) / float(told.sum())))


def _readings(track: Track, parts: list[_Part], lag: float) -> Readings:
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
) -> tuple[list[_Part], int]:
    """Return the readings of each plane and beam that tell something of a lag near an offset [s].

    Of many they are some; the second result is how many they stand for.
    """
    parts: list[_Part] = []
    covered = 0
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
            if len(rows) < LEAST_READINGS:
                continue
            covered += len(rows) * len(beams)
            rows = rows[evenly(len(rows), ENOUGH_READINGS)]
            parts.append((index, beams, time[rows], d[rows][:, beams]))
    return parts, covered


def _settled(time: FloatArray, plane: IntArray, moves: BoolArray) -> BoolArray:
    """Tell which readings (N,) are before one plane whatever the lag: labels may go by their stamps.

    A label may be set on arrival, and the sensor reads on while the hand goes to another plane: of a
    move near whose beginning or end the label changes nothing is taken.
    """
    order = np.argsort(time, kind="stable")
    stamps, label, moves = time[order], plane[order], moves[order]
    first = np.searchsorted(stamps, stamps - REACH)
    last = np.searchsorted(stamps, stamps + REACH, side="right") - 1
    settled = (label[first] == label) & (label[last] == label)
    move = np.cumsum(np.diff(moves, prepend=False))  # moves have odd numbers
    begin, end = np.searchsorted(move, move), np.searchsorted(move, move, side="right") - 1
    # A longer move [s] is not the way from one plane to another, but of an arm that never stops.
    short = moves & (stamps[end] - stamps[begin] <= 15.0)
    settled &= ~np.isin(move, move[short & ~settled])
    found = np.empty(len(time), dtype=bool)
    found[order] = settled
    return found


def _moves(track: Track, time: FloatArray) -> BoolArray:
    """Tell at which times (N,) the hand moves or turns within `REACH` before or after."""
    times = time + np.array([[0.0], [-REACH], [REACH]])
    rows = np.clip(np.searchsorted(track.time, times), 0, len(track.time) - 1)
    shift = np.linalg.norm(track.position[rows[1:]] - track.position[rows[0]], axis=2)
    cosine = np.abs((track.quaternion[rows[1:]] * track.quaternion[rows[0]]).sum(axis=2))
    moves = (shift > MOVES_M) | (cosine < np.cos(0.5 * MOVES_RAD))
    return np.asarray(moves.any(axis=0))


def _squares(track: Track, parts: list[_Part], lag: float) -> float:
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
            # A reading is wild if it is off the median of five by this factor of what nine in ten
            # readings are.
            column[read[off > 10.0 * np.quantile(off, 0.9)]] = np.nan
    return d


def candidate_offsets(track: Track, time: FloatArray, d: FloatArray) -> list[float]:
    """Return by how much readings d (N, B) may be stamped later [s], the likeliest offset first.

    Times (N,) increase. There is none where the hand or the readings rest all the time.
    """
    # Takes half a second to import, and few logs need it.
    from scipy.signal import correlate, correlation_lags, find_peaks

    spans = track.time[-1] - track.time[0], time[-1] - time[0]
    if min(spans) <= 0.0:
        return []
    step = max(STEP, 4.0 * sum(spans) / NUMBERS_AT_ONCE)  # longer ones, for the memory they need
    w = _velocities(track, step)
    y = _rates(time, d, step)
    shift = correlation_lags(len(y), len(w))
    overlap = np.minimum(len(w) + shift, len(y)) - np.maximum(shift, 0)
    # Offsets at which a smaller part of the shorter recording lies within the other count less.
    share = np.maximum(overlap / min(len(w), len(y)), 0.3)
    # A hand that does not turn, or moves in one plane, leaves directions without a velocity.
    inverse = np.linalg.pinv(w.T @ w, rcond=1e-3, hermitian=True)
    explained = np.zeros(len(shift))
    for column in y.T:
        b = np.stack([correlate(column, speed, method="fft") for speed in w.T])
        explained += np.einsum("in,in->n", b, inverse @ b)
    together = correlate(_activity(y), _activity(w), method="fft")
    found = []
    # Where less overlaps, both what a motion explains and what chance does are less.
    for height in (explained / share, together / np.sqrt(share)):
        peaks = find_peaks(height)[0]
        # Most candidates of either kind: a motion that repeats has several.
        best = peaks[np.argsort(-height[peaks], kind="stable")[:6]]
        found.append([float(time[0] - track.time[0] + step * i) for i in shift[best]])
    return [one for pair in zip_longest(*found) for one in pair if one is not None]


def _activity(columns: FloatArray) -> FloatArray:
    """Return where columns (M, k) of speeds move, 1, or rest, 0, less the mean (M,)."""
    speed = np.linalg.norm(columns, axis=1)
    # What is slower than such a part of the root mean square speed hardly moves.
    found = speed / (speed + 0.1 * max(float(np.sqrt((speed**2).mean())), SINGULAR))
    return np.asarray(found - found.mean())


def _velocities(track: Track, step: float) -> FloatArray:
    """Return velocities of position and turn (M, 6) in steps from the first time on, scaled to 1."""
    columns = np.hstack((track.position, track.steady)).T
    grid, apart = np.arange(track.time[0], track.time[-1], step), HALF_WIDTH * step
    late, early = (
        np.stack([np.interp(when, track.time, column) for column in columns], axis=1)
        for when in (grid + apart, grid - apart)
    )
    late_turn, early_turn = Rotation.from_quat(late[:, 3:]), Rotation.from_quat(early[:, 3:])
    turn = (late_turn * early_turn.inv()).as_rotvec()
    w = np.hstack((late[:, :3] - early[:, :3], turn))
    return np.asarray(w / np.maximum(np.sqrt((w**2).mean(axis=0)), ROUNDING))


def _rates(time: FloatArray, d: FloatArray, step: float) -> FloatArray:
    """Return rates of the beams that read (N, B) in steps from the first time on, scaled to 1."""
    columns = []
    grid, apart = np.arange(time[0], time[-1], step), HALF_WIDTH * step
    for column in d.T:
        read = ~np.isnan(column)
        if read.sum() > 1:
            late, early = (
                np.interp(when, time[read], column[read]) for when in (grid + apart, grid - apart)
            )
            rate = late - early
            # Faster ones come from a change of planes.
            most = FAR_SIGMAS * np.sqrt((rate**2).mean())
            rate = np.clip(rate, -most, most)
            columns.append(rate / max(float(np.linalg.norm(rate)), SINGULAR))
    return np.stack(columns, axis=1) if columns else np.zeros((1, 0))
