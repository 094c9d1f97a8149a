"""The variables of beams and planes in somebody else's graph."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import gtsam
import numpy as np

from ..errors import InputError
from ..keys import BeamKeys


@dataclass(frozen=True, slots=True)
class Kind:
    """A kind of variable: how it is read, its type in words, and its natural units.

    The units are powers of the typical range.
    """

    words: str
    read: Callable[[gtsam.Values, int], object]
    expected: str
    powers: tuple[int, ...]


LOCATION = Kind("location of beam", gtsam.Values.atPoint3, "Point3", (1, 1, 1))
DIRECTION = Kind("direction of beam", gtsam.Values.atUnit3, "Unit3", (0, 0))
RANGE_ERROR = Kind(
    "range error of beam", gtsam.Values.atVector, "vector (k1,) or (k1, k2)", (0, -1)
)
PLANE = Kind("plane", gtsam.Values.atOrientedPlane3, "OrientedPlane3", (0, 0, 1))


@dataclass(frozen=True, slots=True)
class Variable:
    """A variable that is read: what it is, its key, and its columns among all that are read."""

    kind: Kind
    name: str
    key: int
    columns: slice

    @property
    def words(self) -> str:
        """What it is, with its name."""
        return f"{self.kind.words} {self.name}"

    @property
    def powers(self) -> tuple[int, ...]:
        """Natural units of its columns."""
        return self.kind.powers[: self.columns.stop - self.columns.start]


def variables_of(
    graph: gtsam.NonlinearFactorGraph,
    values: gtsam.Values,
    beams: Mapping[str, BeamKeys],
    planes: Mapping[str, int],
) -> list[Variable]:
    """Return the variables to be read, each once."""
    if not beams:
        raise InputError("no beams", "a name and BeamKeys for each")
    inside = set(graph.keyVector())
    for key in inside:
        if not values.exists(key):
            raise InputError(f"no value of {key_name(key)}", "one for every variable of the graph")
    asked: list[tuple[Kind, str, int]] = []
    for name, beam in beams.items():
        asked += [(LOCATION, name, beam.location), (DIRECTION, name, beam.direction)]
        if beam.range_error is not None:
            asked.append((RANGE_ERROR, name, beam.range_error))
    asked += [(PLANE, name, key) for name, key in planes.items()]
    found: dict[int, Variable] = {}
    first = 0
    for kind, name, key in asked:
        if key not in inside:
            words = f"{kind.words} {name} under {key_name(key)}"
            raise InputError(words, "a variable of the graph")
        dim = _dimension(values, kind, name, key)
        if key not in found:
            found[key] = Variable(kind, name, key, slice(first, first + dim))
            first += dim
    return list(found.values())


def _dimension(values: gtsam.Values, kind: Kind, name: str, key: int) -> int:
    """Return the dimension of a variable; raises InputError where it is of another type."""
    try:
        value = kind.read(values, key)
    except RuntimeError as error:
        found = f"another type under {key_name(key)}, {kind.words} {name}"
        raise InputError(found, f"a {kind.expected}") from error
    dim = np.asarray(value).size if kind is RANGE_ERROR else len(kind.powers)
    if not 1 <= dim <= len(kind.powers):
        raise InputError(f"{dim} numbers as {kind.words} {name}", f"a {kind.expected}")
    return dim


def key_name(key: int) -> str:
    """Return a key as people write it: x3, or the number."""
    return str(gtsam.DefaultKeyFormatter(key))
