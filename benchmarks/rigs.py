"""Random rigs of profilers, scanners, ToF arrays, depth cameras and beams, by two generators.

    python -m benchmarks.rigs --rigs 200 [--only profiler] [--relations]

Two generators that share nothing with the package, nor with each other, make rigs: mounts anywhere,
planes, spheres, points and bodies anywhere. Each line is one kind of rig: how many were found right
(within what chance allows of their covariance), how many are wrong without a flag (a coordinate beyond
5 of its standard deviations, and yet `usable`), how many were flagged (not `usable`, right or not: the
tests of range errors alone flag at most 1 in 100 sensors that have none), NEES a degree of freedom of
the mounts that converged, and the median error. With --relations, relations that are true, and false by
ten standard deviations of what readings and relation say together, are stated one at a time.
"""

import argparse
import sys
import time
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

import handlaser_gtsam as hl
from handlaser_gtsam.errors import HandlaserError
from handlaser_gtsam.results import SurveyCalibration

from . import rigs_by_distance, rigs_by_rays

GENERATORS = {"rays": rigs_by_rays, "distance": rigs_by_distance}
HAND = 5e-5, 1.7e-4
"""Errors of the hand in the rows that have some: 0.05 mm and 0.01 degrees."""
EXACT = hl.Noise(pose_translation_sigma=0.0, pose_rotation_sigma=0.0)
STATED = hl.Noise(pose_translation_sigma=HAND[0], pose_rotation_sigma=HAND[1])
ROWS: dict[str, tuple[str, dict[str, Any], hl.Noise]] = {
    "profiler": ("profiler", {}, EXACT),
    "scanner": ("scanner", {}, EXACT),
    "array": ("array", {}, EXACT),
    "points": ("points", {}, EXACT),
    "profiler, sphere": ("profiler", {"targets": "sphere"}, EXACT),
    "scanner, sphere": ("scanner", {"targets": "sphere"}, EXACT),
    "array, sphere": ("array", {"targets": "sphere"}, EXACT),
    "array, spheres": ("array", {"targets": "spheres"}, EXACT),
    "profiler, planes and sphere": ("profiler", {"targets": "planes+sphere"}, EXACT),
    "profiler, body": ("profiler", {"targets": "body"}, EXACT),
    "beams, point": ("beams", {"targets": "point", "stations": 15}, EXACT),
    "mixed": ("mixed", {}, EXACT),
    "profiler, hand stated": ("profiler", {"hand_sigma": HAND}, STATED),
    "profiler, hand not stated": ("profiler", {"hand_sigma": HAND}, hl.Noise()),
    "array, hand stated": ("array", {"hand_sigma": HAND}, STATED),
    "profiler, sphere, hand stated": (
        "profiler",
        {"targets": "sphere", "hand_sigma": HAND},
        STATED,
    ),
    "mixed, hand stated": ("mixed", {"hand_sigma": HAND}, STATED),
    "mixed, hand not stated": ("mixed", {"hand_sigma": HAND}, hl.Noise()),
    "profiler, 10 % wrong": ("profiler", {"wrong_shots": 0.1, "wrong_by": "station"}, EXACT),
    "array, 10 % wrong rays": ("array", {"wrong_shots": 0.1}, EXACT),
}
FAR = 5.0
"""Standard deviations beyond which a coordinate is wrong."""
BY_CHANCE = 1e-6
"""A rig is right if an error of its size is more probable than this."""


def survey_of(rig: Any, known: Sequence[hl.Known] = ()) -> hl.Survey:
    """Return a rig as a survey."""
    stations = hl.StationList(rig.R, rig.t, tuple(rig.label))
    shots, names, ranges = [], [], []
    for name, table in rig.tables.items():
        station, kind = table["station"], table["kind"]
        if kind == "profiler":
            shots.append(hl.Shots.profiler(name, station, table["x"], table["z"]))
        elif kind == "scanner":
            shots.append(hl.Shots.scanner(name, station, table["angle"], table["reading"]))
        elif kind == "array":
            directions = np.asarray(table["directions"])[table["zone"]]
            shots.append(
                hl.Shots.array(name, station, directions, table["reading"], table["convention"])
            )
        elif kind == "points":
            xyz = np.stack([table[axis] for axis in "xyz"], axis=1)
            shots.append(hl.Shots.points(name, station, xyz))
        else:
            column = np.full(len(rig.R), np.nan)
            column[station] = table["reading"]
            names.append(name)
            ranges.append(column)
    columns = np.stack(ranges, axis=1) if ranges else None
    return hl.Survey(stations, tuple(shots), columns, tuple(names), tuple(known))


def truth_of(rig: Any, name: str) -> np.ndarray:
    """Return hand_T_sensor; generators have a scan in the plane y = 0, its angle zero along z."""
    T = np.array(rig.truth[name])
    if rig.tables[name]["kind"] == "scanner":
        T[:3, :3] = T[:3, [2, 0, 1]]
    return T


