r"""Noise that is correlated in time: tested, and put into the standard deviations.

Readings of one beam before one plane follow one another in the order of the file, and where the robot
moves while it records, the errors of its poses change smoothly from one station to the next. Then n
readings tell less than n independent ones, and the weighted least-squares estimate x = K e has the
covariance K C K' and not K K'. Whitened noise is modelled as a sum of independent parts,

    C = s_0 I + sum_l s_l R_l,    R_l = exp(-|i - j| / l),

one of them white, the others autoregressive with lengths l of a few stations to a quarter of a plane's.
A correlation that falls off in another way is nearly such a sum.

Residuals w = P e are not the noise: the unknowns take their part of it, and make residuals of
independent noise correlate negatively. So both the test and the estimate are by simulation of the
linear problem. The squares of sums of m neighbours,

    V_m = sum_j (w_j + ... + w_(j + m - 1))^2,    m = 1, 2, 4 ...,

pooled over all beams and planes, are compared with sums of white noise, which gives the test: their
ratios to V_1, as cube roots, which are nearly Gaussian. Every part has its means of V_m, by simulation;
the s that are not negative and fit those of the residuals best are the estimate (an indirect inference:
Gourieroux, Monfort and Renault, Indirect inference, J. Appl. Econometrics 1993). K C K' follows from
them without simulation.

Systematic errors that were found make neighbouring residuals alike, too: they are taken out before.
"""

from typing import NamedTuple

import numpy as np
from scipy.linalg import orth
from scipy.linalg.lapack import dtbtrs
from scipy.optimize import nnls

from ..arrays import FloatArray, IntArray
from ..data.recording import Readings
from ..errors import CalibrationWarning
from ..model.families import BEAM
from ..quantities import FAR_SIGMAS, NEGLIGIBLE, NO_GROWTH, NUMBERS_AT_ONCE
from .messages import warned
from .projection import LinearRows, Projection

LEAST_DRAWS = 20
"""Draws for the largest recordings, which give that spread to 16 %."""
MOST_STEPS = 1000
"""Steps of the search for the sizes of the parts: a dozen parts take some twenty."""


class Dependence(NamedTuple):
    """How the noise of neighbouring readings depends.

    Attributes
    ----------
    correlation : float
        Of the noise of neighbours; zero where the readings do not show any.
    length : float
        Stations after which the correlated part of the noise has fallen to 1/e.
    growth, plane_growth : float
        By how much the standard deviations of the beams, and of the planes for known beams, are larger
        than with independent noise; one or more.
    """

    correlation: float = 0.0
    length: float = 0.0
    growth: float = 1.0
    plane_growth: float = 1.0

    @property
    def warnings(self) -> tuple[CalibrationWarning, ...]:
        """What to say about it; nothing where readings are independent."""
        if self == INDEPENDENT:
            return ()
        return (warned("correlated-in-time", self._asdict()),)


INDEPENDENT = Dependence()


