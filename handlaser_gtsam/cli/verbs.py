"""The verbs of the command line, and what they share; a verb is imported when it is asked for."""

from collections.abc import Callable, Iterator, Mapping
from functools import cache
from importlib import import_module
from typing import Any, cast

import typer
from typer.core import TyperGroup

from .. import __version__
from .options import expanded
from .sections import Verb
from .width import NO_SCREEN

NAME = "handlaser"
VERBS = (
    "calibrate",
    "check",
    "convert",
    "export",
    "plan",
    "plot",
    "simulate",
    "study",
    "validate",
    "watch",
)
"""Each is a module beside this one and the function in it."""
UsageError = cast("type[Exception]", typer.BadParameter.__mro__[1])
"""Of the click that typer uses, which newer versions bring along."""


def function_of(verb: str) -> Callable[..., None]:
    """Return the function that does what a verb says."""
    return cast("Callable[..., None]", getattr(import_module(f".{verb}", __package__), verb))


@cache
def _command(verb: str) -> Any:
    """Return a verb as typer runs it."""
    alone = typer.Typer(add_completion=False, pretty_exceptions_enable=False, rich_markup_mode=None)
    alone.command(cls=Verb)(expanded(function_of(verb)))
    return typer.main.get_command(alone)


class _Commands(Mapping[str, Any]):
    """The verbs by name."""

    def __getitem__(self, name: str) -> Any:
        if name not in VERBS:
            raise KeyError(name)
        return _command(name)

    def __iter__(self) -> Iterator[str]:
        return iter(VERBS)

    def __len__(self) -> int:
        return len(VERBS)


class _Verbs(TyperGroup):
    """A group of commands that are not there before they are asked for."""

    def __init__(self, **settings: Any) -> None:
        super().__init__(**settings | {"commands": _Commands()})


app = typer.Typer(
    name=NAME,
    cls=_Verbs,
    help="Calibrate laser distance sensors on a robot hand.",
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": NO_SCREEN},
)


def usage_words(error: Exception) -> str:
    """Return in one line what is wrong with a command line, and where to look."""
    from ..files.logs.format import LogFormat
    from ..text import printable

    context = getattr(error, "ctx", None)
    command = NAME if context is None else context.command_path
    option = getattr(error, "option_name", "").lstrip("-").replace("-", "_")
    if option in LogFormat.__dataclass_fields__ and "--rig" in _options(context):
        return (
            f"no option --{option.replace('_', '-')} at {command}: how a log is written stands in the "
            f"table [log] of the rig file, as {option}. `{NAME} convert` has the option: it turns the "
            "log into a recording, or with --write-log RIG writes that table"
        )
    message = " ".join(error.format_message().split())  # type: ignore[attr-defined]
    message = (
        message.replace("Value error, ", "").replace("Input should be", "expected").rstrip(".")
    )
    return f"{printable(message)} ({command} --help shows what there is)"


def _options(context: Any) -> set[str]:
    """Return the options of the verb whose command line is wrong."""
    parameters = [] if context is None else context.command.params
    return {option for one in parameters for option in one.opts}


def _print_version(wanted: bool) -> None:
    if wanted:
        print(f"handlaser {__version__}")
        raise typer.Exit


@app.callback()
def _root(
    version: bool = typer.Option(
        False, "--version", callback=_print_version, is_eager=True, help="Print the version."
    ),
) -> None:
    """Calibrate laser distance sensors on a robot hand."""
