"""Rig files: what is known about sensors and robot, in the units people use.

    [noise]   range_sigma_mm, aiming_sigma_mm (of beams that are aimed at points), incidence_sigma_mm,
              pose_translation_sigma_mm, pose_rotation_sigma_deg, or instead of the latter two
              pose_covariance: 6 x 6 over (rx, ry, rz, x, y, z), SI units;
              pose_translation_prior_mm, pose_rotation_prior_deg: what pose sigmas that are not given
              are expected to be
    [sensor]  range_mm = [min, max], max_incidence_deg, linearity_percent, kind: triangulation,
              time-of-flight, confocal, ultrasonic or other; half_angle_deg of cones
    [plausible]  largest plausible sizes of systematic errors, instead of the sizes of the kind:
              incidence_mm, tilt_mm, linear_mm, quadratic_mm, cubic_mm, drift_mm, carry_over_percent,
              beam_on_plane_mm, sag_mm, displaced_mm, tool_displaced_mm, lag_percent,
              turn_scale_percent, translation_scale_percent
    [limits]  rms_mm, location_sigma_mm, direction_sigma_deg
    [log]     how logs are written, a field for every one of `LogFormat`
    [[sensors]], [[known]]: sensors of many rays and relations, see `sensor_tables`
    [workspace], [robot], [blind], [goal], [placement]: for plans, see `rig_planning`

Every table is optional, and so is every field but those that say where something is.
"""

import math
import os
import re
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, get_args, get_origin

import numpy as np
from pydantic import Field, Strict, create_model

from ..arrays import FloatArray
from ..checks import require_number
from ..data.noise import Noise
from ..errors import InputError
from ..model.effects.plausible import FIELDS, Plausible
from ..model.sensor_limits import Sensor
from ..quantities import IN_DEG, IN_MM, LARGEST_LENGTH, WIDEST_CONE
from ..results.limits import Limits
from ..text import shown, some
from .checked_text import (
    FileRecord,
    checked,
    in_file,
    in_table,
    made,
    numbers,
    read_text,
    read_value,
    square_matrix,
    toml_table,
)
from .logs.format import LogFormat
from .logs.format_checks import EXCLUSIVE
from .rig_planning import PlanTables
from .sensor_tables import SINGLE, SurveyRig, SurveyTables
from .writing import path_of, write_text

if TYPE_CHECKING:  # calibrating needs none of it
    from ..planning.bounds import Bounds, Placement
    from ..planning.goal import Goal
    from ..planning.workspace import Workspace

RIG_FILE = "a rig file, TOML"
OPTION = re.compile(r"`handlaser [^`]*`|--([a-z][a-z-]*)")
"""An option by itself; a command to type keeps its own."""
NAMES = tuple(one.name for one in fields(LogFormat))


def _plain(kind: Any) -> Any:
    """Return the type of a field in TOML, or None where it is not stated."""
    if get_origin(kind) is tuple:
        return list[get_args(kind)[0]] | None  # type: ignore[misc]  # computed
    for plain in (bool, float):
        if kind is plain or plain in get_args(kind):
            return plain | None
    return str | None


_FIELDS: Any = {one.name: (_plain(one.type), None) for one in fields(LogFormat)}


class LogTable(create_model("Fields", __base__=FileRecord, **_FIELDS)):  # type: ignore[misc]
    """The table [log] of a rig file."""

    def to_format(self, folder: Path) -> LogFormat:
        """Return the format; files are named from a folder on.

        Raises
        ------
        InputError
        """
        stated: dict[str, object] = {
            name: tuple(value) if isinstance(value, list) else value
            for name, value in self.model_dump(exclude_none=True).items()
        }
        for name in ("readings", "plane_file"):
            if name in stated:
                stated[name] = folder / str(stated[name])
        with naming_fields(), in_table("log", self):
            return with_stated(LogFormat(), stated)


