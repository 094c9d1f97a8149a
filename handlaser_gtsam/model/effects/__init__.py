"""Systematic errors that the model does not hold, one a file, and the list of them all.

What is added here is counted with its plausible size in the verdict, and named in every view. What a
recording can show is tested for; what none can (`unseen`) is only counted.
"""

from .beam_on_plane import BEAM_ON_PLANE
from .carry_over import CARRY_OVER
from .cubic import CUBIC
from .displaced import DISPLACED
from .drift import DRIFT
from .effect import Effect
from .incidence import INCIDENCE
from .lag import LAG
from .sag import SAG
from .tool_displaced import TOOL_DISPLACED
from .translation_scale import TRANSLATION_SCALE
from .turn_scale import TURN_SCALE
from .unseen import INVERSE_COSINE, RANGE_OFFSET, TILT, TOOL_FRAME

EFFECTS = {
    effect.code: effect
    for effect in (
        INCIDENCE,
        CUBIC,
        SAG,
        LAG,
        DRIFT,
        DISPLACED,
        TOOL_DISPLACED,
        BEAM_ON_PLANE,
        TURN_SCALE,
        TRANSLATION_SCALE,
        CARRY_OVER,
        TILT,
        INVERSE_COSINE,
        TOOL_FRAME,
        RANGE_OFFSET,
    )
}
"""All systematic errors by their codes."""
OF_READINGS = {
    code: effect.of_readings for code, effect in EFFECTS.items() if effect.of_readings is not None
}
"""Columns of the errors that a reading has by itself, whenever it is taken."""
OF_STATIONS = (*OF_READINGS, SAG.code, TURN_SCALE.code, TRANSLATION_SCALE.code)
"""Errors that a station has by itself, whenever and after whatever other station it is measured. A lag
goes by the station before and after; the unknowns of a drift and of what is displaced by all stations
up to the last one; and a new plate brings biases of its own."""


def may_also_be(codes: tuple[str, ...]) -> str:
    """Say which other errors the readings do not tell from one that was found."""
    return f"it may also be {' or '.join(EFFECTS[code].without_size() for code in codes)}"


__all__ = ["EFFECTS", "OF_READINGS", "OF_STATIONS", "Effect", "may_also_be"]
