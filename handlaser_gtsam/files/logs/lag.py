r"""How much later readings are stamped than poses of the same moment, from the motion itself.

Before one plane, what a beam reads is a function of the hand's pose alone, whatever mount and plane
are. So, with the poses x(t) and readings d_i stamped t_i, the right lag tau is the one at which

    d_i = f(x(t_i - tau)),    f a polynomial of the pose (position, and turn from the middle one),

leaves the smallest sum of squares S(tau), added over planes and beams. Motion that stops, turns back
or changes its speed identifies the lag; a sweep at constant speed does not, for a shift of it is
another polynomial. Nothing of mounts, planes or starts is needed for that.

What a polynomial leaves out moves the minimum, by milliseconds where the hand turns a little and by
more where it turns far. Near it S(tau) is therefore taken of the calibration itself, solved for each of
a few lags, which moves on until the minimum lies amid them. The curvature there says how well it is
known: with residuals of variance s^2, the variance of tau is 2 s^2 / S''(tau).

Clocks that are further apart are first brought together by the pattern of stops and moves: the hand's
speed and the rate at which readings change, both made 0 or 1, have their largest correlation at the
offset.
"""

from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from itertools import combinations_with_replacement

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft
from scipy.spatial.transform import Rotation

from ...arrays import BoolArray, FloatArray, IntArray
from ...data.readings import Readings
from ...errors import InputError
from ...solvers.levenberg import LevenbergOptions
from ...solvers.many_problems import solve_together
from ...starts import find_start
from .motion import Between
from .stands import Track

MOST = 0.5
"""Lags up to this [s] are looked for."""
COARSE, FINE = 0.02, 0.002
"""Steps of the search [s]."""
WORST = 0.01
"""A standard deviation above this [s] says that the motion does not tell the lag."""
TRUNCATED, BETWEEN = 3e-3, 1e-4
"""What the polynomial leaves out, and what the way between two poses is off, may move the minimum by so
much [s]."""
BENT = 3.0
"""A parabola through sums of squares bends by so many standard deviations of its curvature."""
UNLIKE = 2.0
"""A calibration that leaves so many times the squares of the polynomials is none."""
TERMS = 2
"""Range-error terms of the calibration."""
MOVES_M, MOVES_RAD = 1e-3, 2e-3
"""Readings count where the hand moves by so much within `MOST` before or after."""
PATTERN_STEP = 0.02
"""Step of the pattern of stops and moves [s]."""
PATTERN_MOST = 2_000_000
"""Longer patterns, in steps, take too much memory and time."""
PATTERN_PEAKS = 6
"""So many offsets at which stops and moves go together are looked at: stops at even intervals have
several."""
PATTERN_ALIKE = 4.0
"""Another offset at which readings follow the motion but for less than this factor of the squares fits
as well."""
PATTERN_NEAR = 2.0
"""Offsets nearer to each other than this [s] are one peak."""
LEAST_PATTERN = 0.3
"""A correlation below this is no common pattern."""
ROUNDS = 12
"""The calibration moves on at most so often to where its minimum is."""
OPTIONS = LevenbergOptions(max_iterations=60, step_tolerance=1e-3)
A_FEATURE = 12
"""So many readings for every coefficient of the polynomial."""
AT_MOST = 3000
"""Readings of one plane and beam that are looked at, evenly spread."""


@dataclass(frozen=True, slots=True)
class Lag:
    """A lag and its standard deviation [s]."""

    value: float
    sigma: float


@dataclass(frozen=True, slots=True)
class _Part:
    """Readings d (N, b) of beams before a plane, at times (N,) [s], and the polynomials' degree."""

    plane: int
    beams: IntArray
    time: FloatArray
    d: FloatArray
    degree: int


def estimated_lag(
    track: Track,
    time: FloatArray,
    d: FloatArray,
    plane_of: Callable[[FloatArray], IntArray],
    near: float = 0.0,
) -> Lag:
    """Return the lag of readings.

    Parameters
    ----------
    track : Track
    time : (N,)
        Stamps of readings [s].
    d : (N, B)
        Readings [m]; NaN where there is none.
    plane_of : callable
        Returns which plane each row looks at (N,), from times (N,) on the clock of the poses; -1 for
        rows that do not count.
    near : float
        Where the search begins [s].

    Raises
    ------
    InputError
        Too few readings while the hand moves, or a motion that does not tell.
    """
    rows = track, time, d, plane_of
    try:
        return _refined(track, _coarse(*rows, near))
    except InputError as error:
        # Clocks that are further apart: what stops and moves allow is judged as the lag itself is.
        coarse = []
        for offset in _pattern_offsets(track, time, d):
            if abs(offset - near) > COARSE:
                with suppress(InputError):
                    coarse.append(_coarse(*rows, offset))
        if not coarse:
            raise error from None
    first, *others = sorted(coarse, key=lambda one: one.mean_square)
    for other in others:
        apart = abs(other.near - first.near) > PATTERN_NEAR
        if apart and other.mean_square < PATTERN_ALIKE * first.mean_square:
            raise InputError(
                f"stops and moves that fit offsets of {first.near:.6g} s and {other.near:.6g} s",
                "stops of different lengths; or a rough --lag-s, from which the search begins",
            )
    return _refined(track, first)


