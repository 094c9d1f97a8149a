"""The interface that users of SciPy, GTSAM and Polars expect."""

import ast
import copy
import dataclasses
import inspect
import json
import pydoc
import re

import annotations
import gtsam
import numpy as np
import pytest
from helpers import ROOT

import handlaser_gtsam as hl
from handlaser_gtsam.estimation.solution import covariance

EXACT = {"pose_translation_sigma": 0.0, "pose_rotation_sigma": 0.0}


@pytest.fixture(scope="module")
def calibration(gripper):
    return hl.calibrate(gripper, hl.Noise(range_sigma=3e-5))


# --- names -------------------------------------------------------------------------------------------


def test_everything_that_is_taken_or_returned_has_a_public_name():
    public = {thing for thing in annotations.offered().values() if inspect.isclass(thing)}
    missing = {
        kind for kind in annotations.reachable() if not kind.__name__.startswith("_")
    } - public
    inside = {kind for kind in missing if annotations.is_inside(kind)}
    bases = {
        kind
        for kind in missing
        if any(issubclass(name, kind) for name in public if kind not in inside)
    }
    assert missing - inside - bases == set()


LAZY = ("", *sorted({"data", "estimation", "files", "observability", "planning", "results"}))
LAZY += ("session", "solvers", "validation")


@pytest.mark.parametrize("module", LAZY)
def test_type_checkers_see_the_names_that_there_are(module):
    """What imports for type checkers say is what there is, and from where."""
    package = getattr(hl, module) if module else hl
    tree = ast.parse((ROOT / "handlaser_gtsam" / module / "__init__.py").read_text())
    seen = {
        alias.asname: (node.level, node.module or "")
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom) and node.level and node.module != "lazy"
        for alias in node.names
        if alias.asname
    }
    assert sorted(seen) == dir(package)
    for name, (level, home) in seen.items():
        thing = getattr(package, name)
        if not inspect.ismodule(thing) and hasattr(thing, "__module__"):
            root = package.__name__ if level == 1 else "handlaser_gtsam"
            assert thing.__module__ == f"{root}.{home}"


def test_the_top_is_small_and_help_names_all_of_it():
    assert len(dir(hl)) <= 70
    named = set(re.findall(r"\w+", hl.__doc__))
    assert set(dir(hl)) <= named
    assert len(pydoc.render_doc(hl).splitlines()) < 120  # a few screens


def test_every_public_name_stands_once():
    """At the top or in one module, but for factors and the mathematics, which are whole modules."""
    homes = [name for name in dir(hl) if not inspect.ismodule(getattr(hl, name))]
    for module in LAZY[1:]:
        homes += dir(getattr(hl, module))
    assert len(homes) == len(set(homes))


def test_a_name_that_stands_in_a_module_is_pointed_at():
    with pytest.raises(AttributeError, match=r"it is handlaser_gtsam\.planning\.Workspace$"):
        hl.Workspace  # noqa: B018
    with pytest.raises(AttributeError, match=r"it is handlaser_gtsam\.factors\.BeamKeys$"):
        hl.BeamKeys  # noqa: B018
    with pytest.raises(AttributeError, match=r"no attribute 'Workplace'$"):
        hl.Workplace  # noqa: B018
    assert not hasattr(hl, "__wrapped__")


# --- results -----------------------------------------------------------------------------------------


def test_success_is_one_word(calibration, gripper):
    assert calibration.success is True
    keep = hl.CalibrationOptions(outliers="keep")
    assert hl.calibrate(gripper.part([0, 1, 2]), hl.Noise(3e-5, **EXACT), keep).success is False


CASES = {
    "scales integrated over": (hl.Noise(range_sigma=3e-5), hl.CalibrationOptions()),
    "equal weights": (
        hl.Noise(3e-5, **EXACT),
        hl.CalibrationOptions(range_error="k1k2"),
    ),
    "sigma estimated": (hl.Noise(None, **EXACT), hl.CalibrationOptions(range_error="k1")),
    "robust": (hl.Noise(3e-5, **EXACT), hl.CalibrationOptions(loss="huber")),
    "poses estimated": (
        hl.Noise(3e-5, 5e-5, 1e-4),
        hl.CalibrationOptions(range_error="k1", poses="estimated"),
    ),
}


