"""handlaser watch: a page that follows a recording as it grows."""

import sys
from dataclasses import asdict, dataclass
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .options import AtRangeOption, Given, Model, metres
from .progress_line import Working

if TYPE_CHECKING:
    from ..files.watch.server import PageServer
    from ..files.watch.watched import Watched

LOOPBACK = "127.0.0.1"
EXTRA = ("starlette", "uvicorn")
"""What the extra `watch` brings."""


@dataclass(frozen=True, slots=True)
class Serving:
    """Where the page is, and what it shows."""

    host: Annotated[
        str,
        typer.Option(
            help="Address to listen at. Other computers see the page only where this says so: "
            "0.0.0.0 lets all that reach this one."
        ),
    ] = LOOPBACK
    port: Annotated[
        int | None,
        typer.Option(
            min=0,
            max=65535,
            help="Port to listen at, 0 for any that is free; default: 8642, or the next that is free.",
        ),
    ] = None
    open_: Annotated[bool, typer.Option("--open", help="Open the page in the browser.")] = False
    at_range_mm: AtRangeOption = None


def watch(
    path: Annotated[
        Path,
        typer.Argument(
            metavar="FOLDER|FILE",
            help="Folder of recording.csv, and of rig.toml if it is there; or a recording, CSV, or a "
            "log that is a table. It may yet come.",
            show_default=False,
        ),
    ],
    given: Given,
    model: Model,
    serving: Serving,
) -> None:
    """Show a page that follows a recording as it grows: verdict, beams, planes, next station.

    It is calibrated again whenever it changes. Ctrl-C ends.

    Exit codes: 2 bad input, or a port that is in use; 130 stopped by Ctrl-C.
    """
    with Working():
        _require_extra()
        watched = _watched(path, given, model, serving)
        from ..files.watch.follower import Follower
        from ..files.watch.server import PageServer, listening

        bound = listening(serving.host, serving.port)
        server = PageServer(serving.host, bound)
    with server:
        _say(watched, server, serving)
        Follower(watched, server.publish).run()


def _require_extra() -> None:
    """Refuse to begin without the libraries of the page."""
    from ..errors import InputError

    for name in EXTRA:
        try:
            import_module(name)
        except ImportError as error:
            expected = "pip install 'handlaser-gtsam[watch]'"
            raise InputError(f"no {name}, which the page needs", expected) from error


def _watched(path: Path, given: Given, model: Model, serving: Serving) -> "Watched":
    """Return what is followed; refuse what cannot be calibrated whatever the files say."""
    from ..files.rig_toml import known_rig
    from ..files.watch.watched import Watched, watched_files

    stated = {name: value for name, value in asdict(given).items() if name != "rig"}
    options = model.options(known_rig(None, stated))
    recording, rig = watched_files(path, given.rig)
    reading = metres(serving.at_range_mm)
    return Watched(recording, rig, given.rig is not None, stated, options, reading)


def _say(watched: "Watched", server: "PageServer", serving: Serving) -> None:
    """Say where the page is, and open it where that is asked for."""
    from ..text import printable

    print(f"watching {printable(str(watched.recording))} at {server.url}")
    if not server.loopback:
        print("whoever reaches this computer sees the page", file=sys.stderr)
    print("Ctrl-C ends", flush=True)
    if serving.open_:
        import webbrowser

        webbrowser.open_new_tab(server.url)
