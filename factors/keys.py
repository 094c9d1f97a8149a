"""How this package spells its GTSAM variables.

`r` Point3 location of a beam, `v` Unit3 direction, `k` Vector1 or Vector2 range error,
`p` OrientedPlane3, `x` Pose3 hand pose. Graphs of your own may use any other keys.
"""

from dataclasses import dataclass
from numbers import Integral

import gtsam

from handlaser_gtsam.errors import InputError

EXAMPLE = "gtsam.symbol('l', 0), ..."


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
        Key of the vector of one or two range errors [1, 1/m]. None: the readings are taken as true.

    Raises
    ------
    InputError
        Keys that are no integers, or the same key twice.
    """

    location: int
    direction: int
    range_error: int | None = None

    def __post_init__(self) -> None:
        for name in ("location", "direction", "range_error"):
            key = getattr(self, name)
            if name != "range_error" or key is not None:
                object.__setattr__(self, name, integer_key(key, name.replace("_", " ")))
        if len(set(self.variables)) < len(self.variables):
            given = f"keys {list(self.variables)} of one beam"
            raise InputError(given, f"different integers: {EXAMPLE}")

    @property
    def variables(self) -> tuple[int, ...]:
        """Keys of location, direction and, if it is estimated, range error."""
        if self.range_error is None:
            return self.location, self.direction
        return self.location, self.direction, self.range_error


def integer_key(key: object, of: str) -> int:
    """Return a key as an integer that GTSAM takes; raises InputError where it is none."""
    if isinstance(key, bool) or not isinstance(key, Integral) or not 0 <= int(key) < 2**64:
        raise InputError(f"{key!r} as the key of a {of}", f"an integer: {EXAMPLE}")
    return int(key)


def require_beam(name: str, beam: object) -> None:
    """Refuse what is no BeamKeys; raises InputError."""
    if not isinstance(beam, BeamKeys):
        given = f"{type(beam).__name__} as {name}"
        raise InputError(given, "BeamKeys(location=..., direction=...)")


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
