r"""The elimination of local variables, batched: Brown's reduction, whatever the rows are.

Rows come from blocks in groups that see the same variables. Where no row ties two members of a family,
given all other variables they are independent, and the normal equations

    | H   E' | | x |     | g |
    | E   L  | | y | = - | h |,    L block-diagonal, one block a member,

are solved by eliminating these local members y: S = H - E' inv(L) E of what stays costs time linear in
their number. Members that a row or a station ties to others stay.

All arrays have a leading axis of K problems of one shape, or candidates for one problem. What depends
on the structure alone (which group sees which members) is planned once.
"""

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from ..arrays import BoolArray, FloatArray, IntArray
from ..quantities import SINGULAR, TINY
from .block import Block, Slot, SumsByKey, Values
from .families import FAMILIES
from .reduced_information import ReducedInformation, eliminated, inverse_stack, solve_definite

Index = slice | IntArray
COMMON_NUMBERS = 400_000
"""Sums over the rows of stations that are formed at once: they stay in the processor's cache, and with
few stations all are formed at once."""
FEWER = 8
"""Rows of groups that see the same variables are multiplied at once where groups are at least this many
times as many as such runs: of one group at a time, a product of few rows takes a call of its own."""


@dataclass(frozen=True, slots=True)
class Normal:
    """H delta = -g with local members apart; K problems.

    Attributes
    ----------
    matrix : (K, n, n)
        H, of what stays.
    gradient : (K, n)
    local : (K, m, d, d)
        L, of m local members.
    border : (K, m, d, n)
        E.
    local_gradient : (K, m, d)
    squares : (K,)
        The sum of squares of the rows.
    """

    matrix: FloatArray
    gradient: FloatArray
    local: FloatArray
    border: FloatArray
    local_gradient: FloatArray
    squares: FloatArray

    def arrays(self) -> tuple[FloatArray, ...]:
        """Return all arrays; each has the problems first."""
        return tuple(getattr(self, name) for name in self.__dataclass_fields__)

    def picked(self, problems: IntArray) -> "Normal":
        """Return some of the problems."""
        return Normal(*(array[problems] for array in self.arrays()))

    def replaced(self, which: BoolArray, new: "Normal") -> "Normal":
        """Return the equations in `new` of some problems (K,), and those here of the others."""
        pairs = zip(new.arrays(), self.arrays(), strict=True)
        return Normal(*(np.where(which.reshape(-1, *[1] * (a.ndim - 1)), a, b) for a, b in pairs))

    def reduced(
        self,
        unit: FloatArray,
        local_unit: FloatArray,
        active: BoolArray | None = None,
        known: FloatArray | None = None,
        floor: float | None = None,
    ) -> ReducedInformation:
        """Return what the only problem says of what stays, in the given units.

        Parameters
        ----------
        unit : (n,)
        local_unit : (d,)
        active : (n,) of bool, optional
            Unknowns; the others stay as they are.
        known : (n,), optional
            Information of every unknown beside the rows, in these units.
        floor : float, optional
            Information of a local member below this is none; `SINGULAR` of its largest where not given.
        """
        rows = np.arange(len(unit)) if active is None else np.flatnonzero(active)
        unit = unit[rows]
        H = self.matrix[0][np.ix_(rows, rows)] * unit[:, None] * unit
        if known is not None:
            H[np.diag_indices(len(rows))] += known[rows]
        return eliminated(
            H,
            self.border[0][..., rows] * unit * local_unit[:, None],
            self.local[0] * np.outer(local_unit, local_unit),
            self.gradient[0][rows] * unit,
            self.local_gradient[0] * local_unit,
            floor,
        )


