r"""A prior on the range error of a beam.

The residual is k - mean for the vector k of one or two range errors. With zero mean and the scales
that a calibration has learned (`Calibration.learned.range_error_sigma`) it keeps both terms of a beam
in a graph whether or not its readings determine them.
"""

from collections.abc import Sequence

import gtsam
import numpy as np
from numpy.typing import ArrayLike

from handlaser_gtsam.errors import InputError
from handlaser_gtsam.quantities import LARGEST_NUMBER

from .keys import integer_key

LEAST_PRIOR_SIGMA = 1e-30
"""Smaller sigmas are refused: products of their inverse squares overflow."""


def range_error_prior(
    key: int, sigmas: Sequence[float] | ArrayLike, mean: Sequence[float] | ArrayLike | None = None
) -> gtsam.NonlinearFactor:
    """Return a Gaussian prior on a range error.

    Parameters
    ----------
    key : int
        Of the vector of one or two range errors.
    sigmas : (1,) or (2,)
        Standard deviations of the range errors [1, 1/m].
    mean : same shape, optional
        Zero where not given.

    Raises
    ------
    InputError
        A key that is none, sigmas that are not positive, or shapes that differ.
    """
    try:
        sigma = np.array(sigmas, dtype=np.float64).ravel()
        centre = np.zeros(sigma.size) if mean is None else np.array(mean, dtype=np.float64).ravel()
    except (TypeError, ValueError, OverflowError) as error:
        given = f"sigmas or a mean that are no arrays of numbers ({error})"
        raise InputError(given, "numbers") from error
    if sigma.size not in (1, 2) or centre.size != sigma.size:
        raise InputError(
            f"{sigma.size} sigmas and {centre.size} means of a range error", "one or two of each"
        )
    if not (
        (sigma >= LEAST_PRIOR_SIGMA)
        & (sigma <= LARGEST_NUMBER)
        & (np.abs(centre) <= LARGEST_NUMBER)
    ).all():
        given = f"range-error sigmas {sigma.tolist()} about {centre.tolist()}"
        raise InputError(
            given,
            f"positive sigmas, {LEAST_PRIOR_SIGMA:g} to {LARGEST_NUMBER:g}, about smaller numbers",
        )
    model = gtsam.noiseModel.Diagonal.Sigmas(sigma)
    return gtsam.PriorFactorVector(integer_key(key, "range error"), centre, model)
