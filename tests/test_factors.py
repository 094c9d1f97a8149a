"""Factors against differences through Values.retract, alone and in somebody else's graph."""

import gc
import weakref

import gtsam
import numpy as np
import pytest
from helpers import assert_jacobians_match, numeric_jacobian
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from handlaser_gtsam import factors
from handlaser_gtsam.data.readings import Regressors
from handlaser_gtsam.errors import GrazingBeamError, InputError, SolverError
from handlaser_gtsam.factors import BeamKeys, RangeBlock, SharedEvaluation, range_factor
from handlaser_gtsam.model.weighting import Whitening
from handlaser_gtsam.solvers.graph_levenberg import squared_columns

BEAM, BARE, PLANE, POSE = BeamKeys(11, 12, 13), BeamKeys(11, 12), 21, 31


def scene(seed, terms, count=5):
    """Return values around a random scene, hand poses and readings."""
    rng = np.random.default_rng(seed)
    n = rng.standard_normal(3)
    n /= np.linalg.norm(n)
    poses = []
    for _ in range(count):
        turn = Rotation.random(random_state=rng)
        poses.append(gtsam.Pose3(gtsam.Rot3(turn.as_matrix()), rng.uniform(-1.0, 1.0, 3)))
    v = poses[0].rotation().matrix().T @ (n + 0.5 * rng.uniform(-1.0, 1.0, 3))
    values = gtsam.Values()
    values.insert(11, rng.uniform(-0.1, 0.1, 3))
    values.insert(12, gtsam.Unit3(v))
    if terms:
        values.insert(13, rng.uniform(-0.02, 0.02, terms))
    values.insert(PLANE, gtsam.OrientedPlane3(gtsam.Unit3(n), rng.uniform(-2.0, 2.0)))
    values.insert(POSE, poses[0])
    return values, poses, rng.uniform(0.05, 1.0, count)


def matrices(poses):
    R = np.array([pose.rotation().matrix() for pose in poses])
    return R, np.array([pose.translation() for pose in poses])


def grazing(values, pose):
    plane, v = values.atOrientedPlane3(PLANE), values.atUnit3(12).point3()
    return abs(plane.normal().point3() @ pose.rotation().matrix() @ v) < 0.1


@given(st.integers(0, 10**6), st.sampled_from([0, 1, 2]))
def test_jacobians_on_known_poses(seed, terms):
    values, poses, d = scene(seed, terms)
    poses = [pose for pose in poses if not grazing(values, pose)] or []
    if not poses:
        return
    beam = BEAM if terms else BARE
    factor = factors.range_to_plane(beam, PLANE, poses, d[: len(poses)], 1.0)
    assert_jacobians_match(factor, values)


@pytest.mark.slow
@given(st.integers(0, 10**6), st.sampled_from([0, 1, 2]))
def test_jacobians_on_a_pose_variable(seed, terms):
    values, poses, d = scene(seed, terms)
    if grazing(values, poses[0]):
        return
    beam = BEAM if terms else BARE
    factor = factors.range_to_plane_from_pose(beam, PLANE, POSE, d[:2], 1.0)
    assert list(factor.keys()) == [11, 12, *([13] if terms else []), PLANE, POSE]
    assert_jacobians_match(factor, values)


def test_pose_variable_and_known_pose_agree():
    values, poses, d = scene(3, 2)
    known = factors.range_to_plane(BEAM, PLANE, poses[:1], d[:1], 1.0)
    variable = factors.range_to_plane_from_pose(BEAM, PLANE, POSE, float(d[0]), 1.0)
    assert np.array_equal(known.unwhitenedError(values), variable.unwhitenedError(values))


def test_the_plane_as_gtsam_sees_it():
    """b_H and n_H of the factor are those of OrientedPlane3.transform."""
    values, poses, _ = scene(4, 0)
    seen = values.atOrientedPlane3(PLANE).transform(poses[0])
    n, b = seen.normal().point3(), seen.distance()
    r, v = values.atPoint3(11), values.atUnit3(12).point3()
    factor = factors.range_to_plane(BARE, PLANE, poses[:1], [0.25], 1.0)
    assert factor.unwhitenedError(values) == pytest.approx(-(n @ r + b) / (n @ v) - 0.25)


