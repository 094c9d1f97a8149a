"""The table [log] of a rig file: how logs are written, a field for every one of `LogFormat`."""

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
"""Fields that exclude each other: where a user states one, those of the rig file do not count."""
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
            raise InputError(_as_fields(error.found), _as_fields(error.expected)) from error


def _as_fields(words: str) -> str:
    """Return words with fields of the table in place of options."""
    return OPTION.sub(lambda found: f"log.{found[1].replace('-', '_')}", words)


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
