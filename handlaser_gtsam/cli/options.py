"""Options that several verbs share, in groups, and what becomes of them.

A verb takes a group as one argument; `expanded` gives the command line one option a field. What the
docstring of a verb or a group says of a parameter or a field is the help of its option. With
--log-level, what the package logs goes to stderr, a line each; without it, nothing does.
"""

import functools
import inspect
import logging
import math
import re
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from copy import copy
from dataclasses import asdict, dataclass, fields, is_dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, get_args, get_origin

import typer

from ..errors import ArgumentError, InputError
from ..progress import LOGGER
from .stopping import CLEAR

if TYPE_CHECKING:
    from ..data.survey import Survey
    from ..estimation.options import CalibrationOptions
    from ..files.logs.format import LogReport
    from ..files.rig_toml import Rig


FIELD = re.compile(r"(?m)^(\w+) : .*\n((?:^    .*\n)+)")
"""A parameter or a field in a docstring, and what is said of it."""
RecordingArgument = Annotated[
    Path,
    typer.Argument(
        help="Recording, CSV; or a log of a robot controller, a spreadsheet or a bag (docs/logs.md).",
        show_default=False,
    ),
]
JsonOption = Annotated[
    bool, typer.Option("--json", help="Print the result as JSON, and nothing else.")
]
AtRangeOption = Annotated[
    float | None,
    typer.Option(
        help="Working distance at which the laser spot's error is stated; default: median reading."
    ),
]
QuietOption = Annotated[bool, typer.Option("--quiet", "-q", help="Print no tables.")]
OutOption = Annotated[Path | None, typer.Option(readable=False)]
OneOrMore = Annotated[int | None, typer.Option(min=1)]
Seed = Annotated[int, typer.Option(min=0)]
RANGE = {"metavar": "MIN MAX", "help": "Range of the sensor, mm: --range-mm 0 30."}
KNOWN, HOW = "Noise and sensor, instead of the rig file", "How it is calibrated"
"""Sections of the help, behind the options that most people need."""
Known = Annotated[float | None, typer.Option(rich_help_panel=KNOWN)]
how = typer.Option(rich_help_panel=HOW)
LogLevel = Literal["debug", "info", "warning", "error"]
LogLevelOption = Annotated[
    LogLevel | None,
    typer.Option(help="Log to stderr: info, the stages; debug, every step of the solver, too."),
]


@dataclass(frozen=True, slots=True)
class Given:
    """What is known of noise and sensor: the rig file, and what the command line says instead.

    Attributes
    ----------
    rig : Path, optional
        Rig file, TOML: noise, sensor, limits, how logs are written.
    range_sigma_mm : float, optional
        Standard deviation of a reading, mm; estimated if not given.
    pose_translation_sigma_mm : float, optional
        Sigma of the hand position an axis, mm; estimated if not given.
    pose_rotation_sigma_deg : float, optional
        Sigma of the hand rotation about each axis, deg; estimated if not given.
    incidence_sigma_mm : float, optional
        Added to a reading's sigma times the tangent of the incidence, mm.
    range_mm : (float, float), optional
    max_incidence_deg : float, optional
        Largest angle between beam and plane normal, deg.
    """

    rig: Path | None = None
    range_sigma_mm: float | None = None
    pose_translation_sigma_mm: Known = None
    pose_rotation_sigma_deg: Known = None
    incidence_sigma_mm: Known = None
    range_mm: Annotated[
        tuple[float, float] | None, typer.Option(rich_help_panel=KNOWN, **RANGE)
    ] = None
    max_incidence_deg: Known = None

    def read(self) -> "Rig":
        """Return the rig file with what the command line says instead."""
        from ..files.rig_toml import known_rig

        return known_rig(self.rig, asdict(self))