class _StationSums:
    """Sums over the rows of each station, for some groups of a block.

    Parameters
    ----------
    groups : (g,)
    station : (G, S)
        Of every row of the block.

    Attributes
    ----------
    stations : Index
        In the order of the sums.
    """

    def __init__(self, groups: IntArray, station: IntArray) -> None:
        here = station[groups]
        self._groups = _sliced(groups)
        # All rows of a group may be of one station.
        self._by_group = here.shape[1] > 1 and bool((here == here[:, :1]).all())
        self._sums = SumsByKey(here[:, 0] if self._by_group else here.ravel())
        self.stations = _sliced(self._sums.keys)

    def __call__(self, common: FloatArray, columns: FloatArray) -> FloatArray:
        """Return A'U (K, q, c, stations) of common columns (c, K, G, S) and columns (q, K, G, S)."""
        U, A = common[:, :, self._groups], columns[:, :, self._groups]
        if self._by_group:
            products = U.transpose(1, 2, 0, 3) @ A.transpose(1, 2, 3, 0)
            return self._sums(products).transpose(0, 3, 2, 1)
        products = A.swapaxes(0, 1)[:, :, None] * U.swapaxes(0, 1)[:, None]
        rows = products.shape[3] * products.shape[4]  # -1 cannot stand for it without columns
        return self._sums(products.reshape(*products.shape[:3], rows), axis=3)


class _GroupPlan:
    """How the rows of some groups of one block are added to the normal equations.

    Parameters
    ----------
    of : Reduction
        With the places of all variables.
    block : int
    slots : sequence of Slot
        Of unknown families.
    which : (G,) of bool
        Groups, all with a local member of their own or all without.
    station : (G, S), optional
        Of every row of the block, where stations matter.

    Attributes
    ----------
    block : int
    runs : tuple of slice
        Of groups in their order, each run those that see the same variables: its rows are multiplied at
        once. Empty where groups are too few for that; then each is a run.
    columns, own : Index
        Columns of the rows by what stays, and by the local member; the latter None for none.
    places : list of Index
        Rows of H of each pattern, which is what groups see of what stays.
    tiled : bool
        Whether the patterns share out all that stays, one run after the other, and see the same local
        members: then all are added at once.
    by_station : list of _StationSums
        For each pattern, then for all groups; empty where stations do not matter.
    member_of_station : (stations,)
        The local member that each station sees, -1 for none.
    """

    def __init__(
        self,
        of: "Reduction",
        block: int,
        slots: Sequence[Slot],
        which: BoolArray,
        station: IntArray | None,
    ) -> None:
        self.block = block
        self.own: Index | None = None
        member: IntArray | None = None
        columns: list[IntArray] = []
        places: list[IntArray] = []
        key = np.zeros(int(which.sum()), dtype=np.intp)
        for slot in slots:
            seen = slot.member[which]
            mine = slot.columns.start + of.free[slot.family]
            if slot.family == of.local and (of.number[slot.family][seen] >= 0).all():
                self.own, member = _sliced(mine), of.number[slot.family][seen]
                continue
            columns.append(mine)
            places.append(of.place[slot.family][seen][:, None] + np.arange(len(mine)))
            key = key * of.counts[slot.family] + seen
        _, first, pattern = np.unique(key, return_index=True, return_inverse=True)
        pattern = pattern.ravel()
        of_pattern = np.hstack(places)[first] if places else np.zeros((1, 0), dtype=np.intp)
        groups = np.flatnonzero(which)
        self.by_station: list[_StationSums] = []
        self.member_of_station = np.zeros(0, dtype=np.intp)
        if station is not None:
            some = [groups[pattern == u] for u in range(len(first))]
            self.by_station = [_StationSums(g, station) for g in (*some, groups)]
            self.member_of_station = np.full(int(station.max()) + 1, -1)
            if member is not None:
                self.member_of_station[station[groups]] = member[:, None]
        key = pattern if member is None else pattern * of.members + member
        order = np.argsort(key, kind="stable")
        begins = np.flatnonzero(np.diff(key[order], prepend=-1))
        self.runs: tuple[slice, ...] = ()
        if len(groups) >= FEWER * len(begins):
            self.runs = tuple(slice(a, b) for a, b in pairwise((*begins.tolist(), len(groups))))
            groups, pattern = groups[order], pattern[order[begins]]
            member = None if member is None else member[order[begins]]
        self._groups, self._by_pattern = _sliced(groups), SumsByKey(pattern)
        self.columns = _sliced(np.concatenate(columns)) if columns else slice(0, 0)
        self.places = [_sliced(place) for place in of_pattern]
        self.tiled = of_pattern.size > 0 and np.array_equal(of_pattern.ravel(), np.arange(of.size))
        if member is None:
            return
        self._by_member, by_both = SumsByKey(member), SumsByKey(pattern * of.members + member)
        self._members, self._by_both = _sliced(self._by_member.keys), by_both
        edges = np.searchsorted(by_both.keys, of.members * np.arange(len(first) + 1)).tolist()
        # Of each pattern: where its sums by both stand, and the local members they are of.
        self._pairs = [
            (slice(a, b), _sliced(by_both.keys[a:b] - u * of.members))
            for u, (a, b) in enumerate(pairwise(edges))
        ]
        self.tiled = self.tiled and len(by_both.keys) == len(first) * len(self._by_member.keys)

    def add(self, total: Normal, columns: FloatArray) -> None:
        """Add the products of the columns (q + 1, K, G, S) of the groups."""
        x = columns[:, :, self._groups]
        if self.runs:
            parts = [x[:, :, run].reshape(*x.shape[:2], -1).swapaxes(0, 1) for run in self.runs]
            P = np.stack([part @ part.swapaxes(1, 2) for part in parts], axis=1)
        else:
            x = x.transpose(1, 2, 0, 3)
            P = x @ x.swapaxes(2, 3)
        kept = self._by_pattern(P[:, :, self.columns])
        gradient, kept = kept[..., -1], kept[..., self.columns]
        if self.tiled:
            K, U, w = gradient.shape
            np.einsum("kuiuj->kuij", total.matrix.reshape(K, U, w, U, w))[:] += kept
            total.gradient.reshape(K, U, w)[:] += gradient
        else:
            for u, place in enumerate(self.places):
                rows = place if isinstance(place, slice) else place[:, None]
                total.matrix[:, rows, place] += kept[:, u]
                total.gradient[:, place] += gradient[:, u]
        if self.own is None:
            return
        own = P[:, :, self.own]
        rest = self._by_member(own)
        total.local[:, self._members] += rest[..., self.own]
        total.local_gradient[:, self._members] += rest[..., -1]
        border = self._by_both(own[..., self.columns])
        if self.tiled:
            by_pattern = border.reshape(K, U, -1, *border.shape[2:]).transpose(0, 2, 3, 1, 4)
            total.border.reshape(*total.border.shape[:3], U, w)[:, self._members] += by_pattern
            return
        for (sums, members), place in zip(self._pairs, self.places, strict=True):
            if isinstance(members, slice) or isinstance(place, slice):
                total.border[:, members, :, place] += border[:, sums]
            else:
                total.border[:, members[:, None], :, place] += border[:, sums].transpose(1, 3, 0, 2)


