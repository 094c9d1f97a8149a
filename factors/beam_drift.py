r"""What a beam may have moved between two times: process noise between its variables then and now.

The error of the direction is v_now - v_before (3,): for small turns its length is their angle, and
unlike a tangent vector it needs no basis that both share.
"""

from collections.abc import Sequence

import gtsam
import numpy as np

from handlaser_gtsam.arrays import FloatArray
from handlaser_gtsam.checks import require_number
from handlaser_gtsam.errors import InputError
from handlaser_gtsam.keys import BeamKeys
from handlaser_gtsam.noise import MOST_SIGMA


def beam_drift(
    before: BeamKeys,
    now: BeamKeys,
    location_sigma: float,
    direction_sigma: float,
    range_error_sigmas: Sequence[float] = (),
) -> tuple[gtsam.NonlinearFactor, ...]:
    """Return the factors that tie a beam to what it was before.

    Parameters
    ----------
    before, now : BeamKeys
        With range errors of as many terms.
    location_sigma : float
        Of each coordinate of the shift [m].
    direction_sigma : float
        Of the turn about each axis across the beam [rad].
    range_error_sigmas : one a term
        Of the change of k1 [1] and k2 [1/m].

    Raises
    ------
    InputError
        A sigma that is not positive, or range errors of one of the two only.
    """
    sigmas = (location_sigma, direction_sigma, *range_error_sigmas)
    for sigma in sigmas:
        require_number("process noise", sigma, 0.0, MOST_SIGMA, above=True)
    isotropic = gtsam.noiseModel.Isotropic.Sigma
    factors: list[gtsam.NonlinearFactor] = [
        gtsam.BetweenFactorPoint3(
            before.location, now.location, np.zeros(3), isotropic(3, location_sigma)
        ),
        gtsam.CustomFactor(
            isotropic(3, direction_sigma), [before.direction, now.direction], _DirectionChange()
        ),
    ]
    with_errors = [keys.range_error is not None for keys in (before, now)]
    if with_errors != [bool(range_error_sigmas)] * 2:
        raise InputError(
            f"range errors {with_errors} and {len(range_error_sigmas)} sigmas of them",
            "both beams with range errors and one sigma a term, or none",
        )
    if before.range_error is not None and now.range_error is not None:
        model = gtsam.noiseModel.Diagonal.Sigmas(np.asarray(range_error_sigmas, dtype=float))
        none = np.zeros(len(range_error_sigmas))
        factors.append(gtsam.BetweenFactorVector(before.range_error, now.range_error, none, model))
    return tuple(factors)


class _DirectionChange:
    """The error function of the direction; it does not refer to its factor."""

    __slots__ = ()

    def __call__(
        self,
        factor: gtsam.CustomFactor,
        values: gtsam.Values,
        jacobians: gtsam.JacobianVector | Sequence[FloatArray] | None,
    ) -> FloatArray:
        before, now = (values.atUnit3(key) for key in factor.keys())  # noqa: SIM118
        if jacobians is not None:
            jacobians[0] = -before.basis()  # type: ignore[index]
            jacobians[1] = now.basis()  # type: ignore[index]
        change: FloatArray = now.point3() - before.point3()
        return change