@dataclass(frozen=True, slots=True)
class Model:
    """What is estimated.

    Attributes
    ----------
    range_error : str
        Terms of the true range d + k1 d + k2 d^2 of a reading d; auto: both, under a prior of zero mean
        whose scales are learned from all beams.
    poses : str
        How errors of the hand poses count; auto: marginalised, pose sigmas that are not given are
        estimated; exact: the robot is taken to make no errors, as with sigmas of zero.
    estimate_noise : bool
        Estimate the sigmas of ranges and poses even where they are given.
    range_sigma_by_beam : bool
        Estimate the range sigma of each beam, not only of those that are clearly rougher.
    free : str, optional
        Systematic errors that are unknowns, each under a prior of its plausible size: --free
        lag,incidence (docs/messages.md has all codes).
    """

    range_error: Annotated[Literal["auto", "none", "k1", "k1k2"], how] = "auto"
    poses: Annotated[Literal["auto", "exact", "marginalised", "estimated"], how] = "auto"
    estimate_noise: Annotated[bool, how] = False
    range_sigma_by_beam: Annotated[bool, how] = False
    free: Annotated[str | None, typer.Option(metavar="CODE,...", rich_help_panel=HOW)] = None

    def stated(self) -> list[str]:
        """Return the options that differ from their defaults, as they are called."""
        changed = (one.name for one in fields(self) if getattr(self, one.name) != one.default)
        return [f"--{name.replace('_', '-')}" for name in changed]

    def options(self, rig: "Rig", **more: object) -> "CalibrationOptions":
        """Return the options of a calibration with the sensor of `rig`, and more of its fields."""
        from ..estimation.options import CalibrationOptions
        from ..text import shown

        free = () if self.free is None else tuple(code.strip() for code in self.free.split(","))
        if not all(free):
            raise InputError(f"--free {shown(self.free)}", "codes, with one comma between two")
        by_beam = True if self.range_sigma_by_beam else None
        own = {"free": free, "sensor": rig.sensor, "range_sigma_by_beam": by_beam}
        return CalibrationOptions(**asdict(self) | more | own)


def metres(at_range_mm: float | None) -> float | None:
    """Return the reading of --at-range-mm in metres."""
    from ..checks import require_number
    from ..quantities import IN_MM, LARGEST_LENGTH, MM

    if at_range_mm is None:
        return None
    most = LARGEST_LENGTH * IN_MM
    require_number("--at-range-mm", at_range_mm, -most, most)
    return at_range_mm * MM


def read_stated(rig: "Rig", path: Path, stated: Sequence[str]) -> "tuple[Survey | LogReport, Rig]":
    """Read a recording or a survey; refuse what is stated and does not count with the latter.

    Raises
    ------
    InputError
    """
    from ..data.survey import Survey
    from ..files.input_reading import read_any_kind

    read, rig = read_any_kind(rig, path)
    if not isinstance(read, Survey):
        return read, rig
    fields = {
        "max_incidence_deg": rig.sensor.max_incidence < math.pi / 2.0,
        "incidence_sigma_mm": rig.noise.incidence_sigma > 0.0,
        "rms_mm in [limits]": rig.limits.rms is not None,
    }
    found = [*stated, *(name for name, given in fields.items() if given)]
    if found:
        words = f"{', '.join(found)}, with sensors of many rays, other targets or relations"
        expected = "it with beams before planes only (errors of a sensor are `free` in [[sensors]])"
        raise InputError(words, expected, path)
    return read, rig


def require_outputs_of(
    outputs: Mapping[str, Path | None], rig: "Rig", inputs: Sequence[Path | None]
) -> None:
    """Refuse files to write, by their options, that are an input, or that a rig file has read.

    Raises
    ------
    InputError
        Also a name that `points` with a * would take for the table of another station.
    """
    from ..files.writing import require_outputs

    tables = () if rig.survey is None else rig.survey.files
    require_outputs(outputs, (*inputs, *rig.log.files, *tables))
    if rig.survey is None:
        return
    for option, path in outputs.items():
        if path is not None and rig.survey.reads(path):
            found = f"{option} with a name that points in [[sensors]] takes for a table of points"
            raise InputError(found, "another name, or another folder", path)


@contextmanager
def _in_options(names: Mapping[str, str], values: Mapping[str, object]) -> Iterator[None]:
    """Let what is wrong with the value of an option name the option as it is typed."""
    from ..checks import as_called

    try:
        yield
    except ArgumentError as error:
        raise as_called(error, names) from error
    except InputError as error:
        stated = [name for name, value in values.items() if value == error.path and name in names]
        if error.path is None or not stated or not error.found.startswith("no "):
            raise  # what a file holds is a matter of the file
        file = Path(f"{names[stated[0]]} {error.path}")
        raise InputError(error.found, error.expected, file) from error


