"""What there is to say of the result of a survey: terminal and report render it."""

import math
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial.transform import Rotation

from ...arrays import FloatArray
from ...estimation.survey_trials import BOTH_AXES
from ...model.distributions import p_words
from ...model.families import BEAM, RANGE_ERROR
from ...model.sensors.mounted import SENSOR
from ...quantities import IN_DEG, IN_MM, IN_PERCENT
from ...text import count, some
from ..lines import NAMES_IN_LINE, UNDETERMINED, WIDTH, decimals
from ..messages import said
from ..survey_relations import said_by_readings
from ..survey_warnings import rejected_shot
from ..verdict import Verdict
from .description import Description
from .evidence import by_pose_words
from .tables import (
    Cell,
    Facts,
    Table,
    coordinates,
    full_table,
    listed,
    name_cell,
    significant,
    text_lines,
)

if TYPE_CHECKING:
    from ..survey import BeamMount, Mount, SensorMount, SurveyCalibration, SurveyTarget

SHOWN = {1: ("mm", IN_MM), 0: ("%", IN_PERCENT), -1: ("%/m", IN_PERCENT)}
"""Units of range errors for people, with the factor from SI, by the power of the metre."""
UNITS = {
    name: SHOWN[power]
    for name, power in (*zip(SENSOR.coordinates, SENSOR.powers, strict=True), (BOTH_AXES, 0))
}
"""The same by coordinate of a sensor, and of both axes at once."""


class SurveyDescription(Description):
    """What there is to say of the result of a survey."""

    calibration: "SurveyCalibration"

    @property
    def counts(self) -> tuple[tuple[str, int], ...]:
        """How much there is of everything, as names and numbers."""
        result, survey = self.calibration, self.calibration.survey
        return (
            ("stations", len(survey.stations)),
            ("targets", len(result.targets)),
            ("sensors", len(result.mounts)),
            ("points", sum(len(shots.reading) for shots in survey.shots)),
            ("rejected", len(result.rejected)),
        )

    @property
    def main_tables(self) -> tuple[Table, ...]:
        """Where sensors of many rays sit, and where single beams do; no table of none."""
        sensors = list(self.calibration.sensors.values())
        beams = list(self.calibration.beams.values())
        tables = [listed("sensors", sensors, _sensor_row, "sensor")] if sensors else []
        tables += [listed("beams:survey", beams, _beam_row, "beam")] if beams else []
        return tuple(tables)

    def screen(self, *, closing: int = 0, width: int = WIDTH) -> list[str]:  # noqa: ARG002
        """Return everything: it has no more than a screen of some sensors and targets."""
        return self.full(width)

    def full(self, width: int = WIDTH) -> list[str]:
        """Return the verdict, tables, facts and warnings."""
        lines = text_lines([self.verdict.sentence], width)
        for table in (*self.main_tables, targets_table(self.calibration)):
            lines += full_table(table.name, table, width)
        rest = [f"{name}: {words}" for name, words in facts(self.calibration, self.verdict)]
        rest += self.calibration.undetermined[1:]
        return lines + text_lines([*rest, *(f"WARNING: {one}" for one in self.warnings)], width)


def _sensor_row(sensor: "SensorMount") -> tuple[Cell, ...]:
    """Return location and Euler angles of a sensor with the sigmas of both, its spot and its shots."""
    angles, digits = _angles(sensor)
    care = "care" if sensor.rejected else ""
    rejected = Cell(str(sensor.rejected), sensor.rejected, care)
    return *_mount_row(sensor, angles, digits, sensor.shots), rejected


def _angles(sensor: "SensorMount") -> tuple[FloatArray, int]:
    """Return the Euler angles of a sensor (3,) [deg], and their decimals."""
    angles = Rotation.from_matrix(sensor.rotation).as_euler("ZYX", degrees=True)
    return angles, _digits(sensor.largest_sigmas[1] * IN_DEG)


