"""Every error a caller can meet, under one root, and the warnings of a result.

Each error is one cause and carries its numbers as attributes. The message says what was found,
what was expected and what to do.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from .text import printable


class HandlaserError(Exception):
    """Root of all errors raised on purpose by this package."""

    def __reduce__(self) -> tuple[object, ...]:
        """Let the error come back from another process, with its message and its attributes."""
        return _raised, (type(self), self.args, self.__dict__)


def _raised(
    kind: type[HandlaserError], args: tuple[object, ...], attributes: Mapping[str, object]
) -> HandlaserError:
    error = kind.__new__(kind, *args)
    error.__dict__.update(attributes)
    return error


class InputError(HandlaserError):
    """A file or an argument cannot be used; the command line exits with 2.

    Parameters
    ----------
    found, expected : str
        What stands there and what should.
    path : Path, optional
        The file.
    line : int, optional
        Line of the file, counted from 1 (the header is line 1).
    column : str, optional
        Name of the column or field.

    Notes
    -----
    The message is one line of printable text, whatever file names and cells it repeats.
    """

    def __init__(
        self,
        found: str,
        expected: str,
        path: Path | None = None,
        line: int | None = None,
        column: str | None = None,
    ) -> None:
        self.found, self.expected = found, expected
        self.path, self.line, self.column = path, line, column
        place = [str(path)] if path is not None else []
        place += [f"line {line}"] if line is not None else []
        place += [f"column {column}"] if column is not None else []
        where = ", ".join(place)
        message = f"{where}: found {found}; expected {expected}".removeprefix(": ")
        super().__init__(printable(message))


class ArgumentError(InputError):
    """An argument, an option or a field of a file cannot have the value that it was given.

    Parameters
    ----------
    argument : str
        Its name.
    value : str
        The value, as it is shown.
    expected : str
    """

    def __init__(self, argument: str, value: str, expected: str) -> None:
        self.argument, self.value = argument, value
        super().__init__(f"{argument} {value}", expected)

    def called(self, name: str, scale: float = 1.0, unit: str = "") -> "ArgumentError":
        """Return the same of an argument that the user knows by another name, in another unit."""
        del scale, unit  # of numbers only
        return ArgumentError(name, self.value, self.expected)


class NumberError(ArgumentError):
    """A number, or one of several, is beyond its bounds.

    Parameters
    ----------
    argument : str
    values : numbers
    least, most : float
    above : bool
        Whether the least itself is refused, too.
    unit : str
    remedy : str
        What to do, after a semicolon.
    """

    def __init__(
        self,
        argument: str,
        values: tuple[float, ...],
        least: float,
        most: float,
        *,
        above: bool = False,
        unit: str = "",
        remedy: str = "",
    ) -> None:
        self.values, self.least, self.most = values, least, most
        self.above, self.unit, self.remedy = above, unit, remedy
        unit = f" {unit}" if unit else ""
        span = f"above {least:g}, at most {most:g}" if above else f"{least:g} to {most:g}"
        kind = "a number" if len(values) == 1 else f"{len(values)} numbers"
        shown = " ".join(f"{value:g}" for value in values)
        super().__init__(argument, f"{shown}{unit}", f"{kind}, {span}{unit}{remedy}")

    def called(self, name: str, scale: float = 1.0, unit: str = "") -> "NumberError":
        """Return the same of an argument that the user knows by another name, in another unit."""
        return NumberError(
            name,
            tuple(value * scale for value in self.values),
            self.least * scale,
            self.most * scale,
            above=self.above,
            unit=unit or self.unit,
            remedy=self.remedy,
        )


class GrazingBeamError(HandlaserError):
    """A beam runs parallel to its plane, so no range can be predicted."""

    def __init__(self, cosine: float, limit: float) -> None:
        self.cosine, self.limit = cosine, limit
        super().__init__(
            f"beam is parallel to the plane: |cos(incidence)| = {abs(cosine):.2e}, "
            f"expected at least {limit:.0e}; drop the reading or start closer to the solution"
        )


class SolverError(HandlaserError):
    """A solver cannot work on the problem it was given."""


class MissedTargetError(SolverError):
    """A ray misses its target, or a row means nothing there: no residual can be given."""


class NotConvergedError(HandlaserError):
    """A calibration cannot be used: the recording leaves it open, or its readings do not fit."""

    def __init__(self, status: str, message: str) -> None:
        self.status, self.message = status, message
        super().__init__(
            printable(
                f"found a calibration that is {status} ({message}); expected a converged one: "
            )
            + "record what is missing and calibrate again"
        )


@dataclass(frozen=True, slots=True)
class CalibrationWarning:
    """A sign that a result should not be believed as it stands.

    Attributes
    ----------
    code : str
        What kind of sign, in lower case with hyphens; the kinds are listed in docs/messages.md.
    message : str
        What was found, and what to look at.
    values : mapping of str to int, float or str
        The numbers and names of the message, SI units: `{"beam": "2", "readings": 40}`.
    """

    code: str
    message: str
    values: Mapping[str, float | str] = field(default_factory=dict, hash=False)

    def __str__(self) -> str:
        return self.message
