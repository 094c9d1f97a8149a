"""Errors that no recording can show, because unknowns of the calibration are the same."""

from .effect import Effect

TILT = Effect(
    code="tilt",
    across=True,
    of_sensor={
        "triangulation": 0.0087,
        "time-of-flight": 0.01,
        "confocal": 0.0005,
        "ultrasonic": 0.01,
        "other": 0.0,
    },
)
"""Readings that err by size times tan(tilt): with dr across the beam a plane that is tilted by the
angle a towards dr is met |dr| tan a earlier. Triangulation: as `incidence`, where that grows
with the tangent and has its sign."""
INVERSE_COSINE = Effect(
    code="inverse-cosine",
)
TOOL_FRAME = Effect(
    code="tool-frame",
)
RANGE_OFFSET = Effect(
    code="range-offset",
)
