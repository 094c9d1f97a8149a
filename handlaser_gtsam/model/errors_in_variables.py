r"""Noise kept out of the columns of the range errors.

The residual e = s - g(d) errs by -g'(d) eps, where eps is the noise of the reading d. Its derivatives
by k1 and k2, -d and -d^2, hold the same noise: least squares over N readings then pull k1 by about
sqrt(N) sigma / spread of the readings, in its standard deviations, however large N is (errors in
variables; Fuller, Measurement Error Models, 1987). With C the covariance of the residuals of a station,
hand pose included, the residuals themselves say what the noise probably is,

    E[eps | e] = -g'(d) sigma^2 inv(C) e,

and a reading freed of it, d - E[eps | e], is uncorrelated with e. Where the range error is taken at
that, nothing is pulled, to first order. Residuals stay what they are at the parameters where this is
done:

    e = s - (c + k1 l + k2 l^2),    l = d - E[eps | e],    c = g(d) - k1 l - k2 l^2 there.
"""

import numpy as np

from ..data.parameters import Parameters
from ..data.readings import Readings, Regressors
from ..quantities import FAR_SIGMAS
from .equation import corrected, residuals, scene
from .weighting import Variances, Whitening, slopes, whitening


def weighed(
    readings: Readings, parameters: Parameters, variances: Variances, terms: int
) -> tuple[Readings, Whitening]:
    """Return the readings with the regressors of their range errors, and their whitening.

    The readings are returned as they are where they have no range-error `terms`, else
    `freed_of_noise`, which may raise.
    """
    how = whitening(parameters, readings, variances)
    return (freed_of_noise(readings, parameters, variances, how) if terms else readings), how


def freed_of_noise(
    readings: Readings, parameters: Parameters, variances: Variances, how: Whitening
) -> Readings:
    """Return readings of which the range error is taken without their probable noise.

    Parameters
    ----------
    readings : Readings
    at : Parameters
        Where the noise is judged.
    variances : Variances
    how : Whitening
        Of the readings at these parameters, errors of the hand poses included.

    Raises
    ------
    GrazingBeamError
        A beam is parallel to its plane.
    """
    d, x = readings.distance, scene(parameters, readings)
    variance = variances.range_sigma[readings.beam] ** 2
    if readings.samples is not None:
        variance = variance / readings.samples
    heavy = how.weighed(residuals(x, d)[:, None])[:, 0] / how.sigma**2
    share = slopes(parameters, readings) * variance
    most = FAR_SIGMAS * np.sqrt(variance)  # a larger residual is no noise
    level = d + np.clip(share * heavy, -most, most)
    constant = corrected(d, x.k) - level * (x.k[:, 0] + x.k[:, 1] * level)
    return readings.with_regressors(Regressors(constant, level))
