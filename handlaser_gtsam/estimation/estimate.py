r"""An estimate over any blocks of rows: solved, judged, and finished by GTSAM.

Sensors, targets and relations of one's own are blocks (`model.ranges`, `model.relations`). Here such
blocks get what beams on planes have: a search from many starts, the rank with names, rejected outliers,
covariances that GTSAM eliminates, score tests for what the model leaves out, and JSON.

Rows are in standard deviations. The derivatives of all rows are formed as one dense matrix for the
tests, so that a problem may have some thousand rows and some hundred unknowns.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from ..arrays import BoolArray, FloatArray, IntArray
from ..data.value import Value
from ..errors import InputError
from ..model.block import Block, Values, whitened
from ..model.distributions import gaussian_quantile
from ..model.families import FAMILIES
from ..model.ranges import Ranges
from ..model.reduction import Reduction
from ..model.search import LeastSquares, LevenbergOptions, search
from ..observability.rank import ObservabilityOptions
from ..quantities import MOST_ROUNDS, POWER, SINGULAR
from ..solvers.sums import eliminated_sums

SIGNIFICANCE = 0.01
"""Probability that a reading of a clean recording is rejected, or an effect found that is none."""
NAMED_SHARE = 0.1
"""Coordinates with at least this part of the largest one, in natural units, name a direction."""


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
    """

    blocks: Sequence[Block]
    start: Values
    unknown: Mapping[str, BoolArray | bool]
    length: float = 1.0


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Effect(Value):
    """What a score test says of a systematic error.

    Attributes
    ----------
    size, sigma : float
        Most probable size, and its standard deviation.
    detectable : float
        The smallest size that is found with a probability of `POWER`.
    found : bool
    """

    size: float
    sigma: float
    detectable: float
    found: bool


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Estimate(Value):
    """Values with their covariance.

    Attributes
    ----------
    status : str
        `converged`, `undetermined` or `not_converged`.
    values : mapping
        Members (n, size) of each family.
    names : tuple of str
        Of the unknowns: family, member and coordinate, as `beam[0].x`.
    covariance : (N, N)
        Of the unknowns in the order of the names; NaN where they are not determined.
    undetermined : tuple of str
        Each direction that the rows do not determine, as the unknowns that move along it.
    chi2, dof : float, int
    rejected : tuple of (G, S) of bool
        For each block, the readings that the others contradict.
    """

    status: Literal["converged", "undetermined", "not_converged"]
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
            raise InputError(
                f"an unknown named {name!r}", f"one of {', '.join(self.names[:8])} ..."
            )
        index = self.names.index(name)
        return float(np.sqrt(self.covariance[index, index]))

    def marginal(self, family: str, member: int) -> FloatArray:
        """Return the covariance of the unknown coordinates of one member."""
        first = f"{family}[{member}]."
        rows = [i for i, name in enumerate(self.names) if name.startswith(first)]
        return np.asarray(self.covariance[np.ix_(rows, rows)])

    def to_dict(self) -> dict[str, object]:
        """Return what JSON can hold: status, values by family, and every unknown with its sigma."""
        known = np.sqrt(np.diagonal(self.covariance))
        return {
            "status": self.status,
            "values": {name: x.tolist() for name, x in self.values.items()},
            "sigma": {
                name: None if np.isnan(s) else float(s)
                for name, s in zip(self.names, known, strict=True)
            },
            "undetermined": list(self.undetermined),
            "chi2": self.chi2,
            "dof": self.dof,
            "rejected": [int(rows.sum()) for rows in self.rejected],
        }


def estimate(problem: BlockProblem, options: LevenbergOptions | None = None) -> Estimate:
    """Estimate the unknowns of any blocks.

    Parameters
    ----------
    problem : BlockProblem
    options : LevenbergOptions, optional

    Raises
    ------
    InputError
        A start with numbers that are not finite, or members of another size than their family has.
    """
    options = options or LevenbergOptions()
    _require_start(problem)
    blocks = list(problem.blocks)
    ended = _solved(problem, blocks, problem.start, options)
    if ended is None:
        return _failed(problem, blocks)
    for _ in range(MOST_ROUNDS):
        rest = _without_worst(problem, blocks, ended)
        if rest is None:
            break
        again = _solved(problem, rest, ended, options)
        if again is None:
            break
        blocks, ended = rest, again
    return _judged(problem, blocks, ended)