class Reduction:
    """Adds up the rows of blocks, eliminates local members, and moves values by the steps.

    It holds no number of the blocks: which variables stay, which are eliminated, and how rows are added
    up. Blocks of the same structure, as of some of the problems, share it.

    Parameters
    ----------
    blocks : sequence of Block
    counts : mapping
        Members of each family.
    free : mapping
        Tangent coordinates of each unknown family that are unknown.
    local : str or None
        The family that is eliminated; where not given, the one that leaves the fewest unknowns.

    Attributes
    ----------
    place : dict
        For each family: where each member begins among what stays (-1: it is local).
    number : dict
        For each family: the number of each member among the local ones (-1: it stays).
    size, members, width, stations : int
        Unknowns that stay, local members, unknowns of one, and stations of common columns.
    by_member : SumsByKey, optional
        Runs of stations that see one local member (`by_run`); none where no station sees any.
    """

    def __init__(
        self,
        blocks: Sequence[Block],
        counts: Mapping[str, int],
        free: Mapping[str, IntArray],
        local: str | None,
    ) -> None:
        self.counts, self.free = dict(counts), dict(free)
        tied = {name: _tied(blocks, name, counts[name]) for name in free}
        if local is None:
            sizes = {f: len(free[f]) * int((~tied[f]).sum()) for f in free}
            local = max(sizes, key=lambda name: sizes[name])
        self.local = local
        self.place: dict[str, IntArray] = {}
        self.number: dict[str, IntArray] = {}
        self.size, self.members = 0, 0
        for name, columns in free.items():
            apart = np.zeros(counts[name], dtype=bool) if name != local else ~tied[name]
            self.place[name] = np.where(apart, -1, self.size + len(columns) * _before(~apart))
            self.number[name] = np.where(apart, _before(apart), -1)
            self.size += len(columns) * int((~apart).sum())
            self.members += int(apart.sum())
        self.width = len(free[local])
        self.plans = [plan for i, block in enumerate(blocks) for plan in self._plans(i, block)]
        self._plan_stations()

    def by_run(self, sums: FloatArray) -> FloatArray:
        """Return what stations have (K, q, c, stations), run by run: (K, runs, q, c x stations)."""
        K, q = sums.shape[:2]
        runs = sums[..., self._seen].reshape(*sums.shape[:3], -1, self._run)
        return runs.transpose(0, 3, 1, 2, 4).reshape(K, runs.shape[3], q, -1)

    def normal(self, blocks: Sequence[Block], rows: Sequence[FloatArray]) -> Normal:
        """Return the normal equations of the whitened rows (q + 1, K, G, S) of all blocks."""
        K, n, m, d = rows[0].shape[1], self.size, self.members, self.width
        squares = np.zeros(K)
        for columns in rows:
            squares += np.einsum("kgs,kgs->k", columns[-1], columns[-1])
        total = Normal(
            np.zeros((K, n, n)),
            np.zeros((K, n)),
            np.zeros((K, m, d, d)),
            np.zeros((K, m, d, n)),
            np.zeros((K, m, d)),
            squares,
        )
        for plan in self.plans:
            plan.add(total, rows[plan.block])
        _take_common(total, self, blocks, rows)
        return total

    def moved(self, values: Values, step: FloatArray, local_step: FloatArray) -> Values:
        """Return values moved by the steps."""
        new = dict(values)
        for name, columns in self.free.items():
            delta = self.gathered(name, step, local_step)
            if len(columns) < FAMILIES[name].dim:
                whole = np.zeros((*delta.shape[:2], FAMILIES[name].dim))
                whole[..., columns] = delta
                delta = whole
            new[name] = FAMILIES[name].retract(values[name], delta)
        return new

    def gathered(self, name: str, step: FloatArray, local_step: FloatArray) -> FloatArray:
        """Return the steps (K, members, unknown coordinates) of a family, given all steps."""
        place, number, width = self.place[name], self.number[name], len(self.free[name])
        if name != self.local:
            first = int(place[0])
            return step[:, first : first + len(place) * width].reshape(len(step), -1, width)
        if self.members == len(place):
            return local_step
        stays = place >= 0
        delta = np.empty((len(step), len(place), width))
        delta[:, stays] = step[:, place[stays][:, None] + np.arange(width)]
        delta[:, ~stays] = local_step[:, number[~stays]]
        return delta

    def _plan_stations(self) -> None:
        """Find the stations that see a local member, and runs of one length with the same member."""
        self.stations = max((len(plan.member_of_station) for plan in self.plans), default=0)
        member = np.full(self.stations, -1)
        for plan in self.plans:
            there = member[: len(plan.member_of_station)]
            np.maximum(there, plan.member_of_station, out=there)
        seen = np.flatnonzero(member >= 0)
        self._seen, self._run = _sliced(seen), 1
        self.by_member: SumsByKey | None = None
        if seen.size:
            cuts = np.flatnonzero(np.diff(member[seen])) + 1
            self._run = int(np.gcd.reduce(np.append(cuts, len(seen))))
            self.by_member = SumsByKey(member[seen[:: self._run]])

    def _plans(self, index: int, block: Block) -> list[_GroupPlan]:
        """Return the plans of the groups whose local member is eliminated, and of all others."""
        slots = [slot for slot in block.slots() if slot.family in self.free]
        if not slots:
            return []
        apart = np.zeros(len(slots[0].member), dtype=bool)
        for slot in slots:
            apart |= self.number[slot.family][slot.member] >= 0
        station = block.weights.station
        return [
            _GroupPlan(self, index, slots, which, station)
            for which in (apart, ~apart)
            if which.any()
        ]


