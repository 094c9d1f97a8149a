r"""Whether a calibration holds for another recording.

The planes of that recording are unknown, the beams b known with covariance P. Near them, with the
planes fitted, the whitened residuals cost (`model.reduction`)

    chi2(b + x) = c + 2 g' x + x' S x,

S being what the recording itself knows of the beams. Beams as calibrated leave the least of
chi2(b + x) + x' inv(P) x; beams that are free leave c - g' S^+ g. The difference is chi-square
distributed with as many degrees of freedom as S has rank if nothing has moved, and what the free
beams leave tells whether noise and model are right. One beam at a time has moved: the same with its
part of P infinite. All have moved alike, as where the tool frame is another one: the same with a twist
of the hand that is free.

What by itself explains a difference is what leaves none: a beam or a twist that may have moved, or
another reading of the file with which the calibration holds.
"""

import math
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import combinations
from typing import TYPE_CHECKING, overload

import numpy as np
from scipy.spatial.transform import Rotation

from .. import model
from ..arrays import BoolArray, FloatArray
from ..checks import require_kind
from ..data.noise import Noise
from ..data.parameters import Beams, Parameters
from ..data.recording import Readings, Recording
from ..data.survey import Survey
from ..data.value import Value
from ..errors import CalibrationWarning, GrazingBeamError, HandlaserError, InputError
from ..model.distributions import FEW_DEGREES, SINGLE_LEVEL, f_sf, squares_sf
from ..model.families import BEAM, DIRECTION, LOCATION, PLANE, modelled
from ..model.geometry import skew
from ..model.joint import beams_lift
from ..model.weighting import Variances, Whitening, covariance_roots, whitening
from ..progress import tell
from ..quantities import IN_DEG, IN_MM, KNOWN, MOST_ROUNDS, SINGULAR, TEN_TIMES
from ..results.calibration import Calibration
from ..results.file_mistakes import ALL_LENGTHS, HYPOTHESES
from ..results.messages import Values, warned
from ..results.mounts import Mounts
from ..results.rereading import Change
from ..results.shared_errors import stops_of
from ..solvers.beam_problem import linearized, moved
from ..starts.growing import grown_from

if TYPE_CHECKING:
    from ..results.mounts import PlacedMount
    from ..results.survey import SurveyCalibration
    from .other_survey import SurveyHoldOut


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class BeamDrift(Value):
    """Whether one beam has moved since its calibration, or while a session went on.

    Attributes
    ----------
    name : str
    statistic : float
        By how much chi2 falls when this beam alone may have moved.
    p_value : float
        Probability of so large a fall if it has not; in a session if none has, all epochs and beams
        considered.
    shift : (3,)
        By how much its location would have moved [m]; NaN in a session where it has moved so far that
        planes fit only without it.
    turn : float
        By how much its direction would have [rad]; NaN likewise.
    since : str
        The first plane of a session that saw it moved; empty of another recording.
    rest_p_value : float
        Probability of a larger rest of the drift if this beam alone has moved; NaN where the recording
        says nothing else, and in a session.
    """

    name: str
    statistic: float
    p_value: float
    shift: FloatArray
    turn: float
    since: str = ""
    rest_p_value: float = math.nan


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class HoldOut(Value):
    """A recording that a calibration did not see.

    Attributes
    ----------
    readings : int
    rms, max_residual : float
        Of the residuals with the calibrated beams and the planes fitted [m].
    chi2, dof : float, int
        Of noise and model, the beams free: near dof if they are right. Where no range sigma is given,
        in units of the one that the calibration found.
    noise_p_value : float
        Probability of a larger chi2 then; NaN where the range sigma was estimated from it.
    drift, drift_dof : float, int
        What the beams as calibrated add to it.
    p_value : float
        Probability of a larger drift if the calibration still holds.
    beams : tuple of BeamDrift
    hand : (6,)
        The twist by which all beams would have moved alike: rotation vector [rad], translation [m].
    hand_p_value : float
        Probability of a larger rest of the drift then; NaN where the recording says nothing else.
    max_residual_at : (str, str)
        The station and the beam of the largest residual.
    explained_by : tuple of CalibrationWarning
        What by itself explains that the calibration does not hold, where that was asked for.
    """

    readings: int
    rms: float
    max_residual: float
    chi2: float
    dof: int
    noise_p_value: float
    drift: float
    drift_dof: int
    p_value: float
    beams: tuple[BeamDrift, ...]
    hand: FloatArray
    hand_p_value: float
    max_residual_at: tuple[str, str]
    explained_by: tuple[CalibrationWarning, ...] = ()

    @property
    def misfit(self) -> float:
        """How many times as large as stated the noise is, the beams free."""
        return float(np.sqrt(self.chi2 / self.dof)) if self.dof > 0 else 1.0

    @property
    def fits(self) -> bool:
        """Whether the readings fit some beams."""
        return self.misfit <= TEN_TIMES

    @property
    def holds(self) -> bool:
        """Whether nothing contradicts the calibration, and the readings fit some beams at all."""
        return self.fits and not self.p_value < SINGLE_LEVEL


