r"""An estimate over any blocks of rows: solved, judged, and finished by GTSAM.

Sensors, targets and relations of one's own are blocks (`model.range_blocks`, `model.relation`).
Here such blocks get what beams on planes have: a search from many starts, the rank with names, rejected
outliers, covariances that GTSAM eliminates, score tests for what the model leaves out, and JSON.

Rows are in standard deviations. The derivatives of all rows are formed as one dense matrix for the
tests, so that a problem may have some thousand rows and some hundred unknowns.
"""

import contextlib
import math
from collections.abc import Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal, TypeVar

import numpy as np
from scipy.linalg import block_diag

from ..arrays import BoolArray, FloatArray
from ..data.value import Value
from ..errors import InputError
from ..model.block import Block, Values, impossible
from ..model.damped_search import LeastSquares, LevenbergOptions, Searched, search
from ..model.distributions import FAMILY_LEVEL, chi2_sf, gaussian_quantile, needed
from ..model.families import FAMILIES
from ..model.range_blocks import Ranges
from ..model.reduction import reduction_of
from ..observability.rank import ObservabilityOptions
from ..quantities import NEGLIGIBLE, ROWS_AT_ONCE, SINGULAR
from ..solvers.gtsam_sums import eliminated_sums
from .block_checks import require_blocks, require_start
from .dense import DenseRows, Unknowns, dense_rows, spanned, tests_of, unknowns_of

Name = TypeVar("Name", bound=Hashable)
MOST_REJECTED = 0.3
"""Largest part of the readings that may be rejected: beyond, not they but the model is at fault."""
NAMED_SHARE = 0.1
"""Coordinates with at least this part of the largest one, in natural units, name a direction."""


Status = Literal["converged", "undetermined", "contradicted", "not_converged"]


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class BlockProblem(Value):
    """What is estimated from which rows.

    Attributes
    ----------
    blocks : sequence of Block
        Rows in standard deviations.
    start : mapping
        Members (K, n, size) of each family, K starts; the best end is taken.
    unknown : mapping
        For each unknown family, which of its tangent coordinates are unknown, or True for all.
    length : float
        Typical range [m], for natural units.

    Notes
    -----
    What is in `start` and not in `unknown` is known. A reading that is NaN, or has no weight, is none.
    """

    blocks: Sequence[Block]
    start: Values
    unknown: Mapping[str, BoolArray | bool]
    length: float = 1.0

    def counts(self) -> dict[str, int]:
        """Return the members of each family."""
        return {name: x.shape[1] for name, x in self.start.items()}

    def places(self) -> Unknowns:
        """Return where the unknowns stand."""
        return unknowns_of(self.counts(), self.unknown)

    def rows(self, blocks: Sequence[Block], values: Values) -> DenseRows:
        """Return the rows of blocks as one dense matrix."""
        return dense_rows(blocks, values, self.places())


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class TestedEffect(Value):
    """What a score test says of a systematic error.

    Attributes
    ----------
    size, sigma : float
        Most probable size, and its standard deviation.
    detectable : float
        The smallest size that is found with a probability of `POWER`.
    found : bool
    spot_shift : float
        How far a spot of the sensor moves for an error of size 1 [m]; NaN where it is of no sensor.
    """

    size: float
    sigma: float
    detectable: float
    found: bool
    spot_shift: float = math.nan


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Estimate(Value):
    """Values with their covariance.

    Attributes
    ----------
    status, message : str
        `converged`, `undetermined`, `contradicted` (the rows do not fit each other) or `not_converged`,
        and the same in words.
    values : mapping
        Members (n, size) of each family.
    names : tuple of str
        Of the unknowns: family, member and coordinate, as `beam[0].x`.
    covariance : (N, N)
        Of the unknowns in the order of the names; NaN for those that an undetermined direction moves.
    undetermined : tuple of str
        Each direction that the rows do not determine, as the unknowns that move along it.
    chi2, dof : float, int
    rejected : tuple of (G, S) of bool
        For each block, the readings that the others contradict.
    """

    status: Status
    message: str
    values: Mapping[str, FloatArray]
    names: tuple[str, ...]
    covariance: FloatArray
    undetermined: tuple[str, ...]
    chi2: float
    dof: int
    rejected: tuple[BoolArray, ...]

    def sigma(self, name: str) -> float:
        """Return the standard deviation of an unknown by its name.

        Raises
        ------
        InputError
            There is none of this name.
        """
        if name not in self.names:
            raise InputError(f"an unknown named {name!r}", self._some_names())
        index = self.names.index(name)
        return float(np.sqrt(self.covariance[index, index]))

    def marginal(self, family: str, member: int) -> FloatArray:
        """Return the covariance of the unknown coordinates of one member.

        Raises
        ------
        InputError
            It has none.
        """
        first = f"{family}[{member}]."
        rows = [i for i, name in enumerate(self.names) if name.startswith(first)]
        if not rows:
            raise InputError(f"no unknowns of {first[:-1]}", self._some_names())
        return np.asarray(self.covariance[np.ix_(rows, rows)])

    def _some_names(self) -> str:
        return f"one of {', '.join(self.names[:8])} ..."

    def to_dict(self) -> dict[str, object]:
        """Return what JSON can hold; what is not known is None.

        `rejected` are block, group and reading of each.
        """
        known = np.sqrt(np.diagonal(self.covariance))
        return {
            "status": self.status,
            "message": self.message,
            "values": {name: x.tolist() for name, x in self.values.items()},
            "sigma": {
                name: None if np.isnan(s) else float(s)
                for name, s in zip(self.names, known, strict=True)
            },
            "undetermined": list(self.undetermined),
            "covariance": [
                [None if np.isnan(x) else x for x in row] for row in self.covariance.tolist()
            ],
            "chi2": self.chi2 if np.isfinite(self.chi2) else None,
            "dof": self.dof,
            "rejected": [
                [b, *place]
                for b, rows in enumerate(self.rejected)
                for place in np.argwhere(rows).tolist()
            ],
        }


