"""Score tests of systematic errors: all members of all families, and how large each could be unnoticed.

The formulas stand in `systematic`. The scales of a prior on range errors are learned: an error that
shows by improbable range errors, and not by residuals, widens that prior until they are probable. Such
a strained member is judged as if range errors had no prior.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from .. import model
from ..arrays import BoolArray, FloatArray, IntArray
from ..model.distributions import gaussian_cdf, gaussian_sf, needed, two_sided
from ..model.effects import EFFECTS
from ..model.families import BEAM, DIRECTION, LOCATION, MOUNT_DIM
from ..quantities import NEGLIGIBLE
from .projection import SQUARE_ROUNDING, LinearRows, Projection
from .score_members import score_members
from .significance import CONFIDENCE, FAMILY_LEVEL, holm

UNKNOWN_SIZE = 0.02
"""An error is confounded, too, where the standard deviation of its size is above this part of its
natural unit, the typical range or 1: it would be found from five times that on, where derivatives at
zero do not describe it any more."""
STRAINED_SHARE = 0.95
"""An error strains the prior where removing the prior lowers the square of its adjusted column below
this part: to 0.04 to 0.1 for a cubic range error, to 0.7 or more for all others. A cubic error that is
there widens the prior: with a half here it was judged beside the widened prior, and found in 96 of 100
recordings instead of the 80 that its stated size promises."""


@dataclass(frozen=True, slots=True)
class AdjustedMembers:
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
    growth : float
        Factor on the standard deviations of errors that vary slowly, where the noise does, too.
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
        growth: float = 1.0,
    ) -> None:
        self.rows, self.dof, self.growth = rows, dof, growth
        self.kinds = score_members(rows)
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
        scale = rows.how.sigma if dof is None else float(np.sqrt(bound.square / dof))
        scale *= growth
        self.determined = self._determined(scale)
        self.critical, self.delta = needed(FAMILY_LEVEL / max(int(self.determined.sum()), 1), dof)
        self.strained = loose.left < STRAINED_SHARE * bound.left
        self.left = np.where(self.strained, loose.left, bound.left)
        self.moved = np.where(self.strained[:, None], loose.moved, bound.moved)
        self._test(scale)
        plausible = plausible or {}
        most = self._by_code(lambda code: plausible.get(code, np.inf))
        self.unnoticed = np.minimum(self.detectable, most)

    def _by_code(self, value: Callable[[str], float]) -> FloatArray:
        """Return what every member (m,) has by its code."""
        return np.concatenate([kind.by_code(value) for kind in self.kinds])

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
        residual, priors = self.rows.residual[:, None], projection.prior_residuals(self.rows.at)
        _, heavy, squares, _ = projection.perpendicular(residual, priors)
        score = self.products(heavy)[:, 0]
        return AdjustedMembers(
            projection, np.concatenate(left), np.concatenate(moved), score, float(squares[0])
        )

    def _determined(self, scale: float) -> BoolArray:
        """Tell which members leave enough, even without the prior, to be known at all."""
        left, whole = self._loose.left, np.concatenate([kind.squares for kind in self.kinds])
        share = left / np.where(whole > 0.0, whole, np.inf)
        unit = {"m": self.rows.readings.typical_range(), "1": 1.0}
        most = self._by_code(lambda code: UNKNOWN_SIZE * unit[EFFECTS[code].unit])
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
            each = self.growth * np.sqrt(
                np.maximum(square - explained, SQUARE_ROUNDING * square) / (dof - 1)
            )
        self.size, self.sigma = score / left, each / np.sqrt(left)
        self.z = np.where(
            self.determined, self.size / np.maximum(self.sigma, SQUARE_ROUNDING * scale), 0.0
        )
        tested = np.flatnonzero(self.determined)
        self.p = np.ones(len(left))
        self.p[tested] = holm(two_sided(self.z[tested], self.dof))
        if (self.p < FAMILY_LEVEL).any():
            scale = float(each[tested].min())
        smallest = self.delta * scale / np.sqrt(left)
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
                spots[number, :, power] += sizes[number] / largest * v
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
        products = self.products(adjusted.projection.perpendicular(columns)[1]).T
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
