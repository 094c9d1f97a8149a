r"""Process noise of a beam that may have moved: between its variables before and now.

The error of the direction has two rows, as many as there are degrees of freedom. With B the tangent
basis of v_before it is

    e = B' v_now sqrt(2 / (1 + c)),    c = v_before . v_now,

which is as long as v_now - v_before: for small turns, their angle.
"""

from collections.abc import Sequence

import gtsam
import numpy as np
from numpy.typing import ArrayLike

from handlaser_gtsam.arrays import FloatArray
from handlaser_gtsam.checks import number_array, require_number
from handlaser_gtsam.errors import InputError
from handlaser_gtsam.quantities import LARGEST_LENGTH, SINGULAR

from .keys import BeamKeys, require_beam


def beam_drift(
    before: BeamKeys,
    now: BeamKeys,
    location_sigma: float,
    direction_sigma: float,
    range_error_sigmas: ArrayLike = (),
) -> tuple[gtsam.NonlinearFactor, ...]:
    """Return the factors that tie a beam to its earlier state.

    Parameters
    ----------
    before, now : BeamKeys
        With range errors of as many terms, or with the key of one that has not changed in common.
    location_sigma : float
        Sigma of each coordinate of the shift [m].
    direction_sigma : float
        Sigma of the turn about each axis across the beam [rad].
    range_error_sigmas : one a term
        Sigmas of the change of each range error [1, 1/m].

    Raises
    ------
    InputError
        What is no BeamKeys, a sigma that is not positive, range errors of one of the two only, sigmas
        for a range error that both have in common, or a location or direction that they have in common.
    """
    require_beam("the beam before", before)
    require_beam("the beam now", now)
    of_terms = number_array("range_error_sigmas", range_error_sigmas, "one a range-error term")
    for sigma in (location_sigma, direction_sigma, *of_terms.ravel().tolist()):
        require_number("process noise", sigma, 0.0, LARGEST_LENGTH, above=True)
    shared = {before.location, before.direction} & {now.location, now.direction}
    if shared:
        names = ", ".join(gtsam.DefaultKeyFormatter(key) for key in sorted(shared))
        raise InputError(f"the beam before and now share {names}", "keys of its own for each time")
    isotropic = gtsam.noiseModel.Isotropic.Sigma
    factors: list[gtsam.NonlinearFactor] = [
        gtsam.BetweenFactorPoint3(
            before.location, now.location, np.zeros(3), isotropic(3, location_sigma)
        ),
        gtsam.CustomFactor(
            isotropic(2, direction_sigma), [before.direction, now.direction], _direction_change
        ),
    ]
    return (*factors, *_range_error_drift(before.range_error, now.range_error, of_terms.ravel()))


def _range_error_drift(
    k: int | None, k_now: int | None, range_error_sigmas: FloatArray
) -> list[gtsam.NonlinearFactor]:
    """Return the factor between two range errors; none where both are one, or there are none."""
    tied = k is not None and k_now is not None and k != k_now
    if (k is None) != (k_now is None) or bool(range_error_sigmas.size) != tied:
        raise InputError(
            f"range errors under {k} and {k_now} and {len(range_error_sigmas)} sigmas of them",
            "both beams with range errors and one sigma a term; no sigmas where both have none, or the "
            "key of one that stays the same",
        )
    if k is None or k_now is None or not tied:
        return []
    model = gtsam.noiseModel.Diagonal.Sigmas(range_error_sigmas)
    return [gtsam.BetweenFactorVector(k, k_now, np.zeros(len(range_error_sigmas)), model)]


def _direction_change(
    factor: gtsam.CustomFactor,
    values: gtsam.Values,
    jacobians: gtsam.JacobianVector | Sequence[FloatArray] | None,
) -> FloatArray:
    """Return the error of the direction, and fill its Jacobians where they are asked for."""
    before, now = (values.atUnit3(key) for key in factor.keys())  # noqa: SIM118
    v, basis, other = before.point3(), before.basis(), now.basis()
    e, c = basis.T @ now.point3(), float(v @ now.point3())
    # Opposite directions have no shortest way from one to the other.
    scale = np.sqrt(2.0 / max(1.0 + c, SINGULAR))
    by_c = -0.5 * scale / max(1.0 + c, SINGULAR)
    if jacobians is not None:
        turned = np.outer([e[1], -e[0]], basis_turn(v, basis)) - c * np.eye(2)
        jacobians[0] = scale * turned + by_c * np.outer(e, e)  # type: ignore[index]
        along = v @ other
        jacobians[1] = scale * basis.T @ other + by_c * np.outer(e, along)  # type: ignore[index]
    change: FloatArray = scale * e
    return change


def basis_turn(v: FloatArray, basis: FloatArray) -> FloatArray:
    """Return by how much the tangent basis (3, 2) at v (3,) turns about v, for steps along itself.

    GTSAM takes its first axis across v and the coordinate axis a at the largest angle to v; in a step
    dv it turns towards the second axis b2 by b2 . (dv x a) / |v x a|.
    """
    a = np.zeros(3)
    a[np.abs(v).argmin()] = 1.0
    across = np.cross(v, a)
    sign = np.sign(across @ basis[:, 0])
    turn: FloatArray = sign * (np.cross(basis.T, a) @ basis[:, 1]) / np.linalg.norm(across)
    return turn