def estimate(problem: BlockProblem) -> Estimate:
    """Estimate the unknowns of any blocks.

    Raises
    ------
    InputError
        A start that is none; blocks whose members, readings or weights do not belong to it.
    """
    require_start(problem)
    left = given = replace(problem, blocks=[_read(block) for block in problem.blocks])
    require_blocks(given)
    ended = minimum(given, given.start)
    if ended is None:
        return _failed(given)
    total = _rows(_readings(given.blocks), ended)
    for _ in range(int(MOST_REJECTED * total)):
        rest = _without_worst(left, ended)
        again = None if rest is None else minimum(rest, ended)
        if rest is None or again is None:
            break
        left, ended = rest, again
    return judged(left, ended, given.blocks)


def score_test(
    problem: BlockProblem, found: Estimate, columns: Mapping[str, Sequence[FloatArray]]
) -> dict[str, TestedEffect]:
    """Test for systematic errors that the model leaves out.

    Parameters
    ----------
    problem : BlockProblem
    found : Estimate
    columns : mapping
        For each error, by how much one of size 1 changes the residuals (G, S) of every block. What
        stands where there is no reading, or where it is rejected, counts for nothing.

    Raises
    ------
    InputError
        An estimate that is not a minimum, or columns of other shapes than the residuals, or that are
        not finite where there is a reading.
    """
    if found.status == "not_converged":
        raise InputError("an estimate that has not converged", "a minimum to test at")
    shapes = [out.shape for out in found.rejected]
    for name, of_blocks in columns.items():
        given = [np.shape(column) for column in of_blocks]
        if given != shapes:
            raise InputError(f"columns of {name} of shapes {given}", f"{shapes}, one a block")
    blocks = kept_blocks(problem, found)
    values = {name: x[None] for name, x in found.values.items()}
    J, e = problem.rows(blocks, values).whitened()
    roots = [b.weights.root for b in blocks]
    whole = {}
    for name, of_blocks in columns.items():
        parts = [
            column if root is None else np.where(root[0] == 0.0, 0.0, column) * root[0]
            for root, column in zip(roots, of_blocks, strict=True)
        ]
        whole[name] = -np.concatenate([part.ravel() for part in parts])
        if not np.isfinite(whole[name]).all():
            raise InputError(f"a column of {name} that is not finite at a reading", "numbers")
    return {name: effect for name, (effect, _) in tested_columns(J, e, whole).items()}


