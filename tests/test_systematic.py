"""Systematic errors: found, named, bounded; against dense algebra, formulas and solving again."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import kstest

import handlaser_gtsam as hl
from handlaser_gtsam import model
from handlaser_gtsam.data.noise import Noise
from handlaser_gtsam.data.parameters import Parameters
from handlaser_gtsam.data.recording import Readings
from handlaser_gtsam.estimation.joint_solution import settle
from handlaser_gtsam.estimation.options import CalibrationOptions
from handlaser_gtsam.model.distributions import FAMILY_LEVEL as LEVEL
from handlaser_gtsam.model.distributions import holm, needed, two_sided
from handlaser_gtsam.model.effects import EFFECTS
from handlaser_gtsam.model.effects.effect import SeenStations
from handlaser_gtsam.model.effects.tool_displaced import directions
from handlaser_gtsam.model.weighting import Variances, whitening
from handlaser_gtsam.observability.wording import BeamAndPlaneNames
from handlaser_gtsam.quantities import POWER
from handlaser_gtsam.results.projection import LinearRows
from handlaser_gtsam.results.score_tests import ScoreTests, alike
from handlaser_gtsam.results.systematic import systematic_errors

SIGMA = 1e-4
BY_NATURE = {"inverse-cosine", "tilt", "tool-frame", "range-offset"}
TESTED = tuple(code for code in EFFECTS if code not in BY_NATURE)
FREE, NONE = (np.inf, np.inf), (0.0, 0.0)
ORDERS = {"linear": 1, "quadratic": 2, "cubic": 3}
HELD = ("linear", "quadratic")
BEAM_ARRAYS = ("locations", "directions", "range_errors")


class Scene:
    """Three beams before four planes, 12 stations each, and what the beams read there.

    Ranges are found by intersecting rays with planes that may be bent or displaced, from hand poses
    that may differ from the recorded ones; nothing of it is shared with the package.
    """

    beams, planes, stations = 3, 4, 12

    def __init__(self, seed=0):
        rng = np.random.default_rng(seed)
        count = self.planes * self.stations
        self.r = rng.uniform(-0.05, 0.05, (self.beams, 3))
        self.v = unit(np.column_stack((rng.uniform(-0.3, 0.3, (self.beams, 2)), np.ones(3))))
        tilt = np.array([[0.4, 0.1], [-0.35, 0.3], [0.1, -0.45], [-0.1, 0.2]])
        self.n = unit(np.column_stack((tilt, np.ones(self.planes))))
        self.b = -0.35 - rng.uniform(0.0, 0.05, self.planes)
        # The planes are recorded in turns, so that time is not the order of the planes.
        self.plane = np.arange(count) % self.planes
        self.R = Rotation.from_rotvec(rng.uniform(-0.45, 0.45, (count, 3))).as_matrix()
        self.t = rng.uniform(-0.12, 0.12, (count, 3))

    def true_poses(self, code, size):
        R, t = self.R.copy(), self.t.copy()
        if code == "lag":
            for p in range(self.planes):
                at = np.flatnonzero(self.plane == p)
                for k, j in enumerate(at):
                    way = self._ahead(j, at[max(k - 1, 0) : k], at[k + 1 : k + 2], size)
                    R[j] = self.R[j] @ Rotation.from_rotvec(way[:3]).as_matrix()
                    t[j] = self.t[j] + way[3:]
        if code == "turn-scale":
            mean = Rotation.from_matrix(self.R).mean()
            turns = (mean.inv() * Rotation.from_matrix(self.R)).as_rotvec()
            R = (mean * Rotation.from_rotvec((1.0 + size) * turns)).as_matrix()
        if code == "translation-scale":
            t = t.mean(axis=0) + (1.0 + size) * (t - t.mean(axis=0))
        return R, t

    def _ahead(self, j, before, after, w):
        """Return turn and shift of the hand after a part of a step, by Lagrange's interpolation."""
        ways = [
            np.append(
                Rotation.from_matrix(self.R[j].T @ self.R[i]).as_rotvec(), self.t[i] - self.t[j]
            )
            for i in (*before, *after)
        ]
        if len(ways) == 2:
            return w * (w - 1.0) / 2.0 * ways[0] + w * (w + 1.0) / 2.0 * ways[1]
        return -w * ways[0] if len(before) else w * ways[0]

    def flat_ranges(self, R, t, height=0.0):
        n, b = self.n[self.plane], self.b[self.plane]
        x = t[:, None] + np.einsum("mij,bj->mbi", R, self.r)
        w = np.einsum("mij,bj->mbi", R, self.v)
        along = np.einsum("mi,mbi->mb", n, w)
        s = (height - b[:, None] - np.einsum("mi,mbi->mb", n, x)) / along
        return s, along, x + s[:, :, None] * w

    def ranges(self, code="", size=0.0, plane=0, beam=0, since=0):
        """Return what the beams read (M, B), without noise."""
        R, t = self.true_poses(code, size)
        late = np.arange(len(t)) >= since
        height = np.zeros((len(t), 1))
        if code == "displaced":
            height[(self.plane == plane) & late] = size
        s, along, spots = self.flat_ranges(R, t, height)
        if code == "sag":
            for _ in range(20):  # the height at a spot moves the spot a little
                square = np.empty_like(s)
                for p in range(self.planes):
                    own = spots[self.plane == p]
                    square[self.plane == p] = ((own - own.mean(axis=(0, 1))) ** 2).sum(axis=2)
                s, along, spots = self.flat_ranges(R, t, size * square / square.max())
        if code == "incidence":
            s = s + size * (1.0 / along**2 - 1.0)
        if code == "drift":
            s = s + size * (np.arange(len(t)) / (len(t) - 1) - 0.5)[:, None]
        if code == "beam-on-plane":
            s[self.plane == plane, beam] += size
        if code == "carry-over":
            s = s + size * (np.roll(s, 1, axis=1) - s)
        if code in ORDERS:
            of = slice(None) if code == "cubic" else slice(beam, beam + 1)
            s[:, of] = too_long(s, size, ORDERS[code])[:, of]
        return s

    def problem(self, ranges):
        """Return truth, readings and the positions of their stations; planes about their middles."""
        station, beam = (x.ravel() for x in np.indices(ranges.shape))
        order = np.lexsort((station, beam, self.plane[station]))
        station, beam = station[order], beam[order]
        plane = self.plane[station]
        middle = np.array([self.t[self.plane == p].mean(axis=0) for p in range(self.planes)])
        readings = Readings(
            station,
            beam,
            plane,
            ranges[station, beam],
            self.R[station],
            self.t[station] - middle[plane],
            self.beams,
            self.planes,
        )
        b = self.b + (self.n * middle).sum(axis=1)
        return Parameters(self.r, self.v, np.zeros((self.beams, 2)), self.n, b), readings, station


