"""Score tests of systematic errors: all members of all families, and how large each could be unnoticed.

The formulas stand in `systematic`. The scales of a prior on range errors are learned: an error that
shows by improbable range errors, and not by residuals, widens that prior until they are probable. Such
a strained member is judged as if range errors had no prior.

Errors of all readings are few columns and their sums (`CommonErrors`). Errors of single planes come in
families of many members, of which no column is formed: each counts in ranges of the rows in the order
by plane, beam and time (`PlaneErrors`).
"""

from collections.abc import Callable, Mapping, Sequence
from copy import copy
from typing import NamedTuple

import numpy as np
from scipy.linalg import block_diag

from .. import model
from ..arrays import BoolArray, FloatArray, IntArray
from ..model.distributions import (
    CONFIDENCE,
    FAMILY_LEVEL,
    gaussian_cdf,
    gaussian_sf,
    holm,
    needed,
    two_sided,
)
from ..model.effects import EFFECTS
from ..model.effects.effect import Everywhere, OnPlanes
from ..model.families import BEAM, DIRECTION, LOCATION, MOUNT_DIM
from ..quantities import NEGLIGIBLE, TINY
from .projection import SQUARE_ROUNDING, LinearRows, Projection
from .shared_errors import NOTHING_SHARED, SharedErrors

STRAINED_SHARE = 0.95
"""An error strains the prior where removing the prior lowers the square of its adjusted column below
this part: to 0.04 to 0.1 for a cubic range error, to 0.7 or more for all others. A cubic error that is
there widens the prior: with a half here it was judged beside the widened prior, and found in 96 of 100
recordings instead of the 80 that its stated size promises."""


class AdjustedMembers(NamedTuple):
    """All members and the residuals without what the unknowns explain, with or without the prior.

    Attributes
    ----------
    projection : Projection
    left : (m,)
        Squares of the whitened columns.
    moved : (m, 7 B)
        By how much the beams' part of the unknowns fits the column: it moves by the negative.
    score : (m,)
        Products of the columns with the residuals.
    square : float
        Of the residuals.
    """

    projection: Projection
    left: FloatArray
    moved: FloatArray
    score: FloatArray
    square: float


