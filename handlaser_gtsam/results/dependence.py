r"""Noise that is correlated in time: tested, and put into the standard deviations.

Readings of one beam before one plane follow one another in the order of the file. If their noise is
autoregressive, e_j = rho e_(j-1) + white, the weighted least-squares estimate x = K e has the
covariance K C(rho) K' and not K K':
n readings then tell no more about a mean than n (1 - rho) / (1 + rho)
independent ones do, and more or less about the rest, as the motion has it.

Residuals P e are not the noise: the unknowns take their part of it, and make residuals of independent
noise correlate negatively. So both the test and the estimate are by simulation of the linear problem.
Noise of a given rho is drawn, projected, and its lag-one autocorrelation

    q = sum w_j w_(j+1) / sum w_j^2,    w = P e,

pooled over all beams and planes, is compared with that of the residuals. At rho = 0 this gives the mean
and spread of q, for the test; the rho at which the mean of q is that of the residuals is the estimate
(an indirect inference: Gourieroux, Monfort and Renault, Indirect inference, J. Appl. Econometrics
1993). The same draws give the variance of every coordinate, over that of independent noise; where the
size of the noise comes from the residuals, these are smaller than the noise by a part that the same
draws tell.
"""

from dataclasses import asdict, dataclass

import numpy as np
from scipy.linalg.lapack import dtbtrs

from ..arrays import BoolArray, FloatArray, IntArray
from ..data.recording import Readings
from ..errors import CalibrationWarning
from .projection import WIDTH, Projection, Rows

FAR = 3.5
"""Standard deviations above its mean from which the autocorrelation is no accident: one in 4000."""
LEAST_PAIRS = 20
"""Fewer neighbours tell nothing of a correlation."""
LEAST_GROWTH = 1.02
"""Standard deviations that grow by less are left as they are."""
STEPS = np.array([0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.85, 0.9, 0.95, 0.98])
"""Correlations of neighbours that are tried; what lies between is interpolated."""
DRAWS, LEAST_DRAWS, NUMBERS = 300, 20, 1_000_000
"""Draws of the noise; fewer where there are so many readings that all numbers would be more."""
SEED = 20
"""Of the draws: the same recording gives the same result each time."""


@dataclass(frozen=True, slots=True)
class Dependence:
    """How the noise of neighbouring readings depends.

    Attributes
    ----------
    correlation : float
        Of the noise of neighbours, rho; zero where the readings do not show any.
    growth, plane_growth : float
        By how much the standard deviations of the beams, and those of the planes for known beams, are
        larger than with independent noise; one or more.
    """

    correlation: float = 0.0
    growth: float = 1.0
    plane_growth: float = 1.0

    @property
    def warnings(self) -> tuple[CalibrationWarning, ...]:
        """What to say about it; nothing where readings are independent."""
        if self.growth == 1.0 and self.plane_growth == 1.0:
            return ()
        words = (
            f"the residuals of neighbouring readings go together (their noise correlates by "
            f"{self.correlation:.2f}): the standard deviations of the beams are {self.growth:.2f} "
            f"times, those of the planes up to {self.plane_growth:.2f} times as large as with "
            "independent readings; read more slowly, or average less in the sensor, and visit "
            "stations in another order"
        )
        return (CalibrationWarning("correlated-in-time", words, asdict(self)),)


INDEPENDENT = Dependence()


def dependence(rows: Rows, *, known: bool) -> Dependence:
    """Test the residuals at a solution for correlation between neighbours in time.

    `known` tells whether the size of the noise was given.
    """
    readings, how = rows.readings, rows.how
    chain = _Chain.of(readings, rows.position)
    if chain.joined.sum() < LEAST_PAIRS:
        return INDEPENDENT
    projection = Projection(rows)
    back = how.inverse()
    count = int(np.clip(NUMBERS // len(readings), LEAST_DRAWS, DRAWS))
    white = np.random.default_rng(SEED).standard_normal((len(readings), count))

    def drawn(noise: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        left = projection.perpendicular(back.apply_rows(noise))
        w = back.transposed().apply_rows(left.heavy)
        moved = left.moved.reshape(readings.beams, WIDTH, -1)[:, :5]
        return chain.autocorrelation(w), (w**2).mean(axis=0), (moved**2).mean(axis=-1)

    found = float(chain.autocorrelation(how.apply(rows.residual)[:, None])[0])
    q, squares, variance = drawn(white)
    if found <= q.mean() + FAR * q.std():
        return INDEPENDENT
    means = [float(q.mean())]
    while means[-1] < found and len(means) < len(STEPS):
        one = drawn(chain.coloured(white, float(STEPS[len(means)])))
        means.append(max(float(one[0].mean()), means[-1] + 1e-9))
    rho = float(np.interp(found, means, STEPS[: len(means)]))
    _, loud, more = drawn(chain.coloured(white, rho))
    lost = 1.0 if known else float(squares.mean() / loud.mean())
    beams = float((more / np.where(variance > 0.0, variance, np.inf)).max())
    growth, plane_growth = np.sqrt([lost * beams, lost * chain.growth_of_means(rho)]).tolist()
    if max(growth, plane_growth) < LEAST_GROWTH:
        return INDEPENDENT
    return Dependence(rho, max(1.0, growth), max(1.0, plane_growth, growth))


@dataclass(frozen=True, slots=True)
class _Chain:
    """Readings as chains in time, one a beam and plane.

    Attributes
    ----------
    order : (N,)
        Rows by plane, beam and time.
    joined : (N - 1,) of bool
        Which neighbours in that order are of one chain.
    """

    order: IntArray
    joined: BoolArray

    @classmethod
    def of(cls, readings: Readings, position: IntArray) -> "_Chain":
        """Return the chains of some readings."""
        order = np.lexsort((position, readings.beam, readings.plane)).astype(np.intp)
        same = np.diff(readings.plane[order]) == 0
        return cls(order, same & (np.diff(readings.beam[order]) == 0))

    @property
    def bounds(self) -> IntArray:
        """The first row of every chain, and the end of the last."""
        return np.concatenate(([0], np.flatnonzero(~self.joined) + 1, [len(self.order)]))

    def autocorrelation(self, w: FloatArray) -> FloatArray:
        """Return the lag-one autocorrelation (q,) of columns (N, q), pooled over all chains."""
        w = w[self.order]
        products = (w[:-1] * w[1:])[self.joined].sum(axis=0)
        found: FloatArray = products / np.maximum((w**2).sum(axis=0), np.finfo(float).tiny)
        return found

    def coloured(self, white: FloatArray, rho: float) -> FloatArray:
        """Return noise (N, q) of unit variance whose neighbours correlate by rho, from white noise."""
        noise = np.empty_like(white)
        for rows in np.split(self.order, self.bounds[1:-1]):
            steps = np.sqrt(1.0 - rho**2) * white[rows]
            steps[0] = white[rows[0]]
            # x[i] - rho x[i - 1] = steps[i]: ones on the diagonal, -rho below it.
            band = np.array([[1.0], [-rho]]).repeat(len(rows), axis=1)
            noise[rows] = dtbtrs(band, steps, uplo="L", diag="U")[0]
        return noise

    def growth_of_means(self, rho: float) -> float:
        """Return the variance of the mean of the longest chain, over that of independent noise."""
        n = int(np.diff(self.bounds).max())
        lags = np.arange(1, n)
        return 1.0 + 2.0 * float(((1.0 - lags / n) * rho**lags).sum())
