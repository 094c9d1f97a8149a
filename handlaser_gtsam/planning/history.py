"""How the uncertainty fell with the stations of a recording: the way to where a calibration is."""

from dataclasses import dataclass

import numpy as np

from ..arrays import FloatArray, IntArray
from ..data.value import Value
from ..errors import GrazingBeamError, InputError, SolverError
from ..results.calibration import Calibration
from ..results.spot_error import freedom, radius, spot_at
from ..validation.parts import Part, Whole
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
        None where `parts.Whole.of` refuses the calibration.
    """
    try:
        whole = Whole.of(calibration)
    except SolverError:
        return None
    used = np.flatnonzero(~np.isnan(whole.recording.ranges).all(axis=1))
    counts = np.unique(np.linspace(1, len(used), MOST).round().astype(np.intp))
    rows = np.full((len(counts), 3), np.nan)
    for row, count in zip(rows, counts.tolist(), strict=True):
        first = np.zeros(len(whole.recording.plane_labels), dtype=bool)
        first[used[:count]] = True
        try:
            part = whole.known_by(first)
        except (SolverError, InputError, GrazingBeamError):
            continue
        if len(part.recording.beam_names) == len(calibration.beams):
            row[:] = _known(calibration, part, reading)
    location, direction, spots = rows.T
    return History(counts, Forecast(location, direction, spots, reading))


def _known(calibration: Calibration, part: Part, reading: float) -> FloatArray:
    """Return the largest sigma of a location [m], of a direction [rad], and the largest spot [m]."""
    dof, found = freedom(calibration), []
    for name, S in zip(part.joint.beam_names, part.joint.all_beams(), strict=True):
        _, J, _ = spot_at(calibration, calibration.beams[name], reading)
        turn = np.linalg.eigvalsh(S[3:6, 3:6])[-1]
        found.append((np.sqrt(S.diagonal()[:3].max()), np.sqrt(turn), radius(J @ S @ J.T, dof)))
    most: FloatArray = np.max(found, axis=0)
    return most
