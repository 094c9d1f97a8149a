"""Unknown scales: against dense matrices, against integration on a fine grid, and against the truth."""

import math
from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from helpers import simulated
from scipy import linalg

import handlaser_gtsam as hl
from benchmarks.noise_components import NAMES, run_once
from handlaser_gtsam import model
from handlaser_gtsam.estimation import learning_scales as learned
from handlaser_gtsam.estimation.learning_scales import LinearReadings, ScaleProblem
from handlaser_gtsam.estimation.scale_mixture import (
    GRID_POINTS,
    SCALE_SPAN,
    BeamPosterior,
    RangeErrorGrid,
    information_of,
    near_largest,
    parts_of,
    refined_grid,
    widest_grids,
    worst_known,
)
from handlaser_gtsam.estimation.scales import RANGE as RANGES
from handlaser_gtsam.estimation.scales import ROTATION as ROTATIONS
from handlaser_gtsam.estimation.scales import TRANSLATION as TRANSLATIONS
from handlaser_gtsam.estimation.scales import Scale, Scales
from handlaser_gtsam.estimation.solution import posterior
from handlaser_gtsam.model.weighting import Variances
from handlaser_gtsam.validation.scenes import SCENES, Layout
from handlaser_gtsam.validation.simulate import Errors, simulate

RANGE, TRANSLATION, ROTATION = 3e-5, 5e-5, math.radians(0.03)
ARM = (1e-4, 1e-4, math.radians(0.03))
PRIOR = (1e-4, math.radians(0.02))
"""Scales of the half-Cauchy priors of translations [m] and rotations [rad]."""
FLOOR = 1e-5
"""Where the flat prior of a range sigma ends [m]."""


def robot(layout, errors=(RANGE, TRANSLATION, ROTATION), seed=4, scene="paper"):
    rng = np.random.default_rng(seed)
    truth, stations = SCENES[scene](layout, rng)
    recording = simulate(truth, stations, Errors(*errors), rng)
    readings = recording.readings()
    origins = readings.plane_means(readings.world_t_hand)
    return recording, readings.seen_from(origins), truth.seen_from(origins)


# The textbook, on N x N matrices


