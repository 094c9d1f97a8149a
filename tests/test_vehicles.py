"""Vehicles, SCARA arms and linear axes: what their motion determines, before which walls.

The ranks are those of Jacobians that are written here once more, densely and without the package. In
natural units a range s along a beam (r, v) of the hand pose (R, t) to the plane (n, b) changes by

    ds/dr = -n_H / c,   ds/dv = -s n_H / c,   ds/dk = -(s, s^2),   ds/dn = -x / c,   ds/db = -1 / c

with n_H = R' n, c = n_H . v and the spot x = R (r + s v) + t.
"""

import re
from dataclasses import dataclass, replace

import numpy as np
import pytest
from helpers import ROOT, first_and_slow
from scipy.spatial.transform import Rotation

import handlaser_gtsam as hl
from handlaser_gtsam.data.parameters import Parameters
from handlaser_gtsam.files.logs.format_checks import convention_of
from handlaser_gtsam.files.logs.survey_conventions import refuse_wrong_reading
from handlaser_gtsam.model.conventions import numbers_of
from handlaser_gtsam.observability.motion import check_motion, poor_motion, some_plane_leans
from handlaser_gtsam.results.survey_check import check_survey
from handlaser_gtsam.solvers.beam_problem import refine

WALLS = {
    "vertical": [(0, 0), (60, 0), (-50, 0), (150, 0)],
    "one leans": [(0, 0), (60, 0), (-50, 25)],
    "two lean": [(0, 0), (60, 20), (-50, -30)],
    "a single leaning board": [(0, 25)],
    "a floor": [(0, 0), (60, 0), (-50, 0), (0, 90)],
}
"""Azimuth and lean of every plane [degrees]."""
TERMS = {"none": 0, "k1": 1, "k1k2": 2}
BEAMS = [1, 2, 3, 4]
ROUNDING = 1e-9
"""Singular values of columns of unit length below this part of the largest are zero: the smallest that
is none is above 1e-5 in every scene."""


@dataclass
class Scene:
    """A vehicle before walls 2 m away: poses of the hand, beams and planes."""

    R: np.ndarray
    t: np.ndarray
    plane: np.ndarray
    n: np.ndarray
    b: np.ndarray
    r: np.ndarray
    v: np.ndarray

    @property
    def ranges(self):
        """Range (M, B) of every beam at every station."""
        n_hand = np.einsum("mji,mj->mi", self.R, self.n[self.plane])
        height = (self.n[self.plane] * self.t).sum(axis=1) + self.b[self.plane]
        return -(n_hand @ self.r.T + height[:, None]) / (n_hand @ self.v.T)

    def recording(self, sigma=0.0):
        """The recording, with noise of standard deviation sigma [m]."""
        noise = sigma * np.random.default_rng(9).standard_normal(self.ranges.shape)
        labels = tuple("ABCD"[p] for p in self.plane)
        names = tuple(str(i + 1) for i in range(len(self.r)))
        return hl.Recording(self.R, self.t, self.ranges + noise, labels, names)


def scene(motion, walls, beams, stations=14, uneven=(0.0, 0.0)):
    """Return a scene; `uneven` has the noise of the height [m] and of roll and pitch [degrees]."""
    rng = np.random.default_rng(0)
    azimuth, lean = np.radians(WALLS[walls]).T
    n = np.column_stack(
        (np.cos(azimuth) * np.cos(lean), np.sin(azimuth) * np.cos(lean), np.sin(lean))
    )
    plane = np.repeat(np.arange(len(n)), stations)
    M = len(plane)
    yaw = azimuth[plane] + rng.uniform(-0.5, 0.5, M)
    t = rng.uniform(-0.6, 0.6, (M, 3)) * [1.0, 1.0, 0.0]
    if motion in ("SCARA", "never turning"):
        t[:, 2] = rng.uniform(-0.2, 0.2, M)
    if motion in ("never turning", "plane without turns", "linear axis"):
        yaw[:] = 0.0
    if motion == "linear axis":
        t = t[:, :1] * [1.0, 0.3, 0.0]
    if motion == "turning on the spot":
        t[:] = 0.0
    tilts = np.radians(uneven[1]) * rng.standard_normal((M, 3)) * [1.0, 1.0, 0.0]
    t[:, 2] += uneven[0] * rng.standard_normal(M)
    turns = Rotation.from_rotvec(yaw[:, None] * [0.0, 0.0, 1.0]) * Rotation.from_rotvec(tilts)
    r = rng.uniform(-0.15, 0.15, (beams, 3))
    sideways, steep = rng.uniform(-0.3, 0.3, beams), rng.uniform(0.1, 0.35, beams)
    v = np.column_stack((np.ones(beams), sideways, steep * rng.choice([-1.0, 1.0], beams)))
    v /= np.linalg.norm(v, axis=1, keepdims=True)
    return Scene(turns.as_matrix(), t, plane, n, np.full(len(n), -2.0), r, v)


def tangents(u):
    """Two unit vectors (2, 3) at right angles to u."""
    first = np.cross(u, np.eye(3)[np.abs(u).argmin()])
    first /= np.linalg.norm(first)
    return np.stack((first, np.cross(u, first)))


