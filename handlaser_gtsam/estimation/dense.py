r"""All rows of some blocks as one dense matrix, for tests and for scales of noise.

Rows are multiplied by the roots of their weights. Where rows of a station have columns U in common
(`Weights.common`), their weight matrix is I - U U' (`weighting.Whitening`).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..arrays import BoolArray, FloatArray, IntArray
from ..model.block import Block, Values, whitened
from ..model.condensed_shots import Mixed
from ..model.families import FAMILIES, POSE
from ..model.weighting import Whitening, covariance_roots
from ..quantities import NEGLIGIBLE, SINGULAR, TINY


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