@pytest.mark.parametrize("terms", [0, 1, 2])
def test_shared_evaluation_equals_each_block(terms):
    values, poses, d = scene(5, terms)
    beam = BEAM if terms else BARE
    R = np.array([pose.rotation().matrix() for pose in poses])
    t = np.array([pose.translation() for pose in poses])
    known = RangeBlock(beam, PLANE, d, R, t)
    variable = RangeBlock(beam, PLANE, d[:1], R[:1], t[:1], POSE)
    blocks = [known, variable]
    graph = gtsam.NonlinearFactorGraph()
    for block in blocks:
        graph.push_back(range_factor(block, 0.5))
    alone = graph.linearize(values)
    elsewhere = gtsam.Values(values)
    elsewhere.update(11, values.atPoint3(11) + 0.01)
    shared = SharedEvaluation(blocks)
    # Asked at other values, factors hand out what was evaluated: they do not evaluate themselves.
    with shared.handed_out(shared.evaluate(values)):
        assert graph.linearize(elsewhere).equals(alone, 1e-12)
    assert not graph.linearize(elsewhere).equals(alone, 1e-4)
    assert graph.linearize(values).equals(alone, 1e-15)


def test_blocks_of_several_shapes_share_in_any_order():
    """Factors of one shape hand out the same matrices of GTSAM, one after the other."""
    values, poses, d = scene(9, 2, 9)
    R = np.array([pose.rotation().matrix() for pose in poses])
    t = np.array([pose.translation() for pose in poses])
    graph, blocks = gtsam.NonlinearFactorGraph(), []
    for first, end in ((0, 2), (2, 5), (5, 7), (7, 8), (8, 9)):
        rows = slice(first, end)
        blocks.append(RangeBlock(BEAM, PLANE, d[rows], R[rows], t[rows]))
        graph.push_back(range_factor(blocks[-1], 0.5))
    alone = graph.linearize(values)
    shared = SharedEvaluation(blocks)
    for _ in range(2):  # the second time it writes where it wrote before
        with shared.handed_out(shared.evaluate(values)):
            assert graph.linearize(values).equals(alone, 1e-12)


def test_sharing_follows_values_of_another_number_of_range_errors():
    values, poses, d = scene(9, 2)
    block = RangeBlock(BEAM, PLANE, d, *matrices(poses))
    graph, shared = gtsam.NonlinearFactorGraph(), SharedEvaluation([block])
    graph.push_back(range_factor(block, 0.5))
    for terms in (2, 1, 2):
        values.update(13, np.linspace(0.01, 0.02, terms))
        alone = graph.linearize(values)
        with shared.handed_out(shared.evaluate(values)):
            assert graph.linearize(values).equals(alone, 1e-12)


def test_a_block_picks_its_rows_of_the_weights():
    values, poses, d = scene(9, 2, 6)
    R, t = matrices(poses)
    common = 0.1 * np.random.default_rng(0).standard_normal((6, 6))
    how = Whitening(np.linspace(1.0, 2.0, 6), 0.5, np.array([0, 1, 2, 0, 1, 2]), common)
    rows = np.array([1, 4, 2])
    level = Regressors(d, 0.9 * d)
    picked = RangeBlock(BEAM, PLANE, d[rows], R[rows], t[rows], None, None, how, level, rows)
    mine = how.of_rows(rows), level[rows]
    given = RangeBlock(BEAM, PLANE, d[rows], R[rows], t[rows], None, None, *mine)
    before = [getattr(picked, name) for name in RangeBlock.__slots__]
    for _ in range(2):
        assert picked.whitening == given.whitening
        assert picked.measured == given.measured
    # To ask a block changes nothing of it.
    assert all(
        getattr(picked, name) is one for name, one in zip(RangeBlock.__slots__, before, strict=True)
    )
    alone = RangeBlock(BEAM, PLANE, d[rows], R[rows], t[rows], None, None, how, None, rows)
    assert np.array_equal(alone.measured, d[rows])
    white = [range_factor(block, 0.5).unwhitenedError(values) for block in (picked, given)]
    assert np.array_equal(*white)


