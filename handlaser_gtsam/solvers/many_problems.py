"""Many problems of one shape solved together on the reduction: each has the minimum of its graph."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from ..arrays import BoolArray, FloatArray, IntArray
from ..data.parameters import Parameters, RangeErrorPrior
from ..data.readings import Readings
from ..data.value import Value
from ..model.beams_on_planes import parameters_of
from ..model.damped_search import LevenbergOptions, search
from ..model.families import BEAM, OF_RANGE_ERROR
from ..model.weighting import Whitening
from ..quantities import ROWS_AT_ONCE
from .beam_problem import beam_problem

DEFAULT = LevenbergOptions()


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class SolvedMany(Value):
    """Solutions of K problems with the same beams, planes and stations.

    Attributes
    ----------
    parameters : K Parameters
        Planes in the frames of the readings, or in the world frame from `solve_many`.
    cost : (K,)
        Half the sum of squares in standard deviations, including the prior; infinite where a beam
        grazes its plane at the start.
    converged : (K,) of bool
    iterations : (K,)
        Steps of the last solution.
    covariances : (K, B, 8, 8)
        Of (x, y, z, vx, vy, vz, k1, k2) of every beam, SI units, NaN of a problem whose information is
        singular; `solve_many` alone computes them.
    """

    parameters: tuple[Parameters, ...]
    cost: FloatArray
    converged: BoolArray
    iterations: IntArray
    covariances: FloatArray = field(default_factory=lambda: np.empty((0, 0, 8, 8)))


def solve_together(
    problems: Sequence[Readings],
    starts: Sequence[Parameters],
    terms: int,
    noise: float | Sequence[Whitening],
    prior: RangeErrorPrior | None = None,
    options: LevenbergOptions | None = None,
) -> SolvedMany:
    """Minimise the cost of K problems of one shape.

    Parameters
    ----------
    problems : K Readings
        With the same beams, planes and stations, row by row.
    starts : K Parameters
        Their range errors beyond `terms` are ignored.
    terms : int
        Range-error terms of every beam.
    noise : float or K Whitenings
        Standard deviation of every reading [m], or how to whiten the readings of each problem.
    prior : RangeErrorPrior, optional
        Of every problem.
    options : LevenbergOptions, optional
    """
    options = DEFAULT if options is None else options
    share = max(ROWS_AT_ONCE // max(len(problems[0]), 1), 1)
    ends, parameters = [], []
    for first in range(0, len(problems), share):
        some = slice(first, first + share)
        of_some = noise if isinstance(noise, float) else noise[some]
        problem, block = beam_problem(problems[some], terms, of_some, prior=prior)
        begun = block.begun(starts[some])
        begun[BEAM.name][..., OF_RANGE_ERROR] *= np.arange(2) < terms
        ended = search(problem, begun, options)
        ends.append(ended)
        parameters += parameters_of(ended.values)
    return SolvedMany(
        tuple(parameters),
        np.concatenate([ended.cost for ended in ends]),
        np.concatenate([ended.converged for ended in ends]),
        np.concatenate([ended.iterations for ended in ends]),
    )
