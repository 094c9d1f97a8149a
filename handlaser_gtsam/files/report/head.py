"""What a report says of files, sensor, robot and programs, for its template; and the next stations."""

import sys
from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from ... import __version__
from ...quantities import IN_MM, IN_PERCENT
from ...results.description.tables import Table, number, sentence, table_of, text
from ...text import printable
from .options import ReportOptions, changed_on, sha256
from .subject import Subject

LIBRARIES = ("gtsam", "numpy", "scipy")


def title_of(options: ReportOptions) -> str:
    """Return what is reported on."""
    file = options.recording_file
    return "Calibration" if file is None else f"Calibration of {printable(Path(file).name)}"


def date_of(options: ReportOptions) -> str:
    """Return the date of the recording behind a report; empty where it has no file."""
    if options.recording_file is None:
        return ""
    return f"{changed_on(options.recording_file).isoformat()} (of the recording's file)"


def head_of(subject: Subject) -> Mapping[str, object]:
    """Return what the sections on what was calibrated, and how it was made, are filled with."""
    options, recording = subject.options, subject.calibration.recording
    sensor = options.rig.sensor
    parts = [] if sensor.kind is None else [sensor.kind]
    if sensor.range_stated:
        parts.append(f"reads {sensor.range_min * IN_MM:.6g} to {sensor.range_max * IN_MM:.6g} mm")
    if sensor.max_incidence < np.pi / 2.0:
        parts.append(f"up to {np.degrees(sensor.max_incidence):.4g} deg of incidence")
    parts.append(f"expected linear to {IN_PERCENT * sensor.linearity:.3g} % of a reading")
    contradiction = subject.held_out.contradiction
    contradicting = [contradiction] if contradiction else []
    ranges = np.empty((0, 1)) if recording is None else recording.ranges
    return {
        "warnings": tuple(map(sentence, (*subject.warnings, *contradicting))),
        "date": date_of(options) or "not stated",
        "version": __version__,
        "python": ".".join(map(str, sys.version_info[:3])),
        "libraries": [f"{name} {version(name)}" for name in LIBRARIES],
        "files": [
            (kind, printable(str(path)), printable(Path(path).name), sha256(path))
            for kind, path in options.sources
        ],
        "sensor": ", ".join(parts),
        "merged": (int((~np.isnan(ranges)).any(axis=1).sum()), len(ranges)),
        "terms": sorted({beam.terms for beam in subject.calibration.beams.values()}),
        "plan": _plan_table(subject),
    }


def _plan_table(subject: Subject) -> Table | None:
    """Return the next best stations; None where none were chosen."""
    plan = subject.plan
    if plan is None or not subject.solved:
        return None
    stations = plan.stations
    quaternions = Rotation.from_matrix(stations.world_R_hand).as_quat(canonical=True)
    rows = tuple(
        (
            text(stations.plane_labels[j]),
            *(number(x * IN_MM, 1) for x in stations.world_t_hand[j].tolist()),
            *(number(x, 4) for x in quaternions[j].tolist()),
        )
        for j in range(len(stations.plane_labels))
        if plan.read[j]
    )
    return table_of("next", rows)
