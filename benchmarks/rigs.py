"""Random rigs of profilers, scanners, ToF arrays, depth cameras and beams, by three generators.

    python -m benchmarks.rigs --rigs 200 [--only profiler] [--relations]

Generators that share nothing with the package, nor with each other, make rigs: mounts anywhere,
planes, spheres, points and bodies anywhere. Two of them draw only the rays that meet the labelled
target; of the third, by scene, every ray reads what it meets first. Each line is one kind of rig: how
many were found right (within what chance allows of their covariance), how many are wrong without a flag
(a coordinate beyond 5 of its standard deviations, and yet `usable`), how many were flagged (not
`usable`, right or not: the tests of range errors alone flag at most 1 in 100 sensors that have none),
how many were accused of what no rig has (`NOT_THERE`), NEES a degree of freedom of the mounts that
converged, and the median error. With --relations, relations that are true, and false by ten standard
deviations of what readings and relation say together, are stated one at a time, by the first two.
"""

import argparse
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

import handlaser_gtsam as hl
from handlaser_gtsam.errors import HandlaserError
from handlaser_gtsam.results.survey import SurveyCalibration

from . import rigs_by_distance, rigs_by_rays, rigs_by_scene

GENERATORS = {"rays": rigs_by_rays, "distance": rigs_by_distance}
HAND = 5e-5, 1.7e-4
"""Errors of the hand in the rows that have some: 0.05 mm and 0.01 degrees."""
EXACT = hl.Noise(pose_translation_sigma=0.0, pose_rotation_sigma=0.0)
STATED = hl.Noise(pose_translation_sigma=HAND[0], pose_rotation_sigma=HAND[1])
A_FIFTH = hl.Noise(pose_translation_sigma=0.2 * HAND[0], pose_rotation_sigma=0.2 * HAND[1])
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
    "profiler, a fifth stated": ("profiler", {"hand_sigma": HAND}, A_FIFTH),
    "array, a fifth stated": ("array", {"hand_sigma": HAND}, A_FIFTH),
    "mixed, a fifth stated": ("mixed", {"hand_sigma": HAND}, A_FIFTH),
    "profiler, hand called exact": ("profiler", {"hand_sigma": HAND}, EXACT),
    "mixed, hand stated": ("mixed", {"hand_sigma": HAND}, STATED),
    "mixed, hand not stated": ("mixed", {"hand_sigma": HAND}, hl.Noise()),
    "profiler, 10 % wrong": ("profiler", {"wrong_shots": 0.1, "wrong_by": "station"}, EXACT),
    "array, 10 % wrong rays": ("array", {"wrong_shots": 0.1}, EXACT),
    "array, sphere, 10 % wrong rays": (
        "array",
        {"wrong_shots": 0.1, "targets": "planes+sphere"},
        EXACT,
    ),
}
_HAND_ROWS = (
    ("profiler", "plate before a wall"),
    ("scanner", "ball before a wall"),
    ("array", "plane with clutter"),
    ("points", "planes and ball"),
)
SCENE_ROWS: dict[str, tuple[str, dict[str, Any], hl.Noise]] = {
    **{
        f"{kind}, {scene}": (kind, {"scene": scene}, EXACT)
        for scene in rigs_by_scene.SCENES
        for kind in ("profiler", "scanner", "array", "points")
        if scene != "room" or kind == "scanner"
    },
    **{
        f"{kind}, {scene}, hand {word}": (kind, {"scene": scene, "hand_sigma": HAND}, noise)
        for kind, scene in _HAND_ROWS
        for word, noise in (("stated", STATED), ("not stated", hl.Noise()))
    },
    **{
        f"{kind}, {scene}, {word}": (kind, {"scene": scene, **options}, EXACT)
        for kind, scene in _HAND_ROWS
        for word, options in (("1 mm steps", {"step": 1e-3}), ("3 % strays", {"strays": 0.03}))
    },
    **{
        f"array, {scene}, half mixed": ("array", {"scene": scene, "mixed_pixels": 0.5}, EXACT)
        for scene in ("ball on a table", "ball on a stand", "plate before a wall")
    },
}
"""Rows of the generator by scene: all scenes, some with errors of the hand and rough readings."""
RELATIONS: dict[str, tuple[str, dict[str, Any]]] = {
    "angle": ("profiler", {"planes": 4}),
    "parallel": ("profiler", {"planes": 3, "parallel": True}),
    "along": ("profiler", {"planes": 3}),
    "upright": ("profiler", {"planes": 3}),
    "plane": ("profiler", {"planes": 3}),
    "radius": ("profiler", {"targets": "planes+sphere", "planes": 3}),
    "position": ("profiler", {"targets": "planes+sphere", "planes": 3}),
    "distance": ("profiler", {"targets": "spheres", "spheres": 2}),
    "body": ("profiler", {"targets": "body", "planes": 4}),
    "mount": ("profiler", {"planes": 3}),
    "mounts": ("mixed", {"sensors": ("profiler", "array"), "planes": 3}),
}
"""What each relation is tried on."""
LENGTH_STATED, ANGLE_STATED = 1e-5, 1e-4
"""Standard deviations of the relations [m], [rad]."""
SAME_SPREAD = 0.05
"""A mount is less sure where its standard deviation grew by more: sizes of the noise are estimated."""
FAR = 5.0
"""Standard deviations beyond which a coordinate is wrong."""
NOT_THERE = {"displaced", "range-error", "another-mount"}
"""Codes of warnings of what no rig has."""
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


