"""What a report is about, computed once: the calibration and everything that its parts show of it."""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ... import model
from ...arrays import BoolArray, FloatArray, IntArray
from ...data.recording import Recording
from ...errors import SolverError
from ...planning.advice import next_stations
from ...planning.goal import Forecast
from ...planning.route import Plan
from ...progress import tell
from ...results.calibration import Calibration
from ...results.description.description import Description
from ...validation.quick_validation import held_out
from ...validation.validation import Validation
from .history import history
from .options import ReportOptions


@dataclass(frozen=True)
class Subject(Description):
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
    spot : (N, 3)
        Laser spot, world frame [m]; NaN likewise.
    """

    recording: Recording
    station: IntArray
    beam: IntArray
    reading: FloatArray
    residual: FloatArray
    standardized: FloatArray
    incidence: FloatArray
    spot: FloatArray

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
    nothing = np.full(len(station), np.nan)
    where = (recording, station, beam, d[station, beam], fit.residuals[station, beam])
    z = fit.standardized[station, beam]
    if calibration.status != "converged":
        return ReadingRows(*where, nothing, nothing, np.full((len(station), 3), np.nan))
    at = calibration.parameters()
    R, t = recording.world_R_hand[station], recording.world_t_hand[station]
    v = np.einsum("nij,nj->ni", R, at.directions[beam])
    n = at.normals[recording.plane_of_station[station]]
    incidence = np.arccos(np.clip(np.abs((v * n).sum(axis=1)), 0.0, 1.0))
    g = model.corrected(d[station, beam], at.range_errors[beam])
    spot = np.einsum("nij,nj->ni", R, at.locations[beam]) + t + g[:, None] * v
    return ReadingRows(*where, z, incidence, spot)
