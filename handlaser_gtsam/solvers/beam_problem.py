"""Beams that read planes as a least-squares problem of the reduction, and its solutions.

Many problems of one shape are solved together, each to the minimum of its graph; of many candidates
for one problem, a few damped steps tell which are promising.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from ..arrays import BoolArray, FloatArray, IntArray, gathered
from ..data.parameters import Parameters, RangeErrorPrior
from ..data.readings import Readings
from ..data.value import Value
from ..model import linearize, predicted_ranges, scene, tangent_basis, tangent_columns
from ..model.beams_on_planes import CENTRE, BeamsOnPlanes, parameters_of, values_of
from ..model.block import Block, Values, VectorPrior
from ..model.damped_search import LeastSquares, LevenbergOptions, RobustLoss, search
from ..model.families import BEAM, MOUNT_DIM, OF_RANGE_ERROR, PLANE, count_unknowns, modelled
from ..model.reduction import Normal, damped_step, reduction_of
from ..model.weighting import Whitening
from ..progress import tell
from ..quantities import ROWS_AT_ONCE

UNKNOWNS_RATIO = 4
"""Beams are eliminated first where they have more than this many times the unknowns of the planes."""
LEAST_DAMPING = 1e-8
"""Part of the information that is always added: it keeps an undetermined unknown where it started."""


class Candidate(NamedTuple):
    """A refined start.

    Attributes
    ----------
    parameters : Parameters
    criterion : float
        What candidates are compared by, lower is better: twice the cost at first, the sum of squares
        [m^2] if the loss is Gaussian.
    scale : float
        The unit of the loss at the end, of the residuals of good readings [m].
    method : str
        How its start was found.
    """

    parameters: Parameters
    criterion: float
    scale: float
    method: str = ""


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
        Of the numbers of every beam, SI units, NaN of a problem whose information is singular;
        `solve_many` alone computes them.
    """

    parameters: tuple[Parameters, ...]
    cost: FloatArray
    converged: BoolArray
    iterations: IntArray
    covariances: FloatArray = field(default_factory=lambda: np.empty((0, 0, 8, 8)))


def beam_problem(
    readings: Sequence[Readings],
    terms: int,
    noise: float | Sequence[Whitening],
    copies: int = 1,
    prior: RangeErrorPrior | None = None,
    robust: RobustLoss | None = None,
    local: str | None = None,
) -> tuple[LeastSquares, BeamsOnPlanes]:
    """Return the problems of several recordings, or candidates for one, and their readings as a block.

    Parameters
    ----------
    readings : K Readings of one shape, or one that `copies` candidates share
    terms : int
        Range-error terms of every beam.
    noise : float, or K Whitenings or one
        Standard deviation of every reading [m], or how to whiten the readings of each problem.
    copies : int
        Candidates.
    prior : RangeErrorPrior, optional
        Of every problem.
    robust : RobustLoss, optional
    local : str, optional
        The family that is eliminated; beams only where there are far more of them, if not given.
    """
    block = BeamsOnPlanes(readings, None if isinstance(noise, float) else noise)
    K = max(len(readings), copies)
    unit = np.full(K, noise if isinstance(noise, float) else [w.sigma for w in noise])
    blocks: list[Block] = [block]
    if prior is not None and terms:
        root = unit[:, None, None] * np.where(np.arange(2) < terms, 1.0 / prior.sigma, 0.0)
        mean = np.zeros_like(prior.sigma) if prior.mean is None else prior.mean
        blocks.append(VectorPrior(BEAM.name, root, mean))
    rounding = block.size * (4.0 * np.finfo(float).eps * block.reach() / unit) ** 2
    if robust is not None:
        real = block.spread(np.ones((1, block.size))).reshape(-1, block.slots_of_chunk) > 0.0
        robust = replace(robust, real=real)
    unknown: dict[str, BoolArray | bool] = {BEAM.name: modelled([terms])[0], PLANE.name: True}
    if local is None:
        free = (MOUNT_DIM + terms) * block.beams, PLANE.dim * block.planes
        apart = block.weights.common is None and free[0] > UNKNOWNS_RATIO * free[1]
        local = BEAM.name if apart else PLANE.name
    reduction = reduction_of(blocks, block.counts, unknown, local)
    dof = max(block.size - count_unknowns(readings[0], terms), 1)
    return LeastSquares(tuple(blocks), reduction, unit, rounding, dof, robust), block


