"""What this package relies on in GTSAM's wheel; a new wheel that changes it must be noticed."""

import gtsam
import numpy as np
import pytest

KEY, OTHER = 1, 2


def custom(error, keys=(KEY,), dim=1):
    noise = gtsam.noiseModel.Unit.Create(dim)
    return gtsam.CustomFactor(noise, list(keys), error)


def one_value():
    values = gtsam.Values()
    values.insert(KEY, np.zeros(3))
    return values


def fill(jacobians, block):
    if jacobians is not None:
        jacobians[0] = block


def test_python_owned_values_are_not_copied():
    """Sharing one evaluation among factors needs the callback to see our own Values."""
    values, seen = one_value(), []

    def error(_, given, jacobians):
        seen.append(given is values)
        fill(jacobians, np.zeros((1, 3)))
        return np.zeros(1)

    graph = gtsam.NonlinearFactorGraph()
    graph.push_back(custom(error))
    graph.linearize(values)
    graph.error(values)
    assert seen == [True, True]


def test_exceptions_of_a_callback_come_through_linearize():
    def error(*_):
        raise KeyboardInterrupt

    graph = gtsam.NonlinearFactorGraph()
    graph.push_back(custom(error))
    with pytest.raises(KeyboardInterrupt):
        graph.linearize(one_value())


def test_a_singular_system_is_a_runtime_error():
    """The solver takes RuntimeError from `optimize` for a singular system."""
    graph = gtsam.GaussianFactorGraph()
    graph.add(KEY, np.zeros((1, 1)), np.ones(1), gtsam.noiseModel.Unit.Create(1))
    with pytest.raises(RuntimeError, match=r"[Ii]ndeterminate"):
        graph.optimize()


def test_retract_keeps_values_without_a_step():
    values = one_value()
    values.insert(OTHER, np.ones(3))
    step = gtsam.VectorValues()
    step.insert(KEY, np.full(3, 2.0))
    moved = values.retract(step)
    assert moved.atPoint3(KEY).tolist() == [2.0, 2.0, 2.0]
    assert moved.atPoint3(OTHER).tolist() == [1.0, 1.0, 1.0]


def test_a_plane_retracts_in_the_basis_of_its_normal():
    plane = gtsam.OrientedPlane3(gtsam.Unit3(np.array([0.3, -0.5, 0.8])), 0.4)
    step = np.array([1e-6, -2e-6, 3e-6])
    moved = plane.retract(step)
    n, basis = plane.normal().point3(), plane.normal().basis()
    # First order: the rest is 1e-12.
    assert np.allclose(moved.normal().point3(), n + basis @ step[:2], atol=1e-11)
    assert moved.distance() == pytest.approx(0.4 + 3e-6)


def test_planes_of_a_unit3_keep_their_offset():
    """OrientedPlane3 of four numbers would normalise the normal but not the offset."""
    assert gtsam.OrientedPlane3(2.0, 0.0, 0.0, 3.0).distance() == 3.0
    plane = gtsam.OrientedPlane3(gtsam.Unit3(np.array([2.0, 0.0, 0.0])), 1.5)
    assert plane.planeCoefficients().tolist() == [1.0, 0.0, 0.0, 1.5]


def test_joint_marginals_follow_the_order_asked():
    graph = gtsam.NonlinearFactorGraph()
    for key, sigma in ((KEY, 1.0), (OTHER, 2.0)):
        noise = gtsam.noiseModel.Isotropic.Sigma(3, sigma)
        graph.addPriorPoint3(key, np.zeros(3), noise)
    values = one_value()
    values.insert(OTHER, np.zeros(3))
    marginals = gtsam.Marginals(graph.linearize(values), values)
    joint = marginals.jointMarginalCovariance([OTHER, KEY]).fullMatrix()
    assert np.allclose(np.diagonal(joint), [4.0] * 3 + [1.0] * 3)
