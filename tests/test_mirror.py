"""The mirror image: when the motion alone rules it out, no search may find one that fits."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from handlaser_gtsam.errors import InputError
from handlaser_gtsam.observability import other_solutions as mirror
from handlaser_gtsam.solvers.beam_problem import refine
from handlaser_gtsam.validation.scenes import Layout, arm, paper, unplanned
from handlaser_gtsam.validation.simulate import Errors, simulate

PARTS = (0.0, 1e-3, 1e-2, 0.1, 0.3, 1.0)
"""Of the motion of a scene that is left: a hand that only turns, to one that moves freely."""


def solved(seed):
    """Return a solution of a random scene, its sum of squares, its readings and their sigma."""
    rng = np.random.default_rng(seed)
    layout = Layout(*(int(rng.integers(*span)) for span in ((1, 5), (1, 5), (8, 14))), 0.01, 0.1)
    truth, stations = (paper, unplanned, arm)[seed % 3](layout, rng)
    t, plane = stations.world_t_hand, stations.plane
    middle = np.array([t[plane == p].mean(axis=0) for p in range(layout.planes)])[plane]
    t = middle + PARTS[seed // 3 % len(PARTS)] * (t - middle)
    if seed % 2:  # turns about a point off the hand's origin
        t = t - stations.world_R_hand @ rng.normal(0.0, 0.02, 3)
    sigma = 10.0 ** rng.uniform(-5.0, -3.5)
    recording = simulate(truth, replace(stations, world_t_hand=t), Errors(sigma), rng)
    readings = recording.readings()
    origins = readings.plane_means(readings.world_t_hand)
    readings = readings.seen_from(origins)
    found = refine(truth.seen_from(origins), readings, 0, 30)
    return None if found is None else (found.parameters, found.criterion, readings, sigma)


def image_of(solution, readings):
    """Return beams and planes reflected through the mean hand position of each plane."""
    return mirror.reflected(solution, readings, np.eye(3), np.eye(3))


@pytest.mark.parametrize("kind", ["turns about the hand", "motion in a plane"])
def test_an_image_reads_what_its_beams_and_planes_read(kind):
    """Through the place of a hand that only turns; in the plane in which it moves."""
    rng = np.random.default_rng(3)
    truth, stations = arm(Layout(2, 3, 9), rng)
    R, t = stations.world_R_hand, stations.world_t_hand
    if kind == "turns about the hand":
        hand = world = np.eye(3)
        t = t[:1] + np.zeros_like(t)
    else:
        hand = world = np.diag([0.0, 0.0, 1.0])
        turns = np.zeros((len(t), 3))
        turns[:, 2] = rng.uniform(-0.3, 0.3, len(t))
        R, t = Rotation.from_rotvec(turns).as_matrix(), t * [1.0, 1.0, 0.0] + [0.0, 0.0, 0.4]
    n = truth.directions.mean(axis=0) + 0.2 * rng.normal(size=(3, 3))
    n /= np.linalg.norm(n, axis=1)[:, None]
    truth = replace(truth, normals=n, offsets=-(n * t.mean(axis=0)).sum(axis=1) - 0.3)
    stations = replace(stations, world_R_hand=R, world_t_hand=t)
    readings = simulate(truth, stations, Errors(0.0), rng).readings()
    image = mirror.reflected(truth, readings, hand, world)
    assert np.abs(image.directions - truth.directions).max() > 0.1
    for at in (truth, image):  # readings are of some decimetres
        assert mirror.squares_of(at, readings, None) < 1e-26 * len(readings)


def searched(solution, squares, readings, sigma):
    """Tell by a search from the image, in any case, whether it fits."""
    image = refine(image_of(solution, readings), readings, terms=0, iterations=20)
    if image is None:
        return False
    same = (image.parameters.directions * solution.directions).sum(axis=1) > 0.0
    return not same.any() and image.criterion - squares <= mirror.CHI2_MARGIN * sigma**2


@pytest.mark.slow
def test_no_image_that_fits_is_ruled_out_by_the_motion():
    fits = ruled = 0
    for seed in range(108):
        try:
            case = solved(seed)
        except InputError:  # a beam of the scene misses its plane everywhere
            continue
        if case is None:
            continue
        solution, squares, readings, sigma = case
        limit = squares + mirror.CHI2_MARGIN * sigma**2
        out = mirror.ruled_out(image_of(solution, readings), readings, limit)
        fit = searched(*case)
        assert not (out and fit), f"seed {seed}"
        fits, ruled = fits + fit, ruled + out
    # Half of the scenes hardly move; of those that do, most need no search.
    assert fits >= 20
    assert ruled >= 20


@pytest.mark.parametrize("seed", [16, 17])
def test_a_hand_that_moves_freely_needs_no_search(seed, monkeypatch):
    solution, squares, readings, sigma = solved(seed)

    def search(*_):
        raise AssertionError("the motion rules it out")

    monkeypatch.setattr(mirror, "refine", search)
    assert not mirror.mirror_image_fits(solution, readings, squares, sigma)
