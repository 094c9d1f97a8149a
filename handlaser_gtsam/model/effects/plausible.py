"""How large systematic errors may plausibly be: what is stated, else what `effects.toml` has.

Sizes of a sensor are parts of its measuring range: the one stated, else the largest reading. Sizes of
plates, robots and converters do not depend on the sensor. All are half widths: the error is no larger.
"""

from dataclasses import dataclass, fields

from ...checks import require_number
from ...quantities import LARGEST_LENGTH
from . import EFFECTS

KINDS = tuple(EFFECTS["incidence"].of_sensor)
"""Kinds of sensors; of an `other` kind nothing is plausible."""


@dataclass(frozen=True, slots=True)
class Plausible:
    """Largest plausible sizes of systematic errors; None where the kind of sensor is to say.

    Attributes
    ----------
    incidence, tilt : float, optional
        Of a reading at an incidence of 45 degrees, growing with the squared tangent, and with the
        tangent to one side [m].
    linear, quadratic, cubic : float, optional
        Of the largest reading, growing with its first, second and third power [m]; the first two
        where the model has no such range error.
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
    linear: float | None = None
    quadratic: float | None = None
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
        for code, name in CODES.items():
            size = getattr(self, name)
            if size is not None:
                require_number(name, size, 0.0, LARGEST_LENGTH, unit=EFFECTS[code].unit)


CODES = {field.name.replace("_", "-"): field.name for field in fields(Plausible)}
"""The field of `Plausible` by the code of a systematic error."""


FIELDS = {
    code: f"{name}_mm" if EFFECTS[code].unit == "m" else f"{name}_percent"
    for code, name in CODES.items()
}
"""The field of the table [plausible] of a rig file by the code of a systematic error."""


def how_to_state(code: str) -> str:
    """Return which fields of a rig file state the plausible size of a systematic error."""
    field = f"{FIELDS[code]} in [plausible]"
    kinds = [f'"{kind}"' for kind, part in EFFECTS[code].of_sensor.items() if part > 0.0]
    return f"kind in [sensor], as kind = {' or '.join(kinds)}, or {field}" if kinds else field


def plausible_sizes(
    kind: str | None, stated: Plausible, measuring_range: float
) -> dict[str, float]:
    """Return the plausible size [m, or a part] by code of a systematic error.

    A stated size comes first; nothing else is known where no kind is stated.
    """
    sizes = {}
    for code, name in CODES.items():
        size = getattr(stated, name)
        if size is None and kind is not None:
            size = EFFECTS[code].plausible(kind, measuring_range)
        if size is not None:
            sizes[code] = size
    return sizes