def _beam_row(beam: "BeamMount") -> tuple[Cell, ...]:
    """Return location and direction of a beam with the sigmas of both, its spot and its readings."""
    return _mount_row(beam, beam.direction, 5, beam.readings)


def _mount_row(mount: "Mount", turned: FloatArray, digits: int, read: int) -> tuple[Cell, ...]:
    turn = mount.largest_sigmas[1]
    return (
        name_cell(mount.name),
        *_located(mount.location, mount.location_sigma),
        *coordinates(turned, np.full(3, turn), digits),  # each of them moves with any turn
        significant(turn * IN_DEG, 2),
        significant(mount.spot_error * IN_MM, 2),
        Cell(str(read), read),
    )


def _located(location: FloatArray, sigma: FloatArray) -> tuple[Cell, ...]:
    """Return cells of a location, dashes for what is open, and the largest sigma of the rest."""
    largest = max(sigma[np.isfinite(sigma)].tolist(), default=math.nan)
    digits = _digits(largest * IN_MM)
    place = coordinates(location * IN_MM, sigma, digits)
    return *place, significant(largest * IN_MM, 2)


def _digits(sigma: float) -> int:
    """Return the decimals of a number [mm] or [deg]: few where it is undetermined."""
    return decimals(sigma, 4) if math.isfinite(sigma) else 1


def targets_table(result: "SurveyCalibration") -> Table:
    """Return what was looked at."""
    return listed("targets", list(result.targets.values()), _target_row, "target")


def _target_row(target: "SurveyTarget") -> tuple[Cell, ...]:
    sigma, kind = dict(target.sigma), target.kind
    words = UNDETERMINED
    if all(map(math.isfinite, sigma.values())):
        largest = max(sigma.get(axis, 0.0) for axis in "xyz")
        words = said(f"sigma:{kind}", largest=largest, **sigma)
    return (
        name_cell(target.label),
        Cell(kind),
        Cell(said(f"place:{kind}", **target.values)),
        Cell(words),
    )


def facts(result: "SurveyCalibration", verdict: Verdict) -> Facts:
    """Return noise, fit, limits, relations and tests as pairs of a name and words."""
    found = [("fit", f"chi2 {result.chi2:.4g} at {result.dof} degrees of freedom{_counts(result)}")]
    sigmas, sources = result._found.noise.sigma.tolist(), result._found.rows.names_of_noise()
    noise = [f"{of} {one * IN_MM:.2g} mm" for of, one in zip(sources, sigmas, strict=False)]
    turn, shift = result.pose_sigma
    if math.isfinite(turn):
        how = " (estimated)" if result.pose_sigma_estimated else ""
        noise.append(said("noise:hand", shift=shift, turn=turn, how=how))
    noise += by_pose_words(result.errors_by_pose)
    found.append(("noise, one standard deviation", ", ".join(noise)))
    for sensor in result.sensors.values():
        if sensor.range_error:
            sigmas = np.sqrt(np.diagonal(sensor.covariance)[6:])
            found.append((f"range error of {sensor.name}", _errors(sensor.range_error, sigmas)))
        if sensor.errors:
            found.append((f"tested of {sensor.name}", _tested(sensor)))
    for beam in result.beams.values():
        errors = dict(zip(BEAM.coordinates[RANGE_ERROR], beam.range_error, strict=True))
        sigmas = np.sqrt(np.diagonal(beam.covariance)[RANGE_ERROR])
        found.append((f"range error of beam {beam.name}", _errors(errors, sigmas)))
    for check in verdict.worst_limits:
        found.append(("limit", check.comparison if check.held else check.failure))
    contradicted = any(one.contradicted for one in result.relations)
    judged = contradicted or result.status in ("converged", "undetermined")
    for one in result.relations:
        words = "contradicted by the readings" if one.contradicted else "agrees with the readings"
        words = ", or ".join((words, *(f"{other.words} is" for other in one.rivals)))
        words = f"{words} ({p_words(one.p_value)})"
        if not judged:  # then its test means nothing
            words = "not judged, because the readings do not fit each other"
        found.append((one.known.words, words))
    if result.without is not None:
        found += _without(result, result.without)
    if result.rejected:
        names = [f"{rejected_shot(one, result.beams)} ({one.reason})" for one in result.rejected]
        found.append(("left out", f"{count(len(names), 'shot')}: {some(names, NAMES_IN_LINE)}"))
    return tuple(found)