def errors_of(rig: Any, result: SurveyCalibration) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield the error of each mount with its covariance."""
    for name, sensor in result.sensors.items():
        T, R = truth_of(rig, name), sensor.rotation
        turn = Rotation.from_matrix(R.T @ T[:3, :3]).as_rotvec()
        yield np.concatenate((turn, R.T @ (T[:3, 3] - sensor.location))), sensor.covariance[:6, :6]
    for name, beam in result.beams.items():
        truth = rig.truth[name]
        yield truth["location"] - beam.location, beam.covariance[:3, :3]


def body_of(rig: Any) -> list[hl.Known]:
    """Return the body that the planes of a rig are faces of, in a frame of its own."""
    labels = sorted(label for label in set(rig.label) if label.startswith("plane:"))
    if len(labels) < 2:
        return []
    R, t = Rotation.from_rotvec([0.3, -0.2, 0.5]).as_matrix(), np.array([0.1, 0.2, -0.3])
    faces = []
    for label in labels:
        plane = rig.truth["targets"][label]
        n = R @ plane["normal"]
        faces.append([*n, -plane["offset"] + n @ t])
    return [hl.Known("body", tuple(labels), sigma=1e-5, sigma_angle=1e-5, faces=np.array(faces))]


def row_of(name: str, generator: Any, rigs: int) -> str:
    """Return what is said of one kind of rig."""
    kind, options, noise = ROWS[name]
    right = wrong = flagged = mounts = 0
    nees: list[float] = []
    shifts: list[float] = []
    begin = time.process_time()
    for seed in range(rigs):
        print(f"\r{name}: {seed + 1} of {rigs} ", end="", file=sys.stderr, flush=True)
        rig = getattr(generator, kind)(seed, **options)
        known = body_of(rig) if options.get("targets") == "body" else []
        try:
            result = hl.calibrate(survey_of(rig, known), noise)
        except HandlaserError:
            flagged += 1
            continue
        flagged += not result.usable
        if result.status != "converged":
            continue
        good = True
        for error, C in errors_of(rig, result):
            mounts += 1
            square = float(error @ np.linalg.solve(C, error))
            nees.append(square / len(error))
            shifts.append(float(np.linalg.norm(error[-3:])))
            far = bool((np.abs(error) > FAR * np.sqrt(np.diagonal(C))).any())
            wrong += far and result.usable
            good &= bool(chi2.sf(square, len(error)) > BY_CHANCE)
        right += good
    print("\r" + " " * 60 + "\r", end="", file=sys.stderr)
    seconds = (time.process_time() - begin) / rigs
    return (
        f"{name:32} {right:4} of {rigs} right, {wrong} of {mounts} mounts wrong unflagged, "
        f"{flagged} flagged, NEES {np.mean(nees):.2f}, median {1e3 * np.median(shifts):.3f} mm, "
        f"{seconds:.2f} s"
    )


def relations_row(generator: Any, rigs: int) -> str:
    """Return how relations that are true, and false, fare."""
    worse = named = false = alarms = true = 0
    for seed in range(rigs):
        print(f"\rrelations: {seed + 1} of {rigs} ", end="", file=sys.stderr, flush=True)
        rig = generator.profiler(seed, targets="planes+sphere", planes=3)
        plain = hl.calibrate(survey_of(rig), EXACT)
        before = max(s.location_sigma.max() for s in plain.sensors.values())
        for known, by in _relations(rig, plain):
            after = hl.calibrate(survey_of(rig, [known]), EXACT)
            true += 1
            alarms += after.relations[0].contradicted
            sigma = max(s.location_sigma.max() for s in after.sensors.values())
            worse += bool(sigma > 1.05 * before)
            off = hl.Known(
                known.relation, known.of, known.value + by, known.sigma, known.sigma_angle
            )
            false += 1
            named += hl.calibrate(survey_of(rig, [off]), EXACT).relations[0].contradicted
    print("\r" + " " * 60 + "\r", end="", file=sys.stderr)
    return (
        f"relations: of {true} true ones {alarms} called contradicted, {worse} made the mount worse; "
        f"of {false} false ones {named} named"
    )


def _relations(rig: Any, plain: SurveyCalibration) -> Iterator[tuple[hl.Known, float]]:
    """Yield true relations, and by how much ten standard deviations make them false."""
    ball = plain.targets["sphere:S1"]
    value, sigma = rig.truth["targets"]["sphere:S1"]["radius"], 1e-5
    both = float(np.hypot(sigma, ball.sigma["radius"]))
    yield hl.Known("radius", ("sphere:S1",), value, sigma), 10.0 * both
    for relation, first, second, angle in rig.known:
        if relation == "angle" and 0.2 < angle < 2.9:
            sigma = 1e-4
            tilts = [plain.targets[label].sigma["tilt"] for label in (first, second)]
            both = float(np.hypot(sigma, float(np.linalg.norm(tilts))))
            yield hl.Known("angle", (first, second), angle, 0.0, sigma), 10.0 * both
            return


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rigs", type=int, default=200)
    parser.add_argument("--only", default="")
    parser.add_argument("--relations", action="store_true")
    given = parser.parse_args()
    for name, generator in GENERATORS.items():
        print(f"generator by {name}", flush=True)
        if given.relations:
            print(relations_row(generator, given.rigs), flush=True)
            continue
        for row in ROWS:
            if given.only in row:
                print(row_of(row, generator, given.rigs), flush=True)


if __name__ == "__main__":
    main()
