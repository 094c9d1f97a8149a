"""Systematic errors that the model does not hold, and the table of them all.

What `effects.toml` states, with words and plausible sizes, is named in every view and counted in the
verdict; a size that users may state instead is a field of `plausible.py`. What a recording can show has
its column in a file of its own, and is tested for; what none can, because unknowns of the calibration
are the same, is only counted.
"""

from collections.abc import Callable
from functools import partial

from ...arrays import FloatArray
from . import (
    beam_on_plane,
    displaced,
    drift,
    lag,
    sag,
    tool_displaced,
    translation_scale,
    turn_scale,
)
from .carry_over import column as carried_over
from .cubic import column as cubic
from .effect import STATED, Effect, Everywhere, OnPlanes, SeenStations
from .held_range_error import members as held
from .incidence import column as of_incidence

OF_READINGS = {"incidence": of_incidence, "cubic": cubic, "carry-over": carried_over}
"""Errors that a reading has by itself, whenever it is taken: columns (N,) for the stations and the
reading [m] at which the size is meant."""
TWISTS = {
    "lag": lag.twists,
    "tool-displaced": tool_displaced.twists,
    "turn-scale": turn_scale.twists,
    "translation-scale": translation_scale.twists,
}
"""Errors of the hand poses."""
BENDS = {"lag": lag.bends}
"""What moves the hands by the square of the size of such an error, on top."""


def _of_reading(
    column: Callable[[SeenStations, float], FloatArray], stations: SeenStations
) -> Everywhere:
    return Everywhere(column(stations, float(stations.readings.level.max()))[:, None])


def _of_poses(twists: Callable[[SeenStations], FloatArray], stations: SeenStations) -> Everywhere:
    return Everywhere(stations.by_poses(twists(stations)))


MEMBERS: dict[str, Callable[[SeenStations], Everywhere | OnPlanes]] = {
    **{code: partial(_of_reading, column) for code, column in OF_READINGS.items()},
    **{code: partial(_of_poses, twists) for code, twists in TWISTS.items()},
    "linear": lambda stations: held(stations, 0),
    "quadratic": lambda stations: held(stations, 1),
    "sag": sag.members,
    "drift": drift.members,
    "displaced": displaced.members,
    "tool-displaced": tool_displaced.members,  # in place of what follows from its twists
    "beam-on-plane": beam_on_plane.members,
}
"""Columns of all errors that a recording can show; some have a size for each beam or plane."""
EFFECTS = {
    code: Effect(
        code=code,
        members=MEMBERS.get(code),
        twists=TWISTS.get(code),
        bends=BENDS.get(code),
        **stated,
    )
    for code, stated in STATED.items()
}
"""All systematic errors by their codes."""
OF_STATIONS = (*OF_READINGS, "sag", "turn-scale", "translation-scale")
"""Errors that a station has by itself, whenever and after whatever other station it is measured. A lag
depends on the station before and after, a drift and what is displaced on all stations up to the last
one, and a new plate brings biases of its own."""


def may_also_be(codes: tuple[str, ...]) -> str:
    """Say which other errors the readings do not tell from one that was found."""
    return f"it may also be {' or '.join(EFFECTS[code].without_size() for code in codes)}"


__all__ = ["EFFECTS", "OF_READINGS", "OF_STATIONS", "Effect", "may_also_be"]
