"""Reading the result of somebody else's graph back into a calibration.

Whatever else is in the graph (hand poses, odometry, fixes, landmarks) is eliminated; what is left is
the information of beams and planes. Whether the values are the optimum of the graph is looked at, and
whether the graph determines the beams.
"""

from collections.abc import Container, Iterator, Mapping
from dataclasses import replace
from typing import NamedTuple

import gtsam
import numpy as np

from ..arrays import BoolArray, FloatArray, IntArray
from ..checks import require_names
from ..data.parameters import Parameters
from ..errors import CalibrationWarning, InputError
from ..estimation.estimate import NAMED_SHARE
from ..factors.amid_readings import amid_readings
from ..factors.keys import BeamKeys, integer_key, require_beam
from ..model.distributions import SINGLE_LEVEL
from ..model.equation import plausible_factors
from ..model.families import BEAM, DIRECTION, LOCATION, MOUNT_DIM, PLANE, RANGE_ERROR
from ..model.joint import JointCovariance, strong_correlations
from ..observability.rank import ObservabilityOptions, open_axes
from ..quantities import MAJORITY, NEGLIGIBLE, TEN_TIMES
from ..solvers.graph import parameters_of
from ..solvers.graph_levenberg import OPTIMAL, require_values, usable_values
from .calibration import Calibration
from .calibration_data import OF_GRAPH, Determined, Fit, StartReport, Status
from .messages import Values, warned
from .problem import fit_of_rows, named_estimates
from .warnings import IMPLAUSIBLE, NO_MOUNT, far_reading

ANCHOR = (
    "anchor at least one pose, tie every pose to others by a prior, odometry or a fix, and check that "
    "all lengths are metres"
)
FURTHER = "optimise further, with hl.optimize, or start closer"
MOVE_MORE = "add stations in other orientations, and check that all lengths are metres"
TERMS = "a vector (k1,) or (k1, k2)"
KINDS = (
    ("location of beam {}", gtsam.Values.atPoint3, "a Point3", BEAM.powers[LOCATION]),
    ("direction of beam {}", gtsam.Values.atUnit3, "a Unit3", BEAM.powers[DIRECTION]),
    ("range error of beam {}", gtsam.Values.atVector, TERMS, BEAM.powers[RANGE_ERROR]),
    ("plane {}", gtsam.Values.atOrientedPlane3, "an OrientedPlane3", PLANE.powers),
)
"""Kinds of variables: what each is of, how it is read, its type, and the natural units of its columns
as powers of the typical range."""
Variables = dict[int, tuple[str, tuple[int, ...]]]
"""What is read, by its key: what it is, and the powers of its columns."""


class OwnGraph(NamedTuple):
    """A graph at some values, and the names of the beams and planes among its variables."""

    graph: gtsam.NonlinearFactorGraph
    values: gtsam.Values
    beams: Mapping[str, BeamKeys]
    planes: Mapping[str, int]


def _variables(own: OwnGraph) -> Variables:
    """Return the variables to be read, each once.

    Raises
    ------
    InputError
        No beams, or a key without a value of the right type, or that is not in the graph.
    """
    if not own.beams:
        raise InputError("no beams", "a name and BeamKeys for each")
    for name, beam in own.beams.items():
        require_beam(f"beam {name}", beam)
    for name, key in own.planes.items():
        integer_key(key, f"plane {name}")
    inside = set(own.graph.keyVector())
    for key in inside:
        if not own.values.exists(key):
            expected = "one for every variable of the graph"
            raise InputError(f"no value of {key_name(key)}", expected)
    asked = [
        (key, name, kind)
        for name, beam in own.beams.items()
        for kind, key in zip(KINDS, beam.variables, strict=False)
    ]
    asked += [(key, name, KINDS[-1]) for name, key in own.planes.items()]
    found: Variables = {}
    for key, name, (kind, read, expected, powers) in asked:
        words = kind.format(name)
        if key not in inside:
            raise InputError(f"{words} under {key_name(key)}", "a variable of the graph")
        try:
            value = read(own.values, key)
        except RuntimeError as error:
            other = f"another type under {key_name(key)}, {words}"
            raise InputError(other, expected) from error
        dim = np.asarray(value).size if read is gtsam.Values.atVector else len(powers)
        if not 1 <= dim <= len(powers):
            raise InputError(f"{dim} numbers as {words}", expected)
        found.setdefault(key, (words, powers[:dim]))
    return found


def key_name(key: int) -> str:
    """Return a key as people write it: x3, or the number."""
    return str(gtsam.DefaultKeyFormatter(key))