def as_fields(words: str) -> str:
    """Return words with fields of the table in place of the options of `convert`."""

    def field(option: re.Match[str]) -> str:
        name = (option[1] or "").replace("-", "_")
        return f"log.{name}" if name in NAMES else option[0]

    return OPTION.sub(field, words)


@contextmanager
def naming_fields(hint: str = "") -> Iterator[None]:
    """Let what is said of the options of `convert` name the fields of the table [log]; with a hint."""
    try:
        yield
    except InputError as error:
        found, expected = as_fields(error.found), as_fields(error.expected)
        if (found, expected) == (error.found, error.expected):
            raise
        raise InputError(found, expected + hint, error.path, error.line, error.column) from error


def table_of(given: LogFormat, folder: Path) -> str:
    """Return the table [log] that says how logs are written, with files named from a folder on.

    Raises
    ------
    InputError
        Nothing is stated.
    """
    plain, stated = LogFormat(), dict[str, object]()
    for name in NAMES:
        value = getattr(given, name)
        if value != getattr(plain, name):
            is_path = isinstance(value, Path)
            stated[name] = (
                os.path.relpath(value.absolute(), folder.absolute()) if is_path else value
            )
    if not stated:
        expected = "an option that says how the log is written, such as --pose-format"
        raise InputError("nothing that a table [log] could say", expected)
    return toml_table("[log]", stated)


def with_stated(known: LogFormat, given: Mapping[str, object]) -> LogFormat:
    """Return a format with what is `given` instead; names of no field are passed over.

    Raises
    ------
    InputError
        Values that cannot be, or contradict each other.
    """
    stated = {name: given[name] for name in NAMES if given.get(name) is not None}
    plain = LogFormat()
    for group in EXCLUSIVE:
        if any(name in stated for name in group):
            for name in group:
                stated.setdefault(name, getattr(plain, name))
    return replace(known, **stated) if stated else known  # type: ignore[arg-type]  # checked there


class NoiseTable(
    numbers(  # type: ignore[misc]  # computed
        "range_sigma_mm incidence_sigma_mm pose_translation_sigma_mm pose_rotation_sigma_deg"
        " pose_translation_prior_mm pose_rotation_prior_deg"
    )
):
    """The table [noise] of a rig file."""

    pose_covariance: list[list[float]] | None = None


class _Noise(NoiseTable):
    aiming_sigma_mm: float | None = None


class _Sensor(FileRecord):
    range_mm: Annotated[tuple[float, ...], Strict(False)] | None = None
    max_incidence_deg: float | None = None
    half_angle_deg: float | None = None
    linearity_percent: float | None = None
    kind: str | None = None


class _Plausible(numbers(" ".join(FIELDS.values()))):  # type: ignore[misc]  # computed
    """The table [plausible]."""


class _Limits(numbers("rms_mm location_sigma_mm direction_sigma_deg")):  # type: ignore[misc]
    """The table [limits]."""


class _Rig(PlanTables, SurveyRig):
    noise: _Noise = _Noise()
    sensor: Annotated[_Sensor, Field(description="which is of single beams")] = _Sensor()
    plausible: _Plausible = _Plausible()
    limits: _Limits = _Limits()
    log: LogTable = LogTable()