@overload
def hold_out(
    calibration: "Mounts | Calibration",
    recording: Recording,
    noise: Noise | None = None,
    *,
    each_beam: bool = True,
    explain: bool = False,
) -> HoldOut: ...


@overload
def hold_out(
    calibration: "SurveyCalibration | Sequence[PlacedMount]",
    recording: Survey,
    noise: Noise | None = None,
) -> "SurveyHoldOut": ...


def hold_out(
    calibration: "Mounts | Calibration | SurveyCalibration | Sequence[PlacedMount]",
    recording: Recording | Survey,
    noise: Noise | None = None,
    *,
    each_beam: bool = True,
    explain: bool = False,
) -> "HoldOut | SurveyHoldOut":
    """Compare a calibration with another recording, or survey, of the same sensors.

    Parameters
    ----------
    calibration : Calibration, SurveyCalibration, Mounts or sequence of PlacedMount
        A file gives the last two: `hl.read_mounts(path)`, and of a survey
        `hl.read_calibration(path).placed()`.
    recording : Recording or Survey
        With some of the calibrated beams and sensors; its planes and other targets may be any.
    noise : Noise, optional
        Of the new recording. Of beams before planes, an unknown range sigma is taken from the
        calibration, and what the recording shows where it has readings enough, and unknown errors of
        the poses are taken from the calibration; beams that are rougher there are as much rougher
        here. A survey is calibrated by itself.
    each_beam : bool
        Whether each beam is tested alone, too; that takes long for dozens of beams. Mounts of a survey
        are compared one by one.
    explain : bool
        Whether to look for what by itself explains that it does not hold. That solves dozens of times;
        nothing is looked for with a survey.

    Returns
    -------
    HoldOut or SurveyHoldOut

    Raises
    ------
    InputError
        A sensor or beam that was not calibrated, or pose covariances of another number of stations;
        with `explain`, readings that the calibrated beams cannot have, too.
    GrazingBeamError
        A beam grazes the plane that its readings would have.
    NotConvergedError
        A calibration does not determine a mount.
    """
    if isinstance(recording, Survey):
        from .other_survey import hold_out_survey  # few have sensors of many rays

        if explain or not each_beam:
            raise InputError("each_beam or explain with a survey", "neither of them")
        return hold_out_survey(calibration, recording, noise)
    noise = Noise() if noise is None else noise
    mounts = Mounts.of(calibration) if isinstance(calibration, Calibration) else calibration
    require_kind(
        "the calibration of a recording", mounts, Mounts, "Calibration, or hl.read_mounts(path)"
    )
    assert isinstance(mounts, Mounts), "checked above"
    require_kind("recording", recording, Recording)
    require_kind("noise", noise, Noise)
    tell("hold-out")
    try:
        result = _held_out(mounts, recording, noise, each_beam)
    except GrazingBeamError as error:
        if not explain:
            raise
        causes = _explanations(mounts, recording, noise, None)
        likely = " or ".join(one.message for one in causes) or "planes would lie along a beam"
        found = f"readings that the calibrated beams cannot have: {likely}"
        raise InputError(
            found, "units, poses, channels and labels as for the calibration"
        ) from error
    if explain and not result.holds:
        why = _explanations(mounts, recording, noise, result)
        result = replace(result, explained_by=tuple(why))
    return result


