r"""All rows of some blocks as one dense matrix, for tests and for scales of noise.

Rows are multiplied by the roots of their weights. Where rows of a station have columns U in common
(`Weights.common`), their weight matrix is I - U U' (`weighting.Whitening`).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..arrays import BoolArray, FloatArray, IntArray
from ..model.block import Block, Slot, Values, whitened
from ..model.condensed_shots import Mixed
from ..model.families import FAMILIES, POSE
from ..model.range_blocks import PoseVariables, Ranges
from ..model.targets.sphere import SPHERE
from ..model.weighting import Whitening, covariance_roots
from ..quantities import FAR_SIGMAS, NEGLIGIBLE, SINGULAR, TINY

STEPS_OF_HAND = 8
"""Steps of Gauss and Newton to the error of the hand that a station says. Two do, but near the middle
of a ball: with three, 6 of 96 right profiles were rejected, with eight 2."""


@dataclass(frozen=True, slots=True, eq=False)
class Unknowns:
    """Where the unknowns stand.

    Attributes
    ----------
    place : mapping
        For each family, where each member begins among all unknowns.
    free : mapping
        Its unknown tangent coordinates.
    names : list of str
        Of all unknowns: family, member and coordinate, as `beam[0].x`.
    """

    place: Mapping[str, IntArray]
    free: Mapping[str, IntArray]
    names: list[str]


def unknowns_of(counts: Mapping[str, int], unknown: Mapping[str, BoolArray | bool]) -> Unknowns:
    """Return where the unknowns of families stand, given the number of their members."""
    place: dict[str, IntArray] = {}
    free: dict[str, IntArray] = {}
    names: list[str] = []
    for family, mask in unknown.items():
        known = FAMILIES[family]
        free[family] = np.flatnonzero(np.broadcast_to(mask, known.dim))
        place[family] = len(names) + len(free[family]) * np.arange(counts[family])
        names += [
            f"{family}[{i}].{known.coordinates[c]}"
            for i in range(counts[family])
            for c in free[family]
        ]
    return Unknowns(place, free, names)


@dataclass(frozen=True, slots=True, eq=False)
class DenseRows:
    """Rows of all blocks, times the roots of their weights.

    Attributes
    ----------
    derivatives : (R, N)
    residuals : (R,)
    by_pose : (R, 6)
        Derivatives by the pose of each row's station; zero where it has none.
    common : (R, c)
        U; no columns where nothing is common.
    station : (R,)
        Of each row; a number of its own where it has none.
    where : list of slice
        The rows of each block.
    """

    derivatives: FloatArray
    residuals: FloatArray
    by_pose: FloatArray
    common: FloatArray
    station: IntArray
    where: list[slice]

    @property
    def how(self) -> Whitening:
        """How the rows of a station weigh together: I - U U'."""
        common = self.common if self.common.shape[1] else None
        return Whitening(np.ones(len(self.residuals)), 1.0, self.station, common)

    def whitened(self) -> tuple[FloatArray, FloatArray]:
        """Return derivatives and residuals of rows that are independent, of one unit."""
        rows = self.how.apply_rows(np.column_stack((self.derivatives, self.residuals)))
        return rows[:, :-1], rows[:, -1]


def dense_rows(blocks: Sequence[Block], values: Values, of: Unknowns) -> DenseRows:
    """Return the rows of blocks at the values of one problem."""
    parts: list[tuple[FloatArray, ...]] = []
    where: list[slice] = []
    first = 0
    width = max((len(b.weights.common) for b in blocks if b.weights.common is not None), default=0)
    for block in blocks:
        columns = whitened(block.evaluate(values), block.weights)[:, 0]
        G, S = columns.shape[1:]
        J, P, U = np.zeros((G, S, len(of.names))), np.zeros((G, S, 6)), np.zeros((G, S, width))
        for slot in block.slots():
            if slot.family == POSE.name:
                P = np.moveaxis(columns[slot.columns], 0, 2)
            if slot.family not in of.place:
                continue
            free = of.free[slot.family]
            at = of.place[slot.family][slot.member][:, None] + np.arange(len(free))
            own = columns[slot.columns.start + free].transpose(1, 0, 2)
            J[np.arange(G)[:, None], :, at] += own
        if block.weights.common is not None:
            U = np.moveaxis(np.broadcast_to(block.weights.common[:, 0], (width, G, S)), 0, 2)
        station = block.weights.station
        if station is None:
            station = 2**31 + np.arange(first, first + G * S)  # its own, behind all stations
        numbers = (J, columns[-1], P, U, station.astype(float))
        parts.append(tuple(a.reshape(G * S, -1) for a in numbers))
        where.append(slice(first, first + G * S))
        first += G * S
    J, e, P, U, station = (np.concatenate(some) for some in zip(*parts, strict=True))
    number = np.unique(station[:, 0], return_inverse=True)[1].ravel()
    return DenseRows(J, e[:, 0], P, U, number, where)