@dataclass(frozen=True, slots=True)
class _Coarse:
    """The best lag near an offset [s], and the mean square residual of the polynomials [m^2]."""

    near: float
    lag: float
    mean_square: float
    parts: list[_Part]


def _coarse(
    track: Track,
    time: FloatArray,
    d: FloatArray,
    plane_of: Callable[[FloatArray], IntArray],
    near: float,
) -> _Coarse:
    """Return the best lag within `MOST` of an offset [s].

    Raises
    ------
    InputError
        Too few readings there, or no minimum.
    """
    moments = time - near
    if moments.max() < track.time[0] or moments.min() > track.time[-1]:
        raise InputError(
            f"clocks that do not overlap: poses from {track.time[0]:.10g} to {track.time[-1]:.10g} s, "
            f"readings from {moments.min():.10g} to {moments.max():.10g} s, and no one pattern of "
            "stops and moves in both",
            "one clock and one unit (--time-units, --readings-time-units); or a rough --lag-s",
        )
    parts = list(_parts(track, moments, d, plane_of(moments)))
    if not parts:
        raise InputError(
            "too few readings while the hand moves to estimate the lag",
            f"some {A_FEATURE * len(_exponents(2))} of one beam before one plane, with stops, turns "
            "and changes of speed; or state --lag-s",
        )
    steps = round(MOST / COARSE)
    lags = COARSE * np.arange(-steps, steps + 1)
    sums = np.array([_squares(track, parts, lag) for lag in lags])
    best = int(sums.argmin())
    if best in (0, len(lags) - 1):
        raise InputError(
            f"no lag within {MOST:g} s at which readings follow the motion",
            "clocks that agree better; or a rough --lag-s, from which the search begins",
        )
    count = sum(part.d.size for part in parts)
    return _Coarse(near, float(lags[best]), float(sums[best]) / count, parts)


def _pattern_offsets(track: Track, time: FloatArray, d: FloatArray) -> list[float]:
    """Return by how much readings may be stamped later, from stops and moves, the likeliest first."""
    order = np.argsort(time, kind="stable")
    time, d = time[order], d[order]
    spans = track.time[-1] - track.time[0], time[-1] - time[0]
    if min(spans) <= 0.0 or sum(spans) > PATTERN_STEP * PATTERN_MOST:
        return []
    turn = np.linalg.norm(np.diff(_continuous(track.quaternion), axis=0), axis=1)
    way = np.linalg.norm(np.diff(track.position, axis=0), axis=1)
    hand = _activity(track.time, way / MOVES_M + 2.0 * turn / MOVES_RAD)
    beams = []
    for column in d.T:
        read = np.flatnonzero(~np.isnan(column))
        if len(read) > 1:
            beams.append(_activity(time[read], np.abs(np.diff(column[read])), time[0], time[-1]))
    if not beams:
        return []
    a, b = hand - hand.mean(), np.mean(beams, axis=0)
    b = b - b.mean()
    scale = float(np.linalg.norm(a) * np.linalg.norm(b))
    if scale == 0.0:
        return []
    n = next_fast_len(len(a) + len(b) - 1, real=True)
    products = irfft(rfft(b, n) * np.conj(rfft(a, n)), n) / scale
    shift = np.arange(n)
    offsets = time[0] - track.time[0] + PATTERN_STEP * np.where(shift < len(b), shift, shift - n)
    found: list[float] = []
    while len(found) < PATTERN_PEAKS and products.max() > LEAST_PATTERN:
        found.append(float(offsets[int(products.argmax())]))
        products[np.abs(offsets - found[-1]) < PATTERN_NEAR] = -np.inf
    return found


def _continuous(q: FloatArray) -> FloatArray:
    """Return quaternions (M, 4) without jumps of sign."""
    flips = np.cumprod(np.concatenate(([1.0], np.sign((q[1:] * q[:-1]).sum(axis=1) + 1e-12))))
    return np.asarray(q * flips[:, None])


