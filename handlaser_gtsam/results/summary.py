"""What a person sees of a calibration by default: the verdict first, 30 lines of 100 columns."""

import math
from collections.abc import Iterator

import numpy as np

from ..arrays import FloatArray
from ..data.recording import Recording
from .calibration_data import CalibrationData
from .limits import worst_of_each
from .lines import DEG, MM, UNDETERMINED, count, decimals, some, with_sigma, wrapped
from .noise_lines import noise_words, range_error_words
from .reports import Beam
from .systematic import SystematicError
from .verdict import Verdict, spot_shift
from .wording import size_in_words

LINES = 30
SHOWN_BEAMS = 8
TWO_ROWS = 4
"""Up to so many beams have two rows each."""
SHOWN_REJECTED = 3
SHOWN_ERRORS = 4
"""Kinds of systematic errors that are named in one list."""
NAME = 8
"""Columns of a beam's name."""


def screen_lines(
    result: CalibrationData, recording: Recording | None, verdict: Verdict, *, closing: int = 0
) -> list[str]:
    """Return the default screen; `closing` lines of the 30 are kept for what follows it.

    Without a recording, as for a calibration read from a graph, nothing is said of its stations.
    """
    beams = list(result.beams.values())
    lines = wrapped(verdict.sentence, 3)
    lines += wrapped(_counts(result, recording), 1)
    if any(beam.sigma is not None for beam in beams):
        lines += _beam_rows(beams) if len(beams) <= TWO_ROWS else _beam_table(beams)
        lines += wrapped(range_error_words(result), 2)
        lines += wrapped(noise_words(result, brief=True), 2)
    lines += wrapped(_fit(result), 2)
    lines += wrapped(_observability(result), 2)
    if verdict.limits:
        lines += wrapped(_limits(verdict), 2)
    if result.status == "converged":
        lines += wrapped(_systematic(result.systematic, verdict.reading), 2)
    if result.fit.rejected:
        lines += wrapped(_rejected(result), 1)
    return lines + _warnings(result, LINES - closing - len(lines))


def sizes(result: CalibrationData, recording: Recording | None) -> str:
    """Return how much there is of everything: "44 stations, 4 planes, ..."."""
    counts = (
        *(() if recording is None else (count(len(recording.plane_labels), "station"),)),
        count(len(result.planes), "plane"),
        count(len(result.beams), "beam"),
        count(result.fit.readings, "reading"),
        f"{len(result.fit.rejected)} rejected",
    )
    return ", ".join(counts)


def _counts(result: CalibrationData, recording: Recording | None) -> str:
    words = f"{sizes(result, recording)}; start: {result.start.method}"
    if recording is not None and recording.ignored_columns:
        words += f"; columns not used: {', '.join(recording.ignored_columns)}"
    return words


def _beam_rows(beams: list[Beam]) -> Iterator[str]:
    """Yield the mounts of few beams: two rows each, every number with its standard deviation."""
    yield "beam      hand frame: location r [mm], unit direction v        range error k1, k2 [1/m]"
    for beam in beams:
        sigma = _sigma(beam)
        for k, (symbol, rows, scale, most) in enumerate(
            (("r", slice(3), MM, 4), ("v", slice(3, 6), 1.0, 6))
        ):
            values, sigmas = beam.coordinates[rows] * scale, sigma[rows] * scale
            digits = _row_decimals(sigmas, most)
            pairs = zip(values.tolist(), sigmas.tolist(), strict=True)
            cells = "".join(f"{with_sigma(x, s, digits):>21}" for x, s in pairs)
            error, own = "0", _row_decimals(sigma[6 + k : 7 + k], 6 - 2 * k)
            if k < beam.terms:
                error = with_sigma(float(beam.range_error[k]), float(sigma[6 + k]), own)
            yield f"{'' if k else _short(beam.name):<{NAME}} {symbol}{cells}  k{k + 1} {error}"


def _beam_table(beams: list[Beam]) -> Iterator[str]:
    """Yield the mounts of many beams: one row each, with the largest standard deviations."""
    yield (
        f"{'beam':<{NAME}}{'x':>9}{'y':>9}{'z [mm]':>9} {'+-':<6}{'vx':>9}{'vy':>9}{'vz':>9} "
        f"{'+- deg':<6}  {'k1':>11} {'k2 [1/m]':>10}"
    )
    for beam in beams[:SHOWN_BEAMS]:
        sigma, most = _sigma(beam), float(_sigma(beam)[:3].max()) * MM
        location = _cells(beam.location * MM, sigma[:3] * MM, 3)
        direction = _cells(beam.direction, sigma[3:6], 5)
        turn = math.inf if beam.direction_sigma is None else beam.direction_sigma * DEG
        k1, k2 = (
            _concise(float(beam.range_error[i]), float(sigma[6 + i]), 4 - i)
            if i < beam.terms
            else "0"
            for i in range(2)
        )
        yield (
            f"{_short(beam.name):<{NAME}}{location} {_size(most):<6}{direction} {_size(turn):<6}  "
            f"{k1:>11} {k2:>10}"
        )
    if len(beams) > SHOWN_BEAMS:
        yield f"and {len(beams) - SHOWN_BEAMS} more beams: --verbose"


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