def test_sharing_ends_when_the_solve_is_interrupted():
    values, poses, d = scene(5, 0)
    R = np.array([pose.rotation().matrix() for pose in poses])
    block = RangeBlock(BARE, PLANE, d, R, np.array([pose.translation() for pose in poses]))
    shared = SharedEvaluation([block])
    with pytest.raises(KeyboardInterrupt), shared.handed_out(shared.evaluate(values)):
        raise KeyboardInterrupt
    assert block.prepared is None


def test_what_is_handed_out_cannot_be_exchanged():
    values, poses, d = scene(5, 0)
    block = RangeBlock(BARE, PLANE, d, *matrices(poses))
    shared = SharedEvaluation([block])
    with shared.handed_out(shared.evaluate(values)), pytest.raises(AttributeError):
        block.prepared.white = np.zeros(5)


def test_squared_columns_are_the_diagonal_of_the_information():
    values, poses, d = scene(6, 2)
    graph = gtsam.NonlinearFactorGraph()
    graph.push_back(range_factor(RangeBlock(BEAM, PLANE, d, *matrices(poses)), 0.5))
    sigma = gtsam.noiseModel.Isotropic.Sigma(3, 0.2)
    loss = gtsam.noiseModel.mEstimator.Huber.Create(1.0)
    noise = gtsam.noiseModel.Robust.Create(loss, sigma)
    prior = gtsam.PriorFactorPoint3(BEAM.location, np.array([3.0, 2.0, 1.0]), noise)
    graph.push_back(prior)
    linear = graph.linearize(values)
    columns, diagonal = squared_columns(linear), np.diagonal(linear.hessian()[0])
    assert np.allclose(np.concatenate([columns[key] for key in sorted(columns)]), diagonal)


@pytest.mark.parametrize("ranges", [[0.0], [-1.0], [np.nan], [np.inf], []])
def test_readings_that_are_none_are_refused(ranges):
    with pytest.raises(InputError, match="positive, finite ranges"):
        factors.range_to_plane(BARE, PLANE, [gtsam.Pose3()] * len(ranges), ranges, 1.0)


@pytest.mark.parametrize("noise", [0.0, -1.0, np.nan, gtsam.noiseModel.Isotropic.Sigma(3, 1.0)])
def test_noise_that_does_not_fit_is_refused(noise):
    with pytest.raises(InputError, match=r"sigma|dimension"):
        factors.range_to_plane(BARE, PLANE, [gtsam.Pose3()] * 2, [0.1, 0.2], noise)


@pytest.mark.parametrize("noise", [None, "1e-3", True, [1e-3, 1e-3]])
def test_noise_of_another_type_is_refused(noise):
    with pytest.raises(InputError, match=r"a number, above 0.*or a noise model of GTSAM"):
        factors.range_to_plane(BARE, PLANE, [gtsam.Pose3()] * 2, [0.1, 0.2], noise)


def huber(rows, scheme, inner=None):
    estimator = gtsam.noiseModel.mEstimator.Huber.Create(1.345, scheme)
    inner = inner or gtsam.noiseModel.Isotropic.Sigma(rows, 1e-3)
    return gtsam.noiseModel.Robust.Create(estimator, inner)


