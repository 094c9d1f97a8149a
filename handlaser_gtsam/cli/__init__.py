"""The command `handlaser`; one file a verb. Heavy imports happen inside the verbs."""

import io
import os
import sys

import typer

from .._version import __version__
from ..errors import HandlaserError, InputError
from .calibrate import calibrate
from .check import check
from .simulate import simulate
from .validate import validate

BAD_INPUT, UNDETERMINED, INTERRUPTED = 2, 3, 130

app = typer.Typer(
    name="handlaser",
    help="Calibrate laser distance sensors on a robot hand.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"]},
)
app.command()(calibrate)
app.command()(check)
app.command()(simulate)
app.command()(validate)


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


def main() -> None:
    """Run the command line; errors made on purpose end in one line and an exit code."""
    if sys.stdout is None:  # closed by the caller
        sys.stdout = io.StringIO()
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # what its encoding cannot say is shown as escapes
            stream.reconfigure(errors="backslashreplace")
    try:
        app()
        sys.stdout.flush()
    except InputError as error:
        print(f"handlaser: {error}", file=sys.stderr)
        sys.exit(BAD_INPUT)
    except HandlaserError as error:
        print(f"handlaser: {error}", file=sys.stderr)
        sys.exit(UNDETERMINED)
    except KeyboardInterrupt:
        print("handlaser: stopped by Ctrl-C", file=sys.stderr)
        sys.exit(INTERRUPTED)
    except OSError as error:
        print(f"handlaser: no way to write the output ({error.strerror})", file=sys.stderr)
        os._exit(BAD_INPUT)  # a full stdout would raise again when it is flushed
