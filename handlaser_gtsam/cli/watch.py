"""handlaser watch: a page that follows a recording as it grows."""

import sys
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from .answer import working
from .options import AtRangeOption, Given, Model, metres

LOOPBACK = "127.0.0.1"


def watch(
    path: Annotated[Path, typer.Argument(metavar="FOLDER|FILE", show_default=False)],
    given: Given,
    model: Model,
    host: str = LOOPBACK,
    port: Annotated[int | None, typer.Option(min=0, max=65535)] = None,
    open_: bool = False,
    at_range_mm: AtRangeOption = None,
) -> None:
    r"""Show a page that follows a recording as it grows: verdict, beams, planes, next station.

    It is calibrated again whenever it changes. Ctrl-C ends.

    Exit codes: 2 bad input, or a port that is in use; 130 stopped by Ctrl-C.

    Parameters
    ----------
    path : Path
        Folder of recording.csv, and of rig.toml if it is there; or a recording, CSV, or a log that is a
        table. It may yet come.
    given, model
    host : str
        Address to listen at. Other computers see the page only where this says so: 0.0.0.0 lets all
        that reach this one.
    port : int, optional
        Port to listen at, 0 for any that is free; default: 8642, or any where that is taken.
    open_ : bool
        Open the page in the browser.
    at_range_mm : float, optional

    Examples
    --------
    handlaser watch .
    handlaser watch recording.csv --rig rig.toml \
        --port 9000 --open
    """
    from ..checks import imported
    from ..files.rig_toml import known_rig
    from ..text import printable

    with working():
        for name in ("starlette", "uvicorn"):
            imported(name, "watch", f"no {name}, which the page needs")
        from ..files.watch.follower import Follower
        from ..files.watch.server import PageServer, is_loopback, listening
        from ..files.watch.watched import Watched, watched_files

        # What cannot be calibrated whatever the files say is refused now.
        stated = asdict(given)
        options = model.options(known_rig(None, stated))
        recording, rig = watched_files(path, given.rig)
        reading = metres(at_range_mm)
        watched = Watched(recording, rig, given.rig is not None, stated, options, reading)
        bound = listening(host, port)
        server = PageServer(host, bound)
    with server:
        print(f"watching {printable(str(watched.recording))} at {server.url}")
        if not is_loopback(bound):
            print("whoever reaches this computer sees the page", file=sys.stderr)
        print("Ctrl-C ends", flush=True)
        if open_:
            import webbrowser

            webbrowser.open_new_tab(server.url)
        Follower(watched, server.publish).run()