def dependence(
    rows: LinearRows, projection: Projection, *, known: bool, found: FloatArray
) -> Dependence:
    """Test the residuals at a solution for correlation between neighbours in time.

    Parameters
    ----------
    rows : LinearRows
    projection : Projection
        Of these rows, beside their prior.
    known : bool
        Whether the size of the noise was given.
    found : (N, q)
        Columns of systematic errors that were found.
    """
    chains = _Chains(rows.readings, rows.position)
    # A correlation of fewer neighbours is unsure by more than a fifth.
    if chains.joined.sum() < 20:
        return INDEPENDENT
    how = rows.how

    def left(columns: FloatArray) -> FloatArray:
        """Whiten what unknowns and systematic errors that were found leave of columns (N, q)."""
        w = how.apply_rows(projection.rest(columns)[0])
        return np.asarray(w - explained @ (explained.T @ w))

    explained = np.empty((len(rows.readings), 0))
    if found.size:
        explained = orth(left(found), rcond=NEGLIGIBLE)
    # 300 draws give the spread of a sum to 4 %. Larger recordings get fewer: four arrays of draws, the
    # white ones and what is made of them, stand beside each other.
    count = int(np.clip(NUMBERS_AT_ONCE // (4 * len(rows.readings)), LEAST_DRAWS, 300))
    seen = chains.squares(left(rows.residual[:, None]))[:, 0]
    if not seen[0] > 0.0:
        return INDEPENDENT
    # A few draws suffice where the sums are not even half as far above them as the test asks. A fixed
    # seed: the same recording gives the same result each time.
    for draws, far in ((LEAST_DRAWS, 0.5 * FAR_SIGMAS), (count, FAR_SIGMAS)):
        white = np.random.default_rng(20).standard_normal((len(rows.readings), draws))
        quiet = chains.squares(left(how.coloured(white)))
        shares, share = np.cbrt(quiet / quiet[0]), np.cbrt(seen / seen[0])
        if not (share > shares.mean(axis=1) + far * shares.std(axis=1))[1:].any():
            return INDEPENDENT
    lengths = chains.lengths
    drawn = [left(how.coloured(chains.coloured(white, length))) for length in lengths]
    means = np.stack([quiet.mean(axis=1), *(chains.squares(w).mean(axis=1) for w in drawn)], axis=1)
    spread = quiet.std(axis=1)
    parts, _ = nnls(means / spread[:, None], seen / spread, maxiter=MOST_STEPS)
    # An estimated size of the noise lacks what the unknowns took of it.
    lost = 1.0 if known else float(parts.sum() * means[0, 0] / seen[0])
    parts = parts / parts.sum()
    growth = _growth(rows, projection, chains, parts)
    # The variance of the mean of the longest chain relative to white noise, by the length.
    lags = np.arange(1, chains.longest)
    of_means = 1.0 + 2.0 * np.exp(-lags / lengths[:, None]) @ (1.0 - lags / chains.longest)
    means_growth = float(parts @ [1.0, *of_means])
    growth, plane_growth = np.sqrt([lost * growth, lost * means_growth]).tolist()
    if max(growth, plane_growth) < NO_GROWTH:
        return INDEPENDENT
    together = parts[1:] / max(parts[1:].sum(), np.finfo(float).tiny)
    return Dependence(
        float(parts[1:] @ np.exp(-1.0 / lengths)),
        float(together @ lengths),
        max(1.0, growth),
        max(1.0, plane_growth, growth),
    )


def _growth(
    rows: LinearRows, projection: Projection, chains: "_Chains", parts: FloatArray
) -> float:
    """Return the largest ratio of a variance of any beam to that with independent noise."""
    planes, growth = projection.response.reshape(-1, projection.beam_inverse.shape[0]), 0.0
    for beam in range(rows.readings.beams):
        x = projection.beam_inverse[:, BEAM.dim * beam : BEAM.dim * (beam + 1)]
        x = x[:, x.any(axis=0)]
        gain = rows.how.apply_rows(projection.J @ np.concatenate((x, -planes @ x)))
        alone = (gain**2).sum(axis=0)
        variances = [alone, *(chains.variances(gain, length) for length in chains.lengths)]
        growth = max(growth, float((parts @ variances / alone).max()))
    return growth


class _Chains:
    """Readings as chains in time, one a beam and plane.

    Attributes
    ----------
    order : (N,)
        Rows by plane, beam and time.
    joined : (N - 1,) of bool
        Which neighbours in that order are of one chain.
    bounds : (chains + 1,)
        The first row of every chain, and the end of the last.
    longest : int
        Readings of the longest chain.
    lengths : (l,)
        Lengths of correlation that are tried [stations]: powers of two.
    """

    def __init__(self, readings: Readings, position: IntArray) -> None:
        order = np.lexsort((position, readings.beam, readings.plane))
        same = np.diff(readings.plane[order]) == 0
        self.order, self.joined = order, same & (np.diff(readings.beam[order]) == 0)
        self.bounds = np.concatenate(([0], np.flatnonzero(~self.joined) + 1, [len(order)]))
        self.longest = int(np.diff(self.bounds).max())
        # The unknowns explain longer correlations.
        most = max(self.longest / 4, 2.0)
        self.lengths = np.exp2(np.arange(int(np.log2(most)) + 1))

    def squares(self, w: FloatArray) -> FloatArray:
        """Return the squares of sums of 1, 2, 4 ... neighbours of columns (N, q), (s, q)."""
        sums = np.concatenate((np.zeros((1, w.shape[1])), np.cumsum(w[self.order], axis=0)))
        chain = np.concatenate(([0], np.cumsum(~self.joined)))
        squares = []
        for m in (1, *(2 * self.lengths).astype(int).tolist()):
            whole = chain[m - 1 :] == chain[: len(chain) - m + 1]
            if whole.any():
                squares.append(((sums[m:] - sums[:-m])[whole] ** 2).sum(axis=0))
        return np.stack(squares)

    def coloured(self, white: FloatArray, length: float) -> FloatArray:
        """Return noise (N, q) of unit variance with a length of correlation, from white noise."""
        rho = float(np.exp(-1.0 / length))
        noise = np.empty_like(white)
        for rows in np.split(self.order, self.bounds[1:-1]):
            steps = np.sqrt(1.0 - rho**2) * white[rows]
            steps[0] = white[rows[0]]
            noise[rows] = _discounted_sums(steps, rho)
        return noise

    def variances(self, gain: FloatArray, length: float) -> FloatArray:
        """Return the variances (q,) of the sums over columns (N, q) times noise of that length."""
        rho, variances = float(np.exp(-1.0 / length)), np.zeros(gain.shape[1])
        for rows in np.split(self.order, self.bounds[1:-1]):
            past = _discounted_sums(gain[rows], rho)
            variances += (gain[rows] * (2.0 * past - gain[rows])).sum(axis=0)
        return variances


def _discounted_sums(x: FloatArray, rho: float) -> FloatArray:
    """Return y (n, q) with y[i] = x[i] + rho y[i - 1] of columns x (n, q)."""
    # Ones on the diagonal and -rho below it. scipy.signal has this, and takes half a second to import.
    band = np.array([[1.0], [-rho]]).repeat(len(x), axis=1)
    return np.asarray(dtbtrs(band, x, uplo="L", diag="U")[0])
