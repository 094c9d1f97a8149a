"""Checks of arguments that several modules share: numbers, words, types, names and covariances.

Each raises InputError, and says what was found and what was expected. A bool is no number here: where a
number belongs, True is a slip.
"""

import math
import sys
from collections.abc import Iterable, Mapping
from dataclasses import fields
from importlib import import_module
from numbers import Integral, Real
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from .arrays import FloatArray, frozen
from .errors import ArgumentError, InputError, NumberError
from .quantities import IN_DEG, IN_MM, LARGEST_LENGTH
from .text import A_NAME, name_fault, shown

if TYPE_CHECKING:
    from _typeshed import DataclassInstance


def require_number(
    name: str,
    value: object,
    least: float,
    most: float,
    *,
    above: bool = False,
    unit: str = "",
    remedy: str = "",
) -> None:
    """Refuse what is no number from `least` to `most`, or is `least` where it must be `above`."""
    number = _number(value)
    if number is not None and least <= number <= most and not (above and number == least):
        return
    known = (math.nan if number is None else number,)
    error = NumberError(name, known, least, most, above=above, unit=unit, remedy=remedy)
    raise error if number is not None else ArgumentError(name, shown(value), error.expected)


def require_fields(
    of: "DataclassInstance",
    *names: str,
    least: float = 0.0,
    most: float = LARGEST_LENGTH,
    above: bool = False,
    unit: str = "",
    remedy: str = "",
) -> None:
    """Refuse fields as `require_number` does; None passes in a field whose default it is."""
    default = {field.name: field.default for field in fields(of)}
    for name in names:
        value = getattr(of, name)
        if value is not None or default[name] is not None:
            require_number(name, value, least, most, above=above, unit=unit, remedy=remedy)


def require_count(name: str, value: object, least: int, most: int) -> None:
    """Refuse what is no whole number from `least` to `most`."""
    whole = isinstance(value, Integral) and not isinstance(value, (bool, np.bool_))
    if not (whole and least <= int(value) <= most):  # type: ignore[call-overload]
        raise ArgumentError(name, shown(value), f"a whole number, {least} to {most}")


def require_word(name: str, value: object, words: Iterable[str]) -> None:
    """Refuse what is none of `words`."""
    listed = tuple(words)
    if not (isinstance(value, str) and value in listed):
        raise ArgumentError(name, shown(value), f"one of {', '.join(map(repr, listed))}")


def require_bool(name: str, value: object) -> None:
    """Refuse what is neither True nor False."""
    if not isinstance(value, (bool, np.bool_)):
        raise ArgumentError(name, shown(value), "True or False")


def require_kind(name: str, value: object, kind: type, expected: str = "") -> None:
    """Refuse what is no instance of `kind`; say what is `expected`, or name the class."""
    if not isinstance(value, kind):
        package, _, folder = ".".join(kind.__module__.split(".")[:2]).partition(".")
        # The public name: at the top of the package, or in the module of the folder.
        at_top = kind.__name__ in dir(sys.modules.get(package))
        home = package if at_top or not folder else f"{package}.{folder}"
        given = f"{shown(value)} of type {type(value).__name__} as {name}"
        raise InputError(given, expected or f"{home}.{kind.__name__}(...)")


def imported(name: str, extra: str, found: str, path: Path | None = None, more: str = "") -> Any:
    """Return a module that an extra of this package brings.

    Parameters
    ----------
    name, extra : str
        Of the module and of the extra.
    found : str
        What is said where the module is missing.
    path : Path, optional
        The file that needs it.
    more : str
        What else would do, behind how to install the extra.

    Raises
    ------
    InputError
        The module is not installed.
    """
    try:
        return import_module(name)
    except ImportError as error:
        expected = f"pip install 'handlaser-gtsam[{extra}]'{more}"
        raise InputError(found, expected, path) from error


