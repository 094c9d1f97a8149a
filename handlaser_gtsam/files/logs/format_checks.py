"""Whether what a user states of a log can be, and what its poses mean."""

from dataclasses import fields
from typing import TYPE_CHECKING

from ...checks import require_bool, require_fields, require_number, require_word
from ...errors import ArgumentError, InputError
from ...model.conventions import EULER, FORMATS, Convention, spelled_columns
from ...quantities import LARGEST_LENGTH
from ...text import name_fault, shown
from ..writing import path_of

if TYPE_CHECKING:
    from .format import LogFormat

EXCLUSIVE = {
    ("pose_format", "rotation"): "one of the two: the format says what rotation it has",
    ("plane", "plane_column", "plane_ranges", "plane_file"): "one way to state planes",
    ("pose_topic", "frames"): "one of the two",
    ("stands", "interpolate"): "one of the two: the arm stands, or it moves",
}
"""Fields of which one at most is stated; where a user states one, the rig file's do not count."""
DELIMITERS = {"comma": ",", "semicolon": ";", "tab": "\t", "space": " "}


def check_format(given: "LogFormat") -> None:
    """Refuse values that cannot be or contradict each other; store lists as tuples.

    Raises
    ------
    InputError
    """
    _check_kinds(given)
    if given.delimiter:
        require_word("delimiter", given.delimiter, DELIMITERS)
    require_fields(given, "tolerance_s", "stand_s", above=True, unit="s")
    require_fields(given, "stand_mm", most=1e3, above=True, unit="mm")
    require_fields(given, "stand_deg", most=180.0, above=True, unit="deg")
    # A clock that counts from 1970 and one that counts from its start differ by less.
    most = 1e4 * LARGEST_LENGTH
    require_number("lag_s", given.lag_s, -most, most, unit="s")
    _check_together(given)
    convention_of(given)  # one that cannot be is refused now


def convention_of(given: "LogFormat") -> Convention:
    """Return what the numbers of a pose mean.

    Raises
    ------
    InputError
        A rotation that is none.
    """
    known = FORMATS[given.pose_format or "ros"]
    if given.rotation:
        known = Convention(given.rotation, "m", "rad", spelled_columns(given.rotation))
    units, angles = given.units or known.units, given.angles or known.angles
    return Convention(known.rotation, units, angles, known.columns, given.pose_columns)


def _check_kinds(given: "LogFormat") -> None:
    """Refuse values of other types, and store lists as tuples."""
    for one in fields(given):
        value, default, words = getattr(given, one.name), one.default, given.words_of(one.name)
        if words:
            if value is not None or default is not None:
                require_word(one.name, value, words)
        elif isinstance(default, bool):
            require_bool(one.name, value)
        elif isinstance(default, tuple):
            numbers = one.name in ("tool", "base")
            object.__setattr__(given, one.name, _tuple_of(one.name, value, numbers=numbers))
        elif one.name in ("readings", "plane_file"):
            if value is not None:
                object.__setattr__(given, one.name, path_of(value))
        elif isinstance(default, str) and not isinstance(value, str):
            raise ArgumentError(one.name, shown(value), "a text")
    if given.pose_format:
        require_word("pose_format", given.pose_format, FORMATS)


def _tuple_of(name: str, value: object, *, numbers: bool) -> tuple[object, ...]:
    expected = "a sequence of numbers" if numbers else "a sequence of texts"
    if isinstance(value, str) or not isinstance(value, (list, tuple)):
        raise ArgumentError(name, shown(value), expected)
    for one in value:
        if numbers:
            require_number(name, one, -1e6, 1e6)
        elif not isinstance(one, str) or not one:
            raise InputError(f"{shown(one)} in {name}", expected)
    return tuple(map(float, value)) if numbers else tuple(value)


def _check_together(given: "LogFormat") -> None:
    """Refuse what contradicts each other, or lacks another field."""
    for group, expected in EXCLUSIVE.items():
        stated = [f"--{name.replace('_', '-')}" for name in group if getattr(given, name)]
        if len(stated) > 1:
            raise InputError(" and ".join(stated), expected)
    if given.rotation and given.units is None:
        raise InputError(f"--rotation {given.rotation} without --units", "--units m, mm or in")
    turned = EULER.fullmatch(given.rotation) or given.rotation == "rotvec"
    if turned and given.angles is None:
        raise InputError(f"--rotation {given.rotation} without --angles", "--angles deg or rad")
    if bool(given.beam_column) != bool(given.range_column):
        raise InputError("one of --beam-column and --range-column", "both, of a long table")
    if given.beam_column and given.range_columns:
        raise InputError("--range-columns and --beam-column", "a wide or a long table")
    if given.plane and name_fault(given.plane):
        raise InputError(name_fault(given.plane), "a name for the plane")
    if len(given.frames) not in (0, 2):
        expected = "two: the world and the hand, as tf calls them"
        raise InputError(f"--frames of {len(given.frames)} names", expected)
