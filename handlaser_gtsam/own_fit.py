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
        A beam without a range factor to these planes.
    """
    rows = list(_rows(graph, values, beams, set(planes.values())))
    for i, name in enumerate(beams):
        if all(row.beam != i for row in rows):
            raise InputError(f"no range factor of beam {name} to these planes", "at least one")
    e, sigma = (np.array([getattr(row, name) for row in rows]) for name in ("residual", "sigma"))
    names, size = tuple(beams), sum(graph.at(i).dim() for i in _indices(graph))
    chi2, dof = 2.0 * graph.error(values), size - unknowns
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
    owner = {(keys.location, keys.direction): i for i, keys in enumerate(beams.values())}
    for i in _indices(graph):
        factor = graph.at(i)
        if not isinstance(factor, gtsam.NoiseModelFactor):
            continue
        keys = list(factor.keys())
        beam = owner.get((keys[0], keys[1])) if len(keys) > 2 else None
        if beam is None or not planes & set(keys):
            continue
        posed = keys[-1] not in planes
        name = key_name(keys[-1]) if posed else f"factor {i}"
        e = np.atleast_1d(factor.unwhitenedError(values))
        sigma = _sigmas(factor.noiseModel(), len(e))
        for row, (one, s) in enumerate(zip(e.tolist(), sigma.tolist(), strict=True)):
            label = name if len(e) == 1 else f"{name} row {row + 1}"
            yield _Row(label, beam, one, s, posed)


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
