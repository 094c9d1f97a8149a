"""The table [log] of a rig file: how logs are written, a field for every one of `LogFormat`."""

import json
import os
import re
from collections.abc import Mapping
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, get_args, get_origin

from pydantic import create_model

from ..errors import InputError
from .checked_text import FileRecord, in_table
from .logs.format import LogFormat

ONE_OF = (
    ("pose_format", "rotation"),
    ("plane", "plane_column", "plane_ranges", "plane_file"),
    ("pose_topic", "frames"),
    ("stands", "interpolate"),
)
"""Fields that exclude each other: where a user states one, the rig file's do not count."""
OPTION = re.compile(r"--([a-z][a-z-]*)")
NAMES = tuple(one.name for one in fields(LogFormat))


def _plain(kind: Any) -> Any:
    """Return the type of a field in TOML, or None where it is not stated."""
    if get_origin(kind) is tuple:
        return list[get_args(kind)[0]] | None  # type: ignore[misc]  # computed
    for plain in (bool, float):
        if kind is plain or plain in get_args(kind):
            return plain | None
    return str | None


_FIELDS: Any = {one.name: (_plain(one.type), None) for one in fields(LogFormat)}


class LogTable(create_model("Fields", __base__=FileRecord, **_FIELDS)):  # type: ignore[misc]
    """The table [log] of a rig file."""

    def to_format(self, folder: Path) -> LogFormat:
        """Return the format; files are named from a folder on.

        Raises
        ------
        InputError
        """
        stated: dict[str, object] = {
            name: tuple(value) if isinstance(value, list) else value
            for name, value in self.model_dump(exclude_none=True).items()
        }
        for name in ("readings", "plane_file"):
            if name in stated:
                stated[name] = folder / str(stated[name])
        try:
            with in_table("log", self):
                return with_stated(LogFormat(), stated)
        except InputError as error:  # which of several fields contradict each other
            raise InputError(as_fields(error.found), as_fields(error.expected)) from error


def as_fields(words: str) -> str:
    """Return words with fields of the table in place of the options of `convert`."""

    def field(option: re.Match[str]) -> str:
        name = option[1].replace("-", "_")
        return f"log.{name}" if name in NAMES else option[0]

    return OPTION.sub(field, words)


def table_of(given: LogFormat, folder: Path) -> str:
    """Return the table [log] that says how logs are written, with files named from a folder on.

    Raises
    ------
    InputError
        Nothing is stated.
    """
    plain, lines = LogFormat(), ["[log]"]
    for name in NAMES:
        value = getattr(given, name)
        if value == getattr(plain, name):
            continue
        if isinstance(value, Path):
            value = os.path.relpath(value.absolute(), folder.absolute())
        # What JSON says of a text, a number, a truth value or a list of them, TOML says, too.
        lines.append(f"{name} = {json.dumps(value, ensure_ascii=False)}")
    if len(lines) == 1:
        expected = "an option that says how the log is written, such as --pose-format"
        raise InputError("nothing that a table [log] could say", expected)
    return "\n".join(lines) + "\n"


def with_stated(known: LogFormat, given: Mapping[str, object]) -> LogFormat:
    """Return a format with what is `given` instead; names of no field are passed over.

    Raises
    ------
    InputError
        Values that cannot be, or contradict each other.
    """
    stated = {name: given[name] for name in NAMES if given.get(name) is not None}
    plain = LogFormat()
    for group in ONE_OF:
        if any(name in stated for name in group):
            for name in group:
                stated.setdefault(name, getattr(plain, name))
    return replace(known, **stated) if stated else known  # type: ignore[arg-type]  # checked there