class Dense:
    """Readings linearised at parameters, in the units of the package: [m] over the typical range.

    With X the Jacobian of all unknowns, C the covariance of the readings and inv(L) that of the
    pseudo-observations of k, the unknowns x of the linear model e + X x = noise have the posterior of
    M = X' inv(C) X + L, and the scales the restricted likelihood, up to a constant,

        -(log|C| + log|M| - log|L| + e' inv(C) e + k' L k - h' inv(M) h) / 2,

    h = -X' inv(C) e - L k.
    """

    def __init__(self, at, readings, terms):
        lin = model.linearize(model.scene(at, readings), readings.distance, with_pose=True)
        self.length = float(np.median(readings.distance))
        v, n = model.tangent_basis(at.directions), model.tangent_basis(at.normals)
        self.width = width = 5 + terms
        self.beams = readings.beams
        self.size = readings.beams * width
        self.X = np.zeros((len(readings), self.size + 3 * readings.planes))
        k_unit = np.array([1.0, 1.0 / self.length])[:terms]
        for row, (i, p) in enumerate(zip(readings.beam, readings.plane, strict=True)):
            own = (lin.location[row] * self.length, lin.direction[row] @ v[i])
            self.X[row, width * i : width * (i + 1)] = np.concatenate(
                (*own, lin.range_error[row, :terms] * k_unit)
            )
            first = self.size + 3 * p
            self.X[row, first : first + 2] = lin.normal[row] @ n[p]
            self.X[row, first + 2] = lin.offset[row] * self.length
        self.e, self.J, self.beam = lin.residual, lin.pose, readings.beam
        k1, k2 = at.range_errors[readings.beam].T
        self.slope = 1.0 + k1 + 2.0 * k2 * readings.distance
        cosine = np.abs(model.cosines(model.scene(at, readings)))
        self.tangent = np.tan(np.arccos(cosine))
        self.same = readings.station[:, None] == readings.station
        self.k = (at.range_errors[:, :terms] / k_unit).ravel() if terms else np.zeros(0)
        self.at_k = np.flatnonzero(np.arange(self.size) % width >= 5)

    def covariance(self, ranges, pose, incidence=0.0):
        """Return C for range sigmas (B,) and pose sigmas (6,)."""
        own = (self.slope * ranges[self.beam]) ** 2 + (incidence * self.tangent) ** 2
        return np.diag(own) + np.where(self.same, (self.J * pose**2) @ self.J.T, 0.0)

    def information(self, C):
        """Return X' inv(C) X, -X' inv(C) e and log|C| + e' inv(C) e."""
        W = np.linalg.inv(C)
        value = np.linalg.slogdet(C)[1] + self.e @ W @ self.e
        return self.X.T @ W @ self.X, -self.X.T @ W @ self.e, value

    def posterior(self, C, prior=None):
        """Return log evidence, mean and covariance of the beams; `prior` (K, K) of the range errors."""
        return self.with_prior(*self.information(C), prior)

    def with_prior(self, M, h, value, prior=None):
        """Return the same from what `information` returned."""
        if prior is not None:
            M, h = M.copy(), h.copy()
            precision = np.linalg.inv(prior)
            M[np.ix_(self.at_k, self.at_k)] += precision
            h[self.at_k] -= precision @ self.k
            value += self.k @ precision @ self.k + np.linalg.slogdet(prior)[1]
        S = np.linalg.inv(M)
        value += np.linalg.slogdet(M)[1] - h @ S @ h
        return -0.5 * value, (S @ h)[: self.size], S[: self.size, : self.size]

    def reduced(self, C):
        """Return the information of the beams, planes eliminated: matrix, vector, constant."""
        W = np.linalg.inv(C)
        B, P = self.X[:, : self.size], self.X[:, self.size :]
        H = P.T @ W @ P
        left = W - W @ P @ np.linalg.inv(H) @ P.T @ W
        constant = self.e @ left @ self.e + np.linalg.slogdet(C)[1] + np.linalg.slogdet(H)[1]
        return B.T @ left @ B, -B.T @ left @ self.e, -0.5 * constant


def half_cauchy(scale, u):
    """Return the logarithm of the density of log sigma, up to a constant."""
    return u - math.log(1.0 + math.exp(2.0 * u) / scale**2)


def unknown(*names):
    """Return unknown scales by name; those of a robot that are not named are zero."""
    priors = {RANGES: FLOOR, TRANSLATIONS: PRIOR[0], ROTATIONS: PRIOR[1]}
    return Scales(
        tuple(Scale(name, None, 1.0, priors[name]) for name in names),
        np.full(2, RANGE),
        np.zeros(6),
    )


def base_of(readings):
    stations = int(readings.station.max()) + 1
    return Variances(
        np.full(readings.beams, RANGE), 0.0, np.broadcast_to(np.eye(6), (stations, 6, 6))
    )


@pytest.mark.parametrize("terms", [0, 2])
@pytest.mark.parametrize("incidence", [0.0, 2e-5])
@pytest.mark.parametrize("by_beam", [False, True])
@pytest.mark.parametrize("alone", [False, True])
def test_the_information_is_that_of_dense_matrices(terms, incidence, by_beam, alone):
    """Of stations with all beams, and of those with a reading of one beam each."""
    _, readings, truth = robot(Layout(3, 2, 30 if alone else 9))
    if alone:
        readings = readings.subset(np.flatnonzero(readings.station % 3 == readings.beam))
    truth = replace(truth, range_errors=np.full((3, 2), [0.02, 0.5])) if terms else truth
    dense = Dense(truth, readings, terms)
    base = replace(base_of(readings), incidence_sigma=incidence)
    rows = LinearReadings(truth, readings, terms, dense.length, base)
    ranges = RANGE * (np.array([1.0, 2.0, 0.5]) if by_beam else np.ones(3))
    pose = np.array([ROTATION, 0.5 * ROTATION, 2.0 * ROTATION, 1e-5, TRANSLATION, 1e-4])
    sets = [(ranges, pose), (1.7 * ranges, 0.3 * pose), (0.6 * ranges, np.zeros(6))]
    found, _ = rows.information(*(np.array(scales) for scales in zip(*sets, strict=True)))
    A, b, c = parts_of(found)
    expected = [dense.reduced(dense.covariance(*one, incidence)) for one in sets]
    for j, (matrix, vector, constant) in enumerate(expected):
        scale = np.sqrt(np.diag(matrix))
        assert np.abs((A[j] - matrix) / np.outer(scale, scale)).max() < 1e-9
        assert np.abs((b[j] - vector) / scale).max() < 1e-6
        # Constants that are the same for all sets do not matter.
        assert c[j] - c[0] == pytest.approx(constant - expected[0][2], abs=1e-5)


