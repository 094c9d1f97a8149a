r"""Systematic errors: tested for, and bounded where they cannot be seen.

With e the whitened residuals, J the whitened Jacobian of all unknowns (pseudo-observations of a
prior on k included), A the whitened column of an alternative (`alternatives`) and A_perp = A - J
inv(J'J) J'A, a size a of that error makes e = A a + J x + noise, and

    z = A_perp'e / (sigma |A_perp|) ~ N(0, 1) if a = 0,    a^ = A_perp'e / A_perp'A_perp,

which is Rao's score test. The unknowns of a solution that ignores the error move by -inv(J'J) J'A
a. The size that is found with 80 % power is sqrt(lambda0 / A_perp'A_perp) sigma, and what it does
to r and v is the external reliability (Baarda, A testing procedure for use in geodetic networks,
1968). Where the common factor of the noise was estimated, z has the scale of what A_perp leaves,
and a t distribution.

All members of all families are tested together with Holm's correction, which needs no independence.
Planes with more than `alternatives.MOST_SPLITS` splits are tested at so many of them.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq
from scipy.stats import nct, norm
from scipy.stats import t as student

from .. import model
from ..arrays import BoolArray, FloatArray, IntArray
from ..diagnosis.words import Names
from ..parameters import Parameters
from ..recording import Readings
from ..weighting import Whitening
from .alternatives import (
    BY_NATURE,
    WHOLE,
    WIDTH,
    WORDING,
    Projection,
    Rows,
    families,
    linear_rows,
    size_in_words,
    weighed,
    whole_columns,
)

LEVEL = 0.01
"""At most this part of recordings without any systematic error shows one."""
POWER = 0.8
"""Probability with which an error of the detectable size is found."""
RIGHT = 0.95
"""Two errors are alike where the right one fits better with a smaller probability."""
LEAST_SHARE = 1e-6
"""A column of which less is left is confounded. Rounding leaves up to 1e-11 of a member of a family;
of errors that a recording shows at all, 3e-5 or more is left."""
MOST_SIGMA = 0.1
"""So is one whose size is known worse than to this part of its natural unit, the typical range or 1:
what noise does to the derivatives themselves would then decide."""
TINY = 1e-14
"""Rounding of what is left where everything is explained."""
GAUSSIAN_DOF = 1e5
"""With so many degrees of freedom an estimated scale is as good as given."""


@dataclass(frozen=True, slots=True, eq=False)
class SystematicError:
    """One kind of systematic error: what the readings say of it, and what it could do unnoticed.

    Attributes
    ----------
    code : str
    subject : str
        The member of the family with the smallest p-value; empty where it concerns everything.
    unit : str
        Of sizes: "m", or "1" for relative ones.
    size, sigma : float
        Estimated size of that member alone, and its standard deviation; NaN where confounded.
    p_value : float
        Of that member, corrected for all members of all families (Holm).
    found : bool
        Whether it is below `LEVEL`.
    explained_by : str
        Code of a clearer error that explains this one too; empty where there is none.
    detectable : float
        The size at which the least detectable member is found with probability `POWER` at the level
        at which it is tested; infinite where confounded.
    location_shift, direction_shift : (B, 3)
        What may go unnoticed: how wrong r [m] and v [rad] of every beam would be by the member that
        moves that beam most, at the size at which that member is detectable. NaN where confounded.
    location_error, direction_error : (B, 3)
        How wrong r [m] and v [rad] are if the error has the size estimated. NaN where confounded.
    alike : tuple of str
        Codes of other errors that this recording cannot tell from it.
    confounded : bool
        Whether the unknowns of the calibration explain it, so that no residual shows it.
    message, remedy : str
    """

    code: str
    subject: str
    unit: str
    size: float
    sigma: float
    p_value: float
    found: bool
    explained_by: str
    detectable: float
    location_shift: FloatArray
    direction_shift: FloatArray
    location_error: FloatArray
    direction_error: FloatArray
    alike: tuple[str, ...]
    confounded: bool
    message: str
    remedy: str

    @property
    def warning(self) -> str:
        """The sentence with the remedy, where it is found and nothing clearer explains it."""
        if not self.found or self.explained_by:
            return ""
        return f"{self.message}. To remove it: {self.remedy}"


@dataclass(frozen=True, slots=True, eq=False)
class Reliability:
    """What could go unnoticed of every member of a family.

    Attributes
    ----------
    plane, beam, position : (m,)
        What each member concerns: a plane, a beam, and the position in the recording of its first
        station; -1 for all.
    determined : (m,) of bool
    size, sigma : (m,)
        Estimated sizes and their standard deviations; meaningless where not determined.
    p_value : (m,)
        Corrected for all members of all families.
    detectable : (m,)
        Infinite where not determined.
    location_shift, direction_shift : (m, B, 3)
        How wrong r [m] and v [rad] of every beam would be at the detectable size; NaN where not
        determined.
    """

    plane: IntArray
    beam: IntArray
    position: IntArray
    determined: BoolArray
    size: FloatArray
    sigma: FloatArray
    p_value: FloatArray
    detectable: FloatArray
    location_shift: FloatArray
    direction_shift: FloatArray


def systematic_errors(
    at: Parameters,
    readings: Readings,
    how: Whitening,
    prior: FloatArray,
    position: IntArray,
    names: Names,
    *,
    known: bool,
    dof: int,
    stations: Sequence[str] | None = None,
) -> tuple[SystematicError, ...]:
    """Test the residuals at a solution for systematic errors; the clearest come first.

    Parameters
    ----------
    at : Parameters
        The solution.
    readings : Readings
        Those used, sorted, every plane in a frame amid its own stations.
    how : Whitening
        Of these rows, beam by beam in the order of the beams.
    prior : (B, 2)
        Standard deviations of the zero-mean prior on (k1, k2): infinite where a term is free, zero
        where it is not in the model.
    position : (N,)
        Order in time of each reading's station in the recording.
    names : Names
    known : bool
        Whether the size of the noise was given; else a common factor was estimated.
    dof : int
        Degrees of freedom of the residuals.
    stations : sequence of str, optional
        Names of the stations by position; their numbers from 1 where not given.

    Returns
    -------
    tuple of SystematicError
        Empty where there is no redundancy. Errors that no recording can show come last.

    Raises
    ------
    GrazingBeamError
        A beam is parallel to its plane.
    """
    if dof < (1 if known else 2):
        return ()
    found = _Analysis(at, readings, how, prior, position, None if known else dof)
    label = [str(j + 1) for j in range(int(position.max()) + 1)] if stations is None else stations
    by_nature = [
        _confounded(code, message, remedy, readings.beams)
        for code, (message, remedy) in BY_NATURE.items()
    ]
    return (*_reports(found, names, label), *by_nature)


def detectable_of(
    code: str,
    at: Parameters,
    readings: Readings,
    how: Whitening,
    prior: FloatArray,
    position: IntArray,
    *,
    known: bool,
    dof: int,
) -> Reliability:
    """Return what could go unnoticed of every member of the family `code`.

    The arguments are those of `systematic_errors`. The displacement of plane p from the station at
    position j on is the member with `plane == p` and `position == j`.
    """
    found = _Analysis(at, readings, how, prior, position, None if known else dof)
    members = np.flatnonzero(found.codes == code)
    return Reliability(
        found.plane[members],
        found.beam[members],
        found.position[members],
        found.determined[members],
        found.size[members],
        found.sigma[members],
        found.p[members],
        found.detectable[members],
        *found.shifts(members, found.detectable[members]),
    )


class _Analysis:
    """All members of all families, and their statistics.

    Attributes
    ----------
    codes, plane, beam, position : (m,)
        What each member is.
    share : (m,)
        What the unknowns leave of its column, the prior on k left out.
    determined : (m,) of bool
    moved : (m, 7 B)
        By how much the beams' part of the unknowns fits the column: it moves by the negative.
    size, sigma, z, p : (m,)
        Estimated size, its standard deviation, their ratio, and the probability after Holm.
    detectable : (m,)
    """

    def __init__(
        self,
        at: Parameters,
        readings: Readings,
        how: Whitening,
        prior: FloatArray,
        position: IntArray,
        dof: int | None,
    ) -> None:
        self.at, self.dof = at, dof
        rows = linear_rows(at, readings, how)
        bound = Projection(rows, prior)
        free = bound
        if bound.pull.any():
            free = Projection(rows, np.where(prior > 0.0, np.inf, 0.0))
        self.projection = bound
        self.whole = whole_columns(at, readings, position)
        self.families = families(at, readings, position)
        counts = [len(family.plane) for family in self.families]
        self.codes = np.array(WHOLE + tuple(family.code for family in self.families)).repeat(
            [1] * len(WHOLE) + counts
        )
        all_ = np.full(len(WHOLE), -1)
        self.plane = np.concatenate((all_, *(family.plane for family in self.families)))
        self.beam = np.concatenate((all_, *(family.beam for family in self.families)))
        self.position = np.concatenate((all_, *(family.position for family in self.families)))
        self._project(rows, free)
        if (prior[:, 0] > 0.0).all():
            self.determined[WHOLE.index("translation-scale")] = False
        pulled = bound.pull.copy()
        pulled[:, 5:] *= at.range_errors
        left = bound.perpendicular(rows.residual[:, None], pulled.reshape(-1, 1))
        square = float(left.squares[0])
        scale = how.sigma if dof is None else float(np.sqrt(square / dof))
        unit = {"m": readings.typical_range(), "1": 1.0}
        most = np.array([MOST_SIGMA * unit[WORDING[code].unit] for code in self.codes.tolist()])
        self.determined &= self.left > (scale / most) ** 2
        self._test(self.products(left.heavy)[:, 0], square, scale)

    def products(self, y: FloatArray) -> FloatArray:
        """Return the products (m, q) of all members with columns y (N, q)."""
        return np.concatenate((self.whole.T @ y, *(family.dot(y) for family in self.families)))

    def column(self, member: int) -> FloatArray:
        """Return the column (N,) of one member."""
        if member < len(WHOLE):
            return np.asarray(self.whole[:, member])
        member -= len(WHOLE)
        for family in self.families:
            if member < len(family.plane):
                return family.column_of(member)
            member -= len(family.plane)
        raise IndexError(member)

    def _project(self, rows: Rows, free: Projection) -> None:
        """Find what the unknowns leave of every member, and how the beams follow it."""
        found = self.projection.perpendicular(self.whole)
        loose = found if free is self.projection else free.perpendicular(self.whole)
        squares = [(self.whole * weighed(rows.how, self.whole)).sum(axis=0)]
        left, unbound, moved = [found.squares], [loose.squares], [found.moved.T]
        for family in self.families:
            sums, own = family.products(rows)
            squares.append(own)
            of_beams, part = self.projection.members(sums, own, family.plane)
            left.append(part)
            moved.append(of_beams)
            if free is not self.projection:
                part = free.members(sums, own, family.plane)[1]
            unbound.append(part)
        self.left, self.moved = np.concatenate(left), np.concatenate(moved)
        whole = np.concatenate(squares)
        self.share = np.concatenate(unbound) / np.where(whole > 0.0, whole, np.inf)
        self.determined: BoolArray = self.share > LEAST_SHARE

    def _test(self, score: FloatArray, square: float, scale: float) -> None:
        """Test all members, given their products with e, e'e, and the typical scale of noise."""
        left = np.where(self.determined, self.left, 1.0)
        each = np.full(len(left), scale)
        if self.dof is not None:
            explained = np.where(self.determined, score**2 / left, 0.0)
            each = np.sqrt(np.maximum(square - explained, TINY * square) / (self.dof - 1))
        self.size, self.sigma = score / left, each / np.sqrt(left)
        self.z = np.where(self.determined, self.size / np.maximum(self.sigma, TINY * scale), 0.0)
        tested = np.flatnonzero(self.determined)
        self.p = np.ones(len(left))
        self.p[tested] = holm(two_sided(self.z[tested], self.dof))
        if (self.p < LEVEL).any():
            scale = float(each[tested].min())
        self.critical, self.delta = needed(LEVEL / max(len(tested), 1), self.dof)
        smallest = self.delta * scale / np.sqrt(left)
        self.detectable = np.where(self.determined, smallest, np.inf)

    def shifts(self, members: IntArray, sizes: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return by how much r and v of every beam (m, B, 3) are wrong by members of some sizes."""
        basis = model.tangent_basis(self.at.directions)
        sizes = np.where(self.determined[members], sizes, np.nan)
        x = -self.moved[members].reshape(len(members), len(basis), WIDTH) * sizes[:, None, None]
        return x[:, :, :3], np.einsum("bij,mbj->mbi", basis, x[:, :, 3:5])

    def representatives(self) -> IntArray:
        """Return the clearest determined member of every family, the clearest first."""
        tested = np.flatnonzero(self.determined)
        tested = tested[np.argsort(-np.abs(self.z[tested]), kind="stable")]
        _, first = np.unique(self.codes[tested], return_index=True)
        return np.asarray(tested[np.sort(first)])

    def correlations(self, members: IntArray) -> FloatArray:
        """Return how members (k,) correlate with all (k, m), as far as the unknowns leave them."""
        columns = np.stack([self.column(member) for member in members.tolist()], axis=1)
        products = self.products(self.projection.perpendicular(columns).heavy).T
        left = np.where(self.determined, self.left, np.inf)
        found: FloatArray = products / np.sqrt(left[members, None] * left)
        return np.clip(found, -1.0, 1.0)

    def explained(self, members: IntArray, rho: FloatArray) -> list[str]:
        """Return for every representative the code of a clearer one that explains it, or nothing."""
        kept: list[int] = []
        words = []
        for one in range(len(members)):
            G = rho[kept][:, members[kept]]
            r = rho[kept, members[one]]
            solved = np.linalg.lstsq(G, np.stack((r, self.z[members[kept]]), axis=1), rcond=None)[0]
            freedom = max(1.0 - float(r @ solved[:, 0]), TINY)
            alone = (self.z[members[one]] - float(r @ solved[:, 1])) / np.sqrt(freedom)
            if kept and abs(alone) < self.critical:
                words.append(str(self.codes[members[kept[int(np.argmax(np.abs(r)))]]]))
            else:
                words.append("")
                kept.append(one)
        return words


def holm(p: FloatArray) -> FloatArray:
    """Return probabilities (m,) corrected for their number (Holm, Scand. J. Statist. 1979)."""
    order = np.argsort(p, kind="stable")
    steps = np.maximum.accumulate(p[order] * np.arange(len(p), 0, -1))
    corrected = np.empty(len(p))
    corrected[order] = np.minimum(steps, 1.0)
    return corrected


def two_sided(z: FloatArray, dof: int | None) -> FloatArray:
    """Return the probability of a larger |z|: Gaussian, or Student's with dof - 1."""
    tail = norm.sf(np.abs(z)) if dof is None else student.sf(np.abs(z), dof - 1)
    return np.asarray(2.0 * tail)


def needed(level: float, dof: int | None) -> tuple[float, float]:
    """Return the critical |z| at a level, and the mean of z that exceeds it with probability `POWER`.

    The square of the mean is the noncentrality lambda0. With an estimated scale z is noncentral
    Student.
    """
    gaussian = float(norm.isf(0.5 * level))
    if dof is None or dof > GAUSSIAN_DOF:
        return gaussian, gaussian + float(norm.ppf(POWER))
    critical = float(student.isf(0.5 * level, dof - 1))

    def short(mean: float) -> float:
        return float(nct.sf(critical, dof - 1, mean)) - POWER

    top = 2.0 * critical + 10.0
    return critical, float(brentq(short, 0.0, top)) if short(top) > 0.0 else top


def alike(rho: FloatArray, delta: float) -> BoolArray:
    """Tell which errors cannot be told from a true one of which z has the mean `delta`.

    The statistic of another is z' ~ N(rho delta, 1) with correlation rho to z. The right one fits
    better where z^2 > z'^2. As z - z' and z + z' are independent with means (1 -+ rho) delta and
    variances 2 (1 -+ rho), that has the probability F(a) F(b) + F(-a) F(-b), a, b = delta sqrt((1
    -+ rho) / 2), F the Gaussian distribution function.
    """
    a, b = delta * np.sqrt(0.5 * (1.0 - rho)), delta * np.sqrt(0.5 * (1.0 + rho))
    right = norm.cdf(a) * norm.cdf(b) + norm.cdf(-a) * norm.cdf(-b)
    return np.asarray(right < RIGHT)


def _reports(found: _Analysis, names: Names, stations: Sequence[str]) -> list[SystematicError]:
    """Return one report a kind: those tested, the clearest first, then those confounded."""
    first = found.representatives()
    reports = []
    if first.size:
        rho = found.correlations(first)
        explained = found.explained(first, rho)
        same = alike(rho, found.delta) & found.determined
        for number, member in enumerate(first.tolist()):
            codes = dict.fromkeys(found.codes[same[number]].tolist())
            others = tuple(code for code in codes if code != found.codes[member])
            subject = _subject(found, member, names, stations)
            reports.append(_report(found, member, subject, explained[number], others, names))
    tested = {report.code for report in reports}
    for code, words in WORDING.items():
        if code not in tested:
            what = words.phrase.replace(" by {size}", "").replace(" of {size}", "")
            what = what.format(subject=words.anywhere)
            reports.append(
                _confounded(
                    code,
                    f"{what} cannot be told from {words.confounded}",
                    words.remedy,
                    len(found.at.locations),
                )
            )
    return reports


def _report(
    found: _Analysis,
    member: int,
    subject: str,
    explained: str,
    others: tuple[str, ...],
    names: Names,
) -> SystematicError:
    code = str(found.codes[member])
    words = WORDING[code]
    family = np.flatnonzero((found.codes == code) & found.determined)
    detectable = float(found.detectable[family].max())
    shift, turn = (_worst(x) for x in found.shifts(family, found.detectable[family]))
    error, twist = (x[0] for x in found.shifts(np.array([member]), found.size[[member]]))
    p = float(found.p[member])
    clear = p < LEVEL
    beams = names.sorted_beams()
    if clear:
        size = size_in_words(float(found.size[member]), words.unit)
        message = (
            f"the readings show {words.phrase.format(size=size, subject=subject)} (p = {p:.1g}), which "
            f"makes {_effect(error, twist, beams, 'wrong by')}"
        )
        message += f"; it is explained by what is found as {explained}" if explained else ""
        message += f"; it may also be {' or '.join(others)}" if others and not explained else ""
    else:
        size = size_in_words(detectable, words.unit)
        phrase = words.phrase.format(size=size, subject=words.anywhere)
        message = (
            f"{phrase} would go unnoticed, and make {_effect(shift, turn, beams, 'wrong by up to')}"
        )
    return SystematicError(
        code,
        subject,
        words.unit,
        float(found.size[member]),
        float(found.sigma[member]),
        p,
        clear,
        explained if clear else "",
        detectable,
        shift,
        turn,
        error,
        twist,
        others,
        False,
        message,
        words.remedy,
    )


def _worst(shifts: FloatArray) -> FloatArray:
    """Return of every beam the largest of its shifts (m, B, 3)."""
    member = np.linalg.norm(shifts, axis=2).argmax(axis=0)
    return np.asarray(shifts[member, np.arange(shifts.shape[1])])


def _effect(shift: FloatArray, twist: FloatArray, beams: Sequence[str], verb: str) -> str:
    """Say which beam is moved most, and which is turned most."""
    location, turn = np.linalg.norm(shift, axis=1), np.linalg.norm(twist, axis=1)
    return (
        f"the location of beam {beams[int(location.argmax())]} {verb} {location.max() * 1e3:.2g} mm "
        f"and the direction of beam {beams[int(turn.argmax())]} {verb} {np.rad2deg(turn.max()):.2g} deg"
    )


def _subject(found: _Analysis, member: int, names: Names, stations: Sequence[str]) -> str:
    if found.plane[member] < 0:
        return ""
    plane = f"plane {names.sorted_planes()[found.plane[member]]}"
    if found.beam[member] >= 0:
        return f"beam {names.sorted_beams()[found.beam[member]]} on {plane}"
    return f"{plane} from station {stations[found.position[member]]} on"


def _confounded(code: str, message: str, remedy: str, beams: int) -> SystematicError:
    unknown = np.full((beams, 3), np.nan)
    unit = WORDING[code].unit if code in WORDING else "m"
    return SystematicError(
        code,
        "",
        unit,
        np.nan,
        np.nan,
        1.0,
        False,
        "",
        np.inf,
        unknown,
        unknown,
        unknown,
        unknown,
        (),
        True,
        message,
        remedy,
    )
