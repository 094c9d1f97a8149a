"""JSON as this package writes it: SI units, finite numbers only, two blanks a level."""

import json
import math
from collections.abc import Mapping

import numpy as np
from pydantic import BaseModel

Record = dict[str, object]
Json = dict[str, "Json"] | list["Json"] | str | float | int | None


def json_text(kind: str, content: Record) -> str:
    """Return a record as JSON text of version 1 of the format `handlaser-KIND`."""
    whole = {"format": f"handlaser-{kind}", "version": 1, **content}
    return json.dumps(_plain(whole), indent=2, allow_nan=False) + "\n"


def record(source: object, fields: type[BaseModel] | str, **others: object) -> Record:
    """Return fields of a schema, or of names separated by blanks, in that order.

    A field is one of the `others`, or the attribute of `source` that has its name, or its name but for
    the unit at the end.
    """
    names = fields.split() if isinstance(fields, str) else fields.model_fields
    return {
        name: others[name]
        if name in others
        else getattr(source, name if hasattr(source, name) else name.rpartition("_")[0])
        for name in names
    }


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
