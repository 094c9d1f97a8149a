"""handlaser plan: the stations to measure next."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ..errors import InputError, SolverError
from ..text import count
from .answer import Answer, working, wrote
from .options import (
    Given,
    JsonOption,
    Model,
    OneOrMore,
    OutOption,
    QuietOption,
    Seed,
    read_stated,
    require_outputs_of,
)
from .stopping import Exit

if TYPE_CHECKING:
    from collections.abc import Mapping

    from ..files.rig_toml import Rig
    from ..planning.bounds import Plate
    from ..planning.route import Plan
    from ..results.calibration import Calibration
    from ..results.mounts import Mounts


UNCHECKED = (
    "not checked: stand, plate and arm; there is no [workspace] in the rig file, and stations look at "
    "each target from about where it was seen"
)
"""What is not checked of stations of a survey without a workspace."""


def plan(
    given: Given,
    model: Model,
    recording: Annotated[Path | None, typer.Argument()] = None,
    calibration: Path | None = None,
    planes: OneOrMore = None,
    stations: OneOrMore = None,
    seed: Seed = 0,
    out: OutOption = None,
    picture: OutOption = None,
    json_: JsonOption = False,
    quiet: QuietOption = False,
) -> None:
    r"""Say where to measure next.

    Without RECORDING and --calibration: a first motion for any mount of single beams within the bounds
    of the rig file.

    Exit codes: 0 good; 2 bad input; 3 the recording does not determine the calibration that would guide
    the plan. With sensors of many rays, or other targets than planes, stations are chosen all the same,
    and 3 says that something would still be undetermined after them.

    Parameters
    ----------
    given, model
    recording : Path, optional
        What was recorded so far: a recording, CSV, or a log; it is calibrated first.
    calibration : Path, optional
        Result of `handlaser calibrate --out`, of beams before planes, instead of RECORDING. What it
        says of the planes is their place only: stations before them count as before planes that were
        moved.
    planes : int, optional
        Times to move the plate, to orientations that are part of the plan; default: before the planes
        as they stand.
    stations : int, optional
        Stations in all, at most: fewer where they reach the goal or the limits of the rig file.
        Default: 20, or as many as that takes; for a first motion, as many as it takes.
    seed : int
        Draws the candidates.
    out : Path, optional
        Write the stations to this CSV file.
    picture : Path, optional
        Write the forecast to this picture, SVG.
    json_, quiet

    Examples
    --------
    handlaser plan recording.csv --rig rig.toml \
        --stations 12 --out stations.csv
    handlaser plan recording.csv --rig rig.toml \
        --stations 5 --picture forecast.svg
    """
    from ..files.plan_json import forecast_svg, plan_text
    from ..files.recording_csv import write_stations
    from ..files.writing import write_text
    from .words import plan_lines, station_lines

    with working():
        rig = given.read()
        outputs = {"--out": out, "--picture": picture}
        require_outputs_of(outputs, rig, (recording, calibration, given.rig))
        planned, hidden = _planned(recording, calibration, rig, model, planes, stations, seed)
        warnings, failure = _gaps(planned)
        warnings += hidden
        robot = None if rig.workspace is None else rig.workspace.robot
        lines = plan_lines(planned, rig.goal, robot)
        if planned.sensors and rig.workspace is None:
            lines.append(UNCHECKED)
        if out is not None:
            write_stations(out, planned.stations)
        else:
            lines += station_lines(planned.stations)
        if picture is not None:
            write_text(picture, forecast_svg(planned.forecast, rig.goal))
        lines += wrote(out, picture)
        answer = Answer(plan_text(planned), lines, warnings, failure)
    answer.give(json=json_, quiet=quiet)


def _planned(
    recording: Path | None,
    result: Path | None,
    rig: "Rig",
    model: Model,
    planes: int | None,
    stations: int | None,
    seed: int,
) -> tuple["Plan", list[str]]:
    """Return a first motion, or the next stations of a recording or a result; and what these leave."""
    import numpy as np

    from ..data.survey import Survey
    from ..pipeline import calibrate
    from ..planning import plan as planning
    from ..planning.blind import blind_motion
    from ..planning.workspace import require_range

    rng = np.random.default_rng(seed)
    if recording is not None and result is not None:
        raise InputError("RECORDING and --calibration", "one of the two")
    options = model.options(rig)
    if recording is None and options.free:
        expected = "RECORDING, which is calibrated with these errors as unknowns"
        raise InputError("--free without RECORDING", expected)
    if recording is None and result is None:
        if rig.bounds is None or rig.workspace is None:
            expected = "one of the two, or the tables [blind] and [workspace] of the rig file"
            raise InputError("neither RECORDING nor --calibration", expected)
        each = None if stations is None else stations // (planes or 1)
        known = rig.bounds, rig.sensor, rig.workspace, rig.noise, each
        motion = blind_motion(*known, planes=planes or 1, goal=rig.goal, rng=rng)
        return motion, _beyond_bounds(rig)
    # Without a goal as many as an hour's work; with one, the plan ends where it is reached.
    most = stations or (100 if rig.goal.stated else 20)
    stated = model.stated() + ([] if planes is None else ["--planes"])
    read = None
    if recording is not None:
        read, rig = read_stated(rig, recording, stated)
    if isinstance(read, Survey):
        found = calibrate(read, rig.noise)
        return planning.plan(found, most, workspace=rig.workspace, goal=rig.goal, rng=rng), []
    calibration: Calibration | Mounts
    hidden = list[str]()
    if read is None:
        calibration, plates, hidden = _result(result or Path(), rig)
        require_range(rig.sensor)
    else:
        require_range(rig.sensor)
        plates = None
        calibration = calibrate(read.recording, rig.noise, options)
        if calibration.status != "converged":
            raise SolverError(calibration.message)
        hidden = _hidden(calibration, rig)
    placement = None if planes is None else replace(rig.placement, count=planes)
    asked = calibration, most, rig.sensor, rig.workspace, rig.goal
    return planning.plan(*asked, plates=plates, placement=placement, rng=rng), hidden


def _beyond_bounds(rig: "Rig") -> list[str]:
    """Warn of sensors of many rays, for which there is no first motion."""
    from ..text import some

    many = () if rig.survey is None else rig.survey.sensors
    if not many:
        return []
    names = some([one.name for one in many], 4)
    return [
        "WARNING: a first motion is for the single beams of [blind], and says nothing of "
        f"{names} in [[sensors]]: choose the first stations of these yourself, and plan the next ones "
        "from RECORDING"
    ]


def _hidden(calibration: "Calibration", rig: "Rig") -> list[str]:
    """Warn of limits that only systematic errors exceed, which a plan does not count."""
    worst = calibration.judged(rig.limits).worst_limits
    beyond = [one.failure for one in worst if not one.held and one.random <= one.limit]
    if not beyond:
        return []
    return [
        "WARNING: a plan counts random errors alone, and with systematic ones that may hide the limits "
        f"do not hold ({'; '.join(beyond)}): `calibrate` says which they are, and --free counts them"
    ]


def _gaps(planned: "Plan") -> tuple[list[str], tuple[int, str] | None]:
    """Return a warning of what a survey leaves undetermined, and the failure of a plan that keeps it.

    The failure is an exit code and words; None where everything is determined after the stations.
    """
    if not planned.undetermined:
        return [], None
    words = (
        f"WARNING: the recording leaves open: {'; '.join(planned.undetermined)}. "
        "Stations are chosen at an estimate that may be far off"
    )
    if planned.determined:
        return [words], None
    stations = count(len(planned.forecast), "station")
    return [words], (
        Exit.UNDETERMINED,
        f"{stations} would still leave something open: ask for more with --stations, or allow more "
        "room and larger turns in the table [workspace] of the rig file",
    )


def _result(path: Path, rig: "Rig") -> "tuple[Mounts, Mapping[str, Plate], list[str]]":
    """Return the mounts of a result, and its planes as plates that are known as well as it says.

    Lines say which freed errors of it a plan does not count at the stations to come.
    """
    from ..files.calibration_reading import SurveyFile, mounts_of, read_calibration
    from ..files.checked_text import in_file
    from ..planning.bounds import plate_of

    file = read_calibration(path)
    if isinstance(file, SurveyFile):
        found = "the result of a survey with --calibration"
        expected = "RECORDING in its place: stations of a survey are planned from what was read"
        raise InputError(found, expected, path)
    with in_file(path):
        mounts = mounts_of(file)
    if rig.workspace is None:
        raise InputError("a result without a workspace", "the table [workspace] of the rig file")
    middle, plates = 0.5 * (rig.workspace.low + rig.workspace.high), {}
    for plane in file.planes:
        sigma = plane.sigma
        known = (None, None) if sigma is None else (sigma.offset_m, sigma.normal_rad)
        plates[plane.name] = plate_of(plane.normal, plane.offset_m, middle, known)
    words = ", ".join(dict.fromkeys(effect.code for effect in file.effects))
    line = (
        f"the stations are taken to be without the freed errors {words} of {path}: a plan counts them "
        f"with RECORDING and --free {words} instead of --calibration"
    )
    return mounts, plates, [line] if words else []
