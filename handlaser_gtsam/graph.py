"""From readings and a start to a GTSAM factor graph; builds, does not solve."""

from dataclasses import dataclass

import gtsam
import numpy as np

from .factors import RangeBlock, range_factor
from .keys import BeamKeys, beam_keys, plane_key
from .losses import GAUSSIAN, Loss
from .parameters import Parameters
from .recording import Readings


@dataclass(frozen=True, slots=True)
class CalibrationGraph:
    """A factor graph with what a solver needs to know about it.

    Attributes
    ----------
    graph : gtsam.NonlinearFactorGraph
    values : gtsam.Values
        The start.
    blocks : RangeBlocks
        Error functions of the range factors, all weighted by `range_sigma`.
    range_sigma : float
        Standard deviation of a reading [m].
    ordering : gtsam.Ordering
        Planes before beams: Brown's reduction as an elimination order, linear in the planes.
    beams, planes
        Keys in the order of the recording.
    terms : int
        Range-error terms of every beam.
    loss : Loss
        Of every reading.
    """

    graph: gtsam.NonlinearFactorGraph
    values: gtsam.Values
    blocks: tuple[RangeBlock, ...]
    range_sigma: float
    ordering: gtsam.Ordering
    beams: tuple[BeamKeys, ...]
    planes: tuple[int, ...]
    terms: int
    loss: Loss


def build_graph(
    readings: Readings,
    start: Parameters,
    terms: int,
    range_sigma: float,
    loss: Loss = GAUSSIAN,
) -> CalibrationGraph:
    """Return the graph of all readings on exact poses, one factor a plane and beam.

    Parameters
    ----------
    readings : Readings
    start : Parameters
        Where the solver starts; its range errors beyond `terms` are left out.
    terms : int
        Range-error terms of every beam: 0, 1 (k1) or 2 (k1, k2).
    range_sigma : float
        Standard deviation of a reading [m].
    loss : Loss
        Weighs every reading by itself.
    """
    beams = tuple(beam_keys(i, terms) for i in range(readings.beams))
    planes = tuple(plane_key(p) for p in range(readings.planes))
    blocks = _blocks(readings, beams, planes)
    graph = gtsam.NonlinearFactorGraph()
    for block in blocks:
        graph.push_back(range_factor(block, _noise_model(len(block.distance), range_sigma, loss)))
    ordering = gtsam.Ordering()
    for key in planes:
        ordering.push_back(key)
    for beam in beams:
        for beam_key in (beam.location, beam.direction, beam.range_error):
            if beam_key is not None:
                ordering.push_back(beam_key)
    values = start_values(start, beams, planes, terms)
    return CalibrationGraph(
        graph, values, blocks, range_sigma, ordering, beams, planes, terms, loss
    )


def _noise_model(rows: int, range_sigma: float, loss: Loss) -> gtsam.noiseModel.Base:
    """Return the noise model of a block; GTSAM would weigh the block as a whole by default."""
    isotropic = gtsam.noiseModel.Isotropic.Sigma(rows, range_sigma)
    if loss.name == "gaussian":
        return isotropic
    scheme = gtsam.noiseModel.mEstimator.Base.ReweightScheme.Scalar
    kinds = gtsam.noiseModel.mEstimator
    if loss.name == "huber":
        estimator: gtsam.noiseModel.mEstimator.Base = kinds.Huber.Create(loss.tuning, scheme)
    elif loss.name == "cauchy":
        estimator = kinds.Cauchy.Create(loss.tuning, scheme)
    else:
        estimator = kinds.Tukey.Create(loss.tuning, scheme)
    return gtsam.noiseModel.Robust.Create(estimator, isotropic)


def start_values(
    start: Parameters, beams: tuple[BeamKeys, ...], planes: tuple[int, ...], terms: int
) -> gtsam.Values:
    """Return `start` as GTSAM values under the given keys."""
    values = gtsam.Values()
    for i, beam in enumerate(beams):
        values.insert(beam.location, start.locations[i])
        values.insert(beam.direction, gtsam.Unit3(start.directions[i]))
        if beam.range_error is not None:
            values.insert(beam.range_error, start.range_errors[i, :terms])
    for p, key in enumerate(planes):
        values.insert(key, gtsam.OrientedPlane3(gtsam.Unit3(start.normals[p]), start.offsets[p]))
    return values


def read_parameters(problem: CalibrationGraph, values: gtsam.Values) -> Parameters:
    """Return the beams and planes of `values` as arrays."""
    k = np.zeros((len(problem.beams), 2))
    for i, beam in enumerate(problem.beams):
        if beam.range_error is not None:
            k[i, : problem.terms] = values.atVector(beam.range_error)
    planes = [values.atOrientedPlane3(key) for key in problem.planes]
    return Parameters(
        np.array([values.atPoint3(beam.location) for beam in problem.beams]),
        np.array([values.atUnit3(beam.direction).point3() for beam in problem.beams]),
        k,
        np.array([plane.normal().point3() for plane in planes]),
        np.array([plane.distance() for plane in planes]),
    )


def _blocks(
    readings: Readings, beams: tuple[BeamKeys, ...], planes: tuple[int, ...]
) -> tuple[RangeBlock, ...]:
    starts = readings.block_starts()
    ends = np.append(starts[1:], len(readings))
    return tuple(
        RangeBlock(
            beams[readings.beam[a]],
            planes[readings.plane[a]],
            readings.distance[a:e],
            readings.world_R_hand[a:e],
            readings.world_t_hand[a:e],
        )
        for a, e in zip(starts.tolist(), ends.tolist(), strict=True)
    )
