"""Single steps: against dense equations, and what they do to beams and planes."""

from copy import copy
from dataclasses import replace

import gtsam
import numpy as np
import pytest
from helpers import bench, motion, recording_of

import handlaser_gtsam as hl
from handlaser_gtsam import model
from handlaser_gtsam.model.beams_on_planes import CENTRE, values_of
from handlaser_gtsam.model.block import impossible
from handlaser_gtsam.model.families import BEAM, PLANE
from handlaser_gtsam.model.reduced_information import (
    MANY_MATRICES,
    inverse_stack,
    solve_definite,
)
from handlaser_gtsam.model.reduction import Normal, damped_step
from handlaser_gtsam.model.weighting import Variances, whitening
from handlaser_gtsam.solvers.beam_problem import beam_problem, jacobian_columns, moved
from handlaser_gtsam.solvers.gtsam_sums import eliminated_sums

DAMPED = {"planes first": (3, 3, False), "beams first": (1, 9, False), "coupled": (2, 9, True)}


@pytest.mark.parametrize("case", DAMPED)
@pytest.mark.parametrize("damping", [0.0, 1e-3, 10.0])
def test_a_damped_step_solves_the_dense_equations(case, damping):
    """(J'WJ + lambda diag(J'WJ)) x = -J'We, from the rows of the model, whichever side goes first."""
    planes, beams, coupled = DAMPED[case]
    truth, count = bench(planes, beams), 12 * planes
    labels = np.repeat(np.arange(planes), 12).tolist()
    readings = recording_of(truth, *motion("free", count), labels, 1e-4).readings()
    pose = np.tile(np.diag([1e-3] * 3 + [1e-4] * 3) ** 2, (count, 1, 1)) if coupled else None
    how = whitening(truth, readings, Variances(np.full(beams, 1e-4), 1e-5, pose))
    at = replace(truth, locations=truth.locations + 1e-3, offsets=truth.offsets + 1e-3)
    problem, block = beam_problem([readings], 1, [how])
    values = block.centred(values_of([at]))
    columns = jacobian_columns(at, readings, 1, values[PLANE.name][0, :, CENTRE])
    J = np.zeros((len(readings), 6 * beams + 3 * planes))
    for row, (i, p) in enumerate(zip(readings.beam, readings.plane, strict=True)):
        J[row, 6 * i : 6 * i + 6] = columns[:6, row]
        J[row, 6 * beams + 3 * p : 6 * beams + 3 * p + 3] = columns[6:9, row]
    white, e = how.apply_rows(J), how.apply(columns[-1])
    H = white.T @ white
    dense = np.linalg.solve(H + damping * np.diag(np.diagonal(H)), -white.T @ e)
    parts = [part.ravel() for part in damped_step(problem.normal(values), np.array([damping]))]
    beams_first = problem.reduction.local == BEAM.name
    assert beams_first == (case == "beams first")
    off = np.concatenate(parts[::-1] if beams_first else parts) - dense
    assert np.sqrt(off @ H @ off) < 1e-6 * np.sqrt(dense @ H @ dense)


def test_a_step_turns_a_plane_about_its_centre():
    """At the centre, the height of the plane changes by its own step."""
    rng = np.random.default_rng(0)
    at = bench(3, 2)
    centres, beam, plane = rng.normal(size=(3, 3)), rng.normal(size=(2, 6)), rng.normal(size=(3, 3))
    bases = model.tangent_basis(np.concatenate((at.directions, at.normals)))
    new = moved(at, beam, plane, centres)
    heights = [(one.normals * centres).sum(axis=1) + one.offsets for one in (at, new)]
    assert np.allclose(heights[1] - heights[0], plane[:, 2])
    turned = np.concatenate((new.directions, new.normals))
    along = np.einsum("nij,ni->nj", bases, turned)
    steps = np.concatenate((beam[:, 3:5], plane[:, :2]))
    assert np.allclose(along[:, 0] * steps[:, 1], along[:, 1] * steps[:, 0])
    assert np.allclose((turned**2).sum(axis=1), 1.0)
    assert (np.sum(along * steps, axis=1) > 0.0).all()
    assert np.allclose(new.locations - at.locations, beam[:, :3])
    assert np.allclose(new.range_errors, np.column_stack((beam[:, 5], np.zeros(2))))


@pytest.mark.parametrize("unit", [1.0, 1e-9, 1e9])
def test_a_singular_matrix_is_solved_along_what_it_tells(unit):
    """In any units, beside one that is definite and one that rounding made indefinite."""
    rng = np.random.default_rng(1)
    J, units = rng.normal(size=(8, 4)), np.array([1.0, unit, 1.0, 1.0 / unit])
    whole = J.T @ J
    J[:, 3] = J[:, :3].sum(axis=1)
    lost = J.T @ J
    bent = lost - 1e-9 * np.eye(4)
    A = np.array([whole, lost, bent]) * units[:, None] * units
    rhs = np.einsum("kij,j->ki", A, rng.normal(size=4) / units)
    found = solve_definite(A, rhs)
    assert np.allclose(np.einsum("kij,kj->ki", A, found) / units, rhs / units, rtol=1e-6)
    inverse = inverse_stack(A[:2]) * units[:, None] * units
    assert np.allclose(inverse[0] @ whole, np.eye(4))
    assert np.allclose(lost @ inverse[1] @ lost, lost)


