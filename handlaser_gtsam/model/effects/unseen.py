"""Errors that no recording can show, because unknowns of the calibration are the same."""

from .effect import Effect

TILT = Effect(
    code="tilt",
    phrase="a range error of {size} at an incidence of 45 deg that changes its sign with the side",
    remedy="calibrate once more with the sensor turned by half a turn about its beam, and take the "
    "mean",
    reveal="calibrate once more with the sensor turned by half a turn about its beam",
    confounded="a location of the beam to the side",
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
    phrase="a range error proportional to 1/cos(incidence)",
    remedy="nothing is needed for the beams; measure the offset of a plane by other means if it "
    "matters",
    confounded="the offsets of the planes; it changes no beam",
)
TOOL_FRAME = Effect(
    code="tool-frame",
    phrase="an error of the tool frame",
    remedy="use the calibration with the tool frame of the recording only",
    confounded="the mount of the beams: both are one rigid motion",
)
RANGE_OFFSET = Effect(
    code="range-offset",
    phrase="a constant offset of the readings",
    remedy="use the location together with readings of the same sensor only: their sum is right",
    confounded="the location of the beam along itself",
)
