"""How large systematic errors may plausibly be, by kind of sensor: what no residual may show.

Sizes of a sensor are parts of its measuring range: the one stated, else the largest reading. Sizes of
plates, robots and converters do not depend on the sensor. All are half widths: the error is no larger.

triangulation
    Tilts of 30 degrees change a reading by 0.5 % of the measuring range (operating instructions of
    the optoNCDT 1402, 1700 and 2300, "angle influences"): 1.5 % at 45 degrees where that grows with
    the squared tangent, and 0.87 % where it grows with the tangent and has its sign. Linearity
    0.2 %, and 0.03 % a kelvin (data sheet of the optoNCDT 1402) over a warm-up by 10 K. Colours err
    as linearity does.
time-of-flight
    10 mm, of a measuring range of 1 m or so: the accuracy of the SICK DT35 (data sheet).
confocal
    0.05 %, as the linearity of the confocalDT IFS2405 (data sheet); its errors with tilt are as large.
ultrasonic
    Linearity 1 % (data sheet of the Omron E4PA). The speed of sound changes by 0.17 % a kelvin:
    1.7 % of a reading over 10 K. Within its cone a sensor reads the distance d cos a to the nearest
    point, which for small angles a is 1 - tan^2(a) / 2 times that along the beam.
plate
    A machined face of up to 300 mm is flat to 0.2 mm (ISO 2768-2, class H); held by hand-tightened
    clamps it moves by up to 1 mm.
robot
    Lengths are wrong by up to 0.65 mm over a metre (Slamani, Nubiola and Bonev, Industrial Robot 2012,
    for a six-axis arm): 0.1 %. Turns likewise. A reading is taken up to a tenth of a step before or
    after its pose.
converter
    The sampling capacitor brings C / (C + C_input) of the channel before along: 2 % for 20 pF at an
    input of 1 nF (Microchip, "Channel to channel crosstalk and error").
"""

from dataclasses import dataclass, fields

from ..checks import require_number

PARTS = ("carry_over", "lag", "turn_scale", "translation_scale")
"""Sizes that are no lengths."""
LARGEST_SIZE = 1e3
"""No plausible size is larger [m, or as a part]: it would be a wrong unit."""


@dataclass(frozen=True, slots=True)
class Plausible:
    """Largest plausible sizes of systematic errors; None where the kind of sensor is to say.

    Attributes
    ----------
    incidence, tilt : float, optional
        Of a reading at an incidence of 45 degrees, growing with the squared tangent, and with the
        tangent to one side [m].
    cubic : float, optional
        Of the largest reading, growing with its third power [m].
    drift : float, optional
        Of readings over the recording [m].
    carry_over : float, optional
        Part of the channel before that a channel of one converter keeps.
    beam_on_plane : float, optional
        Of one beam before one plate, as by its colour [m].
    sag, displaced : float, optional
        Of a plate, from the middle to its edge, and as a whole while recording [m].
    tool_displaced : float, optional
        Of the tool frame, or of the sensors on the hand, while recording [m].
    lag : float, optional
        Between poses and readings, as a part of the step to the next station.
    turn_scale, translation_scale : float, optional
        Of the robot's turns and lengths, as parts of them.
    """

    incidence: float | None = None
    tilt: float | None = None
    cubic: float | None = None
    drift: float | None = None
    carry_over: float | None = None
    beam_on_plane: float | None = None
    sag: float | None = None
    displaced: float | None = None
    tool_displaced: float | None = None
    lag: float | None = None
    turn_scale: float | None = None
    translation_scale: float | None = None

    def __post_init__(self) -> None:
        for size in fields(self):
            if getattr(self, size.name) is not None:
                unit = "1" if size.name in PARTS else "m"
                require_number(size.name, getattr(self, size.name), 0.0, LARGEST_SIZE, unit=unit)


CELL = Plausible(
    carry_over=0.02,
    sag=2e-4,
    displaced=1e-3,
    tool_displaced=2.5e-4,
    lag=0.1,
    turn_scale=1e-3,
    translation_scale=1e-3,
)
"""Plausible sizes of converters, plates and robots, whatever the sensor."""
KINDS = {
    "triangulation": Plausible(0.015, 0.0087, 0.002, 0.003, beam_on_plane=0.002),
    "time-of-flight": Plausible(0.01, 0.01, 0.01, 0.01, beam_on_plane=0.01),
    "confocal": Plausible(0.0005, 0.0005, 0.0005, 0.0005, beam_on_plane=0.0005),
    "ultrasonic": Plausible(0.5, 0.01, 0.01, 0.017, beam_on_plane=0.01),
    "other": Plausible(0.0, 0.0, 0.0, 0.0, beam_on_plane=0.0),
}
"""Plausible sizes of a sensor, as parts of its measuring range; none of an `other` kind."""


def plausible_sizes(
    kind: str | None, stated: Plausible, measuring_range: float
) -> dict[str, float]:
    """Return the plausible size [m, or a part] by code of a systematic error.

    A stated size comes first; nothing else is known where no kind is stated.
    """
    sizes = {}
    for error in fields(Plausible):
        size = getattr(stated, error.name)
        if size is None and kind is not None:
            size = getattr(CELL, error.name)
            if size is None:
                size = getattr(KINDS[kind], error.name) * measuring_range
        if size is not None:
            sizes[error.name.replace("_", "-")] = size
    return sizes