def with_curved_errors(
    blocks: Sequence[Block], values: Values, covariance: FloatArray
) -> list[Block]:
    r"""Return blocks whose rows on spheres count what errors of the hand poses do to second order.

    A root L of the covariance (M, 6, 6) of a pose makes its error L z with z ~ N(0, I). What the rows
    of a station say of z, targets and mounts as they are, has a mean z0 and the covariance C C'. With
    z = z0 + C y, a range s and its derivatives A by z,

        s(z) = s(z0) + A(z0) C y + y'B y / 2,

    of which rows that are linear at the recorded pose have s(0) + A(0) z. Readings become shorter by
    the difference of the means, tr(B) / 2 of what is curved among it. Rows of a group of mixed ones
    become independent of the rest, (A(z0) - A(0)) C y and what is curved, whose covariance is
    tr(B_i B_j) / 2 for ranges i and j; of single rows it is noise. So a profile through the middle of a
    ball does not tell by how much the hand is off across it.
    """
    seen = {slot.family for block in blocks for slot in block.slots()}
    if SPHERE.name not in seen or not covariance.any():
        return list(blocks)
    root = covariance_roots(covariance)
    near: dict[int, _NearHand] = {}
    others = np.zeros((len(covariance), 6, 7))
    for index, block in enumerate(blocks):
        slot = next((slot for slot in block.slots() if slot.family == POSE.name), None)
        if slot is None:
            continue
        stop = _stops(block, slot)
        if isinstance(block, Mixed | Ranges):
            ranges = block.ranges if isinstance(block, Mixed) else block
            if ranges.target.family == SPHERE.name:
                pose = values[POSE.name][0, slot.member]
                near[index] = _NearHand(block, ranges, values, pose, root[slot.member], stop)
                continue
        columns = whitened(block.evaluate(values), block.weights)[:, 0]
        A = np.einsum("cgs,gcd->gsd", columns[slot.columns], root[slot.member])
        _add_normal(others, stop, A, columns[-1])
    new = list(blocks)
    z, C = np.zeros((len(covariance), 6)), np.zeros_like(root)
    for _ in range(STEPS_OF_HAND):
        sums = others.copy()
        for one in near.values():
            _add_normal(sums, one.stop, *one.linear(z))
        size, axes = np.linalg.eigh(sums[..., :6])
        C = axes / np.sqrt(1.0 + np.maximum(size, 0.0))[:, None]
        z = -(C @ np.swapaxes(C, 1, 2) @ sums[..., 6:])[..., 0]
        z /= np.maximum(np.linalg.norm(z, axis=1, keepdims=True) / FAR_SIGMAS, 1.0)
    for index, one in near.items():
        new[index] = one.counted(z, C)
    return new


def _stops(block: Block, slot: Slot) -> IntArray:
    """Return the number (G,) of the error of the hand that each group of a block has."""
    return slot.member if block.weights.station is None else block.weights.station[:, 0]


def _add_normal(sums: FloatArray, stop: IntArray, A: FloatArray, e: FloatArray) -> None:
    """Add A'A and A'e of groups of rows A (G, T, 6) and e (G, T) to sums (M, 6, 7) of their stops."""
    np.add.at(sums, stop, np.swapaxes(A, 1, 2) @ np.concatenate((A, e[..., None]), axis=2))


