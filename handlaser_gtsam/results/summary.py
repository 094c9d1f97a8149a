"""What a person sees of a calibration by default: the verdict first, 30 lines of 100 columns."""

import numpy as np

from ..data.recording import Recording
from ..quantities import IN_MM
from .beam_rows import beam_rows
from .calibration_fields import CalibrationData
from .improvement import WELL_CONDITIONED
from .limits import worst_of_each
from .lines import UNDETERMINED, WIDTH, as_many, count, small_mm, some, wrapped
from .noise_lines import noise_words, range_error_words
from .systematic import SystematicError
from .verdict import Verdict
from .wording import size_in_words

LINES, SHOWN_REJECTED = 30, 3
"""Lines of the whole answer, which then stands on one screen, and readings that one of them lists."""
SHOWN_ERRORS = 4
"""Kinds of systematic errors that are named in one list."""


def screen_lines(
    result: CalibrationData,
    recording: Recording | None,
    verdict: Verdict,
    *,
    closing: int = 0,
    width: int = WIDTH,
) -> list[str]:
    """Return the default screen; `closing` lines of the 30 are kept for what follows it.

    A screen of less than 100 columns has more lines: as many letters.

    Without a recording, as for a calibration read from a graph, nothing is said of its stations.
    """
    beams = list(result.beams.values())

    def some_lines(text: str, most: int) -> list[str]:
        return wrapped(text, as_many(most, width), width)

    lines = wrapped(verdict.sentence, None, width)
    lines += some_lines(_counts(result, recording), 1)
    if any(beam.sigma is not None for beam in beams):
        lines += beam_rows(beams, width)
        lines += some_lines(range_error_words(result), 2)
        lines += some_lines(noise_words(result, brief=True), 2)
    lines += some_lines(_fit(result), 2)
    lines += some_lines(_observability(result), 2)
    if verdict.limits:
        lines += some_lines(_limits(verdict), 2)
    if result.status == "converged":
        lines += some_lines(_systematic(result.systematic, verdict.reading), 2)
    if result.fit.rejected:
        lines += some_lines(_rejected(result), 2)
    return lines + _warnings(result, as_many(LINES, width) - closing - len(lines), width)


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


def _fit(result: CalibrationData) -> str:
    fit = result.fit
    station, beam = fit.max_residual_at
    words = (
        f"fit: rms {small_mm(fit.rms, 3)}, largest {small_mm(fit.max_residual, 3)} "
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
        f"{found.condition:.0f} (usual demand: below {WELL_CONDITIONED:.0f})"
    )
    if found.condition >= WELL_CONDITIONED:
        words += "; the standard deviations hold all the same, and more varied motion lowers both"
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
            f"by {_moved(one, reading, unnoticed=False) * IN_MM:.2g} mm"
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
        f"{size_in_words(worst.unnoticed, worst.unit)}, moving a spot by "
        f"{_moved(worst, reading, unnoticed=True) * IN_MM:.2g} mm"
    )


def _moved(one: SystematicError, reading: float, *, unnoticed: bool) -> float:
    """Return how far a systematic error moves the laser spot [m] that it moves most."""
    return float(np.nan_to_num(one.spots(reading, unnoticed=unnoticed)).max())


def _codes(codes: list[str]) -> str:
    return some(codes, len(codes) if len(codes) <= SHOWN_ERRORS else SHOWN_ERRORS - 1)


def _rejected(result: CalibrationData) -> str:
    names = [f"station {one.station} beam {one.beam}" for one in result.fit.rejected]
    return f"rejected: {count(len(names), 'reading')}: {some(names, SHOWN_REJECTED)} (--verbose)"


def _warnings(result: CalibrationData, room: int, width: int) -> list[str]:
    """Return as many warnings as there is room for, whole; the first one is cut if need be."""
    warnings = [f"WARNING: {one}" for one in result.warnings if one.message != result.message]
    lines: list[str] = []
    for number, warning in enumerate(warnings):
        rest = len(warnings) - number - 1
        left = room - len(lines) - (1 if rest else 0)
        own = wrapped(warning, None, width)
        if len(own) > left and number > 0:
            return [*lines, f"and {count(rest + 1, 'more warning')}: --verbose"]
        lines += own if len(own) <= left else wrapped(warning, max(left, 1), width)
    return lines