def require_names(kind: str, names: object) -> None:
    """Refuse names that are no text, empty, too long, not printable, or blank at the ends.

    A single text is refused too: its letters would be taken for the names.
    """
    if isinstance(names, str) or not isinstance(names, Iterable):
        raise InputError(f"{shown(names)} for {kind}, one each", "a sequence of texts")
    good: set[str] = set()
    for name in names:
        if isinstance(name, str) and name in good:
            continue
        fault = name_fault(name)
        if fault:
            raise InputError(f"{fault} as {kind}", A_NAME)
        good.add(name)


def number_array(name: str, values: ArrayLike, expected: str = "numbers") -> FloatArray:
    """Return `values` as a read-only float array, NaN where a masked array is masked.

    Raises
    ------
    InputError
        They are no array of real numbers: rows of different lengths, text, or True and False.
    """
    try:
        if isinstance(values, np.ma.MaskedArray):
            values = np.ma.filled(values.astype(np.float64), np.nan)
        kind = np.asarray(values).dtype
        if kind.kind not in "fiuO":
            raise TypeError(f"its entries are of type {kind}")
        return frozen(values)
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError(f"{name}: no array of numbers ({error})", expected) from error


def require_covariance(name: str, matrix: FloatArray, tolerance: float) -> None:
    """Refuse matrices (..., n, n) that are not finite, symmetric and positive semidefinite.

    Symmetry and eigenvalues are judged on correlations, so that units do not matter, to `tolerance`.
    Standard deviations above `LARGEST_LENGTH` are refused as well: products of larger numbers overflow.
    """
    if not np.isfinite(matrix).all():
        raise InputError(f"{name} with numbers that are not finite", "finite numbers")
    if (np.abs(matrix) > LARGEST_LENGTH**2).any():
        found = f"{name} with the entry {float(np.abs(matrix).max()):g}"
        raise InputError(found, f"variances in SI units, at most {LARGEST_LENGTH**2:g}")
    variance = np.einsum("...ii->...i", matrix)
    if (variance < 0.0).any():
        found = f"{name} with the variance {float(variance.min()):g}"
        raise InputError(found, "variances that are zero or positive")
    scale = np.sqrt(variance)
    unit = scale[..., :, None] * scale[..., None, :]
    transposed = np.swapaxes(matrix, -1, -2)
    if (np.abs(matrix - transposed) > tolerance * unit).any():
        raise InputError(f"{name} that is not symmetric", "a symmetric matrix")
    beyond = bool((np.abs(matrix) > (1.0 + tolerance) * unit).any())  # a correlation above 1
    if not beyond:
        correlation = np.divide(matrix, unit, out=np.zeros_like(matrix), where=unit > 0.0)
        beyond = float(np.linalg.eigvalsh(correlation).min()) < -tolerance
    if beyond:
        expected = "a positive semidefinite matrix: correlations that go together"
        raise InputError(f"{name} that is not positive semidefinite", expected)


UNITS = {
    "_mm": (IN_MM, "mm"),
    "_deg": (IN_DEG, "deg"),
    "_percent": (100.0, "%"),
    "_per_m": (1.0, "1/m"),
    "_s": (1.0, "s"),
}
"""By the ending of a field's or an option's name: what a number in SI units is multiplied by there."""


def as_called(error: ArgumentError, names: Mapping[str, str]) -> ArgumentError:
    """Return an error in the words and units of who stated the value.

    Parameters
    ----------
    error : ArgumentError
        Names an argument in Python, in SI units: `range_sigma`.
    names : mapping of str to str
        By field, as `range_sigma_mm`, how it is called: `noise.range_sigma_mm`, `--range-sigma-mm`.
    """
    argument = error.argument.rpartition(".")[2]  # of a table, as a rig file calls it
    if argument in names:
        return error.called(names[argument])
    both_ends = argument.removesuffix("_min").removesuffix("_max")
    for ending, (scale, unit) in UNITS.items():
        if both_ends + ending in names:
            return error.called(names[both_ends + ending], scale, unit)
    return error


def _number(value: object) -> float | None:
    """Return a real number as a float, infinite where it is too large; None for anything else."""
    if isinstance(value, (bool, np.bool_)) or not isinstance(value, Real):
        return None
    try:
        return float(value)
    except OverflowError:
        return math.inf
