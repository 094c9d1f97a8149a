r"""Unknowns of a survey that are held at zero, tried as free ones with noise learned beside them.

A target that was moved amid a recording, and points that are all too large alike, misfit most stops a
little. Where errors of the hand are learned, they become large enough to explain that, and a score test
in units of them finds nothing. So what is promising is tried: sizes of the noise are learned with the
additional unknowns x (q of them), whose least squares solution in standard deviations that are new,

    x,  C = cov(x),  F = x' inv(C) x / q,

is tested against an F distribution of q over S - q - 1 degrees of freedom at S stops, as if each said
one number of the noise; with noise that is stated by chi2.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from ..arrays import FloatArray, IntArray
from ..data.survey import RAY_ERRORS
from ..data.value import Value
from ..model.distributions import FAMILY_LEVEL, UNLIKELY_EXCESS, chi2_sf, f_sf
from ..model.effects.displaced import LEAST_STATIONS, MOST_SPLITS
from ..model.families import BEAM, PLANE, POSE
from ..model.sensors.mounted import SENSOR
from ..model.targets.point import POINT
from ..model.targets.sphere import SPHERE
from ..quantities import NEGLIGIBLE, TINY
from .dense import DenseRows
from .survey import SurveyEstimate, SurveyState, learned_sizes
from .survey_rows import Entity

Columns = Callable[[SurveyState], FloatArray]
"""Makes derivatives (R, q) of the rows of a state by further unknowns."""
PLACES_OF = dict.fromkeys((PLANE.name, SPHERE.name, BEAM.name), (0, 1, 2)) | {
    SENSOR.name: (3, 4, 5)
}
"""Tangent coordinates of where targets, sensors and beams are: of planes two tilts and the offset."""
BOTH_AXES, ALIKE = "x-and-z", ("k1", "scale")
"""Code of an error of both axes of a profiler by the same part, and the range errors that it is."""


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Tried(Value):
    """Further unknowns of a survey, as it has them if they are free.

    Attributes
    ----------
    size : (q,)
    covariance : (q, q)
    p_value : float
        Probability of sizes that are as large by chance.
    moved : (N,)
        By how much the other unknowns are elsewhere then.
    """

    size: FloatArray
    covariance: FloatArray
    p_value: float
    moved: FloatArray

    @property
    def chi2(self) -> float:
        """The square of the sizes in their covariance."""
        return float(self.size @ np.linalg.solve(self.covariance, self.size))


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Displacement(Value):
    """A target, or a sensor or beam in the hand, that is elsewhere from a station on.

    Attributes
    ----------
    entity : (family, number)
    station : int
        The first one after the displacement.
    tried : Tried
        Of the coordinates of `PLACES_OF`; its p-value counts all displacements that were looked for.
    """

    entity: Entity
    station: int
    tried: Tried


def try_free(state: SurveyState, columns: Columns) -> Tried:
    """Return further unknowns of a state at its minimum, as free ones."""
    state = replace(state, sizes=learned_sizes(state, columns))
    rows, owner = state.dense()
    own = rows.derivatives.shape[1]
    wider = np.column_stack((rows.derivatives, columns(state)))
    J, e = replace(rows, derivatives=wider).whitened()
    scale = np.maximum(np.sqrt((J**2).sum(axis=0)), TINY)
    inverse = np.asarray(np.linalg.pinv(J / scale, rcond=NEGLIGIBLE) / scale[:, None])
    x, C = -inverse @ e, inverse @ inverse.T
    size, C = x[own:], C[own:, own:]
    chi2, q = float(size @ np.linalg.solve(C, size)), len(size)
    left = len(np.unique(state.stops(owner[owner >= 0]))) - q - 1
    p = f_sf(chi2 / q, q, max(left, 1)) if state.learning else chi2_sf(chi2, q)
    return Tried(size, C, float(p), x[:own])


def too_small_alike(found: SurveyEstimate, member: int) -> Tried:
    """Return by which part x and z of a profiler are too small alike: k1 and its scale are one."""
    state = found.learning()
    problem, _ = state.problem()
    whole = replace(problem, unknown={**problem.unknown, SENSOR.name: True}).places()
    place = whole.place[SENSOR.name][member] + [POSE.dim + RAY_ERRORS.index(one) for one in ALIKE]

    def columns(at: SurveyState) -> FloatArray:
        rows, _ = at.dense(pose_errors=False, range_errors=True)
        return np.asarray(rows.derivatives[:, place].sum(axis=1, keepdims=True))

    return try_free(state, columns)


def displacement(found: SurveyEstimate) -> Displacement | None:
    """Return the target, sensor or beam that most surely was moved amid the survey; None for none.

    Where a target may be what was moved, it is: a hand of which all targets seem to move takes more.
    """
    state, looked_for = found.learning(), 0
    rows, owner = state.dense()
    gain, stops = _Gain(rows), state.stops(owner)
    promising: list[tuple[Entity, int]] = []
    for entity, splits in _splits(state):
        looked_for += len(splits)
        columns = rows.derivatives[:, _place(state, entity)]
        chi2 = [gain(columns * (stops >= station)[:, None]) for station in splits]
        best = int(np.argmax(chi2))
        if chi2_sf(chi2[best], columns.shape[1]) < FAMILY_LEVEL:
            promising.append((entity, splits[best]))
    moves = []
    for entity, station in promising:
        one = try_free(state, partial(_since, entity, station))
        p = min(one.p_value * looked_for, 1.0)
        if p < FAMILY_LEVEL:
            moves.append(Displacement(entity, station, replace(one, p_value=p)))
    if not moves:
        return None
    surest = max(one.tried.chi2 for one in moves)
    alike = [one for one in moves if one.tried.chi2 > surest - UNLIKELY_EXCESS]
    return next((one for one in alike if one.entity[0] in (PLANE.name, SPHERE.name)), alike[0])


def _splits(state: SurveyState) -> Iterator[tuple[Entity, list[int]]]:
    """Yield targets, sensors and beams with the stations from which on each may be elsewhere.

    Beams that are aimed at points do not count: each station is aimed by itself.
    """
    seen: dict[Entity, set[int]] = {}
    for item, used in zip(state.rows.items, state.used, strict=True):
        if used and item.target[0] != POINT.name:
            for entity in (item.target, item.mount):
                seen.setdefault(entity, set()).add(item.stop)
    for entity, stops in seen.items():
        splits = sorted(stops)[LEAST_STATIONS : len(stops) - LEAST_STATIONS + 1]
        if entity[0] in PLACES_OF and splits:
            evenly = np.linspace(0, len(splits) - 1, min(len(splits), MOST_SPLITS))
            yield entity, [splits[i] for i in evenly.round().astype(int)]


def _place(state: SurveyState, entity: Entity) -> IntArray:
    """Return which unknowns (3,) say where an entity is."""
    family, member = entity
    return np.asarray(state.rows.places().place[family][member] + np.array(PLACES_OF[family]))


def _since(entity: Entity, station: int, state: SurveyState) -> FloatArray:
    """Return the derivatives (R, 3) by the place of an entity from a station on."""
    rows, owner = state.dense(pose_errors=False)
    return np.asarray(
        rows.derivatives[:, _place(state, entity)] * (state.stops(owner) >= station)[:, None]
    )


class _Gain:
    """By how much chi2 would fall with some further unknowns, noise as it is."""

    def __init__(self, rows: DenseRows) -> None:
        J, self._e = rows.whitened()
        scale = np.maximum(np.sqrt((J**2).sum(axis=0)), TINY)
        U, size, _ = np.linalg.svd(J / scale, full_matrices=False)
        self._rows, self._known = rows, U[:, size > NEGLIGIBLE * size[0]]

    def __call__(self, columns: FloatArray) -> float:
        """Return it for derivatives (R, q) by the further unknowns."""
        A, _ = replace(self._rows, derivatives=columns).whitened()
        rest = A - self._known @ (self._known.T @ A)
        return float(np.linalg.lstsq(rest, self._e, rcond=NEGLIGIBLE)[0] @ rest.T @ self._e)