@pytest.mark.parametrize("correlated", [False, True])
def test_a_robust_noise_model_weighs_reading_by_reading_or_is_refused(correlated):
    schemes = gtsam.noiseModel.mEstimator.Base.ReweightScheme
    values = gtsam.Values()
    values.insert(11, np.zeros(3))
    values.insert(12, gtsam.Unit3(0.0, 0.0, 1.0))
    values.insert(PLANE, gtsam.OrientedPlane3(gtsam.Unit3(0.0, 0.0, 1.0), -1.0))
    poses = [gtsam.Pose3(gtsam.Rot3(), np.array([0.0, 0.0, 0.1 * i])) for i in range(5)]
    d = np.array([1.0, 0.9, 0.8 + 0.05, 0.7, 0.6]) + 2e-4 * np.array([1.0, -1.0, 0.0, 1.0, -1.0])
    inner = gtsam.noiseModel.Gaussian.Covariance(1e-6 * (np.eye(5) + 0.2)) if correlated else None
    with pytest.raises(InputError, match="one common weight"):
        factors.range_to_plane(BARE, PLANE, poses, d, huber(5, schemes.Block, inner))
    if correlated:
        return
    factor = factors.range_to_plane(BARE, PLANE, poses, d, huber(5, schemes.Scalar))
    robust, _ = factor.linearize(values).jacobian()
    plain, _ = factors.range_to_plane(BARE, PLANE, poses, d, 1e-3).linearize(values).jacobian()
    weight = np.abs(robust).max(axis=1) / np.abs(plain).max(axis=1)
    assert weight[[0, 1, 3, 4]] == pytest.approx(1.0)
    assert weight[2] == pytest.approx(np.sqrt(1.345 / 50.0), rel=1e-6)
    factors.range_to_plane(BARE, PLANE, poses[:1], d[:1], huber(1, schemes.Block))


def test_integers_of_numpy_are_keys_and_coinciding_keys_are_refused():
    beam = BeamKeys(*np.array([11, 12]))
    factor = factors.range_to_plane(beam, np.int64(PLANE), [gtsam.Pose3()], [0.1], 1.0)
    assert list(factor.keys()) == [11, 12, PLANE]
    with pytest.raises(InputError, match="a key of its own"):
        factors.range_to_plane(BARE, 11, [gtsam.Pose3()], [0.1], 1.0)
    with pytest.raises(InputError, match="a key of its own"):
        factors.range_to_plane_from_pose(BARE, PLANE, PLANE, 0.1, 1.0)
    for key in (1.0, "x0", None, True, -1):
        with pytest.raises(InputError, match="as the key of a plane"):
            factors.range_to_plane(BARE, key, [gtsam.Pose3()], [0.1], 1.0)


@given(st.integers(0, 10**6), st.floats(0.0, 3.0))
def test_the_drift_of_a_beam_has_as_many_rows_as_degrees_of_freedom(seed, angle):
    rng = np.random.default_rng(seed)
    before, now = BeamKeys(1, 2), BeamKeys(3, 4)
    _, turn = factors.beam_drift(before, now, 1e-3, 0.5)
    v = gtsam.Unit3(rng.standard_normal(3))
    axis = v.basis() @ rng.standard_normal(2)
    w = gtsam.Rot3.Expmap(angle * axis / np.linalg.norm(axis)).rotate(v.point3())
    values = gtsam.Values()
    values.insert(2, v)
    values.insert(4, gtsam.Unit3(w))
    e = turn.unwhitenedError(values)
    assert e.shape == (2,)
    assert np.linalg.norm(e) == pytest.approx(2.0 * np.sin(0.5 * angle), abs=1e-9)
    # GTSAM chooses another basis where two coordinates of v are of one size: no derivative there.
    apart = np.diff(np.sort(np.abs(v.point3())))
    if apart.min() > 1e-3:
        A, _ = turn.linearize(values).jacobian()
        numeric = np.hstack([numeric_jacobian(turn, values, key, 1e-6) for key in (2, 4)])
        assert np.abs(0.5 * A - numeric).max() < 1e-6 / max(np.cos(0.5 * angle), 0.05) ** 3


