"""How the uncertainty fell with the stations of a recording, up to what the calibration states.

The first stations are judged at the most probable scales of noise and range errors. The calibration
integrates over these scales, takes what the range errors of its beams have in common into account, and
counts noise that is correlated in time; so its standard deviations differ by up to a tenth from what
all stations give at these scales. All are multiplied by that factor, beam by beam, so that the last are
the calibration's.
"""

import numpy as np

from ...arrays import FloatArray, IntArray
from ...errors import GrazingBeamError, InputError, SolverError
from ...model.joint import JointCovariance
from ...planning.goal import Forecast
from ...results.calibration import Calibration
from ...results.spots import freedom, radius, spot_at
from ...validation.quick_validation import WholeSolution


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
        both where `WholeSolution.of` refuses the calibration, or it has no covariance.
    """
    joint = calibration.covariance
    try:
        whole = WholeSolution.of(calibration)
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