def tested_columns(
    J: FloatArray, e: FloatArray, columns: Mapping[Name, FloatArray]
) -> dict[Name, tuple[TestedEffect, FloatArray]]:
    """Return what rows say of unknowns that are held at zero, and how the others would follow.

    Parameters
    ----------
    J, e : (R, N), (R,)
        Derivatives and residuals of independent rows of one unit, at a minimum.
    columns : mapping
        Derivatives (R,) by each unknown that is held.

    Returns
    -------
    dict
        Of each: the test, and by how much (N,) the unknowns are wrong if it is of size 1.
    """
    known, inverse, _ = spanned(J)
    critical, delta = needed(FAMILY_LEVEL / max(len(columns), 1), None)
    tested = {}
    for name, a in columns.items():
        rest = a - known @ (known.T @ a)
        left = float(rest @ rest)
        effect = TestedEffect(np.nan, np.inf, np.inf, False)
        if left > SINGULAR * float(a @ a):
            size, sigma = -float(rest @ e) / left, left**-0.5
            effect = TestedEffect(size, sigma, delta * sigma, abs(size) > critical * sigma)
        tested[name] = effect, inverse @ a
    return tested


def kept_blocks(problem: BlockProblem, found: Estimate) -> list[Block]:
    """Return the blocks without what an estimate rejected, and without readings that are none.

    Parameters
    ----------
    problem : BlockProblem
    found : Estimate
        Of this problem.
    """
    read = [_read(block) for block in problem.blocks]
    return [_kept(b, out) for b, out in zip(read, found.rejected, strict=True)]


