"""What there is to say of the result of a survey: terminal and report render it."""

import math
from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from ...quantities import IN_DEG, IN_MM
from ...text import count, some
from ..limits import LimitCheck, worst_of_each
from ..lines import NAMES_IN_LINE
from ..survey import SensorMount, SurveyCalibration, SurveyTarget
from .tables import (
    ROWS_ON_PAGE,
    Cell,
    Column,
    Facts,
    Table,
    digits_of,
    more,
    name_cell,
    number,
    significant,
    text,
)

MOST_MM = 4
"""Decimals of a length in millimetres, at most."""
UNITS = {"k0": ("mm", IN_MM), "k1": ("%", 100.0), "k2": ("%/m", 100.0), "scale": ("%", 100.0)}
"""Units of range errors for people, with the factor from SI."""


def sensors_table(result: SurveyCalibration) -> Table | None:
    """Return where sensors of many rays sit: location, Euler angles, and sigmas of both."""
    if not result.sensors:
        return None
    columns = (
        Column("sensor", number=False),
        *(Column(f"{axis} [mm]") for axis in "xyz"),
        Column("sigma [mm]"),
        *(Column(f"{angle} [deg]") for angle in "ABC"),
        Column("sigma [deg]"),
        Column("spot 95 % [mm]"),
        Column("shots"),
        Column("rejected", wide=True),
    )
    return Table(
        "sensors",
        "hand_T_sensor: location, and R = Rz(A) Ry(B) Rx(C)",
        columns,
        tuple(_sensor_row(sensor) for sensor in result.sensors.values()),
    )


def _sensor_row(sensor: SensorMount) -> tuple[Cell, ...]:
    shift, turn = float(sensor.location_sigma.max()), float(sensor.rotation_sigma.max())
    known = math.isfinite(shift) and math.isfinite(turn)
    digits = digits_of([shift * IN_MM], MOST_MM) if known else 1
    angles = Rotation.from_matrix(sensor.rotation).as_euler("ZYX", degrees=True)
    turns = digits_of([turn * IN_DEG], MOST_MM) if known else 1
    return (
        name_cell(sensor.name),
        *(number(x * IN_MM, digits) for x in sensor.location),
        significant(shift * IN_MM, 2),
        *(number(a, turns) for a in angles),
        significant(turn * IN_DEG, 2),
        significant(sensor.spot_error * IN_MM, 2),
        Cell(str(sensor.shots), sensor.shots),
        Cell(str(sensor.rejected), sensor.rejected, "care" if sensor.rejected else ""),
    )


def beams_table(result: SurveyCalibration) -> Table | None:
    """Return where single beams sit."""
    if not result.beams:
        return None
    columns = (
        Column("beam", number=False),
        *(Column(f"{axis} [mm]") for axis in "xyz"),
        Column("sigma [mm]"),
        *(Column(f"v{axis}") for axis in "xyz"),
        Column("sigma [deg]"),
        Column("readings"),
    )
    rows = []
    for beam in result.beams.values():
        shift = float(beam.location_sigma.max())
        digits = digits_of([shift * IN_MM], MOST_MM) if math.isfinite(shift) else 1
        rows.append(
            (
                name_cell(beam.name),
                *(number(x * IN_MM, digits) for x in beam.location),
                significant(shift * IN_MM, 2),
                *(number(x, 5) for x in beam.direction),
                significant(beam.direction_sigma * IN_DEG, 2),
                Cell(str(beam.readings), beam.readings),
            )
        )
    return Table("beams", "location and direction in the hand", columns, tuple(rows))


def targets_table(result: SurveyCalibration) -> Table:
    """Return what was looked at."""
    columns = (
        Column("target", number=False),
        Column("kind", number=False),
        Column("place", number=False),
        Column("sigma", number=False),
    )
    targets = list(result.targets.values())
    rows = tuple(
        (name_cell(t.label), text(t.kind), text(_place(t)), text(_sigma(t)))
        for t in targets[:ROWS_ON_PAGE]
    )
    note = more(len(targets) - len(rows), "target")
    return Table("targets", "in the world", columns, rows, note)


def _place(target: SurveyTarget) -> str:
    v = target.values
    if target.kind == "plane":
        n = " ".join(f"{v[name]:.5f}" for name in ("nx", "ny", "nz"))
        return f"normal {n}, offset {v['b'] * IN_MM:.3f} mm"
    place = f"({', '.join(f'{v[axis] * IN_MM:.3f}' for axis in 'xyz')}) mm"
    return f"{place}, radius {v['radius'] * IN_MM:.3f} mm" if "radius" in v else place


def _sigma(target: SurveyTarget) -> str:
    s = target.sigma
    if any(not math.isfinite(x) for x in s.values()):
        return "undetermined"
    if target.kind == "plane":
        return f"{s['tilt'] * IN_DEG:.2g} deg, {s['offset'] * IN_MM:.2g} mm"
    words = f"{max(s[axis] for axis in 'xyz') * IN_MM:.2g} mm"
    return f"{words}, {s['radius'] * IN_MM:.2g} mm" if "radius" in s else words


def facts(result: SurveyCalibration, checks: Sequence[LimitCheck] = ()) -> Facts:
    """Return noise, fit, limits, relations and tests as pairs of a name and words."""
    found = [("fit", f"chi2 {result.chi2:.4g} at {result.dof} degrees of freedom")]
    noise = [
        f"{sensor.name} {sensor.reading_sigma * IN_MM:.2g} mm" for sensor in result.sensors.values()
    ]
    turn, shift = result.pose_sigma
    if math.isfinite(turn):
        how = " (estimated)" if result.pose_sigma_estimated else ""
        noise.append(f"hand {shift * IN_MM:.2g} mm and {turn * IN_DEG:.2g} deg an axis{how}")
    found.append(("noise, one standard deviation", ", ".join(noise)))
    for sensor in result.sensors.values():
        if sensor.range_error:
            C = np.sqrt(np.diagonal(sensor.covariance)[6:])
            parts = [
                f"{code} {value * UNITS[code][1]:.4g} +- {s * UNITS[code][1]:.2g} {UNITS[code][0]}"
                for (code, value), s in zip(sensor.range_error.items(), C, strict=True)
            ]
            found.append((f"range error of {sensor.name}", ", ".join(parts)))
        if sensor.errors:
            found.append((f"tested of {sensor.name}", _tested(sensor)))
    for check in worst_of_each(tuple(checks)):
        found.append(("limit", check.comparison if check.held else check.failure))
    for one in result.relations:
        words = "contradicted by the readings" if one.contradicted else "agrees with the readings"
        found.append((one.known.words, f"{words} (p = {one.p_value:.2g})"))
    if result.rejected:
        names = [f"{one.sensor} at {one.station} ({one.reason})" for one in result.rejected]
        found.append(("left out", f"{count(len(names), 'shot')}: {some(names, NAMES_IN_LINE)}"))
    return tuple(found)


def _tested(sensor: SensorMount) -> str:
    """Say which range errors were found, and the largest that could be there all the same."""
    parts = []
    for error in sensor.errors:
        unit, factor = UNITS[error.code]
        if error.found:
            parts.append(f"{error.code} of {error.size * factor:.3g} {unit} found")
        else:
            moved = error.detectable * error.spot_shift * IN_MM
            parts.append(
                f"{error.code} below {error.detectable * factor:.2g} {unit} would go unnoticed "
                f"(a spot {moved:.2g} mm off)"
            )
    return "; ".join(parts)
