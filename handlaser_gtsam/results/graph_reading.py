"""Reading the result of somebody else's graph back into a calibration.

Whatever else is in the graph (hand poses, odometry, fixes, landmarks) is eliminated; what is left is
the information of beams and planes. Whether the values are the optimum of the graph is looked at, and
whether the graph determines the beams.
"""

from collections.abc import Mapping

import gtsam
import numpy as np

from ..arrays import FloatArray
from ..checks import require_names
from ..errors import CalibrationWarning, InputError
from ..factors.keys import BeamKeys
from ..model.joint import JointCovariance
from ..observability.open_axes import open_axes
from ..observability.rank import ObservabilityOptions
from ..solvers.graph import parameters_of
from ..solvers.values import require_values
from .calibration import Calibration
from .calibration_fields import Status
from .correlations import strong_correlations
from .graph_variables import OwnGraph, Variable, fit_of_graph
from .problem import named_estimates
from .reports import Determined, Fit, StartReport
from .significance import SINGLE_LEVEL

OPTIMAL = 0.1
"""Standard deviations from the optimum that values may be."""
NAMED = 0.1
"""Variables are named that have such a part of what the one has that is left open most."""
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
        far = (share > NAMED * share.max()).tolist()
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
