"""Everything that a person can see of a calibration: tables in millimetres and degrees."""

import math
import os
import sys
from collections.abc import Iterator

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.console import Console, RenderableType
from rich.table import Table

from ..data.recording import Recording
from ..quantities import IN_MM
from ..results.calibration import Calibration
from ..results.lines import UNDETERMINED, small_mm, wrapped
from ..results.measuring import spot, typical_plane
from ..results.noise_lines import noise_words, range_error_words, zero_excluded
from ..results.reports import Beam, Plane
from ..results.summary import sizes
from ..results.verdict import Verdict
from ..validation.cross_check import CrossCheck
from .width import ENDLESS, columns, text_width

SHOWN_PLANES, SHOWN_REJECTED, SHOWN_CORRELATIONS = 12, 10, 5
"""Rows of each list on the screen; --json has all."""
ROWS = (
    ("location x", ".4f", "mm"),
    ("location y", ".4f", "mm"),
    ("location z", ".4f", "mm"),
    ("direction x", ".6f", "1"),
    ("direction y", ".6f", "1"),
    ("direction z", ".6f", "1"),
    ("k1", ".6f", "1"),
    ("k2", ".6f", "1/m"),
)


class TableConsole(Console):
    """A console that is silent when its reader has gone, as in `handlaser ... | head`."""

    def on_broken_pipe(self) -> None:
        """Send what is left to nowhere; rich would exit with 1, which means a bug here."""
        self.quiet = True
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def fitting(table: Table, least: int = 0) -> RenderableType:
    """Return a table, or its rows in words where the screen has not the columns that it needs.

    A table needs as many as it has at its widest; or `least`, where a column of prose can be wrapped.
    """
    if (least or Console(width=ENDLESS).measure(table).maximum) <= columns():
        return table
    lines = [str(table.title)] if table.title else []
    titles = [str(column.header) for column in table.columns]
    for row in zip(*(column.cells for column in table.columns), strict=True):
        first, *rest = map(str, row)
        pairs = (f"{title} {cell}" for title, cell in zip(titles[1:], rest, strict=True) if cell)
        lines += wrapped(f"{first}: {', '.join(pairs)}", None, text_width())
    lines += wrapped(str(table.caption), None, text_width()) if table.caption else []
    return "\n".join([*lines, ""])


def calibration_tables(
    result: Calibration, recording: Recording, verdict: Verdict
) -> Iterator[RenderableType]:
    """Yield the parts of the full result, in reading order; no numbers that mean nothing."""
    yield verdict.sentence
    yield _head(result, recording)
    if any(beam.sigma is not None for beam in result.beams.values()):
        for beam in result.beams.values():
            yield fitting(_beam_table(beam, result))
        yield fitting(_plane_table(list(result.planes.values())))
        yield from _spot_lines(result, verdict.reading)
        found = typical_plane(result, recording)
        if found is not None:
            station, plane = found
            yield (
                f"a plane measured by all beams at once, as at station {station}: "
                f"+- {plane.distance_sigma * IN_MM:.3g} mm in distance, "
                f"+- {math.degrees(plane.angle_sigma):.3g} deg in angle"
            )
    yield from _fit_lines(result)
    for check in verdict.limits:
        state = "held" if check.held else "exceeded"
        yield f"limit {state}: {check.comparison} {check.subject}".rstrip()
    yield from systematic_lines(result)
    for warning in result.warnings:
        yield f"WARNING: {warning}"


def systematic_lines(result: Calibration) -> Iterator[str]:
    """Yield all systematic errors that the calibration was tested for."""
    for one in result.systematic:
        subject = f", {one.subject}" if one.subject else ""
        state = "FOUND" if one.found else "confounded" if one.confounded else "not found"
        p = "" if one.confounded else f", p = {one.p_value:.2g}"
        remedy = f"; {one.remedy}" if one.found else ""
        yield f"systematic error {one.code}{subject}: {state}{p}: {one.message}{remedy}"


def cross_check_line(check: CrossCheck) -> str:
    """Return the cross-check in one line."""
    return (
        f"cross-check with SciPy: largest difference {check.largest:.1e} standard deviations "
        f"({check.parameter}); standard deviations agree to {check.largest_sigma:.1e} "
        f"({check.sigma_parameter})"
    )


def _head(result: Calibration, recording: Recording) -> str:
    lines = [sizes(result, recording), f"start: {result.start.method}"]
    if recording.ignored_columns:
        lines.append(f"columns not used: {', '.join(recording.ignored_columns)}")
    if result.status == "converged":
        lines.append(result.message)
    else:
        lines.append(f"NOT A CALIBRATION ({result.status}): {result.message}")
    return "\n".join(lines)


