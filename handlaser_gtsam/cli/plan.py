"""handlaser plan: the stations to measure next."""

from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .answer import Answer, print_wrapped
from .options import Given, JsonOption, Model, QuietOption
from .progress_line import Working

if TYPE_CHECKING:
    from collections.abc import Mapping

    from ..files.rig_toml import Rig
    from ..planning.plate import Plate
    from ..planning.route import Plan

FEW, MANY = 20, 100
"""Stations where no number is given: without a goal, and at most until it is reached."""


@dataclass(frozen=True, slots=True)
class Wanted:
    """What is planned, and where it goes."""

    calibration: Annotated[
        Path | None,
        typer.Option(
            help="Result of `handlaser calibrate --out`, instead of RECORDING. What it says of the "
            "planes is their place only: stations before them count as before planes put anew."
        ),
    ] = None
    planes: Annotated[
        int | None,
        typer.Option(
            min=1,
            help="Put the plate anew so many times, in orientations that are part of the plan; "
            "default: before the planes as they stand.",
        ),
    ] = None
    stations: Annotated[
        int | None,
        typer.Option(
            min=1,
            help="Stations in all, at most: fewer where they reach the goal or the limits of the rig "
            "file. Default: 20, or as many as that takes; for a first motion, as many as it takes.",
        ),
    ] = None
    seed: Annotated[int, typer.Option(min=0, help="Draws the candidates.")] = 0
    out: Annotated[
        Path | None,
        typer.Option(readable=False, help="Write the stations to this CSV file."),
    ] = None
    picture: Annotated[
        Path | None,
        typer.Option(readable=False, help="Write the forecast to this picture, SVG."),
    ] = None


def plan(
    given: Given,
    model: Model,
    wanted: Wanted,
    recording: Annotated[
        Path | None,
        typer.Argument(
            help="What was recorded so far: a recording, CSV, or a log; it is calibrated first."
        ),
    ] = None,
    json_: JsonOption = False,
    quiet: QuietOption = False,
) -> None:
    """Say where to measure next.

    Without RECORDING and --calibration: a first motion for any mount within the bounds of the rig file.

    Exit codes: 0 good; 2 bad input; 3 the recording does not determine the calibration that would guide
    the plan.
    """
    from ..files.writing import require_outputs

    with Working():
        rig = given.read()
        outputs = {"--out": wanted.out, "--picture": wanted.picture}
        require_outputs(outputs, (recording, wanted.calibration, given.rig, *rig.log.files))
        found = _planned(recording, rig, model, wanted)
        answer = _answer(found, rig, wanted)
    answer.give(json=json_, quiet=quiet)


def _planned(recording: Path | None, rig: "Rig", model: Model, wanted: Wanted) -> "Plan":
    from ..errors import InputError

    if recording is not None and wanted.calibration is not None:
        raise InputError("RECORDING and --calibration", "one of the two")
    if recording is None and wanted.calibration is None:
        return _blind(rig, wanted)
    return _next(recording, rig, model, wanted)


def _blind(rig: "Rig", wanted: Wanted) -> "Plan":
    """Return a first motion."""
    import numpy as np

    from ..errors import InputError
    from ..planning.blind import blind_motion

    if rig.bounds is None or rig.workspace is None:
        raise InputError(
            "neither RECORDING nor --calibration",
            "one of the two, or the tables [blind] and [workspace] of the rig file",
        )
    planes = wanted.planes or 1
    return blind_motion(
        rig.bounds,
        rig.sensor,
        rig.workspace,
        rig.noise,
        None if wanted.stations is None else wanted.stations // planes,
        planes=planes,
        goal=rig.goal,
        rng=np.random.default_rng(wanted.seed),
    )


def _next(recording: Path | None, rig: "Rig", model: Model, wanted: Wanted) -> "Plan":
    """Return the next stations."""
    import numpy as np

    from ..errors import SolverError
    from ..files.calibration_reading import read_mounts
    from ..files.rig_reading import read_with
    from ..pipeline import calibrate
    from ..planning import plan as planning
    from ..planning.workspace import require_range

    require_range(rig.sensor)
    count = wanted.stations or (MANY if rig.goal.stated else FEW)
    placement = None
    if wanted.planes is not None:
        placement = replace(rig.placement, count=wanted.planes)
    rng = np.random.default_rng(wanted.seed)
    given = count, rig.sensor, rig.workspace, rig.goal
    if wanted.calibration is not None:
        mounts, plates = read_mounts(wanted.calibration), _plates(wanted.calibration, rig)
        return planning.plan(mounts, *given, plates=plates, placement=placement, rng=rng)
    report, rig = read_with(rig, recording or Path())
    found = calibrate(report.recording, rig.noise, model.options(rig))
    if found.status != "converged":
        raise SolverError(found.message)
    return planning.plan(found, *given, placement=placement, rng=rng)


def _plates(path: Path, rig: "Rig") -> "Mapping[str, Plate]":
    """Return the planes of a result as plates, with what it leaves uncertain of them."""
    from ..errors import InputError
    from ..files.calibration_reading import read_calibration
    from ..planning.plate import plate_of

    if rig.workspace is None:
        raise InputError("a result without a workspace", "the table [workspace] of the rig file")
    middle = 0.5 * (rig.workspace.low + rig.workspace.high)
    return {
        one.name: plate_of(
            one.normal,
            one.offset_m,
            middle,
            None if one.sigma is None else (one.sigma.offset_m, one.sigma.normal_rad),
        )
        for one in read_calibration(path).planes
    }


def _answer(found: "Plan", rig: "Rig", wanted: Wanted) -> Answer:
    """Write the files, and return what is said."""
    from ..files.plan_json import plan_text
    from ..files.stations_csv import write_stations
    from ..files.writing import write_text
    from ..planning.picture import forecast_svg
    from ..text import printable
    from .plan_tables import plan_lines, scene_lines

    lines = list(plan_lines(found, rig.goal))
    if rig.workspace is not None and rig.workspace.robot is not None:
        lines += scene_lines(rig.workspace.robot)
    if wanted.out is not None:
        write_stations(wanted.out, found.stations)
        lines.append(f"wrote {printable(str(wanted.out))}")
    if wanted.picture is not None:
        write_text(wanted.picture, forecast_svg(found.forecast, rig.goal))
        lines.append(f"wrote {printable(str(wanted.picture))}")
    return Answer(plan_text(found), partial(print_wrapped, lines))
