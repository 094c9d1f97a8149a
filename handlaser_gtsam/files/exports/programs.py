"""Stations as robot programs, and as poses in the convention of a controller.

A program drives from station to station, stops, and sets a digital output while a logger may read. At
stations on the way, which are named `via`, it does not stop. Where six joints of every station are
known it moves in the joints, as the ways of a plan are checked; else along lines.
"""

import csv
from io import StringIO

import numpy as np

from ...data.station_list import StationList
from ...model.conventions import FORMATS, numbers_of, spelled_columns
from ...planning.route import VIA
from ...quantities import IN_DEG
from .rendering import REMARK, comment_text, fixed, number, rendered
from .robot_languages import COLON, IN_JOINTS, PROGRAMS


def program_text(stations: StationList, to: str, signal: int, pause: float) -> str:
    """Return the program of some stations; it waits `pause` [s] before and while the signal is set.

    Each stop of a template has `words`, its name and plane, harmless in a comment; `pose`, its numbers
    in the convention of the program; `joints` [rad] in URScript, else [deg], none where the program
    moves along lines; and `read`, whether the program stops there.
    """
    x = numbers_of(stations.world_R_hand, stations.world_t_hand, FORMATS[PROGRAMS[to]])
    joints = stations.joints
    # An arm of another number of joints than six has axes that programs count in other ways.
    if to not in IN_JOINTS or joints is None or joints.shape[1] != 6:
        joints = np.empty((len(x), 0))
    names = zip(stations.station_names, stations.plane_labels, strict=True)
    write, unit = (number, 1.0) if to == "urscript" else (fixed, IN_DEG)
    stops = [
        {
            "words": _words(name, plane, COLON[to]),
            "pose": tuple(map(write, pose)),
            "joints": tuple(write(unit * joint) for joint in turned),
            "read": not name.startswith(VIA),
        }
        for (name, plane), pose, turned in zip(names, x.tolist(), joints.tolist(), strict=True)
    ]
    return rendered(to, stops=stops, signal=signal, pause=pause)


def _words(name: str, label: str, colon: str) -> str:
    """Return what a comment says of a station: its name, and its plane or another target."""
    kind = "target" if ":" in label else "plane"
    station = comment_text(name, colon)[: 2 * REMARK // 3]
    return f"station {station}, {kind} {comment_text(label, colon)}"


def poses_text(stations: StationList, pose_format: str) -> str:
    """Return a CSV of stations with the columns of a pose format (docs/logs.md)."""
    convention = FORMATS[pose_format]
    x = numbers_of(stations.world_R_hand, stations.world_t_hand, convention)
    turn = (convention.columns or spelled_columns(convention.rotation))[0]
    columns = turn if convention.is_matrix else ("x", "y", "z", *turn)
    text = StringIO()
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(("plane", "station", *columns))
    names = zip(stations.plane_labels, stations.station_names, strict=True)
    for pair, numbers in zip(names, x.tolist(), strict=True):
        rows.writerow((*pair, *map(number, numbers)))
    return text.getvalue()