def jacobian(at, terms):
    """Dense derivatives (M B, B (5 + terms) + 3 P) of all ranges."""
    M, B, width = len(at.t), len(at.r), 5 + terms
    J = np.zeros((M, B, B * width + 3 * len(at.n)))
    ranges, of_beam, of_plane = at.ranges, list(map(tangents, at.v)), list(map(tangents, at.n))
    for m, i in np.ndindex(M, B):
        p, s = at.plane[m], ranges[m, i]
        n_hand = at.R[m].T @ at.n[p]
        c, x = n_hand @ at.v[i], at.R[m] @ (at.r[i] + s * at.v[i]) + at.t[m]
        beam = np.concatenate((n_hand, s * (of_beam[i] @ n_hand))) / -c
        J[m, i, i * width : (i + 1) * width] = [*beam, *(-(s ** np.arange(1, terms + 1)))]
        first = B * width + 3 * p
        J[m, i, first : first + 3] = [*(of_plane[p] @ x), 1.0] / -c
    return J.reshape(M * B, -1)


def deficiency(J):
    """How many directions the rows leave undetermined."""
    lengths = np.linalg.norm(J, axis=0)
    values = np.linalg.svd(J / np.where(lengths > 0.0, lengths, 1.0), compute_uv=False)
    return J.shape[1] - int((values > ROUNDING * values[0]).sum())


def undetermined(motion, walls, beams, range_error, *rows):
    """How many directions a recording leaves undetermined, with further rows."""
    at = scene(motion, walls, beams)
    terms = TERMS[range_error]
    return deficiency(np.vstack([jacobian(at, terms), *(row(at, terms) for row in rows)]))


def height(beam):
    """A measured height r_z of a beam."""

    def row(at, terms):
        return np.eye(1, len(at.r) * (5 + terms) + 3 * len(at.n), beam * (5 + terms) + 2)

    return row


def beam_on_floor(beam):
    """A beam that reads the distance to the floor, whose height is that of the wheels: r_z + s v_z."""

    def row(at, terms):
        whole = np.zeros((1, len(at.r) * (5 + terms) + 3 * len(at.n)))
        s = 0.4
        own = [0.0, 0.0, 1.0, *(s * tangents(at.v[beam])[:, 2])]
        own += [at.v[beam, 2] * s ** (k + 1) for k in range(terms)]
        whole[0, beam * (5 + terms) : (beam + 1) * (5 + terms)] = own
        return whole

    return row


def angle(first, second):
    """A known angle between two planes: the derivative of n1 . n2."""

    def row(at, terms):
        begin = len(at.r) * (5 + terms)
        whole = np.zeros((1, begin + 3 * len(at.n)))
        whole[0, begin + 3 * first :][:2] = tangents(at.n[first]) @ at.n[second]
        whole[0, begin + 3 * second :][:2] = tangents(at.n[second]) @ at.n[first]
        return whole

    return row


@pytest.mark.parametrize("beams", BEAMS)
@pytest.mark.parametrize("range_error", TERMS)
class TestTable:
    """Every row of the table, in exact arithmetic but for rounding."""

    @pytest.mark.parametrize("motion", ["planar", "SCARA"])
    def test_before_vertical_walls_every_beam_has_a_height_of_its_own(
        self, motion, beams, range_error
    ):
        """And, with k1 free, an elevation that k1 compensates."""
        of_a_beam = 1 if range_error == "none" else 2
        assert undetermined(motion, "vertical", beams, range_error) == of_a_beam * beams

    @pytest.mark.parametrize("walls", ["one leans", "two lean", "a single leaning board"])
    def test_one_plane_that_leans_ties_all_heights(self, walls, beams, range_error):
        """One common height is left, and with k1 free a vertical stretch of everything."""
        left = 1 if range_error == "none" else 2
        assert undetermined("planar", walls, beams, range_error) == left

    def test_a_floor_leans_too_but_leaves_every_elevation_against_k1(self, beams, range_error):
        left = 1 if range_error == "none" else 1 + beams
        assert undetermined("planar", "a floor", beams, range_error) == left

    @pytest.mark.parametrize(
        "walls", ["one leans", "two lean", "a single leaning board", "a floor"]
    )
    def test_moves_in_height_leave_no_stretch(self, walls, beams, range_error):
        assert undetermined("SCARA", walls, beams, range_error) == 1

    @pytest.mark.parametrize("walls", ["one leans", "two lean"])
    def test_without_turns_three_common_shifts_are_left(self, walls, beams, range_error):
        assert undetermined("never turning", walls, beams, range_error) == 3

    @pytest.mark.parametrize("motion", ["plane without turns", "linear axis"])
    def test_without_turns_and_in_a_plane_more_is_left(self, motion, beams, range_error):
        assert undetermined(motion, "two lean", beams, range_error) >= 3

    def test_a_measured_height_counts_for_one(self, beams, range_error):
        before = undetermined("planar", "vertical", beams, range_error)
        after = undetermined("planar", "vertical", beams, range_error, height(0))
        assert after == before - 1
        left = 0 if range_error == "none" else 1
        assert undetermined("planar", "one leans", beams, range_error, height(0)) == left

    def test_a_beam_on_the_floor_does_the_same_before_a_plane_that_leans(self, beams, range_error):
        left = 0 if range_error == "none" else 1
        assert undetermined("planar", "one leans", beams, range_error, beam_on_floor(0)) == left

    def test_angles_between_vertical_walls_cure_nothing(self, beams, range_error):
        known = angle(0, 1), angle(1, 2), angle(0, 3)
        before = undetermined("planar", "vertical", beams, range_error)
        assert undetermined("planar", "vertical", beams, range_error, *known) == before

    def test_an_angle_cures_the_stretch_where_the_planes_lean_differently(self, beams, range_error):
        left = 0 if range_error == "none" else 1
        upright = undetermined("planar", "one leans", beams, range_error, height(0), angle(0, 1))
        assert upright == left
        assert undetermined("planar", "one leans", beams, range_error, height(0), angle(0, 2)) == 0