class _NearHand:
    """Rows on spheres at errors of the hand: of recorded poses (G, 12) with roots (G, 6, 6)."""

    def __init__(
        self,
        block: Mixed | Ranges,
        ranges: Ranges,
        values: Values,
        pose: FloatArray,
        root: FloatArray,
        stop: IntArray,
    ) -> None:
        self.block, self.values, self.pose, self.root, self.stop = block, values, pose, root, stop
        self.ranges = replace(ranges, robot=PoseVariables(np.arange(len(pose))))
        slots = self.ranges.slots()
        self.columns = next(slot.columns for slot in slots if slot.family == POSE.name)
        first, A = self.at(np.zeros((1, len(pose), 6)))
        self.first, self.A = first[0], A[0]

    def at(self, z: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return residuals (K, G, S) and their derivatives (K, G, S, 6) at errors z (K, G, 6)."""
        step = (self.root @ z[..., None])[..., 0]
        pose = POSE.retract(np.repeat(self.pose[None], len(z), axis=0), step)
        columns = self.ranges.evaluate({**self.values, POSE.name: pose}).columns
        return columns[-1], np.einsum("ckgs,gcd->kgsd", columns[self.columns], self.root)

    def whitened(self, columns: FloatArray) -> FloatArray:
        """Return rows (G, T, c) from columns (G, S, c) of ranges."""
        if isinstance(self.block, Mixed):
            columns = np.swapaxes(self.block.mix, 1, 2) @ columns
        root = self.block.weights.root
        return columns if root is None else columns * root[0, ..., None]

    def linear(self, z: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return derivatives (G, T, 6) at errors z (M, 6), and rows (G, T), as if linear."""
        z = z[self.stop]
        e, A = self.at(z[None])
        rows = self.whitened(np.concatenate((A[0], e[0, ..., None]), axis=2))
        A = rows[..., :6]
        return A, rows[..., 6] - (A @ z[..., None])[..., 0]

    def counted(self, z: FloatArray, C: FloatArray) -> Block:
        """Return the block of `with_curved_errors`, for means (M, 6) and roots (M, 6, 6) of errors."""
        z, C = z[self.stop], C[self.stop]
        steps = np.moveaxis(C, 2, 0)
        ahead, behind = np.split(self.at(np.concatenate((z + steps, z - steps)))[1], 2)
        B = np.einsum("kgsc,gcd->gskd", 0.5 * (ahead - behind), C)
        B = 0.5 * (B + np.swapaxes(B, 2, 3))
        (e,), (A,) = self.at(z[None])
        longer = e - self.first - (self.A @ z[..., None])[..., 0] + 0.5 * np.einsum("gskk->gs", B)
        i, j = np.triu_indices(6, 1)
        curved = np.einsum("gskk->gsk", B) / np.sqrt(2.0), B[..., i, j]
        rest = self.whitened(np.concatenate(((A - self.A) @ C, *curved), axis=2))
        block: Mixed | Ranges
        if isinstance(self.block, Mixed):
            ranges = self.block.ranges
            block = replace(self.block, ranges=replace(ranges, reading=ranges.reading - longer))
        else:
            block = replace(self.block, reading=self.block.reading - longer)
        return _with_own_errors(block, rest)[0]


def with_pose_errors(
    blocks: Sequence[Block],
    values: Values,
    covariance: FloatArray,
    own: FloatArray | None = None,
) -> list[Block]:
    """Return blocks whose rows count errors of the hand poses (M, 6, 6), which a station's rows share.

    With A the derivatives by a pose times a root of its covariance, in standard deviations of the
    readings, the weight matrix of the station's rows is I - A inv(I + A'A) A'. Where several poses are
    one station of the weights, covariances `own` (M, 6, 6) beside that are of each pose by itself: rows
    of a group of mixed ones become independent of them, and of single rows they are noise.
    """
    if not covariance.any():
        return list(blocks)
    root = covariance_roots(covariance)
    own_root = None if own is None or not own.any() else covariance_roots(own)
    found: list[tuple[int, FloatArray, IntArray]] = []
    sums = np.zeros((len(covariance), 6, 6))
    new = list(blocks)
    for index, block in enumerate(blocks):
        slot = next((slot for slot in block.slots() if slot.family == POSE.name), None)
        if slot is None:
            continue
        columns = whitened(block.evaluate(values), block.weights)[slot.columns, 0]
        A = np.einsum("cgs,gcd->gsd", columns, root[slot.member])
        if own_root is not None:
            own_A = np.einsum("cgs,gcd->gsd", columns, own_root[slot.member])
            new[index], white = _with_own_errors(block, own_A)
            A = white @ A
        station = slot.member if block.weights.station is None else block.weights.station[:, 0]
        np.add.at(sums, station, np.swapaxes(A, 1, 2) @ A)
        found.append((index, A, station))
    # A root of inv(I + A'A), which rounding cannot make indefinite.
    squares, axes = np.linalg.eigh(sums)
    inverse = np.swapaxes(axes / np.sqrt(1.0 + np.maximum(squares, 0.0))[:, None], 1, 2)
    for index, A, station in found:
        U = np.einsum("gsd,gcd->cgs", A, inverse[station])[:, None]
        new[index] = replace(
            new[index],
            weights=replace(new[index].weights, common=U),  # type: ignore[type-var]
        )
    return new


def _with_own_errors(block: Block, A: FloatArray) -> tuple[Block, FloatArray]:
    """Return a block whose groups count errors A (G, S, 6), and what its rows are multiplied by."""
    V = A @ np.swapaxes(A, 1, 2)
    if not isinstance(block, Mixed):
        V = np.eye(V.shape[1]) * V
    variances, axes = np.linalg.eigh(V)
    white = (axes / np.sqrt(1.0 + np.maximum(variances, 0.0))[:, None]) @ np.swapaxes(axes, 1, 2)
    if isinstance(block, Mixed):
        return replace(block, mix=block.mix @ white), white
    root = np.einsum("gss->gs", white)[None]
    root = root if block.weights.root is None else block.weights.root * root
    return replace(block, weights=replace(block.weights, root=root)), white  # type: ignore[type-var]


def spanned(J: FloatArray) -> tuple[FloatArray, FloatArray, float]:
    """Return what derivatives J (R, N) span, whatever the units of their columns.

    Returns
    -------
    known : (R, k)
        Orthonormal columns with their span; what depends on others but for rounding is none.
    inverse : (N, R)
        The pseudoinverse of J.
    log_det : float
        Of J'J along what is spanned.
    """
    scale = np.sqrt((J**2).sum(axis=0))
    scale = np.where(scale > 0.0, scale, 1.0)
    U, size, V = np.linalg.svd(J / scale, full_matrices=False)
    some = size > NEGLIGIBLE * size.max(initial=0.0)
    known, size = U[:, some], size[some]
    log_det = 2.0 * float(np.log(size).sum() + np.log(scale).sum())
    return known, (V[some].T / size / scale[:, None]) @ known.T, log_det


def filled(rows: FloatArray, group: IntArray) -> FloatArray:
    """Return the rows (R, c) of each group (R,), filled up with zeros to the most of any (G, most, c).

    Rows whose group is -1 do not count.
    """
    count = np.bincount(group[group >= 0])
    order = np.flatnonzero(group >= 0)[np.argsort(group[group >= 0], kind="stable")]
    place = np.arange(len(order)) - np.repeat(np.cumsum(count) - count, count)
    whole = np.zeros((len(count), int(count.max(initial=0)), rows.shape[1]))
    whole[group[order], place] = rows[order]
    return whole


def tests_of(rows: DenseRows, group: IntArray) -> tuple[FloatArray, IntArray]:
    """Return how far each group of rows is from what all others say, chi2 with its degrees of freedom.

    With M = W - W A inv(A' W A) A' W, the sum of squares that the others save where the rows r are left
    out is (M e)_r' inv(M_rr) (M e)_r; for one row it is the square of Baarda's w.

    Parameters
    ----------
    rows : DenseRows
    group : (R,)
        The number of each row's group, -1 for rows that are not tested. Rows of a group are of one
        station where there are common columns.
    """
    A, scale = rows.derivatives, np.sqrt((rows.derivatives**2).sum(axis=0))
    A = A / np.where(scale > 0.0, scale, 1.0)
    B = rows.how.weighed(np.column_stack((A, rows.residuals)))
    information = A.T @ B[:, :-1]
    values, axes = np.linalg.eigh(information)
    some = values > SINGULAR * max(float(values.max()), TINY)
    root = axes[:, some] / np.sqrt(values[some])
    C = B[:, :-1] @ root
    left = B[:, -1] - C @ (root.T @ (A.T @ B[:, -1]))
    C, U, left = (filled(x, group) for x in (C, rows.common, left[:, None]))
    M = np.eye(left.shape[1]) - U @ np.swapaxes(U, 1, 2) - C @ np.swapaxes(C, 1, 2)
    values, axes = np.linalg.eigh(M)
    # Rows that fill up have nothing left; rows that alone decide something have no more than rounding.
    free = values > SINGULAR**0.5
    along = np.einsum("gij,gi->gj", axes, left[..., 0])
    chi2 = np.where(free, along**2 / np.where(free, values, 1.0), 0.0).sum(axis=1)
    count = np.bincount(group[group >= 0])
    return chi2, free.sum(axis=1) - (left.shape[1] - count)
