"""Simulated surveys as files: stations, tables of points, zones, a rig file, and what is true."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import polars as pl

from ..arrays import FloatArray
from ..data.noise import Noise
from ..data.survey import Shots, Survey, kind_of
from ..model.families import BEAM, FAMILIES, OF_RANGE_ERROR, PLANE
from ..model.sensor_limits import Sensor
from ..model.sensors.kinds import KINDS
from ..quantities import IN_DEG, IN_MM
from ..validation.survey_simulate import SurveyTruth
from .checked_text import Record, json_text, toml_table
from .points_table import COLUMNS
from .recording_csv import PREFIX, write_columns
from .rig_toml import write_rig
from .sensor_tables import SINGLE, SensorTable
from .writing import RIG, STATIONS, TRUTH, write_text


def table_names(tables: Sequence[SensorTable]) -> list[str]:
    """Return the names of all files that a survey of these sensors is written to."""
    zones = [_zones(table) for table in tables if table.kind == "array"]
    return [STATIONS, *map(_points, tables), *zones, RIG, TRUTH]


def write_simulated(
    folder: Path,
    survey: Survey,
    truth: SurveyTruth,
    tables: Sequence[SensorTable],
    zones: dict[str, FloatArray],
    noise: Noise,
    sensor: Sensor,
    beams: Sequence[SensorTable] = (),
) -> None:
    """Write a simulated survey as `calibrate` reads it, and what is true beside it.

    Parameters
    ----------
    folder : Path
    survey : Survey
    truth : SurveyTruth
    tables : sequence of SensorTable
        How its sensors are described in the rig file.
    zones : mapping of name to (n, 3)
        Directions of the zones of arrays.
    noise : Noise
        As the rig file states it.
    sensor : Sensor
        Of the beams.
    beams : sequence of SensorTable
        Those that differ from each other.

    Raises
    ------
    InputError
        A file that cannot be written.
    """
    ranges = PREFIX, survey.beam_names, survey.ranges
    write_columns(folder / STATIONS, survey.stations, ranges)
    for table, shots in zip(tables, survey.shots, strict=True):
        stops = survey.stations.station_names
        # Decimals of millimetres and degrees below the noise of any sensor.
        columns = _columns(table, shots, zones.get(table.name)).round(5)
        content = pl.DataFrame({"station": [stops[j] for j in shots.station.tolist()]}).hstack(
            pl.DataFrame(columns, schema=list(COLUMNS[table.kind]), orient="row")
        )
        if table.kind == "array":
            content = content.with_columns(pl.col("zone").cast(pl.Int64))
            u = pl.DataFrame(zones[table.name], schema=["x", "y", "z"], orient="row")
            write_text(folder / _zones(table), u.with_row_index("zone").write_csv())
        write_text(folder / _points(table), content.write_csv())
    more = "".join(map(_sensor_text, (*tables, *beams)))
    half_angle = float(survey.cones[0]) if len(survey.cones) and not beams else 0.0
    write_rig(folder / RIG, noise, sensor, more, half_angle)
    write_text(folder / TRUTH, json_text("survey-truth", _truth(truth)))


def _points(table: SensorTable) -> str:
    return f"{table.name}.csv"


def _zones(table: SensorTable) -> str:
    return f"{table.name}-zones.csv"


def _columns(table: SensorTable, shots: Shots, zones: FloatArray | None) -> FloatArray:
    """Return the numbers (N, c) of a table of points, in millimetres and degrees."""
    d = shots.reading[:, None] * IN_MM
    if KINDS[table.kind].flat:
        return np.hstack((shots.across * (IN_DEG if table.kind == "scanner" else IN_MM), d))
    if table.kind == "points":
        return np.asarray(d * KINDS[table.kind].rays(shots.across).direction)
    assert zones is not None
    u = zones / np.linalg.norm(zones, axis=1)[:, None]
    zone = (shots.across @ u.T).argmax(axis=1)
    along = shots.across[:, 2:] if table.convention == "perpendicular" else 1.0
    return np.column_stack((zone, d * along))


def _sensor_text(table: SensorTable) -> str:
    """Return a row of [[sensors]]: what was stated, in millimetres and degrees, with its own files."""
    is_array, single = table.kind == "array", table.kind == SINGLE
    fields: dict[str, object] = {
        "name": table.name,
        "kind": table.kind,
        "points": None if single else _points(table),
        "units": None if single else "mm",
        "half_angle_deg": table.half_angle_deg or None,
        "angles": "deg" if table.kind == "scanner" else None,
        "zones": _zones(table) if is_array else None,
        "convention": table.convention if is_array else None,
        "sigma_mm": table.sigma_mm,
        "sigma_across_mm": table.sigma_across_mm or None,
        "free": table.free or None,
    }
    return toml_table("\n[[sensors]]", fields)


def _truth(truth: SurveyTruth) -> Record:
    targets = []
    for label, x in truth.targets.items():
        family = kind_of(label)
        names = ("nx", "ny", "nz", "b") if family == PLANE.name else FAMILIES[family].coordinates
        values = dict(zip(names, x.tolist(), strict=True))
        targets.append({"label": label, "kind": family, "values": values})
    return {
        "sensors": [
            {"name": name, "rotation": T[:3, :3], "location_m": T[:3, 3]}
            for name, T in truth.mounts.items()
        ],
        "beams": [
            {"name": name, "location_m": x[:3], "direction": x[3:]}
            for name, x in truth.beams.items()
        ],
        "targets": targets,
        "range_error": dict(zip(BEAM.numbers[OF_RANGE_ERROR], truth.range_error, strict=True)),
    }