@pytest.mark.parametrize("beams", BEAMS)
@pytest.mark.parametrize("range_error", TERMS)
def test_level_beams_before_vertical_walls_tell_their_elevation_in_second_order_only(
    beams, range_error
):
    """At v_z = 0 k1 makes no difference, and one beam tells the lean of no wall either."""
    at = scene("planar", "vertical", beams)
    at.v[:, 2] = 0.0
    at.v /= np.linalg.norm(at.v, axis=1, keepdims=True)
    leans = len(at.n) if beams == 1 else 0
    assert deficiency(jacobian(at, TERMS[range_error])) == 2 * beams + leans


HEIGHTS = "the height of every beam (location along (0.00, 0.00, 1.00))"
COMMON = "one common height of all beams and planes (location along (0.00, 0.00, 1.00))"
SHIFT = "a common shift of all beams and planes"
UP = "which way up the beams are: their mirror image in the plane of the motion fits as well"
SIGMA = 1e-3
NOISE_AND_BEAMS = first_and_slow((SIGMA, 2), (SIGMA, 1), (0.0, 1), (0.0, 4))


def calibrated(at, sigma, range_error="none", **noise):
    """The calibration with the given noise, without outliers."""
    given = hl.Noise(max(sigma, 1e-6), **(noise or {"pose_translation_sigma": 0.0}))
    if not noise:
        given = hl.Noise(max(sigma, 1e-6), 0.0, 0.0)
    return hl.calibrate(at.recording(sigma), given, hl.CalibrationOptions(range_error))


@pytest.mark.slow
@pytest.mark.parametrize(("sigma", "beams"), NOISE_AND_BEAMS)
@pytest.mark.parametrize(
    ("motion", "walls", "words", "cure"),
    [
        ("planar", "vertical", HEIGHTS, "add a board that leans"),
        ("SCARA", "vertical", HEIGHTS, "add a board that leans"),
        ("planar", "two lean", COMMON, "measure the height of one beam"),
        ("SCARA", "one leans", COMMON, "measure the height of one beam"),
        ("never turning", "two lean", SHIFT, "turn the hand about two different axes"),
    ],
)
def test_check_and_result_name_the_row_of_the_table(motion, walls, words, cure, sigma, beams):
    """The rank is that of the table, and what is undetermined stays near the hand."""
    if (motion, walls, sigma, beams) == ("planar", "two lean", SIGMA, 1):
        pytest.skip("one beam of this noise does not tell whether a plane leans")
    at = scene(motion, walls, beams)
    check, found = check_motion(at.recording(sigma)), calibrated(at, sigma)
    seen = found.observability
    assert found.status == "unobservable"
    assert seen.unknowns - seen.rank == undetermined(motion, walls, beams, "none")
    imaged = motion == "planar" or (motion, walls) == ("SCARA", "vertical")
    for said in (check, seen):
        named, *image = said.undetermined
        assert words in named
        assert image == [UP] * imaged
        assert said.advice[0].startswith(cure)
        assert ("against the mirror image" in said.advice[-2:][0]) == imaged
    assert words in found.message
    for i, beam in enumerate(found.beams.values()):
        assert np.linalg.norm(beam.location) < 0.4  # the true ones are within 0.26 m of the hand
        assert np.isinf(beam.sigma[2])
        if motion != "never turning":
            assert (np.abs(beam.location - at.r[i])[:2] < 4.0 * beam.sigma[:2] + 1e-6).all()
            # What is stated holds for the beam itself, and not only for it or its image.
            assert (np.abs(beam.direction - at.v[i]) < 4 * beam.sigma[3:6] + 1e-6).all()
            assert np.isinf(beam.direction_sigma) == imaged


@pytest.mark.slow
@pytest.mark.parametrize("beams", [2, 4])
@pytest.mark.parametrize(
    ("walls", "words"),
    [("vertical", "its elevation against k1"), ("one leans", "vertical stretch")],
)
def test_with_a_free_k1_elevations_are_named(walls, words, beams):
    at = scene("planar", walls, beams)
    found = calibrated(at, 0.0, "k1")
    named, *image = found.observability.undetermined
    assert words in named
    assert set(image) <= {UP}
    left = found.observability.unknowns - found.observability.rank
    # Level beams are solutions, too, before upright walls: there the walls may lean, each by itself.
    leans = len(at.n) if walls == "vertical" else 0
    assert left == undetermined("planar", walls, beams, "k1") + leans
    check = check_motion(at.recording())
    assert "where k1 is free" in check.undetermined[0]


@pytest.mark.slow
def test_check_and_calibrate_of_noisy_beams_name_the_same_motion(handlaser, tmp_path):
    """A millimetre of noise leads to walls that lean a little: more moves then than the heights."""
    path = tmp_path / "vehicle.csv"
    hl.write_recording(path, scene("planar", "vertical", 2).recording(1e-3))
    said = [handlaser(verb, path) for verb in ("check", "calibrate")]
    for code, _, err in said:
        assert code == 3
        assert HEIGHTS in err
        assert "add a board that leans by 20 to 40 degrees" in err
        assert "location, direction" not in err
    # No size of the noise was given.
    assert "given" not in said[1][1]


@pytest.mark.slow
def test_moves_in_height_leave_no_stretch_in_words():
    found = calibrated(scene("SCARA", "one leans", 2), SIGMA, "k1")
    assert "stretch" not in found.message
    assert all(np.isfinite(beam.range_error_sigma).all() for beam in found.beams.values())


