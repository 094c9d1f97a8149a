"""Options that say how a log is written: one for every field of `LogFormat`, in its own words."""

import inspect
import re
from dataclasses import fields
from pathlib import Path
from typing import Annotated, Any, get_args, get_origin

import typer

from ..files.logs.format import LogFormat

FIELD = re.compile(r"(?m)^(\w+) : .*\n((?:^    .*\n)+)")
"""A field in the section Attributes, and what is said of it."""
PANEL = "Options for logs"


class Log:
    """How a log is written, where it is no recording in CSV; its signature has the options."""

    def __init__(self, **given: object) -> None:
        self._given = given

    def stated(self) -> dict[str, object]:
        """Return what is given, under the names of the fields of the rig file."""
        found = {}
        for one in fields(LogFormat):
            value = self._given.get(one.name)
            if isinstance(value, str) and get_origin(one.type) is tuple:
                value = _parts(one.name, value, numbers=get_args(one.type)[0] is float)
            if value is not None and value is not False:
                found[one.name] = value
        return found


def _parts(name: str, text: str, *, numbers: bool) -> tuple[object, ...]:
    """Return the names of a list, between commas, or its numbers, between commas or blanks."""
    from ..errors import InputError
    from ..text import shown

    parts = [part.strip() for part in text.split(",")]
    try:
        if numbers:
            return tuple(map(float, text.replace(",", " ").split()))
        if all(parts):
            return tuple(parts)
    except ValueError:
        pass
    what = f"{'numbers' if numbers else 'names'} with commas between them"
    raise InputError(f"--{name.replace('_', '-')} {shown(text)}", what)


def _parameters() -> list[inspect.Parameter]:
    """Return an option for every field; None and False where nothing is given."""
    texts = {
        name: " ".join(text.split())
        for name, text in FIELD.findall(f"{inspect.getdoc(LogFormat)}\n")
    }
    found = []
    for one in fields(LogFormat):
        kind: Any = one.type
        option, default, metavar = f"--{one.name.replace('_', '-')}", None, None
        if kind is bool:
            default = False
        elif get_origin(kind) is tuple:
            metavar = "NUMBERS" if get_args(kind)[0] is float else "NAMES"
        elif words := LogFormat.words_of(one.name):
            metavar = "|".join(words)
        plain: Any = next((other for other in (float, Path) if _may_be(kind, other)), str)
        plain = bool if kind is bool else plain | None
        annotation = Annotated[
            plain,
            typer.Option(option, help=texts.get(one.name), metavar=metavar, rich_help_panel=PANEL),
        ]
        where = inspect.Parameter.POSITIONAL_OR_KEYWORD
        found.append(inspect.Parameter(one.name, where, default=default, annotation=annotation))
    return found


def _may_be(kind: Any, wanted: type) -> bool:
    return kind is wanted or (wanted in get_args(kind) and get_origin(kind) is not tuple)


Log.__signature__ = inspect.Signature(_parameters())  # type: ignore[attr-defined]
