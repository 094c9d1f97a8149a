"""Tables of what was estimated: mounts, laser spots, planes, and all of it against the limits."""

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from ...arrays import FloatArray
from ...model.families import BEAM, OF_DIRECTION, OF_LOCATION, OF_RANGE_ERROR
from ...quantities import IN_DEG, IN_MM
from ..calibration_data import Beam, Plane
from ..limits import LimitCheck
from ..lines import UNDETERMINED, decimals
from ..messages import said
from ..spots import spot, spot_radii, typical_plane
from .tables import (
    NONE,
    ROWS_ON_PAGE,
    Cell,
    Table,
    concise,
    coordinates,
    digits_of,
    listed,
    more,
    name_cell,
    number,
    plain,
    significant,
    table_of,
)

if TYPE_CHECKING:
    from .beams import CalibrationDescription

K1: int = OF_RANGE_ERROR.start
PARTS = {
    "location": (OF_LOCATION, "mm", IN_MM, 5),
    "direction": (OF_DIRECTION, "1", 1.0, 7),
    "slope": (slice(K1, K1 + 1), "1", 1.0, 7),
    "curvature": (slice(K1 + 1, BEAM.size), "1/m", 1.0, 5),
}
"""The coordinates of each part of a mount, the unit in which they are shown, that unit per SI unit, and
their decimals at most: no sensor shows what is smaller."""


def beams_table(described: "CalibrationDescription") -> Table | None:
    """Return one row a beam: where it sits and points, and how well that is known."""
    beams = list(described.calibration.beams.values())
    if not any(_known(beam.sigma) for beam in beams):
        return None
    radii = spot_radii(described.calibration, described.verdict.reading) if described.solved else {}
    table = listed("beams", beams, lambda beam: _beam_row(beam, radii.get(beam.name)), "beam")
    if radii:
        at = concise(described.verdict.reading * IN_MM, 4)
        table = table._replace(caption=table.caption + said("table:beams:spots", at=at))
    if not any(cell.mark == "care" for row in table.rows for cell in row):
        return table
    note = f"A dash stands for what the stations do not determine. {table.note}".rstrip()
    return table._replace(note=note)


def _beam_row(beam: Beam, radius: float | None) -> tuple[Cell, ...]:
    sigma = np.full(BEAM.size, np.inf) if beam.sigma is None else beam.sigma
    turn = math.inf if beam.direction_sigma is None else beam.direction_sigma
    location, direction = (
        coordinates(beam.coordinates[at] * scale, sigma[at], digits_of(sigma[at] * scale, most))
        for at, _, scale, most in (PARTS["location"], PARTS["direction"])
    )
    k, known = beam.range_error.tolist(), sigma[6:].tolist()
    errors = [
        _concise(k[term], known[term], most) if term < beam.terms else Cell("0", 0.0)
        for term, most in enumerate((4, 3))
    ]
    return (
        name_cell(beam.name),
        *location,
        significant(float(sigma[:3].max()) * IN_MM, 2),
        *direction,
        significant(turn * IN_DEG, 2),
        *errors,
        significant(None if radius is None else radius * IN_MM, 2),
    )


def _concise(value: float, sigma: float, most: int) -> Cell:
    """Return a value with the standard deviation of its last digits: "0.0207(56)"."""
    if not math.isfinite(sigma):
        return Cell(NONE, None, "care")
    digits = decimals(sigma, most)
    return Cell(f"{plain(value, digits)}({sigma * 10.0**digits:.0f})", value)


def mounts_table(described: "CalibrationDescription") -> Table | None:
    """Return value, standard deviation and 95 % interval of every parameter; None if none is known."""
    beams = list(described.calibration.beams.values())
    if not any(_known(beam.sigma) for beam in beams):
        return None
    rows = [row for beam in beams[:ROWS_ON_PAGE] for row in _parameters(described, beam)]
    return table_of("mounts", rows, more(len(beams) - ROWS_ON_PAGE, "beam"))


