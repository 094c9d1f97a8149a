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

from ..arrays import FloatArray, IntArray
from ..data.parameters import Parameters
from ..data.recording import Readings
from ..data.value import Value
from ..model.weighting import Whitening
from ..observability.wording import Names
from .score_tests import LEVEL, ScoreTests, alike
from .wording import BY_NATURE, WORDING


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
    stations : sequence of str, optional
        Names of the stations by position; their numbers from 1 where not given.

    Returns
    -------
    tuple of SystematicError
        Empty where there is no redundancy. Errors that no recording can show come last.
    """
    if dof < (1 if known else 2):
        return ()
    found = ScoreTests(at, readings, how, prior, position, None if known else dof)
    if stations is None:
        stations = [str(j + 1) for j in range(int(position.max()) + 1)]
    return (*_reports(found, names, stations), *_by_nature(readings.beams))


def _by_nature(beams: int) -> list[SystematicError]:
    """Return the errors that no recording can show."""
    return [_confounded(code, *words, beams) for code, words in BY_NATURE.items()]


def _reports(found: ScoreTests, names: Names, stations: Sequence[str]) -> list[SystematicError]:
    """Return one report a kind: those tested, the clearest first, then those confounded."""
    first = found.representatives()
    reports = []
    if first.size:
        rho = found.correlations(first)
        explained = found.explained(first, rho)
        same = alike(rho, found.delta) & found.determined
        for number, member in enumerate(first.tolist()):
            codes = dict.fromkeys(found.members.codes[same[number]].tolist())
            others = tuple(code for code in codes if code != found.members.codes[member])
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
    found: ScoreTests,
    member: int,
    subject: str,
    explained: str,
    others: tuple[str, ...],
    names: Names,
) -> SystematicError:
    code = str(found.members.codes[member])
    words = WORDING[code]
    family = np.flatnonzero((found.members.codes == code) & found.determined)
    detectable = float(found.detectable[family].max())
    shift, turn = (_worst(x) for x in found.shifts(family, found.detectable[family]))
    error, twist = (x[0] for x in found.shifts(np.array([member]), found.size[[member]]))
    p = float(found.p[member])
    clear = p < LEVEL
    beams = names.sorted_beams()
    if clear:
        effect = _effect(error, twist, beams, "wrong by")
        phrase = words.with_size(float(found.size[member]), subject)
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


def _subject(found: ScoreTests, member: int, names: Names, stations: Sequence[str]) -> str:
    if found.members.plane[member] < 0:
        return ""
    plane = f"plane {names.sorted_planes()[found.members.plane[member]]}"
    if found.members.beam[member] >= 0:
        return f"beam {names.sorted_beams()[found.members.beam[member]]} on {plane}"
    return f"{plane} from station {stations[found.members.position[member]]} on"


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
