"""A range error of first or second order, of one beam or all, where the model holds it at zero."""

import numpy as np

from .effect import Everywhere, SeenStations

BEAMS_ALONE = 16
"""Beams that are tested one by one, at most, because each has a column of all readings; more are only
tested for an error that all have alike."""


def members(stations: SeenStations, term: int) -> Everywhere:
    """Return the derivatives by the error of the largest reading, of all beams and of each one."""
    readings, held = stations.readings, stations.held[:, term]
    column = stations.longer * (readings.level / readings.level.max()) ** (1 + term)
    beams = np.flatnonzero(held)
    if len(beams) > BEAMS_ALONE:
        return Everywhere((column * held[readings.beam])[:, None])
    together = np.ones((len(beams), int(len(beams) > 1)))
    return Everywhere(
        column[:, None] * (readings.beam[:, None] == beams),
        mix=np.hstack((np.eye(len(beams)), together)),
        beam=np.append(beams, np.full(together.shape[1], -1)),
    )
