"""Values of somebody else's graph: numbers that a solver can square."""

from collections.abc import Callable

import gtsam
import numpy as np
from numpy.typing import ArrayLike

from ..arrays import FloatArray
from ..errors import InputError
from ..quantities import LARGEST_NUMBER


def require_values(values: gtsam.Values) -> None:
    """Refuse what is no Values, and numbers in them that are not finite or beyond `LARGEST_NUMBER`.

    Raises
    ------
    InputError
    """
    if not isinstance(values, gtsam.Values):
        raise InputError(f"{type(values).__name__} as values", "gtsam.Values: the result's .values")
    readers: tuple[Callable[[int], ArrayLike], ...] = (
        values.atPoint3,
        values.atVector,
        lambda key: values.atOrientedPlane3(key).planeCoefficients(),
        lambda key: values.atPose3(key).matrix(),
        lambda key: values.atUnit3(key).point3(),
    )
    for key in values.keys():  # noqa: SIM118  (gtsam.Values is no dict)
        numbers = _numbers(key, readers)
        wrong = ~(np.abs(numbers) <= LARGEST_NUMBER)
        if wrong.any():
            name = gtsam.DefaultKeyFormatter(key)
            raise InputError(
                f"{numbers[wrong][0]:g} in the value of {name}",
                f"finite numbers, at most {LARGEST_NUMBER:g}",
            )


def _numbers(key: int, readers: tuple[Callable[[int], ArrayLike], ...]) -> FloatArray:
    """Return the numbers of a value; none where it is of a type that range factors do not use."""
    for read in readers:
        try:
            return np.asarray(read(key), dtype=np.float64).ravel()
        except RuntimeError:  # another type
            continue
    return np.empty(0)