@dataclass(frozen=True, slots=True)
class Rig:
    """A rig file in SI units.

    Attributes
    ----------
    noise : Noise
    sensor : Sensor
    limits : Limits
    log : LogFormat
        How logs are written.
    survey : SurveyTables or None
        Sensors of many rays, and relations; None where there are none.
    aiming_sigma : float, optional
        Standard deviation of a spot across its ray where beams are aimed at points [m].
    half_angle : float
        Half the opening angle of the cone in which each single sensor reads what is nearest [rad], as
        ultrasonic ones do; zero of beams, and `survey` may say another of one. Recordings of cones are
        surveys.
    workspace : Workspace or None
        Where the hand may go, and the robot that is to reach it.
    bounds : Bounds or None
        Where beams and plate roughly are, before any reading.
    stated_goal : Goal or None
        What to plan for, as it is stated.
    stated_placement : Placement or None
        How the plate can be placed again, as it is stated.
    """

    noise: Noise = field(default_factory=Noise)
    sensor: Sensor = field(default_factory=Sensor)
    limits: Limits = field(default_factory=Limits)
    log: LogFormat = field(default_factory=LogFormat)
    survey: SurveyTables | None = None
    aiming_sigma: float | None = None
    half_angle: float = 0.0
    workspace: "Workspace | None" = None
    bounds: "Bounds | None" = None
    stated_goal: "Goal | None" = None
    stated_placement: "Placement | None" = None

    @property
    def many_rays(self) -> bool:
        """Whether there are sensors of many rays."""
        return self.survey is not None and bool(self.survey.sensors)

    def of_beams(self, names: Sequence[str]) -> tuple[FloatArray, FloatArray]:
        """Return the half angles [rad] and stated sigmas [m] of named beams (B,): 0 and NaN for none.

        Raises
        ------
        InputError
            A beam in [[sensors]] that is none of these.
        """
        tables = {} if self.survey is None else self.survey.beams
        for name in tables:
            if name not in names:
                found = f"{name} of kind = {shown(SINGLE)} in [[sensors]], of which nothing is read"
                raise InputError(found, f"one of the single beams: {some(names, 8) or 'none'}")
        given = [tables[name].in_si() if name in tables else {} for name in names]
        cones = [one.get("half_angle", self.half_angle) for one in given]
        sigmas = [one.get("sigma", np.nan) for one in given]
        return np.array(cones, dtype=np.float64), np.array(sigmas, dtype=np.float64)

    @property
    def goal(self) -> "Goal":
        """What to plan for; the limits stand in it where it states nothing else."""
        from ..planning.goal import Goal

        return (self.stated_goal or Goal()).within(self.limits)

    @property
    def placement(self) -> "Placement":
        """How the plate can be placed again."""
        from ..planning.bounds import Placement

        return self.stated_placement or Placement()


def read_rig(path: Path | str) -> Rig:
    """Read a rig file.

    Raises
    ------
    InputError
        No TOML, an unknown table or field, or a value that cannot be.
    """
    return _read(path_of(path))[1]


def known_rig(path: Path | None, given: Mapping[str, object]) -> Rig:
    """Return a rig file, if there is one, with what is `given` instead, None where nothing is.

    The names in `given` are fields of the file; others are passed over. A pose sigma replaces a
    covariance.

    Raises
    ------
    InputError
        As `read_rig`, or a value given that cannot be.
    """
    rig = _Rig() if path is None else _read(path)[0]
    stated = {name: value for name, value in given.items() if value is not None}
    if {"pose_translation_sigma_mm", "pose_rotation_sigma_deg"} & stated.keys():
        stated["pose_covariance"] = None
    tables: dict[str, object] = {}
    for name, table in (("noise", rig.noise), ("sensor", rig.sensor)):
        own = {field: stated[field] for field in type(table).model_fields if field in stated}
        tables[name] = table.model_copy(update=own)
    found = _to_si(rig.model_copy(update=tables), Path() if path is None else path.parent)
    return replace(found, log=with_stated(found.log, given))


def _read(path: Path) -> tuple[_Rig, Rig]:
    rig = checked(read_value(path, toml_value, RIG_FILE), _Rig, RIG_FILE, path)
    with in_file(path):
        return rig, _to_si(rig, path.parent)


def toml_value(text: str) -> dict[str, Any]:
    """Return the content of a TOML text; raises a ValueError."""
    return tomllib.loads(text.removeprefix("\ufeff").replace("\r\n", "\n"))