def _counts(result: "SurveyCalibration") -> str:
    """Say what degrees of freedom are made of, in the counts of `check`; empty of what is open."""
    own = result._found
    if own.estimate.status == "undetermined":
        return ""
    numbers = sum(item.numbers for item in own.rows.counted(own.used))
    unknowns = len(own.estimate.names)
    more = result.dof + unknowns - numbers
    return said("degrees", numbers=numbers, more=more, unknowns=unknowns)


def _without(result: "SurveyCalibration", other: "SurveyCalibration") -> Iterator[tuple[str, str]]:
    """Yield what follows without the relations that are contradicted: how far each mount moves."""
    false = " and ".join(one.known.words for one in result.relations if one.contradicted)
    yield f"without {false}", other.verdict.sentence
    for words, measured in said_by_readings(result):
        yield f"{words} without it", measured
    for name, sensor in other.sensors.items():
        before = result.sensors[name]
        turn = float(Rotation.from_matrix(before.rotation.T @ sensor.rotation).magnitude())
        angles, digits = _angles(sensor)
        to = _places(sensor.location, sensor.location_sigma)
        to |= {axis: f"{x:.{digits}f}" for axis, x in zip("ABC", angles.tolist(), strict=True)}
        shift = _shift(sensor, before)
        yield f"{name} without it", said("without:sensor", shift=shift, turn=turn, **to)
    for name, beam in other.beams.items():
        old = result.beams[name]
        sine = float(np.linalg.norm(np.cross(beam.direction, old.direction)))
        turn = math.atan2(sine, float(beam.direction @ old.direction))
        to = _places(beam.location, beam.location_sigma)
        shift = _shift(beam, old)
        yield f"beam {name} without it", said("without:beam", shift=shift, turn=turn, **to)


def _shift(mount: "Mount", before: "Mount") -> float:
    """Return how far a mount moves [m] along the axes along which its location is determined."""
    known = np.isfinite(mount.location_sigma)
    return float(np.linalg.norm((mount.location - before.location)[known]))


def _places(location: FloatArray, sigma: FloatArray) -> dict[str, str]:
    """Return the coordinates of a location as the table of its kind has them."""
    cells = _located(location, sigma)[:3]
    return {axis: cell.text for axis, cell in zip("xyz", cells, strict=True)}


def _errors(errors: Mapping[str, float], sigmas: FloatArray) -> str:
    """Say range errors that were estimated, each with its standard deviation where it has one."""
    parts = []
    for (code, size), sigma in zip(errors.items(), sigmas.tolist(), strict=True):
        unit, factor = UNITS[code]
        known = f" +- {sigma * factor:.2g} {unit}"
        how = known if math.isfinite(sigma) else f" {unit} (undetermined)"
        parts.append(f"{code} {size * factor:.4g}{how}")
    return ", ".join(parts)


def _tested(sensor: "SensorMount") -> str:
    """Say which range errors were found, and the largest that could be there all the same."""
    parts = []
    for code, error in sensor.errors.items():
        unit, factor = UNITS[code]
        size, least = (
            f"{x * factor:{d}} {unit}" for x, d in ((error.size, ".3g"), (error.detectable, ".2g"))
        )
        moved = error.detectable * error.spot_shift
        hidden = said("tested:hidden", code=code, size=least, moved=moved)
        parts.append(f"{code} of {size} found" if error.found else hidden)
    return "; ".join(parts)