def test_the_mode_is_that_of_the_textbook():
    """The derivative of the restricted likelihood and the prior vanishes there."""
    _, readings, truth = robot(Layout(2, 4, 10), ARM, scene="arm")
    names = (RANGES, TRANSLATIONS, ROTATIONS)
    problem = ScaleProblem(truth, readings, 0, base_of(readings), unknown(*names), None)
    mode = problem.mode(np.log([1e-4, 5e-5, 2e-4]))
    dense = Dense(truth, readings, 0)

    def objective(u):
        sigma = np.exp(u)
        pose = np.repeat(sigma[[2, 1]], 3)
        value = dense.posterior(dense.covariance(np.full(2, sigma[0]), pose))[0]
        value += half_cauchy(PRIOR[0], u[1]) + half_cauchy(PRIOR[1], u[2])
        return value - math.log(1.0 + FLOOR / sigma[0])

    step = 0.05 * np.eye(3)
    ahead, behind = ([objective(mode + sign * one) for one in step] for sign in (1.0, -1.0))
    slope = (np.array(ahead) - behind) / 0.1
    curvature = (2.0 * objective(mode) - ahead - behind) / 0.05**2
    assert (curvature > 0.1).all()
    # In standard deviations of the scales; the search itself takes differences over 0.02.
    assert (np.abs(slope) / np.sqrt(curvature) < 0.02).all()


def averaged(points, evidence):
    """Return mean and covariance of a mixture: `evidence` returns log weight, mean, covariance."""
    found = [evidence(*one) for one in points]
    w = np.array([one[0] for one in found])
    w = np.exp(w - w.max())
    w /= w.sum()
    means = np.array([one[1] for one in found])
    mean = w @ means
    within = np.einsum("j,jab->ab", w, np.array([one[2] for one in found]))
    return w, mean, within + (w[:, None] * (means - mean)).T @ (means - mean)


@pytest.mark.slow
def test_noise_scales_are_integrated_over():
    """Against a grid of 15 x 17 x 17 over six standard deviations and seven powers of e."""
    _, readings, truth = robot(Layout(2, 3, 7), ARM, scene="arm")
    names = (RANGES, TRANSLATIONS, ROTATIONS)
    problem = ScaleProblem(truth, readings, 0, base_of(readings), unknown(*names), None)
    learned = problem.learned(mode := problem.mode(np.log([1e-4, 5e-5, 2e-4])))
    found = posterior(problem, learned)
    dense = Dense(truth, readings, 0)
    sides = (
        mode[0] + np.linspace(-1.5, 1.5, 15),
        np.log(PRIOR[0]) + np.linspace(-5.0, 3.0, 17),
        np.log(PRIOR[1]) + np.linspace(-5.0, 3.0, 17),
    )

    def evidence(a, b, c):
        ranges, pose = np.full(2, math.exp(a)), np.exp(np.repeat([c, b], 3))
        value, mean, S = dense.posterior(dense.covariance(ranges, pose))
        value += half_cauchy(PRIOR[0], b) + half_cauchy(PRIOR[1], c)
        return value - math.log(1.0 + FLOOR / math.exp(a)), mean, S

    w, _, S = averaged(points := list(product(*sides)), evidence)
    unit = np.tile([dense.length] * 3 + [1.0] * 2, 2)
    # Some dozen points about the mode stand for the whole posterior.
    ratio = np.sqrt(np.diag(found.joint.beams)) / (unit * np.sqrt(np.diag(S)))
    assert (np.abs(ratio - 1.0) < 0.05).all()
    sigma = np.exp(np.array(points))
    for column, one in enumerate(found.scales):
        spread = math.sqrt(w @ sigma[:, column] ** 2 - (w @ sigma[:, column]) ** 2)
        u = np.log(sigma[:, column])
        # The design does not reach into the long tail of small sigmas, which change nothing.
        width = math.sqrt(w @ (u - w @ u) ** 2)
        assert abs(math.log(one.sigma) - w @ u) < 0.4 * width
        assert one.error == pytest.approx(spread, rel=0.25)