@pytest.mark.slow
@pytest.mark.parametrize("motion", ["plane without turns", "linear axis"])
def test_a_linear_axis_is_named(motion):
    at = scene(motion, "two lean", 2)
    check, found = check_motion(at.recording(SIGMA)), calibrated(at, SIGMA)
    where = "along one line" if motion == "linear axis" else "in one plane"
    for said in (check, found.observability):
        assert said.undetermined == (
            f"nearly everything, because the hand never turns and moves {where} only",
        )


@pytest.mark.slow
@pytest.mark.parametrize("beams", [2, 3])
@pytest.mark.parametrize(
    ("motion", "walls", "words"),
    [
        ("planar", "vertical", HEIGHTS),
        ("planar", "two lean", COMMON),
        ("SCARA", "vertical", HEIGHTS),
    ],
)
def test_a_floor_that_is_not_flat_changes_no_word(motion, walls, words, beams):
    """A tenth of a millimetre and a hundredth of a degree determine everything, within metres."""
    at = scene(motion, walls, beams, uneven=(1e-4, 0.01))
    assert deficiency(jacobian(at, 0)) == 0
    variances = np.radians([0.003] * 3) ** 2, np.full(3, 5e-5**2)
    found = calibrated(at, SIGMA, pose_covariance=np.diag(np.concatenate(variances)))
    check = check_motion(at.recording(SIGMA))
    for said in (check, found.observability):
        named, *image = said.undetermined
        assert words in named
        assert set(image) <= {UP}


def test_motions_that_suffice_have_no_name():
    rng = np.random.default_rng(0)
    at = scene("planar", "two lean", 2)
    at.R = Rotation.from_rotvec(rng.uniform(-0.3, 0.3, (len(at.t), 3))).as_matrix()
    assert poor_motion(at.recording().readings()) is None
    assert check_motion(at.recording()).undetermined == ()
    on_the_spot = scene("turning on the spot", "two lean", 2)
    assert poor_motion(on_the_spot.recording().readings()) is None


@pytest.mark.slow
@pytest.mark.parametrize("walls", ["vertical", "one leans"])
def test_the_command_says_it(handlaser, tmp_path, walls):
    path = tmp_path / "vehicle.csv"
    hl.write_recording(path, scene("planar", walls, 2).recording(SIGMA))
    code, _, err = handlaser("check", path)
    assert code == 3
    assert (HEIGHTS if walls == "vertical" else COMMON) in err
    assert ("add a board that leans" if walls == "vertical" else "measure the height") in err


@pytest.mark.slow
def test_python_of_the_page_cures_what_a_vehicle_lacks(tmp_path, monkeypatch):
    """The section on vehicles, with a recording of a vehicle before a leaning board."""
    monkeypatch.chdir(tmp_path)
    at = scene("planar", "one leans", 2)
    hl.write_recording("vehicle.csv", at.recording(SIGMA))
    page = (ROOT / "docs" / "cell.md").read_text()
    names = {}
    for block in re.findall(r"```python\n(.*?)```", page, flags=re.DOTALL):
        exec(compile(block, "cell.md", "exec"), names)
    assert names["calibration"].status == "unobservable"
    cured = names["result"]
    assert cured.status == "converged"
    for i, beam in enumerate(cured.beams.values()):
        assert (np.abs(beam.location - at.r[i]) < 4.0 * beam.location_sigma).all()
        assert np.arccos(beam.direction @ at.v[i]) < 4.0 * np.sqrt(2.0) * beam.direction_sigma


@pytest.mark.parametrize(("motion", "walls"), [("planar", "one leans"), ("SCARA", "vertical")])
def test_no_elevation_is_stated_that_a_mirror_image_contradicts(motion, walls):
    """Upside down beams read the same: their elevations were up to 70 standard deviations off."""
    at = scene(motion, walls, 2)
    found = calibrated(at, SIGMA)
    assert UP in found.observability.undetermined
    for i, beam in enumerate(found.beams.values()):
        assert (np.abs(beam.direction - at.v[i]) < 4.0 * beam.sigma[3:6]).all()
        assert np.isinf(beam.sigma[5])
        assert np.isfinite(beam.sigma[[0, 1, 3, 4]]).all()
    if walls == "one leans":
        assert np.isinf(found.planes["C"].normal_sigma)
        assert np.isfinite(found.planes["A"].normal_sigma)
    check = check_motion(at.recording(SIGMA))
    assert UP in check.undetermined
    assert "against the mirror image" in check.advice[-2]


def test_noise_before_level_beams_is_no_lean():
    """k1 hides the elevations; leans of 39 to 72 degrees then had 4 standard deviations and more."""
    at = scene("planar", "vertical", 3, stations=8)
    across = np.hypot(at.v[:, 0], at.v[:, 1])
    v = np.column_stack((at.v[:, :2] / across[:, None], np.full(3, 1e-3)))
    n, lean = at.n * 0.5, np.sqrt(0.75)
    n[:, 2] = lean
    errors = np.column_stack((across - 1.0, np.zeros(3)))
    level = Parameters(at.r, v / np.linalg.norm(v, axis=1, keepdims=True), errors, n, 0.5 * at.b)
    assert not leans(at, level)
    board = scene("planar", "one leans", 3, stations=8)
    assert leans(board, Parameters(board.r, board.v, np.zeros((3, 2)), board.n, board.b))


