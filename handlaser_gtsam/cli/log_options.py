"""Options that say how a log is written: one for every field of `LogFormat`, in its own words."""

import inspect
from dataclasses import fields
from pathlib import Path
from typing import Annotated, Any, get_args, get_origin

import typer

from ..files.logs.format import LogFormat
from .options import described, option_of

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
    texts, found = described(LogFormat), []
    for one in fields(LogFormat):
        kind: Any = one.type
        metavar = "|".join(LogFormat.words_of(one.name)) or None
        if get_origin(kind) is tuple:
            metavar = "NUMBERS" if get_args(kind)[0] is float else "NAMES"
        plain: Any = next((other for other in (float, Path) if _may_be(kind, other)), str)
        default, plain = (False, bool) if kind is bool else (None, plain | None)
        given = Annotated[plain, typer.Option(metavar=metavar, rich_help_panel=PANEL)]
        where = inspect.Parameter.KEYWORD_ONLY
        option = inspect.Parameter(one.name, where, default=default, annotation=given)
        found.append(option_of(option, texts.get(one.name, "")))
    return found


def _may_be(kind: Any, wanted: type) -> bool:
    return kind is wanted or (wanted in get_args(kind) and get_origin(kind) is not tuple)


Log.__signature__ = inspect.Signature(_parameters())  # type: ignore[attr-defined]