def test_beams_of_which_the_drift_makes_no_sense_are_refused():
    with pytest.raises(InputError, match="share"):
        factors.beam_drift(BeamKeys(1, 2), BeamKeys(3, 2), 1e-3, 1e-3)
    with pytest.raises(InputError, match="one sigma a term"):
        factors.beam_drift(BeamKeys(1, 2, 5), BeamKeys(3, 4, 6), 1e-3, 1e-3)
    with pytest.raises(InputError, match="stays the same"):
        factors.beam_drift(BeamKeys(1, 2, 5), BeamKeys(3, 4, 5), 1e-3, 1e-3, [1e-3])
    assert len(factors.beam_drift(BeamKeys(1, 2, 5), BeamKeys(3, 4, 5), 1e-3, 1e-3)) == 2
    assert len(factors.beam_drift(BeamKeys(1, 2, 5), BeamKeys(3, 4, 6), 1e-3, 1e-3, [1e-3])) == 3


def test_poses_and_readings_must_pair():
    with pytest.raises(InputError, match="hand poses"):
        factors.range_to_plane(BARE, PLANE, [gtsam.Pose3()], [0.1, 0.2], 1.0)


def test_arguments_of_the_wrong_kind_are_named():
    with pytest.raises(InputError, match="BeamKeys"):
        factors.range_to_plane((11, 12), PLANE, [gtsam.Pose3()], [0.1], 1.0)
    with pytest.raises(InputError, match="a sequence of hand poses"):
        factors.range_to_plane(BARE, PLANE, gtsam.Pose3(), [0.1], 1.0)
    with pytest.raises(InputError, match="hand pose"):
        factors.range_to_plane(BARE, PLANE, [np.eye(4)], [0.1], 1.0)
    with pytest.raises(InputError, match="the key of a hand pose"):
        factors.range_to_plane_from_pose(BARE, PLANE, None, 0.1, 1.0)
    with pytest.raises(InputError, match="the key of a range error"):
        factors.range_error_prior("k", [1e-3])
    with pytest.raises(InputError, match="BeamKeys"):
        factors.beam_drift(BARE, 5, 1e-3, 1e-3)
    with pytest.raises(InputError, match="the key of a plane"):
        factors.range_to_plane(BARE, 2**64, [gtsam.Pose3()], [0.1], 1.0)


@pytest.mark.parametrize(
    "R", [np.diag([1.0, 1.0, -1.0]), 1.001 * np.eye(3)], ids=["mirror", "scale"]
)
def test_hand_poses_that_are_no_rotations_are_refused(R):
    with pytest.raises(InputError, match="no rotation at station 1 of 1"):
        factors.range_to_plane(BARE, PLANE, [gtsam.Pose3(gtsam.Rot3(R), [0, 0, 0])], [0.1], 1.0)


@pytest.mark.parametrize(
    "model",
    [
        gtsam.noiseModel.Isotropic.Sigma(1, 0.0),
        gtsam.noiseModel.Isotropic.Sigma(1, np.nan),
        gtsam.noiseModel.Constrained.All(1),
        gtsam.noiseModel.Robust.Create(
            gtsam.noiseModel.mEstimator.Huber.Create(1.3), gtsam.noiseModel.Isotropic.Sigma(1, 0.0)
        ),
    ],
    ids=["zero", "nan", "constrained", "robust"],
)
def test_noise_models_without_sigmas_above_zero_are_refused(model):
    with pytest.raises(InputError, match="without sigmas above zero"):
        factors.range_to_plane(BARE, PLANE, [gtsam.Pose3()], [0.1], model)
    negative = gtsam.noiseModel.Gaussian.Covariance(np.diag([1e-6, -1e-6]))
    with pytest.raises(InputError, match="without sigmas above zero"):
        factors.range_to_plane(BARE, PLANE, 2 * [gtsam.Pose3()], [0.1, 0.2], negative)


def test_readings_below_zero_count_where_the_sensor_has_such():
    pose = [gtsam.Pose3()]
    with pytest.raises(InputError, match="range_min"):
        factors.range_to_plane(BARE, PLANE, pose, [-0.002], 1e-4)
    factor = factors.range_to_plane(BARE, PLANE, pose, [-0.002], 1e-4, range_min=-0.01)
    values = gtsam.Values()
    values.insert(11, np.zeros(3))
    values.insert(12, gtsam.Unit3(np.array([0.0, 0.0, 1.0])))
    values.insert(PLANE, gtsam.OrientedPlane3(0.0, 0.0, 1.0, 0.003))
    assert factor.unwhitenedError(values) == pytest.approx([-0.001])
    with pytest.raises(InputError, match=r"above -0\.01 m"):
        factors.range_to_plane_from_pose(BARE, PLANE, 4, -0.02, 1e-4, range_min=-0.01)