def shared_prior(*logarithms, linearity=0.01):
    """Return the log density of the logarithms of s1, s2 and S.

    The last is half-Cauchy about the linearity, the others F(2, 2) in their squares about the square of
    a scale that is half-Cauchy about the linearity.
    """
    t = np.exp(np.linspace(-16.0, 16.0, 1601))  # over the linearity
    density = 2.0 / math.pi * t / (1.0 + t**2)
    for one in logarithms[:-1]:
        F = (math.exp(one) / linearity / t) ** 2
        density = density * 2.0 * F / (1.0 + F) ** 2  # the density of F(2, 2) is (1 + F)^-2
    alone = math.exp(logarithms[-1]) / linearity
    return math.log(density.sum() * 0.02 * 2.0 / math.pi * alone / (1.0 + alone**2))


def prior_on_turned_axes(worst, best, alone, linearity=0.01):
    """Return the log density of the logarithms of the scales of what is known worst and best, and of S.

    The last two are half-Cauchy about the linearity; the first shrinks by Beta(1/2, 1) about the root
    mean square of the linearity and of the second.
    """
    square = 0.5 * (linearity**2 + math.exp(2.0 * best))
    total = square + math.exp(2.0 * worst)
    shrunk, rest = square / total, math.exp(2.0 * worst) / total
    # The density of Beta(1/2, 1) is 1 / (2 sqrt(x)).
    value = math.log(math.sqrt(shrunk) * rest)
    for one in (best, alone):
        value += (
            math.log(2.0 / math.pi / linearity / (1.0 + (math.exp(one) / linearity) ** 2)) + one
        )
    return value


@pytest.mark.parametrize("linearity", [0.001, 0.01])
def test_the_prior_of_the_scales_is_what_it_is_said_to_be(linearity):
    widest = max(SCALE_SPAN, math.log(0.9 / linearity))
    cell = 3.0 * math.log((widest + SCALE_SPAN) / (GRID_POINTS - 1))
    angles = np.array([0.3, 0.2, 0.3, 0.4])
    grids = widest_grids(linearity, 2, 4, angles)
    for grid, density in zip(grids, (shared_prior, prior_on_turned_axes), strict=True):
        rows = zip(grid.individual, grid.common, grid.log_prior, strict=True)
        for own, common, value in list(rows)[::7]:
            expected = density(*np.log([*own, common]), linearity=linearity) + cell
            assert value == pytest.approx(expected, abs=1e-9)
        assert grid.common.max() == pytest.approx(max(90.0 * linearity, 0.9), rel=1e-3)
    assert [grid.turned for grid in grids] == [False, True]
    assert np.array_equal(grids[1].angles, angles)
    assert len(widest_grids(linearity, 2, 4, None)) == 1


def axes(angles):
    """Return the matrix (K, K) from range errors, beam after beam, to what they are on turned axes."""
    turns = [[[math.cos(x), math.sin(x)], [-math.sin(x), math.cos(x)]] for x in angles]
    return linalg.block_diag(*turns)