@pytest.mark.parametrize("case", CASES)
def test_the_graph_is_the_problem_that_was_solved(gripper, case):
    """Its cost is the calibration's, and the values are its optimum: a solver moves them no more."""
    noise, options = CASES[case]
    found = hl.calibrate(gripper, noise, options)
    problem, values = found.problem(), found.values
    graph = found.graph
    if options.poses == "estimated":  # poses start where they were recorded
        values = hl.optimize(graph, values).values
    assert graph.error(values) == pytest.approx(found.cost, rel=1e-5)
    again = hl.optimize(graph, values)
    assert again.status == "converged"
    moved = hl.solvers.read_parameters(problem, again.values)
    at = found.parameters() if found.at_scales is None else found.at_scales.parameters
    joint = found.covariance if found.at_scales is None else found.at_scales.covariance
    sigma = np.sqrt(np.diagonal(joint.matrix(planes=[]))).reshape(-1, 8)[:, :3]
    assert (np.abs(moved.locations - at.locations) < 1e-3 * sigma).all()
    if options.loss == "gaussian":
        squares = found.fit.chi2 if found.fit.range_sigma_given else found.fit.dof
        assert 2.0 * found.cost == pytest.approx(squares, rel=1e-9)
        # The graph's own covariance is the calibration's; poses as variables agree to their rounding.
        own, whole = covariance(problem, values).matrix(planes=[]), joint.matrix(planes=[])
        every = np.sqrt(np.diagonal(whole))
        assert (np.abs(own - whole) <= 1e-3 * np.outer(every, every)).all()


def test_a_rejected_reading_is_not_in_the_graph(gripper):
    ranges = gripper.ranges.copy()
    ranges[3, 1] += 0.01
    spoilt = dataclasses.replace(gripper, ranges=ranges)
    found = hl.calibrate(spoilt, hl.Noise(3e-5, **EXACT), hl.CalibrationOptions(range_error="k1"))
    assert [(r.station, r.sensor) for r in found.fit.rejected] == [
        (gripper.station_names[3], gripper.beam_names[1])
    ]
    rows = sum(len(block.distance) for block in found.problem().blocks)
    assert rows == found.fit.readings == (~np.isnan(ranges)).sum() - 1


def test_a_graph_needs_the_recording(calibration):
    without = dataclasses.replace(calibration, recording=None)
    with pytest.raises(hl.InputError, match="without its recording"):
        without.graph  # noqa: B018


def test_tables_name_their_units(calibration):
    beams, planes = calibration.to_polars()
    assert beams.columns[:10] == [
        "beam",
        "terms",
        "x_m",
        "y_m",
        "z_m",
        "vx",
        "vy",
        "vz",
        "k1",
        "k2_per_m",
    ]
    assert planes.columns[:5] == ["plane", "nx", "ny", "nz", "b_m"]
    assert beams["beam"].to_list() == list(calibration.beams)
    for row, beam in zip(beams.iter_rows(named=True), calibration.beams.values(), strict=True):
        assert [row["x_m"], row["y_m"], row["z_m"]] == beam.location.tolist()
        assert row["k2_per_m"] == beam.range_error[1]
        assert [row["vz_sigma"], row["k2_sigma_per_m"]] == beam.sigma[[5, 7]].tolist()
    for row, plane in zip(planes.iter_rows(named=True), calibration.planes.values(), strict=True):
        assert [row["nx"], row["b_m"]] == [plane.normal[0], plane.offset]
        assert row["b_sigma_m"] == plane.offset_sigma
    unknown = dataclasses.replace(
        calibration,
        beams={n: dataclasses.replace(b, sigma=None) for n, b in calibration.beams.items()},
    )
    assert unknown.to_polars()[0]["x_sigma_m"].null_count() == len(beams)


