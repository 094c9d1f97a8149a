r"""Systematic errors: tested for, and bounded where they cannot be seen.

With e the whitened residuals, J the whitened Jacobian of all unknowns (pseudo-observations of a
prior on k included), A the whitened column of an alternative (`systematic_columns`) and A_perp = A - J
inv(J'J) J'A, a size a of that error makes e = A a + J x + noise, and

    z = A_perp'e / (sigma |A_perp|) ~ N(0, 1) if a = 0,    a^ = A_perp'e / A_perp'A_perp,

which is Rao's score test. The unknowns of a solution that ignores the error move by -inv(J'J) J'A
a. The size that is found with 80 % power is sqrt(lambda0 / A_perp'A_perp) sigma, and what it does
to r and v is the external reliability (Baarda, A testing procedure for use in geodetic networks,
1968). Where the common factor of the noise was estimated, z has the scale of what A_perp leaves,
and a t distribution.

All members of all families are tested together with Holm's correction, which needs no independence.
Planes with more than `systematic_columns.MOST_SPLITS` splits are tested at so many of them.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from .. import model
from ..arrays import FloatArray, IntArray
from ..data.value import Value
from ..observability.wording import BeamAndPlaneNames
from ..quantities import IN_MM
from .dependence import INDEPENDENT, Dependence, dependence
from .projection import Rows
from .significance import FAMILY_LEVEL
from .systematic_tests import ScoreTests, alike
from .systematic_words import WORDING, may_also_be


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
    plausible : float
        The largest size that is plausible of such a sensor, plate or robot; infinite where not stated.
    location_shift, direction_shift : (B, 3)
        What may go unnoticed: how wrong r [m] and v [rad] of every beam would be by the member that
        moves that beam most, at the smaller of the sizes that are detectable and plausible. NaN where
        both are infinite.
    location_error, direction_error : (B, 3)
        How wrong r [m] and v [rad] are if the error has the size estimated. NaN where confounded.
    spot_shift, spot_error : (B, 4, 3)
        Likewise of laser spots: what goes with the powers 0 to 3 of the reading [m].
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
    plausible: float
    location_shift: FloatArray
    direction_shift: FloatArray
    location_error: FloatArray
    direction_error: FloatArray
    spot_shift: FloatArray
    spot_error: FloatArray
    alike: tuple[str, ...]
    confounded: bool
    message: str
    remedy: str

    @property
    def unnoticed(self) -> float:
        """The size that may go unnoticed: the smaller of what is detectable and what is plausible."""
        return min(self.detectable, self.plausible)

    def spots(self, reading: float, *, unnoticed: bool) -> FloatArray:
        """Return how far it moves the spot of every beam (B,) at a reading [m]; NaN if unknown.

        At the size that may go `unnoticed`, or at the size estimated.
        """
        shift = self.spot_shift if unnoticed else self.spot_error
        powers = reading ** np.arange(shift.shape[1])
        return np.asarray(np.linalg.norm(np.einsum("bpi,p->bi", shift, powers), axis=1))

    @property
    def warning(self) -> str:
        """The sentence with the remedy, where it is found and nothing clearer explains it."""
        if not self.found or self.explained_by:
            return ""
        return f"{self.message}. To remove it: {self.remedy}"


def systematic_errors(
    rows: Rows,
    names: BeamAndPlaneNames,
    stations: Sequence[str],
    *,
    known: bool,
    dof: int,
    plausible: Mapping[str, float] | None = None,
) -> tuple[tuple[SystematicError, ...], Dependence]:
    """Test the residuals at a solution for systematic errors, and for correlation in time.

    Where neighbouring residuals go together, errors that vary slowly are judged by as much noise as
    those have in common.

    Parameters
    ----------
    rows : Rows
    names : BeamAndPlaneNames
    stations : sequence of str
        Names of the stations by position.
    known : bool
        Whether the size of the noise was given; else a common factor was estimated.
    dof : int
    plausible : mapping, optional
        The largest plausible size by code; of codes that are not there it is not known.

    Returns
    -------
    tuple of SystematicError
        Empty where there is no redundancy. Those tested come first, the clearest before all others,
        then those confounded, and those that no recording can show come last.
    Dependence
    """
    if dof < (1 if known else 2):
        return (), INDEPENDENT
    plausible = {} if plausible is None else plausible
    found = ScoreTests(rows, None if known else dof, plausible)
    together = dependence(rows, known=known, found=found.found_columns())
    if together != INDEPENDENT:
        found = ScoreTests(rows, None if known else dof, plausible, together.plane_growth)
    first, reports = found.representatives(), []
    if first.size:
        rho = found.correlations(first)
        explained = found.explained(first, rho)
        same = alike(rho, found.delta) & found.determined
        for number, member in enumerate(first.tolist()):
            codes = dict.fromkeys(found.codes[same[number]].tolist())
            others = tuple(code for code in codes if code != found.codes[member])
            subject = _subject(found, member, names, stations)
            report = _report(found, member, subject, explained[number], others, names)
            reports.append(replace(report, plausible=plausible.get(report.code, np.inf)))
    tested = {report.code for report in reports}
    untold = [code for code in WORDING if code not in tested]
    if rows.readings.beams == 1:
        untold = [code for code in untold if code != "carry-over"]
    return (*reports, *(_confounded(found, code, names, plausible) for code in untold)), together


def _report(
    found: ScoreTests,
    member: int,
    subject: str,
    explained: str,
    others: tuple[str, ...],
    names: BeamAndPlaneNames,
) -> SystematicError:
    code, p, size = str(found.codes[member]), float(found.p[member]), float(found.size[member])
    words, beams, clear = WORDING[code], names.sorted_beams(), p < FAMILY_LEVEL
    family = np.flatnonzero((found.codes == code) & found.determined)
    detectable = float(found.detectable[family].max())
    shift, turn, spot = _worst(found, family, found.unnoticed[family])
    error, twist, off = _worst(found, np.array([member]), found.size[[member]])
    if clear:
        effect = _effect(error, twist, beams, "wrong by")
        phrase = words.with_size(size, subject)
        message = f"the readings show {phrase} (p = {p:.1g}), which makes {effect}"
        message += f"; it is explained by what is found as {explained}" if explained else ""
        message += f"; {may_also_be(others)}" if others and not explained else ""
    else:
        effect = _effect(shift, turn, beams, "wrong by up to")
        largest = words.with_size(float(found.unnoticed[family].max()))
        message = f"{largest} would go unnoticed, and make {effect}"
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
        plausible=np.inf,
        location_shift=shift,
        direction_shift=turn,
        location_error=error,
        direction_error=twist,
        spot_shift=spot,
        spot_error=off,
        alike=others,
        confounded=False,
        message=message,
        remedy=words.remedy,
    )


def _confounded(
    found: ScoreTests, code: str, names: BeamAndPlaneNames, plausible: Mapping[str, float]
) -> SystematicError:
    """Return the report of an error that the recording cannot show."""
    words, size = WORDING[code], plausible.get(code, np.inf)
    family = np.flatnonzero(found.codes == code)
    unknown = np.full((found.rows.readings.beams, 3), np.nan)
    shift, turn, spot = unknown, unknown, np.full((len(unknown), 4, 3), np.nan)
    if code == "tilt" and np.isfinite(size):
        shift, turn, spot = _sideways(found.rows.at.directions, size)
    elif family.size:
        shift, turn, spot = _worst(found, family, np.full(len(family), size))
    message = f"{words.without_size()} cannot be told from {words.confounded}"
    if np.isfinite(size):
        effect = _effect(shift, turn, names.sorted_beams(), "wrong by up to")
        message = f"{words.with_size(size)} cannot be told from {words.confounded}, and would "
        message += f"make {effect}"
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
        plausible=size,
        location_shift=shift,
        direction_shift=turn,
        location_error=unknown,
        direction_error=unknown,
        spot_shift=spot,
        spot_error=np.full_like(spot, np.nan),
        alike=(),
        confounded=True,
        message=message,
        remedy=words.remedy,
    )


def _sideways(directions: FloatArray, size: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the shifts of r, v and spots by readings that err by `size` [m] times tan(tilt).

    With dr across the beam a plane that is tilted by the angle a towards dr is met |dr| tan a earlier.
    Which way the sensor is turned is not known: any way does.
    """
    shift = size * model.tangent_basis(directions)[:, :, 0]
    spot = np.zeros((len(shift), 4, 3))
    spot[:, 0] = shift
    return shift, np.zeros_like(shift), spot