def row_of(name: str, row: tuple[str, dict[str, Any], hl.Noise], generator: Any, rigs: int) -> str:
    """Return what is said of one kind of rig."""
    kind, options, noise = row
    right = wrong = flagged = accused = mounts = 0
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
        accused += bool(NOT_THERE & {warning.code for warning in result.warnings})
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
        f"{name:44} {right:4} of {rigs} right, {wrong} of {mounts} mounts wrong unflagged, "
        f"{flagged} flagged, {accused} accused, NEES {np.mean(nees or [np.nan]):.2f}, "
        f"median {1e3 * np.median(shifts or [np.nan]):.3f} mm, {seconds:.2f} s"
    )


def relation_rows(generator: Any, rigs: int) -> Iterator[str]:
    """Yield how relations of each kind fare that are true, and false."""
    for relation, (kind, options) in RELATIONS.items():
        alarms = worse = named = stated = 0
        far: list[float] = []
        for seed in range(rigs):
            print(f"\r{relation}: {seed + 1} of {rigs} ", end="", file=sys.stderr, flush=True)
            rig = getattr(generator, kind)(seed, **options)
            plain = hl.calibrate(survey_of(rig), EXACT)
            true, false = stated_relation(rig, plain, relation)
            after = hl.calibrate(survey_of(rig, [true]), EXACT)
            contradicted = hl.calibrate(survey_of(rig, [false]), EXACT).relations[0]
            stated += 1
            alarms += after.relations[0].contradicted
            worse += _spread(after) > (1.0 + SAME_SPREAD) * _spread(plain)
            named += contradicted.contradicted
            far += [float(np.abs(_shift(rig, name, after)).max()) for name in after.sensors]
        print("\r" + " " * 60 + "\r", end="", file=sys.stderr)
        yield (
            f"{relation:10} {stated} true: {alarms} called contradicted, {worse} widened mounts, "
            f"mounts off by at most {max(far):.1f} sigma; {stated} false: {named} named"
        )


def _spread(result: SurveyCalibration) -> float:
    """Return the largest standard deviation of a mount's location."""
    return max(float(s.location_sigma.max()) for s in result.sensors.values())


def _shift(rig: Any, name: str, result: SurveyCalibration) -> np.ndarray:
    """Return the error of a mount's location in its standard deviations, along the axes of the hand."""
    sensor = result.sensors[name]
    return np.asarray((truth_of(rig, name)[:3, 3] - sensor.location) / sensor.location_sigma)


