"""JSON as this package writes it: SI units, finite numbers only, two blanks a level."""

import json
import math
from collections.abc import Mapping

import numpy as np

Record = dict[str, object]
Json = dict[str, "Json"] | list["Json"] | str | float | int | None


def json_text(kind: str, record: Record) -> str:
    """Return a record as JSON text of version 1 of the format `handlaser-KIND`."""
    whole = {"format": f"handlaser-{kind}", "version": 1, **record}
    return json.dumps(_plain(whole), indent=2, allow_nan=False) + "\n"


def named(source: object, names: str) -> Record:
    """Return the attributes of the given names, separated by blanks, in that order."""
    return {name: getattr(source, name) for name in names.split()}


def _plain(value: object) -> Json:
    """Return numbers, arrays, sequences and mappings as JSON has them.

    The infinite standard deviation of what is undetermined, and what is no number, are null.
    """
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if value is None or isinstance(value, str | int):
        return value
    if isinstance(value, np.ndarray | np.generic):
        return _plain(value.tolist())
    if isinstance(value, Mapping):
        return {str(name): _plain(one) for name, one in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(one) for one in value]
    raise TypeError(f"{type(value).__name__} has no form in JSON")
