"""What was read from a log, beside the recording itself."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from ...data.recording import Recording


@dataclass(frozen=True, slots=True, eq=False)
class LogReport:
    """A recording, and how it came about.

    Attributes
    ----------
    recording : Recording
    scatter : float or None
        Standard deviation of one reading, from readings that repeat [m].
    scatter_of : {beam: sigma}
        The same of each beam that repeats [m].
    lag : float
        How much later readings were taken to be stamped than poses [s].
    lag_sigma : float or None
        Its standard deviation where it was estimated [s].
    lines : texts
        All of this for a person.
    beside : paths
        Files that were read beside the log itself.
    """

    recording: Recording
    scatter: float | None = None
    scatter_of: Mapping[str, float] = field(default_factory=dict)
    lag: float = 0.0
    lag_sigma: float | None = None
    lines: tuple[str, ...] = ()
    beside: tuple[Path, ...] = ()
