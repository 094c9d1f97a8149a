"""Text files with a schema: read and checked, the first fault refused in one line; and written as JSON.

JSON as this package writes it has SI units, finite numbers only, and two blanks a level.
"""

import json
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar, get_args

import numpy as np
from pydantic import BaseModel, ConfigDict, ValidationError, create_model

from ..arrays import FloatArray
from ..checks import as_called
from ..data.recording import first_repeated
from ..errors import ArgumentError, InputError
from ..quantities import DEG, MM
from ..text import shown
from .writing import readable

UNITS = {"mm": MM, "deg": DEG, "percent": 0.01}
"""Units that names of fields end with."""
WARNING = "code message values"
"""Fields of a warning in JSON."""
Record = dict[str, object]
Json = dict[str, "Json"] | list["Json"] | str | float | int | None


class FileRecord(BaseModel):
    """Fields of a file: no others, of no other type, and finite."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)

    def in_si(self) -> dict[str, Any]:
        """Return the fields that are given, in SI units, by their names without the unit.

        rms_mm = 0.1 is rms = 1e-4, and an array of numbers with a unit becomes a NumPy array.
        """
        found: dict[str, Any] = {}
        for name, value in self:
            quantity, _, unit = name.rpartition("_")
            if value is not None and unit in UNITS:
                value = np.array(value) if isinstance(value, list | tuple) else value
                found[quantity] = value * UNITS[unit]
            elif value is not None:
                found[name] = value
        return found


def numbers(names: str) -> Any:
    """Return a record of numbers that may be given, under names with blanks between them."""
    fields: Any = dict.fromkeys(names.split(), (float | None, None))
    return create_model("Numbers", __base__=FileRecord, **fields)


Schema = TypeVar("Schema", bound=FileRecord)
Made = TypeVar("Made")


def read_text(path: Path, expected: str) -> str:
    """Return the text of a file.

    Raises
    ------
    InputError
        No such file, or bytes that are not UTF-8.
    """
    with readable(path, expected):
        data = path.read_bytes()
    return decoded(data, path)


def decoded(data: bytes, path: Path) -> str:
    """Return the text that the bytes of a file are.

    Raises
    ------
    InputError
        They are not UTF-8.
    """
    try:
        return data.decode("utf-8")
    except UnicodeDecodeError as error:
        at = error.start
        if data[:2] in (b"\xff\xfe", b"\xfe\xff"):
            raise InputError("UTF-16 text", "a file saved as UTF-8", path, 1) from error
        line = data.count(b"\n" if b"\n" in data else b"\r", 0, at) + 1
        found = f"the byte 0x{data[at]:02x}, which is not UTF-8, at offset {at}"
        raise InputError(found, "a file saved as UTF-8", path, line) from error


def checked(data: object, schema: type[Schema], expected: str, path: Path) -> Schema:
    """Return what a file that is `expected` holds as `schema` has it; see `read_value`.

    Raises
    ------
    InputError
        What `schema` does not take.
    """
    try:
        return schema.model_validate(data)
    except ValidationError as error:
        raise _first_fault(error, data, schema, expected, path) from error


def read_value(path: Path, parse: Callable[[str], object], expected: str) -> object:
    """Return the content of a file.

    Parameters
    ----------
    path : Path
    parse : callable
        Makes a value of the text; a ValueError says that the text is none.
    expected : str
        What kind of file it is, and its language: "a rig file, TOML".

    Raises
    ------
    InputError
        No such file, no UTF-8, or what `parse` refuses.
    """
    text = read_text(path, expected)
    try:
        return parse(text)
    except InputError as error:
        raise InputError(error.found, expected, path) from error
    except (ValueError, RecursionError) as error:  # ValueError: endless integers, too
        what = str(error).split(";")[0].splitlines()[0][:120]
        raise InputError(f"no {expected.split()[-1]} ({what})", expected, path) from error


def _first_fault(
    error: ValidationError, data: object, schema: type[BaseModel], expected: str, path: Path
) -> InputError:
    """Return the first fault as the file spells it.

    A field that may be one of several kinds has a fault for each; the one that is found deepest in the
    file belongs to the kind that was meant.
    """
    faults = error.errors()
    places = [_place(one["loc"], one["type"] == "missing", data) for one in faults]
    first = [i for i, one in enumerate(places) if one[: len(places[0])] == places[0]]
    deepest = max(first, key=lambda i: len(places[i]))
    fault, place = faults[deepest], places[deepest]
    if not place:
        return InputError(f"the file = {shown(fault['input'])}", expected, path)
    field = ".".join(place)
    if fault["type"] == "extra_forbidden":
        tables: list[type[BaseModel]] = [schema]
        for part in place[:-1]:  # a name of the user's, as of a scene, is no field
            fields = [one.model_fields[part] for one in tables if part in one.model_fields]
            tables = [one for field in fields for one in _tables(field.annotation)] or tables
        tables = [one for one in tables if place[-1] not in one.model_fields]
        names = ", ".join(dict.fromkeys(name for one in tables for name in one.model_fields))
        expected = f"one of {names}"
        expected += "".join(
            f"; {place[-1]} stands in [{name}]{f', {of.description}' if of.description else ''}"
            for name, of in schema.model_fields.items()
            if place[-1] in getattr(of.annotation, "model_fields", ())
        )
        return InputError(f"the unknown field {shown(field)[1:-1]}", expected, path)
    if fault["type"] == "missing":
        kind = expected.split(",")[0]
        return InputError(f"no field {field}", f"the field, which {kind} needs", path)
    wanted = []
    for one in (faults[i] for i in first if places[i] == place):
        kind = one["type"].removesuffix("_type").removesuffix("_parsing")
        wanted.append(KINDS.get(kind, "another value").format(**one.get("ctx", {})))
    wanted_words = " or ".join(dict.fromkeys(wanted))
    given, several = fault["input"], f"{field}s"
    if path.suffix == ".toml" and isinstance(given, dict) and wanted_words == KINDS["list"]:
        return InputError(f"the table [{field}]", f"[[{field}]], a table for each", path)
    if path.suffix == ".toml" and isinstance(given, list) and wanted_words == KINDS["dict"]:
        more = f", or [[{several}]]" if several in schema.model_fields else ""
        return InputError(f"the tables [[{field}]]", f"one table [{field}]{more}", path)
    return InputError(f"{field} = {shown(given)}", wanted_words, path)


def _tables(annotation: object) -> Iterator[type[BaseModel]]:
    """Yield the tables that a field may be, by itself, in a list or by names."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for one in get_args(annotation):
        yield from _tables(one)