def _fit(result: CalibrationData) -> str:
    fit = result.fit
    station, beam = fit.max_residual_at
    words = (
        f"fit: rms {fit.rms * MM:.3g} mm, largest {fit.max_residual * MM:.3g} mm "
        f"(station {station}, beam {beam}); "
    )
    if fit.range_sigma_given or result.noise_estimate:
        words += f"sigma0 {fit.sigma0:.2f} (expected 1), "
    return words + count(fit.dof, "degree") + " of freedom"


def _observability(result: CalibrationData) -> str:
    found = result.observability
    if found.condition is None:
        known = f"observability: {found.rank} of {found.unknowns} unknowns determined"
        return f"{known}; {UNDETERMINED}: {'; '.join(found.undetermined)}"
    words = (
        f"observability: all {found.unknowns} unknowns determined, condition number "
        f"{found.condition:.0f} (usual demand: below 100)"
    )
    return f"{words}; known worst: {found.weakest}" if found.weakest else words


def _limits(verdict: Verdict) -> str:
    if verdict.exceeded:
        return f"limits exceeded: {'; '.join(verdict.exceeded)}"
    return f"limits held: {', '.join(one.comparison for one in worst_of_each(verdict.limits))}"


def _systematic(tested: tuple[SystematicError, ...], reading: float) -> str:
    """Say which systematic errors were found, or the largest that could be there all the same."""
    if not tested:
        return "systematic errors: not tested"
    found = sorted((one for one in tested if one.found), key=lambda one: one.p_value)
    if found:
        clear = [
            f"{one.code} of {size_in_words(one.size, one.unit)} (p = {one.p_value:.1g}), moving a spot "
            f"by {_moved(one, reading, unnoticed=False) * MM:.2g} mm"
            for one in found
            if not one.explained_by
        ]
        less = [one.code for one in found if one.explained_by]
        explained = f"; explained by it: {_codes(less)}" if less else ""
        return f"systematic errors found: {some(clear, 1)}{explained}"
    sensitive = [one for one in tested if not one.confounded]
    hidden = [one.code for one in tested if one.confounded]
    words = f"systematic errors: none of {count(len(sensitive), 'kind')} found"
    words += f" (confounded: {_codes(hidden)})" if hidden else ""
    if not sensitive:
        return words
    worst = max(sensitive, key=lambda one: _moved(one, reading, unnoticed=True))
    return (
        f"{words}; the worst unnoticed: {worst.code} below "
        f"{size_in_words(worst.detectable, worst.unit)}, moving a spot by "
        f"{_moved(worst, reading, unnoticed=True) * MM:.2g} mm"
    )


def _moved(one: SystematicError, reading: float, *, unnoticed: bool) -> float:
    """Return how far a systematic error moves the laser spot [m] that it moves most."""
    return float(np.nan_to_num(spot_shift(one, reading, unnoticed=unnoticed)).max())


def _codes(codes: list[str]) -> str:
    return some(codes, len(codes) if len(codes) <= SHOWN_ERRORS else SHOWN_ERRORS - 1)


def _rejected(result: CalibrationData) -> str:
    names = [f"station {one.station} beam {one.beam}" for one in result.fit.rejected]
    return f"rejected: {count(len(names), 'reading')}: {some(names, SHOWN_REJECTED)} (--verbose)"


def _warnings(result: CalibrationData, room: int) -> list[str]:
    """Return as many warnings as there is room for, whole; the first one is cut if need be."""
    warnings = [f"WARNING: {one}" for one in result.warnings if one.message != result.message]
    lines: list[str] = []
    for number, warning in enumerate(warnings):
        rest = len(warnings) - number - 1
        left = room - len(lines) - (1 if rest else 0)
        own = wrapped(warning)
        if len(own) > left and number > 0:
            return [*lines, f"and {count(rest + 1, 'more warning')}: --verbose"]
        lines += own if len(own) <= left else wrapped(warning, max(left, 1))
    return lines