def leans(at, start):
    """Whether a plane is known to lean at the minimum near some parameters."""
    readings = at.recording(SIGMA).readings()
    found = refine(start, readings, terms=0, iterations=200)
    assert found.criterion < 2.0 * SIGMA**2 * len(readings)
    return some_plane_leans(poor_motion(readings), found.parameters, readings, SIGMA)


@pytest.mark.parametrize(
    ("walls", "beams", "stations"),
    first_and_slow(("vertical", 2, 12), ("one leans", 2, 10), ("vertical", 1, 8)),
)
def test_range_errors_with_a_prior_do_not_end_at_level_beams(walls, beams, stations):
    """Free ones were where the search began: no fit, or up to 250 standard deviations off."""
    at = scene("planar", walls, beams, stations)
    found = hl.calibrate(at.recording(SIGMA))
    assert found.status == "unobservable"
    words = HEIGHTS if walls == "vertical" else COMMON
    assert words in found.observability.undetermined[0]
    assert not found.warnings
    for i, beam in enumerate(found.beams.values()):
        assert np.linalg.norm(beam.location) < 0.4
        assert (np.abs(beam.location - at.r[i]) < 4.0 * beam.sigma[:3]).all()
        assert (np.abs(beam.direction - at.v[i]) < 4.0 * beam.sigma[3:6]).all()
        assert np.isinf(beam.sigma[5]) or walls == "one leans"


@pytest.mark.parametrize(("beams", "range_error"), [(2, "k1"), (1, "k1k2")])
def test_where_an_elevation_is_undetermined_no_coordinate_of_the_direction_is_stated(
    beams, range_error
):
    """Level beams show none to first order: one was known to 0.004 degrees, and 6 degrees off.

    With k2, a step along what is undetermined led to k1 = -1, where any beam fits: that was a no-fit.
    """
    at = scene("planar", "vertical", beams)
    found = calibrated(at, SIGMA, range_error)
    assert found.status == "unobservable"
    for i, beam in enumerate(found.beams.values()):
        assert np.isinf(beam.sigma[3:6]).all()
        assert (np.abs(beam.location - at.r[i])[:2] < 4.0 * beam.sigma[:2]).all()


@pytest.mark.parametrize("motion", ["plane without turns", "never turning"])
def test_no_direction_of_a_hand_that_never_turns_is_stated_that_an_image_contradicts(motion):
    """The image in the plane of the moves, or of two normals, was up to 85 degrees off."""
    at = scene(motion, "two lean", 2)
    if motion == "never turning":
        keep = at.plane < 2
        at = replace(at, R=at.R[keep], t=at.t[keep], plane=at.plane[keep], n=at.n[:2], b=at.b[:2])
    found = calibrated(at, SIGMA)
    assert found.status == "unobservable"
    assert all(np.isinf(beam.sigma[3:6]).all() for beam in found.beams.values())


IMAGE = "its mirror image in the plane of the motion fits as well"
MOUNT = np.eye(4)
MOUNT[:3, :3] = Rotation.from_euler("ZYX", [0.2, np.pi / 2 - 0.1, 0.25]).as_matrix()
MOUNT[:3, 3] = 0.05, 0.02, 0.03
"""Where sensors sit: hand_T_sensor."""
UPRIGHT = {"plane:A": ([1.0, 0.0, 0.0], 2.0), "plane:B": ([0.3, 1.0, 0.0], 2.5)}
LEANING = {**UPRIGHT, "plane:L": ([-0.5, 0.3, 0.35], 1.6)}
"""Normals, and offsets [m] along them."""


def stations_before(walls, seed, looks):
    """Stations of a hand at a height of 0.5 m that turns about z only, 12 a wall."""
    rng = np.random.default_rng(seed)
    R, t, labels = [], [], []
    for label, (normal, offset) in walls.items():
        n = np.array(normal) / np.linalg.norm(normal)
        for _ in range(12):
            yaw = np.arctan2(n[1], n[0]) - np.arctan2(looks[1], looks[0]) + rng.uniform(-0.6, 0.6)
            level = np.array([n[0], n[1], 0.0]) / np.hypot(n[0], n[1])
            at = level * (offset - 0.5 * n[2]) / np.hypot(n[0], n[1])
            at += np.cross([0, 0, 1], level) * rng.uniform(-0.3, 0.3) - level * rng.uniform(
                0.3, 0.5
            )
            R.append(Rotation.from_euler("z", yaw).as_matrix())
            t.append([at[0], at[1], 0.5])
            labels.append(label)
    return hl.StationList(np.array(R), np.array(t), tuple(labels)), rng


def reads(walls, stations, origin, direction):
    """Ranges (M,) of a ray in the hand: n . (t + R (origin + s direction)) = offset."""
    n = np.array([np.array(walls[label][0]) for label in stations.plane_labels])
    length = np.linalg.norm(n, axis=1)
    offset = np.array([walls[label][1] for label in stations.plane_labels])
    n_hand = np.einsum("mji,mj->mi", stations.world_R_hand, n / length[:, None])
    height = (n / length[:, None] * stations.world_t_hand).sum(axis=1)
    return (offset - height - n_hand @ origin) / (n_hand @ direction)


def profiled(walls, seed, *known):
    """The survey of a profiler of 61 points, each with 0.03 mm of noise."""
    stations, rng = stations_before(walls, seed, MOUNT[:3, 2])
    x = np.linspace(-0.03, 0.03, 61)
    z = np.array(
        [reads(walls, stations, MOUNT[:3] @ [u, 0, 0, 1], MOUNT[:3, 2]) for u in x]
    ) + 3e-5 * rng.standard_normal((61, len(stations)))
    station = np.repeat(np.arange(len(stations)), 61)
    shots = hl.Shots.profiler("s", station, np.tile(x, len(stations)), z.T.ravel())
    return hl.Survey(stations, (shots,), known=known)


