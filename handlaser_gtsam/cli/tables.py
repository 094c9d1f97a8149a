"""What a person sees of a calibration: tables in millimetres and degrees."""

import math
import os
import sys
from collections.abc import Iterator

from rich.box import SIMPLE_HEAD
from rich.console import Console, RenderableType
from rich.table import Table

from ..calibration import Beam, Calibration, Plane
from ..diagnosis.cross_check import CrossCheck
from ..recording import Recording

MM = 1e3
SHOWN_PLANES = 12
SHOWN_REJECTED = 10


class TableConsole(Console):
    """A console that is silent when its reader has gone, as in `handlaser ... | head`."""

    def on_broken_pipe(self) -> None:
        """Send what is left to nowhere; rich would exit with 1, which means a bug here."""
        self.quiet = True
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def calibration_tables(result: Calibration, recording: Recording) -> Iterator[RenderableType]:
    """Yield the parts of the printed result, in reading order; no numbers that mean nothing."""
    yield _head(result, recording)
    if result.status == "converged":
        for beam in result.beams.values():
            yield _beam_table(beam)
        yield _plane_table(list(result.planes.values()))
    yield from _fit_lines(result)
    for warning in result.warnings:
        yield f"WARNING: {warning}"


def cross_check_line(check: CrossCheck) -> str:
    """Return the cross-check in one line."""
    return (
        f"cross-check with SciPy: largest difference {check.largest:.1e} standard deviations "
        f"({check.parameter}); standard deviations agree to {check.largest_sigma:.1e} "
        f"({check.sigma_parameter})"
    )


def _head(result: Calibration, recording: Recording) -> str:
    sizes = (
        _count(len(recording.plane_labels), "station"),
        _count(len(result.planes), "plane"),
        _count(len(result.beams), "beam"),
        _count(result.fit.readings, "reading"),
        f"{len(result.fit.rejected)} left out",
    )
    lines = [
        ", ".join(sizes),
        f"start: {result.start.method}; range error: {result.range_error_choice}",
    ]
    if recording.ignored_columns:
        lines.append(f"columns not used: {', '.join(recording.ignored_columns)}")
    if result.status == "converged":
        lines.append(result.message)
    else:
        lines.append(f"NOT A CALIBRATION ({result.status}): {result.message}")
    return "\n".join(lines)


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}" + ("" if number == 1 else "s")


def _beam_table(beam: Beam) -> Table:
    table = Table(title=f"beam {beam.name}, hand frame", title_justify="left", box=SIMPLE_HEAD)
    for name in ("parameter", "value", "std dev", "unit"):
        table.add_column(name, justify="left" if name in ("parameter", "unit") else "right")
    location, k_sigma, covariance = beam.location_sigma, beam.range_error_sigma, beam.covariance
    for i, axis in enumerate("xyz"):
        sigma = None if location is None else location[i] * MM
        table.add_row(
            f"location {axis}", f"{beam.location[i] * MM:.4f}", _number(sigma, ".4f"), "mm"
        )
    for i, axis in enumerate("xyz"):
        sigma = None if covariance is None else math.sqrt(max(covariance[3 + i, 3 + i], 0.0))
        table.add_row(f"direction {axis}", f"{beam.direction[i]:.6f}", _number(sigma, ".6f"), "1")
    turn = None if beam.direction_sigma is None else math.degrees(beam.direction_sigma)
    table.add_row("direction, largest", "", _number(turn, ".4f"), "deg")
    for i, (name, unit) in enumerate((("k1", "1"), ("k2", "1/m"))[: beam.terms]):
        sigma = None if k_sigma is None else k_sigma[i]
        table.add_row(name, f"{beam.range_error[i]:.6f}", _number(sigma, ".6f"), unit)
    return table


def _plane_table(planes: list[Plane]) -> Table:
    table = Table(title="planes n . x + b = 0, world frame", title_justify="left", box=SIMPLE_HEAD)
    for name in ("plane", "n x", "n y", "n z", "+- deg", "b mm", "+- mm"):
        table.add_column(name, justify="left" if name == "plane" else "right", no_wrap=True)
    for plane in planes[:SHOWN_PLANES]:
        turn = None if plane.normal_sigma is None else math.degrees(plane.normal_sigma)
        shift = None if plane.offset_sigma is None else plane.offset_sigma * MM
        normal = (f"{x:.6f}" for x in plane.normal)
        offset = f"{plane.offset * MM:.3f}"
        table.add_row(plane.name, *normal, _number(turn, ".4f"), offset, _number(shift, ".4f"))
    if len(planes) > SHOWN_PLANES:
        table.caption = f"and {len(planes) - SHOWN_PLANES} more; --out or --json has all"
    return table


def _fit_lines(result: Calibration) -> Iterator[str]:
    fit = result.fit
    station, beam = fit.largest_at
    yield (
        f"residuals: rms {fit.rms * MM:.4g} mm, largest {fit.largest * MM:.4g} mm "
        f"(station {station}, beam {beam})"
    )
    if fit.range_sigma_given:
        yield f"chi2/dof: {fit.chi2:.1f}/{fit.dof}, sigma0 {fit.sigma0:.3f} (1 if the sigma is right)"
    else:
        yield f"range sigma estimated from {fit.dof} degrees of freedom: {fit.range_sigma * MM:.4g} mm"
    condition = result.observability.condition
    if condition is not None:
        yield f"condition number: {condition:.1f} (usually demanded: below 100; more motion lowers it)"
    for left_out in fit.rejected[:SHOWN_REJECTED]:
        residual = (
            "" if left_out.residual is None else f", residual {left_out.residual * MM:.3g} mm"
        )
        yield f"left out: station {left_out.station}, beam {left_out.beam}: {left_out.reason}{residual}"
    if len(fit.rejected) > SHOWN_REJECTED:
        yield f"left out: {len(fit.rejected) - SHOWN_REJECTED} more; --out or --json has all"


def _number(value: float | None, spec: str) -> str:
    return "-" if value is None else format(value, spec)
