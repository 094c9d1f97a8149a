"""Warnings about results by their codes, and sentences with numbers: words are in `messages.toml`."""

import pkgutil
import string
import tomllib
from collections.abc import Mapping

from ..errors import CalibrationWarning
from ..quantities import IN_DEG, IN_MM

_FOUND = tomllib.loads((pkgutil.get_data(__name__, "messages.toml") or b"").decode())
MESSAGES: dict[str, dict[str, str]] = _FOUND
"""Words of warnings and other sentences by code, with a suffix where one code has several words."""
TITLES: dict[str, dict[str, list[str]]] = _FOUND["tables"]
"""Titles of columns by table: of all, of the columns of words, and of the columns that give way."""
MISTAKES: dict[str, dict[str, str | int | list[int]]] = _FOUND["mistakes"]
"""Mistakes of files in words, and what was wrong with positions, ranges, quaternions or rows."""
READ_AS: list[list[str]] = _FOUND["conventions"]["read_as"]
"""Conventions of rotations with their unit of angles, and those in which they were read."""
Values = Mapping[str, float | str]
"""Numbers and names that a warning keeps, SI units."""
IN_UNITS = {"mm": IN_MM, "deg": IN_DEG, "degrees": IN_DEG}


class _InUnits(string.Formatter):
    """Writes values in SI units as a person reads them: {rms_m:.3g mm}; {x:.3f _mm} has no unit."""

    def format_field(self, value: float | str, format_spec: str) -> str:
        digits, _, unit = format_spec.partition(" ")
        if not unit:
            return format(value, digits)
        shown = f"{float(value) * IN_UNITS[unit.removeprefix('_')]:{digits}}"
        return shown if unit.startswith("_") else f"{shown} {unit}"


def said(sentence: str, **words: float | str) -> str:
    """Return one of the sentences with its words."""
    return _filled(MESSAGES["sentences"][sentence], words)


def warned(message: str, values: Values | None = None, **words: float | str) -> CalibrationWarning:
    """Return one of the warnings, which keeps `values` and the numbers of its other words."""
    values = values or {}
    words = {**values, **words}
    kept = {name: x for name, x in words.items() if name in values or not isinstance(x, str)}
    filled = _filled(MESSAGES["warnings"][message], words)
    return CalibrationWarning(message.partition(":")[0], filled, kept)


def _filled(message: str, words: Values) -> str:
    return _InUnits().vformat(message, (), {"checks": MESSAGES["sentences"]["checks"], **words})