def too_long(s, size, power):
    """Return readings d that are too long by size (d / max d)^power."""
    d = s
    for _ in range(50):
        d = s + size * (d / d.max()) ** power
    return d


def unit(x):
    return x / np.linalg.norm(x, axis=1, keepdims=True)


def names_of(readings):
    return BeamAndPlaneNames(
        tuple((f"b{i}", i) for i in range(readings.beams)),
        tuple((f"p{p}", p) for p in range(readings.planes)),
    )


def pose_variances(readings, scale=1.0):
    S = np.diag([3e-4**2] * 3 + [5e-5**2] * 3) * scale**2
    return Variances(
        np.full(readings.beams, SIGMA), 0.0, np.tile(S, (readings.station.max() + 1, 1, 1))
    )


def arguments(at, readings, position, prior=FREE, variances=None):
    variances = variances or Variances(np.full(readings.beams, SIGMA))
    how = whitening(at, readings, variances)
    return at, readings, how, np.tile(prior, (readings.beams, 1)), position


def solved(scene, ranges, terms="none"):
    """Return the problem at its solution, planes and beams found anew."""
    truth, readings, position = scene.problem(ranges)
    options = CalibrationOptions(range_error=terms, poses="exact", outliers="keep")
    found = settle(readings, truth, Noise(SIGMA), options).finished()
    assert found.at.status == "converged"
    return arguments(found.parameters, readings, position, NONE if terms == "none" else FREE)


def report(problem, known=True):
    readings, prior = problem[1], problem[3]
    unknowns = 5 * readings.beams + 3 * readings.planes + int(np.isinf(prior).sum())
    found = judged(problem, known, len(readings) - unknowns)
    return {one.code: one for one in found}


def judged(problem, known, dof):
    rows, names = LinearRows(*problem), names_of(problem[1])
    stations = [str(number) for number in range(1, int(rows.position.max()) + 2)]
    return systematic_errors(rows, names, stations, known=known, dof=dof, plausible={})[0]