def _held_out(mounts: Mounts, recording: Recording, noise: Noise, each_beam: bool) -> HoldOut:
    """Compare calibrated beams with a recording."""
    noise = noise.reordered(np.arange(len(recording.plane_labels)))
    typical = float(np.median(mounts.range_sigma))
    mounts = mounts.arranged(recording.beam_names)
    readings = recording.readings().about_planes()
    # Beams that are rougher than others are so in every recording.
    sigmas = mounts.range_sigma * ((noise.range_sigma or typical) / typical)
    stations, pose = len(recording.plane_labels), None
    if noise.poses_uncertain:
        pose = noise.pose_covariances(stations)
    elif not noise.poses_exact and mounts.pose_covariance is not None:
        pose = np.broadcast_to(mounts.pose_covariance, (stations, 6, 6))
    if pose is not None:
        pose = _of_visits(recording, noise, pose)
    variances = Variances(sigmas, noise.incidence_sigma, pose)
    beams = (mounts.locations, mounts.directions, mounts.range_errors)
    at, how = fit_planes(beams, readings, variances)
    e = model.residuals(model.scene(at, readings), readings.distance)
    white = how.apply(e) / how.sigma
    active = modelled(mounts.terms).ravel()
    every = np.tile(BEAM.natural_units(readings.typical_range()), readings.beams)
    unit, beam = every[active], np.repeat(np.arange(readings.beams), BEAM.dim)[active]
    known, cost = noise.range_sigma is not None, float(white @ white)
    squares = _Squares(at, readings, how, active, cost, known)
    behind = min(np.inf if squares.known else max(squares.dof, 1), mounts.dof)

    def p_value(statistic: float, degrees: int) -> float:
        """Return the probability of a larger statistic; NaN without degrees of freedom."""
        return float(squares_sf(statistic, degrees, behind)) if degrees else math.nan

    bases = model.tangent_basis(mounts.directions)
    lift = beams_lift(bases, mounts.terms)
    covariance = lift.T @ mounts.covariance @ lift / np.outer(unit, unit)

    (own,) = covariance_roots(covariance[None])
    held, rank = squares.least(own, own[:, :0])[0], squares.rank
    drift = squares.fall - held
    drifts = []
    for index, name in enumerate(mounts.names if each_beam else ()):
        mine = beam == index
        others = np.where(mine[:, None], 0.0, own)
        fall, x = squares.least(others, np.eye(len(own))[:, mine])
        statistic, dx = max(fall - held, 0.0), (x * unit)[mine]
        degrees = min(int(mine.sum()), rank)
        p, rest = p_value(statistic, degrees), p_value(drift - statistic, rank - degrees)
        turn = float(np.linalg.norm(dx[DIRECTION]))
        drifts.append(BeamDrift(name, statistic, p, dx[LOCATION], turn, rest_p_value=rest))
    # A twist (w, u) of the hand moves r by w x r + u, and v by w x v.
    twist = np.zeros((readings.beams, BEAM.dim, 6))
    twist[:, LOCATION, :3] = -skew(mounts.locations)
    twist[:, LOCATION, 3:] = np.eye(3)
    twist[:, DIRECTION, :3] = -np.swapaxes(bases, 1, 2) @ skew(mounts.directions)
    along_twist = twist.reshape(-1, 6)[active] / unit[:, None]
    fall, x = squares.least(own, along_twist)
    alike = np.asarray(np.linalg.lstsq(along_twist, x, rcond=SINGULAR)[0], dtype=float)
    worst, dof, chi2 = int(np.abs(e).argmax()), squares.dof, squares.chi2
    noise_p_value = math.nan
    if squares.known and dof > 0:
        noise_p_value = float(squares_sf(chi2, dof, np.inf if known else mounts.dof))
    where = recording.station_names[readings.station[worst]], mounts.names[readings.beam[worst]]
    return HoldOut(
        readings=len(e),
        rms=float(np.sqrt(np.mean(e**2))),
        max_residual=float(np.abs(e[worst])),
        chi2=chi2 * squares.scale,
        dof=dof,
        noise_p_value=noise_p_value,
        drift=drift,
        drift_dof=rank,
        p_value=p_value(drift, rank),
        beams=tuple(drifts),
        hand=alike,
        hand_p_value=p_value(drift - (fall - held), rank - min(6, rank)),
        max_residual_at=where,
    )