def _activity(
    time: FloatArray, change: FloatArray, begin: float | None = None, end: float | None = None
) -> FloatArray:
    """Return 1 where something changes fast and 0 where it rests, in steps of `PATTERN_STEP`.

    What counts as fast lies between the slow tenth of the rates, which is noise, and the fast.
    """
    begin, end = time[0] if begin is None else begin, time[-1] if end is None else end
    grid = np.arange(begin, end, PATTERN_STEP)
    total = np.concatenate(([0.0], np.cumsum(change)))
    width = 5.0 * PATTERN_STEP
    rate = np.interp(grid + width, time, total) - np.interp(grid - width, time, total)
    low, high = np.quantile(rate, [0.1, 0.9])
    return np.asarray(rate > low + 0.25 * (high - low), dtype=np.float64)


def _refined(track: Track, coarse: _Coarse) -> Lag:
    """Return the minimum of the calibration near a lag."""
    parts, near = coarse.parts, coarse.lag
    steps = round(COARSE / FINE)
    lags = np.asarray(near + FINE * np.arange(-steps, steps + 1), dtype=np.float64)
    sums = np.array([_squares(track, parts, lag) for lag in lags])
    low = np.clip(int(sums.argmin()), 3, len(lags) - 4)
    rows = slice(low - 3, low + 4)
    count = sum((len(one.d) - len(_exponents(one.degree))) * one.d.shape[1] for one in parts)
    rough, squares = _lowest(lags[rows], sums[rows], count, TRUNCATED)
    middle = rough.value if rough is not None else float(lags[low])
    # Polynomials alone may find a minimum far from the true offset: a calibration must fit there.
    found = _calibrated(track, parts, middle, UNLIKE * squares)
    if found is None or found.sigma > WORST:
        raise InputError(
            "a motion that does not tell the lag of the readings",
            "a log with stops, turns and changes of speed before a plane; or state --lag-s",
        )
    return Lag(coarse.near + found.value, found.sigma)


def _lowest(
    lags: FloatArray, sums: FloatArray, count: int, least: float
) -> tuple[Lag | None, float]:
    """Return the minimum of a parabola through seven sums of squares, and the least of them.

    None where no minimum stands out from how rough the sums are; `count` are the degrees of
    freedom, `least` is added to sigma.
    """
    middle, squares = lags[3], float(sums.min())
    if not np.isfinite(sums).all():
        return None, squares
    (bend, slope, _), spread = np.polyfit(lags - middle, sums, 2, cov=True)
    if bend <= BENT * np.sqrt(spread[0, 0]):
        return None, squares
    shift = float(np.clip(-0.5 * slope / bend, lags[0] - middle, lags[-1] - middle))
    fitted = 0.5 * np.sqrt(spread[1, 1]) / bend
    sigma = float(np.linalg.norm([np.sqrt(squares / max(count, 1) / bend), fitted, least]))
    return Lag(float(middle) + shift, sigma), squares


def _calibrated(track: Track, parts: list[_Part], near: float, most: float) -> Lag | None:
    """Return the lag at which a calibration of beams and planes fits best.

    None where none is found that leaves less than `most` of squares.
    """
    readings = _readings(track, parts, near)
    origins = readings.plane_means(readings.world_t_hand)
    start = find_start(readings.seen_from(origins), None, 0, effort="quick").parameters
    count = len(readings) - readings.unknowns(TERMS)
    step, found, squares = COARSE, None, np.inf
    for _ in range(ROUNDS):
        lags = np.asarray(near + step * np.arange(-3, 4), dtype=np.float64)
        problems = [_readings(track, parts, lag).seen_from(origins) for lag in lags]
        solved = solve_together(problems, [start] * 7, TERMS, 1.0, options=OPTIONS)
        cost = np.asarray(2.0 * solved.cost)
        if not np.isfinite(cost).all():
            return None
        best = int(cost.argmin())
        start = solved.parameters[best]
        if best in (0, 6):  # the minimum lies further on
            near = float(lags[best])
            continue
        found, squares = _lowest(lags, cost, count, BETWEEN)
        near = float(lags[best]) if found is None else found.value
        if step == FINE:
            break
        step = max(step / 4.0, FINE)
    return found if found is not None and step == FINE and squares <= most else None


def _readings(track: Track, parts: list[_Part], lag: float) -> Readings:
    """Return all readings with the poses of their times less the lag, each time a station."""
    columns, first = [], 0
    for part in parts:
        rotation, position, _ = _poses(track, part, lag)
        R = rotation.as_matrix()
        station = np.arange(first, first + len(part.time))
        first += len(part.time)
        for beam, d in zip(part.beams.tolist(), part.d.T, strict=True):
            same = np.full((2, len(d)), [[part.plane], [beam]])
            columns.append((*same, station, d, R, position))
    plane, beam, station, d, R, t = (np.concatenate(own) for own in zip(*columns, strict=True))
    order = np.lexsort((station, beam, plane))
    beams, beam = np.unique(beam[order], return_inverse=True)
    planes, plane = np.unique(plane[order], return_inverse=True)
    rows = d[order], R[order], t[order]
    return Readings(station[order], beam, plane, *rows, len(beams), len(planes))


