"""Reading the result of somebody else's graph back into a calibration.

Whatever else is in the graph (hand poses, odometry, fixes, landmarks) is eliminated; what is left is
the information of beams and planes. Whether the values are the optimum of the graph is looked at, and
whether the graph determines the beams.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import gtsam
import numpy as np
from scipy.stats import chi2 as chi2_distribution

from ..arrays import FloatArray
from ..checks import require_names
from ..errors import CalibrationWarning, InputError
from ..keys import BeamKeys
from ..model.joint import JointCovariance
from ..observability.rank import ObservabilityOptions
from ..solvers.graph import parameters_of
from ..solvers.values import require_values
from .calibration import Calibration, Determined, Fit, StartReport, Status
from .graph_fit import fit_of_graph
from .graph_variables import Variable, variables_of
from .problem import Estimate

METHOD = "graph"
OPTIMAL = 0.1
"""Standard deviations from the optimum that values may be."""
UNLIKELY = 1e-6
"""A chi2 of the graph that is less probable contradicts its noise models."""
ANCHOR = (
    "anchor at least one pose, tie every pose to others by a prior, odometry or a fix, and check that "
    "all lengths are metres"
)
MOVE_MORE = "add stations in other orientations, and check that all lengths are metres"


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
    return _estimate(graph, values, beams, planes)


def _estimate(
    graph: gtsam.NonlinearFactorGraph,
    values: gtsam.Values,
    beams: Mapping[str, BeamKeys],
    planes: Mapping[str, int],
) -> Calibration:
    """Read beams and planes, eliminate everything else, and judge what is left."""
    wanted = variables_of(graph, values, beams, planes)
    linear = graph.linearize(values)
    unknowns = linear.gradientAtZero().vector().size
    fit = fit_of_graph(graph, values, beams, planes, unknowns)
    found = _judged(_information(graph, linear, wanted), wanted, fit)
    status, message, joint = found.status, found.message, None
    if status == "converged" and not (_left_to_go(linear) <= OPTIMAL):
        status = "not_converged"
        message = "the values are not at the optimum of the graph: optimise further"
    if status == "converged":
        joint = _joint(found.covariance, wanted, values, beams, planes)
    estimate = Estimate(
        tuple(beams),
        tuple(planes),
        parameters_of(values, list(beams.values()), list(planes.values())),
        tuple(_terms(values, beam) for beam in beams.values()),
        joint,
        None,
        status,
        message,
        fit,
        found.determined,
        StartReport(METHOD, ()),
    )
    return estimate.calibration(_warnings(fit))


def _terms(values: gtsam.Values, beam: BeamKeys) -> int:
    return 0 if beam.range_error is None else int(values.atVector(beam.range_error).size)


def _warnings(fit: Fit) -> tuple[CalibrationWarning, ...]:
    if fit.dof <= 0 or float(chi2_distribution.sf(fit.chi2, fit.dof)) >= UNLIKELY:
        return ()
    words = (
        f"chi2 {fit.chi2:.0f} for {fit.dof} degrees of freedom is too large for the graph's noise"
    )
    return (CalibrationWarning("sigmas-too-small", words),)


def _information(
    graph: gtsam.NonlinearFactorGraph, linear: gtsam.GaussianFactorGraph, wanted: list[Variable]
) -> tuple[FloatArray, FloatArray] | None:
    """Return the information of what is read, and its right-hand side; None if it has none."""
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


@dataclass(frozen=True, slots=True, eq=False)
class _Judgement:
    """What the information of beams and planes says of the values; no covariance of what is open."""

    status: Status
    message: str
    determined: Determined
    covariance: FloatArray


def _judged(
    information: tuple[FloatArray, FloatArray] | None, wanted: list[Variable], fit: Fit
) -> _Judgement:
    """Judge the values by the information of what is read, in natural units as everywhere."""
    unknowns = wanted[-1].columns.stop
    if information is None:
        words = "the graph leaves variables undetermined"
        return _undetermined(0, unknowns, words, (words,), ANCHOR)
    matrix, vector = information
    length = fit.typical_range if fit.typical_range > 0.0 else 1.0
    unit = length ** np.array([power for one in wanted for power in one.powers], dtype=float)
    values, axes = np.linalg.eigh(0.5 * (matrix + matrix.T) * np.outer(unit, unit))
    weak = values < ObservabilityOptions().most_sigma ** -2
    if weak.any():
        share = (axes[:, weak] ** 2).sum(axis=1)
        names = tuple(one.words for one in wanted if share[one.columns].sum() > 0.1)
        words = f"the graph does not determine {', '.join(names)}"
        return _undetermined(int((~weak).sum()), unknowns, words, names, MOVE_MORE)
    covariance = (axes / values) @ axes.T * np.outer(unit, unit)
    away = float((np.abs(covariance @ vector) / np.sqrt(np.diagonal(covariance))).max())
    determined = Determined(unknowns, unknowns, float(np.sqrt(values[-1] / values[0])))
    if not away <= OPTIMAL:
        words = f"the values are {away:.2g} standard deviations from the optimum: optimise further"
        return _Judgement("not_converged", words, determined, covariance)
    words = "the values are the optimum of the graph"
    return _Judgement("converged", words, determined, covariance)


def _undetermined(
    rank: int, unknowns: int, words: str, names: tuple[str, ...], remedy: str
) -> _Judgement:
    determined = Determined(rank, unknowns, None, names, (remedy,))
    return _Judgement("unobservable", f"{words}: {remedy}", determined, np.empty((0, 0)))


def _joint(
    S: FloatArray,
    wanted: list[Variable],
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
        np.array(
            [values.atOrientedPlane3(key).normal().basis() for key in planes.values()]
        ).reshape(-1, 3, 2),
        np.zeros((count, 3)),
        coupling,
    )
