"""Vehicles, SCARA arms and linear axes: what their motion determines, before which walls.

The ranks are those of Jacobians that are written here once more, densely and without the package. In
natural units a range s along a beam (r, v) of the hand pose (R, t) to the plane (n, b) changes by

    ds/dr = -n_H / c,   ds/dv = -s n_H / c,   ds/dk = -(s, s^2),   ds/dn = -x / c,   ds/db = -1 / c

with n_H = R' n, c = n_H . v and the spot x = R (r + s v) + t.
"""

from dataclasses import dataclass

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import handlaser_gtsam as hl

WALLS = {
    "vertical": [(0, 0), (60, 0), (-50, 0), (150, 0)],
    "one leans": [(0, 0), (60, 0), (-50, 25)],
    "two lean": [(0, 0), (60, 20), (-50, -30)],
    "a single leaning board": [(0, 25)],
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
    for m, i in np.ndindex(M, B):
        n, s = at.n[at.plane[m]], at.ranges[m, i]
        n_hand = at.R[m].T @ n
        c, x = n_hand @ at.v[i], at.R[m] @ (at.r[i] + s * at.v[i]) + at.t[m]
        beam = np.concatenate((n_hand, s * (tangents(at.v[i]) @ n_hand))) / -c
        J[m, i, i * width : (i + 1) * width] = [*beam, *(-(s ** np.arange(1, terms + 1)))]
        first = B * width + 3 * at.plane[m]
        J[m, i, first : first + 3] = [*(tangents(n) @ x), 1.0] / -c
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

    @pytest.mark.parametrize("walls", ["one leans", "two lean", "a single leaning board"])
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