class ScoreTests:
    """All members of all families, and their statistics.

    Attributes
    ----------
    rows : LinearRows
    projection : Projection
        Beside the prior.
    dof : int or None
        Behind the scale of the noise; None where it is given.
    growth : (m,)
        Factor on the standard deviation of each, where noise goes together in time, or at stops.
    codes : (m,) of str
    plane, beam, position : (m,)
        What each member concerns: a plane, a beam, and the position in the recording of its first
        station; -1 for all.
    determined, strained : (m,) of bool
    size, sigma, z, p : (m,)
        Estimated size, its standard deviation, their ratio, and the probability after Holm.
    detectable : (m,)
        Infinite where not determined.
    unnoticed : (m,)
        The smaller of what is detectable and what is plausible.
    critical, delta : float
        The |z| from which on an error is found, and the mean of z that exceeds it with `POWER`.
    """

    def __init__(
        self,
        rows: LinearRows,
        dof: int | None,
        plausible: Mapping[str, float] | None = None,
        shared: SharedErrors = NOTHING_SHARED,
    ) -> None:
        self.rows, self.dof = rows, dof
        self.kinds = self.common, *_ = score_members(rows)
        self.codes = np.concatenate([kind.codes for kind in self.kinds])
        self.plane = np.concatenate([kind.plane for kind in self.kinds])
        self.beam = np.concatenate([kind.beam for kind in self.kinds])
        self.position = np.concatenate([kind.position for kind in self.kinds])
        self.projection = Projection(rows, rows.prior)
        self._bound = self._loose = self._adjusted(self.projection)
        if self._bound.projection.pull.any():
            free = np.where(rows.prior > 0.0, np.inf, 0.0)
            self._loose = self._adjusted(Projection(rows, free))
        bound, loose = self._bound, self._loose
        self.strained = loose.left < STRAINED_SHARE * bound.left
        self.left = np.where(self.strained, loose.left, bound.left)
        self.moved = np.where(self.strained[:, None], loose.moved, bound.moved)
        self.plausible = self._by_code(lambda code: (plausible or {}).get(code, np.inf))
        self._judge(1.0, shared)

    def judged_by(self, shared: SharedErrors, growth: float = 1.0) -> "ScoreTests":
        """Return the same tests where stations share errors, and with a factor on all sigmas."""
        tests = copy(self)
        tests._judge(growth, shared)
        return tests

    def _judge(self, growth: float, shared: SharedErrors) -> None:
        """Set what follows from the noise."""
        rows, bound = self.rows, self._bound
        self.growth = np.full(len(self.codes), max(growth, shared.plane_growth))
        if shared.stop.size:
            of_common = self.common.growth_by(shared, self.projection)
            self.growth[: len(of_common)] = np.maximum(growth, of_common)
        if shared.by_pose is not None and shared.by_pose.moved.any():
            more = np.zeros(len(self.codes))
            for columns in shared.by_pose.columns:
                heavy = self.projection.weighed_rest(columns)
                more += (self.products(heavy) ** 2).sum(axis=1)
            left = np.maximum(bound.left, TINY) * rows.how.sigma**2
            self.growth = np.sqrt(self.growth**2 + more / left)
        scale = rows.how.sigma if self.dof is None else float(np.sqrt(bound.square / self.dof))
        self.determined = self._determined(self.growth * scale)
        tested = max(int(self.determined.sum()), 1)
        self.critical, self.delta = needed(FAMILY_LEVEL / tested, self.dof)
        self._test(scale)
        self.unnoticed = np.minimum(self.detectable, self.plausible)

    def _by_code(self, value: Callable[[str], float]) -> FloatArray:
        """Return what every member (m,) has by its code."""
        codes, which = np.unique(self.codes, return_inverse=True)
        return np.array([value(code) for code in codes.tolist()], dtype=float)[which]

    def products(self, y: FloatArray) -> FloatArray:
        """Return the products (m, q) of all members with columns y (N, q)."""
        return np.concatenate([kind.dot(y) for kind in self.kinds])

    def column(self, member: int) -> FloatArray:
        """Return the column (N,) of one member."""
        for kind in self.kinds:
            if member < len(kind.plane):
                break
            member -= len(kind.plane)
        return kind.column_of(member)

    def _adjusted(self, projection: Projection) -> AdjustedMembers:
        """Take out of all members, and of the residuals, what the unknowns explain."""
        moved, left = zip(*(kind.adjusted_by(projection) for kind in self.kinds), strict=True)
        heavy, square = projection.of_residuals(self.rows)
        score = self.products(heavy[:, None])[:, 0]
        return AdjustedMembers(
            projection, np.concatenate(left), np.concatenate(moved), score, square
        )

    def _determined(self, scale: FloatArray) -> BoolArray:
        """Tell which members leave enough, even without the prior, to be known at all.

        Given the scale of noise (m,) behind each.
        """
        left, whole = self._loose.left, np.concatenate([kind.squares for kind in self.kinds])
        share = left / np.where(whole > 0.0, whole, np.inf)
        unit = {"m": self.rows.readings.typical_range(), "1": 1.0}
        # An error is confounded, too, where the standard deviation of its size is above this part
        # of its natural unit, the typical range or 1: it would be found from five times that on,
        # where derivatives at zero do not describe it any more. They do describe how far a tool is
        # displaced, and a long way makes the noise that is learned, and that deviation, large.
        most = self._by_code(
            lambda code: np.inf if EFFECTS[code].of_mean else 0.02 * unit[EFFECTS[code].unit]
        )
        # An error is confounded where the unknowns explain all of its column but a negligible part.
        # Rounding makes up to 1e-11 of a member; errors that a recording shows have 3e-5 or more.
        determined = (share > NEGLIGIBLE) & (left > (scale / most) ** 2)
        if (self.rows.prior[:, 0] > 0.0).all():
            determined &= self._by_code(lambda code: not EFFECTS[code].is_k1) > 0.0
        return np.asarray(determined)

    def _test(self, scale: float) -> None:
        """Test all members, given the typical scale of noise."""
        left = np.where(self.determined, self.left, 1.0)
        score = np.where(self.strained, self._loose.score, self._bound.score)
        square = np.where(self.strained, self._loose.square, self._bound.square)
        each = np.full(len(left), scale)
        if self.dof is not None:
            explained = np.where(self.determined, score**2 / left, 0.0)
            priors = int((self._bound.projection.pull > 0.0).sum())
            dof = np.where(self.strained, max(self.dof - priors, 2), self.dof)
            each = np.sqrt(np.maximum(square - explained, SQUARE_ROUNDING * square) / (dof - 1))
        self.size, self.sigma = score / left, self.growth * each / np.sqrt(left)
        self.z = np.where(
            self.determined, self.size / np.maximum(self.sigma, SQUARE_ROUNDING * scale), 0.0
        )
        tested = np.flatnonzero(self.determined)
        self.p = np.ones(len(left))
        self.p[tested] = holm(two_sided(self.z[tested], self.dof))
        if (self.p < FAMILY_LEVEL).any():
            scale = float(each[tested].min())
        smallest = self.delta * scale * self.growth / np.sqrt(left)
        self.detectable = np.where(self.determined, smallest, np.inf)

    def moves(
        self, members: IntArray, sizes: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return by how much r, v and laser spots of every beam are wrong by members of some sizes.

        The spot x = r + g(d) v is wrong by dr + g(d) dv + (d dk1 + d^2 dk2) v, and by what the error
        itself makes g wrong by. NaN where a size is infinite.

        Returns
        -------
        location, turn : (m, B, 3)
        spot : (m, B, 4, 3)
            By powers 0 to 3 of the reading [m].
        """
        at, sizes = self.rows.at, np.where(np.isfinite(sizes), sizes, np.nan)
        k, v = at.range_errors[:, :, None], at.directions
        x = -self.moved[members].reshape(len(members), len(v), BEAM.dim) * sizes[:, None, None]
        turn = np.einsum("bij,mbj->mbi", model.tangent_basis(v), x[:, :, DIRECTION])
        parts = (
            x[:, :, LOCATION],
            (1.0 + k[:, 0]) * turn + x[:, :, MOUNT_DIM, None] * v,
            k[:, 1] * turn + x[:, :, MOUNT_DIM + 1, None] * v,
            np.zeros_like(turn),
        )
        spots = np.stack(parts, axis=2)
        for number, member in enumerate(members.tolist()):
            power = EFFECTS[str(self.codes[member])].power
            if power is not None:
                largest = self.rows.readings.level.max() ** power
                concerned = slice(None) if self.beam[member] < 0 else self.beam[member]
                spots[number, concerned, power] += sizes[number] / largest * v[concerned]
        return x[:, :, LOCATION], turn, spots

    def representatives(self) -> IntArray:
        """Return the clearest determined member of every family, in the order of their clearness."""
        tested = np.flatnonzero(self.determined)
        tested = tested[np.argsort(-np.abs(self.z[tested]), kind="stable")]
        _, first = np.unique(self.codes[tested], return_index=True)
        return np.asarray(tested[np.sort(first)])

    def found_columns(self) -> FloatArray:
        """Return the columns (N, q) of the errors that are found and that no clearer error explains."""
        first = self.representatives()
        first = first[self.p[first] < FAMILY_LEVEL]
        if not first.size:
            return np.empty((len(self.rows.readings), 0))
        explained = self.explained(first, self.correlations(first))
        alone = [member for member, code in zip(first.tolist(), explained, strict=True) if not code]
        return np.stack([self.column(member) for member in alone], axis=1)

    def correlations(self, members: IntArray) -> FloatArray:
        """Return how members (k,) correlate with all (k, m), as far as the unknowns leave them.

        Two of which one is strained are compared without the prior, as that one is judged.
        """
        columns = np.stack([self.column(member) for member in members.tolist()], axis=1)
        rho = self._correlated(self._bound, members, columns)
        if self.strained[self.determined].any():
            loose = self._correlated(self._loose, members, columns)
            either = self.strained[members][:, None] | self.strained
            rho = np.where(either, loose, rho)
        return np.clip(rho, -1.0, 1.0)

    def _correlated(
        self, adjusted: AdjustedMembers, members: IntArray, columns: FloatArray
    ) -> FloatArray:
        products = self.products(adjusted.projection.perpendicular(columns)[0]).T
        left = np.where(self.determined, adjusted.left, np.inf)
        return np.asarray(products / np.sqrt(left[members, None] * left))

    def explained(self, members: IntArray, rho: FloatArray) -> list[str]:
        """Return for every representative the code of a clearer one that explains it, or nothing."""
        kept: list[int] = []
        words = []
        for number, member in enumerate(members.tolist()):
            G = rho[kept][:, members[kept]]
            r = rho[kept, member]
            solved = np.linalg.lstsq(G, np.stack((r, self.z[members[kept]]), axis=1), rcond=None)[0]
            freedom = max(1.0 - float(r @ solved[:, 0]), SQUARE_ROUNDING)
            alone = (self.z[member] - float(r @ solved[:, 1])) / np.sqrt(freedom)
            if kept and abs(alone) < self.critical:
                words.append(str(self.codes[members[kept[int(np.argmax(np.abs(r)))]]]))
            else:
                words.append("")
                kept.append(number)
        return words


def alike(rho: FloatArray, delta: float) -> BoolArray:
    """Tell which errors cannot be distinguished from a true one of which z has the mean `delta`.

    The statistic of another is z' ~ N(rho delta, 1) with correlation rho to z. The right one fits
    better where z^2 > z'^2. As z - z' and z + z' are independent with means (1 -+ rho) delta and
    variances 2 (1 -+ rho), that has the probability F(a) F(b) + F(-a) F(-b), a, b = delta sqrt((1
    -+ rho) / 2), F the Gaussian distribution function.
    """
    a, b = delta * np.sqrt(0.5 * (1.0 - rho)), delta * np.sqrt(0.5 * (1.0 + rho))
    right = gaussian_cdf(a) * gaussian_cdf(b) + gaussian_sf(a) * gaussian_sf(b)
    return np.asarray(right < CONFIDENCE)


class CommonErrors:
    """Errors that concern all readings, with the interface of `PlaneErrors`.

    Attributes
    ----------
    columns : (N, c)
        Derivatives of the residuals.
    mix : (c, m)
        Of which columns each member is the sum.
    beam, position : (m,)
        The one beam that each member concerns, and the position in the recording from which on it
        counts; -1 for all, and for the whole of it.
    """

    def __init__(self, rows: LinearRows, kinds: Sequence[tuple[str, Everywhere]]) -> None:
        # There may be none: all of them can be unknowns.
        none = Everywhere(np.empty((len(rows.readings), 0)))
        every = [none, *(kind for _, kind in kinds)]
        self.columns = np.hstack([kind.columns for kind in every])
        self.mix = np.asarray(block_diag(*(kind.mix for kind in every)))
        self.position = np.concatenate([kind.since for kind in every])
        codes = [code for code, kind in kinds for _ in kind.since]
        self.codes = np.array(codes, dtype=str)
        self.plane = np.full(len(self.codes), -1)
        self.beam = np.concatenate([kind.beam for kind in every])
        self.squares = self._squares(rows.how.weighed(self.columns))

    def dot(self, y: FloatArray) -> FloatArray:
        """Return the products (m, q) of all members with columns y (N, q)."""
        return np.asarray(self.mix.T @ (self.columns.T @ y))

    def column_of(self, member: int) -> FloatArray:
        """Return the column (N,) of one member."""
        return np.asarray(self.columns @ self.mix[:, member])

    def adjusted_by(self, projection: Projection) -> tuple[FloatArray, FloatArray]:
        """Return how beams follow the members (m, 7 B), and the adjusted squares (m,)."""
        heavy, moved = projection.perpendicular(self.columns)
        return (moved @ self.mix).T, self._squares(heavy)

    def growth_by(self, shared: SharedErrors, projection: Projection) -> FloatArray:
        """Return by how much standard deviations of members (m,) are larger by shared errors."""
        heavy = projection.perpendicular(self.columns)[0]
        more = np.einsum("ci,cd,di->i", self.mix, shared.variances(heavy), self.mix)
        left = np.maximum(self._squares(heavy), TINY) * projection.how.sigma**2
        return np.asarray(np.sqrt(np.maximum(1.0 + more / left, 1.0)))

    def _squares(self, heavy: FloatArray) -> FloatArray:
        """Return the squares (m,) of the members, given their weighed columns (N, c)."""
        gram = self.columns.T @ heavy
        squares: FloatArray = np.einsum("ci,cd,di->i", self.mix, gram, self.mix)
        return np.maximum(squares, 0.0)


class PlaneErrors:
    """Errors of one kind that are local to a plane.

    Attributes
    ----------
    codes : (m,) of str
    column : (N,)
        Derivative of the residuals, as if the error were everywhere.
    plane, beam, position : (m,)
        Of every member: its plane, the one beam it concerns (-1 for all), and the position in the
        recording of the first station it concerns. It counts from there on.
    products : (m, B, 10)
        Sums over members times sigma^2 inv(C) with the rows of J, beam by beam.
    squares : (m,)
        Of the whitened columns.
    """

    def __init__(self, rows: LinearRows, code: str, kind: OnPlanes) -> None:
        self.rows, self.kind = rows, kind
        self.plane, self.beam, self.position = kind.plane, kind.beam, kind.since
        plane, position = self.plane, self.position
        self.codes, self.column = np.full(len(plane), code), kind.column
        # A member counts in the rows [first, last) of every beam, in the order by plane, beam and time.
        readings = rows.readings
        self.order = np.lexsort((rows.position, readings.beam, readings.plane))
        times = int(rows.position.max()) + 1
        block = readings.plane * readings.beams + readings.beam
        key = (block * times + rows.position)[self.order]
        blocks = plane[:, None] * rows.readings.beams + np.arange(rows.readings.beams)
        self.first = np.searchsorted(key, blocks * times + position[:, None])
        self.last = np.searchsorted(key, (blocks + 1) * times)
        self.products = np.zeros((*self.first.shape, rows.J.shape[1]))
        self.squares = np.zeros(len(plane))
        self._sum(rows)

    def dot(self, y: FloatArray) -> FloatArray:
        """Return the products (m, q) of all members with columns y (N, q)."""
        values = (self.column[:, None] * y)[self.order]
        if (self.beam < 0).all():
            return np.asarray(_range_sums(values, self.first, self.last).sum(axis=1))
        of_beam = (np.arange(len(self.beam)), self.beam)
        return _range_sums(values, self.first[of_beam], self.last[of_beam])

    def column_of(self, member: int) -> FloatArray:
        """Return the column (N,) of one member."""
        return self.kind.column_of(member, self.rows)

    def adjusted_by(self, projection: Projection) -> tuple[FloatArray, FloatArray]:
        """Return how beams follow the members (m, 7 B), and the adjusted squares (m,)."""
        products, inverse = self.products, projection.plane_inverse[self.plane]
        planes = products[:, :, BEAM.dim :].sum(axis=1)
        beams = products[:, :, : BEAM.dim].reshape(len(products), projection.pull.size)
        beams = beams - np.einsum("mi,mij->mj", planes, projection.response[self.plane])
        moved = beams @ projection.beam_inverse
        left = self.squares - np.einsum("mi,mij,mj->m", planes, inverse, planes)
        left -= (beams * moved).sum(axis=1)
        freed = self.dot(projection.freed_heavy)
        following = freed @ projection.freed_inverse
        left -= (following * freed).sum(axis=1)
        return moved - following @ projection.freed_moved[: projection.pull.size].T, left

    def _sum(self, rows: LinearRows) -> None:
        """Fill in the products and the squares."""
        if not rows.how.is_coupled and (self.beam >= 0).all():  # only the own beam has any
            of_beam = np.arange(len(self.beam)), self.beam
            values = self._weighed(rows, self.column)
            sums = _range_sums(values, self.first[of_beam], self.last[of_beam])
            self.products[of_beam], self.squares[:] = sums[:, :-1], sums[:, -1]
            return
        for beam in np.unique(self.beam).tolist():
            members = np.flatnonzero(self.beam == beam)
            mine = (rows.readings.beam == beam) | (beam < 0)
            values = self._weighed(rows, np.where(mine, self.column, 0.0))
            sums = _range_sums(values, self.first[members], self.last[members])
            self.products[members] = sums[:, :, :-1]
            self.squares[members] = sums[:, :, -1].sum(axis=1)

    def _weighed(self, rows: LinearRows, column: FloatArray) -> FloatArray:
        """Return a column times sigma^2 inv(C), with J and with itself, in the order (N, 11)."""
        heavy = rows.how.weighed(column[:, None])[:, 0]
        return np.column_stack((rows.J * heavy[:, None], column * heavy))[self.order]


def score_members(rows: LinearRows) -> tuple[CommonErrors, *tuple[PlaneErrors, ...]]:
    """Return all effects that are no unknowns: one of all readings each, or a family."""
    everywhere: list[tuple[str, Everywhere]] = []
    families: list[PlaneErrors] = []
    for code, effect in EFFECTS.items():
        members = None if code in rows.freed.codes else effect.at(rows)
        if isinstance(members, Everywhere):
            everywhere.append((code, members))
        elif members is not None:
            families.append(PlaneErrors(rows, code, members))
    # Those with more members than columns last.
    everywhere.sort(key=lambda one: one[1].mix.shape[1] > len(one[1].mix))
    return CommonErrors(rows, everywhere), *families


def _range_sums(values: FloatArray, first: IntArray, last: IntArray) -> FloatArray:
    """Return the sums of values (N, D) over rows [first, last), both of any shape."""
    padded = np.concatenate((values, np.zeros((1, values.shape[1]))))
    bounds = np.stack((first.ravel(), last.ravel()), axis=1).ravel()
    if not bounds.size:
        return np.zeros((*first.shape, values.shape[1]))
    sums = np.add.reduceat(padded, bounds, axis=0)[::2].reshape(*first.shape, -1)
    sums[first >= last] = 0.0
    return sums
