"""What a report is about, computed once: the calibration and everything that its parts show of it.

A part of it is how the uncertainty fell with the stations, up to what the calibration states. The first
stations are judged at the most probable scales of noise and range errors. The calibration integrates
over these scales, takes what the range errors of its beams have in common into account, and counts
noise that is correlated in time; so its standard deviations differ by up to a tenth from what all
stations give at these scales. All are multiplied by that factor, beam by beam, so that the last are the
calibration's.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ...arrays import BoolArray, FloatArray, IntArray
from ...data.recording import Recording
from ...errors import GrazingBeamError, InputError, SolverError
from ...model.joint import JointCovariance
from ...planning.advice import next_stations
from ...planning.goal import Forecast
from ...planning.route import Plan
from ...progress import tell
from ...results.calibration import Calibration
from ...results.description.beams import CalibrationDescription
from ...results.spots import freedom, radius, spot_at
from ...validation.quick_validation import WholeSolution, held_out
from ...validation.validation import Validation
from .options import ReportOptions


@dataclass(frozen=True)
class Subject(CalibrationDescription):
    """A calibration and what a report shows of it, beside what every view shows.

    Attributes
    ----------
    options : ReportOptions
    held_out : Validation
    nothing_held_out : str
        Why not; empty where something was.
    history : (number of stations, Forecast) or None
    plan : Plan or None
        The next best stations.
    rows : ReadingRows or None
        Of every reading; None without a recording.
    """

    calibration: Calibration
    options: ReportOptions
    held_out: Validation
    nothing_held_out: str
    history: tuple[IntArray, Forecast] | None
    plan: Plan | None
    rows: "ReadingRows | None"


class ReadingRows(NamedTuple):
    """One entry a reading that there is, rejected ones included, in the order of the stations.

    Attributes
    ----------
    recording : Recording
    station, beam : (N,) of int
        Rows and columns of the recording.
    reading : (N,)
        d [m].
    residual : (N,)
        [m]; NaN where it was rejected.
    standardized : (N,)
        Residual in its own standard deviation; NaN where it was rejected.
    incidence : (N,)
        Angle between beam and plane normal [rad]; NaN where there is no calibration.
    """

    recording: Recording
    station: IntArray
    beam: IntArray
    reading: FloatArray
    residual: FloatArray
    standardized: FloatArray
    incidence: FloatArray

    @property
    def used(self) -> BoolArray:
        """Which readings were used (N,)."""
        return np.asarray(~np.isnan(self.residual))


def subject_of(calibration: Calibration, options: ReportOptions) -> Subject:
    """Compute what a report shows.

    Raises
    ------
    InputError
        A working distance that the sensor cannot read.
    """
    tell("report")
    recording, rig = calibration.recording, options.rig
    judged = calibration.judged(rig.limits, options.reading)
    solved = calibration.status == "converged"
    plan, past = options.plan, None
    if solved and plan is None:
        plan = next_stations(calibration, rig.sensor, rig.workspace, rig.goal)
    if solved and math.isfinite(judged.reading):
        past = history(calibration, judged.reading)
    try:
        held, why = held_out(calibration), ""
    except SolverError as error:
        held, why = Validation(calibration, (), ()), str(error)
    rows = None if recording is None else _rows(calibration, recording)
    return Subject(calibration, judged, options, held, why, past, plan, rows)


def _rows(calibration: Calibration, recording: Recording) -> ReadingRows:
    d, fit = recording.ranges, calibration.fit
    station, beam = np.nonzero(~np.isnan(d))
    where = (recording, station, beam, d[station, beam], fit.residuals[station, beam])
    if calibration.status != "converged":
        nothing = np.full(len(station), np.nan)
        return ReadingRows(*where, nothing, nothing)
    at = calibration.parameters()
    v = np.einsum("nij,nj->ni", recording.world_R_hand[station], at.directions[beam])
    n = at.normals[recording.plane_of_station[station]]
    incidence = np.arccos(np.clip(np.abs((v * n).sum(axis=1)), 0.0, 1.0))
    return ReadingRows(*where, fit.standardized[station, beam], incidence)


def history(calibration: Calibration, reading: float) -> tuple[IntArray, Forecast] | None:
    """Return what was known after the first stations, at the noise estimated from all of them.

    Parameters
    ----------
    calibration : Calibration
    reading : float
        Working distance of the spots [m].

    Returns
    -------
    stations : (K,)
        How many, ascending, in the order of the recording; the last is all of them.
    known : Forecast
        The largest of all beams, (K,) each; NaN where something is still undetermined. None in place of
        both where `WholeSolution` refuses the calibration, or it has no covariance.
    """
    joint = calibration.covariance
    try:
        whole = WholeSolution(calibration)
    except SolverError:
        return None
    if joint is None:
        return None
    used = np.flatnonzero(~np.isnan(whole.recording.ranges).all(axis=1))
    # A curve through two dozen numbers of stations is smooth.
    counts = np.unique(np.linspace(1, len(used), 24).round().astype(np.intp))
    sigmas = np.full((len(counts), len(calibration.beams), 3), np.nan)
    for rows, count in zip(sigmas, counts.tolist(), strict=True):
        first = np.zeros(len(whole.recording.plane_labels), dtype=bool)
        first[used[:count]] = True
        try:
            _, known = whole.known_by(first)
        except (SolverError, InputError, GrazingBeamError):
            continue
        if len(known.beam_names) == len(calibration.beams):
            rows[:] = _known(calibration, known, reading)
    last = sigmas[-1].copy()
    stated = _known(calibration, joint, reading)
    sigmas *= np.divide(stated, last, out=np.ones_like(last), where=last > 0.0)
    location, direction, spots = sigmas.max(axis=1).T
    return counts, Forecast(location, direction, spots, reading)


def _known(calibration: Calibration, joint: JointCovariance, reading: float) -> FloatArray:
    """Return the largest sigma of a location [m], of a direction [rad], and the spot [m], (B, 3)."""
    dof, rows = freedom(calibration), []
    for name, S in zip(joint.beam_names, joint.all_beams(), strict=True):
        _, J, _ = spot_at(calibration, calibration.beams[name], reading)
        variances = S.diagonal()[:3].max(), np.linalg.eigvalsh(S[3:6, 3:6])[-1]
        rows.append((*np.sqrt(variances), radius(J @ S @ J.T, dof)))
    return np.array(rows, dtype=np.float64)
