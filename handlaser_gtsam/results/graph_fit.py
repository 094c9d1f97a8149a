"""How the range factors of somebody else's graph fit."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import gtsam
import numpy as np

from ..arrays import FloatArray
from ..errors import InputError
from ..keys import BeamKeys
from .fit import FitRows, fit_of_rows
from .graph_variables import key_name
from .reports import Fit

LEAST_OBLIQUE = 1e-6
"""Squared sine of the incidence below which a row says nothing of its range."""


@dataclass(frozen=True, slots=True)
class _Row:
    """A row of a range factor: label, beam, residual, sigma and range [m], whether it has a pose."""

    label: str
    beam: int
    residual: float
    sigma: float
    range: float
    posed: bool


def fit_of_graph(
    graph: gtsam.NonlinearFactorGraph,
    values: gtsam.Values,
    beams: Mapping[str, BeamKeys],
    planes: Mapping[str, int],
    unknowns: int,
) -> Fit:
    """Return how the rows of the range factors fit; chi2 and dof are those of the whole graph.

    Raises
    ------
    InputError
        A beam without a range factor to these planes, two names for one beam, or an error that is no
        number.
    """
    if len({tuple(_keys(beam)) for beam in beams.values()}) < len(beams):
        raise InputError("two names for one beam", "different variables for every beam")
    rows = list(_rows(graph, values, beams, set(planes.values())))
    for i, name in enumerate(beams):
        if all(row.beam != i for row in rows):
            raise InputError(f"no range factor of beam {name} to these planes", "at least one")
    chi2 = 2.0 * graph.error(values)
    dof = sum(graph.at(i).dim() for i in _indices(graph)) - unknowns
    if not np.isfinite(chi2):
        raise InputError(f"an error of the graph of {chi2}", "values that are finite numbers")
    e, sigma, s = np.array([(row.residual, row.sigma, row.range) for row in rows]).T
    labels, own = [row.label for row in rows], np.array([row.beam for row in rows])
    of_rows = FitRows(labels, tuple(beams), np.arange(len(rows)), own, e, e / sigma, s)
    posed = any(row.posed for row in rows)
    return fit_of_rows(
        of_rows,
        chi2=chi2,
        dof=dof,
        range_sigma=float(np.median(sigma)),
        given=True,
        poses="estimated" if posed else "exact",
        loss="gaussian",
    )


def _rows(
    graph: gtsam.NonlinearFactorGraph,
    values: gtsam.Values,
    beams: Mapping[str, BeamKeys],
    planes: set[int],
) -> Iterator[_Row]:
    """Yield the rows of factors of one of the beams and one of the planes."""
    owner = {tuple(_keys(beam)): i for i, beam in enumerate(beams.values())}
    for i in _indices(graph):
        factor = graph.at(i)
        if not isinstance(factor, gtsam.CustomFactor):
            continue
        keys = list(factor.keys())
        posed = keys[-1] not in planes
        beam = owner.get(tuple(keys[: -2 if posed else -1]))
        if beam is None or keys[-2 if posed else -1] not in planes:
            continue
        name = key_name(keys[-1]) if posed else f"factor {i}"
        e = np.atleast_1d(factor.unwhitenedError(values))
        sigma, ranges = _sigmas(factor.noiseModel(), len(e)), _ranges(factor, values)
        for row, one in enumerate(zip(e.tolist(), sigma.tolist(), ranges.tolist(), strict=True)):
            label = name if len(e) == 1 else f"{name} row {row + 1}"
            yield _Row(label, beam, *one, posed)


def _ranges(factor: gtsam.CustomFactor, values: gtsam.Values) -> FloatArray:
    """Return the ranges (N,) of a range factor [m]; NaN where a beam is perpendicular to its plane.

    A factor does not give its readings away, but its derivatives do: with the range s and the tangent
    basis B of the direction, de/dv = s de/dr B. Weights of rows cancel.
    """
    jacobian, _ = factor.linearize(values).jacobian()
    by_location, by_direction = jacobian[:, :3], jacobian[:, 3:5]
    across = by_location @ values.atUnit3(list(factor.keys())[1]).basis()
    square = (across**2).sum(axis=1)
    seen = square > LEAST_OBLIQUE * (by_location**2).sum(axis=1)
    product = (by_direction * across).sum(axis=1)
    found: FloatArray = np.where(seen, product / np.where(seen, square, 1.0), np.nan)
    return found


def _keys(beam: BeamKeys) -> list[int]:
    keys = (beam.location, beam.direction, beam.range_error)
    return [key for key in keys if key is not None]


def _indices(graph: gtsam.NonlinearFactorGraph) -> list[int]:
    return [i for i in range(graph.size()) if graph.exists(i)]


def _sigmas(model: gtsam.noiseModel.Base, rows: int) -> FloatArray:
    """Return the standard deviations of a noise model, those of the inner one where it is robust."""
    inner = model.noise() if isinstance(model, gtsam.noiseModel.Robust) else model
    sigmas = inner.sigmas() if hasattr(inner, "sigmas") else np.ones(rows)
    return np.asarray(sigmas, dtype=np.float64)
