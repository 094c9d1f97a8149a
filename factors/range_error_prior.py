r"""A prior on the range error of a beam.

The residual is k - mean for the vector k = (k1,) or (k1, k2). With zero mean and the scales that a
calibration has learned (`Calibration.range_error_scales`) it keeps both terms of a beam in a graph
whether or not its readings determine them.
"""

from collections.abc import Sequence

import gtsam
import numpy as np
from numpy.typing import ArrayLike

from handlaser_gtsam.errors import InputError

LEAST, MOST = 1e-30, 1e12
"""Of sigmas and means: inverse squares of others overflow."""


def range_error_prior(
    key: int, sigmas: Sequence[float] | ArrayLike, mean: Sequence[float] | ArrayLike | None = None
) -> gtsam.NonlinearFactor:
    """Return a Gaussian prior on a range error.

    Parameters
    ----------
    key : int
        Of the vector (k1,) or (k1, k2).
    sigmas : (1,) or (2,)
        Standard deviations of k1 [1] and k2 [1/m].
    mean : same shape, optional
        Zero where not given.

    Raises
    ------
    InputError
        Sigmas that are not positive, or shapes that differ.
    """
    try:
        sigma = np.array(sigmas, dtype=np.float64).ravel()
        centre = np.zeros(sigma.size) if mean is None else np.array(mean, dtype=np.float64).ravel()
    except (TypeError, ValueError, OverflowError) as error:
        found = f"sigmas or a mean that are no arrays of numbers ({error})"
        raise InputError(found, "numbers") from error
    if sigma.size not in (1, 2) or centre.size != sigma.size:
        raise InputError(
            f"{sigma.size} sigmas and {centre.size} means of a range error", "one or two of each"
        )
    if not ((sigma >= LEAST) & (sigma <= MOST) & (np.abs(centre) <= MOST)).all():
        found = f"range-error sigmas {sigma.tolist()} about {centre.tolist()}"
        raise InputError(found, f"positive sigmas, {LEAST:g} to {MOST:g}, about smaller numbers")
    model = gtsam.noiseModel.Diagonal.Sigmas(sigma)
    return gtsam.PriorFactorVector(key, centre, model)
