"""The verbs of the command line, and what they share; a verb is imported when it is asked for.

The help of a verb ends with the examples of its docstring. They run as written, in the order of the
verbs, in one folder with the files of examples/gripper and examples/study. A line that ends with a
backslash goes on, so that nothing is wider than 50 columns; `watch` runs until it is stopped.
"""

import inspect
import re
from collections.abc import Callable
from functools import cache
from importlib import import_module
from typing import Any, cast

import typer
from typer.core import TyperCommand, TyperGroup

from .. import __version__
from .answer import NO_SCREEN
from .options import expanded

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


class Verb(TyperCommand):
    """A verb whose help lists its options under the panels that they name."""

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """Write arguments, the options without a panel, then panel by panel."""
        sections: dict[str, list[tuple[str, str]]] = {"Arguments": [], "Options": []}
        for one in self.get_params(ctx):
            row = one.get_help_record(ctx)
            if row is not None:
                usual = "Arguments" if one.param_type_name == "argument" else "Options"
                title = getattr(one, "rich_help_panel", None) or usual
                sections.setdefault(title, []).append(row)
        for title, rows in sections.items():
            if rows:
                with formatter.section(title):
                    formatter.write_dl(rows)

    def format_epilog(self, ctx: Any, formatter: Any) -> None:
        """Write the examples."""
        lines = "\n".join(examples_of(self.name or ""))
        self.epilog = f"\b\nExamples:\n{lines}"  # is not to be wrapped
        super().format_epilog(ctx, formatter)


def function_of(verb: str) -> Callable[..., None]:
    """Return the function that does what a verb says."""
    return cast("Callable[..., None]", getattr(import_module(f".{verb}", __package__), verb))


def examples_of(verb: str) -> list[str]:
    """Return what a person copies: the examples of the docstring of a verb."""
    text = inspect.getdoc(function_of(verb)) or ""
    return re.split(r"\n(?=handlaser )", text.partition("\nExamples\n--------\n")[2])


@cache
def _command(verb: str) -> Any:
    """Return a verb as typer runs it."""
    alone = typer.Typer(add_completion=False, pretty_exceptions_enable=False, rich_markup_mode=None)
    alone.command(cls=Verb)(expanded(function_of(verb)))
    return typer.main.get_command(alone)


class _Verbs(TyperGroup):
    """A group of commands that are not there before they are asked for."""

    def __init__(self, **settings: Any) -> None:
        super().__init__(**settings | {"commands": dict.fromkeys(VERBS)})

    def get_command(self, ctx: Any, cmd_name: str) -> Any:  # noqa: ARG002  # the group decides
        """Return a verb by its name."""
        return _command(cmd_name) if cmd_name in VERBS else None


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
    parameters = [] if context is None else context.command.params
    options = {name for one in parameters for name in one.opts}
    if option in LogFormat.__dataclass_fields__ and "--rig" in options:
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