def _place(parts: Sequence[int | str], missing: bool, data: object) -> list[str]:
    """Return where in the file a fault is, without pydantic's names of the kinds of a field."""
    found = []
    for i, part in enumerate(parts):
        if isinstance(data, list) and isinstance(part, int):
            data = data[part]
        elif isinstance(data, dict) and (part in data or (missing and i == len(parts) - 1)):
            data = data.get(part)
        else:
            continue
        found.append(str(part))
    return found


KINDS = {
    "bool": "true or false",
    "dict": "a table",
    "finite_number": "a finite number",
    "float": "a number",
    "greater_than_equal": "{ge} or more",
    "int": "a whole number",
    "less_than_equal": "{le} or less",
    "list": "an array",
    "literal_error": "one of {expected}",
    "model": "a table",
    "string": "a text in quotes",
    "too_long": "an array of {max_length} or fewer",
    "too_short": "an array of {min_length} or more",
    "tuple": "an array",
}
"""What a field must be, by the beginnings of pydantic's names of faults, with the bounds it knows."""


def json_value(text: str, parse_constant: Callable[[str], object] | None = None) -> object:
    """Return the content of a JSON text; raises a ValueError, or InputError for a field twice."""
    return json.loads(text, object_pairs_hook=_once_each, parse_constant=parse_constant)


def _once_each(pairs: list[tuple[str, object]]) -> dict[str, object]:
    """Return the fields of an object; refuse one that stands twice: only the last would count."""
    twice = first_repeated([name for name, _ in pairs])
    if twice is not None:
        raise InputError(f"the field {shown(pairs[twice][0])} twice", "every field once")
    return dict(pairs)


@contextmanager
def in_table(name: str, record: BaseModel) -> Iterator[None]:
    """Let a fault of what is made of a table's fields name the field, in its own unit."""
    try:
        yield
    except ArgumentError as error:
        fields = {field: f"{name}.{field}" for field in type(record).model_fields}
        raise as_called(error, fields) from error


def made(name: str, record: FileRecord, kind: Callable[..., Made], **others: object) -> Made:
    """Return what the fields of a table make in SI units, beside others; see `in_table`."""
    with in_table(name, record):
        return kind(**record.in_si() | others)


def toml_table(title: str, fields: Mapping[str, object]) -> str:
    """Return a table of TOML with those fields that are stated, texts, numbers, truths or lists."""
    # What JSON says of these, TOML says, too.
    lines = [
        f"{name} = {json.dumps(value, ensure_ascii=False)}"
        for name, value in fields.items()
        if value is not None
    ]
    return "\n".join((title, *lines, ""))


@contextmanager
def in_file(path: Path) -> Iterator[None]:
    """Let a fault of what a file holds name the file, where it names none."""
    try:
        yield
    except InputError as error:
        if error.path is not None:
            raise
        raise InputError(error.found, error.expected, path, error.line, error.column) from error


def square_matrix(rows: Sequence[Sequence[float]], size: int, field: str) -> FloatArray:
    """Return the rows of a field as a square matrix of `size`; refuse any other shape."""
    lengths = [len(row) for row in rows]
    if lengths != [size] * size:
        found = f"{field} of {len(rows)} rows of {sorted(set(lengths))}"
        raise InputError(found, f"{size} rows of {size} numbers")
    return np.array(rows, dtype=np.float64)


def json_text(kind: str, content: Record) -> str:
    """Return a record as JSON text of version 1 of the format `handlaser-KIND`."""
    whole = {"format": f"handlaser-{kind}", "version": 1, **content}
    return json.dumps(_plain(whole), indent=2, allow_nan=False) + "\n"


def record(source: object, fields: str, **others: object) -> Record:
    """Return fields, whose names are separated by blanks, in that order.

    A field is one of the `others`, or the attribute of `source` that has its name, or its name but for
    the unit at the end; an array or a tuple has the fields in their order.
    """
    names = fields.split()
    if isinstance(source, np.ndarray | tuple):
        return dict(zip(names, source, strict=True))
    found: Record = {}
    for name in names:
        attribute = name if hasattr(source, name) else name.rpartition("_")[0]
        found[name] = others[name] if name in others else getattr(source, attribute)
    return found


def records(sources: Iterable[object], fields: str) -> list[Record]:
    """Return the `record` of each source."""
    return [record(one, fields) for one in sources]


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
