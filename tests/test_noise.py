"""What may be said about noise, and what is refused."""

import numpy as np
import pytest

import handlaser_gtsam as hl

GOOD = np.diag([1e-6] * 3 + [1e-9] * 3)


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"range_sigma": 0.0}, "range_sigma 0 m"),
        ({"incidence_sigma": -1.0}, "incidence_sigma -1"),
        ({"pose_rotation_sigma": float("nan")}, "pose_rotation_sigma nan"),
        ({"pose_covariance": np.eye(5)}, r"shape \(5, 5\)"),
        ({"pose_covariance": -GOOD}, "the variance -1e-06"),
        ({"pose_covariance": GOOD + np.eye(6, k=1)}, "not symmetric"),
        ({"pose_covariance": GOOD + 2e-6 * ~np.eye(6, dtype=bool)}, "not positive semidefinite"),
        ({"pose_covariance": np.full((6, 6), np.nan)}, "not finite"),
        ({"pose_covariance": np.where(np.eye(6, k=1), 1e308, -1e308)}, "the entry 1e\\+308"),
        ({"pose_covariance": "thin"}, "no array of numbers"),
        ({"pose_covariance": 1e20 * np.eye(6)}, "at most 1e\\+12"),
        ({"range_sigma": "thin"}, "range_sigma 'thin'"),
        ({"range_sigma": True}, "range_sigma True"),
        ({"pose_translation_prior": 0.0}, "pose_translation_prior 0"),
        ({"incidence_sigma": None}, "incidence_sigma None"),
        ({"pose_translation_sigma": 10**400}, "pose_translation_sigma inf"),
        ({"pose_covariance": GOOD, "pose_rotation_sigma": 1e-3}, "one of the two"),
    ],
)
def test_noise_that_cannot_be_is_refused(fields, words):
    with pytest.raises(hl.InputError, match=words):
        hl.Noise(**fields)


def test_sigmas_and_covariance_say_the_same():
    sigmas = hl.Noise(1e-3, 2e-3, 3e-3)
    assert np.allclose(sigmas.pose_covariances(2)[1], np.diag([9e-6] * 3 + [4e-6] * 3))
    one = hl.Noise(1e-3, pose_covariance=GOOD)
    assert np.array_equal(one.pose_covariances(3), [GOOD] * 3)
    assert one.poses_uncertain
    assert not hl.Noise(1e-3, 0.0, 0.0).poses_uncertain
    assert not hl.Noise(1e-3, pose_covariance=np.zeros((6, 6))).poses_uncertain
    assert one == hl.Noise(1e-3, pose_covariance=GOOD.copy())
    assert one != hl.Noise(1e-3)
    many = hl.Noise(1e-3, pose_covariance=np.arange(1, 4)[:, None, None] * GOOD)
    order = np.array([2, 0, 1])
    assert np.allclose(many.reordered(order).pose_covariance[0], 3.0 * GOOD)
    assert one.reordered(order) is one
