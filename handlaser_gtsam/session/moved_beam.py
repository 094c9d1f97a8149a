r"""Whether a beam has moved while planes came in, which one, and since when.

Near the present beams plane p, with itself fitted, knows of the beams x the information L_p and
h_p = L_p x_p. Over all planes, T = sum L_p and h = sum h_p, it is x = inv(T) h. If beam i has moved by
m as the planes A were measured, after some epoch, the score of m at x and its variance are

    s = h_A - L_A x,    M = L_A - L_A inv(T) L_A    (rows and columns of beam i),

and chi2 falls by s' M^+ s: chi-square distributed if nothing has moved, with as many degrees of freedom
as M has rank. Sums over A are differences of running totals, so that an epoch costs the same however
many planes there are. Every epoch and beam is a test; the smallest probability counts, times their
number.
"""

from collections.abc import Mapping
from itertools import accumulate

import numpy as np

from ..arrays import IntArray
from ..estimation.scale_mixture import parts_of
from ..estimation.survey_outliers import most_contradicted
from ..model.distributions import squares_sf
from ..model.families import BEAM, MOUNT_DIM
from ..quantities import KNOWN
from ..validation.other_recording import BeamDrift
from .config import SessionConfig
from .plane import FittedPlane

FALSE_ALARMS = 2e-5
"""Probability that a search finds a move where there is none; a session searches at every change."""


def moves(config: SessionConfig) -> IntArray:
    """Return which of the unknowns belong to the mount of each beam, (B, 5)."""
    unknowns = np.flatnonzero(config.mask)
    return np.flatnonzero(unknowns % BEAM.dim < MOUNT_DIM).reshape(-1, MOUNT_DIM)


def search(
    config: SessionConfig, planes: Mapping[str, FittedPlane], *, recently: bool = False
) -> BeamDrift | None:
    """Return the beam that has moved; None where there is no clear sign of it.

    Parameters
    ----------
    config : SessionConfig
    planes : mapping of str to FittedPlane
        In their order, all linearised at the same beams.
    recently : bool
        Whether to look at the epochs 1, 2, 4, ... planes ago only, until any of them shows a move.
    """
    count = len(planes)
    epochs = np.arange(1, count)  # numbers of planes before the move
    if recently:
        ago = 2 ** np.arange(count.bit_length())
        epochs = count - ago[ago < count]
    if not epochs.size:
        return None
    totals = list(accumulate(plane.information[0] for plane in planes.values()))
    matrix, vector, _ = parts_of(totals[-1])
    try:
        x = np.linalg.solve(matrix, vector)
        covariance = np.linalg.inv(matrix)
    except np.linalg.LinAlgError:
        return None
    L, s, _ = parts_of(totals[-1] - np.stack([totals[epoch - 1] for epoch in epochs.tolist()]))
    s = s - L @ x
    M = L - L @ covariance @ L
    beams = moves(config)
    values, axes = np.linalg.eigh(M[:, beams[:, :, None], beams[:, None, :]])
    along = np.einsum("ebji,ebj->ebi", axes, s[:, beams])
    keep = values > KNOWN**-2
    safe = np.where(keep, values, 1.0)
    rank = keep.sum(axis=2)
    statistic = np.where(keep, along**2 / safe, 0.0).sum(axis=2)
    p = np.where(rank > 0, squares_sf(statistic, np.maximum(rank, 1), config.sigma_dof), 1.0)
    best = np.unravel_index(most_contradicted(p.ravel(), statistic.ravel()), p.shape)
    p_value = min(float(p[best]) * p.size, 1.0)
    if p_value >= FALSE_ALARMS:
        return None
    if len(epochs) < count - 1:
        return search(config, planes)  # something has moved: look at every epoch
    d = axes[best] @ np.where(keep, along / safe, 0.0)[best] * config.unit[beams[best[1]]]
    return BeamDrift(
        config.names[best[1]],
        float(statistic[best]),
        p_value,
        d[:3],
        float(np.linalg.norm(d[3:])),
        list(planes)[int(epochs[best[0]])],
    )
