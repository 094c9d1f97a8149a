r"""By how much errors inside shots make variances of fitted shapes larger than independent noise does.

Smoothing filters of profilers, and the grain of a surface, make errors of neighbouring readings go
together: a shot of n readings then says less than n independent ones. What it says less is seen in
the residuals e of its shape, whose orthonormal columns Q say how the shape hangs on each reading: the
variance Q' E[e e'] Q, with products of errors up to some distance from each other (Newey and West,
Econometrica 55 (1987), page 703). All shots of a sensor together say it.
"""

import numpy as np

from ..arrays import FloatArray, IntArray
from ..quantities import FAR_SIGMAS, MEDIAN_TO_SIGMA, NEGLIGIBLE

DISTANCES = (0, 1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64)
"""Up to one of these numbers of readings errors go together: filters and grain reach over some tens."""
LOST_AT_MOST = 0.6
"""A shape follows errors that go together over long distances: distances at which independent noise
would lose a larger part of its products so are passed over."""
FEWEST_SHOTS = 5
"""Fewer shots do not say how the noise inside them is."""


def growth_by_distance(Q: FloatArray, e: FloatArray, order: IntArray) -> FloatArray:
    """Return by how much errors that go together up to a distance make variances of a shape larger.

    Independent noise of unit variance has the expected value 1 at every distance. Distance 0 has
    errors that are larger where the shape hangs on a reading.

    Parameters
    ----------
    Q : (n, q)
        Orthonormal derivatives of the readings by the shape.
    e : (n,)
        Residuals, with a mean square of 1 for each degree of freedom.
    order : (n,)
        Of the readings along their line.

    Returns
    -------
    (k,)
        One for each of `DISTANCES`, NaN where it is not known.
    """
    found, (n, q) = np.full(len(DISTANCES), np.nan), Q.shape
    # Where a shape hangs on a reading, its residual is smaller than its error by this.
    smaller = np.sqrt(np.maximum(1.0 - (Q**2).sum(axis=1), NEGLIGIBLE))
    by_pairs = (Q[:, :, None] * Q[:, None]).reshape(n, -1)
    both = np.column_stack((e[:, None] * Q, by_pairs)) / smaller[:, None]
    size = 2 ** int(np.ceil(np.log2(2 * n)))
    power = np.abs(np.fft.rfft(both[order], size, axis=0)) ** 2
    near = np.fft.irfft(power, size, axis=0)[: min(n, DISTANCES[-1] + 1)]
    near[1:] *= 2.0
    near[0, q:] = 0.0
    sums = np.cumsum(near, axis=0) / q
    seen, lost = sums[:, :q].sum(axis=1), sums[:, q:].sum(axis=1)
    for i, distance in enumerate(DISTANCES):
        if distance < len(seen) and lost[distance] <= LOST_AT_MOST:
            found[i] = seen[distance] / (1.0 - lost[distance])
    return found


def common_growth(growth: FloatArray) -> float:
    """Return the growth (S, k) by distance that S shots have in common; 1 where it is not clear."""
    most = 1.0
    for each in growth.T:
        some = each[np.isfinite(each)]
        if len(some) >= FEWEST_SHOTS:
            middle = float(np.median(some))
            scatter = MEDIAN_TO_SIGMA * float(np.median(np.abs(some - middle)))
            # The median of Gaussian numbers scatters by 1.25 times what their mean does.
            error = 1.25 * scatter / np.sqrt(len(some))
            # The largest of many distances would be so by chance.
            if middle > max(1.0 + FAR_SIGMAS * error, most + error):
                most = middle
    return most