@pytest.mark.parametrize("least", [1.0, 1e-3, 1e-5])
def test_many_small_matrices_have_the_inverses_of_each_alone(least):
    """In any units, whatever their inflation: cofactors are replaced where they are not sure."""
    rng = np.random.default_rng(2)
    Q = np.linalg.qr(rng.normal(size=(MANY_MATRICES, 3, 3)))[0]
    sizes = np.array([1.0, least, least]) ** rng.uniform(0.0, 1.0, (MANY_MATRICES, 1))
    units = np.array([1.0, 1e-6, 1e6])
    A = (Q * sizes[:, None, :]) @ np.swapaxes(Q, 1, 2) * units[:, None] * units
    A[5] = np.outer(units, units)  # of rank one
    alone = np.concatenate([inverse_stack(one[None]) for one in A])
    scale = np.sqrt(np.einsum("kii->ki", alone))
    off = np.abs(inverse_stack(A) - alone) / scale[:, :, None] / scale[:, None]
    assert off.max() < 1e-9


@pytest.mark.parametrize("count", [1, MANY_MATRICES])
def test_a_plane_of_which_no_reading_counts_stays(count):
    """What damping adds to nothing is no information."""
    empty = 1e-311 * np.eye(3)
    full = np.diag([4.0, 1.0, 2.0])
    found = inverse_stack(np.array([[empty, full]] * count))
    assert (found[0, 0] == 0.0).all()
    assert np.allclose(found[0, 1], np.diag([0.25, 1.0, 0.5]))


@pytest.mark.parametrize(("planes", "beams"), [(1, 3), (7, 3), (7, 0)])
def test_gtsam_eliminates_sums_of_a_few_members_at_once(monkeypatch, planes, beams):
    """Step and covariance are those of the dense equations; some keys have idle members."""
    rng, n, d = np.random.default_rng(0), 5 * beams, 3
    J = rng.normal(size=(40 * planes, n + d * planes))
    for p in range(planes):
        others = np.delete(np.arange(planes), p)
        J[40 * p : 40 * (p + 1), n:].reshape(40, planes, d)[:, others] = 0.0
    J, e = J * 10.0 ** rng.uniform(-3, 3, J.shape[1]), rng.normal(size=len(J))
    H, g = J.T @ J, J.T @ e
    members = np.arange(planes)
    local = H[n:, n:].reshape(planes, d, planes, d)[members, :, members]
    border = H[n:, :n].reshape(planes, d, n)
    own = g[n:].reshape(planes, d)
    normal = Normal(*(x[None] for x in (H[:n, :n], g[:n], local, border, own, e @ e)))
    factors, make = [], gtsam.HessianFactor
    monkeypatch.setattr(gtsam, "HessianFactor", lambda *of: factors.append(1) or make(*of))
    found = eliminated_sums(normal, 0.5)
    assert len(factors) == (beams > 0) + int(np.ceil(planes / max(np.floor(np.sqrt(n)), 1)))
    dense = np.linalg.solve(H, -g)
    step = np.concatenate((found.step, found.local_step.ravel()))
    assert np.sqrt((step - dense) @ H @ (step - dense)) < 1e-9 * np.sqrt(dense @ H @ dense)
    known, response = found.local_members()
    follow = np.vstack((np.eye(n), -response.reshape(planes * d, n)))
    whole = follow @ found.covariance() @ follow.T
    for p in range(planes):
        whole[n + d * p : n + d * (p + 1), n + d * p : n + d * (p + 1)] += known[p]
    scale = np.sqrt(np.diagonal(whole))
    assert np.allclose(
        whole / scale / scale[:, None], 0.25 * np.linalg.inv(H) / scale / scale[:, None], atol=1e-9
    )


@pytest.mark.parametrize("place", ["matrix", "local"])
def test_information_that_is_below_zero_by_rounding_is_singular(place):
    """In units of a negative information GTSAM's sums overflow."""
    H, g, local = 1e16 * np.eye(3)[None], np.zeros((1, 3)), 1e16 * np.eye(3)[None, None]
    parts = {"matrix": H, "local": local}
    parts[place][..., 1, 1] = -1e-2
    normal = Normal(H, g, local, np.zeros((1, 1, 3, 3)), g[None], np.zeros(1))
    with pytest.raises(np.linalg.LinAlgError, match="rounding"):
        eliminated_sums(normal, 1.0)


def test_patterns_that_tile_what_stays_are_added_at_once():
    """As one after the other: the normal equations are the same."""
    truth = bench(3, 2)
    readings = recording_of(truth, *motion("free", 36), [0, 1, 2] * 12, 1e-4).readings()
    problem, block = beam_problem([readings] * 2, 1, 1e-4)
    reduction = problem.reduction
    rows = [block.evaluate(block.begun([truth, truth])).columns]
    assert all(plan.tiled for plan in reduction.plans)
    at_once = reduction.normal(problem.blocks, rows)
    each = copy(reduction)
    each.plans = [copy(plan) for plan in reduction.plans]
    for plan in each.plans:
        plan.tiled = False
    in_turn = each.normal(problem.blocks, rows)
    for one, other in zip(at_once.arrays(), in_turn.arrays(), strict=True):
        assert np.array_equal(one, other)


def test_no_search_ends_where_rounding_makes_a_beam_graze():
    """Of eight stations with wrong labels, one ended at a cosine of 0.00099999999999997."""
    n, across = np.array([[0.0, 0.0, 1.0]]), np.array([[1.0, 0.0, 0.0]])
    truth = bench(1, 1)
    for part, expected in ((1.0 + 1e-13, True), (1.001, False)):
        cosine = model.GRAZING_LIMIT * part
        v = cosine * n + np.sqrt(1.0 - cosine**2) * across
        at = replace(truth, directions=v, normals=n)
        still = [np.eye(3)] * 4, np.zeros((4, 3))
        ranges = np.full((4, 1), 0.1)
        readings = hl.Recording(*still, ranges, ("A",) * 4, ("1",)).readings()
        _, block = beam_problem([readings], 0, 1e-4)
        assert impossible(block.evaluate(block.begun([at])), block).all() == expected
