"""Whether anything changed between readings of one stop, as where a programme is run several times.

The error of the robot is common to all readings of a stop: the differences of their residuals from the
mean of the stop and the beam do not have it, and tell more of what changes with time than anything else
does. With e these differences, and A the same of the derivatives by the mount of a beam, the place of a
plane or by an offset of all beams in the rows from some station on, an F test asks whether A explains
e. Which of them it was is left to the tests of single stations, before anything is averaged.
"""

import numpy as np

from .. import model
from ..arrays import FloatArray, evenly
from ..data.recording import Recording
from ..data.screening import stops_of
from ..errors import CalibrationWarning
from ..model.distributions import SINGLE_LEVEL, f_sf, p_words
from ..model.effects.displaced import MOST_SPLITS
from ..quantities import FAR_SIGMAS, MEDIAN_TO_SIGMA, NEGLIGIBLE, TINY
from .calibration import Calibration
from .messages import warned


def changed_stops(
    result: Calibration, recording: Recording, still: tuple[float, float]
) -> CalibrationWarning | None:
    """Warn of the beam or plane whose readings of the same stops are others from some station on.

    Parameters
    ----------
    result : Calibration
        Of what was averaged.
    recording : Recording
        Before that.
    still : (float, float)
        Shift [m] and turn [rad] up to which poses are of one stop.
    """
    readings, at = recording.readings(), result.parameters()
    key = stops_of(recording, still)[readings.station] * readings.beams + readings.beam
    linear = model.linearize(model.scene(at, readings), readings.distance)
    rows = np.flatnonzero(np.bincount(key)[key] > 1)
    key, when = np.unique(key[rows], return_inverse=True)[1], readings.station[rows]
    count = np.bincount(key)

    def means(x: FloatArray) -> FloatArray:
        """Return columns (n, q) with the mean of each stop and beam in every row."""
        sums = np.stack([np.bincount(key, one) for one in x.T], axis=1)
        return np.asarray((sums / count[:, None])[key])

    e = linear.residual[rows, None]
    e, dof = (e - means(e))[:, 0], len(rows) - len(count)
    # Gross errors count as the largest that are usual.
    most = FAR_SIGMAS * MEDIAN_TO_SIGMA * float(np.median(np.abs(e)))
    e = np.clip(e, -most, most)
    lift = model.tangent_basis(at.directions)[readings.beam[rows]]
    across = np.einsum("ni,nij->nj", linear.direction[rows], lift)
    mount = np.hstack((linear.location[rows], across, linear.range_error[rows, :1]))
    suspects = [("all beams", np.ones(len(rows), dtype=bool), np.ones((len(rows), 1)))]
    for what, names, of, J in (
        ("beam", recording.beam_names, readings.beam[rows], mount),
        ("plane", recording.plane_names, readings.plane[rows], linear.offset[rows, None]),
    ):
        suspects += [(f"{what} {name}", of == i, means(J)) for i, name in enumerate(names)]
    total, tests, found = max(float(e @ e), TINY), 0, (1.0, "", 0)
    splits = np.unique(when)[1:]
    for split in splits[evenly(len(splits), MOST_SPLITS)].tolist():
        late = (when >= split)[:, None].astype(np.float64)
        late -= means(late)
        for target, own, J in suspects:
            A = (J * late)[own]
            A /= np.maximum(np.sqrt((A**2).sum(axis=0)), TINY)
            U, s, _ = np.linalg.svd(A, full_matrices=False)
            rank = int((s > NEGLIGIBLE).sum())
            if not 0 < rank < dof:
                continue
            tests += 1
            share = float(((U[:, :rank].T @ e[own]) ** 2).sum()) / total
            F = share / rank / max(1.0 - share, NEGLIGIBLE) * (dof - rank)
            found = min(found, (float(f_sf(F, rank, dof - rank)), target, split))
    p, target, split = found
    if not p * tests < SINGLE_LEVEL:
        return None
    values: dict[str, float | str] = {
        "target": target,
        "station": recording.station_names[split],
        "p": p,
    }
    return warned("changed-stops", values, likely=p_words(p, 1))
