"""Warnings by their codes: the words of all of them stand in `messages.toml`."""

import pkgutil
import string
import tomllib
from collections.abc import Mapping

from ..errors import CalibrationWarning
from ..quantities import IN_DEG, IN_MM

MESSAGES: dict[str, str] = tomllib.loads(
    (pkgutil.get_data(__name__, "messages.toml") or b"").decode()
)
"""Words by code, or by code and what tells messages of one code apart."""
Values = Mapping[str, float | str]
"""Numbers and names that a warning keeps, SI units."""
IN_UNITS = {"mm": IN_MM, "deg": IN_DEG, "degrees": IN_DEG}


class _InUnits(string.Formatter):
    """Writes values in SI units as a person reads them: {rms_m:.3g mm}."""

    def format_field(self, value: float | str, format_spec: str) -> str:
        digits, _, unit = format_spec.partition(" ")
        return f"{float(value) * IN_UNITS[unit]:{digits}} {unit}" if unit else format(value, digits)


def warned(message: str, values: Values | None = None, **words: float | str) -> CalibrationWarning:
    """Return a warning with its words.

    Parameters
    ----------
    message : str
        Of `MESSAGES`.
    values : Values, optional
    words : float or str
        What else its words hold.
    """
    values = {} if values is None else values
    said = _InUnits().vformat(MESSAGES[message], (), {**MESSAGES, **values, **words})
    return CalibrationWarning(message.partition(":")[0], said, values)
