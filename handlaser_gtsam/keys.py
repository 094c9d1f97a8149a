"""How this package spells its GTSAM variables.

`r` Point3 location of a beam, `v` Unit3 direction, `k` Vector1 or Vector2 range error,
`p` OrientedPlane3, `x` Pose3 hand pose. Graphs of your own may use any other keys.
"""

from dataclasses import dataclass

import gtsam

from .errors import InputError


@dataclass(frozen=True, slots=True)
class BeamKeys:
    """The variables of one beam.

    Attributes
    ----------
    location : int
        Key of a Point3: a point on the beam where the range is zero, hand frame, metres.
    direction : int
        Key of a Unit3: where the beam points, hand frame.
    range_error : int, optional
        Key of a vector (k1,) or (k1, k2), units 1 and 1/m. None: the readings are taken as true.

    Raises
    ------
    InputError
        Keys that are no integers, or the same key twice.
    """

    location: int
    direction: int
    range_error: int | None = None

    def __post_init__(self) -> None:
        keys = [self.location, self.direction]
        keys += [] if self.range_error is None else [self.range_error]
        if not all(isinstance(key, int) for key in keys) or len(set(keys)) < len(keys):
            raise InputError(f"keys {keys}", "different integers: gtsam.symbol('l', 0), ...")


def beam_keys(index: int, terms: int) -> BeamKeys:
    """Return the keys of beam `index`; `terms` range-error terms (0, 1 or 2)."""
    return BeamKeys(
        gtsam.symbol("r", index),
        gtsam.symbol("v", index),
        gtsam.symbol("k", index) if terms else None,
    )


def plane_key(index: int) -> int:
    """Return the key of plane `index`."""
    return gtsam.symbol("p", index)


def pose_key(index: int) -> int:
    """Return the key of the hand pose of station `index`."""
    return gtsam.symbol("x", index)
