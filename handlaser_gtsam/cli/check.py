"""handlaser check: what the motion of a recording can determine, before anything is solved."""

import sys
from pathlib import Path
from typing import Annotated

import typer

UNDETERMINED = 3


def check(
    recording: Annotated[Path, typer.Argument(help="Recording, CSV.", show_default=False)],
    json_: Annotated[
        bool, typer.Option("--json", help="Print the check as JSON, and nothing else.")
    ] = False,
) -> None:
    """Say which stations serve which unknown, and which motion is missing.

    Exit codes: 0 the motion determines everything, for beams and planes in general position; 2 bad
    input; 3 it leaves something open.
    """
    from ..files.calibration_json import check_text
    from ..files.recording_csv import read_recording
    from ..observability.motion import check_motion, lemma_words

    table = read_recording(recording)
    found = check_motion(table)
    for warning in table.warnings:
        print(f"WARNING: {warning}", file=sys.stderr)
    if json_:
        sys.stdout.write(check_text(found))
    else:
        print(f"{found.readings} readings for {found.unknowns} unknowns, without range errors")
        for words in lemma_words(found, table.beam_names):
            print(words)
    if found.undetermined:
        print(
            f"handlaser: the motion leaves open {'; '.join(found.undetermined)}. "
            f"To determine it: {'; '.join(found.advice)}",
            file=sys.stderr,
        )
        raise typer.Exit(UNDETERMINED)
    if not json_:
        print("the motion determines everything, for beams and planes in general position")