class Detectable:
    """What could go unnoticed of every member of one family, for noise of known size."""

    def __init__(self, code, problem):
        found = ScoreTests(LinearRows(*problem), None)
        members = np.flatnonzero(found.codes == code)
        for name in (
            "plane",
            "beam",
            "position",
            "determined",
            "size",
            "sigma",
            "detectable",
            "strained",
        ):
            setattr(self, name, getattr(found, name)[members])
        self.location_shift, self.direction_shift = found.moves(members, self.detectable)[:2]


# Two ways to one number


def dense(problem):
    """Return whitened J, e (prior rows included), a function from raw columns, and sigma."""
    at, readings, how, prior, _ = problem
    x = model.linearize(model.scene(at, readings), readings.distance, with_pose=True)
    N, B, P = len(readings), readings.beams, readings.planes
    J = np.zeros((N, 7 * B + 3 * P))
    v_basis, n_basis = model.tangent_basis(at.directions), model.tangent_basis(at.normals)
    for i in range(N):
        b, p = readings.beam[i], readings.plane[i]
        own = (x.location[i], x.direction[i] @ v_basis[b], x.range_error[i] * (prior[b] > 0.0))
        J[i, 7 * b : 7 * b + 7] = np.concatenate(own)
        J[i, 7 * B + 3 * p :][:3] = *(x.normal[i] @ n_basis[p]), x.offset[i]
    finite = np.flatnonzero(np.isfinite(prior) & (prior > 0.0))
    pull = np.zeros((len(finite), J.shape[1]))
    k = np.zeros(len(finite))
    for row, index in enumerate(finite):
        b, term = divmod(int(index), 2)
        pull[row, 7 * b + 5 + term] = how.sigma / prior[b, term]
        k[row] = at.range_errors[b, term] * how.sigma / prior[b, term]
    W = how.apply_rows(np.eye(N))

    def white(a):
        return np.concatenate((W @ a, np.zeros(len(finite))))

    return np.vstack((W @ J, pull)), np.concatenate((W @ x.residual, k)), white, x


def dense_test(J, e, a, sigma):
    """Return the size, its sigma and how the unknowns move, by least squares with one more column."""
    scale = np.linalg.norm(J, axis=0)
    scale[scale == 0.0] = 1.0
    x = np.linalg.lstsq(J / scale, np.column_stack((a, e)), rcond=1e-12)[0]
    a_perp, e_perp = a - J / scale @ x[:, 0], e - J / scale @ x[:, 1]
    square = a_perp @ a_perp
    return a_perp @ e_perp / square, sigma / np.sqrt(square), -x[:, 0] / scale