class _Squares:
    """What a recording says of the `active` unknowns of beams, its planes fitted to them.

    Beams that differ by x from the calibrated ones, in natural units, have the sum of squares
    chi2(b + x) = chi2 + fall + 2 gradient' x + x' information x.

    Parameters
    ----------
    at : Parameters
        The beams as calibrated, and the planes that fit.
    readings : Readings
    how : Whitening
    active : (7 B,) of bool
    cost : float
        Sum of squares there, in units of the stated noise.
    given : bool
        Whether the range sigma was given.

    Attributes
    ----------
    information, gradient : (n, n), (n,)
        Along what the recording determines.
    chi2, fall : float
        Of free beams, and what the calibrated ones add to it, in units of the noise.
    scale : float
        Square of the noise, in units of the stated one.
    rank, dof : int
        Of the information, and degrees of freedom beside it.
    known : bool
        Whether the noise is known; else it is what the readings show.
    """

    def __init__(
        self,
        at: Parameters,
        readings: Readings,
        how: Whitening,
        active: BoolArray,
        cost: float,
        given: bool,
    ) -> None:
        normal, _ = linearized(at, readings, 2, how)
        length = readings.typical_range()
        every = np.tile(BEAM.natural_units(length), readings.beams)
        reduced = normal.reduced(every, PLANE.natural_units(length), active)
        values, axes = np.linalg.eigh(reduced.matrix / how.sigma**2)
        free = len(readings) - 3 * readings.planes
        along = axes.T @ reduced.gradient / how.sigma**2
        self.scale, keep = 1.0, values > KNOWN**-2
        # Few readings cannot tell their own sigma: that of the calibration stands for it.
        self.known = given or free - int(keep.sum()) < FEW_DEGREES
        # In three rounds the scale of the noise and the directions that it determines settle together.
        for _ in range(0 if self.known else 3):
            rest = cost - float((along[keep] ** 2 / values[keep]).sum())
            self.scale = rest / (free - int(keep.sum()))
            keep = values / self.scale > KNOWN**-2
        axes, values, along = axes[:, keep], values[keep] / self.scale, along[keep] / self.scale
        self.fall, self.rank = float((along**2 / values).sum()), int(keep.sum())
        self.chi2, self.dof = cost / self.scale - self.fall, free - self.rank
        self.information, self.gradient = (axes * values) @ axes.T, axes @ along

    def least(self, root: FloatArray, free: FloatArray) -> tuple[float, FloatArray]:
        """Return by how much chi2 falls, and for which x = root z + free y; z' z adds to chi2."""
        A = np.hstack((root, free))
        Q = A.T @ self.information @ A
        Q[: root.shape[1], : root.shape[1]] += np.eye(root.shape[1])
        b = A.T @ self.gradient
        z = -np.linalg.pinv(Q, rcond=SINGULAR, hermitian=True) @ b
        return float(-b @ z), A @ z


def _explanations(
    mounts: Mounts, recording: Recording, noise: Noise, found: HoldOut | None
) -> list[CalibrationWarning]:
    """Return what by itself explains that a calibration does not hold.

    `found` is None where no planes fit the readings as they stand. What takes long is tried only where
    nothing else explains it.
    """

    def holds(change: Change) -> bool:
        """Tell whether the calibration holds for a changed recording."""
        with suppress(HandlaserError):  # read another way, it may be no recording
            changed, S = change(recording), noise.pose_covariance
            if S is not None and S.ndim == 3:
                S = S[np.isin(recording.station_names, changed.station_names)]
            one = _held_out(mounts, changed, replace(noise, pose_covariance=S), each_beam=False)
            return _noise_alike(one) and one.p_value >= SINGLE_LEVEL
        return False

    def without(names: Sequence[str], name: str) -> Change:
        return lambda whole: whole.part(np.array(names) != name)

    def without_beam(name: str) -> Change:
        return lambda whole: whole.without(np.array(whole.beam_names) == name)

    def exchanged(one: str, two: str) -> Change:
        other = {one: two, two: one}
        names = tuple(other.get(name, name) for name in recording.beam_names)
        return lambda whole: replace(whole, beam_names=names)

    causes: list[CalibrationWarning] = []
    first: list[tuple[CalibrationWarning, Change]] = []
    suspects = recording.beam_names
    if found is not None:
        for beam in found.beams:
            values: Values = {"beam": beam.name}
            if not _noise_alike(found):  # its step is too long to be told from here
                if holds(without_beam(beam.name)):
                    causes.append(warned("explained:beam", values, how=""))
            elif beam.p_value < SINGLE_LEVEL and not beam.rest_p_value < SINGLE_LEVEL:
                shift = float(np.linalg.norm(beam.shift))
                moved = f" by {shift * IN_MM:.3g} mm and turned by {beam.turn * IN_DEG:.3g} deg"
                values = {"beam": beam.name, "shift": shift, "turn": beam.turn}
                causes.append(warned("explained:beam", values, how=moved))
        causes += _hand_moved(mounts, recording, noise, found)
        station, of = found.max_residual_at[0], recording.station_names
        first.append((warned("explained:station", {"station": station}), without(of, station)))
        # Two beams that were exchanged are among those that gain most by moving.
        beams = sorted(found.beams, key=lambda one: -one.statistic)
        suspects = tuple(beam.name for beam in beams)
    first += [
        (warned("explained:channels", {"first": one, "second": two}), exchanged(one, two))
        for one, two in combinations(suspects[:4], 2)
    ]
    then = [
        (warned("explained:plane", {"plane": plane}), without(recording.plane_labels, plane))
        for plane in recording.plane_names
    ]
    then += [
        (warned("explained:file", {"mistake": words}), undone)
        for words, undone in (ALL_LENGTHS | HYPOTHESES).items()
    ]
    causes += [warning for warning, change in first if holds(change)]
    return causes or [warning for warning, change in then if holds(change)]