def prior_covariance(own, common, angles=(0.0, 0.0)):
    """Return the covariance (K, K), beam after beam, of range errors with a mean that all share."""
    beams = len(angles)
    alike = np.kron(np.ones((beams, beams)), common**2 * np.eye(2))
    return axes(angles).T @ (np.kron(np.eye(beams), np.diag(np.square(own))) + alike) @ axes(angles)


def known_worst(covariance):
    """Return the angles of what k1 and k2 D are known worst by, from a covariance (K, K) of theirs."""
    angles = np.linspace(0.0, math.pi, 20001)
    along = np.stack((np.cos(angles), np.sin(angles)))
    each = [covariance[i : i + 2, i : i + 2] for i in range(0, len(covariance), 2)]
    return [float(angles[np.einsum("an,ab,bn->n", along, V, along).argmax()]) for V in each]


def test_the_spread_of_a_beam_is_that_of_the_prior_in_the_mean_of_all():
    own, common, angles = np.array([0.02, 0.005]), 0.01, np.array([0.6, 0.9])
    grid = RangeErrorGrid(own[None], np.array([common]), np.zeros(1), angles)
    covariance = prior_covariance(own, common, angles)
    variance, basis = np.diag(covariance), grid.contrasts()
    assert np.allclose(basis @ covariance @ basis.T, np.diag(grid.spread()[0] ** 2), atol=1e-15)
    assert np.allclose(grid.total()[0] ** 2, 0.5 * (variance[:2] + variance[2:]), rtol=1e-12)


def test_axes_are_those_of_what_readings_know():
    """Of a beam that they hardly see they know nothing; it takes the mean of the others."""

    def long(angle, across=1e-4):
        axis = np.array([math.cos(angle), math.sin(angle)])
        return np.outer(axis, axis) + across * np.eye(2)

    def found(*each):
        return worst_known(np.array(each))

    unknown = 100.0 * np.eye(2)
    assert found(long(0.4), unknown, long(0.6)) == pytest.approx([0.4, 0.5, 0.6])
    # An axis has no sign: those to both sides of one point the same way.
    near = found(long(-0.1), long(0.1), long(math.pi))
    assert np.abs(near - near[2]).max() == pytest.approx(0.1)
    assert np.tan(near) == pytest.approx(np.tan([-0.1, 0.1, 0.0]), abs=1e-9)
    assert found(long(0.4, 0.0)) == pytest.approx([0.4])  # what readings tell without any doubt
    assert found(long(0.4, -1e-20)) == pytest.approx([0.4])  # and with rounding
    assert found(np.eye(2), unknown) is None
    assert found(np.eye(1)) is None


@pytest.mark.slow
@pytest.mark.parametrize("k", [(0.0, 0.0), (0.03, 0.1)])
def test_scales_of_range_errors_are_integrated_over(k):
    """Against a finer grid over all three, within the same bounds: these belong to the prior."""
    _, readings, truth = robot(Layout(2, 3, 8), (1e-4, 0.0, 0.0), scene="arm")
    errors = np.array([k, [-0.5 * x for x in k]])
    truth = replace(truth, range_errors=errors)
    longer = np.einsum("nk,nk->n", errors[readings.beam], model_powers(readings.distance))
    readings = replace(readings, distance=readings.distance - longer)
    scales = Scales((), np.full(2, 1e-4), np.zeros(6))
    problem = ScaleProblem(truth, readings, 2, Variances(np.full(2, 1e-4)), scales, 0.01)
    learned = problem.learned(problem.mode(np.zeros(0)))
    beams, _ = problem.beams(learned.points)
    found_mean, covariance, _ = beams.integrated(learned.grids, learned.log_weight)
    dense = Dense(truth, readings, 2)
    C = dense.covariance(np.full(2, 1e-4), np.zeros(6))
    known = dense.information(C)  # only the prior differs from point to point
    side = np.log(0.01) + np.linspace(-SCALE_SPAN, SCALE_SPAN, 13)
    alone = dense.posterior(C, 3.0 * 0.9**2 * np.eye(4))[2]
    angles = known_worst(alone[np.ix_(dense.at_k, dense.at_k)])
    assert np.tan(learned.grids[-1].angles) == pytest.approx(np.tan(angles), abs=1e-3)

    def evidence(angles, a, b, c):
        prior = prior_covariance(np.exp([a, b]), math.exp(c), angles)
        value, mean, S = dense.with_prior(*known, prior)
        if any(angles):
            value += prior_on_turned_axes(a, b, c) + math.log(0.5)
        else:
            value += shared_prior(a, b, c) + math.log(0.5)
        return value, mean, S

    points = list(product(((0.0, 0.0), tuple(angles)), side, side, side))
    w, mean, S = averaged(points, evidence)
    sigma = np.sqrt(np.diag(S))
    # Half as many scales an axis stand for the posterior.
    assert (np.abs(found_mean - mean) < 0.05 * sigma).all()
    assert np.allclose(np.sqrt(np.diag(covariance)), sigma, rtol=0.1)
    scale = problem.range_error_scales(learned.mode)
    total = [np.diag(prior_covariance(np.exp([a, b]), math.exp(c), x)) for x, a, b, c in points]
    total = np.mean(np.reshape(total, (len(points), 2, 2)), axis=1)  # over the beams
    assert np.allclose(np.log(scale), w @ np.log(np.sqrt(total)), atol=0.25)