@pytest.mark.parametrize("prior", [FREE, NONE, (0.01, 0.05), (np.inf, 0.0)])
def test_the_blocked_projection_agrees_with_a_dense_one(prior):
    scene = Scene()
    rng = np.random.default_rng(1)
    truth, readings, position = scene.problem(scene.ranges() + SIGMA * rng.standard_normal((48, 3)))
    # A reading is missing here and there, and the solution is not where J'e = 0.
    keep = np.flatnonzero(rng.uniform(size=len(readings)) > 0.1)
    readings, position = readings.subset(keep), position[keep]
    k = np.where(np.array(prior) > 0.0, 1e-3, 0.0)
    at = replace(truth, locations=truth.locations + 1e-4, range_errors=np.tile(k, (3, 1)))
    problem = arguments(at, readings, position, prior, pose_variances(readings))
    # What strains the prior is judged without it.
    loose = arguments(
        at,
        readings,
        position,
        np.where(np.array(prior) > 0.0, np.inf, 0.0),
        pose_variances(readings),
    )
    (*bound, x), (*free, _) = dense(problem), dense(loose)
    sigma = problem[2].sigma

    def by_hand(column, strained):
        J, e, white = free if strained else bound
        return dense_test(J, e, white(column), sigma)

    slope = 1.0 + k[0] + 2.0 * k[1] * readings.distance
    cosine = -1.0 / x.offset
    columns = {
        "incidence": -slope * (1.0 / cosine**2 - 1.0),
        "cubic": -slope * (readings.distance / readings.distance.max()) ** 3,
        "drift": -slope * (position / position.max() - 0.5),
        "translation-scale": -(
            x.pose[:, 3:] * np.einsum("nji,nj->ni", readings.world_R_hand, readings.world_t_hand)
        ).sum(axis=1),
    }
    found = {code: Detectable(code, problem) for code in TESTED}
    for code, column in columns.items():
        if not found[code].determined[0]:
            assert code == "translation-scale"
            assert prior[0] > 0.0
            continue
        _agree(found[code], 0, by_hand(column, found[code].strained[0]), at)
    for term, code in enumerate(HELD):
        column = -slope * (readings.distance / readings.distance.max()) ** (1 + term)
        assert found[code].beam.tolist() == ([] if prior[term] else [0, 1, 2, -1])
        for m, beam in enumerate(found[code].beam):
            own = (readings.beam == beam) | (beam < 0)
            _agree(found[code], m, by_hand(column * own, found[code].strained[m]), at)
    shifted = found["displaced"]
    assert len(shifted.plane) > 20
    for m in range(0, len(shifted.plane), 5):
        rows = (readings.plane == shifted.plane[m]) & (position >= shifted.position[m])
        _agree(shifted, m, by_hand(x.offset * rows, shifted.strained[m]), at)
    biased = found["beam-on-plane"]
    assert len(biased.plane) == 12
    moves = found["tool-displaced"]
    assert len(moves.position) == 8 * len(directions())
    for m in range(0, len(moves.position), 5):
        first = moves.position[m]
        share = position / position.max() if first < 0 else 1.0 * (position >= first)
        column = -(x.location @ directions()[m % len(directions())]) * (share - share.mean())
        _agree(moves, m, by_hand(column, moves.strained[m]), at)
    for m in range(len(biased.plane)):
        rows = (readings.plane == biased.plane[m]) & (readings.beam == biased.beam[m])
        _agree(biased, m, by_hand(-slope * rows, biased.strained[m]), at)
    if np.isfinite(prior[0]) and prior[0] > 0.0:
        assert found["cubic"].strained[0]
        assert not biased.strained.all()


def _agree(found, m, dense_found, at):
    # Normal equations in natural units lose half of the digits of a least-squares solution at most.
    size, sigma, moved = dense_found
    assert found.size[m] == pytest.approx(size, rel=1e-5, abs=1e-5 * sigma)
    assert found.sigma[m] == pytest.approx(sigma, rel=1e-6)
    moved = (moved[: 7 * len(at.locations)] * found.detectable[m]).reshape(-1, 7)
    scale = np.abs(moved[:, :3]).max()
    assert np.allclose(found.location_shift[m], moved[:, :3], atol=1e-5 * scale)
    turned = np.einsum("bij,bj->bi", model.tangent_basis(at.directions), moved[:, 3:5])
    assert np.allclose(found.direction_shift[m], turned, atol=1e-5 * np.abs(turned).max())


# Injected errors

WHERE = {"plane": 2, "beam": 1, "since": 4 * 5 + 2}
SUBJECT = {
    "displaced": "plane p2 from station 23 on",
    "beam-on-plane": "beam b1 on plane p2",
    "linear": "beam b1",
    "quadratic": "beam b1",
}


def injected_size(code, problem):
    """Return twice the size that is detectable of the member that is injected."""
    found = Detectable(code, problem)
    member = 0
    if code in SUBJECT:
        plane = -1 if code in HELD else WHERE["plane"]
        beam_or_time = (found.beam == WHERE["beam"]) | (found.position == WHERE["since"])
        member = np.flatnonzero((found.plane == plane) & beam_or_time)[0]
    return 2.0 * float(found.detectable[member])


@pytest.mark.parametrize("terms", ["none", "k1k2"])
@pytest.mark.parametrize("code", [code for code in TESTED if code != "tool-displaced"])
def test_an_injected_error_is_found_named_and_its_effect_is_right(code, terms):
    if code in ("translation-scale", *HELD) and terms == "k1k2":
        pytest.skip("confounded with k1, or an unknown: tested below")
    scene = Scene()
    noise = SIGMA * np.random.default_rng(7).standard_normal((48, 3))
    clean = solved(scene, scene.ranges() + noise, terms)
    size = injected_size(code, clean)
    problem = solved(scene, scene.ranges(code, size, **WHERE) + noise, terms)
    found = report(problem)
    first = next(iter(found.values()))
    assert first.code == code or code in first.alike
    one = found[code]
    assert one.found
    assert one.subject == SUBJECT.get(code, "")
    # Noise, and what is not linear in an error of twice the detectable size.
    assert one.size == pytest.approx(size, abs=4.0 * one.sigma + 0.1 * size)
    # The same noise is in both solutions, so that only the injected error moves them.
    moved = problem[0].locations - clean[0].locations
    expected = one.location_error * size / one.size
    assert np.linalg.norm(moved - expected) < 0.2 * np.linalg.norm(moved) + 1e-9
    turned = problem[0].directions - clean[0].directions
    expected = one.direction_error * size / one.size
    assert np.linalg.norm(turned - expected) < 0.2 * np.linalg.norm(turned) + 1e-9