_KNOWN: dict[Hashable, Reduction] = {}


def reduction_of(
    blocks: Sequence[Block],
    counts: Mapping[str, int],
    unknown: Mapping[str, BoolArray | bool],
    local: str | None = None,
) -> Reduction:
    """Return the reduction of blocks; it is planned once for all of the same structure.

    Parameters
    ----------
    blocks : sequence of Block
    counts : mapping
        Members of each family.
    unknown : mapping
        For each unknown family, which of its tangent coordinates are unknown (dim,), or True for all.
    local : str, optional
        The family that is eliminated; where not given, the one that leaves the fewest unknowns.
    """
    free = {
        name: np.flatnonzero(np.ones(FAMILIES[name].dim, dtype=bool) & mask)
        for name, mask in unknown.items()
    }
    free = {name: columns for name, columns in free.items() if len(columns)}
    structures = []
    for block in blocks:
        slots = [(s.family, s.member.tobytes(), s.columns.start) for s in block.slots()]
        station = block.weights.station
        structures.append((*slots, station is not None and (station.shape, station.tobytes())))
    key = (
        tuple(structures),
        tuple(counts.items()),
        tuple((name, columns.tobytes()) for name, columns in free.items()),
        local,
    )
    if key not in _KNOWN:
        while len(_KNOWN) >= 64:  # a calibration meets a dozen, again and again
            _KNOWN.pop(next(iter(_KNOWN)))
        _KNOWN[key] = Reduction(blocks, counts, free, local)
    return _KNOWN[key]


