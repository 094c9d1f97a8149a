"""Reading the result of somebody else's graph back into a calibration.

Whatever else is in the graph (hand poses, odometry, fixes, landmarks) is eliminated; what is left is
the information of beams and planes. Whether the values are the optimum of the graph is looked at, and
whether the graph determines the beams.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace

import gtsam
import numpy as np

from ..arrays import FloatArray
from ..checks import require_names
from ..errors import CalibrationWarning, InputError
from ..estimation.estimate import NAMED_SHARE
from ..factors.keys import BeamKeys
from ..model.distributions import SINGLE_LEVEL
from ..model.families import DIRECTION, LOCATION
from ..model.joint import JointCovariance, strong_correlations
from ..observability.rank import ObservabilityOptions, open_axes
from ..quantities import NEGLIGIBLE
from ..solvers.graph import parameters_of
from ..solvers.levenberg import require_values
from .calibration import Calibration
from .fit import fit_of_rows
from .problem import named_estimates
from .reports import Determined, Fit, StartReport, Status

OPTIMAL = 0.1
"""Standard deviations from the optimum that values may be."""
ANCHOR = (
    "anchor at least one pose, tie every pose to others by a prior, odometry or a fix, and check that "
    "all lengths are metres"
)
MOVE_MORE = "add stations in other orientations, and check that all lengths are metres"


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
    by_location, by_direction = jacobian[:, LOCATION], jacobian[:, DIRECTION]
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
        Its fit lists the rows of the range factors; chi2 and dof count the whole graph.
        `not_converged` where the values are no optimum, `unobservable` where the graph leaves beams or
        planes undetermined.

    Raises
    ------
    InputError
        A key without a value of the right type, a beam without range factors or under two names, names
        that cannot be printed, values without some of the graph's variables or that are no numbers or
        beyond sense, or constrained noise models.
    """
    require_values(values)
    require_names("the name of a beam", beams)
    require_names("the name of a plane", planes)
    own = OwnGraph(graph, values, beams, planes)
    wanted = own.variables()
    linear = graph.linearize(values)
    fit = fit_of_graph(own, linear.gradientAtZero().vector().size)
    status, message, determined, covariance = _judged(own, linear, wanted, fit)
    joint = None if covariance is None else _joint(covariance, wanted, own)
    at = parameters_of(values, list(beams.values()), list(planes.values()))
    warnings: tuple[CalibrationWarning, ...] = ()
    if fit.p_value < SINGLE_LEVEL:
        words = f"chi2 {fit.chi2:.0f} for {fit.dof} degrees of freedom is too large for its noise"
        warnings = (CalibrationWarning("sigmas-too-small", words),)
    return Calibration(
        status,
        message,
        warnings,
        *named_estimates(tuple(beams), tuple(planes), at, own.terms(), joint),
        fit,
        determined,
        StartReport("graph", ()),
        iterations=0,
        covariance=joint,
        correlations=() if joint is None else strong_correlations(joint),
    )


def _information(
    own: OwnGraph, linear: gtsam.GaussianFactorGraph, wanted: list[Variable]
) -> tuple[FloatArray, FloatArray] | None:
    """Return the information of what is read, and its right-hand side; None if it has none."""
    keys = [one.key for one in wanted]
    order = gtsam.Ordering.ColamdConstrainedLastNonlinearFactorGraph(own.graph, keys)
    others = gtsam.Ordering([order.at(i) for i in range(order.size() - len(keys))])
    rest = linear
    try:
        if others.size():
            _, rest = linear.eliminatePartialSequential(others)
        matrix, vector = rest.hessian(gtsam.Ordering(keys))
    except RuntimeError:  # GTSAM's indeterminate linear system, which names a bystander
        return None
    except ValueError as error:
        raise InputError(
            f"a factor that cannot be eliminated ({error})",
            "noise models with sigmas above zero, not constrained ones",
        ) from error
    return np.asarray(matrix), np.asarray(vector).ravel()