def model_powers(d):
    """Return (N, 2): d and its square, of which k1 and k2 are the coefficients."""
    return np.column_stack((d, d**2))


# What comes out of it


@pytest.mark.slow
@pytest.mark.parametrize(
    ("scene", "spread"), [("arm", (0.03, 0.07, 0.07)), ("paper", (0.04, 0.05, 0.4))]
)
def test_sigmas_are_estimated_from_thirteen_planes(scene, spread):
    """A small run of benchmarks.noise_components, which found these spreads of single runs."""
    ratio, said = run_once(0, scene)[:3], run_once(0, scene)[3:]
    assert len(ratio) == len(NAMES)
    assert (np.abs(ratio - 1.0) < 3.0 * np.array(spread)).all()
    # What is said of the errors is of the size of the spread.
    assert (said < 3.0 * np.array(spread)).all()


def test_a_perfect_robot_gets_small_sigmas_and_says_how_sure_it_is():
    recording, _, _ = robot(Layout(4, 6, 15), (RANGE, 0.0, 0.0))
    found = hl.calibrate(recording, options=hl.CalibrationOptions("none"))
    by_name = {one.name: one for one in found.noise_estimate}
    assert by_name["range"].sigma == pytest.approx(RANGE, rel=0.2)
    assert by_name["pose translation"].sigma < 0.5 * RANGE
    assert 0.0 < by_name["range"].error < 0.2 * RANGE
    # Beside errors of the robot, which may be there and change with the pose, little is known worse.
    exact = hl.calibrate(recording, options=hl.CalibrationOptions("none", poses="exact"))
    for name, beam in found.beams.items():
        assert (beam.location_sigma < 1.5 * exact.beams[name].location_sigma).all()


def test_each_beam_may_have_its_own_sigma():
    recording, _, _ = robot(Layout(3, 5, 14), (RANGE, 0.0, 0.0))
    rng = np.random.default_rng(5)
    extra = np.array([0.0, 3.0, 6.0]) * RANGE
    noisy = recording.ranges + extra * rng.standard_normal(recording.ranges.shape)
    options = hl.CalibrationOptions("none", poses="exact", range_sigma_by_beam=True)
    found = hl.calibrate(replace(recording, ranges=noisy), options=options)
    assert [one.name for one in found.noise_estimate] == [f"range of beam {i}" for i in "123"]
    sigma = np.array([one.sigma for one in found.noise_estimate])
    # Seventy readings a beam tell a sigma to 9 %.
    assert np.allclose(sigma, np.hypot(RANGE, extra), rtol=0.3)
    assert found.beams["3"].location_sigma.max() > found.beams["1"].location_sigma.max()