def _beam_table(beam: Beam, result: Calibration) -> Table:
    table = Table(title=f"beam {beam.name}, hand frame", title_justify="left", box=SIMPLE_HEAD)
    for name in ("parameter", "value", "std dev", "95 % from", "to", "unit"):
        table.add_column(name, justify="left" if name in ("parameter", "unit") else "right")
    sigma = np.full(8, np.inf) if beam.sigma is None else beam.sigma
    interval = result.intervals(beam.name)
    interval = np.zeros((8, 2)) if interval is None else interval
    value = beam.coordinates
    for i, (name, spec, unit) in enumerate(ROWS[: 6 + beam.terms]):
        scale = IN_MM if unit == "mm" else 1.0
        numbers = [x * scale for x in (value[i], sigma[i], *interval[i])]
        shown = [format(x, spec) if math.isfinite(sigma[i]) else UNDETERMINED for x in numbers]
        table.add_row(name, *shown, unit)
    turn = math.inf if beam.direction_sigma is None else math.degrees(beam.direction_sigma)
    table.add_row("direction, largest", "", _pair(0.0, turn, ".4f")[1], "", "", "deg")
    if beam.terms:
        found = zip(("k1", "k2")[: beam.terms], zero_excluded(result, beam.name), strict=False)
        listed = (f"{name}: zero {'excluded' if out else 'not excluded'}" for name, out in found)
        table.caption = ", ".join(listed)
        table.caption_justify = "left"
    return table


def _spot_lines(result: Calibration, reading: float) -> Iterator[str]:
    """Yield what the calibration leaves unsure of each laser spot at a reading [m]."""
    if result.covariance is None or math.isnan(reading):
        return
    for name in result.beams:
        found = spot(result, name, reading)
        yield (
            f"laser spot of beam {name} at a reading of {reading * IN_MM:.4g} mm: +- "
            f"{found.along * IN_MM:.3g} mm along the beam, to which a reading adds "
            f"{found.reading_sigma * IN_MM:.3g}, +- {found.across * IN_MM:.3g} mm across, "
            f"+- {math.degrees(found.direction_sigma):.3g} deg"
        )


def _plane_table(planes: list[Plane]) -> Table:
    table = Table(title="planes n . x + b = 0, world frame", title_justify="left", box=SIMPLE_HEAD)
    for name in ("plane", "n x", "n y", "n z", "+- deg", "b mm", "+- mm"):
        table.add_column(name, justify="left" if name == "plane" else "right", no_wrap=True)
    for plane in planes[:SHOWN_PLANES]:
        turn = math.inf if plane.normal_sigma is None else math.degrees(plane.normal_sigma)
        shift = math.inf if plane.offset_sigma is None else plane.offset_sigma * IN_MM
        normal = (_pair(x, turn, ".6f")[0] for x in plane.normal)
        offset = _pair(plane.offset * IN_MM, shift, ".3f")[0]
        spread = _pair(0.0, turn, ".4f")[1], _pair(0.0, shift, ".4f")[1]
        table.add_row(plane.name, *normal, spread[0], offset, spread[1])
    if len(planes) > SHOWN_PLANES:
        table.caption = f"and {len(planes) - SHOWN_PLANES} more; --out or --json has all"
    return table


def _fit_lines(result: Calibration) -> Iterator[str]:
    fit = result.fit
    station, beam = fit.max_residual_at
    yield (
        f"residuals: rms {small_mm(fit.rms, 4)}, largest {small_mm(fit.max_residual, 4)} "
        f"(station {station}, beam {beam})"
    )
    if fit.range_sigma_given:
        yield f"chi2/dof: {fit.chi2:.1f}/{fit.dof}, sigma0 {fit.sigma0:.3f} (1 if the sigmas are right)"
    else:
        yield (
            f"standard deviation of a reading from {fit.dof} degrees of freedom: "
            f"{small_mm(fit.range_sigma, 4)}"
        )
    if fit.poses != "exact":
        yield f"hand poses: {fit.poses}"
    yield noise_words(result)
    yield range_error_words(result)
    pairs = [
        f"strongly correlated: {one.first} and {one.second} ({one.coefficient:+.3f}): {one.advice}"
        for one in result.correlations
    ]
    yield from _first(pairs, SHOWN_CORRELATIONS, "strongly correlated: {} more; --json has all")
    condition = result.observability.condition
    if condition is not None:
        yield f"condition number: {condition:.1f} (usually demanded: below 100; more motion lowers it)"
        if result.observability.weakest:
            yield f"known worst: {result.observability.weakest}"
    rejected = [
        f"rejected: station {one.station}, beam {one.beam}: {one.reason}"
        + ("" if one.residual is None else f", residual {one.residual * IN_MM:.3g} mm")
        for one in fit.rejected
    ]
    yield from _first(rejected, SHOWN_REJECTED, "rejected: {} more; --out or --json has all")


def _first(lines: list[str], most: int, more: str) -> Iterator[str]:
    """Yield the first lines, and how many more there are."""
    yield from lines[:most]
    if len(lines) > most:
        yield more.format(len(lines) - most)


def _pair(value: float, sigma: float, spec: str) -> tuple[str, str]:
    """Return a value and its standard deviation; no value where it is undetermined."""
    if not math.isfinite(sigma):
        return UNDETERMINED, UNDETERMINED
    return format(value, spec), format(sigma, spec)