# --- files -------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("case", ["determined", "undetermined", "robust"])
def test_a_calibration_file_is_read_as_it_was_written(tmp_path, calibration, gripper, case):
    found = calibration
    if case == "undetermined":
        found = hl.calibrate(gripper.part([0, 1, 2, 3]), hl.Noise(3e-5, **EXACT))
        assert not found.success
    if case == "robust":
        found = hl.calibrate(gripper, hl.Noise(), hl.CalibrationOptions(loss="tukey"))
    path = tmp_path / "first.json"
    hl.write_calibration(path, found)
    read = hl.read_calibration(path)
    assert read.model_dump(mode="json") == json.loads(path.read_text())
    assert read == hl.read_calibration(path) == copy.deepcopy(read)
    assert (read.status, read.success) == (found.status, found.success)
    assert read.fit.rms_m == found.fit.rms
    for one, beam in zip(read.beams, found.beams.values(), strict=True):
        assert one.name == beam.name
        assert one.location_m == tuple(beam.location)
        assert (one.covariance is None) == (beam.covariance is None)
    assert [one.code for one in read.warnings] == [one.code for one in found.warnings]
    with pytest.raises(AttributeError):
        read.fit.residuals  # noqa: B018  a file does not hold them


def test_a_field_that_has_come_since_is_kept(tmp_path, calibration):
    path = tmp_path / "calibration.json"
    hl.write_calibration(path, calibration)
    path.write_text(path.read_text().replace('"iterations"', '"rounds": 1, "iterations"'))
    assert hl.read_calibration(path).rounds == 1


# --- recordings --------------------------------------------------------------------------------------


@pytest.fixture
def poses(gripper):
    pairs = zip(gripper.world_R_hand, gripper.world_t_hand, strict=True)
    return [gtsam.Pose3(gtsam.Rot3(R), t) for R, t in pairs]


def test_a_recording_of_pose3_or_matrices_is_the_same(gripper, poses):
    labels = gripper.plane_labels
    of_objects = hl.Recording.from_poses(poses, gripper.ranges, labels)
    of_matrices = hl.Recording.from_poses(
        np.array([pose.matrix() for pose in poses]), gripper.ranges, labels
    )
    by_hand = hl.Recording(
        np.array([pose.rotation().matrix() for pose in poses]),
        gripper.world_t_hand,
        gripper.ranges,
        labels,
        ("1", "2", "3", "4"),
    )
    assert of_objects == of_matrices == by_hand


def test_one_name_is_the_plane_of_all_stations(gripper, poses):
    found = hl.Recording.from_poses(poses, gripper.ranges, "wall", beam_names=["a", "b", "c", "d"])
    assert found.plane_names == ("wall",)
    assert found.beam_names == ("a", "b", "c", "d")


def test_masked_readings_are_none(gripper, poses):
    mask = np.zeros(gripper.ranges.shape, dtype=bool)
    mask[5, 2] = mask[7, 0] = True
    masked = np.ma.array(np.where(mask, 9.9, gripper.ranges), mask=mask)
    empty = np.where(mask, np.nan, gripper.ranges)
    labels = gripper.plane_labels
    found = hl.Recording.from_poses(poses, masked, labels)
    assert found == hl.Recording.from_poses(poses, empty, labels)
    assert np.isnan(found.ranges[5, 2])