@pytest.mark.parametrize("direction", [(1.0, 0.0, 0.0), (-0.5, 0.8, 0.3), (0.2, -0.4, -0.9)])
@pytest.mark.parametrize(
    ("share", "subject"),
    [
        (lambda j: j / 47.0, "little by little"),
        (lambda j: j >= 24.0, "from station 25 on"),
        (lambda j: j >= 33.0, ""),  # between two of the stations that are tried
    ],
)
def test_a_tool_frame_that_steps_or_creeps_is_found(share, subject, direction):
    scene, size = Scene(), 12.0 * SIGMA
    noise = SIGMA * np.random.default_rng(7).standard_normal((48, 3))
    recorded = scene.t
    shift = size * np.asarray(direction) / np.linalg.norm(direction)
    along = np.asarray(share(np.arange(48.0)), dtype=float)
    scene.t = recorded + along[:, None] * np.einsum("mij,j->mi", scene.R, shift)
    ranges = scene.ranges() + noise
    scene.t = recorded
    found = report(solved(scene, ranges))
    first = found["tool-displaced"]
    assert first.found
    assert first.subject == subject or not subject
    along_the_beams = abs(shift[2]) > 0.5 * size
    if subject == "little by little" and along_the_beams:  # a drift of the readings looks the same
        assert "drift" in first.alike
    else:
        assert next(iter(found.values())) is first
    # The size is that along the direction tried that fits best, which has 0.89 of the true one or more.
    # A part along the beams hardly shows, so that a direction without it may fit as well.
    assert 0.6 * size < abs(first.size) < 1.2 * size + 4.0 * first.sigma
    # The mounts are of the mean of the tool frames, and half of the way from where either is.
    assert (first.spots(0.3, unnoticed=False) >= 0.5 * abs(first.size)).all()


def test_a_sensor_that_warms_up_is_found_to_drift():
    scene = Scene()
    noise = SIGMA * np.random.default_rng(7).standard_normal((48, 3))
    size = 8.0 * SIGMA
    time = np.arange(48) / 47.0
    found = report(solved(scene, scene.ranges() - size * np.exp(-8.0 * time)[:, None] + noise))
    one = found["drift"]
    assert one.found
    assert not one.explained_by
    assert one.size == pytest.approx(size, abs=4.0 * one.sigma)


def test_nothing_is_found_in_a_clean_recording():
    scene = Scene()
    noise = SIGMA * np.random.default_rng(3).standard_normal((48, 3))
    found = report(solved(scene, scene.ranges() + noise))
    assert set(found) == {*TESTED, *BY_NATURE}
    assert not any(one.found or one.warning for one in found.values())
    for code in TESTED:
        assert not found[code].confounded
        assert np.isfinite(found[code].detectable)
        assert "would go unnoticed" in found[code].message
    for code in BY_NATURE:
        assert found[code].confounded
        assert found[code].detectable == np.inf
        assert "cannot be told" in found[code].message


def test_the_bound_of_a_family_is_that_of_its_least_detectable_member():
    scene = Scene()
    problem = arguments(*scene.problem(scene.ranges()))
    one = report(problem)["displaced"]
    of = Detectable("displaced", problem)
    assert one.detectable == of.detectable.max()
    largest = np.linalg.norm(of.location_shift, axis=2).max(axis=0)
    assert np.allclose(np.linalg.norm(one.location_shift, axis=1), largest)


def test_one_cause_gives_one_warning():
    scene = Scene()
    noise = SIGMA * np.random.default_rng(7).standard_normal((48, 3))
    found = report(solved(scene, scene.ranges("displaced", 4e-3, **WHERE) + noise))
    assert sum(one.found for one in found.values()) > 1
    warnings = [one.code for one in found.values() if one.warning]
    assert warnings == ["displaced"]
    assert {one.explained_by for one in found.values() if one.found} == {"", "displaced"}