def _parts(track: Track, time: FloatArray, d: FloatArray, plane: IntArray) -> Iterator[_Part]:
    """Yield the readings of each plane and beam that tell something."""
    inside = (time - MOST >= track.time[0]) & (time + MOST <= track.time[-1]) & (plane >= 0)
    moves = inside & _moves(track, time) & _settled(time, plane)
    for index in np.unique(plane[moves]).tolist():
        read = ((moves & (plane == index))[:, None] & ~np.isnan(d)).T
        # Beams that read at the same times share their monomials.
        alike: dict[bytes, list[int]] = {}
        for beam, mine in enumerate(read):
            alike.setdefault(mine.tobytes(), []).append(beam)
        for beams in map(np.array, alike.values()):
            rows = np.flatnonzero(read[beams[0]])
            if len(rows) > AT_MOST:
                rows = rows[np.linspace(0, len(rows) - 1, AT_MOST).round().astype(np.intp)]
            for degree in (3, 2):
                if len(rows) >= A_FEATURE * len(_exponents(degree)):
                    yield _Part(index, beams, time[rows], d[rows][:, beams], degree)
                    break


def _settled(time: FloatArray, plane: IntArray) -> BoolArray:
    """Tell which readings (N,) are before one plane whatever the lag: labels may go by their stamps."""
    order = np.argsort(time, kind="stable")
    stamps, label = time[order], plane[order]
    settled = np.empty(len(time), dtype=bool)
    first = np.searchsorted(stamps, stamps - MOST)
    last = np.searchsorted(stamps, stamps + MOST, side="right") - 1
    settled[order] = (label[first] == label) & (label[last] == label)
    return settled


def _moves(track: Track, time: FloatArray) -> BoolArray:
    """Tell at which times (N,) the hand moves, a little before or after."""
    rows = [
        np.clip(np.searchsorted(track.time, time + shift), 0, len(track.time) - 1)
        for shift in (-MOST, 0.0, MOST)
    ]
    moves = np.zeros(len(time), dtype=bool)
    for other in (rows[0], rows[2]):
        shift = track.position[other] - track.position[rows[1]]
        cosine = np.abs((track.quaternion[other] * track.quaternion[rows[1]]).sum(axis=1))
        moves |= (np.linalg.norm(shift, axis=1) > MOVES_M) | (cosine < np.cos(0.5 * MOVES_RAD))
    return moves


def _squares(track: Track, parts: list[_Part], lag: float) -> float:
    """Return the sum of squares that is left at a lag, over all planes and beams."""
    total = 0.0
    for part in parts:
        X = _features(track, part, lag)
        coefficients = np.linalg.lstsq(X, part.d, rcond=1e-10)[0]
        total += float(((part.d - X @ coefficients) ** 2).sum())
    return total


def _features(track: Track, part: _Part, lag: float) -> FloatArray:
    """Return the monomials (N, F) of the poses at the times of readings less the lag."""
    turn, position, middle = _poses(track, part, lag)
    x = np.hstack((position - position.mean(axis=0), (middle.inv() * turn).as_rotvec()))
    x /= np.maximum(np.abs(x).max(axis=0), 1e-12)
    columns = [np.ones(len(x))]
    columns += [np.prod(x[:, list(one)], axis=1) for one in _exponents(part.degree)[1:]]
    return np.column_stack(columns)


def _poses(track: Track, part: _Part, lag: float) -> tuple[Rotation, FloatArray, Rotation]:
    """Return rotations and positions (N, 3) at the times of readings less the lag, and a rotation."""
    wanted = part.time - lag
    first = int(np.searchsorted(track.time, wanted[0] - 1.0))
    last = int(np.searchsorted(track.time, wanted[-1] + 1.0))
    q, p = track.quaternion[first:last], track.position[first:last]
    way = Between.at(track.time[first:last], wanted)
    turn, position = way.of_quaternions(q, p)
    return turn, position, Rotation.from_quat(q[way.row[len(wanted) // 2]])


def _exponents(degree: int) -> list[tuple[int, ...]]:
    """Return which of the six coordinates each monomial multiplies."""
    return [
        one for power in range(degree + 1) for one in combinations_with_replacement(range(6), power)
    ]
