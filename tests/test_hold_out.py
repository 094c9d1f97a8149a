"""Does an old calibration hold: for beams that stayed, and for one that was displaced."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2, f, kstest

import handlaser_gtsam as hl
from handlaser_gtsam.data.parameters import Parameters
from handlaser_gtsam.validation.scenes import SCENES, Layout
from handlaser_gtsam.validation.simulate import Errors, simulate

SIGMA = 3e-5
NOISE = hl.Noise(SIGMA, 0.0, 0.0)


def two_days(seed, turned=0.0, planes=2):
    """Return recordings of one rig before and after, its second beam turned in between [rad]."""
    rng = np.random.default_rng(seed)
    truth, stations = SCENES["unplanned"](Layout(3, 3, 12, 0.01, 0.1), rng)
    other, later = SCENES["unplanned"](Layout(3, planes, 12), np.random.default_rng(1000 + seed))
    v = truth.directions.copy()
    v[1] += [turned, 0.0, 0.0]
    v /= np.linalg.norm(v, axis=1, keepdims=True)
    moved = Parameters(truth.locations, v, truth.range_errors, other.normals, other.offsets)
    sensor = hl.Sensor(0.0, 0.1)
    first = simulate(truth, stations, Errors(SIGMA), rng)
    return first, simulate(moved, later, Errors(SIGMA), rng, sensor)


def mounts(recording):
    return hl.Mounts.of(hl.calibrate(recording, NOISE, hl.CalibrationOptions("k1k2")))


def still(seeds):
    """Mounts, and the second recording, of days between which nothing moved."""
    return [(mounts(a), b) for a, b in map(two_days, seeds)]


@pytest.fixture(scope="module")
def undisturbed():
    return still(range(2))


@pytest.fixture(scope="module")
def thirty():
    return still(range(30))


@pytest.mark.slow
@pytest.mark.parametrize("told", [True, False])
def test_p_values_are_uniform_where_nothing_moved(thirty, told):
    found = [hl.hold_out(m, b, NOISE if told else None) for m, b in thirty]
    # Thirty draws: a test at a hundredth would be wrong once in a hundred seeds.
    assert kstest([one.p_value for one in found], "uniform").pvalue > 0.01
    assert kstest([b.p_value for one in found for b in one.beams], "uniform").pvalue > 0.01
    if told:
        assert kstest([one.noise_p_value for one in found], "uniform").pvalue > 0.01
    else:
        assert all(np.isnan(one.noise_p_value) for one in found)


def test_a_turned_beam_is_named():
    first, second = two_days(3, turned=0.03)
    found = hl.hold_out(mounts(first), second, NOISE)
    assert found.p_value < 1e-6
    assert min(found.beams, key=lambda beam: beam.p_value).name == "2"
    assert found.beams[1].turn == pytest.approx(0.03, rel=0.3)
    assert found.noise_p_value > 1e-3


def test_a_turned_beam_alone_explains_it():
    """The falls of the others are as significant, but leave what cannot be chance."""
    first, second = two_days(3, turned=0.03)
    found = hl.hold_out(mounts(first), second, NOISE, explain=True)
    assert not found.holds
    assert all(beam.p_value < 1e-3 for beam in found.beams)
    assert [one.values["beam"] for one in found.explained_by] == ["2"]


@pytest.mark.parametrize("turned", [0.03, 1.2])
def test_a_beam_that_was_bent_far_is_named_too(turned):
    """Freed, it does not fit where it was: the others tell."""
    first, second = two_days(4, turned=turned)
    causes = hl.hold_out(mounts(first), second, explain=True).explained_by
    assert [one.values["beam"] for one in causes] == ["2"]


def of_another_tool(b):
    """Return the poses of a tool frame that is elsewhere by 10 cm and turned by 3 degrees."""
    turn = Rotation.from_rotvec([0.0, 0.0, 0.05]).as_matrix()
    t = b.world_t_hand + b.world_R_hand @ [0.0, 0.06, 0.08]
    return replace(b, world_R_hand=b.world_R_hand @ turn, world_t_hand=t)


def with_a_wrong_label(b):
    other = next(name for name in b.plane_labels if name != b.plane_labels[4])
    return replace(b, plane_labels=(*b.plane_labels[:4], other, *b.plane_labels[5:]))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (of_another_tool, {"shift": 0.1, "turn": 0.05}),
        (lambda b: replace(b, beam_names=("3", "2", "1")), {"first": "3", "second": "1"}),
        (with_a_wrong_label, {"station": "5"}),
        (lambda b: replace(b, world_t_hand=1e3 * b.world_t_hand), {"mistake": "positions"}),
    ],
)
def test_what_explains_it_by_itself_is_named(undisturbed, change, expected):
    m, b = undisturbed[0]
    (cause,) = hl.hold_out(m, change(b), explain=True).explained_by
    for name, value in expected.items():
        if isinstance(value, float):  # the standard deviations of the mounts are a tenth of it
            assert cause.values[name] == pytest.approx(value, rel=0.3)
        else:
            assert value in cause.values[name]


@pytest.mark.slow
def test_readings_in_another_unit_are_named(undisturbed):
    """Planes lie along beams then, or fit no beams."""
    m, b = undisturbed[0]
    for lengths, what in (
        ({"ranges": 1e3 * b.ranges}, "the ranges look like millimetres"),
        ({"ranges": b.ranges / 0.0254}, "the ranges look like inches"),
        ({"ranges": 1e3 * b.ranges, "world_t_hand": 1e3 * b.world_t_hand}, "all lengths"),
    ):
        try:
            words = hl.hold_out(m, replace(b, **lengths), explain=True).explained_by[0].message
        except hl.InputError as error:
            words = str(error)
        assert what in words


def test_readings_that_fit_no_beams_do_not_pass(undisturbed):
    """Noise that is learned from the readings is as large as they want it."""
    m, b = undisturbed[0]
    found = hl.hold_out(m, replace(b, world_t_hand=b.world_t_hand * [1.0, -1.0, 1.0]))
    assert found.misfit > 10.0
    assert not found.holds


def test_the_drift_is_the_difference_of_two_fits():
    """The quadratic of hold_out against solving again: both recordings apart, and together."""
    first, second = two_days(5)
    options = hl.CalibrationOptions("none", outliers="keep")
    bare = [
        replace(r, plane_labels=tuple(n + p for p in r.plane_labels))
        for r, n in ((first, "a"), (second, "b"))
    ]
    both = hl.Recording(
        *(
            np.concatenate([getattr(r, name) for r in bare])
            for name in ("world_R_hand", "world_t_hand", "ranges")
        ),
        bare[0].plane_labels + bare[1].plane_labels,
        first.beam_names,
    )
    apart = [hl.calibrate(r, NOISE, options) for r in bare]
    together = hl.calibrate(both, NOISE, options)
    expected = together.fit.chi2 - sum(one.fit.chi2 for one in apart)
    found = hl.hold_out(apart[0], second, NOISE)
    assert found.drift_dof == 15
    # Linearised at the beams of the first recording, tenths of a sigma from the joint ones.
    assert found.drift == pytest.approx(expected, rel=0.05)
    assert found.chi2 == pytest.approx(apart[1].fit.chi2, rel=0.05)


def test_robot_errors_count(undisturbed):
    m, b = undisturbed[0]
    exact = hl.hold_out(m, b, NOISE)
    loose = hl.hold_out(m, b, hl.Noise(SIGMA, 1e-3, 0.0))
    assert loose.drift < exact.drift
    assert loose.chi2 < 0.7 * exact.chi2


def test_a_recording_of_few_stations_tests_what_it_can(undisturbed):
    m, b = undisturbed[1]
    few = hl.Recording(
        b.world_R_hand[:2], b.world_t_hand[:2], b.ranges[:2], b.plane_labels[:2], b.beam_names
    )
    found = hl.hold_out(m, few, NOISE)
    assert found.readings == np.isfinite(few.ranges).sum() == 6
    # Six readings less the three unknowns of the plane tell so many combinations of the beams.
    assert found.drift_dof == 3
    assert 1e-3 < found.p_value <= 1.0


def test_beams_that_were_not_calibrated_are_refused(undisturbed):
    m, b = undisturbed[0]
    with pytest.raises(hl.InputError, match="beam 'x'"):
        hl.hold_out(m, replace(b, beam_names=("1", "2", "x")), NOISE)


def test_mounts_come_back_from_their_file(tmp_path, undisturbed):
    first, second = two_days(0)
    calibration = hl.calibrate(first, NOISE, hl.CalibrationOptions("k1k2"))
    path = tmp_path / "mounts.json"
    hl.write_calibration(path, calibration)
    back = hl.read_mounts(path)
    assert back.names == ("1", "2", "3")
    assert np.array_equal(back.covariance, hl.Mounts.of(calibration).covariance)
    assert hl.hold_out(back, second, NOISE).p_value == pytest.approx(
        hl.hold_out(undisturbed[0][0], second, NOISE).p_value
    )


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("{", "no JSON"),
        ("[]", "calibration of handlaser"),
        ('{"format": "handlaser-truth"}', "format"),
        ("[" * 100000, "no JSON"),
    ],
)
def test_files_that_are_no_calibration_are_refused(tmp_path, text, words):
    path = tmp_path / "broken.json"
    path.write_text(text)
    with pytest.raises(hl.InputError, match=words):
        hl.read_mounts(path)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda t: t.replace('"converged"', '"not_converged"', 1), "that is not_converged"),
        (lambda t: t.replace('"version": 1', '"version": 2', 1), "version"),
        (lambda t: t.replace('"direction": [', '"direction": [7, ', 1), "direction"),
    ],
)
def test_calibrations_that_were_changed_by_hand_are_refused(tmp_path, change, words):
    first, _ = two_days(0)
    path = tmp_path / "mounts.json"
    hl.write_calibration(path, hl.calibrate(first, NOISE, hl.CalibrationOptions("none")))
    path.write_text(change(path.read_text()))
    with pytest.raises(hl.InputError, match=words):
        hl.read_mounts(path)


def test_few_stations_give_no_false_alarm_without_a_sigma(undisturbed):
    """Three stations cannot tell their own noise: that of the calibration stands for it."""
    found = []
    for m, b in undisturbed:
        few = b.part([0, 1, 2])
        found.append(hl.hold_out(m, few).p_value)
    assert np.nanmin(found) > 1e-3
    first, second = two_days(3, turned=0.2)
    assert hl.hold_out(mounts(first), second.part(np.arange(6))).p_value < 1e-3


def test_a_sigma_learned_from_few_readings_counts_as_learned(tmp_path):
    """With chi2 in place of F, 5 of 388 such calibrations were contradicted; 1 is with F."""
    recording, later = two_days(3, planes=2)
    few = hl.calibrate(recording.part(np.arange(0, 36, 3)), hl.Noise(None, 0.0, 0.0))
    dof = few.fit.dof
    assert 3 < dof < 20
    assert hl.Mounts.of(hl.calibrate(recording, NOISE)).dof == np.inf
    old, path = hl.Mounts.of(few), tmp_path / "few.json"
    hl.write_calibration(path, few)
    assert (old.dof, hl.read_mounts(path).dof) == (dof, dof)
    for none in (0.0, np.nan):
        with pytest.raises(hl.InputError, match="found dof"):
            replace(old, dof=none)
    found = hl.hold_out(old, later, NOISE)
    known = hl.hold_out(replace(old, dof=np.inf), later, NOISE)
    assert found.drift == known.drift
    assert known.p_value == pytest.approx(chi2.sf(known.drift, known.drift_dof))
    expected = f.sf(found.drift / found.drift_dof, found.drift_dof, dof)
    assert found.p_value == pytest.approx(expected)


def test_covariances_of_other_stations_are_refused(undisturbed):
    m, b = undisturbed[0]
    many = hl.Noise(
        SIGMA, pose_covariance=np.tile(1e-9 * np.eye(6), (len(b.plane_labels) + 1, 1, 1))
    )
    with pytest.raises(hl.InputError, match="25 pose covariances; expected 24"):
        hl.hold_out(m, b, many)


def test_a_file_is_refused_with_the_call_that_reads_its_mounts(tmp_path):
    """The error and the docstring name what works."""
    recording, later = two_days(3, planes=2)
    path = tmp_path / "old.json"
    hl.write_calibration(path, hl.calibrate(recording, NOISE))
    for file in (path, hl.read_calibration(path)):
        with pytest.raises(hl.InputError, match=r"hl\.read_mounts\(path\)"):
            hl.hold_out(file, later, NOISE)
    assert hl.hold_out(hl.read_mounts(path), later, NOISE).holds
    assert "hl.read_mounts(path)" in hl.hold_out.__doc__