def _judged(
    own: OwnGraph, linear: gtsam.GaussianFactorGraph, wanted: list[Variable], fit: Fit
) -> tuple[Status, str, Determined, FloatArray | None]:
    """Judge the values by the information of what is read, in natural units as everywhere.

    The covariance is None unless the values are the optimum and everything is determined.
    """
    powers = np.array([power for one in wanted for power in one.powers], dtype=float)
    unknowns, information = len(powers), _information(own, linear, wanted)
    if information is None:
        words = "the graph leaves variables undetermined"
        found = Determined(0, unknowns, None, (words,), (ANCHOR,))
        return "unobservable", f"{words}: {ANCHOR}", found, None
    matrix, vector = information
    length = fit.typical_range if fit.typical_range > 0.0 else 1.0
    unit = length**powers
    values, axes = np.linalg.eigh(0.5 * (matrix + matrix.T) * np.outer(unit, unit))
    block = np.repeat(np.arange(len(wanted)), [len(one.powers) for one in wanted])
    weak = open_axes(values, axes, block, ObservabilityOptions().most_sigma ** -2)
    if weak.any():
        share = np.bincount(block, (axes[:, weak] ** 2).sum(axis=1))
        far = (share > NAMED_SHARE * share.max()).tolist()
        names = tuple(one.words for one, named in zip(wanted, far, strict=True) if named)
        words = f"the graph does not determine {', '.join(names)}: {MOVE_MORE}"
        found = Determined(int((~weak).sum()), unknowns, None, names, (MOVE_MORE,))
        return "unobservable", words, found, None
    S = (axes / values) @ axes.T * np.outer(unit, unit)
    away = float((np.abs(S @ vector) / np.sqrt(np.diagonal(S))).max())
    found = Determined(unknowns, unknowns, float(np.sqrt(values[-1] / values[0])))
    if not away <= OPTIMAL:
        words = f"the values are {away:.2g} standard deviations from the optimum: optimise further"
        return "not_converged", words, found, None
    try:  # the squared length of the step to the optimum of all variables, in standard deviations
        decrement = -linear.gradientAtZero().dot(linear.optimize())
    except RuntimeError:
        decrement = np.inf
    if not max(decrement, 0.0) <= OPTIMAL**2:
        words = "the values are not at the optimum of the graph: optimise further"
        return "not_converged", words, found, None
    return "converged", "the values are the optimum of the graph", found, S


def _joint(S: FloatArray, wanted: list[Variable], own: OwnGraph) -> JointCovariance:
    """Return the covariance in the order of the names; shared variables stand once for every beam."""
    counts = [len(one.powers) for one in wanted]
    parts = np.split(np.arange(sum(counts)), np.cumsum(counts)[:-1])
    columns = {one.key: part for one, part in zip(wanted, parts, strict=True)}
    of_beams = [np.concatenate([columns[k] for k in b.variables]) for b in own.beams.values()]
    at = np.concatenate(of_beams)
    p = np.array([columns[key] for key in own.planes.values()], dtype=np.intp).ravel()
    unique = np.unique(at)
    expand = (at[:, None] == unique).astype(float)
    inside = np.linalg.inv(S[np.ix_(unique, unique)])
    W = -S[np.ix_(p, unique)] @ inside
    rest = S[np.ix_(p, p)] + W @ S[np.ix_(unique, p)]
    count = len(own.planes)
    coupling = rest.reshape(count, 3, count, 3).copy()
    each = np.arange(count)
    alone = coupling[each, :, each, :].copy()
    coupling[each, :, each, :] = 0.0
    normals = [own.values.atOrientedPlane3(key).normal() for key in own.planes.values()]
    return JointCovariance(
        tuple(own.beams),
        tuple(own.planes),
        own.terms(),
        S[np.ix_(at, at)],
        (W @ np.linalg.pinv(expand)).reshape(count, 3, -1),
        alone,
        np.array([own.values.atUnit3(beam.direction).basis() for beam in own.beams.values()]),
        np.array([normal.basis() for normal in normals]).reshape(-1, 3, 2),
        np.zeros((count, 3)),
        coupling,
    )