def stated_relation(rig: Any, plain: SurveyCalibration, relation: str) -> tuple[hl.Known, hl.Known]:
    """Return a relation that is true, and one that is false by ten standard deviations.

    These are what the relation and the readings alone say together; where two variables are tied, as
    if their errors were independent.
    """
    targets = rig.truth["targets"]
    planes = [label for label in targets if label.startswith("plane:")]
    spheres = [label for label in targets if label.startswith("sphere:")]
    sensors = list(rig.tables)
    sigma, sigma_angle = LENGTH_STATED, ANGLE_STATED
    x_axis = np.array([1.0, 0.0, 0.0])

    def off(stated: float, *others: float) -> float:
        return 10.0 * float(np.linalg.norm([stated, *others]))

    def spread(label: str, *names: str) -> float:
        return float(max(plain.targets[label].sigma[name] for name in names))

    if relation in ("radius", "position", "distance"):
        centre = [targets[label]["centre"] for label in spheres]
        sigmas = [spread(label, "x", "y", "z") for label in spheres]
        if relation == "radius":
            value = targets[spheres[0]]["radius"]
            true = hl.Known("radius", (spheres[0],), value, sigma)
            return true, replace(true, value=value + off(sigma, spread(spheres[0], "radius")))
        if relation == "position":
            true = hl.Known("position", (spheres[0],), 0.0, sigma, direction=centre[0])
            return true, replace(true, direction=centre[0] + off(sigma, sigmas[0]) * x_axis)
        value = float(np.linalg.norm(centre[0] - centre[1]))
        true = hl.Known("distance", tuple(spheres[:2]), value, sigma)
        return true, replace(true, value=value + off(sigma, *sigmas[:2]))
    if relation == "body":
        true = replace(body_of(rig)[0], sigma=sigma, sigma_angle=sigma_angle)
        assert true.faces is not None
        tilts = [spread(face, "tilt") for face in true.of]
        normals = true.faces[:, :3].copy()
        # Towards another face: no turn of the body as a whole does that.
        other = normals[np.argmin(np.abs(normals @ normals[0]))]
        towards = other - (other @ normals[0]) * normals[0]
        normals[0] += off(sigma_angle, *tilts) * towards / np.linalg.norm(towards)
        return true, replace(true, faces=np.column_stack((normals, true.faces[:, 3])))
    if relation in ("mount", "mounts"):
        poses = [truth_of(rig, name) for name in sensors]
        pose = poses[0] if relation == "mount" else np.linalg.inv(poses[0]) @ poses[1]
        of = tuple(f"sensor:{name}" for name in sensors[: 1 if relation == "mount" else 2])
        mounts = [plain.sensors[name].location_sigma.max() for name in sensors[: len(of)]]
        turns = [plain.sensors[name].rotation_sigma.max() for name in sensors[: len(of)]]
        if relation == "mounts":
            # Of a turn of the first sensor, the second is shifted by as much as it is far.
            mounts.append(float(np.linalg.norm(pose[:3, 3])) * turns[0])
        true = hl.Known(relation, of, 0.0, sigma, sigma_angle, pose=pose)
        moved = pose.copy()
        moved[0, 3] += off(sigma, *mounts)
        return true, replace(true, pose=moved)
    if relation in ("angle", "parallel"):
        _, first, second, value = next(one for one in rig.known if _is_of(one, relation))
        tilts = [spread(label, "tilt") for label in (first, second)]
        if relation == "angle":
            true = hl.Known("angle", (first, second), value, 0.0, sigma_angle)
            step = off(sigma_angle, *tilts)
            return true, replace(true, value=value + (step if value < np.pi / 2 else -step))
        true = hl.Known("parallel", (first, second), value, sigma, sigma_angle)
        return true, replace(
            true, value=value + off(sigma, *[spread(label, "offset") for label in (first, second)])
        )
    label = planes[0]
    normal, tilt = targets[label]["normal"], spread(label, "tilt")
    aside = np.linalg.svd(normal[None])[2][1]
    if relation == "plane":
        value = targets[label]["offset"]
        true = hl.Known("plane", (label,), value, sigma, sigma_angle, direction=normal)
        return true, replace(true, value=value + off(sigma, spread(label, "offset")))
    direction = normal if relation == "along" else aside
    turned = direction + off(sigma_angle, tilt) * (aside if relation == "along" else normal)
    true = hl.Known(relation, (label,), 0.0, 0.0, sigma_angle, direction=direction)
    return true, replace(true, direction=turned)


def _is_of(relation: tuple[Any, ...], kind: str) -> bool:
    """Tell whether a true relation is of a kind; angles near 0 and 180 degrees tell little."""
    return relation[0] == kind and (kind != "angle" or 0.2 < relation[3] < np.pi - 0.2)


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
            for row in relation_rows(generator, given.rigs):
                print(row, flush=True)
            continue
        for row in ROWS:
            if given.only in row:
                print(row_of(row, ROWS[row], generator, given.rigs), flush=True)
    if given.relations:
        return
    print("generator by scene", flush=True)
    for row in SCENE_ROWS:
        if given.only in row:
            print(row_of(row, SCENE_ROWS[row], rigs_by_scene, given.rigs), flush=True)


if __name__ == "__main__":
    main()