def score_test(
    problem: BlockProblem, found: Estimate, columns: Mapping[str, Sequence[FloatArray]]
) -> dict[str, Effect]:
    """Test for systematic errors that the model leaves out.

    Parameters
    ----------
    problem : BlockProblem
    found : Estimate
    columns : mapping
        For each error, by how much one of size 1 changes the residuals (G, S) of every block.
    """
    blocks = [_kept(b, out) for b, out in zip(problem.blocks, found.rejected, strict=True)]
    values = {name: x[None] for name, x in found.values.items()}
    J, e, _ = _dense(problem, blocks, values)
    effects = {}
    cut = -float(gaussian_quantile(0.5 * SIGNIFICANCE / max(len(columns), 1)))
    for name, of_blocks in columns.items():
        a = np.concatenate(
            [
                (column if b.weights.root is None else column * b.weights.root[0]).ravel()
                for b, column in zip(blocks, of_blocks, strict=True)
            ]
        )
        rest = a - J @ np.linalg.lstsq(J, a, rcond=None)[0]
        left = float(rest @ rest)
        if left <= SINGULAR * float(a @ a):
            effects[name] = Effect(np.nan, np.inf, np.inf, False)
            continue
        size, sigma = float(rest @ e) / left, left**-0.5
        detectable = (cut + float(gaussian_quantile(POWER))) * sigma
        effects[name] = Effect(size, sigma, detectable, abs(size) > cut * sigma)
    return effects


def _solved(
    problem: BlockProblem, blocks: Sequence[Block], start: Values, options: LevenbergOptions
) -> dict[str, FloatArray] | None:
    """Return the values (1, n, size) at the best minimum, or None where no start leads to one."""
    K = max(len(x) for x in start.values())
    task = _least_squares(problem, blocks, K)
    damped = replace(options, least_damping=max(options.least_damping, SINGULAR))
    ended = search(task, start, damped)
    if not ended.converged.any():
        return None
    best = int(np.where(ended.converged, ended.cost, np.inf).argmin())
    return {name: x[best : best + 1] for name, x in ended.values.items()}


def _least_squares(problem: BlockProblem, blocks: Sequence[Block], K: int) -> LeastSquares:
    counts = {name: x.shape[1] for name, x in problem.start.items()}
    reduction = Reduction(blocks, counts, problem.unknown)
    size = reduction.structure.size + reduction.structure.members * reduction.structure.width
    dof = max(sum(_rows(block) for block in blocks) - size, 1)
    return LeastSquares(tuple(blocks), reduction, np.ones(K), np.zeros(K), dof)


def _rows(block: Block) -> int:
    """Return how many rows of a block weigh anything."""
    root = block.weights.root
    if root is not None:
        return int((root[0] > 0.0).sum())
    shape = block.reading.shape[1:] if isinstance(block, Ranges) else (1,)
    return int(np.prod(shape))


def _places(problem: BlockProblem) -> tuple[dict[str, IntArray], dict[str, IntArray], list[str]]:
    """Return where each member begins among all unknowns, its unknown coordinates, and all names."""
    place: dict[str, IntArray] = {}
    free: dict[str, IntArray] = {}
    names: list[str] = []
    for family, mask in problem.unknown.items():
        known = FAMILIES[family]
        free[family] = np.flatnonzero(np.broadcast_to(mask, known.dim))
        count = problem.start[family].shape[1]
        place[family] = len(names) + len(free[family]) * np.arange(count)
        names += [
            f"{family}[{i}].{known.coordinates[c]}" for i in range(count) for c in free[family]
        ]
    return place, free, names


