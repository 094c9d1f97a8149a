"""The table [log] of a rig file: how logs are written, see `logs.format`."""

from collections.abc import Mapping
from dataclasses import fields, replace
from pathlib import Path

from .checked_text import FileRecord
from .logs.format import LogFormat

ONE_OF = (
    ("pose_format", "rotation"),
    ("plane", "plane_column", "plane_ranges", "plane_file"),
    ("pose_topic", "frames"),
    ("stands", "interpolate"),
    ("lag_s", "estimate_lag"),
)
"""Fields that exclude each other: where a user states one, those of the rig file do not count."""
NAMES = tuple(one.name for one in fields(LogFormat))


class LogTable(FileRecord):
    """The table [log] of a rig file."""

    pose_format: str | None = None
    rotation: str | None = None
    units: str | None = None
    angles: str | None = None
    inverted: bool | None = None
    tool: list[float] | None = None
    base: list[float] | None = None
    pose_columns: list[str] | None = None
    plane_column: str | None = None
    station_column: str | None = None
    time_column: str | None = None
    range_columns: list[str] | None = None
    beam_column: str | None = None
    range_column: str | None = None
    range_units: str | None = None
    plane: str | None = None
    plane_ranges: list[str] | None = None
    plane_file: str | None = None
    header: list[str] | None = None
    delimiter: str | None = None
    decimal: str | None = None
    sheet: str | None = None
    readings: str | None = None
    readings_station_column: str | None = None
    readings_time_column: str | None = None
    time_units: str | None = None
    tolerance_s: float | None = None
    interpolate: bool | None = None
    stands: bool | None = None
    stand_s: float | None = None
    stand_mm: float | None = None
    stand_deg: float | None = None
    average: str | None = None
    lag_s: float | None = None
    estimate_lag: bool | None = None
    pose_topic: str | None = None
    frames: list[str] | None = None
    receive_time: bool | None = None
    range_sigma_from_scatter: bool | None = None
    as_stated: bool | None = None

    def to_format(self, folder: Path) -> LogFormat:
        """Return the format; files are named from a folder on.

        Raises
        ------
        InputError
        """
        stated: dict[str, object] = {
            name: tuple(value) if isinstance(value, list) else value
            for name, value in self.model_dump(exclude_none=True).items()
        }
        for name in ("readings", "plane_file"):
            if name in stated:
                stated[name] = folder / str(stated[name])
        return with_stated(LogFormat(), stated)


def with_stated(known: LogFormat, given: Mapping[str, object]) -> LogFormat:
    """Return a format with what is `given` instead; names of no field are passed over.

    Raises
    ------
    InputError
        Values that cannot be, or contradict each other.
    """
    stated = {name: given[name] for name in NAMES if given.get(name) is not None}
    plain = LogFormat()
    for group in ONE_OF:
        if any(name in stated for name in group):
            for name in group:
                stated.setdefault(name, getattr(plain, name))
    return replace(known, **stated) if stated else known  # type: ignore[arg-type]  # checked there
