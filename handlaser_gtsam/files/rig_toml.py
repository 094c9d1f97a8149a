"""Rig files: what is known about sensors and robot, in the units people use.

    [noise]   range_sigma_mm, incidence_sigma_mm, pose_translation_sigma_mm, pose_rotation_sigma_deg,
              or instead of the latter two pose_covariance: 6 x 6 over (rx, ry, rz, x, y, z), SI units;
              pose_translation_prior_mm, pose_rotation_prior_deg: what pose sigmas that are not given
              are expected to be
    [sensor]  range_mm = [min, max], max_incidence_deg, linearity_percent
    [limits]  rms_mm, location_sigma_mm, direction_sigma_deg
    [workspace], [blind], [goal], [placement]: for plans, see `rig_planning`

Every table is optional, and so is every field but those that say where something is.
"""

import math
import tomllib
from dataclasses import dataclass, field
from pathlib import Path
from typing import overload

import numpy as np
from pydantic import ValidationError

from ..arrays import FloatArray
from ..data.noise import Noise
from ..errors import InputError
from ..model.sensor import Sensor
from ..planning.bounds import Bounds
from ..planning.goal import Goal
from ..planning.plate import Placement
from ..planning.workspace import Workspace
from ..results.limits import Limits
from ..text import shown
from .rig_planning import BlindTable, GoalTable, PlacementTable, Table, WorkspaceTable
from .writing import path_of, write_text


class _Noise(Table):
    range_sigma_mm: float | None = None
    incidence_sigma_mm: float | None = None
    pose_translation_sigma_mm: float | None = None
    pose_rotation_sigma_deg: float | None = None
    pose_covariance: list[list[float]] | None = None
    pose_translation_prior_mm: float | None = None
    pose_rotation_prior_deg: float | None = None


class _Sensor(Table):
    range_mm: list[float] | None = None
    max_incidence_deg: float | None = None
    linearity_percent: float | None = None


class _Limits(Table):
    rms_mm: float | None = None
    location_sigma_mm: float | None = None
    direction_sigma_deg: float | None = None


class _Rig(Table):
    noise: _Noise = _Noise()
    sensor: _Sensor = _Sensor()
    limits: _Limits = _Limits()
    workspace: WorkspaceTable | None = None
    blind: BlindTable | None = None
    goal: GoalTable = GoalTable()
    placement: PlacementTable = PlacementTable()


@dataclass(frozen=True, slots=True)
class Rig:
    """A rig file in SI units.

    Attributes
    ----------
    noise : Noise
    sensor : Sensor
    limits : Limits
    workspace : Workspace or None
        Where the hand may go.
    bounds : Bounds or None
        Where beams and plate roughly are, before any reading.
    goal : Goal
        What to plan for; the limits stand in it where it states nothing else.
    placement : Placement
        How the plate can be put anew.
    """

    noise: Noise = field(default_factory=Noise)
    sensor: Sensor = field(default_factory=Sensor)
    limits: Limits = field(default_factory=Limits)
    workspace: Workspace | None = None
    bounds: Bounds | None = None
    goal: Goal = field(default_factory=Goal)
    placement: Placement = field(default_factory=Placement)


def read_rig(path: Path | str) -> Rig:
    """Read a rig file.

    Raises
    ------
    InputError
        No TOML, an unknown table or field, or a value that cannot be.
    """
    path = path_of(path)
    try:
        text = path.read_bytes().decode("utf-8").removeprefix("\ufeff").replace("\r\n", "\n")
        rig = _Rig.model_validate(tomllib.loads(text))
    except OSError as error:
        raise InputError(f"no readable file ({error.strerror})", "a rig file", path) from error
    except UnicodeDecodeError as error:
        byte = error.object[error.start]
        found = f"the byte 0x{byte:02x}, which is not UTF-8, at offset {error.start}"
        raise InputError(found, "a rig file in TOML", path) from error
    except ValidationError as error:
        raise _first_fault(error, path) from error
    except (ValueError, RecursionError) as error:  # ValueError: TOML, and endless integers
        what = str(error).split(";")[0].splitlines()[0][:120]
        raise InputError(f"no TOML ({what})", "a rig file in TOML", path) from error
    try:
        return _to_si(rig)
    except InputError as error:
        raise InputError(error.found, error.expected, path) from error


