"""Options that say how a log is written: those of the table [log] of the rig file."""

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated

import typer

from .listed import listed, numbers

Text = str | None
Flag = bool


@dataclass(frozen=True, slots=True)
class Log:
    """How a log is written, where it is no recording in CSV."""

    pose_format: Annotated[
        Text,
        typer.Option(
            help="Poses as written by: ros, kuka, abb, abb-euler, fanuc, yaskawa, ur, staubli, "
            "kawasaki, franka, matrix, tum, urdf-rpy, ... (docs/logs.md has all)."
        ),
    ] = None
    rotation: Annotated[
        Text,
        typer.Option(
            help="Instead of --pose-format: xyzw, wxyz, rotvec, matrix, matrix-columns, or Euler "
            "angles as SciPy spells them (ZYX, xyz); with --units and --angles."
        ),
    ] = None
    units: Annotated[Text, typer.Option(help="Of positions: m or mm.")] = None
    angles: Annotated[Text, typer.Option(help="Of rotations: deg or rad.")] = None
    inverted: Annotated[
        Flag, typer.Option("--inverted", help="Poses are hand_T_world (base in hand).")
    ] = False
    tool: Annotated[
        Text,
        typer.Option(
            metavar="NUMBERS",
            help="The tool that was active, as a pose of the log: the hand is then the flange.",
        ),
    ] = None
    base: Annotated[
        Text,
        typer.Option(
            metavar="NUMBERS",
            help="The base (work object) that was active: poses are then in the robot's frame.",
        ),
    ] = None
    pose_columns: Annotated[
        Text, typer.Option(metavar="NAMES", help="Columns of a pose in order: X,Y,Z,A,B,C.")
    ] = None
    plane_column: Annotated[Text, typer.Option(help="Column of plane labels.")] = None
    station_column: Annotated[Text, typer.Option(help="Column of station labels.")] = None
    time_column: Annotated[Text, typer.Option(help="Column of times.")] = None
    range_columns: Annotated[
        Text,
        typer.Option(
            metavar="NAMES",
            help="Columns of ranges, COLUMN or BEAM=COLUMN each: left=AI1,right=AI2; of bags topics, "
            "and TOPIC[INDEX] for a ray of a LaserScan.",
        ),
    ] = None
    beam_column: Annotated[
        Text, typer.Option(help="Column of beams in a long table, one row a reading.")
    ] = None
    range_column: Annotated[Text, typer.Option(help="Column of ranges in a long table.")] = None
    range_units: Annotated[Text, typer.Option(help="Of ranges: m (default) or mm.")] = None
    plane: Annotated[Text, typer.Option(help="The plane of all stations.")] = None
    plane_ranges: Annotated[
        Text,
        typer.Option(
            metavar="RANGES", help="Planes by stations, A=1..12,B=13..24, or times, A=0s..12.5s."
        ),
    ] = None
    plane_file: Annotated[Path | None, typer.Option(help="The same as CSV: plane,from,to.")] = None
    header: Annotated[
        Text, typer.Option(metavar="NAMES", help="Columns of a file that has no header.")
    ] = None
    delimiter: Annotated[
        Text, typer.Option(help="comma, semicolon, tab or space; default: recognised.")
    ] = None
    decimal: Annotated[Text, typer.Option(help="point or comma; default: recognised.")] = None
    sheet: Annotated[Text, typer.Option(help="Sheet of a workbook.")] = None
    readings: Annotated[
        Path | None,
        typer.Option(help="A second file, with the readings; joined by station or time."),
    ] = None
    readings_station_column: Annotated[
        Text, typer.Option(help="Column of station labels there, if it differs.")
    ] = None
    readings_time_column: Annotated[
        Text, typer.Option(help="Column of times there, if it differs.")
    ] = None
    time_units: Annotated[Text, typer.Option(help="Of times: s (default), ms, us or ns.")] = None
    tolerance_s: Annotated[
        float | None, typer.Option(help="How far pose and reading may be apart in time, s.")
    ] = None
    interpolate: Annotated[
        Flag, typer.Option("--interpolate", help="The arm moves: poses between their neighbours.")
    ] = False
    stands: Annotated[
        Flag,
        typer.Option("--stands", help="Stations are the moments at which the arm stands still."),
    ] = False
    stand_s: Annotated[float | None, typer.Option(help="Shortest stand, s (0.5).")] = None
    stand_mm: Annotated[
        float | None, typer.Option(help="How far the hand may move in a stand, mm (0.1).")
    ] = None
    stand_deg: Annotated[float | None, typer.Option(help="How far it may turn, deg (0.05).")] = None
    average: Annotated[
        Text, typer.Option(help="Of repeated readings: mean (default) or median.")
    ] = None
    lag_s: Annotated[
        float | None,
        typer.Option(help="How much later readings are stamped than poses of the same moment, s."),
    ] = None
    estimate_lag: Annotated[
        Flag, typer.Option("--estimate-lag", help="Estimate that from readings while it moves.")
    ] = False
    pose_topic: Annotated[Text, typer.Option(help="Of a bag: PoseStamped of the hand.")] = None
    frames: Annotated[
        Text, typer.Option(metavar="WORLD,HAND", help="Of a bag: instead, frames of tf.")
    ] = None
    receive_time: Annotated[
        Flag, typer.Option("--receive-time", help="Of a bag: not the stamps of headers.")
    ] = False
    range_sigma_from_scatter: Annotated[
        Flag,
        typer.Option(
            "--range-sigma-from-scatter",
            help="Take the scatter of repeated readings as range sigma, where none is given.",
        ),
    ] = False
    as_stated: Annotated[
        Flag,
        typer.Option("--as-stated", help="Read it so although it looks otherwise; warn only."),
    ] = False

    def stated(self) -> dict[str, object]:
        """Return what is given, under the names of the fields of the rig file."""
        found = {name: value for name, value in asdict(self).items() if value not in (None, False)}
        for name in ("pose_columns", "range_columns", "plane_ranges", "header", "frames"):
            if name in found:
                found[name] = listed(name, str(found[name]))
        for name in ("tool", "base"):
            if name in found:
                found[name] = numbers(name, str(found[name]))
        return found
