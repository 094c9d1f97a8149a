"""Stations to drive to as CSV: a recording without readings.

Columns: `plane`, `station`, `x, y, z, qx, qy, qz, qw` (world_T_hand, metres), as in a recording, and
with an arm `joint_NAME` for each of its joints (radians; metres where it slides). Who fills in
`range_NAME` for every beam has a recording; columns of ranges are ignored here.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import polars as pl

from ..checks import require_kind
from ..data.station_list import StationList
from .recording_csv import POSE, station_columns, stations_of
from .table import column_numbers, read_table
from .writing import path_of, write_text

JOINT = "joint_"
"""Before the names of joints; a recording ignores such columns."""


def write_stations(path: Path | str, stations: StationList) -> None:
    """Write stations; every number reads back as it was.

    Raises
    ------
    InputError
        What is no `StationList`, or a file that cannot be written.
    """
    require_kind("stations", stations, StationList)
    table = station_columns(stations)
    if stations.joints is not None:
        names = [JOINT + name for name in stations.joint_names]
        table = table.hstack(pl.DataFrame(stations.joints, schema=names, orient="row"))
    write_text(path_of(path), table.write_csv())


def read_stations(path: Path | str) -> StationList:
    """Read the stations of a file, in their order; a recording is such a file, too.

    Raises
    ------
    InputError
        The first fault of the file: its line and column, what was found, what was expected.
    """
    table = read_table(path_of(path), ("plane", *POSE))
    table.require("plane", *POSE)
    last = table.frame.columns[-1]
    if last in POSE or last.startswith(JOINT):
        table.refuse_cut()
    stations = stations_of(table)
    columns = [name for name in table.frame.columns if name.startswith(JOINT)]
    if not columns:
        return stations
    joints = np.stack([column_numbers(table, name) for name in columns], axis=1)
    names = tuple(name.removeprefix(JOINT) for name in columns)
    return replace(stations, joints=joints, joint_names=names)
