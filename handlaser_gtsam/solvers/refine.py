"""A few damped steps for many candidates at once: starts are compared after them."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..data.parameters import Parameters
from ..data.readings import Readings
from ..model.beams_on_planes import parameters_of
from ..model.damped_search import LevenbergOptions, RobustLoss, search
from ..progress import tell
from ..quantities import ROWS_AT_ONCE
from .beam_problem import beam_problem

LEAST_DAMPING = 1e-8
"""Part of the information that is always added: it keeps an undetermined unknown where it started."""


@dataclass(frozen=True, slots=True)
class Refined:
    """Parameters after some steps.

    Attributes
    ----------
    parameters : Parameters
    squares : float
        Twice the cost: the sum of squares [m^2] if the loss is Gaussian.
    scale : float
        The unit of the loss at the end [m].
    """

    parameters: Parameters
    squares: float
    scale: float


def refine(start: Parameters, readings: Readings, terms: int, iterations: int) -> Refined | None:
    """Take up to `iterations` damped steps from `start`; None where a beam grazes its plane there."""
    return refine_many([start], readings, terms, iterations)[0]


def refine_many(
    starts: Sequence[Parameters],
    readings: Readings | Sequence[Readings],
    terms: int,
    iterations: int,
    robust: RobustLoss | None = None,
) -> list[Refined | None]:
    """Refine every start; None where a beam grazes its plane there and the loss is not robust.

    A station whose label names a plane at right angles to the one it sees has beams that graze the
    plane named, at the solution as much as anywhere: their residuals grow beyond bounds and change
    sign within a few degrees. Under a robust loss residuals are therefore limited.

    Parameters
    ----------
    starts : Parameters, each
    readings : Readings, or one of the same beams, planes and stations for every start
    terms : int
        Range-error terms that are refined with the rest.
    iterations : int
        Most trial steps.
    robust : RobustLoss, optional
        Least squares where not given.
    """
    common = isinstance(readings, Readings)
    each = [readings] if isinstance(readings, Readings) else readings
    if robust is not None:  # residuals end at twice the upper quartile of the readings
        limit = 2.0 * max(float(np.quantile(one.distance, 0.75)) for one in each)
        robust = replace(robust, limit=limit)
    share = max(ROWS_AT_ONCE // max(len(each[0]), 1), 1)
    refined: list[Refined | None] = []
    for first in range(0, len(starts), share):
        tell("search")
        some = starts[first : first + share]
        read = each if common else each[first : first + share]
        problem, block = beam_problem(read, terms, 1.0, len(some), robust=robust)
        # What candidates would still save of their cost, 1e-9 of it, does not change their order.
        tolerance = 3e-5 * float(np.sqrt(problem.dof))
        options = LevenbergOptions(
            iterations,
            tolerance,
            least_damping=LEAST_DAMPING,
            first_damping=LEAST_DAMPING,
        )
        ended = search(problem, block.begun(some), options)
        parameters = parameters_of(block.facing(ended.values))  # a beam may have come from behind
        ends = zip(parameters, ended.cost.tolist(), ended.scale.tolist(), strict=True)
        refined += [Refined(at, 2.0 * c, s) if np.isfinite(c) else None for at, c, s in ends]
    return refined
