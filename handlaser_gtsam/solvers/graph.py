"""From readings and a start to a GTSAM factor graph; builds, does not solve.

Hand poses can be variables of the graph: then each has a prior with what is known about it beforehand.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, partial

import gtsam
import numpy as np

from ..arrays import FloatArray, IntArray, renumbered
from ..checks import require_covariance, require_kind, require_number
from ..data.parameters import Parameters, RangeErrorPrior, Terms, per_beam
from ..data.recording import Readings
from ..errors import InputError
from ..factors import RangeBlock, SharedEvaluation, range_error_prior, require_rows
from ..factors.keys import BeamKeys, beam_keys, plane_key, pose_key
from ..model.losses import GAUSSIAN, Loss
from ..model.weighting import Whitening, without_exact_axes
from ..quantities import LARGEST_LENGTH, NEGLIGIBLE
from .beam_problem import UNKNOWNS_RATIO


@dataclass(frozen=True, slots=True)
class PosePriors:
    """Recorded hand poses of the stations that have readings, and their covariances.

    Attributes
    ----------
    stations : (S,)
        Indices of the stations.
    world_R_hand : (S, 3, 3)
    world_t_hand : (S, 3)
        [m], in the frame of the readings.
    covariance : (S, 6, 6)
        (rx, ry, rz, x, y, z), hand frame [rad, m].
    start : gtsam.Values or None
        Poses to start from; the recorded ones where not given.
    """

    stations: IntArray
    world_R_hand: FloatArray
    world_t_hand: FloatArray
    covariance: FloatArray
    start: gtsam.Values | None = None

    def join(
        self, graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, keys: tuple[int, ...]
    ) -> None:
        """Add a prior for each of `keys` to `graph`, and a start to `values`."""
        for j, key in enumerate(keys):
            recorded = gtsam.Pose3(gtsam.Rot3(self.world_R_hand[j]), self.world_t_hand[j])
            model = gtsam.noiseModel.Gaussian.Covariance(self.covariance[j])
            graph.push_back(gtsam.PriorFactorPose3(key, recorded, model))
            values.insert(key, pose3=recorded if self.start is None else self.start.atPose3(key))


def pose_priors(
    readings: Readings, covariance: FloatArray, start: gtsam.Values | None = None
) -> PosePriors:
    """Return the priors of all stations with readings, from the covariance (M, 6, 6) of each.

    GTSAM's elimination needs a variance along every axis, as `without_exact_axes` gives.

    Raises
    ------
    InputError
        What is no covariance of every station.
    """
    count = int(readings.station.max()) + 1
    if np.shape(covariance)[1:] != (6, 6) or len(covariance) < count:
        found = f"covariances of shape {np.shape(covariance)}"
        raise InputError(found, f"({count}, 6, 6), one of each station")
    require_covariance("a pose covariance", covariance, NEGLIGIBLE)
    stations, first = np.unique(readings.station, return_index=True)
    whole = without_exact_axes(covariance[stations], readings.typical_range())
    return PosePriors(
        stations, readings.world_R_hand[first], readings.world_t_hand[first], whole, start
    )


@dataclass(frozen=True, slots=True)
class CalibrationGraph:
    """A factor graph with what a solver needs to know about it.

    Attributes
    ----------
    graph : gtsam.NonlinearFactorGraph
        Range factors, then the priors of range errors and of hand poses that are variables.
    values : gtsam.Values
        The start.
    blocks : tuple of RangeBlock
        Error functions of the range factors, all weighted by `range_sigma`.
    range_sigma : float
        Standard deviation of a whitened residual [m]; of a reading where all weigh the same.
    ordering : gtsam.Ordering
        Poses, then planes, then beams: Brown's reduction as an elimination order, linear in stations.
        Poses, then beams, then planes where there are far more beams, independent given the planes.
    beams, planes, poses
        Keys in the order of the readings' indices; poses by station, none where they are known.
    terms : tuple of int
        Range-error terms of each beam.
    loss : Loss
        Of every whitened residual.
    rows : (N,)
        Row of the readings for each row of the blocks.
    shared : SharedEvaluation
        Of the blocks, with the whitening of their rows.
    readings : Readings
    """

    graph: gtsam.NonlinearFactorGraph
    values: gtsam.Values
    blocks: tuple[RangeBlock, ...]
    range_sigma: float
    ordering: gtsam.Ordering
    beams: tuple[BeamKeys, ...]
    planes: tuple[int, ...]
    poses: tuple[int, ...]
    terms: tuple[int, ...]
    loss: Loss
    rows: IntArray
    shared: SharedEvaluation
    readings: Readings
    prior_rows: int = 0
    """Rows of the priors."""


def build_graph(
    readings: Readings,
    start: Parameters,
    terms: Terms,
    noise: float | Whitening,
    loss: Loss = GAUSSIAN,
    priors: PosePriors | None = None,
    range_errors: RangeErrorPrior | None = None,
) -> CalibrationGraph:
    """Return the graph of all readings.

    A factor holds the readings of a plane and a beam; of a plane and all beams where errors of the
    poses couple them, and of one station where poses are variables.

    Parameters
    ----------
    start : Parameters
        Where the solver starts; its range errors beyond `terms` are ignored.
    terms : int, or one a beam
    noise : float or Whitening
        Standard deviation of every reading [m], or how to whiten them.
    loss : Loss
    priors : PosePriors, optional
        Makes the hand pose of every station a variable; needs a whitening of the readings alone.
    range_errors : RangeErrorPrior, optional
        Of every beam.

    Raises
    ------
    InputError
        Noise that is neither a number above zero nor a whitening, terms other than 0, 1 or 2, or hand
        poses as variables of which the whitening has the errors, too.
    """
    require_kind("readings", readings, Readings)
    require_kind("start", start, Parameters)
    require_kind("loss", loss, Loss)
    if not isinstance(noise, Whitening):
        remedy = ", or a whitening: hl.model.whitening(...)"
        require_number("noise", noise, 0.0, LARGEST_LENGTH, above=True, unit="m", remedy=remedy)
        noise = float(noise)
    if priors is not None and (isinstance(noise, float) or noise.is_coupled):
        found = "hand poses as variables, with "
        found += (
            "no whitening" if isinstance(noise, float) else "their errors in the whitening, too"
        )
        raise InputError(found, "a whitening of the readings alone: Variances without `pose`")
    counts, planes = per_beam(terms, readings.beams), tuple(map(plane_key, range(readings.planes)))
    beams = tuple(beam_keys(i, count) for i, count in enumerate(counts))
    whitening, sigma = (None, noise) if isinstance(noise, float) else (noise, noise.sigma)
    coupled = whitening is not None and whitening.is_coupled
    require_rows(readings.distance, readings.world_R_hand, readings.world_t_hand)
    if whitening is None or (priors is None and not coupled):
        group, rows = readings.plane * readings.beams + readings.beam, np.arange(len(readings))
    else:
        group = readings.plane if priors is None else readings.station
        rows = np.lexsort((readings.beam, readings.station, group))
    blocks = grouped_blocks(readings, whitening, rows, group, (beams, planes, priors))
    graph, noise_model = gtsam.NonlinearFactorGraph(), cache(partial(_noise_model, sigma, loss))
    for block in blocks:
        graph.add(block.factor(noise_model(len(block.distance))))
    for factor in range_error_priors(beams, counts, range_errors):
        graph.add(factor)
    prior_rows = 0 if range_errors is None else range_errors.rows(max(counts))
    values = start_values(start, beams, planes, counts)
    poses: tuple[int, ...] = ()
    if priors is not None:
        poses = tuple(pose_key(j) for j in priors.stations.tolist())
        priors.join(graph, values, poses)
        prior_rows += 6 * len(poses)
    whitening = None if whitening is None else whitening.of_rows(rows)
    shared = SharedEvaluation(blocks, whitening, readings.measured[rows])
    of_beams = [key for beam in beams for key in beam.variables]
    # Uncoupled beams are independent given the planes: they go first where there are far more.
    order = [*poses, *planes, *of_beams]
    if not coupled and len(of_beams) > UNKNOWNS_RATIO * len(planes):
        order = [*poses, *of_beams, *planes]
    return CalibrationGraph(
        graph,
        values,
        blocks,
        sigma,
        gtsam.Ordering(order),
        beams,
        planes,
        poses,
        counts,
        loss,
        rows,
        shared,
        readings,
        prior_rows=prior_rows,
    )


def range_error_priors(
    beams: Sequence[BeamKeys], terms: Sequence[int], prior: RangeErrorPrior | None
) -> list[gtsam.NonlinearFactor]:
    """Return a prior factor for the range error of every beam that has one."""
    factors = []
    for i, (beam, count) in enumerate(zip(beams, terms, strict=True)):
        if prior is None or beam.range_error is None or np.isinf(prior.sigma[i, :count]).any():
            continue
        mean = np.zeros(count) if prior.mean is None else prior.mean[i, :count]
        factors.append(range_error_prior(beam.range_error, prior.sigma[i, :count], mean))
    return factors


def _noise_model(range_sigma: float, loss: Loss, rows: int) -> gtsam.noiseModel.Base:
    """Return the noise model of a block; GTSAM would weigh the block as a whole by default."""
    isotropic = gtsam.noiseModel.Isotropic.Sigma(rows, range_sigma)
    if loss.name == "gaussian":
        return isotropic
    estimators = gtsam.noiseModel.mEstimator
    kind = getattr(estimators, loss.name.capitalize())
    weighing = kind.Create(loss.tuning, estimators.Base.ReweightScheme.Scalar)
    return gtsam.noiseModel.Robust.Create(weighing, isotropic)


def start_values(
    start: Parameters, beams: tuple[BeamKeys, ...], planes: tuple[int, ...], terms: Terms
) -> gtsam.Values:
    """Return `start` as GTSAM values under the given keys.

    The name of the kind of value spares GTSAM the trial of one kind after the other.
    """
    counts = per_beam(terms, len(beams))
    values = gtsam.Values()
    for i, beam in enumerate(beams):
        values.insert(beam.location, start.locations[i])
        values.insert(beam.direction, unit3=gtsam.Unit3(start.directions[i]))
        if beam.range_error is not None:
            values.insert(beam.range_error, start.range_errors[i, : counts[i]])
    coefficients = np.column_stack((start.normals, start.offsets)).tolist()
    for key, plane in zip(planes, coefficients, strict=True):
        values.insert(key, plane=gtsam.OrientedPlane3(*plane))
    return values


def read_parameters(problem: CalibrationGraph, values: gtsam.Values) -> Parameters:
    """Return the beams and planes of `values` as arrays."""
    return parameters_of(values, problem.beams, problem.planes)


def parameters_of(
    values: gtsam.Values, beams: Sequence[BeamKeys], planes: Sequence[int]
) -> Parameters:
    """Return the beams and planes under the given keys as arrays."""
    k = np.zeros((len(beams), 2))
    for i, beam in enumerate(beams):
        if beam.range_error is not None:
            range_error = values.atVector(beam.range_error)
            k[i, : range_error.size] = range_error
    directions = [values.atUnit3(beam.direction).point3() for beam in beams]
    found = [values.atOrientedPlane3(key).planeCoefficients() for key in planes]
    n, b = np.hsplit(np.array(found).reshape(-1, 4), [3])
    return Parameters.unchecked(
        np.array([values.atPoint3(beam.location) for beam in beams]),
        np.array(directions).reshape(-1, 3),
        k,
        np.ascontiguousarray(n),
        b.ravel(),
    )


def grouped_blocks(
    readings: Readings,
    whitening: Whitening | None,
    rows: IntArray,
    group: IntArray,
    names: tuple[tuple[BeamKeys, ...], tuple[int, ...], PosePriors | None],
) -> tuple[RangeBlock, ...]:
    """Return a block for each run of `rows` of one group.

    A group is a plane with one beam, a plane, or a station with its pose.
    """
    beams, planes, priors = names
    group = group[rows]
    new = np.concatenate(([True], group[1:] != group[:-1]))
    starts, run = np.flatnonzero(new), np.cumsum(new) - 1
    # The beams of each run, in their order, and which of them each row is of.
    pair = run * len(beams) + readings.beam[rows]
    pairs = np.flatnonzero(np.bincount(pair))
    first = np.searchsorted(pairs, len(beams) * np.arange(len(starts) + 1))
    beam_of = renumbered(pair) - first[run]
    seen, first = [beams[i] for i in (pairs % len(beams)).tolist()], first.tolist()
    d, R, t = (
        one[rows] for one in (readings.distance, readings.world_R_hand, readings.world_t_hand)
    )
    if priors is not None:
        R, t = np.broadcast_to(np.eye(3), R.shape), np.zeros(t.shape)
    blocks, ends = [], [*starts[1:].tolist(), len(rows)]
    plane, station = (one[rows[starts]].tolist() for one in (readings.plane, readings.station))
    for g, (begin, end) in enumerate(zip(starts.tolist(), ends, strict=True)):
        own = slice(begin, end)
        blocks.append(
            RangeBlock(
                seen[first[g] : first[g + 1]],
                planes[plane[g]],
                d[own],
                R[own],
                t[own],
                None if priors is None else pose_key(station[g]),
                beam_of[own],
                whitening,
                readings.measured,
                rows[own],
            )
        )
    return tuple(blocks)
