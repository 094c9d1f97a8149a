"""How the range factors of somebody else's graph fit."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import gtsam
import numpy as np

from .arrays import FloatArray
from .calibration import Fit
from .errors import InputError
from .keys import BeamKeys


@dataclass(frozen=True, slots=True)
class _Row:
    """A row of a range factor: a label, the index of its beam, its residual and sigma [m], its pose."""

    label: str
    beam: int
    residual: float
    sigma: float
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
    e, sigma = (np.array([getattr(row, name) for row in rows]) for name in ("residual", "sigma"))
    names, size = tuple(beams), sum(graph.at(i).dim() for i in _indices(graph))
    chi2, dof = 2.0 * graph.error(values), size - unknowns
    if not np.isfinite(chi2):
        raise InputError(f"an error of the graph of {chi2}", "values that are finite numbers")
    worst, far = int(np.abs(e).argmax()), int(np.abs(e / sigma).argmax())
    table = np.full((len(rows), len(beams)), np.nan)
    table[np.arange(len(rows)), [row.beam for row in rows]] = e
    return Fit(
        readings=len(rows),
        rms=float(np.sqrt(np.mean(e**2))),
        largest=float(np.abs(e).max()),
        largest_at=(rows[worst].label, names[rows[worst].beam]),
        chi2=chi2,
        dof=dof,
        sigma0=float(np.sqrt(chi2 / dof)) if dof > 0 else 0.0,
        range_sigma=float(np.median(sigma)),
        range_sigma_given=True,
        poses="estimated" if any(row.posed for row in rows) else "exact",
        median_reading=float("nan"),
        typical_range=float("nan"),
        loss="gaussian",
        farthest=float(np.abs(e / sigma).max()),
        farthest_at=(rows[far].label, names[rows[far].beam]),
        residuals=table,
        rejected=(),
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
        sigma = _sigmas(factor.noiseModel(), len(e))
        for row, (one, s) in enumerate(zip(e.tolist(), sigma.tolist(), strict=True)):
            label = name if len(e) == 1 else f"{name} row {row + 1}"
            yield _Row(label, beam, one, s, posed)


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


def key_name(key: int) -> str:
    """Return a key as people write it: x3, or the number."""
    return str(gtsam.DefaultKeyFormatter(key))
