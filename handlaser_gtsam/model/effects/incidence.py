"""A reading that errs with the incidence: by its squared tangent."""

from ...arrays import FloatArray
from ..equation import cosines
from .effect import Effect, SeenStations


def column(stations: SeenStations, _largest: float) -> FloatArray:
    """Return the derivatives (N,) by an error at an incidence of 45 degrees."""
    return stations.longer * (1.0 / cosines(stations.scene) ** 2 - 1.0)


INCIDENCE = Effect(
    code="incidence",
    of_readings=column,
    of_sensor={
        "triangulation": 0.015,
        "time-of-flight": 0.01,
        "confocal": 0.0005,
        "ultrasonic": 0.5,
        "other": 0.0,
    },
)
"""Triangulation: tilts of 30 degrees change a reading by 0.5 % of the measuring range (operating
instructions of the optoNCDT 1402, 1700 and 2300, "angle influences"). Ultrasound: within its
cone a sensor reads the distance d cos a to the nearest point, which for small angles a is 1 -
tan^2(a) / 2 times that along the beam. The others as their accuracy or linearity."""