def _parameters(described: "CalibrationDescription", beam: Beam) -> Iterator[tuple[Cell, ...]]:
    """Yield the rows of one beam; no number where the recording determines none."""
    calibration = described.calibration
    sigma = np.full(BEAM.size, np.inf) if beam.sigma is None else beam.sigma
    interval = calibration.intervals(beam.name)
    interval = np.full((8, 2), np.nan) if interval is None else interval
    for part, (at, unit_name, scale, most) in PARTS.items():
        digits, unit = digits_of(sigma[at] * scale, most), Cell(unit_name)
        for i in range(at.start, min(at.stop, K1 + beam.terms)):
            name = Cell(BEAM.labels[i])
            if not math.isfinite(sigma[i]):
                blank = (Cell(UNDETERMINED, None, "care"), *[Cell(NONE)] * 3)
                yield Cell(beam.name), name, *blank, unit
                continue
            values = (beam.coordinates[i], sigma[i], *interval[i])
            yield Cell(beam.name), name, *(number(x * scale, digits) for x in values), unit
        turn = beam.direction_sigma
        if part == "direction" and turn is not None and math.isfinite(turn):
            dash, angle = Cell(NONE), significant(turn * IN_DEG, 2)
            words = Cell("direction, angle")
            yield Cell(beam.name), words, dash, angle, dash, dash, Cell("deg")


def spots_table(described: "CalibrationDescription") -> Table | None:
    """Return how well the laser spot of every beam is known at the working distance."""
    calibration, reading = described.calibration, described.verdict.reading
    radii = spot_radii(calibration, reading) if described.solved else {}
    if not radii:
        return None

    def row(name: str) -> tuple[Cell, ...]:
        found = spot(calibration, name, reading)
        numbers = (radii[name], found.along, found.across, found.reading_sigma)
        cells = [significant(x * IN_MM, 2) for x in numbers]
        return name_cell(name), *cells, significant(found.direction_sigma * IN_DEG, 2)

    measured, note = typical_plane(calibration), ""
    if measured is not None:
        station, plane = measured
        far, turn = concise(plane.distance_sigma * IN_MM), concise(plane.angle_sigma * IN_DEG)
        note = said("table:spots:plane", station=station, distance=far, angle=turn)
    return listed("spots", list(radii), row, "beam", note, at=concise(reading * IN_MM, 4))


def planes_table(described: "CalibrationDescription") -> Table | None:
    """Return where every plane was found; None where nothing is known."""
    planes = list(described.calibration.planes.values())
    if not any(_known(plane.sigma) for plane in planes):
        return None
    return listed("planes", planes, _plane_row, "plane")


def _plane_row(plane: Plane) -> tuple[Cell, ...]:
    sigma = np.full(4, np.inf) if plane.sigma is None else plane.sigma
    turn, shift = plane.normal_sigma, float(sigma[3])
    turn = math.inf if turn is None else turn
    digits = digits_of([turn], 7)
    n = coordinates(plane.normal, sigma[:3], digits, UNDETERMINED)
    at, digits = np.array([plane.offset * IN_MM]), digits_of([shift * IN_MM], 4)
    offset = coordinates(at, sigma[3:], digits, UNDETERMINED)
    row = (*n, significant(turn * IN_DEG, 2), *offset)
    return name_cell(plane.name), *row, significant(shift * IN_MM, 2)


def _known(sigma: FloatArray | None) -> bool:
    return sigma is not None and bool(np.isfinite(sigma).any())


def limits_table(described: "CalibrationDescription") -> Table | None:
    """Return every value beside its limit; None where no limit was given."""
    checks = sorted(described.verdict.limits, key=lambda one: -one.ratio)
    if not checks:
        return None

    def row(one: LimitCheck) -> tuple[Cell, ...]:
        scale, unit = one.unit
        words = one.name.replace("sigma", "std dev")
        state = Cell("pass", 0.0, "good") if one.held else Cell("fail", 1.0, "bad")
        value, limit = significant(one.value * scale), significant(one.limit * scale)
        return Cell(words), Cell(one.subject or "all"), value, limit, Cell(unit), state

    return listed("limits", checks, row, "limit")
