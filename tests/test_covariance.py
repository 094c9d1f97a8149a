"""The joint covariance: by elimination, by GTSAM's marginals, by a dense inverse, and reduced."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from helpers import simulated

from handlaser_gtsam.errors import InputError
from handlaser_gtsam.estimation.solution import covariance, covariance_of_determined
from handlaser_gtsam.model.weighting import Variances, whitening
from handlaser_gtsam.observability.rank import observability
from handlaser_gtsam.solvers.graph import build_graph, pose_priors, read_parameters
from handlaser_gtsam.solvers.graph_levenberg import levenberg_marquardt, linearize
from handlaser_gtsam.validation.scenes import Layout

SIGMA = 3e-5
POSE = np.diag([5e-4**2] * 3 + [5e-5**2] * 3)
TERMS = (2, 0, 1)


def solved(kind):
    """Return readings, their variances, and the graph and values of a solution of three beams."""
    recording, truth = simulated("paper", Layout(3, 4, 12, 0.01, 0.1))
    readings = recording.readings()
    origins = readings.plane_means(readings.world_t_hand)
    readings, truth = readings.seen_from(origins), truth.seen_from(origins)
    poses = np.broadcast_to(POSE, (len(recording.plane_labels), 6, 6))
    variances = Variances(np.full(3, SIGMA), 0.0, None if kind == "exact" else poses)
    noise = SIGMA if kind == "exact" else whitening(truth, readings, variances)
    priors = None
    if kind == "estimated":
        noise = whitening(truth, readings, variances.without_poses())
        priors = pose_priors(readings, poses)
    problem = build_graph(readings, truth, TERMS, noise, priors=priors)
    return readings, variances, problem, levenberg_marquardt(problem).values


def tangent_keys(problem):
    beams = [key for b in problem.beams for key in (b.location, b.direction, b.range_error)]
    return [key for key in beams if key is not None] + list(problem.planes)


def relative(difference, covariance_):
    scale = np.sqrt(np.diagonal(covariance_))
    return np.abs(difference / np.outer(scale, scale)).max()


@pytest.mark.parametrize("kind", ["exact", "marginalised", "estimated"])
def test_elimination_marginals_and_dense_inverse_agree(kind):
    _, _, problem, values = solved(kind)
    mine = covariance(problem, values).matrix(ambient=False)
    linear = linearize(problem, values)
    keys = tangent_keys(problem)
    marginals = gtsam.Marginals(linear, values).jointMarginalCovariance(keys).fullMatrix()
    information = linear.hessian(problem.ordering)[0]
    scale = np.sqrt(np.diagonal(information))
    dense = np.linalg.inv(information / np.outer(scale, scale)) / np.outer(scale, scale)
    first = 6 * len(problem.poses)
    planes = np.arange(first, first + 3 * len(problem.planes))
    at = np.concatenate((np.arange(planes[-1] + 1, len(dense)), planes))
    dense = dense[np.ix_(at, at)]
    # In correlations the information has a condition of 1e4 (1e7 with poses): 1e-16 becomes 1e-11.
    assert relative(mine - dense, dense) < 1e-9
    assert relative(marginals - dense, dense) < 1e-9


@pytest.mark.parametrize("kind", ["exact", "marginalised"])
def test_the_reduced_information_gives_the_same(kind):
    """What stands in where GTSAM calls a system indeterminate, or where rank is short."""
    readings, variances, problem, values = solved(kind)
    at = read_parameters(problem, values)
    how = None if kind == "exact" else whitening(at, readings, variances)
    if how is not None:
        problem = build_graph(readings, at, TERMS, how)
        values = problem.values
    origins = np.full((len(problem.planes), 3), 0.2)
    sigma = SIGMA if how is None else how.sigma
    found = observability(at, readings, TERMS, sigma, whitening=how)
    assert found.full
    assert found.unknowns == (5 + 2) + 5 + (5 + 1) + 4 * 3
    mine = covariance_of_determined(found, at, sigma, origins).matrix()
    its = replace(covariance(problem, values), origins=origins).matrix()
    keep = np.flatnonzero(np.diagonal(its) > 0.0)
    assert (np.diagonal(mine) > 0.0).sum() == len(keep)
    difference = (mine - its)[np.ix_(keep, keep)]
    # The offset at the world's origin is far from the readings: some digits go in the difference.
    assert relative(difference, its[np.ix_(keep, keep)]) < 1e-7


def test_marginalised_and_estimated_poses_have_one_covariance():
    """The prior of a pose, eliminated, is what it adds to the weights: the same to first order."""
    marginalised, estimated = (
        covariance(problem, values).matrix(ambient=False)
        for _, _, problem, values in (solved("marginalised"), solved("estimated"))
    )
    sigmas = np.sqrt(np.diagonal(marginalised))
    assert np.allclose(np.sqrt(np.diagonal(estimated)), sigmas, rtol=0.01)


def test_parts_by_name_and_their_labels():
    _, _, problem, values = solved("exact")
    joint = covariance(problem, values).arranged(
        [("left", 2), ("right", 0), ("top", 1)], [("floor", 3), ("wall", 1)]
    )
    whole = covariance(problem, values).matrix()
    rows = [*range(16, 24), *range(16), *range(24 + 12, 24 + 16), *range(24 + 4, 24 + 8)]
    expected = whole[np.ix_(rows, rows)]
    # An offset at the world's origin is a small difference of large numbers: 1e-16 times 1e4.
    assert np.abs(joint.matrix() - expected).max() < 1e-12 * np.abs(expected).max()
    assert np.allclose(joint.matrix(["right"], []), joint.all_beams()[1])
    assert np.allclose(joint.matrix([], ["wall"]), joint.all_planes()[1])
    assert joint.labels()[8] == ("beam right", "x")
    assert joint.labels()[-1] == ("plane wall", "b")
    assert np.allclose(joint.scaled(4.0).matrix(), 4.0 * joint.matrix())
    with pytest.raises(InputError, match="beam 'tip'; expected one of left, right, top"):
        joint.matrix(["tip"])
