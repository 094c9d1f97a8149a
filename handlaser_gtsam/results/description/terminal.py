"""What a person sees of a calibration: the verdict first, on one screen of 30 lines of 100 columns.

And in full, where every table is asked for.
"""

from typing import TYPE_CHECKING

from ...model.distributions import p_words
from ...model.effects.effect import size_in_words
from ...quantities import IN_MM
from ...text import count, some
from ..lines import NAMES_IN_LINE, WIDTH, as_many, wrapped
from ..messages import said
from ..systematic import SystematicError
from .tables import PLAIN, ROWS_ON_SCREEN, Facts, full_table, text_lines, text_table

if TYPE_CHECKING:
    from .beams import CalibrationDescription

LINES = 30
"""Lines of the whole answer, which then stands on one screen."""
BRIEF = ("rms residual", "largest residual", "sigma0", "degrees of freedom")
"""Facts of the fit that stand on the screen."""


def screen_lines(
    described: "CalibrationDescription", *, closing: int = 0, width: int = WIDTH
) -> list[str]:
    """Return the default screen; `closing` lines of the 30 are kept for what follows it.

    A screen of less than 100 columns has more lines: as many letters. Where the first warning would
    not fit, what is said of observability, systematic errors and the other facts is cut before it is.
    """
    first = wrapped("".join(_warning_texts(described)[:1]), None, width)
    lines, room = [], 0
    for most in (3, 2, 1):
        lines = _above_warnings(described, most, width)
        room = as_many(LINES, width) - closing - len(lines)
        if len(first) <= room:
            break
    return lines + _warnings(described, room, width)


def _above_warnings(described: "CalibrationDescription", evidence: int, width: int) -> list[str]:
    """Return the screen up to the warnings.

    Noise, observability and systematic errors have `evidence` lines each, at most, and other facts at
    most two of them; freed errors, which warnings are of, have three.
    """
    calibration, verdict, fit = described.calibration, described.verdict, dict(described.fit)
    few, of = min(2, evidence), dict[str, int]()
    if any(beam.sigma is not None for beam in calibration.beams.values()):
        of = {"range errors": few, "freed errors": 3, "noise": evidence}
    facts = [(name, fit[name], most) for name, most in of.items() if name in fit]
    facts.append(("fit", ", ".join(f"{name} {fit[name]}" for name in BRIEF if name in fit), few))
    facts.append(("observability", " ".join(described.observability[:3]), evidence))
    if verdict.exceeded:
        facts.append(("limits exceeded", "; ".join(verdict.exceeded), few))
    elif verdict.limits:
        nearest = ", ".join(check.comparison for check in verdict.worst_limits)
        facts.append(("limits held", nearest, few))
    if described.solved:
        tested = _systematic(calibration.systematic, verdict.reading)
        facts.append(("systematic errors", tested, evidence))
    if calibration.fit.rejected:
        names = [f"station {it.station} beam {it.sensor}" for it in calibration.fit.rejected]
        listed = some(names, NAMES_IN_LINE - 1)  # a station and its beam take the room of two names
        facts.append(("rejected", f"{count(len(names), 'reading')}: {listed} (--verbose)", few))
    lines = wrapped(verdict.sentence, None, width)
    lines += wrapped(_head(described), as_many(1, width), width)
    if described.beams is not None:
        lines += text_table(described.beams, width, ROWS_ON_SCREEN)
    for name, words, most in facts:
        lines += wrapped(f"{name}: {words}".translate(PLAIN), as_many(most, width), width)
    return lines


def full_lines(described: "CalibrationDescription", width: int = WIDTH) -> list[str]:
    """Return everything that there is to say, in reading order."""
    calibration = described.calibration
    opening = [described.verdict.sentence, _head(described)]
    if not described.solved:
        opening.append(f"NOT A CALIBRATION ({calibration.status}): {calibration.message}")
    lines = text_lines(opening, width)
    lines += full_table("mounts", described.mounts, width)
    lines += full_table("laser spots", described.spots, width)
    lines += full_table("planes", described.planes, width)
    lines += full_table("limits", described.limits, width)
    lines += _fact_lines(described.fit, width)
    lines += text_lines([f"observability: {' '.join(described.observability)}"], width)
    if described.correlations is not None and described.correlations.rows:
        lines += full_table("correlations", described.correlations, width)
    lines += full_table("systematic errors", described.systematic, width)
    lines += _fact_lines(described.systematic_facts, width)
    lines += full_table("rejected readings", described.rejected, width)
    return lines + text_lines(_warning_texts(described), width)


def _warning_texts(described: "CalibrationDescription") -> list[str]:
    return [f"WARNING: {words}" for words in described.warnings]


def _fact_lines(facts: Facts, width: int) -> list[str]:
    return text_lines([f"{name}: {words}" for name, words in facts], width)


def _head(described: "CalibrationDescription") -> str:
    calibration = described.calibration
    words = f"{described.sizes}; start: {calibration.start.method}"
    recording = calibration.recording
    if recording is not None and recording.ignored_columns:
        words += f"; columns not used: {', '.join(recording.ignored_columns)}"
    return words


def _systematic(tested: tuple[SystematicError, ...], reading: float) -> str:
    """Say which systematic errors were found, or the largest that could be there all the same."""
    if not tested:
        return "not tested"
    found = sorted((error for error in tested if error.found), key=lambda error: error.p_value)
    if found:
        clear = [
            f"{error.code} of {size_in_words(error.size, error.unit)} ({p_words(error.p_value, 1)}), "
            f"moving a spot by {error.moved(reading, unnoticed=False) * IN_MM:.2g} mm"
            for error in found
            if not error.explained_by
        ]
        explained = [error.code for error in found if error.explained_by]
        if not clear:
            return f"none but what the displacement explains ({some(explained, NAMES_IN_LINE)})"
        return "; ".join(clear) + (
            f" (which explains {some(explained, NAMES_IN_LINE)})" if explained else ""
        )
    tested_for = [error for error in tested if not error.confounded]
    hidden = [error.code for error in tested if error.confounded]
    words = f"none of {count(len(tested_for), 'kind')} found"
    words += f" (cannot be told: {some(hidden, NAMES_IN_LINE)})" if hidden else ""
    if not tested_for:
        return words
    worst = max(tested_for, key=lambda error: error.moved(reading, unnoticed=True))
    size, moved = size_in_words(worst.unnoticed, worst.unit), worst.moved(reading, unnoticed=True)
    return said("unnoticed", words=words, code=worst.code, size=size, moved=moved)


def _warnings(described: "CalibrationDescription", room: int, width: int) -> list[str]:
    """Return as many warnings as there is room for, whole; the first one is cut if need be."""
    warnings = _warning_texts(described)
    lines: list[str] = []
    for number, warning in enumerate(warnings):
        rest = len(warnings) - number - 1
        left = room - len(lines) - (1 if rest else 0)
        own = wrapped(warning, None, width)
        if len(own) > left and number > 0:
            return [*lines, f"and {count(rest + 1, 'more warning')}: --verbose"]
        lines += own if len(own) <= left else wrapped(warning, max(left, 1), width)
    return lines
