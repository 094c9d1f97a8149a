"""The measurement equation against geometry and against differences."""

from dataclasses import replace

import numpy as np
import pytest
from helpers import simulated
from hypothesis import given
from hypothesis import strategies as st

from handlaser_gtsam import model
from handlaser_gtsam.errors import GrazingBeamError
from handlaser_gtsam.validation.simulate import read_back


@pytest.fixture
def case():
    recording, truth = simulated("arm", range_sigma=0.0)
    readings = recording.readings()
    return model.scene(truth, readings), readings.distance


def test_the_spot_lies_on_the_plane(case):
    x, _ = case
    s = model.predicted_ranges(x)
    spot = np.einsum("nij,nj->ni", x.R, x.r + s[:, None] * x.v) + x.t
    # Metre-sized numbers of 16 digits, a few operations.
    assert np.abs((spot * x.n).sum(axis=1) + x.b).max() < 1e-14


def test_a_beam_straight_at_a_plane_reads_the_distance():
    one = np.ones(1)
    x = model.Scene(
        np.eye(3)[None],
        np.zeros((1, 3)),
        np.zeros((1, 3)),
        np.array([[0.0, 0.0, 1.0]]),
        np.array([[0.0, 0.0, 1.0]]),
        -0.2 * one,
        np.array([[0.01, 0.5]]),
    )
    assert model.predicted_ranges(x) == pytest.approx(0.2)
    # g(0.1) = 0.1 + 0.001 + 0.005
    assert model.residuals(x, 0.1 * one) == pytest.approx(0.2 - 0.106)


@pytest.mark.parametrize("name", ["r", "v", "n", "b", "k"])
def test_derivatives_match_differences(case, name):
    x, d = case
    at = model.linearize(x, d)
    exact = {
        "r": at.location,
        "v": at.direction,
        "n": at.normal,
        "b": at.offset[:, None],
        "k": at.range_error,
    }[name]
    value, step = getattr(x, name), 1e-6
    for column in range(exact.shape[1]):
        delta = np.zeros_like(value)
        delta[..., column] = step
        if name == "b":
            delta = np.full_like(value, step)
        up = model.residuals(replace(x, **{name: value + delta}), d)
        down = model.residuals(replace(x, **{name: value - delta}), d)
        # Central differences: error step**2 times the third derivative, here up to about 10.
        assert np.abs((up - down) / (2 * step) - exact[:, column]).max() < 1e-9


def test_ambient_derivatives_hold_for_vectors_off_the_sphere_too(case):
    """de/dv and de/dn are the tangent parts; along the vector itself the range scales as 1/length."""
    x, d = case
    at = model.linearize(x, d)
    s = model.predicted_ranges(x)
    assert np.allclose((at.direction * x.v).sum(axis=1), -s, rtol=1e-12)


def test_pose_derivative_only_where_asked(case):
    x, d = case
    assert model.linearize(x, d).pose.shape == (0, 6)
    assert model.linearize(x, d, with_pose=True).pose.shape == (len(d), 6)


def test_grazing_beam_is_refused_with_its_cosine(case):
    x, d = case
    across = np.cross(x.n, x.v + 0.1)
    v = np.einsum("nji,nj->ni", x.R, model.normalized(across))
    with pytest.raises(GrazingBeamError, match="parallel to the plane") as caught:
        model.residuals(replace(x, v=v), d)
    assert abs(caught.value.cosine) < 1e-9


def test_nan_is_refused_as_grazing(case):
    x, d = case
    with pytest.raises(GrazingBeamError):
        model.residuals(replace(x, v=np.full_like(x.v, np.nan)), d)


@given(st.tuples(*[st.floats(-1.0, 1.0)] * 3).filter(lambda v: np.linalg.norm(v) > 1e-3))
def test_tangent_basis_is_orthonormal_and_right_handed(vector):
    unit = model.normalized(np.array([vector]))
    basis = model.tangent_basis(unit)[0]
    frame = np.column_stack((basis, unit[0]))
    assert np.abs(frame.T @ frame - np.eye(3)).max() < 1e-12
    assert np.linalg.det(frame) == pytest.approx(1.0)


@given(st.floats(0.001, 10.0), st.floats(-0.05, 0.05), st.floats(-0.02, 0.02))
def test_reading_back_inverts_the_correction(s, k1, k2):
    k = np.array([[k1, k2]])
    d = read_back(np.array([s]), k)
    assert model.corrected(d, k) == pytest.approx(s, rel=1e-12)