def mounted(sigma_deg):
    """The drawing of the mount, right to 1 mm and so many degrees."""
    return hl.Known(
        "mount", ("sensor:s",), sigma=1e-3, sigma_angle=np.radians(sigma_deg), pose=MOUNT
    )


STATED = hl.Noise(pose_translation_sigma=2e-5, pose_rotation_sigma=np.radians(0.01))


def off(result):
    """By how much the rotation of the sensor is wrong [rad]."""
    turn = Rotation.from_matrix(MOUNT[:3, :3].T @ result.sensors["s"].rotation)
    return turn.magnitude()


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 3])
@pytest.mark.parametrize("walls", [UPRIGHT, LEANING], ids=["upright", "leaning"])
def test_a_profiler_in_planar_motion_has_a_mirror_image(walls, seed):
    result = hl.calibrate(profiled(walls, seed), STATED)
    assert result.status == "undetermined"
    assert f"which way up flat sensor s is: {IMAGE}" in result.undetermined[0]
    assert ("one common height" if "plane:L" in walls else "no plane is known to lean") in (
        result.undetermined[0]
    )
    assert np.isnan(result.sensors["s"].rotation_sigma).all()
    assert np.isnan(result.sensors["s"].covariance[:3]).all()


OTHER = np.eye(4)
OTHER[:3, :3] = MOUNT[:3, :3] @ Rotation.from_euler("xyz", [12, -20, 35], degrees=True).as_matrix()
OTHER[:3, 3] = MOUNT[:3, 3] + [0.05, -0.04, 0.06]


def two_profiled(walls, seed, *known):
    """The survey of two profilers on one hand."""
    stations, rng = stations_before(walls, seed, MOUNT[:3, 2])
    x, shots = np.linspace(-0.03, 0.03, 61), []
    for name, mount in (("s", MOUNT), ("u", OTHER)):
        z = np.array(
            [reads(walls, stations, mount[:3] @ [u, 0, 0, 1], mount[:3, 2]) for u in x]
        ) + 3e-5 * rng.standard_normal((61, len(stations)))
        station = np.repeat(np.arange(len(stations)), 61)
        shots.append(hl.Shots.profiler(name, station, np.tile(x, len(stations)), z.T.ravel()))
    return hl.Survey(stations, tuple(shots), known=known)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("walls", "seed"), [(UPRIGHT, 3), (LEANING, 0)], ids=["upright", "leaning"]
)
def test_two_profilers_have_mirror_images_alone_before_upright_walls_only(walls, seed):
    """A wall that leans ties the two: then a drawing of one of them tells the other, too."""
    both = hl.calibrate(two_profiled(walls, seed), STATED)
    assert both.status == "undetermined"
    for name in "su":
        assert f"which way up flat sensor {name} is: {IMAGE}" in both.undetermined[0]
        assert np.isnan(both.sensors[name].rotation_sigma).any()
    one = hl.calibrate(two_profiled(walls, seed, mounted(5.0)), STATED)
    assert off(one) < np.radians(1.0)
    alone = "plane:L" not in walls
    assert (f"which way up flat sensor u is: {IMAGE}" in one.message) == alone
    assert "which way up flat sensor s is" not in one.message
    turn = Rotation.from_matrix(OTHER[:3, :3].T @ one.sensors["u"].rotation).magnitude()
    assert alone or turn < np.radians(1.0)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("walls", "seed"), [(UPRIGHT, 2), (LEANING, 1)], ids=["upright", "leaning"]
)
def test_a_drawing_of_the_mount_says_which_way_up_it_is(walls, seed):
    result = hl.calibrate(profiled(walls, seed, mounted(2.0)), STATED)
    assert result.status == "converged"
    assert result.usable
    assert not any(one.contradicted for one in result.relations)
    # Four standard deviations of a turn about each of three axes.
    assert off(result) < 4.0 * np.linalg.norm(result.sensors["s"].rotation_sigma)
    assert not check_survey(profiled(walls, seed, mounted(2.0)), STATED).undetermined
    vague = hl.calibrate(profiled(walls, seed, mounted(180.0)), STATED)
    assert vague.status == "undetermined"
    assert f"which way up flat sensor s is: {IMAGE}" in vague.undetermined[0]
    assert np.isfinite(vague.sensors["s"].location_sigma).all()


@pytest.mark.slow
@pytest.mark.parametrize("sigma_deg", [2.0, 180.0])
@pytest.mark.parametrize("walls", [UPRIGHT, LEANING], ids=["upright", "leaning"])
def test_a_beam_of_a_survey_has_a_mirror_image(walls, sigma_deg):
    v = MOUNT[:3, 2] + [0.0, 0.0, 0.3]
    v /= np.linalg.norm(v)
    stations, rng = stations_before(walls, 2, v)
    ranges = reads(walls, stations, MOUNT[:3, 3], v) + 3e-5 * rng.standard_normal(len(stations))
    drawn = MOUNT.copy()
    drawn[:3, :3] = Rotation.align_vectors([v], [[0, 0, 1.0]])[0].as_matrix()
    known = hl.Known(
        "mount", ("beam:b",), sigma=1e-3, sigma_angle=np.radians(sigma_deg), pose=drawn
    )
    survey = hl.Survey(stations, (), ranges[:, None], ("b",), (known,))
    result = hl.calibrate(survey, replace(STATED, range_sigma=3e-5))
    beam = result.beams["b"]
    if sigma_deg == 180.0:
        assert result.status == "undetermined"
        assert f"which way up beam b is: {IMAGE}" in result.undetermined[0]
        assert beam.direction_sigma == np.inf
    else:
        assert result.status == "converged"
        assert np.arccos(beam.direction @ v) < 4.0 * np.sqrt(2.0) * beam.direction_sigma