def test_an_unknown_range_sigma_is_estimated_beside_known_poses():
    recording, _, _ = robot(Layout(4, 6, 15))
    noise = hl.Noise(None, TRANSLATION, ROTATION)
    found = hl.calibrate(recording, noise, hl.CalibrationOptions("none"))
    assert found.fit.poses == "marginalised"
    assert not found.fit.range_sigma_given
    assert found.fit.range_sigma == pytest.approx(RANGE, rel=0.2)
    assert [one.name for one in found.noise_estimate] == ["range"]
    # Its most probable value is within a standard deviation, 4 %, of that of the residuals.
    assert found.fit.sigma0 == pytest.approx(1.0, abs=0.05)


@pytest.mark.slow
def test_scales_that_many_beams_tell_well_are_not_integrated_over(monkeypatch):
    """What is stated is nearly the same."""
    rng = np.random.default_rng(5)
    truth, stations = SCENES["paper"](Layout(12, 4, 16), rng)
    recording = simulate(truth, stations, Errors(RANGE, TRANSLATION, 2.0 * ROTATION), rng)
    few = hl.calibrate(recording)
    monkeypatch.setattr(learned, "INTEGRATED_BEAMS", 12)
    all_ = hl.calibrate(recording)
    assert (len(few.learned.points), len(all_.learned.points)) == (1, 27)
    for one, other in zip(few.noise_estimate, all_.noise_estimate, strict=True):
        assert one.sigma == pytest.approx(other.sigma, rel=0.02)
        assert one.error == pytest.approx(other.error, rel=0.3)
    for name, beam in few.beams.items():
        assert np.allclose(beam.sigma, all_.beams[name].sigma, rtol=0.03)
        off = np.abs(beam.location - all_.beams[name].location)
        assert (off < 0.05 * beam.sigma[:3]).all()


def test_what_is_given_is_not_estimated():
    recording, _, _ = robot(Layout(4, 6, 15))
    noise = hl.Noise(RANGE, TRANSLATION, None)
    found = hl.calibrate(recording, noise, hl.CalibrationOptions("none"))
    assert [one.name for one in found.noise_estimate] == ["pose rotation"]
    assert found.fit.range_sigma == pytest.approx(RANGE, rel=1e-9)
    options = hl.CalibrationOptions("none", estimate_noise=True)
    found = hl.calibrate(recording, noise, options)
    assert [one.name for one in found.noise_estimate] == list(NAMES)


def test_what_cannot_be_estimated_is_refused():
    recording, _, _ = robot(Layout(2, 2, 6), (RANGE, 0.0, 0.0))
    with pytest.raises(hl.InputError, match="12 readings of beam 1; expected 15"):
        hl.calibrate(recording, options=hl.CalibrationOptions("none", range_sigma_by_beam=True))
    options = hl.CalibrationOptions("none", poses="exact", estimate_noise=True)
    with pytest.raises(hl.InputError, match="estimate_noise with exact poses"):
        hl.calibrate(recording, options=options)


@pytest.mark.slow
def test_what_the_prior_carries_is_said():
    """One beam cannot tell its own noise from that of the hand along it; four can."""
    recording, _, _ = robot(Layout(1, 5, 20))
    found = hl.calibrate(recording, options=hl.CalibrationOptions("none"))
    assert found.status == "converged"
    assert any(one.prior_carries for one in found.noise_estimate)
    assert all(0.0 < one.sigma < 1e-2 for one in found.noise_estimate)
    recording, _, _ = robot(Layout(4, 13, 20), ARM, scene="arm")
    found = hl.calibrate(recording, options=hl.CalibrationOptions("none"))
    assert not any(one.prior_carries for one in found.noise_estimate)