def damped_step(normal: Normal, damping: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return steps (K, n) of what stays and (K, m, d) of local members for Marquardt's damping (K,)."""
    damped, L, n = bool(damping.any()), normal.local, normal.gradient.shape[1]
    if damped:
        lift = _lift(damping, np.einsum("kmii->kmi", L))
        L = L + lift[..., None] * np.eye(L.shape[-1])
    # All that the local members answer to: a unit of every unknown that stays, and the gradients.
    right = np.concatenate((normal.border, normal.local_gradient[..., None]), axis=3)
    answer = (inverse_stack(L) @ right).reshape(len(L), -1, n + 1)
    taken = right.reshape(answer.shape)[..., :n].swapaxes(1, 2) @ answer
    S = normal.matrix - taken[..., :n]
    if damped:
        np.einsum("kii->ki", S)[:] += _lift(damping, np.einsum("kii->ki", normal.matrix))
    step = solve_definite(S, taken[..., n] - normal.gradient) if n else normal.gradient
    moved = answer[..., n] + (answer[..., :n] @ step[..., None])[..., 0]
    return step, -moved.reshape(normal.local_gradient.shape)


def _take_common(
    total: Normal, of: Reduction, blocks: Sequence[Block], rows: Sequence[FloatArray]
) -> None:
    """Take out the weight that rows of a station lose by what they have in common.

    With the common columns U of a station (`Weights`) and Y = A'U of all its rows A, the normal
    equations lose Y Y'.
    """
    plans = [plan for plan in of.plans if blocks[plan.block].weights.common is not None]
    if not plans:
        return
    first = blocks[plans[0].block].weights.common
    assert first is not None
    K, n = total.gradient.shape
    numbers = K * (n + 1) * of.stations
    step = int(np.clip(COMMON_NUMBERS // max(numbers, 1), 1, len(first)))
    sums = np.empty(numbers * step), np.empty(K * of.width * of.stations * step)
    for begin in range(0, len(first), step):
        some = slice(begin, min(begin + step, len(first)))
        shape = some.stop - begin, of.stations
        Y, Z = (
            into[: K * size * shape[0] * shape[1]].reshape(K, size, *shape)
            for into, size in zip(sums, (n + 1, of.width), strict=True)
        )
        _sum_common(plans, blocks, rows, some, (Y, Z))
        flat = Y.reshape(K, n + 1, -1)
        product = flat @ flat.swapaxes(1, 2)
        total.matrix[:] -= product[:, :n, :n]
        total.gradient[:] -= product[:, :n, n]
        total.squares[:] -= product[:, n, n]
        if of.by_member is not None:
            here, Z = of.by_member.keys, of.by_run(Z)
            total.local[:, here] -= of.by_member(Z @ Z.swapaxes(2, 3))
            both = of.by_member(Z @ of.by_run(Y).swapaxes(2, 3))
            total.border[:, here] -= both[..., :n]
            total.local_gradient[:, here] -= both[..., n]


def _sum_common(
    plans: Sequence[_GroupPlan],
    blocks: Sequence[Block],
    rows: Sequence[FloatArray],
    some: slice,
    into: tuple[FloatArray, FloatArray],
) -> None:
    """Fill in Y (K, n + 1, c, stations) and Z (K, d, c, stations): A'U for `some` columns of U.

    Y is of what stays and of the residual, Z of the local member of each station.
    """
    Y, Z = into
    Y[:], Z[:] = 0.0, 0.0
    n, each = Y.shape[1] - 1, np.arange(Y.shape[2])[:, None]
    for plan in plans:
        common, columns = blocks[plan.block].weights.common, rows[plan.block]
        assert common is not None
        U = common[some]
        for by_station, place in zip(plan.by_station, plan.places, strict=False):
            here, sums = by_station.stations, by_station(U, columns[plan.columns])
            if isinstance(here, slice) and isinstance(place, slice):
                there = Y[:, place, :, here]  # a view: what is added to it is not copied again
                there += sums
            elif isinstance(here, slice) or isinstance(place, slice):
                Y[:, place, :, here] += sums
            else:
                Y[:, place[:, None, None], each, here] += sums
        whole = plan.by_station[-1]
        Y[:, n:, :, whole.stations] += whole(U, columns[-1:])
        if plan.own is not None:
            Z[..., whole.stations] += whole(U, columns[plan.own])


def _tied(blocks: Sequence[Block], family: str, count: int) -> BoolArray:
    """Tell which members (count,) of a family a row, or a station whose pose errs, ties to others."""
    tied = np.zeros(count, dtype=bool)
    stations, seen = [], []
    for block in blocks:
        slots = [slot for slot in block.slots() if slot.family == family]
        for slot in slots if len(slots) > 1 else ():
            tied[slot.member] = True
        station = block.weights.station
        if station is not None:
            for slot in slots:
                stations.append(station.ravel())
                seen.append(np.broadcast_to(slot.member[:, None], station.shape).ravel())
    if stations:
        pairs = np.unique(np.concatenate(stations) * count + np.concatenate(seen))
        station, member = pairs // count, pairs % count
        several = np.bincount(station)[station] > 1
        tied[member[several]] = True
    return tied


def _lift(damping: FloatArray, diagonal: FloatArray) -> FloatArray:
    """Return what Marquardt's damping adds, at least a trace of it where a column is empty."""
    K = len(diagonal)
    largest = np.maximum(diagonal.reshape(K, -1).max(axis=1, initial=0.0), TINY)
    shape = (K,) + (1,) * (diagonal.ndim - 1)
    least = (SINGULAR * largest).reshape(shape)
    lift: FloatArray = damping.reshape(shape) * np.maximum(diagonal, least)
    return lift


def _before(which: BoolArray) -> IntArray:
    """Return how many of `which` come before each."""
    count: IntArray = np.cumsum(which) - which
    return count


def _sliced(index: IntArray) -> Index:
    """Return a run of indices as a slice: reading and writing along it copies nothing."""
    if len(index) and int(index[-1] - index[0]) == len(index) - 1 and (np.diff(index) > 0).all():
        return slice(int(index[0]), int(index[-1]) + 1)
    return index