def linearized(
    parameters: Parameters, readings: Readings, terms: int, whitening: Whitening | None = None
) -> tuple[Normal, FloatArray]:
    """Return the normal equations at `parameters`, with planes as local members, in metres.

    With them the points (P, 3) amid the laser spots at which the offset of each plane is taken [m].

    Raises
    ------
    GrazingBeamError
        A beam is parallel to its plane.
    """
    noise = 1.0 if whitening is None else [whitening]
    problem, block = beam_problem([readings], terms, noise, local=PLANE.name)
    values, normal = _normal_amid(problem, block, parameters, readings)
    return normal, values[PLANE.name][0, :, CENTRE]


def _normal_amid(
    problem: LeastSquares, block: BeamsOnPlanes, parameters: Parameters, readings: Readings
) -> tuple[Values, Normal]:
    """Return parameters as values, planes about points amid their spots, and normal equations there."""
    values = block.centred(values_of([parameters]))
    rows = problem.rows(values)
    if rows[0].impossible is not None:
        require_steep(parameters, readings)
    return values, problem.summed(rows)


def jacobian_columns(
    parameters: Parameters,
    readings: Readings,
    terms: int,
    centres: FloatArray | None = None,
) -> FloatArray:
    """Return the rows of (J_beam, J_plane, e), transposed: (5 + terms + 4, N).

    Offsets of planes are taken at `centres` (P, 3): amid the laser spots where not given.
    """
    x = scene(parameters, readings)
    linear = linearize(x, readings.measured)
    if centres is None:
        centres = readings.plane_means(linear.normal / linear.offset[:, None])
    v_basis = gathered(tangent_basis(parameters.directions), readings.beam)
    n_basis = gathered(tangent_basis(parameters.normals), readings.plane)
    middle = gathered(centres, readings.plane)
    return tangent_columns(linear, v_basis, n_basis, middle, terms)


def moved(
    parameters: Parameters, beam: FloatArray, plane: FloatArray, centres: FloatArray
) -> Parameters:
    """Return parameters moved by beam (B, 5 + terms) and plane (P, 3) steps about `centres` (P, 3)."""
    values = values_of([parameters])
    planes = values[PLANE.name]
    planes[..., CENTRE] = centres
    planes[0, :, 3] += (parameters.normals * centres).sum(axis=1)
    full = np.zeros((1, len(beam), BEAM.dim))
    full[0, :, : beam.shape[1]] = beam
    return parameters_of(
        {
            BEAM.name: BEAM.retract(values[BEAM.name], full),
            PLANE.name: PLANE.retract(planes, plane[None]),
        }
    )[0]


def newton_step(
    parameters: Parameters,
    readings: Readings,
    terms: int,
    whitening: Whitening,
    prior: RangeErrorPrior | None = None,
) -> tuple[Parameters, float]:
    """Return where an undamped step leads, and its length sqrt(-g' delta) [standard deviations].

    Raises
    ------
    GrazingBeamError
        A beam is parallel to its plane.
    """
    problem, block = beam_problem([readings], terms, [whitening], prior=prior)
    values, normal = _normal_amid(problem, block, parameters, readings)
    step, local = damped_step(normal, np.zeros(1))
    saved = -float((normal.gradient * step).sum() + (normal.local_gradient * local).sum())
    there = problem.reduction.moved(values, step, local)
    return parameters_of(there)[0], float(np.sqrt(max(saved, 0.0))) / whitening.sigma


def require_steep(parameters: Parameters, readings: Readings) -> None:
    """Refuse a beam that is parallel to its plane."""
    predicted_ranges(scene(parameters, readings))


def refine(start: Parameters, readings: Readings, terms: int, iterations: int) -> Candidate | None:
    """Take up to `iterations` damped steps from `start`; None where a beam grazes its plane there."""
    return refine_many([start], readings, terms, iterations)[0]


def refine_many(
    starts: Sequence[Parameters],
    readings: Readings | Sequence[Readings],
    terms: int,
    iterations: int,
    robust: RobustLoss | None = None,
) -> list[Candidate | None]:
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
    refined: list[Candidate | None] = []
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
        refined += [Candidate(at, 2.0 * c, s) if np.isfinite(c) else None for at, c, s in ends]
    return refined


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
    options = options or LevenbergOptions()
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