def _to_si(rig: _Rig, folder: Path) -> Rig:
    given = rig.sensor.in_si()
    span = given.pop("range", (0.0, math.inf))
    half_angle = given.pop("half_angle", 0.0)
    if len(span) != 2:
        raise InputError(f"sensor.range_mm of {len(span)} numbers", "[least, largest]")
    limits = made("limits", rig.limits, Limits)
    plausible = made("plausible", rig.plausible, Plausible)
    with in_table("sensor", rig.sensor):
        least, most = map(float, span)
        sensor = Sensor(least, most, plausible=plausible, **given)
        require_number("half_angle", half_angle, 0.0, WIDEST_CONE, unit="rad")
    aiming = rig.noise.in_si().get("aiming_sigma")
    if aiming is not None:
        with in_table("noise", rig.noise):
            require_number("aiming_sigma", aiming, 0.0, LARGEST_LENGTH, above=True, unit="m")
    log, survey = rig.log.to_format(folder), rig.survey(folder)
    noise = noise_of(rig.noise.model_copy(update={"aiming_sigma_mm": None}))
    plans = rig.in_plans(folder)
    return Rig(noise, sensor, limits, log, survey, aiming, half_angle, **plans)


def noise_of(table: NoiseTable, name: str = "noise") -> Noise:
    """Return the noise of a table in SI units; raises InputError for a value that cannot be."""
    given = {}
    if table.pose_covariance is not None:
        S = square_matrix(table.pose_covariance, 6, f"{name}.pose_covariance")
        given["pose_covariance"] = S
    return made(name, table, Noise, **given)


def write_rig(
    path: Path | str, noise: Noise, sensor: Sensor, more: str = "", half_angle: float = 0.0
) -> None:
    """Write the noise, the sensor's range and cone, and more tables; but nothing that is unknown."""

    def stated(value: float | None, unit: float) -> float | None:
        return None if value is None else float(f"{value * unit:.12g}")

    S = noise.pose_covariance
    fields = {
        "range_sigma_mm": stated(noise.range_sigma, IN_MM),
        "pose_translation_sigma_mm": stated(noise.pose_translation_sigma, IN_MM),
        "pose_rotation_sigma_deg": stated(noise.pose_rotation_sigma, IN_DEG),
        "incidence_sigma_mm": stated(noise.incidence_sigma or None, IN_MM),
        "pose_covariance": None if S is None or S.ndim != 2 else S.tolist(),
    }
    text, bounded = toml_table("[noise]", fields), math.isfinite(sensor.range_max)
    if bounded or half_angle:
        ends = [stated(end, IN_MM) for end in (sensor.range_min, sensor.range_max)]
        fields = {"range_mm": ends if bounded else None}
        fields["half_angle_deg"] = stated(half_angle or None, IN_DEG)
        text += "\n" + toml_table("[sensor]", fields)
    write_text(path_of(path), text + more)


def with_log_table(path: Path | str, log: LogFormat) -> str:
    """Return the text of a rig file, which may not exist yet, with how logs are written as its [log].

    Raises
    ------
    InputError
        No rig file, one with a table [log] that says another thing, or nothing to say.
    """
    path = path_of(path)
    table = table_of(log, path.parent)
    try:
        table.encode()
        wanted = LogTable.model_validate(toml_value(table)["log"]).to_format(path.parent)
    except ValueError as error:  # a character that UTF-8 or TOML does not have
        raise InputError(f"no table [log] ({error})", "printable names") from error
    if not path.exists():
        return table
    known, text = read_rig(path).log, read_text(path, RIG_FILE)
    if "log" not in toml_value(text):
        ends = "\r\n" if "\r\n" in text else "\n"
        gap = "" if not text else ends if text.endswith("\n") else 2 * ends
        return text + gap + table.replace("\n", ends)
    differ = [name for name in NAMES if getattr(known, name) != getattr(wanted, name)]
    if differ:
        found = f"a table [log] with other values of {', '.join(differ)}"
        expected = "the same values, a rig file without that table, or a new one"
        raise InputError(found, expected, path)
    return text
