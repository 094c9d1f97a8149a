"""A range error of third order: a function of the reading itself, the next term of g."""

from ...arrays import FloatArray
from .effect import Effect, SeenStations


def column(stations: SeenStations, largest: float) -> FloatArray:
    """Return the derivatives (N,) by the error of the `largest` reading [m]."""
    return stations.longer * (stations.readings.level / largest) ** 3


CUBIC = Effect(
    code="cubic",
    of_readings=column,
    power=3,
    of_sensor={
        "triangulation": 0.002,
        "time-of-flight": 0.01,
        "confocal": 0.0005,
        "ultrasonic": 0.01,
        "other": 0.0,
    },
)
"""Linearities: data sheets of the optoNCDT 1402, the SICK DT35 (10 mm, of a measuring range of 1 m
or so), the confocalDT IFS2405 and the Omron E4PA."""
