"""The beams and planes of a calibration as tables, for whoever analyses many."""

from typing import TYPE_CHECKING

import numpy as np
import polars as pl

from ..arrays import FloatArray
from ..model.joint import BEAM_COORDINATES, PLANE_COORDINATES

if TYPE_CHECKING:
    from .calibration import Calibration

UNITS = {"x": "_m", "y": "_m", "z": "_m", "b": "_m", "k2": "_per_m"}
"""Ends of the names of coordinates that have a unit."""


def beam_table(calibration: "Calibration") -> pl.DataFrame:
    """Return one row a beam; see `Calibration.to_polars`."""
    beams = list(calibration.beams.values())
    rows = [np.concatenate((one.location, one.direction, one.range_error)) for one in beams]
    names = pl.DataFrame({"beam": [one.name for one in beams], "terms": [b.terms for b in beams]})
    return names.hstack(_coordinates(BEAM_COORDINATES, rows, [one.sigma for one in beams]))


def plane_table(calibration: "Calibration") -> pl.DataFrame:
    """Return one row a plane; see `Calibration.to_polars`."""
    planes = list(calibration.planes.values())
    rows = [np.append(one.normal, one.offset) for one in planes]
    names = pl.DataFrame({"plane": [one.name for one in planes]})
    return names.hstack(_coordinates(PLANE_COORDINATES, rows, [one.sigma for one in planes]))


def _coordinates(
    names: tuple[str, ...], rows: list[FloatArray], sigmas: list[FloatArray | None]
) -> pl.DataFrame:
    """Return a column a coordinate, then one for the standard deviation of each."""
    columns: dict[str, list[float | None]] = {}
    for index, name in enumerate(names):
        columns[name + UNITS.get(name, "")] = [float(row[index]) for row in rows]
    for index, name in enumerate(names):
        found = [None if sigma is None else float(sigma[index]) for sigma in sigmas]
        columns[f"{name}_sigma{UNITS.get(name, '')}"] = found
    return pl.DataFrame(columns, schema=dict.fromkeys(columns, pl.Float64))
