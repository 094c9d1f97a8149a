"""The verbs of the command line, and what they share."""

import typer

from .._version import __version__
from .calibrate import calibrate
from .check import check
from .options import expanded
from .plan import plan
from .plot import plot
from .simulate import simulate
from .study import study
from .validate import validate
from .watch import watch

app = typer.Typer(
    name="handlaser",
    help="Calibrate laser distance sensors on a robot hand.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"]},
)
for verb in (calibrate, check, plan, plot, simulate, study, validate, watch):
    app.command()(expanded(verb))


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