def _dense(
    problem: BlockProblem, blocks: Sequence[Block], values: Values
) -> tuple[FloatArray, FloatArray, list[slice]]:
    """Return the whitened derivatives (R, N) and residuals (R,), and the rows of each block."""
    place, free, names = _places(problem)
    parts, residuals, where, first = [], [], [], 0
    for block in blocks:
        columns = whitened(block.evaluate(values), block.weights)[:, 0]
        G, S = columns.shape[1:]
        J = np.zeros((G, S, len(names)))
        for slot in block.slots():
            if slot.family not in place:
                continue
            for c, coordinate in enumerate(free[slot.family]):
                at = place[slot.family][slot.member] + c
                J[np.arange(G), :, at] += columns[slot.columns.start + coordinate]
        parts.append(J.reshape(G * S, -1))
        residuals.append(columns[-1].ravel())
        where.append(slice(first, first + G * S))
        first += G * S
    return np.concatenate(parts), np.concatenate(residuals), where


def _kept(block: Block, out: BoolArray) -> Block:
    """Return a block without some readings."""
    if not isinstance(block, Ranges) or not out.any():
        return block
    root = np.ones((1, *out.shape)) if block.weights.root is None else block.weights.root
    return replace(block, weights=replace(block.weights, root=np.where(out, 0.0, root)))


def _without_worst(
    problem: BlockProblem, blocks: Sequence[Block], values: Values
) -> list[Block] | None:
    """Return the blocks without the reading that the others contradict most, if any do.

    A reading is judged by its residual over the standard deviation that it should have, with the
    reading itself in the estimate (Baarda's w); the bound counts how many are judged.
    """
    J, e, where = _dense(problem, blocks, values)
    scale = np.sqrt((J**2).sum(axis=0))
    Q = np.linalg.qr(J / np.where(scale > 0.0, scale, 1.0))[0]
    free = 1.0 - (Q**2).sum(axis=1)
    tested = np.zeros(len(e), dtype=bool)
    for block, rows in zip(blocks, where, strict=True):
        tested[rows] = isinstance(block, Ranges)
    tested &= (free > SINGULAR**0.5) & (e != 0.0)
    if not tested.any():
        return None
    w = np.where(tested, np.abs(e) / np.sqrt(np.where(tested, free, 1.0)), 0.0)
    worst = int(w.argmax())
    if w[worst] <= -float(gaussian_quantile(0.5 * SIGNIFICANCE / int(tested.sum()))):
        return None
    rest = []
    for block, rows in zip(blocks, where, strict=True):
        if rows.start <= worst < rows.stop and isinstance(block, Ranges):
            out = np.zeros(rows.stop - rows.start, dtype=bool)
            out[worst - rows.start] = True
            block = _kept(block, out.reshape(block.reading.shape[1:]))
        rest.append(block)
    return rest


def _judged(problem: BlockProblem, blocks: Sequence[Block], values: Values) -> Estimate:
    """Return the estimate at a minimum, GTSAM's last step taken where everything is determined."""
    names = _places(problem)[2]
    open_axes, undetermined = _undetermined(problem, blocks, values, names)
    covariance = np.full((len(names), len(names)), np.nan)
    if not open_axes.shape[1]:
        values, covariance = _finished(problem, blocks, values)
    _, e, _ = _dense(problem, blocks, values)
    rows = sum(_rows(block) for block in blocks)
    return Estimate(
        "undetermined" if undetermined else "converged",
        {name: x[0] for name, x in values.items()},
        tuple(names),
        covariance,
        undetermined,
        float(e @ e),
        rows - len(names) + open_axes.shape[1],
        tuple(_out(b, left) for b, left in zip(problem.blocks, blocks, strict=True)),
    )