def described(of: Callable[..., object]) -> dict[str, str]:
    """Return what the docstring of a function, or of a class and its bases, says of each parameter."""
    found: dict[str, str] = {}
    for one in reversed(getattr(of, "__mro__", (of,))):
        found |= dict(FIELD.findall(f"{inspect.getdoc(one)}\n"))
    return {name: " ".join(text.split()) for name, text in found.items()}


def option_of(one: inspect.Parameter, words: str) -> inspect.Parameter:
    """Return a parameter as typer takes it, with the words of its docstring and those stated there.

    Without a default it is an argument; what is true or false is a flag that cannot be negated.
    """
    kind, stated = one.annotation, None
    if get_origin(kind) is Annotated:
        kind, stated = get_args(kind)
    if stated is None:
        stated = typer.Argument(show_default=False) if one.default is one.empty else typer.Option()
    info = copy(stated)
    info.help = f"{words}{info.help or ''}" or None
    if kind is bool and info.default is ...:
        info.default = f"--{one.name.strip('_').replace('_', '-')}"
    return one.replace(kind=one.POSITIONAL_OR_KEYWORD, annotation=Annotated[kind, info])


def expanded(verb: Callable[..., None]) -> Callable[..., None]:
    """Return a verb that takes the fields of its groups, instead of the groups, and --log-level."""
    groups: dict[str, Callable[..., object]] = {}
    parameters: list[inspect.Parameter] = []
    for one in inspect.signature(verb).parameters.values():
        kind, of, given = one.annotation, verb, [one]
        # A group is a dataclass, or a class that states its signature.
        if isinstance(kind, type) and (is_dataclass(kind) or "__signature__" in vars(kind)):
            groups[one.name] = of = kind
            given = list(inspect.signature(kind).parameters.values())
        words = described(of)
        parameters += [option_of(each, words.get(each.name, "")) for each in given]
    where = inspect.Parameter.POSITIONAL_OR_KEYWORD
    log = inspect.Parameter("log_level", where, default=None, annotation=LogLevelOption)
    parameters.append(log)
    names = {
        one.name: f"--{one.name.replace('_', '-')}"
        for one in parameters
        if isinstance(one.annotation.__metadata__[0], typer.models.OptionInfo)
    }

    @functools.wraps(verb)
    def flat(log_level: LogLevel | None = None, **values: object) -> None:
        stated = dict(values)
        for name, group in groups.items():
            mine = inspect.signature(group).parameters
            values[name] = group(**{field: values.pop(field) for field in mine})
        with logging_at(log_level), _in_options(names, stated):
            verb(**values)

    flat.__doc__ = re.split(r"\n\n\w+\n---", inspect.getdoc(verb) or "")[0]
    flat.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    flat.__annotations__ = {one.name: one.annotation for one in parameters}
    return flat


class _Lines(logging.Handler):
    """Time since the beginning, level, and what is said, as one printable line of stderr.

    On a terminal, behind what takes away the sign of life that may stand in the line.
    """

    began = time.time()

    def emit(self, record: logging.LogRecord) -> None:
        """Print a line."""
        from ..text import printable

        elapsed = max(record.created - self.began, 0.0)
        line = f"{elapsed:9.3f} s {record.levelname.lower():7} {record.getMessage()}"
        clear = CLEAR if sys.stderr.isatty() else ""
        print(clear + printable(line), file=sys.stderr, flush=True)


@contextmanager
def logging_at(level: LogLevel | None) -> Iterator[None]:
    """Log to stderr meanwhile."""
    if level is None or sys.stderr is None:
        yield
        return
    handler, before = _Lines(), LOGGER.level
    LOGGER.addHandler(handler)
    LOGGER.setLevel(level.upper())
    try:
        yield
    finally:
        LOGGER.removeHandler(handler)
        LOGGER.setLevel(before)