def test_the_rig_file_changes_what_is_expected(tmp_path):
    """Of one beam the prior decides about the robot: another one, another estimate."""
    rig = tmp_path / "rig.toml"
    rig.write_text(
        "[sensor]\nlinearity_percent = 3.0\n"
        "[noise]\npose_translation_prior_mm = 0.002\npose_rotation_prior_deg = 0.4\n"
    )
    known = hl.read_rig(rig)
    assert known.sensor.linearity == pytest.approx(0.03)
    assert known.noise.pose_translation_prior == pytest.approx(2e-6)
    assert known.noise.pose_rotation_prior == pytest.approx(math.radians(0.4))
    recording, _, _ = robot(Layout(1, 5, 20))
    options = hl.CalibrationOptions(sensor=known.sensor)
    found = hl.calibrate(recording, known.noise, options)
    usual = hl.calibrate(recording)
    assert found.learned.linearity == pytest.approx(0.03)
    sigma, before = ({x.name: x.sigma for x in one.noise_estimate} for one in (found, usual))
    assert sigma["pose translation"] < 0.5 * before["pose translation"]
    assert found.learned.range_error_sigma[0] > usual.learned.range_error_sigma[0]


def test_beside_a_robust_loss_scales_are_estimated_but_not_integrated_over():
    recording, _, _ = robot(Layout(3, 4, 14))
    found = hl.calibrate(recording, options=hl.CalibrationOptions(loss="huber"))
    assert {beam.terms for beam in found.beams.values()} == {2}
    assert found.learned is None
    assert found.fit.range_sigma == pytest.approx(RANGE, rel=0.5)


@pytest.mark.slow
def test_predictions_carry_the_noise_that_was_estimated():
    recording, _, _ = robot(Layout(4, 5, 16))
    found = hl.validate(recording, options=hl.CalibrationOptions("none"), splits=4)
    mean = np.mean([one.standardized**2 for one in found.predictions])
    assert 0.6 < mean < 1.5
    assert all(one.result.p_value > 1e-3 for one in found.targets)


def test_a_prior_far_narrower_than_the_widest_loses_no_digit():
    """Mean and covariance equal what all information in one matrix gives, whatever cancels."""
    rng = np.random.default_rng(3)
    rows = rng.standard_normal((40, 14)) @ np.diag(
        [1e3] * 5 + [1e2, 1e-3] + [1e3] * 5 + [1e2, 1e-3]
    )
    matrix, vector = rows.T @ rows, rows.T @ rng.standard_normal(40)
    k = np.array([[1e-9, -2e-9], [3e-9, 1e-9]])
    scale = np.array([2e-9, 1e-9])
    information = information_of(matrix[None], vector[None], np.zeros(1))
    known = [RangeErrorGrid.at(scale, np.zeros(2))]
    mean, covariance, _ = BeamPosterior(information, k, 0.9).integrated(known, np.zeros(1))
    places = np.array([5, 6, 12, 13])
    matrix[places, places] += np.tile(scale**-2, 2)
    vector[places] -= k.ravel() * np.tile(scale**-2, 2)
    unit = 1.0 / np.sqrt(np.diagonal(matrix))
    exact = np.linalg.inv(matrix * np.outer(unit, unit)) * np.outer(unit, unit)
    sigma = np.sqrt(np.diagonal(exact))
    # The part that every unknown is known to beside the readings, which the matrix here lacks.
    np.testing.assert_allclose(
        covariance / np.outer(sigma, sigma), exact / np.outer(sigma, sigma), atol=1e-6
    )
    np.testing.assert_allclose(mean / sigma, exact @ vector / sigma, atol=1e-6)


def test_scales_are_found_where_the_evidence_is_beyond_all_bounds():
    """Beside 1e19, which readings that fit nothing reach, differences of the prior are rounding."""
    (grid,) = widest_grids(0.01, 2, 4, None)
    ((near, _),) = near_largest([grid], [np.full(len(grid.individual), -1e19)])
    fine = refined_grid(near, 0.01)
    assert np.isfinite(fine.individual).all()
    assert near_largest([fine], [np.full(len(fine.individual), -1e19)])


@pytest.mark.slow
@pytest.mark.parametrize("noise", [hl.Noise(), hl.Noise(3e-5)], ids=["nothing given", "sigma"])
def test_rows_shifted_against_the_poses_are_no_calibration(noise):
    recording, _ = simulated(layout=Layout(2, 3, 8), range_sigma=3e-5)
    shifted = replace(recording, ranges=np.roll(recording.ranges, 1, axis=0))
    assert hl.calibrate(shifted, noise).status != "converged"
