"""Whether standard deviations are right on an arm whose joints, links and gears err: Monte Carlo.

    python -m benchmarks.arm_errors [--runs 40] [--jobs 2] [--again]

Two beams, a profiler or a depth camera on an arm go through a programme before each of four plates,
the same or another one each time. Lengths and twists of its links, zeros of its joints and the
eccentricity of its gears differ from what it believes, so that the errors of its hand are smooth in its
pose. Beside that only readings err. The constant part of the errors of the hand belongs to the mount,
because no reading shows it. Each line has the mean square of the errors of a mount in standard
deviations (1 is right), the median of the recordings, how many of them have a location beyond three and
five standard deviations (and are plainly usable all the same), and how many are usable, usable with
care, and neither. With --again, how often what is true is contradicted: that nothing has moved, by
another recording of the same arm and sensor with programmes and plates of its own (and the mean
statistic a degree of freedom), and, in surveys, two angles between plates that are stated to 0.002
degrees; and how often a sensor is found that has moved by 3 mm across and along its axis. Nothing of
the simulation is shared with the package.
"""

import argparse
from dataclasses import dataclass, replace
from functools import partial
from itertools import product

import numpy as np
from scipy.spatial.transform import Rotation

import handlaser_gtsam as hl
from benchmarks.robot_arm import DH_A, DH_ALPHA, DH_D, POSTURE
from benchmarks.studies import Studies, add_options
from handlaser_gtsam.arrays import FloatArray
from handlaser_gtsam.data.station_list import StationList
from handlaser_gtsam.data.survey import Kind, Known, Shots, Survey

LENGTH, ANGLE, GEAR = 2e-4, 2e-4, 1e-4
"""What links [m], twists and zeros [rad], and each of two harmonics of a gear [rad] err by."""
REACH = np.radians([8.0, 6.0, 8.0, 20.0, 20.0, 70.0])
"""How far the joints go from their posture."""
STOPS = 12
"""Of a programme."""
TILTS = np.radians([[0, 0, 0], [22, 0, 0], [-12, 20, 0], [-10, -20, 0]])
"""Of the plates, by about which they lean from the middle of the programme."""
DISTANCE, STEEP = 0.55, 0.5
"""From the middle of the programme to the plates [m]; least cosine of incidence."""
SIGMA = {"beams": 5e-5, "profiler": 5e-5, "camera": 2e-4}
"""Of a reading [m]."""
KIND: dict[str, Kind] = {"profiler": "profiler", "camera": "points"}
ANGLE_SIGMA = np.radians(0.002)
"""Of angles between plates that are stated."""
MOVED = 3e-3
"""By which a sensor moves across and along its axis [m]."""
ACROSS = np.linspace(-0.04, 0.04, 50)
"""Of the points of a profile [m]."""
VIEW = np.linspace(-0.3, 0.3, 10)
"""Directions of a camera [rad]."""


@dataclass(frozen=True, slots=True)
class Case:
    """One line of the study; `scale` is on all errors of the arm."""

    sensor: str
    is_same: bool
    is_stated: bool
    scale: float = 1.0

    @property
    def name(self) -> str:
        """The same in words."""
        programme = "same programme" if self.is_same else "other programmes"
        noise = "stated" if self.is_stated else "nothing given"
        return f"{self.sensor}, {self.scale:g} of the errors, {programme}, {noise}"


