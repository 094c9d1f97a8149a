"""How the uncertainty fell with the stations of a recording: the way to where a calibration is.

What some stations know is computed at the most probable scales of noise and range errors. The
calibration integrates over them, takes what the range errors of its beams have in common into account,
and counts noise that goes together in time; so the standard deviations of all stations at those scales
are not its own (up to a tenth off, in either direction). By what factor they differ at the end, beam by
beam, they are multiplied all along: the way ends where the calibration is.
"""

from dataclasses import dataclass

import numpy as np

from ..arrays import FloatArray, IntArray
from ..data.value import Value
from ..errors import GrazingBeamError, InputError, SolverError
from ..model.joint import JointCovariance
from ..results.calibration import Calibration
from ..results.spot_error import freedom, radius, spot_at
from ..validation.parts import WholeSolution
from .goal import Forecast

MOST = 24
"""Numbers of stations at which it is computed."""


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class History(Value):
    """What was known after so many stations, in the order of the recording.

    Attributes
    ----------
    stations : (K,)
        How many, ascending; the last is all of them.
    known : Forecast
        Of the beam that is known worst, (K,) each; NaN where something is undetermined still.
    """

    stations: IntArray
    known: Forecast


def history(calibration: Calibration, reading: float) -> History | None:
    """Return what the first stations would have told, at the noise found from all of them.

    Parameters
    ----------
    calibration : Calibration
    reading : float
        Working distance of the spots [m].

    Returns
    -------
    History or None
        None where `parts.WholeSolution.of` refuses the calibration, or it has no covariance.
    """
    try:
        whole = WholeSolution.of(calibration)
    except SolverError:
        return None
    joint = calibration.covariance
    if joint is None:
        return None
    used = np.flatnonzero(~np.isnan(whole.recording.ranges).all(axis=1))
    counts = np.unique(np.linspace(1, len(used), MOST).round().astype(np.intp))
    found = np.full((len(counts), len(calibration.beams), 3), np.nan)
    for rows, count in zip(found, counts.tolist(), strict=True):
        first = np.zeros(len(whole.recording.plane_labels), dtype=bool)
        first[used[:count]] = True
        try:
            part = whole.known_by(first)
        except (SolverError, InputError, GrazingBeamError):
            continue
        if len(part.recording.beam_names) == len(calibration.beams):
            rows[:] = _known(calibration, part.joint, reading)
    own, last = _known(calibration, joint, reading), found[-1].copy()
    found *= np.divide(own, last, out=np.ones_like(last), where=last > 0.0)
    location, direction, spots = found.max(axis=1).T
    return History(counts, Forecast(location, direction, spots, reading))


def _known(calibration: Calibration, joint: JointCovariance, reading: float) -> FloatArray:
    """Return the largest sigma of a location [m], of a direction [rad], and the spot [m], (B, 3)."""
    dof, found = freedom(calibration), []
    for name, S in zip(joint.beam_names, joint.all_beams(), strict=True):
        _, J, _ = spot_at(calibration, calibration.beams[name], reading)
        turn = np.linalg.eigvalsh(S[3:6, 3:6])[-1]
        found.append((np.sqrt(S.diagonal()[:3].max()), np.sqrt(turn), radius(J @ S @ J.T, dof)))
    known: FloatArray = np.array(found)
    return known
