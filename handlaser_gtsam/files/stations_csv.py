"""Stations to drive to as CSV: a recording without readings.

Columns: `plane`, `station`, `x, y, z, qx, qy, qz, qw` (world_T_hand, metres), as in a recording. Who
fills in `range_NAME` for every beam has one; columns of ranges are ignored here.
"""

from pathlib import Path

from ..checks import require_kind
from ..data.station_list import StationList
from .recording_csv import POSE, station_columns, stations_of
from .table import read_table
from .writing import path_of, write_text


def write_stations(path: Path | str, stations: StationList) -> None:
    """Write stations; every number reads back as it was.

    Raises
    ------
    InputError
        What is no `StationList`, or a file that cannot be written.
    """
    require_kind("stations", stations, StationList)
    write_text(path_of(path), station_columns(stations).write_csv())


def read_stations(path: Path | str) -> StationList:
    """Read the stations of a file, in their order; a recording is such a file, too.

    Raises
    ------
    InputError
        The first fault of the file: its line and column, what was found, what was expected.
    """
    table = read_table(path_of(path), ("plane", *POSE))
    for name in ("plane", *POSE):
        if name not in table.frame.columns:
            raise table.fault(f"no column {name!r}", f"{name!r}", name)
    if table.frame.columns[-1] in POSE:
        table.refuse_cut()
    return StationList(*stations_of(table))
