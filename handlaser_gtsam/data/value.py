"""Values: frozen dataclasses that hold arrays, and compare, pickle and print as wholes.

`==` of a dataclass with arrays raises, a mapping proxy in one cannot be pickled, a copied array can be
written to again, and the representation lists every number. A subclass of `Value` needs no method
against that; its decorator switches off the methods of the dataclass:

    @dataclass(frozen=True, slots=True, eq=False, repr=False)
    class Beam(Value): ...
"""

from collections.abc import Mapping, Sequence
from dataclasses import MISSING, Field
from itertools import chain
from types import MappingProxyType
from typing import Any, ClassVar

import numpy as np

from ..arrays import BoolArray, IntArray
from ..text import SHOWN_CHARACTERS

SHOWN_ENTRIES = 8
"""Arrays and tuples with more entries are represented by their size, or a line gets too long; of a
mapping no more keys are listed."""

PLAIN = frozenset((float, int, bool, str, type(None)))
"""Types of which nobody can change a value."""


class Value:
    """Base of frozen dataclasses with arrays.

    Two values are equal if they are of one class and all their fields are equal: arrays in shape and
    every entry, mappings in the order of their names too, and NaN is equal to NaN. Private fields do
    not count, and are not shown. Values have no hash, like arrays. Arrays and mappings in them are
    read-only, in copies and after unpickling as well;
    building a value copies no array, so that who keeps a writable one must not write to it.
    """

    __slots__ = ()
    __dataclass_fields__: ClassVar[dict[str, Field[object]]]

    def __post_init__(self) -> None:
        for name in self.__dataclass_fields__:
            value = getattr(self, name)
            if type(value) not in PLAIN:
                object.__setattr__(self, name, _read_only(value))

    def __eq__(self, other: object) -> bool:
        if type(other) is not type(self):
            return NotImplemented
        names = [name for name in self.__dataclass_fields__ if not name.startswith("_")]
        return all(same(getattr(self, name), getattr(other, name)) for name in names)

    def __reduce__(self) -> tuple[object, ...]:
        """Rebuild from the fields, without the checks that they have passed already."""
        values = [getattr(self, name) for name in self.__dataclass_fields__]
        # A mapping proxy cannot be pickled.
        return _rebuilt, (
            type(self),
            [dict(value) if isinstance(value, MappingProxyType) else value for value in values],
        )

    def __repr__(self) -> str:
        parts = []
        for name, field in self.__dataclass_fields__.items():
            value = getattr(self, name)
            default = field.default is not MISSING and same(value, field.default)
            if not (name.startswith("_") or default):
                parts.append(f"{name}={_short(value)}")
        return f"{type(self).__name__}({', '.join(parts)})"


def fields_at(of: Value, rows: IntArray | BoolArray, *names: str) -> dict[str, Any]:
    """Return some fields, arrays or tuples of texts with an entry a row, at some rows or by a mask.

    None stays None.
    """
    found: dict[str, Any] = {}
    for name in names:
        column = getattr(of, name)
        if isinstance(column, tuple):
            found[name] = tuple(np.array(column, dtype=object)[rows].tolist())
        else:
            found[name] = None if column is None else column[rows]
    return found


def fields_joined(values: Sequence[Value], *names: str) -> dict[str, Any]:
    """Return some fields, arrays or tuples with an entry a row, of several values one after another."""
    found: dict[str, Any] = {}
    for name in names:
        columns = [getattr(of, name) for of in values]
        whole = isinstance(columns[0], tuple)
        found[name] = tuple(chain.from_iterable(columns)) if whole else np.concatenate(columns)
    return found


def same(a: object, b: object) -> bool:
    """Tell whether two fields of values are equal; NaN is equal to NaN."""
    if isinstance(a, np.ndarray) or isinstance(b, np.ndarray):
        if not (isinstance(a, np.ndarray) and isinstance(b, np.ndarray) and a.shape == b.shape):
            return False
        return bool(((a == b) | ((a != a) & (b != b))).all())
    if isinstance(a, Mapping) and isinstance(b, Mapping):
        return list(a) == list(b) and same(tuple(a.values()), tuple(b.values()))
    if isinstance(a, tuple) and isinstance(b, tuple):
        return len(a) == len(b) and all(map(same, a, b))
    return bool(a == b or (a != a and b != b))


def _rebuilt(kind: type[Value], fields: list[object]) -> Value:
    rebuilt = object.__new__(kind)
    for name, value in zip(kind.__dataclass_fields__, fields, strict=True):
        object.__setattr__(rebuilt, name, _read_only(value))
    return rebuilt


def _read_only(value: object) -> object:
    if isinstance(value, np.ndarray):
        if value.flags.writeable:
            value = value.view()
            value.flags.writeable = False
    elif isinstance(value, dict):
        value = MappingProxyType(value)
    elif isinstance(value, tuple) and any(isinstance(entry, np.ndarray) for entry in value):
        value = tuple(map(_read_only, value))
    return value


def _short(value: object) -> str:
    """Return a field in a few words."""
    if isinstance(value, np.ndarray):
        if value.size <= SHOWN_ENTRIES:
            return " ".join(np.array2string(value, precision=6, separator=", ").split())
        return f"<array {'x'.join(map(str, value.shape))}>"
    if isinstance(value, Mapping):
        names = [repr(name) for name in list(value)[:SHOWN_ENTRIES]]
        return f"{{{', '.join([*names, '...'] if len(value) > SHOWN_ENTRIES else names)}}}"
    if isinstance(value, tuple):
        plain = all(isinstance(entry, (str, int, float)) for entry in value)
        if plain and len(value) <= SHOWN_ENTRIES:
            return f"({', '.join(map(_short, value))})"
        return f"<{len(value)} {type(value[0]).__name__}>"
    if isinstance(value, str) and len(value) > SHOWN_CHARACTERS:
        return repr(f"{value[:SHOWN_CHARACTERS]}...")
    if isinstance(value, float):
        return f"{value:.6g}"
    return f"<{type(value).__name__}>" if hasattr(value, "__dataclass_fields__") else repr(value)