class Arm:
    """An arm that believes its nominal links."""

    def __init__(self, rng: np.random.Generator, scale: float) -> None:
        self.a, self.d = (scale * LENGTH * rng.normal(size=6) for _ in range(2))
        self.alpha, self.zero = (scale * ANGLE * rng.normal(size=6) for _ in range(2))
        self.gear = scale * GEAR * rng.normal(size=(2, 6))
        self.phase = rng.uniform(0.0, 2.0 * np.pi, (2, 6))

    def hands(self, q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return where the hand is believed to be, and is, at joints (N, 6): (N, 4, 4)."""
        off = self.zero + sum(self.gear[k] * np.sin((k + 1) * q + self.phase[k]) for k in range(2))
        true = _hands(q + off, DH_A + self.a, DH_D + self.d, DH_ALPHA + self.alpha)
        return _hands(q, DH_A, DH_D, DH_ALPHA), true


def _hands(q: FloatArray, a: FloatArray, d: FloatArray, alpha: FloatArray) -> FloatArray:
    """Return the poses (N, 4, 4) of the hand for links by Denavit and Hartenberg."""
    hand = np.tile(np.eye(4), (len(q), 1, 1))
    for joint in range(6):
        turn = Rotation.from_rotvec(q[:, joint, None] * [0.0, 0.0, 1.0])
        twist = Rotation.from_rotvec([alpha[joint], 0.0, 0.0])
        step = np.tile(np.eye(4), (len(q), 1, 1))
        step[:, :3, :3] = (turn * twist).as_matrix()
        step[:, :3, 3] = turn.apply([a[joint], 0.0, d[joint]])
        hand = hand @ step
    return hand


class Scene:
    """A sensor on an arm before four plates, and what it reads; `again` with others, maybe moved."""

    def __init__(self, case: Case, seed: int, *, again: bool = False, moved: float = 0.0) -> None:
        rng = np.random.default_rng(seed)
        arm, self.case = Arm(rng, case.scale), case
        count = 2 if case.sensor == "beams" else 1
        self.r = rng.uniform(-0.05, 0.05, (count, 3))
        self.R = Rotation.from_rotvec(rng.normal(0.0, 0.15, (count, 3)))
        if again:
            rng = np.random.default_rng((seed, 1))
        middle = arm.hands(POSTURE[None])[0][0]
        ahead = Rotation.from_matrix(middle[:3, :3])
        tilts = TILTS + rng.uniform(-0.1, 0.1, (4, 3))
        normals = self.normals = (ahead * Rotation.from_rotvec(tilts)).apply([0.0, 0.0, 1.0])
        offsets = normals @ middle[:3, 3] + DISTANCE
        joints: list[FloatArray] = []
        while len(joints) < (1 if case.is_same else 4) * STOPS:
            q = POSTURE + REACH * rng.uniform(-1.0, 1.0, 6)
            axes = arm.hands(q[None])[1][0, :3, :3] @ self.R.apply([0.0, 0.0, 1.0]).T
            if (normals @ axes > STEEP).all():
                joints.append(q)
        if case.is_same:
            joints *= 4
        self.believed, hands = arm.hands(np.array(joints))
        self.plate = np.repeat(np.arange(4), STOPS)
        errors = np.linalg.inv(self.believed) @ hands
        turns = Rotation.from_matrix(errors[:, :3, :3]).as_rotvec()
        self.turn, self.shift = turns.std(axis=0).mean(), errors[:, :3, 3].std(axis=0).mean()
        # What is constant belongs to the mount.
        constant = Rotation.from_rotvec(turns.mean(axis=0))
        self.truth = constant * self.R, constant.apply(self.r) + errors[:, :3, 3].mean(axis=0)
        self.readings = [
            self._read(hands, normals, offsets, r + np.array((moved, 0.0, moved)), R, rng)
            for r, R in zip(self.r, self.R, strict=True)
        ]

    def _rays(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return origins and directions (n, 3) in the sensor, and what tells the rays apart."""
        if self.case.sensor == "beams":
            return np.zeros((1, 3)), np.array([[0.0, 0.0, 1.0]]), np.zeros((1, 1))
        if self.case.sensor == "profiler":
            origins = np.stack((ACROSS, 0.0 * ACROSS, 0.0 * ACROSS), axis=1)
            return origins, np.tile([0.0, 0.0, 1.0], (len(ACROSS), 1)), ACROSS[:, None]
        x, y = (part.ravel() for part in np.meshgrid(np.tan(VIEW), np.tan(VIEW)))
        rays = np.stack((x, y, np.ones_like(x)), axis=1)
        rays /= np.linalg.norm(rays, axis=1)[:, None]
        return np.zeros_like(rays), rays, rays

    def _read(
        self,
        hands: FloatArray,
        normals: FloatArray,
        offsets: FloatArray,
        r: FloatArray,
        R: Rotation,
        rng: np.random.Generator,
    ) -> FloatArray:
        """Return the readings (N, n) of one sensor at all stations."""
        origins, rays, _ = self._rays()
        turn, shift, n = hands[:, :3, :3], hands[:, :3, 3], normals[self.plate]
        starts = (R.apply(origins) + r) @ np.swapaxes(turn, 1, 2) + shift[:, None]
        along = R.apply(rays) @ np.swapaxes(turn, 1, 2)
        ahead = offsets[self.plate][:, None] - np.einsum("mni,mi->mn", starts, n)
        exact = ahead / np.einsum("mni,mi->mn", along, n)
        return np.asarray(exact + rng.normal(0.0, SIGMA[self.case.sensor], exact.shape))

    @property
    def noise(self) -> hl.Noise:
        """What is stated: how large the errors of the hand are, less what is constant."""
        if not self.case.is_stated:
            return hl.Noise()
        sigma = SIGMA["beams"] if self.case.sensor == "beams" else None
        return hl.Noise(sigma, pose_translation_sigma=self.shift, pose_rotation_sigma=self.turn)

    def recording(self) -> hl.Recording:
        """Return what two beams read."""
        R, t = self.believed[:, :3, :3], self.believed[:, :3, 3]
        labels = tuple(f"p{plate}" for plate in self.plate)
        ranges = np.hstack(self.readings)
        return hl.Recording(R, t, ranges, plane_labels=labels, beam_names=("a", "b"))

    def survey(self) -> Survey:
        """Return what a sensor of many rays saw."""
        R, t = self.believed[:, :3, :3], self.believed[:, :3, 3]
        _, _, across = self._rays()
        station = np.repeat(np.arange(len(R)), len(across))
        every_ray = np.tile(across, (len(R), 1))
        shots = Shots("s", KIND[self.case.sensor], station, every_ray, self.readings[0].ravel())
        labels = tuple(f"plane:p{plate}" for plate in self.plate)
        return Survey(StationList(R, t, labels), (shots,))

    def squares(self) -> tuple[float, float, str]:
        """Return the mean square error of the mounts, the largest error of r, and the verdict."""
        turns, r = self.truth
        if self.case.sensor == "beams":
            found = hl.calibrate(self.recording(), self.noise)
            assert found.covariance is not None, "everything is determined"
            squares, far = [], []
            v = turns.apply([0.0, 0.0, 1.0])
            every = zip(found.beams.values(), r, v, found.covariance.all_beams(), strict=True)
            for beam, at, towards, C in every:
                e = np.concatenate((beam.location - at, beam.direction - towards))
                squares.append(e @ np.linalg.pinv(C[:6, :6], rcond=1e-9) @ e / 5.0)
                far.append(np.abs(beam.location - at) / beam.location_sigma)
            return float(np.mean(squares)), float(np.max(far)), found.verdict.code
        survey = hl.calibrate(self.survey(), self.noise)
        mount = survey.sensors["s"]
        own = Rotation.from_matrix(mount.rotation)
        e = np.concatenate(
            ((own.inv() * turns[0]).as_rotvec(), own.inv().apply(r[0] - mount.location))
        )
        square = float(e @ np.linalg.solve(mount.covariance, e)) / 6.0
        far_by = float(np.max(np.abs(r[0] - mount.location) / mount.location_sigma))
        return square, far_by, survey.judged().code


def run_once(case: Case, seed: int) -> tuple[float, float, str]:
    """Return the `squares` of one recording."""
    return Scene(case, seed).squares()


def contradicted_once(case: Case, seed: int) -> tuple[float, bool, bool, bool]:
    """Return the statistic a degree of freedom of another recording, and what is contradicted.

    That nothing has moved where that is true, and where it is not, and true angles between plates.
    """
    scene = Scene(case, seed)
    others = [Scene(case, seed, again=True, moved=moved) for moved in (0.0, MOVED)]
    if case.sensor == "beams":
        calibration = hl.calibrate(scene.recording(), scene.noise)
        held = [hl.hold_out(calibration, one.recording(), one.noise) for one in others]
        return held[0].drift / held[0].drift_dof, not held[0].holds, not held[1].holds, False
    found = hl.calibrate(scene.survey(), scene.noise)
    of_survey = [hl.hold_out(found, one.survey(), one.noise) for one in others]
    n = scene.normals
    known = tuple(
        Known("angle", (f"plane:p{i}", f"plane:p{i + 1}"), angle, sigma_angle=ANGLE_SIGMA)
        for i, angle in ((i, float(np.arccos(n[i] @ n[i + 1]))) for i in (0, 2))
    )
    related = hl.calibrate(replace(scene.survey(), known=known), scene.noise)
    mount, false = of_survey[0].mounts[0], any(test.contradicted for test in related.relations)
    accused, seen = (not one.holds for one in of_survey)
    return mount.statistic / mount.dof, accused, seen, false


def study_again(runs: int, studies: Studies) -> None:
    """Print a line for every case: whether what is true is contradicted, and a move found."""
    for case in (Case(*of) for of in product(SIGMA, (False, True), (True, False))):
        found = studies.each(case.name, partial(contradicted_once, case), range(100, 100 + runs))
        statistic, accused, seen, false = np.array(found, dtype=float).T
        angles = "" if case.sensor == "beams" else f"; angles contradicted in {false.sum():.0f}"
        studies.show(
            f"{case.name:60} of {runs} accused {accused.sum():.0f}, "
            f"{statistic.mean():.2f} a degree of freedom; moved {seen.sum():.0f} found{angles}"
        )


def study(runs: int, studies: Studies) -> None:
    """Print a line for every case."""
    cases = [Case(*of) for of in product(SIGMA, (False, True), (True, False))]
    cases += [Case(sensor, False, False, scale) for sensor in SIGMA for scale in (0.3, 0.0)]
    for case in cases:
        found = studies.each(case.name, partial(run_once, case), range(100, 100 + runs))
        squares, far = (np.array([one[i] for one in found], dtype=float) for i in range(2))
        codes = [one[2] for one in found]
        usable, care = codes.count("usable"), codes.count("usable-with-care")
        unsaid = sum(one[1] > 5.0 and one[2] == "usable" for one in found)
        studies.show(
            f"{case.name:60} {squares.mean():.2f}, median {np.median(squares):.2f}, "
            f"beyond three {(far > 3.0).sum()}, five {(far > 5.0).sum()} ({unsaid} usable), "
            f"usable {usable}, with care {care}, else {runs - usable - care}"
        )


def main() -> None:
    """Print a line a case as soon as it is done."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=40)
    parser.add_argument("--again", action="store_true", help="is what is true contradicted?")
    add_options(parser)
    arguments = parser.parse_args()
    with Studies.of(arguments) as studies:
        (study_again if arguments.again else study)(arguments.runs, studies)


if __name__ == "__main__":
    main()