def three_beams_of_a_vehicle(seed, sigma_deg, turned=0.0):
    """Beams before three walls and a board, 40 stations a plane, with the mount of one in a drawing.

    Readings err by 1 mm, and poses by 0.5 mm and 0.5 mrad. The drawing is turned about z [deg].
    """
    rng = np.random.default_rng(seed)
    walls = {**UPRIGHT, "plane:C": ([-0.3, -1.0, 0.0], 2.3), "plane:L": ([1.0, 0.2, 0.6], 3.3)}
    v = np.array([[1.0, 0.1, 0.15], [0.2, 1.0, -0.2], [0.3, -1.0, 0.25]])
    v /= np.linalg.norm(v, axis=1)[:, None]
    r = np.array([[0.3, 0.05, 0.2], [0.1, 0.22, 0.35], [0.05, -0.2, 0.28]])
    label = np.repeat(list(walls), 40)
    yaw = rng.uniform(-np.pi, np.pi, len(label))
    t = rng.uniform(-1.0, 1.0, (len(label), 3)) * [1.0, 1.0, 0.0]
    turns = Rotation.from_rotvec(yaw[:, None] * [0.0, 0.0, 1.0])
    exact = hl.StationList(turns.as_matrix(), t, tuple(label))
    ranges = np.column_stack([reads(walls, exact, *beam) for beam in zip(r, v, strict=True)])
    normals = np.array([walls[one][0] for one in label])
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    cosine = np.einsum("mi,mij,bj->mb", normals, exact.world_R_hand, v)
    ranges[(cosine < 0.35) | (ranges < 0.15) | (ranges > 4.5)] = np.nan
    ranges += 1e-3 * rng.standard_normal(ranges.shape)
    errors = Rotation.from_rotvec(5e-4 * rng.standard_normal((len(label), 1)) * [0.0, 0.0, 1.0])
    at = t + 5e-4 * rng.standard_normal(t.shape) * [1.0, 1.0, 0.0]
    seen = np.isfinite(ranges).any(axis=1)
    stations = hl.StationList((errors * turns).as_matrix()[seen], at[seen], tuple(label[seen]))
    drawn = np.eye(4)
    ahead = Rotation.from_euler("z", turned, degrees=True).apply(v[0])
    drawn[:3, :3] = Rotation.align_vectors([ahead], [[0, 0, 1.0]])[0].as_matrix()
    drawn[:3, 3] = r[0]
    mount = hl.Known(
        "mount", ("beam:a",), sigma=5e-3, sigma_angle=np.radians(sigma_deg), pose=drawn
    )
    return hl.Survey(stations, (), ranges[seen], ("a", "b", "c"), (mount,)), v


OF_A_VEHICLE = hl.Noise(
    range_sigma=1e-3, pose_translation_sigma=5e-4, pose_rotation_sigma=np.radians(0.03)
)


@pytest.mark.parametrize("noise", [None, OF_A_VEHICLE], ids=["learned", "stated"])
def test_many_readings_do_not_draw_beams_of_a_vehicle_to_the_horizontal(noise):
    """Elevations were too small by one degree and more, and a true mount was contradicted."""
    survey, v = three_beams_of_a_vehicle(1, 3.0)
    result = hl.calibrate(survey, noise)
    assert result.usable
    assert not any(one.contradicted for one in result.relations)
    found = np.array([beam.direction for beam in result.beams.values()])
    # The drawing is true, and range errors are zero: nothing else tells the elevations.
    assert np.degrees(np.abs(np.arcsin(found[:, 2]) - np.arcsin(v[:, 2]))).max() < 0.6


def test_a_false_mount_of_a_vehicle_is_contradicted():
    """A drawing that is turned by ten standard deviations."""
    result = hl.calibrate(three_beams_of_a_vehicle(1, 3.0, turned=30.0)[0])
    assert result.verdict.code == "contradicted"
    assert result.relations[0].contradicted


def array_before_walls(wobble, recorded, seed):
    """An array on a vehicle before two upright walls, whose poses err by 0.2 mm, and readings by 1 mm.

    It rolls and pitches by `wobble`, and recorded turns err by `recorded` [deg].
    """
    rng = np.random.default_rng(seed)
    azimuth, wall = np.radians([0.0, 70.0]), np.repeat([0, 1], 14)
    n = np.column_stack((-np.cos(azimuth), -np.sin(azimuth), np.zeros(2)))[wall]
    yaw = azimuth[wall] + rng.uniform(-0.4, 0.4, 28)
    place = rng.uniform(-0.4, 0.4, (28, 3)) * [1.0, 1.0, 0.0]
    turns = Rotation.from_rotvec(yaw[:, None] * [0.0, 0.0, 1.0])
    turns *= Rotation.from_rotvec(np.radians(wobble) * rng.standard_normal((28, 3)) * [1, 1, 0])
    mount = np.array([[0.1, 0.0, 0.995], [1.0, 0.0, -0.1], [0.0, 1.0, 0.0]])
    mount = Rotation.from_rotvec([0.02, 0.1, -0.05]) * Rotation.from_matrix(mount)
    side = np.linspace(-0.4, 0.4, 5)
    u = np.stack(np.meshgrid(side, side, [1.0]), axis=-1).reshape(-1, 3)
    u /= np.linalg.norm(u, axis=1)[:, None]
    rays = np.einsum("mij,zj->mzi", (turns * mount).as_matrix(), u)
    start = place + turns.apply([0.1, 0.02, 0.4])
    ranges = -(1.5 + (start * n).sum(axis=1))[:, None] / np.einsum("mzi,mi->mz", rays, n)
    ranges += 1e-3 * rng.standard_normal(ranges.shape)
    R = turns * Rotation.from_rotvec(np.radians(recorded) * rng.standard_normal((28, 3)))
    labels = tuple(f"plane:{'AB'[w]}" for w in wall)
    at = place + 2e-4 * rng.standard_normal((28, 3))
    stations = hl.StationList(R.as_matrix(), at, labels)
    shots = hl.Shots.array("tof", np.repeat(np.arange(28), 25), np.tile(u, (28, 1)), ranges.ravel())
    return hl.Survey(stations, (shots,))