class RangeRows(NamedTuple):
    """The rows of one range factor.

    Attributes
    ----------
    beam : (N,)
        Index of each row's beam.
    plane : int
        Key.
    pose : int or None
        Key; None where the hand poses are known.
    ranges : (N,)
        Predicted [m]; NaN where a beam is perpendicular to its plane.
    along : float
        Above zero where beams look along the normal of the plane, below where against it.
    """

    beam: IntArray
    plane: int
    pose: int | None
    ranges: FloatArray
    along: float


def _range_rows(
    own: OwnGraph,
    owner: Mapping[tuple[int, ...], int],
    planes: Container[int],
    factor: gtsam.CustomFactor,
) -> RangeRows | None:
    """Return the rows of a range factor of some of the beams to one plane; None of another factor.

    A factor does not give its readings away, but its derivatives do: with the range s and the tangent
    basis B of the direction, de/dv = s de/dr B, and de/dr is as long as de/db, however rows weigh.
    Somebody else's factor on the same variables has other derivatives. A row of several beams, which
    errors of a pose couple, belongs to the one that moves it most. `owner` has the number of each beam
    by its variables.
    """
    keys, beams, bases, first = list(factor.keys()), [], [], [0]
    while size := next((n for n in (3, 2) if tuple(keys[:n]) in owner), 0):
        beams.append(owner[tuple(keys[:size])])
        bases.append(own.values.atUnit3(keys[1]).basis())
        terms = own.values.atVector(keys[2]).size if size == 3 else 0
        first.append(first[-1] + MOUNT_DIM + terms)
        keys = keys[size:]
    if not beams or not 1 <= len(keys) <= 2 or keys[0] not in planes:
        return None
    J: FloatArray = factor.linearize(own.values).jacobian()[0]
    inner, robust = factor.noiseModel(), False
    if isinstance(inner, gtsam.noiseModel.Robust):
        inner, robust = inner.noise(), True
    if isinstance(inner, gtsam.noiseModel.Gaussian) and not isinstance(
        inner, gtsam.noiseModel.Diagonal
    ):
        root: FloatArray = inner.R()
        J = np.asarray(np.linalg.solve(root, J))  # it mixes readings of several hands
    by_location = np.stack([J[:, a:][:, LOCATION] for a in first[:-1]])
    by_direction = np.stack([J[:, a:][:, DIRECTION] for a in first[:-1]])
    by_offset = J[:, first[-1] + PLANE.dim - 1]
    mine = np.square(by_location).sum(axis=2).argmax(axis=0), np.arange(len(J))
    across, turned = (by_location @ np.array(bases))[mine], by_direction[mine]
    size, square = (np.square(x).sum(axis=1) for x in (by_location[mine], across))
    # Squares of the sine of the incidence; a row at right angles says nothing of its range.
    seen = square > NEGLIGIBLE * size
    product = (turned * across).sum(axis=1)
    ranges: FloatArray = np.where(seen, product / np.where(seen, square, 1.0), np.nan)
    off = np.where(seen[:, None], turned - ranges[:, None] * across, 0.0)
    turns_as_a_range = np.square(off).max() <= NEGLIGIBLE * np.square(turned).max()
    length = np.square(by_location.sum(axis=0)).sum(axis=1)
    moves_as_a_plane = np.abs(length - by_offset**2).max() <= NEGLIGIBLE * size.max()
    # A robust model may take all weight from every row.
    if not (size.any() or (robust and not J.any())) or not (turns_as_a_range and moves_as_a_plane):
        return None
    pose = keys[1] if len(keys) > 1 else None
    return RangeRows(np.array(beams)[mine[0]], keys[0], pose, ranges, -float(by_offset.sum()))


class GraphFit(NamedTuple):
    """How a graph fits.

    Attributes
    ----------
    fit : Fit
        Of the rows of the range factors; chi2 and dof count the whole graph.
    times : float
        Residuals of these rows in their sigmas, as their own losses count them.
    missed : (float, str)
        The same of the prior that is missed by most, and what it is of; 0 where there is none.
    beam : (N,)
        Index of each row's beam.
    ranges : (N,)
        Predicted [m]; NaN where they are not known.
    against : set of int
        Keys of the planes whose normals point towards the sensors.
    farthest : (int, int)
        The factor, and its row, of the reading that is most sigmas off.
    """

    fit: Fit
    times: float
    missed: tuple[float, str]
    beam: IntArray
    ranges: FloatArray
    against: set[int]
    farthest: tuple[int, int]

    def has_plausible_range_errors(self, at: Parameters) -> bool:
        """Tell whether every true range is of the order of its reading; see `plausible_factors`.

        A factor does not give its readings d away, but s = d + k1 d + k2 d^2.
        """
        seen = ~np.isnan(self.ranges)
        s, k = self.ranges[seen], at.range_errors[self.beam[seen]].T
        with np.errstate(divide="ignore", invalid="ignore"):  # no reading has such a range
            slope = 1.0 + k[0]
            d = 2.0 * s / (slope + np.sqrt(slope**2 + 4.0 * k[1] * s))
            plausible: BoolArray = plausible_factors(k, d)
        return bool(plausible.all())