def test_grazing_beam_raises_through_gtsam():
    values, poses, d = scene(7, 0)
    n_hand = poses[0].rotation().matrix().T @ values.atOrientedPlane3(PLANE).normal().point3()
    values.update(12, gtsam.Unit3(np.cross(n_hand, [0.3, 0.5, 0.7])))
    factor = factors.range_to_plane(BARE, PLANE, poses[:1], d[:1], 1.0)
    with pytest.raises(GrazingBeamError):
        factor.linearize(values)


def test_values_that_are_not_finite_are_refused():
    values, poses, d = scene(7, 0)
    values.update(11, np.array([np.nan, 0.0, 0.0]))
    factor = factors.range_to_plane(BARE, PLANE, poses, d, 1.0)
    with pytest.raises(SolverError, match="not finite"):
        factor.linearize(values)


def test_range_error_of_three_terms_is_refused():
    values, poses, d = scene(8, 0)
    values.insert(13, np.zeros(3))
    factor = factors.range_to_plane(BEAM, PLANE, poses, d, 1.0)
    with pytest.raises(SolverError, match="3 terms"):
        factor.linearize(values)


@pytest.mark.slow
def test_factors_are_freed():
    """A callback that refers to its own factor would never be collected."""
    values, poses, d = scene(9, 0)
    R = np.array([pose.rotation().matrix() for pose in poses])

    class Watched(RangeBlock):
        __slots__ = ("__weakref__",)

    block = Watched(BARE, PLANE, d, R, np.array([pose.translation() for pose in poses]))
    alive = weakref.ref(block)
    factor = range_factor(block, 1.0)
    factor.linearize(values)
    del block
    gc.collect()
    assert alive() is not None
    del factor
    gc.collect()
    assert alive() is None


def test_one_line_joins_a_graph_that_gtsam_solves():
    """Known beam and poses: GTSAM's own optimizer finds the plane."""
    values, poses, _ = scene(10, 0, count=40)
    poses = [pose for pose in poses if not grazing(values, pose)]
    exact = factors.range_to_plane(BARE, PLANE, poses, np.ones(len(poses)), 1.0)
    s = exact.unwhitenedError(values) + 1.0
    ahead = s > 0.05
    graph = gtsam.NonlinearFactorGraph()
    kept = [pose for pose, good in zip(poses, ahead, strict=True) if good]
    graph.push_back(factors.range_to_plane(BARE, PLANE, kept, s[ahead], 1e-3))
    graph.addPriorPoint3(11, values.atPoint3(11), gtsam.noiseModel.Isotropic.Sigma(3, 1e-6))
    tight = gtsam.noiseModel.Isotropic.Sigma(2, 1e-6)
    graph.push_back(gtsam.PriorFactorUnit3(12, values.atUnit3(12), tight))
    truth = values.atOrientedPlane3(PLANE)
    start = gtsam.Values(values)
    start.erase(POSE)
    start.update(PLANE, truth.retract(np.array([0.02, -0.03, 0.01])))
    found = gtsam.Values(gtsam.LevenbergMarquardtOptimizer(graph, start).optimize())
    assert found.atOrientedPlane3(PLANE).equals(truth, 1e-6)


def test_a_position_that_is_too_far_is_refused_with_the_limit():
    there = gtsam.Pose3(gtsam.Rot3(), np.array([5e5, 5.3e6, 500.0]))
    with pytest.raises(InputError, match=r"a hand position of 5.3e\+06 m; .*at most 1000000"):
        factors.range_to_plane(BEAM, PLANE, [there], [0.3], 1e-3)
