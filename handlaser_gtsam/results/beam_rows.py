"""The mounts of beams on a screen: as much of every number as there is room for."""

import math
from collections.abc import Iterator

import numpy as np

from ..arrays import FloatArray
from ..quantities import IN_DEG, IN_MM
from .lines import WIDTH, decimals, with_sigma
from .reports import Beam

SHOWN_BEAMS = 8
"""Beams that are shown in full: two lines each on half a screen."""
FEW = 4
"""Up to so many beams, every number has its own standard deviation."""
THREE_WIDE = 76
"""Columns that three numbers need with their standard deviations."""
NAME = 8
"""Columns of a beam's name."""
PAIR = 22
"""Columns of a number with its standard deviation: a blank, a sign and six decimals of a direction."""
MOST_OF_ERROR = (5, 4)
"""Decimals of k1 and k2 [1/m]."""


def beam_rows(beams: list[Beam], width: int) -> Iterator[str]:
    """Yield the mounts of beams: every number with its standard deviation, as far as `width` allows."""
    if width < THREE_WIDE:
        yield from _compact_rows(beams)
    elif len(beams) > FEW:
        yield from _beam_table(beams) if width >= WIDTH else _compact_rows(beams)
    else:
        yield from _two_rows(beams) if width >= WIDTH else _three_rows(beams)


def _two_rows(beams: list[Beam]) -> Iterator[str]:
    """Yield the mounts of few beams: two rows each, every number with its standard deviation."""
    yield "beam      hand frame: location r [mm], unit direction v           range error k1, k2 [1/m]"
    for beam in beams:
        (location, direction), (k1, k2) = _each_with_sigma(beam)
        yield f"{location}  k1 {k1}"
        yield f"{direction}  k2 {k2}"


def _three_rows(beams: list[Beam]) -> Iterator[str]:
    """Yield the mounts of few beams on a screen of 80 columns: three rows each."""
    yield "beam      hand frame: location r [mm], unit direction v, errors k1, k2 [1/m]"
    for beam in beams:
        mount, (k1, k2) = _each_with_sigma(beam)
        yield from mount
        yield f"{'':<{NAME}} k{k1:>{PAIR}}{k2:>{PAIR}}"


def _each_with_sigma(beam: Beam) -> tuple[tuple[str, str], tuple[str, str]]:
    """Return rows of location and direction, and k1 and k2, every number with its sigma."""
    sigma, rows = _sigma(beam), []
    for name, symbol, at, scale, most in (
        (_short(beam.name), "r", slice(3), IN_MM, 4),
        ("", "v", slice(3, 6), 1.0, 6),
    ):
        values, sigmas = beam.coordinates[at] * scale, sigma[at] * scale
        digits = _row_decimals(sigmas, most)
        pairs = zip(values.tolist(), sigmas.tolist(), strict=True)
        cells = "".join(f"{with_sigma(x, s, digits):>{PAIR}}" for x, s in pairs)
        rows.append(f"{name:<{NAME}} {symbol}{cells}")
    k1, k2 = (
        with_sigma(float(k), float(s), _row_decimals(np.array([s]), most)) if term else "0"
        for k, s, most, term in zip(
            beam.range_error, sigma[6:], MOST_OF_ERROR, _modelled(beam), strict=True
        )
    )
    return (rows[0], rows[1]), (k1, k2)


def _modelled(beam: Beam) -> tuple[bool, bool]:
    """Return which of k1 and k2 are in the model."""
    return beam.terms > 0, beam.terms > 1


def _compact_rows(beams: list[Beam]) -> Iterator[str]:
    """Yield the mounts of beams on a narrow screen: three rows each, with the largest sigmas."""
    yield "beam, hand frame: location, direction, k1, k2"
    for beam in beams[:SHOWN_BEAMS]:
        (location, most), (direction, turn), (k1, k2) = _largest_sigmas(beam)
        yield f"{_short(beam.name):<{NAME}}{location} +- {most} mm"
        yield f"{'':<{NAME}}{direction} +- {turn} deg"
        yield f"{'':<{NAME}} k1 {k1}, k2 {k2} 1/m"
    yield from _more(beams)


def _largest_sigmas(beam: Beam) -> tuple[tuple[str, str], tuple[str, str], tuple[str, str]]:
    """Return location [mm] and direction [deg], each with its largest sigma, and k1 and k2 [1/m]."""
    sigma = _sigma(beam)
    turn = math.inf if beam.direction_sigma is None else beam.direction_sigma * IN_DEG
    location = (
        _cells(beam.location * IN_MM, sigma[:3] * IN_MM, 3),
        _size(float(sigma[:3].max()) * IN_MM),
    )
    direction = _cells(beam.direction, sigma[3:6], 5), _size(turn)
    k1, k2 = (
        _concise(float(k), float(s), most) if term else "0"
        for k, s, most, term in zip(
            beam.range_error, sigma[6:], (4, 3), _modelled(beam), strict=True
        )
    )
    return location, direction, (k1, k2)


def _more(beams: list[Beam]) -> Iterator[str]:
    if len(beams) > SHOWN_BEAMS:
        yield f"and {len(beams) - SHOWN_BEAMS} more beams: --verbose"


def _beam_table(beams: list[Beam]) -> Iterator[str]:
    """Yield the mounts of many beams: one row each, with the largest standard deviations."""
    yield (
        f"{'beam':<{NAME}}{'x':>9}{'y':>9}{'z [mm]':>9} {'+-':<6}{'vx':>9}{'vy':>9}{'vz':>9} "
        f"{'+- deg':<6}  {'k1':>11} {'k2 [1/m]':>10}"
    )
    for beam in beams[:SHOWN_BEAMS]:
        (location, most), (direction, turn), (k1, k2) = _largest_sigmas(beam)
        yield (
            f"{_short(beam.name):<{NAME}}{location} {most:<6}{direction} {turn:<6}  "
            f"{k1:>11} {k2:>10}"
        )
    yield from _more(beams)


def _sigma(beam: Beam) -> FloatArray:
    return np.full(8, math.inf) if beam.sigma is None else beam.sigma


def _row_decimals(sigmas: FloatArray, most: int) -> int:
    """Return the decimals of a row: two digits of the smallest sigma, three of the largest at most."""
    finite = sigmas[np.isfinite(sigmas)]
    if not len(finite):
        return most
    return min(decimals(float(finite.min()), most), decimals(float(finite.max()), most) + 1, most)


def _cells(values: FloatArray, sigmas: FloatArray, most: int) -> str:
    digits = _row_decimals(sigmas, most)
    cells = [
        f"{x:.{digits}f}" if math.isfinite(s) else "undet."
        for x, s in zip(values.tolist(), sigmas.tolist(), strict=True)
    ]
    return "".join(f"{cell:>9}" for cell in cells)


def _concise(value: float, sigma: float, most: int) -> str:
    """Return a value with the standard deviation of its last digits: "0.0207(56)"."""
    if not math.isfinite(sigma):
        return "undet."
    digits = decimals(sigma, most)
    return f"{value:.{digits}f}({sigma * 10.0**digits:.0f})"


def _size(sigma: float) -> str:
    return f"{sigma:.2g}"[:6] if math.isfinite(sigma) else "undet."


def _short(name: str) -> str:
    return name if len(name) < NAME else name[: NAME - 3] + ".."