def _fit_of_graph(own: OwnGraph, wanted: Variables, unknowns: int) -> GraphFit:
    """Return how the range factors, and the priors of what is read, fit.

    Raises
    ------
    InputError
        A beam without a range factor to these planes, two names for one beam, or an error that is no
        number.
    """
    owner = {beam.variables: i for i, beam in enumerate(own.beams.values())}
    if len(owner) < len(own.beams):
        raise InputError("two names for one beam", "different variables for every beam")
    planes, labels, dims, cost, poses = set(own.planes.values()), list[str](), 0, 0.0, False
    along: dict[int, float] = {}
    missed = (0.0, "")
    rows: list[tuple[IntArray, FloatArray, FloatArray, FloatArray]] = []
    places: list[tuple[int, int]] = []
    for number in range(own.graph.size()):
        if not own.graph.exists(number):
            continue
        factor = own.graph.at(number)
        dims += factor.dim()
        keys = list(factor.keys())
        if len(keys) == 1 and keys[0] in wanted and factor.dim():
            squares = 2.0 * factor.error(own.values) / factor.dim()
            missed = max(missed, (float(np.sqrt(squares)), wanted[keys[0]][0]))
        if not isinstance(factor, gtsam.CustomFactor):
            continue
        read = _range_rows(own, owner, planes, factor)
        if read is None:
            continue
        poses |= read.pose is not None
        cost += factor.error(own.values)
        along[read.plane] = along.get(read.plane, 0.0) + read.along
        e = np.atleast_1d(factor.unwhitenedError(own.values))
        label = f"factor {number}" if read.pose is None else key_name(read.pose)
        labels += [label] if len(e) == 1 else [f"{label} row {i + 1}" for i in range(len(e))]
        model = factor.noiseModel()
        inner = model.noise() if isinstance(model, gtsam.noiseModel.Robust) else model
        sigma = np.asarray(inner.sigmas() if hasattr(inner, "sigmas") else np.ones(len(e)), float)
        rows.append((read.beam, e, sigma, read.ranges))
        places += [(number, row) for row in range(len(e))]
    for i, name in enumerate(own.beams):
        if all((beam != i).all() for beam, *_ in rows):
            expected = "at least one, and all beams of a factor that holds several"
            raise InputError(f"no range factor of beam {name} to these planes", expected)
    chi2 = 2.0 * own.graph.error(own.values)
    if not np.isfinite(chi2):
        raise InputError(f"an error of the graph of {chi2}", "values that are finite numbers")
    column, e, sigma, ranges = map(np.concatenate, zip(*rows, strict=True))
    fit = fit_of_rows(
        (labels, tuple(own.beams)),
        (np.arange(len(e)), column),
        e,
        e / sigma,
        ranges,
        chi2=chi2,
        dof=dims - unknowns,
        range_sigma=float(np.median(sigma)),
        given=True,
        poses="estimated" if poses else "exact",
        loss="gaussian",
    )
    against = {key for key, total in along.items() if total < 0.0}
    times = float(np.sqrt(2.0 * cost / len(e)))
    farthest = places[int(np.abs(e / sigma).argmax())]
    return GraphFit(fit, times, missed, column, ranges, against, farthest)


def _misfit(own: OwnGraph, found: GraphFit, at: Parameters) -> Iterator[CalibrationWarning]:
    """Say why an optimum is no calibration: of what does not fit, or what no sensor has."""
    far, fit = float(np.linalg.norm(at.locations, axis=1).max()), found.fit
    times, variable = found.missed
    misfits = fit.dof > 0 and found.times > TEN_TIMES
    alone = tuple(far_reading(fit)) if misfits else ()
    if alone and _saved_without(own, *found.farthest) > MAJORITY * (fit.chi2 - fit.dof):
        (station, beam), sigmas = fit.max_standardized_residual_at, fit.max_standardized_residual
        values: Values = {"station": station, "beam": beam, "sigmas": sigmas}
        yield warned("no-fit:reading", {**values, "sigma0": found.times})
        yield from alone
    elif misfits and times <= found.times:
        yield warned("no-fit:sigmas", {"sigma0": found.times})
    elif not found.has_plausible_range_errors(at):
        yield warned(IMPLAUSIBLE)
    elif far > NO_MOUNT:
        yield warned("far-beam:no-mount", {"distance_m": far})
    elif times > TEN_TIMES:
        yield warned("no-fit:prior", {"variable": variable, "times": times})


