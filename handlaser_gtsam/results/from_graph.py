"""Reading the result of somebody else's graph back into a calibration.

Whatever else is in the graph (hand poses, odometry, fixes, landmarks) is eliminated; what is left is
the information of beams and planes. Whether the values are the optimum of the graph is looked at, and
whether the graph determines the beams.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

import gtsam
import numpy as np
from scipy.stats import chi2 as chi2_distribution

from ..arrays import FloatArray
from ..checks import require_kind, require_names
from ..errors import CalibrationWarning, InputError
from ..keys import BeamKeys
from ..model.joint import JointCovariance
from ..observability.rank import ObservabilityOptions
from ..solvers.values import require_values
from .calibration import Beam, Calibration, Determined, Plane, StartReport, Status
from .correlations import strong_correlations
from .graph_fit import fit_of_graph, key_name

METHOD = "graph"
OPTIMAL = 0.1
"""Standard deviations from the optimum that values may be."""
UNLIKELY = 1e-6


def read_graph(
    graph: gtsam.NonlinearFactorGraph,
    values: gtsam.Values,
    beams: Mapping[str, BeamKeys],
    planes: Mapping[str, int],
) -> Calibration:
    """Return the calibration that optimised values of a graph hold.

    Parameters
    ----------
    graph : gtsam.NonlinearFactorGraph
        With range factors of these beams to these planes, and anything else.
    values : gtsam.Values
        Its optimum, by any optimizer.
    beams : mapping of names to BeamKeys
        Variables may be shared between beams.
    planes : mapping of names to keys
        Of OrientedPlane3 variables in the world frame.

    Returns
    -------
    Calibration
        Its fit lists the rows of the range factors; chi2 and dof are those of the whole graph.
        `not_converged` where the values are no optimum, `unobservable` where the graph leaves beams or
        planes open.

    Raises
    ------
    InputError
        A key without a value of the right type, a beam without range factors or under two names, names
        that cannot be printed, values without some of the graph's variables or that are no numbers or
        beyond sense, or constrained noise models.
    """
    if not isinstance(values, gtsam.Values):
        raise InputError(f"{type(values).__name__} as values", "gtsam.Values: the result's .values")
    require_names("the name of a beam", beams)
    require_names("the name of a plane", planes)
    for keys in beams.values():
        require_kind("the keys of a beam", keys, BeamKeys)
    require_values(values)
    wanted = _wanted(graph, values, beams, planes)
    linear = graph.linearize(values)
    unknowns = linear.gradientAtZero().vector().size
    fit = fit_of_graph(graph, values, beams, planes, unknowns)
    information = _information(graph, linear, wanted)
    length = fit.typical_range if fit.typical_range > 0.0 else 1.0
    status, message, found = _judged(information, wanted, length)
    if status == "converged" and not (_left_to_go(linear) <= OPTIMAL):
        status = "not_converged"
        message = "the values are not at the optimum of the graph: optimise further"
    joint = None if found is None else _joint(found[0], wanted, values, beams, planes)
    told = joint if status == "converged" else None
    tail = float(chi2_distribution.sf(fit.chi2, fit.dof)) if fit.dof > 0 else 1.0
    doubt = CalibrationWarning(
        "sigmas-too-small",
        f"chi2 {fit.chi2:.0f} for {fit.dof} degrees of freedom is too large for the graph's noise",
    )
    return Calibration(
        status,
        message,
        (doubt,) if tail < UNLIKELY else (),
        MappingProxyType(dict(zip(beams, _beams(values, beams, told), strict=True))),
        MappingProxyType(dict(zip(planes, _planes(values, planes, told), strict=True))),
        fit,
        _determined(found, wanted, message if status == "unobservable" else ""),
        StartReport(METHOD, ()),
        0,
        covariance=told,
        correlations=() if told is None else strong_correlations(told),
    )


@dataclass(frozen=True, slots=True)
class _Kind:
    """A kind of variable: how it is read, its type in words, and its natural units.

    The units are powers of the typical range.
    """

    words: str
    read: Callable[[gtsam.Values, int], object]
    expected: str
    powers: tuple[int, ...]


LOCATION = _Kind("location of beam", gtsam.Values.atPoint3, "Point3", (1, 1, 1))
DIRECTION = _Kind("direction of beam", gtsam.Values.atUnit3, "Unit3", (0, 0))
RANGE_ERROR = _Kind(
    "range error of beam", gtsam.Values.atVector, "vector (k1,) or (k1, k2)", (0, -1)
)
PLANE = _Kind("plane", gtsam.Values.atOrientedPlane3, "OrientedPlane3", (0, 0, 1))


@dataclass(frozen=True, slots=True)
class _Variable:
    """A variable that is read: what it is, its key, and its columns among all that are read."""

    kind: _Kind
    name: str
    key: int
    columns: slice

    @property
    def words(self) -> str:
        """What it is, with its name."""
        return f"{self.kind.words} {self.name}"

    @property
    def powers(self) -> tuple[int, ...]:
        """Natural units of its columns."""
        return self.kind.powers[: self.columns.stop - self.columns.start]


def _wanted(
    graph: gtsam.NonlinearFactorGraph,
    values: gtsam.Values,
    beams: Mapping[str, BeamKeys],
    planes: Mapping[str, int],
) -> list[_Variable]:
    """Return the variables to be read, each once."""
    if not beams:
        raise InputError("no beams", "a name and BeamKeys for each")
    inside = set(graph.keyVector())
    for key in inside:
        if not values.exists(key):
            raise InputError(f"no value of {key_name(key)}", "one for every variable of the graph")
    asked: list[tuple[_Kind, str, int]] = []
    for name, beam in beams.items():
        asked += [(LOCATION, name, beam.location), (DIRECTION, name, beam.direction)]
        if beam.range_error is not None:
            asked.append((RANGE_ERROR, name, beam.range_error))
    asked += [(PLANE, name, key) for name, key in planes.items()]
    found: dict[int, _Variable] = {}
    first = 0
    for kind, name, key in asked:
        if key not in inside:
            words = f"{kind.words} {name} under {key_name(key)}"
            raise InputError(words, "a variable of the graph")
        dim = _dimension(values, kind, name, key)
        if key not in found:
            found[key] = _Variable(kind, name, key, slice(first, first + dim))
            first += dim
    return list(found.values())


def _dimension(values: gtsam.Values, kind: _Kind, name: str, key: int) -> int:
    """Return the dimension of a variable; raises InputError where it is of another type."""
    try:
        value = kind.read(values, key)
    except RuntimeError as error:
        found = f"another type under {key_name(key)}, {kind.words} {name}"
        raise InputError(found, f"a {kind.expected}") from error
    dim = np.asarray(value).size if kind is RANGE_ERROR else len(kind.powers)
    if not 1 <= dim <= len(kind.powers):
        raise InputError(f"{dim} numbers as {kind.words} {name}", f"a {kind.expected}")
    return dim


def _information(
    graph: gtsam.NonlinearFactorGraph, linear: gtsam.GaussianFactorGraph, wanted: list[_Variable]
) -> tuple[FloatArray, FloatArray] | None:
    """Return the information of what is read and the right-hand side; None if others are open."""
    keys = [one.key for one in wanted]
    order = gtsam.Ordering.ColamdConstrainedLastNonlinearFactorGraph(graph, keys)
    others, last = gtsam.Ordering(), gtsam.Ordering()
    for i in range(order.size() - len(keys)):
        others.push_back(order.at(i))
    for key in keys:
        last.push_back(key)
    rest = linear
    try:
        if others.size():
            _, rest = linear.eliminatePartialSequential(others)
        matrix, vector = rest.hessian(last)
    except RuntimeError:  # GTSAM's indeterminate linear system, which names a bystander
        return None
    except ValueError as error:
        raise InputError(
            f"a factor that cannot be eliminated ({error})",
            "noise models with sigmas above zero, not constrained ones",
        ) from error
    return np.asarray(matrix), np.asarray(vector).ravel()


def _left_to_go(linear: gtsam.GaussianFactorGraph) -> float:
    """Return how far the optimum of all variables is: the length of a step, in standard deviations."""
    try:
        decrement = -linear.gradientAtZero().dot(linear.optimize())
    except RuntimeError:
        return float("inf")
    return float(np.sqrt(max(decrement, 0.0))) if np.isfinite(decrement) else float("inf")


def _judged(
    information: tuple[FloatArray, FloatArray] | None, wanted: list[_Variable], length: float
) -> tuple[Status, str, tuple[FloatArray, FloatArray] | None]:
    """Return status and message, and (covariance, eigenvalues) where there is a covariance.

    Eigenvalues are those in natural units, with `length` [m] for the typical range, as everywhere.
    """
    if information is None:
        words = (
            "the graph leaves variables open: anchor at least one pose, tie every pose to others by a "
            "prior, odometry or a fix, and check that all lengths are metres"
        )
        return "unobservable", words, None
    matrix, vector = information
    unit = length ** np.array([power for one in wanted for power in one.powers], dtype=float)
    values, axes = np.linalg.eigh(0.5 * (matrix + matrix.T) * np.outer(unit, unit))
    weak = values < ObservabilityOptions().most_sigma ** -2
    if weak.any():
        share = (axes[:, weak] ** 2).sum(axis=1)
        open_ = [one.words for one in wanted if share[one.columns].sum() > 0.1]
        words = (
            f"the graph does not determine {', '.join(open_)}: add stations in other orientations, "
            f"and check that all lengths are metres"
        )
        return "unobservable", words, None
    covariance = (axes / values) @ axes.T * np.outer(unit, unit)
    away = float((np.abs(covariance @ vector) / np.sqrt(np.diagonal(covariance))).max())
    found = covariance, values
    if not away <= OPTIMAL:
        words = f"the values are {away:.2g} standard deviations from the optimum: optimise further"
        return "not_converged", words, found
    return "converged", "the values are the optimum of the graph", found


def _joint(
    S: FloatArray,
    wanted: list[_Variable],
    values: gtsam.Values,
    beams: Mapping[str, BeamKeys],
    planes: Mapping[str, int],
) -> JointCovariance:
    """Return the covariance in the order of the names; shared variables stand once for every beam."""
    columns = {one.key: np.arange(one.columns.start, one.columns.stop) for one in wanted}
    keys = [(b.location, b.direction, b.range_error) for b in beams.values()]
    own = [np.concatenate([columns[k] for k in three if k is not None]) for three in keys]
    at = np.concatenate(own)
    of_planes = [columns[key] for key in planes.values()]
    p = np.concatenate([np.empty(0, dtype=np.intp), *of_planes])
    unique = np.unique(at)
    expand = (at[:, None] == unique).astype(float)
    inside = np.linalg.inv(S[np.ix_(unique, unique)])
    W = -S[np.ix_(p, unique)] @ inside
    rest = S[np.ix_(p, p)] + W @ S[np.ix_(unique, p)]
    count = len(of_planes)
    coupling = rest.reshape(count, 3, count, 3).copy()
    each = np.arange(count)
    alone = coupling[each, :, each, :].copy()
    coupling[each, :, each, :] = 0.0
    return JointCovariance(
        tuple(beams),
        tuple(planes),
        tuple(len(one) - 5 for one in own),
        S[np.ix_(at, at)],
        (W @ np.linalg.pinv(expand)).reshape(count, 3, -1),
        alone,
        np.array([values.atUnit3(beam.direction).basis() for beam in beams.values()]),
        np.array([_plane(values, k).normal().basis() for k in planes.values()]).reshape(-1, 3, 2),
        np.zeros((count, 3)),
        coupling,
    )


def _beams(
    values: gtsam.Values, beams: Mapping[str, BeamKeys], joint: JointCovariance | None
) -> list[Beam]:
    covariances = [None] * len(beams) if joint is None else joint.all_beams()
    found = []
    for (name, keys), S in zip(beams.items(), covariances, strict=True):
        k = np.zeros(2)
        terms = 0
        if keys.range_error is not None:
            own = values.atVector(keys.range_error)
            terms, k[: own.size] = own.size, own
        sigma = None if S is None else np.sqrt(np.maximum(np.diagonal(S), 0.0))
        r, v = values.atPoint3(keys.location), values.atUnit3(keys.direction).point3()
        found.append(Beam(name, r, v, k, terms, S, sigma))
    return found


def _planes(
    values: gtsam.Values, planes: Mapping[str, int], joint: JointCovariance | None
) -> list[Plane]:
    covariances = [None] * len(planes) if joint is None else joint.all_planes()
    found = []
    for (name, key), S in zip(planes.items(), covariances, strict=True):
        plane = _plane(values, key)
        sigma = None if S is None else np.sqrt(np.maximum(np.diagonal(S), 0.0))
        found.append(Plane(name, plane.normal().point3(), plane.distance(), S, sigma))
    return found


def _plane(values: gtsam.Values, key: int) -> gtsam.OrientedPlane3:
    return values.atOrientedPlane3(key)


def _determined(
    found: tuple[FloatArray, FloatArray] | None, wanted: list[_Variable], open_: str
) -> Determined:
    unknowns = wanted[-1].columns.stop
    if found is None:
        return Determined(0, unknowns, None, (open_,))
    values = found[1]
    return Determined(unknowns, unknowns, float(np.sqrt(values[-1] / values[0])))