def test_the_scale_of_translations_is_confounded_with_k1():
    scene = Scene()
    noise = SIGMA * np.random.default_rng(7).standard_normal((48, 3))
    ranges = scene.ranges("translation-scale", 0.01) + noise
    assert report(solved(scene, ranges))["translation-scale"].found
    at, readings, how, _, position = problem = solved(scene, ranges, "k1k2")
    one = report(problem)["translation-scale"]
    assert one.confounded
    assert "k1 of all beams" in one.message
    prior = np.tile((0.01, 0.02), (3, 1))
    assert report((at, readings, how, prior, position))["translation-scale"].confounded
    prior[0] = 0.0
    assert not report((at, readings, how, prior, position))["translation-scale"].confounded


def test_range_errors_are_tested_for_where_they_are_held_at_zero():
    scene = Scene()
    noise = SIGMA * np.random.default_rng(7).standard_normal((48, 3))
    at, readings, how, _, position = solved(scene, scene.ranges() + noise)
    for prior, held in ((FREE, ()), ((0.01, 0.02), ()), ((np.inf, 0.0), HELD[1:]), (NONE, HELD)):
        found = report((at, readings, how, np.tile(prior, (3, 1)), position))
        assert {code for code in found if code in HELD} == set(held)
        assert not any(found[code].confounded for code in held)
    # Only one of three beams holds k2; and more beams than are tested one by one.
    prior = np.array([FREE, FREE, (np.inf, 0.0)])
    one = Detectable("quadratic", (at, readings, how, prior, position))
    assert one.beam.tolist() == [2]
    crowd = replace(readings, beam=np.arange(len(readings)) % 17, beams=17)
    many = replace(at, **{name: getattr(at, name)[np.arange(17) % 3] for name in BEAM_ARRAYS})
    stations = SeenStations(many, crowd, position, np.arange(17))
    stations.held[1:] = True
    column = EFFECTS["linear"].at(stations).columns
    assert column.shape == (len(crowd), 16)
    stations.held[0] = True
    [[column]] = [EFFECTS["linear"].at(stations).columns.T]
    assert np.allclose(column, stations.longer * crowd.distance / crowd.distance.max())


def test_a_range_error_that_is_said_to_be_zero_is_no_code_to_free():
    with pytest.raises(hl.InputError, match=r"free linear, which .* range_error lets be estimated"):
        CalibrationOptions(range_error="none", free=("linear",))


def test_what_a_recording_cannot_show_is_confounded():
    scene = Scene()
    scene.R[:] = scene.R[0]
    problem = arguments(*scene.problem(scene.ranges()), NONE)
    found = report(problem)
    assert found["turn-scale"].confounded
    assert found["turn-scale"].detectable == np.inf
    assert "in this recording" in found["turn-scale"].message


def test_one_beam_has_no_bias_on_one_plane():
    scene = Scene()
    truth, readings, position = scene.problem(scene.ranges())
    rows = np.flatnonzero(readings.beam == 0)
    readings = replace(readings.subset(rows), beams=1)
    one = Parameters(*(x[:1] for x in truth.beams), truth.normals, truth.offsets)
    found = report(arguments(one, readings, position[rows]))["beam-on-plane"]
    assert found.confounded
    assert "offset of the plane" in found.message


# Statistics in the linear model: residuals that are drawn, at known unknowns


def drawn(scene, rng, count, code="", size=0.0):
    """Yield problems of readings with noise at the truth; e is projected, so it need not be solved."""
    ranges = scene.ranges(code, size, **WHERE)
    for _ in range(count):
        yield arguments(*scene.problem(ranges + SIGMA * rng.standard_normal(ranges.shape)))


@pytest.mark.slow
@pytest.mark.parametrize("known", [True, False])
def test_without_errors_p_values_are_uniform_and_warnings_rare(known):
    rng, scene = np.random.default_rng(5), Scene()
    smallest, sizes = [], {code: [] for code in ("sag", "lag", "cubic")}
    dof = 48 * 3 - 21 - 12
    for problem in drawn(scene, rng, 200):
        found = report(problem, known)
        smallest.append(min(one.p_value for one in found.values()))
        for code, values in sizes.items():
            z = np.array([found[code].size / found[code].sigma])
            values.append(float(two_sided(z, None if known else dof)[0]))
    for values in sizes.values():
        assert kstest(values, "uniform").pvalue > 1e-3
    # Expected at most 2 of 200; 7 or more have a probability of 0.5 % at 1 %.
    assert np.sum(np.array(smallest) < LEVEL) < 7


