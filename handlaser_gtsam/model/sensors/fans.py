"""Where the rays of a sensor are in its own frame."""

from dataclasses import dataclass

from ...arrays import FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Rayset:
    """Rays in the frame of their sensor, one a reading.

    Attributes
    ----------
    origin, direction : (n, 3)
        [m], unit vectors.
    origin_by_scale, direction_by_scale : (n, 3)
        Their derivatives by the scale of what tells the rays apart.
    """

    origin: FloatArray
    direction: FloatArray
    origin_by_scale: FloatArray
    direction_by_scale: FloatArray