def _undetermined(
    problem: BlockProblem, blocks: Sequence[Block], values: Values, names: Sequence[str]
) -> tuple[FloatArray, tuple[str, ...]]:
    """Return the directions (N, q) that the rows do not determine, and what moves along each.

    A direction is undetermined where its standard deviation in natural units exceeds
    `ObservabilityOptions.most_sigma`, or where its information is rounding.
    """
    J, _, _ = _dense(problem, blocks, values)
    place, free, _ = _places(problem)
    unit = np.concatenate(
        [
            np.tile(FAMILIES[f].natural_units(problem.length)[free[f]], len(at))
            for f, at in place.items()
        ]
    )
    options = ObservabilityOptions()
    information, axes = np.linalg.eigh((J * unit).T @ (J * unit))
    least = max(options.most_sigma**-2, options.least_information * float(information[-1]))
    null = axes[:, information < least]
    echelon = null.T.copy()
    for r in range(len(echelon)):  # each direction gets a coordinate that the others do not have
        row, pivot = np.unravel_index(np.abs(echelon[r:]).argmax(), echelon[r:].shape)
        echelon[[r, r + row]] = echelon[[r + row, r]]
        echelon[r] /= echelon[r, pivot]
        others = np.arange(len(echelon)) != r
        echelon[others] -= np.outer(echelon[others, pivot], echelon[r])
    words = []
    for direction in echelon:
        size = np.abs(direction)
        moving = [names[i] for i in np.argsort(-size) if size[i] > NAMED_SHARE * size.max()]
        words.append(", ".join(moving))
    return null, tuple(words)


def _finished(
    problem: BlockProblem, blocks: Sequence[Block], values: Values
) -> tuple[Values, FloatArray]:
    """Return the values after GTSAM's last step, and the covariance of all unknowns.

    Raises
    ------
    RuntimeError, numpy.linalg.LinAlgError
        GTSAM calls the system indeterminate.
    """
    task = _least_squares(problem, blocks, 1)
    of = task.reduction.structure
    sums = eliminated_sums(task.normal(values), 1.0)
    moved = task.reduction.moved(values, sums.step[None], sums.local_step[None])
    n, d = of.size, of.width
    whole = np.zeros((n + of.members * d,) * 2)
    follow = -sums.response.reshape(-1, n)
    whole[:n, :n] = sums.covariance
    whole[n:, :n] = follow @ sums.covariance
    whole[:n, n:] = whole[n:, :n].T
    whole[n:, n:] = whole[n:, :n] @ follow.T
    for i in range(of.members):
        own = slice(n + i * d, n + (i + 1) * d)
        whole[own, own] += sums.known[i]
    order = []
    for family, columns in of.free.items():
        stays = of.place[family] >= 0
        first = np.where(stays, of.place[family], n + of.number[family] * d)
        order.append((first[:, None] + np.arange(len(columns))).ravel())
    index = np.concatenate(order)
    return moved, whole[np.ix_(index, index)]


def _out(block: Block, left: Block) -> BoolArray:
    """Return which readings of a block are rejected."""
    if not isinstance(block, Ranges) or left.weights.root is None:
        return np.zeros((1, 1), dtype=bool)
    before = True if block.weights.root is None else block.weights.root[0] > 0.0
    return np.asarray(before & (left.weights.root[0] == 0.0))


def _failed(problem: BlockProblem, blocks: Sequence[Block]) -> Estimate:
    """Return that no start led to a minimum."""
    names = _places(problem)[2]
    return Estimate(
        "not_converged",
        {name: x[0] for name, x in problem.start.items()},
        tuple(names),
        np.full((len(names), len(names)), np.nan),
        (),
        np.inf,
        sum(_rows(block) for block in blocks) - len(names),
        tuple(_out(block, block) for block in blocks),
    )


def _require_start(problem: BlockProblem) -> None:
    """Refuse starts that are none."""
    for name, x in problem.start.items():
        if name not in FAMILIES:
            raise InputError(f"a family {name!r}", f"one of {', '.join(FAMILIES)}; `register` it")
        if x.ndim != 3 or x.shape[2] != FAMILIES[name].size:
            expected = f"(starts, members, {FAMILIES[name].size})"
            raise InputError(f"a start of shape {x.shape} for {name}", expected)
        if not np.isfinite(x).all():
            raise InputError(f"a start of {name} that is not finite", "finite numbers")
    for name in problem.unknown:
        if name not in problem.start:
            raise InputError(f"no start of the unknown {name}", "one for each unknown family")
