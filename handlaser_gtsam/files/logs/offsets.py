r"""By how much two clocks may differ, from the velocities of the hand and the rates of readings.

Before a plane, the rate of a range is linear in the hand's velocity w (6,), that of its position and of
its turn in the world, with coefficients that change little unless the hand turns far. The offset tau by
which readings are stamped later is looked for where one set of coefficients explains the rates y_i of
each beam best,

    rho(tau) = sum_i b_i' G^-1 b_i / y_i' y_i,    b_i(tau) = sum_t y_i(t) w(t - tau),    G = sum_t w w',

for all offsets at once by the Fourier transform. It does not matter whether the arm stops. Where planes
are turned far from one another one set of coefficients explains little, but an arm that stops shows
when: so the offset is looked for, too, where hand and readings move and rest at the same times. The
maxima of both are candidates only: `lag` judges them by the range equation.
"""

from itertools import zip_longest

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft
from scipy.ndimage import median_filter
from scipy.spatial.transform import Rotation

from ...arrays import FloatArray
from ...quantities import FAR_SIGMAS, NUMBERS_AT_ONCE, ROUNDING, SINGULAR
from .stands import Track

STEP = 0.02
"""Step in which velocities and rates are taken [s]."""
HALF_WIDTH = 5
"""Velocities are differences over twice this number of steps, because readings have noise."""
CANDIDATES = 6
"""Most candidates of either kind: a motion that repeats has several."""
LEAST_OVERLAP = 0.3
"""Offsets at which a smaller part of the shorter recording lies within the other count less."""
RESTS = 0.1
"""What is slower than such a part of the root mean square speed hardly moves."""
SPIKE = 10.0
"""A reading is wild if it is off the median of five by this factor of what nine in ten readings are."""


def despiked(d: FloatArray) -> FloatArray:
    """Return readings (N, B) in the order of time, with NaN in place of single wild ones."""
    d = d.copy()
    for column in d.T:
        read = np.flatnonzero(~np.isnan(column))
        if len(read):
            off = np.abs(column[read] - median_filter(column[read], 5, mode="nearest"))
            column[read[off > SPIKE * np.quantile(off, 0.9)]] = np.nan
    return d


def candidate_offsets(track: Track, time: FloatArray, d: FloatArray) -> list[float]:
    """Return by how much readings d (N, B) may be stamped later [s], the likeliest offset first.

    Times (N,) increase. There is none where the hand or the readings rest all the time.
    """
    from scipy.signal import find_peaks  # takes half a second to import, and few logs need it

    spans = track.time[-1] - track.time[0], time[-1] - time[0]
    if min(spans) <= 0.0:
        return []
    step = max(STEP, 4.0 * sum(spans) / NUMBERS_AT_ONCE)  # longer ones, for the memory they need
    w = _velocities(track, step)
    y = _rates(time, d, step)
    n = next_fast_len(len(w) + len(y) - 1, real=True)
    shift = np.arange(n)
    shift = np.where(shift < len(y), shift, shift - n)
    overlap = np.minimum(len(w) + shift, len(y)) - np.maximum(shift, 0)
    share = np.maximum(overlap / min(len(w), len(y)), LEAST_OVERLAP)
    forms = [np.conj(rfft(column, n)) for column in w.T]
    # A hand that does not turn, or moves in one plane, leaves directions without a velocity.
    inverse = np.linalg.pinv(w.T @ w, rcond=1e-3, hermitian=True)
    explained = np.zeros(n)
    for column in y.T:
        own = rfft(column, n)
        b = np.stack([irfft(own * form, n) for form in forms])
        explained += np.einsum("in,in->n", b, inverse @ b)
    moves = [_activity(one) for one in (w, y)]
    together = irfft(rfft(moves[1], n) * np.conj(rfft(moves[0], n)), n)
    order, found = np.argsort(shift), []
    # Where less overlaps, both what a motion explains and what chance does are less.
    for height in ((explained / share)[order], (together / np.sqrt(share))[order]):
        peaks = find_peaks(height)[0]
        best = peaks[np.argsort(-height[peaks], kind="stable")[:CANDIDATES]]
        found.append([float(time[0] - track.time[0] + step * i) for i in shift[order][best]])
    return [one for pair in zip_longest(*found) for one in pair if one is not None]


def _activity(columns: FloatArray) -> FloatArray:
    """Return where columns (M, k) of speeds move, 1, or rest, 0, less the mean (M,)."""
    speed = np.linalg.norm(columns, axis=1)
    found = speed / (speed + RESTS * max(float(np.sqrt((speed**2).mean())), SINGULAR))
    return np.asarray(found - found.mean())


def _velocities(track: Track, step: float) -> FloatArray:
    """Return velocities of position and turn (M, 6) in steps from the first time on, scaled to 1."""
    x = np.hstack((track.position, track.steady))
    late, early = _sides(track.time, x, step)
    late_turn, early_turn = Rotation.from_quat(late[:, 3:]), Rotation.from_quat(early[:, 3:])
    turn = (late_turn * early_turn.inv()).as_rotvec()
    w = np.hstack((late[:, :3] - early[:, :3], turn))
    return np.asarray(w / np.maximum(np.sqrt((w**2).mean(axis=0)), ROUNDING))


def _rates(time: FloatArray, d: FloatArray, step: float) -> FloatArray:
    """Return rates of the beams that read (N, B) in steps from the first time on, scaled to 1."""
    columns = []
    for column in d.T:
        read = np.flatnonzero(~np.isnan(column))
        if len(read) > 1:
            ends = np.interp(time[[0, -1]], time[read], column[read])
            t = np.concatenate((time[:1], time[read], time[-1:]))
            x = np.concatenate((ends[:1], column[read], ends[1:]))
            late, early = _sides(t, x[:, None], step)
            rate = (late - early)[:, 0]
            # Faster ones come from a change of planes.
            most = FAR_SIGMAS * np.sqrt((rate**2).mean())
            rate = np.clip(rate, -most, most)
            columns.append(rate / max(float(np.linalg.norm(rate)), SINGULAR))
    return np.stack(columns, axis=1) if columns else np.zeros((1, 0))


def _sides(time: FloatArray, x: FloatArray, step: float) -> tuple[FloatArray, FloatArray]:
    """Return columns (N, k) a little after and a little before each step."""
    grid = np.arange(time[0], time[-1], step)
    both = [
        np.stack([np.interp(grid + side, time, column) for column in x.T], axis=1)
        for side in (HALF_WIDTH * step, -HALF_WIDTH * step)
    ]
    return both[0], both[1]