def _noise_alike(found: HoldOut) -> bool:
    """Tell whether readings scatter about free beams as on the day of the calibration.

    The noise of another day is taken to be as uncertain as one that few readings tell.
    """
    alike = f_sf(found.misfit**2, found.dof, FEW_DEGREES) if found.dof > 0 else 1.0
    return bool(alike >= SINGLE_LEVEL)


def _hand_moved(
    mounts: Mounts, recording: Recording, noise: Noise, found: HoldOut
) -> Iterator[CalibrationWarning]:
    """Yield the twist of the hand by which all beams have moved alike, if one explains it."""
    R, t, now = recording.world_R_hand, recording.world_t_hand, found
    turned, shifted = np.eye(3), np.zeros(3)
    with suppress(HandlaserError):
        for _ in range(3):  # a few steps are enough, or it is another cause
            step = Rotation.from_rotvec(now.hand[:3].copy()).as_matrix()
            shifted, turned = shifted + turned @ now.hand[3:], turned @ step
            moved = replace(recording, world_R_hand=R @ turned, world_t_hand=t + R @ shifted)
            now = _held_out(mounts, moved, noise, each_beam=False)
            if _noise_alike(now) and not now.hand_p_value < SINGLE_LEVEL:
                shift = float(np.linalg.norm(shifted))
                turn = float(Rotation.from_matrix(turned).magnitude())
                yield warned("explained:hand", {"shift": shift, "turn": turn})
                return


def _of_visits(recording: Recording, noise: Noise, pose: FloatArray) -> FloatArray:
    """Return covariances (M, 6, 6) for independent errors of which n visits to a stop say as much.

    What n stations of one stop read has the mean error p of the hand; so has the mean of n independent
    errors of variance n p^2.
    """
    read = np.flatnonzero(~np.isnan(recording.ranges).all(axis=1))
    stops = stops_of(recording, read, noise.standstill, pose)
    if stops is None:
        return pose
    at = stops.stop[read] * len(recording.plane_names) + recording.plane_of_station[read]
    _, number, count = np.unique(at, return_inverse=True, return_counts=True)
    often = np.ones(len(recording.plane_labels))
    often[read] = count[number]
    return pose * often[:, None, None]


def fit_planes(
    beams: Beams, readings: Readings, variances: Variances
) -> tuple[Parameters, Whitening]:
    """Return the planes that fit `readings` best for fixed beams (r, v, k), and the whitening there."""
    r, v, k = beams
    at = grown_from(readings, r=r, v=v, k=k)
    unit = PLANE.natural_units(readings.typical_range())
    still = np.zeros((readings.beams, BEAM.dim))
    for _ in range(MOST_ROUNDS):  # the closed-form planes converge quadratically
        how = whitening(at, readings, variances)
        normal, centres = linearized(at, readings, 2, how)
        step = normal.reduced(np.ones(still.size), unit).local_step * unit
        at = moved(at, still, step, centres)
        if np.abs(step).max() < SINGULAR:
            break
    return at, whitening(at, readings, variances)