@pytest.mark.slow
@pytest.mark.parametrize("known", [True, False])
def test_the_detectable_size_is_found_with_80_percent(known):
    rng, scene = np.random.default_rng(6), Scene()
    dof = 48 * 3 - 21 - 12
    size = injected_size("sag", arguments(*scene.problem(scene.ranges()))) / 2.0
    if not known:
        size *= needed(LEVEL / 80, dof)[1] / needed(LEVEL / 80, None)[1]
    hits = [report(one, known)["sag"].found for one in drawn(scene, rng, 150, "sag", size)]
    # The standard deviation of a share of 150 is 3.3 %; the two counts of members hardly differ.
    assert np.mean(hits) == pytest.approx(POWER, abs=0.11)


@pytest.mark.parametrize("dof", [None, 5, 40, 3000])
def test_the_mean_needed_has_the_power(dof):
    rng = np.random.default_rng(2)
    critical, mean = needed(1e-4, dof)
    z = mean + rng.standard_normal(200_000)
    if dof is not None:
        z /= np.sqrt(rng.chisquare(dof - 1, len(z)) / (dof - 1))
    assert np.mean(np.abs(z) > critical) == pytest.approx(POWER, abs=0.006)
    assert two_sided(np.array([critical]), dof)[0] == pytest.approx(1e-4)


@pytest.mark.parametrize("rho", [0.5, 0.7, 0.75, 0.95, -0.95, 1.0])
def test_errors_are_alike_where_the_right_one_does_not_fit_better(rho):
    delta = 5.0
    rng = np.random.default_rng(3)
    a, b = rng.standard_normal((2, 400_000))
    right, other = delta + a, rho * delta + rho * a + np.sqrt(1.0 - rho**2) * b
    better = np.mean(np.abs(right) > np.abs(other))
    assert abs(better - 0.95) > 0.005 or rho == 1.0  # clear of the limit, so that draws can decide
    assert bool(alike(np.array([rho]), delta)[0]) == (better < 0.95)


def test_holm_rejects_step_by_step():
    p = np.array([0.01, 0.04, 0.03, 0.005])
    assert np.allclose(holm(p), [0.03, 0.06, 0.06, 0.02])


# Invariance


@pytest.mark.parametrize("prior", [NONE, (0.01, 0.05)])
def test_units_and_frames_do_not_matter(prior):
    rng, scene = np.random.default_rng(1), Scene()
    at, readings, position = scene.problem(
        scene.ranges() + 3.0 * SIGMA * rng.standard_normal((48, 3))
    )
    before = report(arguments(at, readings, position, prior, pose_variances(readings)))
    unit_ = 1000.0
    R = Rotation.from_rotvec([0.4, -1.1, 0.3]).as_matrix()
    at = Parameters(
        at.locations * unit_, at.directions, at.range_errors, at.normals @ R.T, at.offsets * unit_
    )
    readings = replace(
        readings,
        distance=readings.distance * unit_,
        world_R_hand=R @ readings.world_R_hand,
        world_t_hand=readings.world_t_hand @ R.T * unit_,
    )
    S = np.diag([3e-4**2] * 3 + [(5e-5 * unit_) ** 2] * 3)
    variances = Variances(np.full(3, SIGMA * unit_), 0.0, np.tile(S, (48, 1, 1)))
    prior = (prior[0], prior[1] / unit_)
    after = report(arguments(at, readings, position, prior, variances))
    assert set(before) == set(after)
    for code, one in before.items():
        other = after[code]
        assert one.confounded == other.confounded
        if one.confounded:
            continue
        factor = unit_ if one.unit == "m" else 1.0
        assert other.size / factor == pytest.approx(one.size, rel=1e-6, abs=1e-6 * one.sigma)
        assert other.detectable / factor == pytest.approx(one.detectable, rel=1e-6)
        assert other.p_value == pytest.approx(one.p_value, rel=1e-4)
        assert (other.subject, other.alike) == (one.subject, one.alike)
        assert np.allclose(other.location_shift / unit_, one.location_shift, rtol=1e-4, atol=1e-9)


def test_without_redundancy_nothing_is_tested():
    at, readings, position = Scene().problem(Scene().ranges())
    problem = arguments(at, readings, position)
    for known, dof in ((True, 0), (False, 1)):
        assert judged(problem, known, dof) == ()
