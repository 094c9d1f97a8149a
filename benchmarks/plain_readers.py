"""What a file plainly says: a second reader of every format, to judge the package's own by.

Nothing here is imported from the package, and no table parser is used: text is split at line ends and
separators, or taken apart by `json` and `tomllib`. Where a file does not plainly say something, these
readers raise `UnclearError`; the package must then refuse the file, too. Where they answer, the
package may refuse (it knows more faults), but must not answer anything else.
"""

import csv
import json
import math
import re
import tomllib
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

POSE = ("x", "y", "z", "qx", "qy", "qz", "qw")
NUMBER = re.compile(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?")
NO_READING = (
    " err error fehler hi inf infinity 1inf invalid lo na nan nanind nil noecho none noreading "
    "notanumber notarget null ol outofrange over overflow overrange ovf under underrange "
    "ung\u00fcltig 1ind 1qnan 1snan "
)
"""What a logger writes for "no reading", once its signs, points and blanks are gone."""
DEGREE = math.pi / 180.0


class UnclearError(Exception):
    """A file from which no two readers need to take the same."""


@dataclass(frozen=True, slots=True)
class PlainRecording:
    """Stations as a recording's cells state them; NaN where a beam has no reading.

    Attributes
    ----------
    planes, stations, beams : names
        `stations` is empty where the file does not name them.
    positions, rotations : (M, 3), (M, 3, 3)
    ranges : (M, B)
    """

    planes: tuple[str, ...]
    stations: tuple[str, ...]
    beams: tuple[str, ...]
    positions: NDArray[np.float64]
    rotations: NDArray[np.float64]
    ranges: NDArray[np.float64]


def plain_recording(data: bytes) -> PlainRecording:
    """Read a recording: one station a line that holds more than blanks and separators."""
    text = _utf8(data).removeprefix("\ufeff")
    if "\0" in text:
        raise UnclearError("a null character")
    lines = [line for line in re.split("\r\n|\n|\r", text) if line.strip()]
    if not lines:
        raise UnclearError("nothing")
    separator, header = _header(lines[0])
    rows = [_cells(line, separator) for line in lines[1:] if line.strip(f" \t{separator}")]
    if not rows or any(len(row) != len(header) for row in rows):
        raise UnclearError("rows of another length than the header")
    column = {name: [row[i] for row in rows] for i, name in enumerate(header)}
    poses = np.array([[_number(cell) for cell in column[name]] for name in POSE]).T
    beams = [name for name in header if name.startswith("range_")]
    ranges = np.array([[_range(cell) for cell in column[name]] for name in beams]).T
    return PlainRecording(
        tuple(column["plane"]),
        tuple(column.get("station", ())),
        tuple(name.removeprefix("range_") for name in beams),
        poses[:, :3],
        np.array([_rotation(*q) for q in poses[:, 3:].tolist()]),
        ranges,
    )


def _utf8(data: bytes) -> str:
    try:
        return data.decode("utf-8")
    except UnicodeDecodeError as error:
        raise UnclearError("bytes that are no UTF-8") from error


def _header(line: str) -> tuple[str, list[str]]:
    """Return the separator under which a header has all the columns of a recording, each once."""
    for separator in (",", ";", "\t"):
        try:
            names = _cells(line, separator)
        except UnclearError:
            continue
        beams = [name for name in names if name.startswith("range_")]
        needed = [name for name in names if name in ("plane", "station", *POSE)] + beams
        if beams and {"plane", *POSE} <= set(names) and len(set(needed)) == len(needed):
            return separator, names
    raise UnclearError("no header of a recording")


def _cells(line: str, separator: str) -> list[str]:
    if '"' not in line:
        return [cell.strip(" \t") for cell in line.split(separator)]
    blanks = "[ ]*" if separator == "\t" else "[ \t]*"
    cell = rf'(^|{separator}){blanks}("(?:[^"]|"")*"){blanks}(?={separator}|$)'
    parts = re.sub(cell, r"\1\2", line)
    try:
        row = next(csv.reader([parts], delimiter=separator, strict=True))
    except (csv.Error, StopIteration) as error:
        raise UnclearError("quotes") from error
    return [cell.strip(" \t") for cell in row]


def _number(cell: str) -> float:
    if not NUMBER.fullmatch(cell):
        raise UnclearError(f"{cell[:20]!r} for a number")
    return float(cell)


def _range(cell: str) -> float:
    letters = "".join(one for one in cell.lower() if one not in "+-._,#/()!" and not one.isspace())
    marked = re.match(r"#[^0-9.,+-]|[<>]|err:[0-9]+$", cell.lower())
    if not cell.strip("-\u2013\u2014*?") or marked or f" {letters} " in NO_READING:
        return math.nan
    return _number(cell)


def _rotation(x: float, y: float, z: float, w: float) -> list[list[float]]:
    length = math.hypot(x, y, z, w)
    if not 0.9 < length < 1.1:
        raise UnclearError("no unit quaternion")
    x, y, z, w = x / length, y / length, z / length, w / length
    return [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]


RIG_UNITS = {
    ("noise", "range_sigma_mm"): 1e-3,
    ("noise", "incidence_sigma_mm"): 1e-3,
    ("noise", "pose_translation_sigma_mm"): 1e-3,
    ("noise", "pose_rotation_sigma_deg"): DEGREE,
    ("noise", "pose_translation_prior_mm"): 1e-3,
    ("noise", "pose_rotation_prior_deg"): DEGREE,
    ("sensor", "max_incidence_deg"): DEGREE,
    ("sensor", "linearity_percent"): 1e-2,
    ("limits", "rms_mm"): 1e-3,
    ("limits", "location_sigma_mm"): 1e-3,
    ("limits", "direction_sigma_deg"): DEGREE,
}
"""What every number of a rig file is multiplied by."""


@dataclass(frozen=True, slots=True)
class PlainRig:
    """The numbers of a rig file that stand there, in SI units, by table and field."""

    numbers: dict[tuple[str, str], float]
    span: tuple[float, float] | None
    pose_covariance: NDArray[np.float64] | None


def plain_rig(data: bytes) -> PlainRig:
    """Read a rig file."""
    try:
        tables = tomllib.loads(_utf8(data).removeprefix("\ufeff"))
    except (ValueError, RecursionError) as error:
        raise UnclearError("no TOML") from error
    known = {*RIG_UNITS, ("sensor", "range_mm"), ("noise", "pose_covariance")}
    found: dict[tuple[str, str], object] = {}
    for table, fields in tables.items():
        if table not in ("noise", "sensor", "limits") or not isinstance(fields, dict):
            raise UnclearError(f"table {table[:20]!r}")
        found |= {(table, name): value for name, value in fields.items()}
    if not set(found) <= known:
        raise UnclearError("an unknown field")
    span = found.get(("sensor", "range_mm"))
    matrix = found.get(("noise", "pose_covariance"))
    return PlainRig(
        {key: _real(value) * RIG_UNITS[key] for key, value in found.items() if key in RIG_UNITS},
        None if span is None else _span(span),
        None if matrix is None else _square(matrix, 6),
    )


def _span(value: object) -> tuple[float, float]:
    if not isinstance(value, list) or len(value) != 2:
        raise UnclearError("no span")
    return _real(value[0]) * 1e-3, _real(value[1]) * 1e-3


@dataclass(frozen=True, slots=True)
class PlainResult:
    """The beams of a result file, and what they are known to."""

    names: tuple[str, ...]
    locations: NDArray[np.float64]
    directions: NDArray[np.float64]
    range_errors: NDArray[np.float64]
    terms: tuple[int, ...]
    covariance: NDArray[np.float64]
    range_sigma: NDArray[np.float64]
    pose_covariance: NDArray[np.float64] | None


class _Twice(dict[str, object]):
    """An object in which a field stood twice: reading it is unclear."""


def plain_result(data: bytes) -> PlainResult:
    """Read the beams of a converged calibration."""
    try:
        record = json.loads(_utf8(data), object_pairs_hook=_fields)
    except (ValueError, RecursionError) as error:
        raise UnclearError("no JSON") from error
    kind, version = _get(record, "format"), _get(record, "version")
    if (kind, version, _get(record, "status")) != ("handlaser-calibration", 1, "converged"):
        raise UnclearError("another format or status")
    if isinstance(version, bool):
        raise UnclearError("a version that is no number")
    beams, fit = _list(_get(record, "beams")), _get(record, "fit")
    names = [_get(beam, "name") for beam in beams]
    if not beams or not all(isinstance(name, str) for name in names):
        raise UnclearError("no names")
    errors = [_get(beam, "range_error") for beam in beams]
    pose = fit.get("pose_covariance") if isinstance(fit, dict) else None
    common = _real(_get(fit, "range_sigma_m"))
    own = [beam.get("range_sigma_m") if isinstance(beam, dict) else None for beam in beams]
    return PlainResult(
        tuple(str(name) for name in names),
        np.array([_vector(_get(beam, "location_m")) for beam in beams]),
        np.array([_vector(_get(beam, "direction")) for beam in beams]),
        np.array([[_real(_get(k, "k1")), _real(_get(k, "k2_per_m"))] for k in errors]),
        tuple(int(_real(_get(beam, "range_error_terms"))) for beam in beams),
        _square(_get(record, "beam_covariance"), 8 * len(beams)),
        np.array([common if one is None else _real(one) for one in own]),
        None if pose is None else _square(pose, 6),
    )


def _fields(pairs: list[tuple[str, object]]) -> dict[str, object]:
    record = dict(pairs)
    return record if len(record) == len(pairs) else _Twice(record)


def _get(record: object, field: str) -> object:
    if not isinstance(record, dict) or isinstance(record, _Twice) or field not in record:
        raise UnclearError(f"no field {field}")
    return record[field]


def _list(value: object) -> list[object]:
    if not isinstance(value, list):
        raise UnclearError("no list")
    return value


def _vector(value: object) -> list[float]:
    numbers = [_real(x) for x in _list(value)]
    if len(numbers) != 3:
        raise UnclearError("no vector")
    return numbers


def _square(value: object, size: int) -> NDArray[np.float64]:
    rows = [[_real(x) for x in _list(row)] for row in _list(value)]
    if [len(row) for row in rows] != [size] * size:
        raise UnclearError("no square matrix")
    return np.array(rows)


def _real(value: object) -> float:
    """Return a finite number; a bool or a text is none."""
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise UnclearError("no number")
    try:
        number = float(value)
    except OverflowError as error:
        raise UnclearError("a number beyond all") from error
    if not math.isfinite(number):
        raise UnclearError("no finite number")
    return number
