r"""Systematic errors: tested for, and bounded where they cannot be seen.

With e the whitened residuals, J the whitened Jacobian of all unknowns (pseudo-observations of a
prior on k included), A the whitened column of an effect (`model.effects`) and A_perp = A - J
inv(J'J) J'A, a size a of that error makes e = A a + J x + noise, and

    z = A_perp'e / (sigma |A_perp|) ~ N(0, 1) if a = 0,    a^ = A_perp'e / A_perp'A_perp,

which is Rao's score test. The unknowns of a solution that ignores the error move by -inv(J'J) J'A
a. The size that is found with 80 % power is sqrt(lambda0 / A_perp'A_perp) sigma, and what it does
to r and v is the external reliability (Baarda, A testing procedure for use in geodetic networks,
1968). Where the common factor of the noise was estimated, z has the scale of what A_perp leaves,
and a t distribution.

All members of all effects are tested together with Holm's correction, which needs no independence.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from .. import model
from ..arrays import FloatArray, IntArray
from ..data.value import Value
from ..estimation.errors_by_pose import ErrorsByPose
from ..model.distributions import FAMILY_LEVEL
from ..model.effects import EFFECTS, may_also_be
from ..observability.wording import BeamAndPlaneNames
from .dependence import INDEPENDENT, Dependence, dependence
from .messages import Values, said
from .projection import LinearRows
from .score_tests import ScoreTests, alike
from .shared_errors import NOTHING_SHARED, SharedErrors, with_errors_by_pose


@dataclass(frozen=True, slots=True, eq=False, repr=False, kw_only=True)
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
    unit: str
    subject: str = ""
    size: float = np.nan
    sigma: float = np.nan
    p_value: float = 1.0
    found: bool = False
    explained_by: str = ""
    detectable: float = np.inf
    plausible: float = np.inf
    location_shift: FloatArray
    direction_shift: FloatArray
    location_error: FloatArray
    direction_error: FloatArray
    spot_shift: FloatArray
    spot_error: FloatArray
    alike: tuple[str, ...] = ()
    confounded: bool = False
    message: str
    remedy: str

    @property
    def values(self) -> Values:
        """The names and numbers of its message."""
        return {"subject": self.subject, "size": self.size, "p_value": self.p_value}

    @property
    def unnoticed(self) -> float:
        """The size that may go unnoticed: the smaller of what is detectable and what is plausible."""
        return min(self.detectable, self.plausible)

    def spots(self, reading: float, *, unnoticed: bool) -> FloatArray:
        """Return how far it moves the spot of every beam (B,) at a reading [m]; NaN if unknown.

        At the size that may go `unnoticed`, or at that estimated. What was displaced amid a recording
        is, before and after, at least half of that from the mean, which mounts are of.
        """
        shift = self.spot_shift if unnoticed else self.spot_error
        powers = reading ** np.arange(shift.shape[1])
        moved = np.linalg.norm(np.einsum("bpi,p->bi", shift, powers), axis=1)
        if EFFECTS[self.code].of_mean and not unnoticed:
            moved = np.maximum(moved, 0.5 * abs(self.size))
        return np.asarray(moved)

    def moved(self, reading: float, *, unnoticed: bool) -> float:
        """Return how far it moves the spot that it moves most [m]; zero where nothing is known."""
        return float(np.nan_to_num(self.spots(reading, unnoticed=unnoticed)).max())

    @property
    def warning(self) -> str:
        """The sentence with the remedy, where it is found and nothing clearer explains it."""
        if not self.found or self.explained_by:
            return ""
        return f"{self.message}. To remove it: {self.remedy}"


def systematic_errors(
    rows: LinearRows,
    names: BeamAndPlaneNames,
    stations: Sequence[str],
    *,
    known: bool,
    dof: int,
    plausible: Mapping[str, float],
    shared: SharedErrors = NOTHING_SHARED,
    learn: Callable[[FloatArray, float], ErrorsByPose] | None = None,
) -> tuple[tuple[SystematicError, ...], Dependence, SharedErrors]:
    """Test the residuals at a solution for systematic errors, and for correlation in time.

    Where neighbouring residuals go together, errors that vary slowly are judged by as much noise as
    those have in common.

    Parameters
    ----------
    rows : LinearRows
    names : BeamAndPlaneNames
    stations : sequence of str
        Names of the stations by position.
    known : bool
        Whether the size of the noise was given; else a common factor was estimated.
    dof : int
    plausible : mapping
        The largest plausible size by code; of codes that are not there it is not known.
    shared : SharedErrors
        What follows from errors of the hand that stations share.
    learn : callable, optional
        Learns errors that change with the pose, beside errors of some columns (N, q), where as many
        stations say no more than one that is independent.

    Returns
    -------
    tuple of SystematicError
        Empty where there is no redundancy; arrays are in the order of the names. Those tested come
        first, the clearest before all others, then those confounded, and those that no recording can
        show come last.
    Dependence
    SharedErrors
        With errors that change with the pose.
    """
    if dof < (1 if known else 2):
        return (), INDEPENDENT, shared
    tests = ScoreTests(rows, None if known else dof, plausible, shared=shared)
    found = tests.found_columns()
    together = dependence(rows, tests.projection, known=known, found=found)
    if learn is not None:
        by_pose = _learned_by_pose(learn, tests, found, together, known=known)
        shared = with_errors_by_pose(shared, tests.projection, by_pose)
        tests = tests.judged_by(shared)
        beside = tests.found_columns()
        if not np.array_equal(beside, found):
            together = dependence(rows, tests.projection, known=known, found=beside)
    if together != INDEPENDENT:
        tests = tests.judged_by(shared, together.plane_growth)
    first, reports = tests.representatives(), []
    if first.size:
        rho = tests.correlations(first)
        explained = tests.explained(first, rho)
        same = alike(rho, tests.delta) & tests.determined
        for number, member in enumerate(first.tolist()):
            codes = dict.fromkeys(tests.codes[same[number]].tolist())
            others = tuple(code for code in codes if code != tests.codes[member])
            concerns = tests.plane[member], tests.beam[member], tests.position[member]
            subject = subject_in_words(str(tests.codes[member]), *concerns, names, stations)
            reports.append(_report(tests, member, subject, explained[number], others, names))
    tested = {report.code for report in reports}
    confounded = [
        code
        for code, effect in EFFECTS.items()
        if code not in (*tested, *rows.freed.codes) and effect.concerns(rows)
    ]
    reports += [_confounded(tests, code, names, plausible) for code in confounded]
    return tuple(reports), together, shared


def _learned_by_pose(
    learn: Callable[[FloatArray, float], ErrorsByPose],
    tests: ScoreTests,
    found: FloatArray,
    together: Dependence,
    *,
    known: bool,
) -> ErrorsByPose:
    """Return errors that change with the pose, learned beside columns (N, q) of errors that were found.

    Where they are seen nevertheless, they may be what was found, and are learned alone. Where
    neighbouring residuals go together, and errors that change with the pose do not explain that, as
    many fewer stations tell of these.
    """
    by_pose, times = learn(found, 1.0), 1.0
    if together != INDEPENDENT and by_pose.moved.any():
        columns = np.concatenate((found, *by_pose.columns), axis=1)
        left = dependence(tests.rows, tests.projection, known=known, found=columns)
        times = left.plane_growth**2
        by_pose = learn(found, times) if times > 1.0 else by_pose
    return learn(found[:, :0], times) if found.size and by_pose.is_seen else by_pose


def _report(
    tests: ScoreTests,
    member: int,
    subject: str,
    explained: str,
    others: tuple[str, ...],
    names: BeamAndPlaneNames,
) -> SystematicError:
    """Return the report of an error that was tested, given its clearest member."""
    code, p, size = str(tests.codes[member]), float(tests.p[member]), float(tests.size[member])
    words, beams, found = EFFECTS[code], names.sorted_beams(), p < FAMILY_LEVEL
    order = [index for _, index in names.beams]
    family = np.flatnonzero((tests.codes == code) & tests.determined)
    unnoticed = _largest_moves(tests, family, tests.unnoticed[family])
    estimated = _largest_moves(tests, np.array([member]), tests.size[[member]])
    if found:
        phrase = words.with_size(size, subject)
        message = f"the readings show {phrase} (p = {p:.1g}), which makes "
        message += _effect(*estimated[:2], beams, "wrong by")
        message += f"; it is explained by what is found as {explained}" if explained else ""
        message += f"; {may_also_be(others)}" if others and not explained else ""
    else:
        largest = words.with_size(float(tests.unnoticed[family].max()))
        effect = _effect(*unnoticed[:2], beams, "wrong by up to")
        message = f"{largest} would go unnoticed, and make {effect}"
    return SystematicError(
        code=code,
        unit=words.unit,
        subject=subject,
        size=size,
        sigma=float(tests.sigma[member]),
        p_value=p,
        found=found,
        explained_by=explained if found else "",
        detectable=float(tests.detectable[family].max()),
        plausible=float(tests.plausible[member]),
        location_shift=unnoticed[0][order],
        direction_shift=unnoticed[1][order],
        spot_shift=unnoticed[2][order],
        location_error=estimated[0][order],
        direction_error=estimated[1][order],
        spot_error=estimated[2][order],
        alike=others,
        message=message,
        remedy=words.remedy,
    )


def _confounded(
    tests: ScoreTests, code: str, names: BeamAndPlaneNames, plausible: Mapping[str, float]
) -> SystematicError:
    """Return the report of an error that the recording cannot show."""
    words, size = EFFECTS[code], plausible.get(code, np.inf)
    order = [index for _, index in names.beams]
    family = np.flatnonzero(tests.codes == code)
    unknown = np.full((tests.rows.readings.beams, 3), np.nan)
    unknown_spot = np.full((len(unknown), 4, 3), np.nan)
    shift, turn, spot = unknown, unknown, unknown_spot
    if words.across and np.isfinite(size):
        # The side to which the sensor is turned is unknown, and any will do.
        shift = size * model.tangent_basis(tests.rows.at.directions)[:, :, 0]
        turn, spot = np.zeros_like(shift), np.zeros((len(shift), 4, 3))
        spot[:, 0] = shift
    elif family.size:
        shift, turn, spot = _largest_moves(tests, family, np.full(len(family), size))
    message = f"{words.without_size()} cannot be told from {words.confounded}"
    if np.isfinite(size):
        effect = _effect(shift, turn, names.sorted_beams(), "wrong by up to")
        message = f"{words.with_size(size)} cannot be told from {words.confounded}, and would "
        message += f"make {effect}"
    return SystematicError(
        code=code,
        unit=words.unit,
        plausible=size,
        location_shift=shift[order],
        direction_shift=turn[order],
        spot_shift=spot[order],
        location_error=unknown,
        direction_error=unknown,
        spot_error=unknown_spot,
        confounded=True,
        message=message,
        remedy=words.remedy,
    )


def _largest_moves(
    tests: ScoreTests, family: IntArray, sizes: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return by how much members of some sizes move r, v and the spot of every beam at most."""
    shifts = tests.moves(family, sizes)
    powers = tests.rows.readings.typical_range() ** np.arange(4)
    moves = [*shifts[:2], np.einsum("mbpi,p->mbi", shifts[2], powers)]
    beams = np.arange(shifts[0].shape[1])
    worst = [np.linalg.norm(move, axis=2).argmax(axis=0) for move in moves]
    location, turn, spot = (
        np.asarray(shift[member, beams]) for shift, member in zip(shifts, worst, strict=True)
    )
    return location, turn, spot


def _effect(shift: FloatArray, twist: FloatArray, beams: Sequence[str], verb: str) -> str:
    """Say which beam is moved most, and which is turned most."""
    location, turn = np.linalg.norm(shift, axis=1), np.linalg.norm(twist, axis=1)
    names = {"located": beams[int(location.argmax())], "turned": beams[int(turn.argmax())]}
    return said("moved", verb=verb, far=location.max(), turn=turn.max(), **names)


def subject_in_words(
    code: str,
    plane: int,
    beam: int,
    position: int,
    names: BeamAndPlaneNames,
    stations: Sequence[str],
) -> str:
    """Return in words which plane, beam or first station a member concerns; -1 stands for all."""
    if plane < 0:
        if "{subject}" not in EFFECTS[code].phrase:
            return ""
        if EFFECTS[code].term is not None:
            return "all beams" if beam < 0 else f"beam {names.sorted_beams()[beam]}"
        return "little by little" if position < 0 else f"from station {stations[position]} on"
    words = f"plane {names.sorted_planes()[plane]}"
    if beam >= 0:
        return f"beam {names.sorted_beams()[beam]} on {words}"
    return f"{words} from station {stations[position]} on"