TRANSPOSED = gtsam.Pose3(gtsam.Rot3(), [1.0, 0.0, 0.0]).matrix().T
R, T, D = np.eye(3)[None], np.zeros((1, 3)), [[0.1]]
REFUSED = {
    "transposed poses": (
        lambda: hl.Recording.from_poses([TRANSPOSED], D, "A"),
        "not its transpose",
    ),
    "one pose": (
        lambda: hl.Recording.from_poses(gtsam.Pose3(), D, "A"),
        "a sequence of gtsam.Pose3",
    ),
    "one row": (lambda: hl.Recording.from_poses([np.eye(4)], [0.1], "A"), "(M, B)"),
    "planes 3": (lambda: hl.Recording.from_poses([np.eye(4)], D, 3), "a sequence of texts"),
    "letters": (lambda: hl.Recording(R, T, D, "A", ("1",)), "a sequence of texts"),
    "text": (lambda: hl.Recording(R, T, [["0.1"]], ("A",), ("1",)), "no array of numbers"),
    "bools": (lambda: hl.Recording(R, T, [[True]], ("A",), ("1",)), "no array of numbers"),
    "loss": (
        lambda: hl.CalibrationOptions(loss="hubber"),
        "'gaussian', 'huber', 'cauchy', 'tukey'",
    ),
    "outliers": (lambda: hl.CalibrationOptions(outliers="drop"), "'reject', 'keep'"),
    "range error": (
        lambda: hl.CalibrationOptions(range_error="k2"),
        "'auto', 'none', 'k1', 'k1k2'",
    ),
    "poses": (
        lambda: hl.CalibrationOptions(poses="fixed"),
        "'auto', 'exact', 'marginalised', 'estimated'",
    ),
    "shapes": (lambda: hl.Parameters(1, 2, 3, 4, 5), "arrays of shapes"),
    "joining none": (lambda: hl.join([]), "a sequence of recordings"),
    "joining others": (lambda: hl.join([3]), "handlaser_gtsam.Recording(...)"),
    "writing": (lambda: hl.write_recording("x.csv", 3), "handlaser_gtsam.Recording(...)"),
    "writing another": (
        lambda: hl.write_calibration("x.json", 3),
        "handlaser_gtsam.Calibration(...)",
    ),
    "a sensor": (lambda: hl.read_recording("x.csv", 3), "handlaser_gtsam.Sensor(...)"),
    "a spot": (lambda: hl.spot(3, "1", 0.01), "handlaser_gtsam.Calibration(...)"),
    "mounts": (lambda: hl.Mounts.of(3), "handlaser_gtsam.Calibration(...)"),
    "a graph": (lambda: hl.solvers.build_graph(3, 3, 0, 1.0), "handlaser_gtsam.data.Readings(...)"),
    "a generator": (
        lambda: hl.validate(hl.Recording(R, T, D, ("A",), ("1",)), rng=3),
        "numpy.random.default_rng(...)",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_cannot_be_is_refused_in_one_line_that_says_what_can(case):
    run, words = REFUSED[case]
    with pytest.raises(hl.InputError) as caught:
        run()
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


OPTIONS = (
    hl.CalibrationOptions,
    hl.solvers.LevenbergOptions,
    hl.Limits,
    hl.LogFormat,
    hl.Noise,
    hl.observability.ObservabilityOptions,
    hl.Plausible,
    hl.Sensor,
)


@pytest.mark.parametrize("kind", OPTIONS, ids=lambda kind: kind.__name__)
def test_no_option_takes_any_object(kind):
    for field in dataclasses.fields(kind):
        with pytest.raises(hl.InputError):
            kind(**{field.name: object()})


def test_names_of_what_is_not_there_list_what_is(calibration):
    for ask in (
        lambda: calibration.intervals("9"),
        lambda: hl.spot(calibration, "9", 0.01),
        lambda: calibration.covariance.matrix(["9"]),
    ):
        with pytest.raises(hl.InputError, match="one of 1, 2, 3, 4"):
            ask()
    with pytest.raises(hl.InputError, match="a sequence"):
        calibration.covariance.matrix("1")


# --- the summary -------------------------------------------------------------------------------------


def test_the_summary_is_what_the_command_prints(handlaser):
    folder = ROOT / "examples" / "gripper"
    _, printed, _ = handlaser("calibrate", folder / "recording.csv", "--rig", folder / "rig.toml")
    rig = hl.read_rig(folder / "rig.toml")
    recording = hl.read_recording(folder / "recording.csv", rig.sensor)
    options = hl.CalibrationOptions(sensor=rig.sensor)
    found = hl.calibrate(recording, rig.noise, options)
    summary, advice = printed.split("next best stations")  # which `hl.plan` chooses
    assert found.summary(rig.limits) == summary.rstrip("\n")
    assert advice.count("before plane") == 3


def test_a_calibration_without_its_recording_has_a_summary(calibration):
    without = dataclasses.replace(calibration, recording=None)
    (line,) = [
        line for line in without.summary().splitlines() if line.startswith("4 planes, 4 beams")
    ]
    assert f"44 stations, {line}" in calibration.summary().splitlines()