@pytest.mark.parametrize("recorded", [0.02, 0.1])
def test_errors_of_recorded_turns_are_no_motion_of_a_vehicle(recorded):
    """Before upright walls the height of an array is open, however poses that err wobble.

    It was "usable", half a metre off. Errors that are as usual are known before; others are learned.
    """
    found = hl.calibrate(array_before_walls(0.0, recorded, 0))
    assert found.status == "undetermined"
    assert "the height of every sensor" in found.undetermined[0]


@pytest.mark.parametrize("seed", [5, 7])
def test_poses_of_a_vehicle_are_not_taken_for_another_convention(seed):
    """A start from them may lie far along the height that they leave open: it counted as none."""
    survey, log = array_before_walls(0.0, 0.02, seed), hl.LogFormat()
    at = survey.stations.world_R_hand, survey.stations.world_t_hand
    assert refuse_wrong_reading(survey, numbers_of(*at, convention_of(log)), log) == ()


def test_turns_of_a_vehicle_on_an_uneven_floor_are_motion():
    """They are well above the errors of the poses, and tell the height as well as they can."""
    found = hl.calibrate(array_before_walls(0.5, 0.02, 0))
    assert found.verdict.usable
    tof = found.sensors["tof"]
    assert np.all(np.abs(tof.location - [0.1, 0.02, 0.4]) < 4.0 * tof.location_sigma)


@pytest.mark.parametrize("error", [0.02, 0.1])
def test_errors_of_recorded_turns_are_no_motion_of_beams(error):
    """A leaning board leaves one common height of all beams; errors of the poses tell nothing of it."""
    rng, made = np.random.default_rng(0), scene("planar", "one leans", 4)
    turns = Rotation.from_rotvec(np.radians(error) * rng.standard_normal(made.t.shape))
    recorded = made.t + 2e-4 * rng.standard_normal(made.t.shape)
    recording = made.recording(5e-4)
    wobbling = replace(recording, world_R_hand=made.R @ turns.as_matrix(), world_t_hand=recorded)
    # A station that reads nothing says nothing, wherever the hand is.
    R, ranges = wobbling.world_R_hand.copy(), wobbling.ranges.copy()
    R[3], ranges[3] = R[3] @ Rotation.from_rotvec([1.0, 0.0, 0.0]).as_matrix(), np.nan
    for one in (wobbling, replace(wobbling, world_R_hand=R, ranges=ranges)):
        found = hl.calibrate(one)
        assert found.status == "unobservable"
        assert "one common height" in found.message


def test_turns_within_pose_errors_count_where_a_relation_determines_the_rest():
    """Poses were made wrong by up to four sigmas, and a plane was falsely said to be moved."""
    survey = array_before_walls(0.06, 0.02, 0)
    pose = np.eye(4)
    plain = hl.calibrate(survey)
    pose[:3, :3] = plain.sensors["tof"].matrix()[:3, :3]
    pose[:3, 3] = [0.1, 0.02, 0.4]
    known = hl.Known("mount", ("sensor:tof",), sigma=1e-3, sigma_angle=np.radians(2.0), pose=pose)
    found = hl.calibrate(replace(survey, known=(known,)))
    assert found.usable
    assert found.survey.stations == survey.stations
    assert not {"displaced", "sigmas-too-small"} & {one.code for one in found.warnings}


def test_pose_errors_of_a_vehicle_that_are_learned_in_place_of_stated_ones_are_no_motion():
    """Stated a fifth as large, errors of turns gave a height that was "usable", 0.27 m off."""
    stated = hl.Noise(pose_rotation_sigma=np.radians(0.01), pose_translation_sigma=2e-4)
    survey = array_before_walls(0.0, 0.05, 7)
    survey = replace(survey, shots=(replace(survey.shots[0], sigma=1e-3),))
    found = hl.calibrate(survey, stated)
    assert found.status == "undetermined"
    assert "the height of every sensor" in found.undetermined[0]
    rng, made = np.random.default_rng(2), scene("planar", "one leans", 4)
    turns = Rotation.from_rotvec(np.radians(0.05) * rng.standard_normal(made.t.shape))
    recorded = made.t + 2e-4 * rng.standard_normal(made.t.shape)
    recording = replace(
        made.recording(5e-4), world_R_hand=made.R @ turns.as_matrix(), world_t_hand=recorded
    )
    result = hl.calibrate(recording, replace(stated, range_sigma=5e-4))
    assert result.status == "unobservable"
    assert "one common height" in result.message
