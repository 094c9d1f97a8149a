"""The verdict and the head of a report; at its end what to do next, and how it was made."""

import sys
from collections.abc import Iterator
from importlib.metadata import version
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from ... import __version__
from ...quantities import IN_MM, IN_PERCENT
from ...results.description.evidence import rejected_words
from ...results.description.tables import (
    Facts,
    Table,
    concise,
    number,
    of_numbers,
    of_words,
    sentence,
    text,
)
from ...results.lines import NAMES_ON_PAGE
from ...text import count, printable, some
from .options import changed_on, sha256
from .subject import Subject

FRAMES = (
    "Mounts in the hand frame, which the recorded poses describe; planes and stations in the world "
    "frame, in which they are given. Lengths in mm, angles in deg, k1 without unit, k2 in 1/m."
)
LIBRARIES = ("gtsam", "numpy", "scipy")


def title_of(subject: Subject) -> str:
    """Return what is reported on."""
    name = _name(subject.options.recording_file)
    return f"Calibration of {name}" if name else "Calibration"


def warnings_of(subject: Subject) -> tuple[str, ...]:
    """Return warnings of the calibration, and of the planes that were held out, as sentences."""
    contradicting = (
        f"plane {plane} contradicts the beams found without it" for plane in subject.contradicting
    )
    return tuple(map(sentence, (*subject.warnings, *contradicting)))


def head_facts(subject: Subject) -> Facts:
    """Return what was calibrated."""
    return tuple((term, words) for term, words in _facts(subject) if words)


def _facts(subject: Subject) -> Iterator[tuple[str, str]]:
    calibration, recording = subject.calibration, subject.calibration.recording
    yield "date", _date(subject)
    yield "made by", f"handlaser_gtsam {__version__}"
    for kind, path in subject.options.sources:
        yield kind, _name(path)
        yield "its SHA-256", sha256(path)
    yield "robot", _robot(subject)
    yield "sensor", _sensor(subject)
    yield "beams", f"{len(calibration.beams)}: {some(list(calibration.beams), NAMES_ON_PAGE)}"
    yield "planes", f"{len(calibration.planes)}: {some(list(calibration.planes), NAMES_ON_PAGE)}"
    if recording is not None:
        read = np.atleast_1d((~np.isnan(recording.ranges)).any(axis=1))
        merged = "" if read.all() else f" with readings, of {len(read)}"
        yield "stations", f"{read.sum()}{merged}"
    yield "readings", f"{calibration.fit.readings} used, {rejected_words(subject)}"
    if recording is not None and recording.ignored_columns:
        yield "columns not used", some(recording.ignored_columns, NAMES_ON_PAGE)
    yield "frames and units", FRAMES


def _date(subject: Subject) -> str:
    options = subject.options
    if options.day is not None:
        return options.day.isoformat()
    if options.recording_file is not None:
        return f"{changed_on(options.recording_file).isoformat()} (of the recording's file)"
    return "not stated"


def _name(path: Path | str | None) -> str:
    return "" if path is None else printable(Path(path).name)


def _model(subject: Subject) -> str:
    """Return what was estimated and how, as far as a calibration tells."""
    calibration = subject.calibration
    terms = sorted({beam.terms for beam in calibration.beams.values()})
    names = [("no range error", "k1", "k1 and k2")[term] for term in terms]
    scaled = " under learned scales" if calibration.range_error_scales is not None else ""
    fit = calibration.fit
    return f"range errors: {', '.join(names)}{scaled}; hand poses {fit.poses}; {fit.loss} loss"


def _robot(subject: Subject) -> str:
    workspace = subject.options.rig.workspace
    if workspace is None or workspace.robot is None:
        return "not stated"
    return f"{_name(workspace.robot.urdf)}, hand frame {printable(workspace.robot.frame)}"


def _sensor(subject: Subject) -> str:
    sensor = subject.options.rig.sensor
    parts = [] if sensor.kind is None else [sensor.kind]
    if sensor.range_stated:
        parts.append(f"reads {sensor.range_min * IN_MM:.6g} to {sensor.range_max * IN_MM:.6g} mm")
    if sensor.max_incidence < np.pi / 2.0:
        parts.append(f"up to {np.degrees(sensor.max_incidence):.4g} deg of incidence")
    parts.append(f"expected linear to {IN_PERCENT * sensor.linearity:.3g} % of a reading")
    return ", ".join(parts)


def promise(subject: Subject) -> str:
    """Return what the next best stations promise; empty where none were chosen."""
    plan = subject.plan
    if plan is None or not subject.solved:
        return ""
    return (
        f"After {count(len(plan), 'station')} more, at the poses below: "
        f"{plan.forecast.words(len(plan))} (now {plan.forecast.words(0)})."
    )


def plan_table(subject: Subject) -> Table | None:
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
        if not np.isnan(plan.ranges[j]).all()
    )
    columns = (*of_words("plane"), *of_numbers("x mm", "y mm", "z mm", "qx", "qy", "qz", "qw"))
    return Table("next", "Hand poses world_T_hand.", columns, rows)


def made_facts(subject: Subject) -> Facts:
    """Return how the calibration and this report were made."""
    calibration, options = subject.calibration, subject.options
    start = calibration.start
    python = ".".join(map(str, sys.version_info[:3]))
    libraries = ", ".join(f"{name} {version(name)}" for name in LIBRARIES)
    given = options.rig.noise
    facts = (
        ("program", f"handlaser_gtsam {__version__}, Python {python}, {libraries}"),
        ("command", printable(options.command)),
        *(
            (f"{kind} file", f"{printable(str(path))}, SHA-256 {sha256(path)}")
            for kind, path in options.sources
        ),
        (
            "range sigma",
            "estimated"
            if given.range_sigma is None
            else f"{concise(given.range_sigma * IN_MM)} mm, given",
        ),
        ("model", _model(subject)),
        ("start", f"{start.method}; {count(len(start.tried), 'start')} tried"),
        ("iterations", str(calibration.iterations)),
        ("status", calibration.status.replace("_", " ")),
        ("message", calibration.message),
    )
    return tuple((term, words) for term, words in facts if words)
