"""The range to a sphere, and its continuation for rays that graze or miss it."""

import numpy as np
import pytest

from handlaser_gtsam.model.targets.sphere import GRAZING_PART, SPHERE, Sphere

RADIUS = 0.08


def hits(sphere, passed):
    """Where a ray along z meets the sphere that it passes at a distance from the centre."""
    origin = np.array([passed * 0.6, passed * 0.8, -1.0]).reshape(3, 1, 1, 1)
    ahead = np.array([0.0, 0.0, 1.0]).reshape(3, 1, 1, 1)
    return Sphere(np.array([0])).hit({SPHERE.name: sphere[None, None]}, origin, ahead)


@pytest.mark.parametrize("part", [0.0, 0.5, 0.99])
def test_the_range_of_a_ray_that_meets_it_is_exact(part):
    s = hits(np.array([0.0, 0.0, 0.1, RADIUS]), part * RADIUS).range.item()
    assert s == pytest.approx(1.1 - RADIUS * np.sqrt(1.0 - part**2), abs=1e-14)


def test_ranges_grow_as_rays_miss_it_farther_and_have_no_step():
    sphere = np.array([0.0, 0.0, 0.1, RADIUS])
    limit = RADIUS * np.sqrt(1.0 - GRAZING_PART**2)
    passed = np.sort(np.append(np.linspace(0.0, 3.0 * RADIUS, 100), [limit - 1e-9, limit + 1e-9]))
    s = np.array([hits(sphere, p).range.item() for p in passed])
    assert (np.diff(s) > 0.0).all()
    assert np.diff(s).min() < 3e-9 / GRAZING_PART


@pytest.mark.parametrize("part", [0.3, 0.9, 1.1, 4.0])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_derivatives_are_those_of_differences(part, sign):
    """A radius below zero is what a search may try: it counts as one above zero."""
    sphere = np.array([0.0, 0.0, 0.1, sign * RADIUS])
    met = hits(sphere, part * RADIUS)
    for i, step in enumerate(1e-7 * np.eye(4)):
        ends = [hits(sphere + way * step, part * RADIUS).range.item() for way in (1.0, -1.0)]
        slope = (ends[0] - ends[1]) / 2e-7
        assert met.columns[i].item() == pytest.approx(slope, rel=1e-6, abs=1e-6)
        if i < 3:
            assert met.covector[i].item() == pytest.approx(-slope, rel=1e-6, abs=1e-6)
