"""The verbs of the command line, and what they share."""

from typing import Any, cast

import typer

from .. import __version__
from ..files.logs.format import LogFormat
from .calibrate import calibrate
from .check import check
from .convert import convert
from .examples import epilog
from .export import export
from .options import expanded
from .plan import plan
from .plot import plot
from .sections import Verb
from .simulate import simulate
from .study import study
from .validate import validate
from .watch import watch
from .width import NO_SCREEN

NAME = "handlaser"
UsageError = cast("type[Exception]", typer.BadParameter.__mro__[1])
"""Of the click that typer uses, which newer versions bring along."""
app = typer.Typer(
    name=NAME,
    help="Calibrate laser distance sensors on a robot hand.",
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": NO_SCREEN},
)
for verb in (calibrate, check, convert, export, plan, plot, simulate, study, validate, watch):
    app.command(cls=Verb, epilog=epilog(verb.__name__))(expanded(verb))


def usage_words(error: Exception) -> str:
    """Return in one line what is wrong with a command line, and where to look."""
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
