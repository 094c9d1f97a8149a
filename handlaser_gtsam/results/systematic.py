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

from ..arrays import FloatArray
from ..data.value import Value
from ..observability.wording import Names
from .projection import Rows
from .score_tests import ScoreTests, alike
from .significance import FAMILY_LEVEL
from .wording import WORDING


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class SystematicError(Value):
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
        Whether it is below `FAMILY_LEVEL`.
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


def systematic_errors(
    rows: Rows, names: Names, stations: Sequence[str], *, known: bool, dof: int
) -> tuple[SystematicError, ...]:
    """Test the residuals at a solution for systematic errors; the clearest come first.

    Parameters
    ----------
    rows : Rows
    names : Names
    stations : sequence of str
        Names of the stations by position.
    known : bool
        Whether the size of the noise was given; else a common factor was estimated.
    dof : int

    Returns
    -------
    tuple of SystematicError
        Empty where there is no redundancy. Those tested come first, then those confounded, and those
        that no recording can show come last.
    """
    if dof < (1 if known else 2):
        return ()
    found = ScoreTests(rows, None if known else dof)
    first, reports = found.representatives(), []
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
    untold = [code for code in WORDING if code not in tested]
    return (*reports, *(_confounded(code, rows.readings.beams) for code in untold))


def _report(
    found: ScoreTests,
    member: int,
    subject: str,
    explained: str,
    others: tuple[str, ...],
    names: Names,
) -> SystematicError:
    code, p, size = str(found.codes[member]), float(found.p[member]), float(found.size[member])
    words, beams, clear = WORDING[code], names.sorted_beams(), p < FAMILY_LEVEL
    family = np.flatnonzero((found.codes == code) & found.determined)
    detectable = float(found.detectable[family].max())
    shift, turn = (_worst(x) for x in found.shifts(family, found.detectable[family]))
    error, twist = (x[0] for x in found.shifts(np.array([member]), found.size[[member]]))
    if clear:
        effect = _effect(error, twist, beams, "wrong by")
        phrase = words.with_size(size, subject)
        message = f"the readings show {phrase} (p = {p:.1g}), which makes {effect}"
        message += f"; it is explained by what is found as {explained}" if explained else ""
        message += f"; it may also be {' or '.join(others)}" if others and not explained else ""
    else:
        effect = _effect(shift, turn, beams, "wrong by up to")
        message = f"{words.with_size(detectable)} would go unnoticed, and make {effect}"
    return SystematicError(
        code,
        subject,
        words.unit,
        size,
        float(found.sigma[member]),
        p,
        found=clear,
        explained_by=explained if clear else "",
        detectable=detectable,
        location_shift=shift,
        direction_shift=turn,
        location_error=error,
        direction_error=twist,
        alike=others,
        confounded=False,
        message=message,
        remedy=words.remedy,
    )


def _confounded(code: str, beams: int) -> SystematicError:
    """Return the report of an error that the recording cannot show."""
    words, unknown = WORDING[code], np.full((beams, 3), np.nan)
    message = f"{words.without_size()} cannot be told from {words.confounded}"
    return SystematicError(
        code,
        subject="",
        unit=words.unit,
        size=np.nan,
        sigma=np.nan,
        p_value=1.0,
        found=False,
        explained_by="",
        detectable=np.inf,
        location_shift=unknown,
        direction_shift=unknown,
        location_error=unknown,
        direction_error=unknown,
        alike=(),
        confounded=True,
        message=message,
        remedy=words.remedy,
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


def _subject(found: ScoreTests, member: int, names: Names, stations: Sequence[str]) -> str:
    """Return in words which plane, beam or station a member concerns."""
    number, beam = int(found.plane[member]), int(found.beam[member])
    if number < 0:
        return ""
    plane = f"plane {names.sorted_planes()[number]}"
    if beam >= 0:
        return f"beam {names.sorted_beams()[beam]} on {plane}"
    return f"{plane} from station {stations[found.position[member]]} on"
