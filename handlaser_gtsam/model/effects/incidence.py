"""A reading that errs with the incidence: by its squared tangent."""

from ...arrays import FloatArray
from ..equation import cosines
from .effect import SeenStations


def column(stations: SeenStations, _largest: float) -> FloatArray:
    """Return the derivatives (N,) by an error at an incidence of 45 degrees."""
    return stations.longer * (1.0 / cosines(stations.scene) ** 2 - 1.0)
