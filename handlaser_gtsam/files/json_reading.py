"""JSON files read into a schema: the first fault refused in one line that names the field."""

import json
from pathlib import Path
from typing import TypeVar

from pydantic import BaseModel, ValidationError

from ..data.recording import first_repeated
from ..errors import InputError
from ..text import shown
from .writing import path_of

EXPECTED = "a calibration, JSON"

Schema = TypeVar("Schema", bound=BaseModel)


def read_json(path: Path | str, schema: type[Schema]) -> Schema:
    """Return the content of the JSON file of a calibration.

    Raises
    ------
    InputError
        No such file, no JSON, a field twice, or what `schema` does not take.
    """
    path = path_of(path)
    try:
        text = path.read_bytes().decode("utf-8")
        return schema.model_validate(json.loads(text, object_pairs_hook=_once_each))
    except OSError as error:
        raise InputError(f"no readable file ({error.strerror})", EXPECTED, path) from error
    except ValidationError as error:
        raise _first_fault(error, path) from error
    except UnicodeDecodeError as error:
        byte = error.object[error.start]
        found = f"the byte 0x{byte:02x}, which is not UTF-8, at offset {error.start}"
        raise InputError(found, EXPECTED, path) from error
    except (InputError, ValueError, RecursionError) as error:
        reason = str(error).splitlines()[0][:120]
        found = error.found if isinstance(error, InputError) else f"no JSON ({reason})"
        raise InputError(found, EXPECTED, path) from error


def _once_each(pairs: list[tuple[str, object]]) -> dict[str, object]:
    """Return the fields of an object; refuse one that stands twice: only the last would count."""
    twice = first_repeated([name for name, _ in pairs])
    if twice is not None:
        raise InputError(f"the field {shown(pairs[twice][0])} twice", "every field once")
    return dict(pairs)


def _first_fault(error: ValidationError, path: Path) -> InputError:
    fault = error.errors()[0]
    field = ".".join(str(part) for part in fault["loc"]) or "the file"
    found = f"{field} = {shown(fault['input'])}: {fault['msg']}"
    return InputError(found, "a calibration of handlaser", path)