def _worst(
    found: ScoreTests, family: IntArray, sizes: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return of every beam its largest shifts of r, of v and of the spot by members of some sizes."""
    shifts = (*found.shifts(family, sizes), found.spots(family, sizes))
    powers = found.rows.readings.typical_range() ** np.arange(4)
    amounts = [*shifts[:2], np.einsum("mbpi,p->mbi", shifts[2], powers)]
    beams = np.arange(shifts[0].shape[1])
    worst = [np.linalg.norm(one, axis=2).argmax(axis=0) for one in amounts]
    location, turn, spot = (
        np.asarray(shift[member, beams]) for shift, member in zip(shifts, worst, strict=True)
    )
    return location, turn, spot


def _effect(shift: FloatArray, twist: FloatArray, beams: Sequence[str], verb: str) -> str:
    """Say which beam is moved most, and which is turned most."""
    location, turn = np.linalg.norm(shift, axis=1), np.linalg.norm(twist, axis=1)
    return (
        f"the location of beam {beams[int(location.argmax())]} {verb} {location.max() * IN_MM:.2g} mm "
        f"and the direction of beam {beams[int(turn.argmax())]} {verb} {np.rad2deg(turn.max()):.2g} deg"
    )


def _subject(
    found: ScoreTests, member: int, names: BeamAndPlaneNames, stations: Sequence[str]
) -> str:
    """Return in words which plane, beam or station a member concerns."""
    number, beam = int(found.plane[member]), int(found.beam[member])
    if number < 0:
        if found.codes[member] != "tool-displaced":
            return ""
        first = int(found.position[member])
        return "little by little" if first < 0 else f"from station {stations[first]} on"
    plane = f"plane {names.sorted_planes()[number]}"
    if beam >= 0:
        return f"beam {names.sorted_beams()[beam]} on {plane}"
    return f"{plane} from station {stations[found.position[member]]} on"