def _saved_without(own: OwnGraph, number: int, row: int) -> float:
    """Return how much smaller chi2 is without one row of a factor, as if the graph were linear."""
    factor = own.graph.at(number)
    assert isinstance(factor, gtsam.CustomFactor)
    linear, model = factor.linearize(own.values), factor.noiseModel()
    keys, (J, e) = list(linear.keys()), linear.jacobian()
    try:
        joint = gtsam.Marginals(own.graph, own.values).jointMarginalCovariance(sorted(set(keys)))
    except RuntimeError:  # planes far from the origin, whose normals and offsets look alike there
        return 0.0
    S = np.block([[joint.at(a, b) for b in keys] for a in keys])
    inner = model.noise() if isinstance(model, gtsam.noiseModel.Robust) else model
    assert isinstance(inner, gtsam.noiseModel.Gaussian)
    u = np.asarray(inner.R())[:, row]
    of_others = 1.0 - float(u @ J @ S @ J.T @ u) / float(u @ u)
    return float(u @ e) ** 2 / float(u @ u) / of_others if of_others > NEGLIGIBLE else 0.0


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
        Its fit lists the rows of the range factors; chi2 and dof count the whole graph. Normals point
        away from the sensors, whichever way the values have them. `not_converged` where the values are
        no optimum, the readings do not fit at all, or only with range errors that no sensor has, or
        a prior of a beam or a plane is missed by more than ten of its standard deviations;
        `unobservable` where the graph leaves beams or planes undetermined.

    Raises
    ------
    InputError
        What is no graph; a key without a value of the right type or size, a beam without range factors
        or under two names, names that cannot be printed, values without some of the graph's variables
        or that are no numbers or beyond sense, or constrained noise models.
    """
    if not isinstance(graph, gtsam.NonlinearFactorGraph):
        raise InputError(f"{type(graph).__name__} as graph", "a gtsam.NonlinearFactorGraph")
    require_values(values)
    require_names("the name of a beam", beams)
    require_names("the name of a plane", planes)
    own = OwnGraph(graph, values, beams, planes)
    wanted = _variables(own)
    with usable_values("value", graph, values):
        linear, points = amid_readings(graph.linearize(values), values)
    graph_fit = _fit_of_graph(own, wanted, linear.gradientAtZero().vector().size)
    fit = graph_fit.fit
    status, message, determined, covariance = _judged(own, linear, wanted, fit)
    at = parameters_of(values, list(beams.values()), list(planes.values()))
    signs = np.array([-1.0 if key in graph_fit.against else 1.0 for key in planes.values()])
    at = replace(at, normals=signs[:, None] * at.normals, offsets=signs * at.offsets)
    warnings: tuple[CalibrationWarning, ...] = ()
    if status == "converged":
        warnings = tuple(_misfit(own, graph_fit, at))
    if warnings:
        status, message, covariance = "not_converged", warnings[0].message, None
    else:
        if fit.p_value < SINGLE_LEVEL:
            warnings = (warned("sigmas-too-small:graph", chi2=fit.chi2, dof=fit.dof),)
        warnings += tuple(far_reading(fit))
    keys = [beam.range_error for beam in beams.values()]
    terms = tuple(0 if key is None else len(wanted[key][1]) for key in keys)
    joint = None if covariance is None else _joint(covariance, wanted, own, terms, signs, points)
    return Calibration(
        status,
        message,
        warnings,
        *named_estimates(tuple(beams), tuple(planes), at, terms, joint),
        fit,
        determined,
        StartReport(OF_GRAPH, ()),
        iterations=0,
        covariance=joint,
        correlations=() if joint is None else strong_correlations(joint),
    )


def _information(
    own: OwnGraph, linear: gtsam.GaussianFactorGraph, keys: list[int]
) -> tuple[FloatArray, FloatArray] | None:
    """Return the information of what is read, and its right-hand side; None if it has none."""
    order = gtsam.Ordering.ColamdConstrainedLastNonlinearFactorGraph(own.graph, keys)
    others = gtsam.Ordering([order.at(i) for i in range(order.size() - len(keys))])
    try:
        rest = linear.eliminatePartialSequential(others)[1] if others.size() else linear
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
    own: OwnGraph, linear: gtsam.GaussianFactorGraph, wanted: Variables, fit: Fit
) -> tuple[Status, str, Determined, FloatArray | None]:
    """Judge the values by the information of what is read, in natural units as everywhere.

    The covariance is None unless the values are the optimum and everything is determined.
    """
    information = _information(own, linear, list(wanted))
    block = np.repeat(np.arange(len(wanted)), [len(powers) for _, powers in wanted.values()])
    if information is None:
        words = "the graph leaves variables undetermined"
        found = Determined(0, len(block), None, (words,), (ANCHOR,))
        return "unobservable", f"{words}: {ANCHOR}", found, None
    matrix, vector = information
    length = fit.typical_range if fit.typical_range > 0.0 else 1.0
    unit = length ** np.concatenate([powers for _, powers in wanted.values()]).astype(float)
    values, axes = np.linalg.eigh(0.5 * (matrix + matrix.T) * np.outer(unit, unit))
    weak = open_axes(values, axes, block, ObservabilityOptions().most_sigma ** -2)
    if weak.any():
        share = np.bincount(block, (axes[:, weak] ** 2).sum(axis=1))
        far = (share > NAMED_SHARE * share.max()).tolist()
        names = tuple(
            words for (words, _), named in zip(wanted.values(), far, strict=True) if named
        )
        words = f"the graph does not determine {', '.join(names)}: {MOVE_MORE}"
        found = Determined(int((~weak).sum()), len(block), None, names, (MOVE_MORE,))
        return "unobservable", words, found, None
    S = (axes / values) @ axes.T * np.outer(unit, unit)
    found = Determined(len(block), len(block), float(np.sqrt(values[-1] / values[0])))
    away = float((np.abs(S @ vector) / np.sqrt(np.diagonal(S))).max())
    if not away <= OPTIMAL:
        words = f"the values are {away:.2g} standard deviations from the optimum: {FURTHER}"
        return "not_converged", words, found, None
    try:  # the squared length of the step to the optimum of all variables, in standard deviations
        decrement = -linear.gradientAtZero().dot(linear.optimize())
    except RuntimeError:
        decrement = np.inf
    if not decrement <= OPTIMAL**2:
        words = f"the values are not at the optimum of the graph: {FURTHER}"
        return "not_converged", words, found, None
    return "converged", "the values are the optimum of the graph", found, S


def _joint(
    S: FloatArray,
    wanted: Variables,
    own: OwnGraph,
    terms: tuple[int, ...],
    signs: FloatArray,
    points: Mapping[int, FloatArray],
) -> JointCovariance:
    """Return the covariance in the order of the names; shared variables stand once for every beam.

    `signs` (P,) turn the planes: offsets change theirs, and the bases of the normals. Offsets are taken
    at `points`.
    """
    ends = np.cumsum([len(powers) for _, powers in wanted.values()])
    columns = dict(zip(wanted, np.split(np.arange(ends[-1]), ends[:-1]), strict=True))
    at = np.concatenate([columns[key] for beam in own.beams.values() for key in beam.variables])
    p = np.array([columns[key] for key in own.planes.values()], dtype=np.intp).ravel()
    turned = np.ones(len(S))
    turned[p[PLANE.dim - 1 :: PLANE.dim]] = signs
    S = S * np.outer(turned, turned)
    unique = np.unique(at)
    W = -S[np.ix_(p, unique)] @ np.linalg.inv(S[np.ix_(unique, unique)])
    count, each = len(own.planes), np.arange(len(own.planes))
    coupling = (S[np.ix_(p, p)] + W @ S[np.ix_(unique, p)]).reshape(count, 3, count, 3)
    alone = coupling[each, :, each, :].copy()
    coupling[each, :, each, :] = 0.0
    expand = (at[:, None] == unique).astype(float)
    normals = [own.values.atOrientedPlane3(key).normal() for key in own.planes.values()]
    return JointCovariance(
        tuple(own.beams),
        tuple(own.planes),
        terms,
        S[np.ix_(at, at)],
        (W @ np.linalg.pinv(expand)).reshape(count, 3, -1),
        alone,
        np.array([own.values.atUnit3(beam.direction).basis() for beam in own.beams.values()]),
        signs[:, None, None] * np.array([normal.basis() for normal in normals]).reshape(-1, 3, 2),
        np.array([points[key] for key in own.planes.values()]).reshape(-1, 3),
        coupling,
    )