def minimum(
    problem: BlockProblem, start: Values, most: int | None = None
) -> dict[str, FloatArray] | None:
    """Return the values (1, n, size) at the best minimum from K starts; None where there is none.

    With `most`, a search counts that has not come to rest after this number of iterations: along what
    is undetermined it may wander without end, while chi2 has settled long before.
    """
    options = LevenbergOptions(least_damping=SINGULAR)
    options = options if most is None else replace(options, max_iterations=most)
    K = max(len(x) for x in start.values())
    first = {name: x[:1] for name, x in start.items()}
    share = max(ROWS_AT_ONCE // max(_rows(problem.blocks, first), 1), 1)
    best, least = None, np.inf
    for a in range(0, K, share):
        some = {name: x if len(x) == 1 else x[a : a + share] for name, x in start.items()}
        task = _least_squares(problem, min(share, K - a), first)
        ended = search(task, some, options)
        cost = np.where(ended.converged | (most is not None), ended.cost, np.inf)
        here = int(cost.argmin())
        if cost[here] < least:
            least = float(cost[here])
            best = {name: x[here : here + 1] for name, x in ended.values.items()}
    return best


def search_from(problem: BlockProblem, start: Values, iterations: int) -> Searched:
    """Return where searches of at most `iterations` from K starts end, at rest or not."""
    K = max(len(x) for x in start.values())
    task = _least_squares(problem, K, {name: x[:1] for name, x in start.items()})
    return search(task, start, LevenbergOptions(iterations, least_damping=SINGULAR))


def _least_squares(problem: BlockProblem, K: int, values: Values) -> LeastSquares:
    reduction = reduction_of(problem.blocks, problem.counts(), problem.unknown)
    size = reduction.size + reduction.members * reduction.width
    dof = max(_rows(problem.blocks, values) - size, 1)
    return LeastSquares(tuple(problem.blocks), reduction, np.ones(K), np.zeros(K), dof)


def _counted(block: Block, values: Values) -> BoolArray:
    """Return which rows (G, S) of a block weigh anything; only where all do, rows are computed."""
    root = block.weights.root
    if root is None:
        return np.ones(block.evaluate(values).columns.shape[2:], dtype=bool)
    return np.asarray(root[0] > 0.0)


def _rows(blocks: Iterable[Block], values: Values) -> int:
    """Return how many rows of some blocks weigh anything."""
    return sum(int(_counted(block, values).sum()) for block in blocks)


def _readings(blocks: Iterable[Block]) -> list[Ranges]:
    return [block for block in blocks if isinstance(block, Ranges)]


def _read(block: Block) -> Block:
    """Return a block in which a reading that is NaN has no weight."""
    if not isinstance(block, Ranges) or not np.isnan(block.reading).any():
        return block
    none = np.asarray(np.isnan(block.reading).any(axis=0))
    return _kept(replace(block, reading=np.nan_to_num(block.reading)), none)


def _kept(block: Block, out: BoolArray) -> Block:
    """Return a block without some of its readings (G, S), or as many in one row."""
    if not isinstance(block, Ranges) or not out.any():
        return block
    out = out.reshape(block.reading.shape[1:])
    root = np.ones((1, *out.shape)) if block.weights.root is None else block.weights.root
    return replace(block, weights=replace(block.weights, root=np.where(out, 0.0, root)))


def _without_worst(problem: BlockProblem, values: Values) -> BlockProblem | None:
    """Return the problem without the reading that the others contradict most, if any do.

    A reading is judged by its residual over the standard deviation that it should have, with the
    reading itself in the estimate (Baarda's w); the bound counts how many are judged.
    """
    rows = problem.rows(problem.blocks, values)
    tested = np.zeros(len(rows.residuals), dtype=bool)
    for block, part in zip(problem.blocks, rows.where, strict=True):
        tested[part] = isinstance(block, Ranges)
    tested &= rows.residuals != 0.0
    if not tested.any():
        return None
    number = np.where(tested, np.cumsum(tested) - 1, -1)
    found, _ = tests_of(rows, number)
    worst = int(found.argmax())
    if np.sqrt(found[worst]) <= -float(gaussian_quantile(0.5 * FAMILY_LEVEL / len(found))):
        return None
    worst = int(np.flatnonzero(tested)[worst])
    outs = [np.arange(part.start, part.stop) == worst for part in rows.where]
    pairs = zip(problem.blocks, outs, strict=True)
    return replace(problem, blocks=[_kept(block, out) for block, out in pairs])


def judged(problem: BlockProblem, values: Values, given: Sequence[Block] = ()) -> Estimate:
    """Return the estimate at a minimum, GTSAM's last step taken where everything is determined.

    Blocks that were `given` may have readings that are rejected in the problem.
    """
    blocks, names = problem.blocks, problem.places().names
    open_axes, undetermined, covariance = _undetermined(problem, values, names)
    if not undetermined:
        # Where GTSAM calls it indeterminate the covariance of the dense rows stands.
        with contextlib.suppress(RuntimeError, np.linalg.LinAlgError):
            values, covariance = _finished(problem, values)
    _, e = problem.rows(blocks, values).whitened()
    chi2, open_ = float(e @ e), open_axes.shape[1]
    dof = _rows(blocks, values) - len(names) + open_
    pairs = zip(given or blocks, blocks, strict=True)
    out = tuple(_counted(b, values) & ~_counted(left, values) for b, left in pairs)
    readings = _rows(_readings(given or blocks), values)
    many = sum(int(rows.sum()) for rows in out) >= int(MOST_REJECTED * readings) > 0
    status: Status = "converged"
    message = f"chi2 {chi2:.4g} at {dof} degrees of freedom"
    if undetermined:
        status, message = "undetermined", f"the rows do not determine {'; '.join(undetermined)}"
    elif many or (dof > 0 and float(chi2_sf(chi2, dof)) < NEGLIGIBLE):
        status = "contradicted"
        message = f"the rows do not fit each other: {message}"
    return Estimate(
        status,
        message,
        {name: x[0] for name, x in values.items()},
        tuple(names),
        covariance,
        undetermined,
        chi2,
        dof,
        out,
    )


def information_axes(
    problem: BlockProblem, values: Values
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the information (N,) of independent directions, these as columns (N, N), and units (N,).

    Directions are of unknowns in natural units; the last result has these units in SI units.
    """
    J, _ = problem.rows(problem.blocks, values).whitened()
    of = problem.places()
    unit = np.concatenate(
        [
            np.tile(FAMILIES[f].natural_units(problem.length)[of.free[f]], len(at))
            for f, at in of.place.items()
        ]
    )
    # By singular values, which keep twice the digits of the information, of the rows' triangle: those
    # of all rows would take the square of their number in memory.
    _, singular, axes = np.linalg.svd(np.linalg.qr(J * unit, mode="r"), full_matrices=True)
    information = np.zeros(len(of.names))
    information[: len(singular)] = singular**2
    return information, axes.T, unit


def least_information(information: FloatArray) -> float:
    """Return the information below which a direction is undetermined.

    Its standard deviation in natural units exceeds `ObservabilityOptions.most_sigma` there, or its
    information is rounding.
    """
    options = ObservabilityOptions()
    return max(options.most_sigma**-2, SINGULAR**2 * float(information.max()))


def covariance_along(
    found: tuple[FloatArray, FloatArray, FloatArray], J: FloatArray, first: int = 0
) -> FloatArray:
    """Return the covariance (F, F) of linear functionals of the unknowns.

    Parameters
    ----------
    found
        Information, axes and units, as `information_axes` returns them.
    J : (F, n)
        Derivatives of each by n unknowns in SI units, of which the `first` has that number.

    Returns
    -------
    (F, F)
        In the units of the functionals. Rows and columns are NaN where undetermined directions have
        more than `NEGLIGIBLE` of the squared length of a functional.
    """
    information, axes, unit = found
    functionals = np.zeros((len(J), len(unit)))
    at = slice(first, first + J.shape[1])
    functionals[:, at] = J * unit[at]
    known = information >= least_information(information)
    parts = functionals @ axes
    covariance = (parts[:, known] / information[known]) @ parts[:, known].T
    length = (functionals**2).sum(axis=1)
    moves = (parts[:, ~known] ** 2).sum(axis=1) > NEGLIGIBLE * length
    covariance[moves], covariance[:, moves] = np.nan, np.nan
    return np.asarray(covariance)


def _undetermined(
    problem: BlockProblem, values: Values, names: Sequence[str]
) -> tuple[FloatArray, tuple[str, ...], FloatArray]:
    """Return the directions (N, q) that the rows do not determine, and what moves along each.

    The third result is the covariance (N, N) of all that does not move along them, NaN for the rest.
    """
    found = information_axes(problem, values)
    information, axes, _ = found
    null = axes[:, information < least_information(information)]
    echelon = null.T.copy()
    for r in range(len(echelon)):  # each direction gets a coordinate that the others do not have
        row, pivot = divmod(int(np.abs(echelon[r:]).argmax()), echelon.shape[1])
        echelon[[r, r + row]] = echelon[[r + row, r]]
        echelon[r] /= echelon[r, pivot]
        others = np.arange(len(echelon)) != r
        echelon[others] -= np.outer(echelon[others, pivot], echelon[r])
    words = []
    for direction in echelon:
        size = np.abs(direction)
        moving = [names[i] for i in np.argsort(-size) if size[i] > NAMED_SHARE * size.max()]
        words.append(", ".join(moving))
    return null, tuple(words), covariance_along(found, np.eye(len(axes)))


def _finished(problem: BlockProblem, values: Values) -> tuple[Values, FloatArray]:
    """Return the values after GTSAM's last step, and the covariance of all unknowns.

    Raises
    ------
    RuntimeError, numpy.linalg.LinAlgError
        GTSAM calls the system indeterminate.
    """
    task = _least_squares(problem, 1, values)
    of = task.reduction
    sums = eliminated_sums(task.normal(values), 1.0)
    moved = task.reduction.moved(values, sums.step[None], sums.local_step[None])
    n, d = of.size, of.width
    known, response = sums.local_members()
    follow = np.vstack((np.eye(n), -response.reshape(of.members * d, n)))
    whole = follow @ sums.covariance() @ follow.T
    whole += block_diag(np.zeros((n, n)), *known)
    order = []
    for family, columns in of.free.items():
        stays = of.place[family] >= 0
        first = np.where(stays, of.place[family], n + of.number[family] * d)
        order.append((first[:, None] + np.arange(len(columns))).ravel())
    index = np.concatenate(order)
    return moved, whole[np.ix_(index, index)]


def _failed(problem: BlockProblem) -> Estimate:
    """Return that no start led to a minimum, and why."""
    names = problem.places().names
    first = {name: x[:1] for name, x in problem.start.items()}
    starts = max(len(x) for x in problem.start.values())
    never = [
        str(i)
        for i, block in enumerate(problem.blocks)
        if impossible(block.evaluate(problem.start), block).all()
    ]
    message = f"none of {starts} starts leads to a minimum"
    if never:
        message += f": at each, rows of block {', '.join(never)} are impossible"
    return Estimate(
        "not_converged",
        message,
        {name: x[0] for name, x in problem.start.items()},
        tuple(names),
        np.full((len(names), len(names)), np.nan),
        (),
        np.inf,
        _rows(problem.blocks, first) - len(names),
        tuple(np.zeros_like(_counted(block, first)) for block in problem.blocks),
    )