def _to_si(rig: _Rig) -> Rig:
    mm, deg = 1e-3, math.pi / 180.0
    span, incidence = rig.sensor.range_mm, rig.sensor.max_incidence_deg
    if span is None:
        span = [0.0, math.inf]
    if len(span) != 2:
        raise InputError(f"sensor.range_mm of {len(span)} numbers", "[least, largest]")
    given = Noise(), Sensor()
    linearity = rig.sensor.linearity_percent
    limits = Limits(
        scaled(rig.limits.rms_mm, mm),
        scaled(rig.limits.location_sigma_mm, mm),
        scaled(rig.limits.direction_sigma_deg, deg),
    )
    return Rig(
        Noise(
            scaled(rig.noise.range_sigma_mm, mm),
            scaled(rig.noise.pose_translation_sigma_mm, mm),
            scaled(rig.noise.pose_rotation_sigma_deg, deg),
            scaled(rig.noise.incidence_sigma_mm, mm, given[0].incidence_sigma),
            _matrix(rig.noise.pose_covariance),
            scaled(rig.noise.pose_translation_prior_mm, mm, given[0].pose_translation_prior),
            scaled(rig.noise.pose_rotation_prior_deg, deg, given[0].pose_rotation_prior),
        ),
        Sensor(
            span[0] * mm,
            span[1] * mm,
            math.radians(90.0 if incidence is None else incidence),
            given[1].linearity if linearity is None else 0.01 * linearity,
        ),
        limits,
        None if rig.workspace is None else rig.workspace.to_si(),
        None if rig.blind is None else rig.blind.to_si(),
        rig.goal.to_si().within(limits),
        rig.placement.to_si(),
    )


def _matrix(rows: list[list[float]] | None) -> FloatArray | None:
    """Return the rows as a 6 x 6 matrix."""
    if rows is None:
        return None
    if [len(row) for row in rows] != [6] * 6:
        raise InputError(
            f"noise.pose_covariance of {len(rows)} rows of {sorted({len(row) for row in rows})}",
            "6 rows of 6 numbers",
        )
    return np.array(rows, dtype=np.float64)


def write_rig(path: Path | str, noise: Noise, sensor: Sensor) -> None:
    """Write the noise and the sensor's range; unknown values are left out."""
    lines = ["[noise]"]
    for name, value, unit in (
        ("range_sigma_mm", noise.range_sigma, 1e3),
        ("pose_translation_sigma_mm", noise.pose_translation_sigma, 1e3),
        ("pose_rotation_sigma_deg", noise.pose_rotation_sigma, 180.0 / math.pi),
        ("incidence_sigma_mm", noise.incidence_sigma or None, 1e3),
    ):
        if value is not None:
            lines.append(f"{name} = {value * unit:.12g}")
    if noise.pose_covariance is not None and noise.pose_covariance.ndim == 2:
        lines.append(f"pose_covariance = {noise.pose_covariance.tolist()}")
    if math.isfinite(sensor.range_max):
        least, most = sensor.range_min * 1e3, sensor.range_max * 1e3
        lines += ["", "[sensor]", f"range_mm = [{least:.12g}, {most:.12g}]"]
    write_text(path_of(path), "\n".join(lines) + "\n")


@overload
def scaled(value: float | None, unit: float, otherwise: float) -> float: ...
@overload
def scaled(value: float | None, unit: float, otherwise: None = None) -> float | None: ...
def scaled(value: float | None, unit: float, otherwise: float | None = None) -> float | None:
    """Return a value in SI units, or what stands for one that is not given."""
    return otherwise if value is None else value * unit


def _first_fault(error: ValidationError, path: Path) -> InputError:
    fault = error.errors()[0]
    field = ".".join(str(part) for part in fault["loc"])
    if fault["type"] == "extra_forbidden":
        tables: dict[str, type[Table]] = {
            "noise": _Noise,
            "sensor": _Sensor,
            "limits": _Limits,
            "workspace": WorkspaceTable,
            "blind": BlindTable,
            "goal": GoalTable,
            "placement": PlacementTable,
        }
        table: type[Table] = _Rig if len(fault["loc"]) == 1 else tables[str(fault["loc"][0])]
        names = ", ".join(table.model_fields)
        return InputError(f"the unknown field {shown(field)[1:-1]}", f"one of {names}", path)
    return InputError(f"{field} = {shown(fault['input'])}", fault["msg"], path)
