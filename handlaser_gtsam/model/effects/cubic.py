"""A range error of third order: a function of the reading itself, the next term of g."""

from ...arrays import FloatArray
from .effect import SeenStations


def column(stations: SeenStations, largest: float) -> FloatArray:
    """Return the derivatives (N,) by the error of the `largest` reading [m]."""
    return stations.longer * (stations.readings.level / largest) ** 3
