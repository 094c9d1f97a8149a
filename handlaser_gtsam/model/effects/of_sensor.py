"""Systematic errors of the sensors: by incidence, range, time, plane and channel."""

import numpy as np

from ...arrays import FloatArray
from ..equation import cosines
from .effect import Effect, Everywhere, OnPlanes, SeenStations

WARMING = 8.0
"""A sensor that warms up does so within an eighth of the recording: a few minutes of half an hour."""


def _incidence(stations: SeenStations, _largest: float) -> FloatArray:
    """Return the derivatives (N,) by an error at an incidence of 45 degrees."""
    return stations.longer * (1.0 / cosines(stations.scene) ** 2 - 1.0)


INCIDENCE = Effect(
    code="incidence",
    phrase="a range error of {size} at an incidence of 45 deg that grows with its squared tangent",
    remedy="measure at smaller angles of incidence, or give the sensor's largest incidence",
    reveal="add stations at 50 to 60 deg of incidence, where the sensor reads there",
    of_readings=_incidence,
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


def _cubic(stations: SeenStations, largest: float) -> FloatArray:
    """Return the derivatives (N,) by the error of the `largest` reading [m], the next term of g."""
    return stations.longer * (stations.readings.level / largest) ** 3


CUBIC = Effect(
    code="cubic",
    phrase="a third-order range error of {size} at the largest reading",
    remedy="measure over a shorter span of ranges around the working distance, or linearise the "
    "sensor",
    reveal="add stations over the whole span of ranges at the same angles of incidence",
    of_readings=_cubic,
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


def _drift(stations: SeenStations) -> Everywhere:
    """Return the derivatives (N, 2) by a steady drift, and by the drift of a sensor that warms up."""
    steady = stations.longer * (stations.time - 0.5)
    warming = -stations.longer * np.exp(-WARMING * stations.time)
    return Everywhere(np.stack((steady, warming), axis=1), parts=("steady", "warming up"))


DRIFT = Effect(
    code="drift",
    phrase="a drift of the readings by {size} over the recording",
    remedy="let the sensor warm up, and record in a shorter time",
    reveal="repeat the first stations at the end",
    members=_drift,
    of_sensor={
        "triangulation": 0.003,
        "time-of-flight": 0.01,
        "confocal": 0.0005,
        "ultrasonic": 0.017,
        "other": 0.0,
    },
)
"""Over a warm-up by 10 K. Triangulation: 0.03 % a kelvin (data sheet of the optoNCDT 1402).
Ultrasound: the speed of sound changes by 0.17 % a kelvin. The others as their accuracy."""


def _beam_on_plane(stations: SeenStations) -> OnPlanes:
    """Return the bias of every beam on every plane, as by its colour: its readings there are too long.

    A beam has no such bias where it sees no other plane, or where no other beam sees the plane: that
    bias is then the location of the beam along itself, or the offset of the plane.
    """
    readings = stations.readings
    first = np.full((readings.planes, readings.beams), np.iinfo(np.intp).max)
    np.minimum.at(first, (readings.plane, readings.beam), stations.position)
    seen = first < np.iinfo(np.intp).max
    plane, beam = np.nonzero(seen & (seen.sum(axis=0) > 1) & (seen.sum(axis=1) > 1)[:, None])
    return OnPlanes(stations.longer, plane, beam, first[plane, beam])


BEAM_ON_PLANE = Effect(
    code="beam-on-plane",
    phrase="a bias of {size} of {subject}",
    remedy="check the surface of that plane under the beam, or remove these readings",
    reveal="add a plane of the same surface",
    confounded="the offset of the plane or the location of the beam: it takes two beams that see the "
    "same two planes",
    anywhere="one beam on one plane",
    members=_beam_on_plane,
    of_sensor=CUBIC.of_sensor,
)
"""Colours err as linearity does."""


def _carry_over(stations: SeenStations, _largest: float) -> FloatArray:
    """Return the derivatives (N,) by the part of the channel before that each channel keeps.

    Before the first channel comes the last. They are zero where the channel before has no reading at
    the station. Predicted readings are carried over, not the recorded ones: two readings of a station
    differ by errors of the pose as well, which the residuals hold, too, and most of the little that the
    unknowns do not explain of the difference would be these errors.
    """
    readings, expected, station = stations.readings, stations.expected, stations.first[1]
    order = np.argsort(stations.channel)
    channel_before = np.empty_like(order)
    channel_before[order] = np.roll(order, 1)
    table = np.full((int(station.max()) + 1, readings.beams), np.nan)
    table[station, readings.beam] = expected
    before = table[station, channel_before[readings.beam]]
    return stations.longer * np.nan_to_num(before - expected)


CARRY_OVER = Effect(
    code="carry-over",
    phrase="a carry-over of {size} from one channel to the next",
    remedy="sample slower, put a buffer before the converter, or use a converter for each sensor",
    reveal="cover one sensor while another reads a fixed distance; state carry_over_percent = 0 in "
    "the rig file's [plausible] where every sensor has a converter of its own",
    unit="1",
    of_readings=_carry_over,
    least_beams=2,
    of_cell=0.02,
)
"""The sampling capacitor brings C / (C + C_input) of the channel before along: 2 % for 20 pF at an
input of 1 nF (Microchip, "Channel to channel crosstalk and error")."""
