"""What is found in a recording before anything is solved, and what is left to be solved."""

from dataclasses import dataclass, replace

from ..errors import CalibrationWarning
from .codes import without_codes
from .columns import refuse_repeated_columns
from .recording import Recording
from .stations import merged_stations


@dataclass(frozen=True, slots=True)
class Screened:
    """A recording as it is solved, and what was found in it.

    Attributes
    ----------
    recording : Recording
        With the stations, beams and planes of the one that was screened. Readings that repeat others,
        or are none, are missing; means stand in place of repeated ones.
    warnings : tuple of CalibrationWarning
    """

    recording: Recording
    warnings: tuple[CalibrationWarning, ...]


def screened(recording: Recording, sigma: float | None) -> Screened:
    """Merge repeated stations, take out readings that are codes, and refuse repeated columns.

    What was screened stays the same when it is screened again.

    Parameters
    ----------
    recording : Recording
    sigma : float, optional
        Standard deviation of a reading, if given [m].

    Raises
    ------
    RepeatedColumnError
        A channel was logged twice.
    InputError
        A beam or a plane is left without readings.
    """
    left, repeated = merged_stations(recording, sigma)
    left, codes = without_codes(left)
    refuse_repeated_columns(left, sigma)
    warnings = (*recording.warnings, *repeated, *codes)
    return Screened(replace(left, warnings=()) if left.warnings else left, warnings)
