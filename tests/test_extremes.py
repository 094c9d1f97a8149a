"""Numbers beyond sense in arrays and graphs: an error made on purpose, never one of linear algebra."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from helpers import GRIPPER

import handlaser_gtsam as hl

PROFILER = GRIPPER.parent / "profiler"
BEAM = hl.factors.BeamKeys(1, 2)
EXTREMES = [1e308, -1e308, 1e160, np.inf, -np.inf, 10**400, "x", None]
NAMES = [repr(value)[:8] for value in EXTREMES]


@pytest.fixture(scope="module")
def recording():
    return hl.read_recording(GRIPPER / "recording.csv")


@pytest.fixture(scope="module")
def mounts():
    directions = np.array([[0.0, 0.0, 1.0], [0.0, 0.6, 0.8]])
    return hl.Mounts(
        ("1", "2"), 0.01 * directions, directions, np.zeros((2, 2)), (2, 2), 1e-8 * np.eye(16), 3e-5
    )


def with_one(values, value):
    """Return nested lists with one number replaced, whatever its type."""
    array = np.array(values, dtype=object)
    array.flat[1] = value
    return array.tolist()


@pytest.mark.parametrize("value", EXTREMES, ids=NAMES)
@pytest.mark.parametrize("name", ["world_R_hand", "world_t_hand", "ranges"])
def test_recordings(recording, name, value):
    if name == "ranges" and value is None:
        pytest.skip("None is no reading, as NaN is")
    with pytest.raises(hl.InputError):
        replace(recording, **{name: with_one(getattr(recording, name), value)})


@pytest.mark.parametrize("value", EXTREMES, ids=NAMES)
@pytest.mark.parametrize("name", ["locations", "directions", "range_errors", "covariance"])
def test_mounts(mounts, name, value):
    with pytest.raises(hl.InputError):
        replace(mounts, **{name: with_one(getattr(mounts, name), value)})


@pytest.mark.parametrize("value", EXTREMES, ids=NAMES)
def test_factors(value):
    for make in (
        lambda: hl.factors.range_to_plane(BEAM, 3, [gtsam.Pose3()], [value], 3e-5),
        lambda: hl.factors.range_to_plane(BEAM, 3, [gtsam.Pose3()], [0.1], value),
        lambda: hl.factors.range_to_plane_from_pose(BEAM, 3, 4, value, 3e-5),
        lambda: hl.factors.range_error_prior(5, [value, 0.1]),
        lambda: hl.factors.beam_drift(BEAM, hl.factors.BeamKeys(11, 12), value, 0.1),
    ):
        with pytest.raises(hl.InputError):
            make()


def graph_and_values(x):
    poses = [gtsam.Pose3(), gtsam.Pose3(gtsam.Rot3.Rx(0.1), [0.0, 0.0, 0.01])]
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    graph.push_back(hl.factors.range_to_plane(BEAM, 3, poses, [0.021, 0.013], 3e-5))
    values.insert(1, np.array([x, 0.0, 0.0]))
    values.insert(2, gtsam.Unit3(np.array([0.0, 0.0, 1.0])))
    values.insert(3, gtsam.OrientedPlane3(0.0, 0.0, 1.0, -0.02))
    return graph, values


@pytest.mark.parametrize("x", [1e308, -1e308, 1e160, np.inf, np.nan])
def test_values_of_a_graph(x):
    graph, values = graph_and_values(x)
    with pytest.raises(hl.InputError, match="in the value of 1"):
        hl.optimize(graph, values)
    with pytest.raises(hl.InputError, match="in the value of 1"):
        hl.read_graph(graph, values, beams={"laser": BEAM}, planes={"wall": 3})


@pytest.mark.parametrize("name", ["", " a", "\x1b[31m", "\u202ea", "a" * 201, 3, None, ("a",)])
def test_names_that_cannot_be(recording, name):
    graph, values = graph_and_values(0.0)
    labels = tuple(recording.plane_labels)
    stations = tuple(recording.station_names)
    for make in (
        lambda: recording.renamed("1", name),
        lambda: replace(recording, plane_labels=(name, *labels[1:])),
        lambda: replace(recording, station_names=(name, *stations[1:])),
        lambda: replace(recording, ignored_columns=(name,)),
        lambda: hl.read_graph(graph, values, beams={name: BEAM}, planes={"wall": 3}),
        lambda: hl.read_graph(graph, values, beams={"laser": BEAM}, planes={name: 3}),
    ):
        with pytest.raises(hl.InputError) as caught:
            make()
        assert str(caught.value).isprintable()
        assert len(str(caught.value)) < 300


@pytest.mark.parametrize("path", [None, 3, "a\0b", b"a"])
def test_what_is_no_path(path):
    for read in (hl.read_recording, hl.read_rig, hl.read_mounts):
        with pytest.raises(hl.InputError, match="as a path"):
            read(path)


@pytest.mark.parametrize("count", [-1, 0.5, True, 10**30])
def test_counts(recording, count):
    with pytest.raises(hl.InputError, match="splits"):
        hl.validate(recording, splits=count)


def test_arguments_of_other_types(recording, mounts):
    for run in (
        lambda: hl.hold_out(mounts, "recording.csv"),
        lambda: hl.hold_out(mounts, recording, 3e-5),
        lambda: hl.hold_out(recording, mounts),
        lambda: hl.cross_check("result.json", recording),
        lambda: hl.Session(3e-5),
    ):
        with pytest.raises(hl.InputError, match="of type"):
            run()


# Errors of the hand that are 1e5 to 1e9 times those of a reading, which sums of them lose to rounding.
STATED = [
    (1e-9, 0.1, None),
    (1e-9, None, 1.0),
    (None, 1.0, 0.0),
    (1e-9, 1.0, 1.0),
]


@pytest.mark.slow
@pytest.mark.parametrize(("reading", "translation", "rotation"), STATED)
def test_noise_of_beams(recording, reading, translation, rotation):
    noise = hl.Noise(
        range_sigma=reading, pose_translation_sigma=translation, pose_rotation_sigma=rotation
    )
    try:
        result = hl.calibrate(recording, noise)
    except hl.HandlaserError:
        return  # one line that says what is wrong is an answer
    assert not result.verdict.usable


@pytest.mark.slow
@pytest.mark.parametrize(
    ("reading", "translation", "rotation"), [(1e-9, 0.0, None), (1e-9, 0.1, 0.0)]
)
def test_noise_of_surveys(reading, translation, rotation):
    survey = hl.read_survey(PROFILER / "poses.csv", PROFILER / "rig.toml")
    shots = tuple(replace(shot, sigma=reading) for shot in survey.shots)
    noise = hl.Noise(pose_translation_sigma=translation, pose_rotation_sigma=rotation)
    result = hl.calibrate(replace(survey, shots=shots), noise)
    # Readings scatter by 0.04 mm inside shots: a millionth of it cannot be confirmed.
    assert not result.verdict.usable
    assert "sigmas-too-small" in {cause.code for cause in result.verdict.causes}
