"""Somebody else's graph: the variables of beams and planes in it, and how its range factors fit."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace

import gtsam
import numpy as np

from ..arrays import FloatArray
from ..errors import InputError
from ..factors.keys import BeamKeys
from ..quantities import NEGLIGIBLE
from .fit import fit_of_rows
from .reports import Fit


@dataclass(frozen=True, slots=True)
class Variable:
    """A variable that is read, or a kind of them: what it is, how it is read, and its type in words.

    `powers` are the natural units of its columns, as powers of the typical range.
    """

    words: str
    read: Callable[[gtsam.Values, int], object]
    expected: str
    powers: tuple[int, ...]
    key: int = 0


KINDS = (
    Variable("location of beam", gtsam.Values.atPoint3, "Point3", (1, 1, 1)),
    Variable("direction of beam", gtsam.Values.atUnit3, "Unit3", (0, 0)),
    Variable("range error of beam", gtsam.Values.atVector, "vector (k1,) or (k1, k2)", (0, -1)),
    Variable("plane", gtsam.Values.atOrientedPlane3, "OrientedPlane3", (0, 0, 1)),
)
"""Kinds of variables: of a beam three lengths; two angles; a number k1, and k2 per length; of a plane
two angles of the normal, and the offset, which is a length."""


@dataclass(frozen=True, slots=True, eq=False)
class OwnGraph:
    """A graph at some values, and the names of the beams and planes among its variables."""

    graph: gtsam.NonlinearFactorGraph
    values: gtsam.Values
    beams: Mapping[str, BeamKeys]
    planes: Mapping[str, int]

    def factors(self) -> list[tuple[int, gtsam.NonlinearFactor]]:
        """Return the factors that there are, with their numbers."""
        return [(i, self.graph.at(i)) for i in range(self.graph.size()) if self.graph.exists(i)]

    def terms(self) -> tuple[int, ...]:
        """Return how many range-error terms each beam has."""
        keys = [beam.range_error for beam in self.beams.values()]
        return tuple(0 if key is None else int(self.values.atVector(key).size) for key in keys)

    def variables(self) -> list[Variable]:
        """Return the variables to be read, each once.

        Raises
        ------
        InputError
            No beams, or a key without a value of the right type, or that is not in the graph.
        """
        if not self.beams:
            raise InputError("no beams", "a name and BeamKeys for each")
        inside = set(self.graph.keyVector())
        for key in inside:
            if not self.values.exists(key):
                expected = "one for every variable of the graph"
                raise InputError(f"no value of {key_name(key)}", expected)
        asked = [
            replace(kind, words=f"{kind.words} {name}", key=key)
            for name, beam in self.beams.items()
            for kind, key in zip(KINDS, beam.variables, strict=False)
        ]
        asked += [
            replace(KINDS[-1], words=f"plane {name}", key=key) for name, key in self.planes.items()
        ]
        found: dict[int, Variable] = {}
        for one in asked:
            if one.key not in inside:
                raise InputError(
                    f"{one.words} under {key_name(one.key)}", "a variable of the graph"
                )
            try:
                value = one.read(self.values, one.key)
            except RuntimeError as error:
                other = f"another type under {key_name(one.key)}, {one.words}"
                raise InputError(other, f"a {one.expected}") from error
            dim = len(one.powers)
            if one.read is gtsam.Values.atVector:
                dim = np.asarray(value).size
                if not 1 <= dim <= len(one.powers):
                    raise InputError(f"{dim} numbers as {one.words}", f"a {one.expected}")
            found.setdefault(one.key, replace(one, powers=one.powers[:dim]))
        return list(found.values())


def key_name(key: int) -> str:
    """Return a key as people write it: x3, or the number."""
    return str(gtsam.DefaultKeyFormatter(key))


def fit_of_graph(own: OwnGraph, unknowns: int) -> Fit:
    """Return how the rows of the range factors fit; chi2 and dof count the whole graph.

    Raises
    ------
    InputError
        A beam without a range factor to these planes, two names for one beam, or an error that is no
        number.
    """
    if len({beam.variables for beam in own.beams.values()}) < len(own.beams):
        raise InputError("two names for one beam", "different variables for every beam")
    found = list(_factors(own))
    for i, name in enumerate(own.beams):
        if all(beam != i for _, _, beam, _ in found):
            raise InputError(f"no range factor of beam {name} to these planes", "at least one")
    chi2 = 2.0 * own.graph.error(own.values)
    dof = sum(factor.dim() for _, factor in own.factors()) - unknowns
    if not np.isfinite(chi2):
        raise InputError(f"an error of the graph of {chi2}", "values that are finite numbers")
    errors = [np.atleast_1d(one.unwhitenedError(own.values)) for one, *_ in found]
    counts = [len(e) for e in errors]
    labels = [
        label if count == 1 else f"{label} row {row + 1}"
        for (_, label, *_), count in zip(found, counts, strict=True)
        for row in range(count)
    ]
    e, beam = np.concatenate(errors), np.repeat([i for _, _, i, _ in found], counts)
    sigma = np.concatenate([_sigmas(one.noiseModel(), one.dim()) for one, *_ in found])
    s = np.concatenate([_ranges(one, own.values) for one, *_ in found])
    return fit_of_rows(
        (labels, tuple(own.beams)),
        (np.arange(len(e)), beam),
        e,
        e / sigma,
        s,
        chi2=chi2,
        dof=dof,
        range_sigma=float(np.median(sigma)),
        given=True,
        poses="estimated" if any(posed for *_, posed in found) else "exact",
        loss="gaussian",
    )


def _factors(own: OwnGraph) -> Iterator[tuple[gtsam.CustomFactor, str, int, bool]]:
    """Yield the range factors of these beams and planes.

    Each with the name of its pose or its number, the number of its beam, and whether it has a pose.
    """
    owner = {beam.variables: i for i, beam in enumerate(own.beams.values())}
    planes = set(own.planes.values())
    for i, factor in own.factors():
        if not isinstance(factor, gtsam.CustomFactor):
            continue
        *keys, last = factor.keys()
        posed = last not in planes
        plane = keys.pop() if posed else last
        if tuple(keys) in owner and plane in planes:
            name = key_name(last) if posed else f"factor {i}"
            yield factor, name, owner[tuple(keys)], posed


def _ranges(factor: gtsam.CustomFactor, values: gtsam.Values) -> FloatArray:
    """Return the ranges (N,) of a range factor [m]; NaN where a beam is perpendicular to its plane.

    A factor does not give its readings away, but its derivatives do: with the range s and the tangent
    basis B of the direction, de/dv = s de/dr B. Weights of rows cancel.
    """
    jacobian, _ = factor.linearize(values).jacobian()
    by_location, by_direction = jacobian[:, :3], jacobian[:, 3:5]
    across = by_location @ values.atUnit3(list(factor.keys())[1]).basis()
    square = (across**2).sum(axis=1)
    # Squares of the sine of the incidence; a row at right angles says nothing of its range.
    seen = square > NEGLIGIBLE * (by_location**2).sum(axis=1)
    product = (by_direction * across).sum(axis=1)
    found: FloatArray = np.where(seen, product / np.where(seen, square, 1.0), np.nan)
    return found


def _sigmas(model: gtsam.noiseModel.Base, rows: int) -> FloatArray:
    """Return the standard deviations of a noise model, of the inner model where it is robust."""
    inner = model.noise() if isinstance(model, gtsam.noiseModel.Robust) else model
    sigmas = inner.sigmas() if hasattr(inner, "sigmas") else np.ones(rows)
    return np.asarray(sigmas, dtype=np.float64)
