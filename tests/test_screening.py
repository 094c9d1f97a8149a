"""Readings that are not what they seem are found before anything is solved."""

import pickle
from dataclasses import replace

import numpy as np
import pytest
from helpers import codes, simulated
from scipy.spatial.transform import Rotation

import handlaser_gtsam as hl
from benchmarks.odd_readings import logged
from handlaser_gtsam.data.screening import (
    RepeatedColumnError,
    merged_stations,
    pose_groups,
    refuse_repeated_columns,
    without_codes,
)
from handlaser_gtsam.validation.scenes import SCENES, Layout
from handlaser_gtsam.validation.simulate import Errors, simulate

SIGMA = 3e-5
NOISE = hl.Noise(SIGMA, 1e-4, 1e-4)


@pytest.fixture(scope="module")
def recording():
    return simulated("paper", Layout(3, 4, 11), range_sigma=SIGMA)[0]


@pytest.fixture(scope="module")
def calibration(recording):
    return hl.calibrate(recording, NOISE)


def repeated(recording, rows, jitter=0.0, noise=0.0, seed=0):
    """The stations `rows`, each with its own jitter of pose and readings, and noise of the readings."""
    rng = np.random.default_rng(seed)
    turn = Rotation.from_rotvec(jitter * rng.standard_normal((len(rows), 3))).as_matrix()
    many = logged(recording, rows)
    t, d = many.world_t_hand, many.ranges
    return replace(
        many,
        world_R_hand=many.world_R_hand @ turn,
        world_t_hand=t + jitter * rng.standard_normal(t.shape),
        ranges=d + (jitter + noise) * rng.standard_normal(d.shape),
    )


def doubled(recording, column):
    ranges = recording.ranges.copy()
    ranges[:, 2] = column(ranges[:, 0])
    return replace(recording, ranges=ranges)


@pytest.mark.parametrize("jitter", [0.0, 1e-7])
@pytest.mark.parametrize("order", ["pasted", "held"])
def test_repeated_stations_count_once(recording, calibration, order, jitter):
    """Standard deviations are those of the stations themselves; a tenth of one is what jitter moves."""
    number = np.arange(len(recording.plane_labels))
    rows = np.tile(number, 2) if order == "pasted" else np.repeat(number, 10)
    found = hl.calibrate(repeated(recording, rows, jitter), NOISE)
    assert codes(found) == ["repeated-stations"]
    assert f"{len(rows) - len(number)} of {len(rows)} stations" in str(found.warnings[0])
    assert found.fit.readings == calibration.fit.readings
    for name, beam in calibration.beams.items():
        other = found.beams[name]
        assert other.sigma == pytest.approx(beam.sigma, rel=1e-3)
        apart = np.abs(other.location - beam.location)
        assert (apart < 0.1 * beam.location_sigma).all()


def test_samples_of_one_pose_are_averaged_and_weigh_as_many(recording):
    """The mean of five has the variance of a fifth, which the exact robot shows undiluted."""
    exact = hl.Noise(SIGMA, 0.0, 0.0)
    without_noise = recording.ranges + hl.calibrate(recording, exact).fit.residuals
    rows = np.repeat(np.arange(len(recording.plane_labels)), 5)
    many = repeated(replace(recording, ranges=without_noise), rows, noise=SIGMA)
    merged, warnings = merged_stations(many, SIGMA)
    assert [one.code for one in warnings] == ["repeated-poses"]
    first = np.arange(0, len(rows), 5)
    assert np.isnan(np.delete(merged.ranges, first, axis=0)).all()
    mean = many.ranges.reshape(-1, 5, many.ranges.shape[1]).mean(axis=1)
    assert merged.ranges[first] == pytest.approx(mean, abs=1e-12)
    assert merged.samples[first] == pytest.approx(5.0)
    once = hl.calibrate(replace(merged, samples=None), exact)
    found = hl.calibrate(many, exact)
    for name, beam in found.beams.items():  # range errors have a prior, which does not shrink
        ratio = (beam.sigma / once.beams[name].sigma)[:6]
        assert (ratio > 0.99 / np.sqrt(5.0)).all()
        assert (ratio < 0.6).all()


def test_scatter_below_the_sigma_leaves_what_the_samples_share(recording):
    rows = np.repeat(np.arange(len(recording.plane_labels)), 8)
    many = repeated(recording, rows, noise=0.5 * SIGMA)
    worth = merged_stations(many, SIGMA)[0].samples[0, 0]
    assert worth == pytest.approx(1.0 / (0.75 + 0.25 / 8.0), rel=0.05)


def test_a_gross_error_among_samples_is_not_averaged(recording):
    rows = np.repeat(np.arange(len(recording.plane_labels)), 5)
    many = repeated(recording, rows, noise=SIGMA)
    ranges = many.ranges.copy()
    ranges[7, 1] += 0.01
    left = merged_stations(replace(many, ranges=ranges), SIGMA)[0].ranges
    assert left[7, 1] == ranges[7, 1]
    assert left[5, 1] == pytest.approx(np.delete(ranges[5:10, 1], 2).mean())


def test_poses_before_different_planes_and_poses_that_move_stay_apart(recording):
    labels = tuple(str(j) for j in range(len(recording.plane_labels)))
    twice = repeated(recording, np.tile(np.arange(len(labels)), 2))
    apart = replace(twice, plane_labels=(*labels, *(f"again {one}" for one in labels)))
    assert len(np.unique(pose_groups(apart))) == 2 * len(labels)
    creeping = repeated(recording, np.zeros(20, dtype=int))
    t = creeping.world_t_hand + 5e-7 * np.arange(20)[:, None]
    assert len(np.unique(pose_groups(replace(creeping, world_t_hand=t)))) == 20


@pytest.mark.parametrize(
    "column",
    [
        lambda d: d,
        lambda d: d + 1e-7 * np.sin(1e6 * d),
        lambda d: np.round(d, 5),
        lambda d: np.round(d, 4),
        lambda d: 1e3 * d,
        lambda d: np.round(d / 0.0254, 6),
        lambda d: np.where(np.arange(len(d)) == 3, 0.02, d),
    ],
    ids=["equal", "jitter", "rounded", "coarse", "millimetres", "inches", "but one"],
)
def test_a_column_twice_is_refused(recording, column):
    with pytest.raises(RepeatedColumnError, match="one channel logged twice") as found:
        hl.calibrate(doubled(recording, column))
    again = pickle.loads(pickle.dumps(found.value))
    assert (again.code, str(again)) == ("column-twice", str(found.value))
    assert again.beams == ("1", "3")


@pytest.mark.slow
def test_a_column_twice_with_noise_of_its_own_is_warned_of(recording):
    rng = np.random.default_rng(2)
    column = doubled(recording, lambda d: d + SIGMA * rng.standard_normal(len(d)))
    found = hl.calibrate(column, hl.Noise())
    assert "column-twice" in codes(found)
    judged = found.judged()
    assert (judged.code, judged.best.code) == ("contradicted", "column-twice")
    assert judged.sentence.count("lie in one place") == 1


@pytest.mark.parametrize(
    ("label", "found"), [("plate a", True), ("Plat_A", True), ("plate 2", False), ("other", False)]
)
def test_a_misspelt_label_is_named(recording, label, found):
    """Of one station, which stays a plane of its own; numbers and other words tell labels apart."""
    first = recording.plane_labels[0]
    whole = ["Plate A" if one == first else one for one in recording.plane_labels]
    labels = (label, *whole[1:])
    calibration = hl.calibrate(replace(recording, plane_labels=labels), hl.Noise(SIGMA, 0.0, 0.0))
    named = [one.values for one in calibration.warnings if one.code == "misspelt-label"]
    assert named == ([{"target": label, "other": "Plate A"}] if found else [])


def test_a_misspelt_name_of_another_plane_is_none(recording):
    labels = [f"plate {label}" for label in recording.plane_labels]
    few = np.flatnonzero(recording.plane_of_station == 1)
    part = replace(recording, plane_labels=tuple(labels))
    part = part.part(np.setdiff1d(np.arange(len(labels)), few[3:]))
    assert "misspelt-label" not in codes(hl.calibrate(part, hl.Noise(SIGMA, 0.0, 0.0)))


def test_parallel_beams_side_by_side_are_two_beams(recording):
    """20 mm apart, on a hand that tilts by a degree: readings differ by a fraction of a millimetre."""
    rng = np.random.default_rng(1)
    tilt = np.radians(rng.uniform(-1.0, 1.0, len(recording.plane_labels)))
    column = doubled(
        recording, lambda d: d + 0.02 * np.tan(tilt) + SIGMA * rng.standard_normal(len(d))
    )
    refuse_repeated_columns(column, SIGMA)
    parallel = doubled(recording, lambda d: d + np.sqrt(2.0) * SIGMA * rng.standard_normal(len(d)))
    refuse_repeated_columns(parallel, SIGMA)


@pytest.mark.parametrize("value", [0.999, 8.191, 65.535, 65535.0])
@pytest.mark.parametrize("count", [3, 10])
def test_codes_for_no_reading_are_taken_out(recording, calibration, value, count):
    ranges = recording.ranges.copy()
    cells = np.random.default_rng(count).choice(ranges.size, count, replace=False)
    ranges.ravel()[cells] = value
    found = hl.calibrate(replace(recording, ranges=ranges), NOISE)
    assert codes(found) == ["reading-code"]
    assert f"{count} readings of {value:.10g} m" in str(found.warnings[0])
    assert found.fit.readings == calibration.fit.readings - count
    assert not found.fit.rejected


def test_readings_at_the_limit_of_the_sensor_are_taken_out(recording):
    limit = np.sort(recording.ranges.ravel())[-20]
    left, found = without_codes(replace(recording, ranges=np.minimum(recording.ranges, limit)))
    assert [one.code for one in found] == ["reading-code"]
    assert np.isnan(left.ranges).sum() == 20


@pytest.mark.parametrize("step", [1e-6, 1e-5, 1e-4, 1e-3])
def test_readings_of_a_coarse_sensor_are_no_codes(step):
    for seed in range(5):
        clean, _ = simulated("paper", Layout(3, 4, 30), SIGMA, seed)
        coarse = replace(clean, ranges=np.maximum(step * np.round(clean.ranges / step), step))
        assert without_codes(coarse) == (coarse, ())


def test_a_session_screens_what_it_is_given(recording):
    rows = np.repeat(np.arange(len(recording.plane_labels)), 3)
    many = repeated(recording, rows, 1e-7)
    session = hl.Session(NOISE)
    session.add(many)
    found = session.calibration()
    assert "repeated-stations" in codes(found)
    assert found.fit.readings == hl.calibrate(recording, NOISE).fit.readings
    with pytest.raises(RepeatedColumnError):
        session.add(doubled(recording, lambda d: d))


@pytest.mark.slow
def test_the_second_solver_reads_what_was_solved(recording):
    rows = np.repeat(np.arange(len(recording.plane_labels)), 4)
    many = repeated(recording, rows, noise=SIGMA)
    found = hl.calibrate(many, NOISE)
    assert hl.cross_check(found, many).largest < 0.01


def written(folder, recording, cells):
    """The file of a recording with other text in some cells of ranges: {(station, beam): text}."""
    path = folder / "recording.csv"
    hl.write_recording(path, recording)
    rows = [row.split(",") for row in path.read_text().splitlines()]
    for (station, beam), text in cells.items():
        rows[station + 1][rows[0].index(f"range_{recording.beam_names[beam]}")] = text
    path.write_text("\n".join(",".join(row) for row in rows) + "\n")
    return path


@pytest.mark.parametrize(
    "word",
    [
        *(
            "nan",
            "NaN",
            "inf",
            "-Infinity",
            "OVERFLOW",
            "n/a",
            "OUT OF RANGE",
            "OL",
            "+Over",
            "n.a.",
        ),
        *("Fehler", "#N/A", "#WERT!", "1.#INF", "*****", "?", ">0.13"),
    ],
)
def test_words_for_no_reading_are_counted(tmp_path, recording, word):
    read = hl.read_recording(written(tmp_path, recording, {(2, 0): word, (5, 1): word}))
    assert np.isnan(read.ranges[[2, 5], [0, 1]]).all()
    assert np.isnan(read.ranges).sum() == 2
    assert codes(read) == ["reading-code"]
    assert f"2 readings of '{word}' of beams 1, 2" in str(read.warnings[0])
    assert hl.calibrate(read, NOISE).warnings == read.warnings


def test_numbers_that_the_stated_range_excludes_share_one_warning(tmp_path, recording):
    cells = {(2, 0): "-0.681", (3, 0): "-15.5", (5, 1): "-2.4", (6, 1): "nan"}
    read = hl.read_recording(written(tmp_path, recording, cells), hl.Sensor(0.0, 0.03))
    assert np.isnan(read.ranges).sum() == 4
    assert codes(read) == ["reading-code"] * 2
    words = str(read.warnings[1])
    assert words.startswith("3 readings of '-15.5' to '-0.681' of beams 1, 2 counted as no reading")
    assert (
        "excludes them; leave such cells empty" in words
    )  # the range is stated: no need to say so
    assert "state the sensor's range" in str(read.warnings[0])


def test_a_refused_reading_is_told_in_the_unit_of_its_file(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text("X,Y,Z,A,B,C,L1\n600,100,400,0,0,0,12\n600,100,410,5,0,0,-3\n")
    given = hl.LogFormat(pose_format="kuka", plane="A", range_columns=("L1",), range_units="mm")
    with pytest.raises(
        hl.InputError, match="'-3'; expected a positive range in millimetres"
    ) as told:
        hl.read_log(path, given)
    assert "--range-mm MIN MAX" in str(told.value)
    hl.read_log(path, given, hl.Sensor(-0.005, 0.03))  # what the message tells to state


@pytest.mark.parametrize("text", ["0", "-1", "4294967295"])
def test_impossible_numbers_are_codes_where_they_pile_up_or_the_range_says_so(
    tmp_path, recording, text
):
    pile = {(j, j % 4): text for j in range(3)}
    read = hl.read_recording(written(tmp_path, recording, pile))
    assert np.isnan(read.ranges).sum() == 3
    assert f"3 readings of '{text}'" in str(read.warnings[0])
    single = written(tmp_path, recording, {(4, 1): text})
    with pytest.raises(hl.InputError, match="range_mm in the rig file"):
        hl.read_recording(single)
    read = hl.read_recording(single, hl.Sensor(0.0, 0.03))
    assert np.isnan(read.ranges).sum() == 1
    assert f"one reading of '{text}' of beam 2" in str(read.warnings[0])


@pytest.mark.parametrize("text", ["twelve", "nanometre", "1e400", "0.01.2", "#0.0125"])
def test_other_words_are_refused(tmp_path, recording, text):
    with pytest.raises(hl.InputError, match=text):
        hl.read_recording(written(tmp_path, recording, {(4, 1): text}), hl.Sensor(0.0, 0.03))


def about_a_reference(recording, reference, least):
    """What a triangulation sensor reads: the distance from a reference amid its range."""
    return replace(recording, ranges=recording.ranges - reference, range_min=least)


@pytest.mark.parametrize("given", [True, False])
@pytest.mark.parametrize("name", ["paper", "arm"])
def test_readings_about_a_reference_give_the_same_beams(name, given):
    """The location lies where the reading is zero, on the beam; without range errors all else is equal.

    Noise that is estimated has a prior in the units of the readings, so that it differs by a little.
    """
    truth, stations = SCENES[name](Layout(3, 4, 12), np.random.default_rng(2))
    truth = replace(truth, range_errors=np.zeros((3, 2)))
    recording = simulate(truth, stations, Errors(SIGMA), np.random.default_rng(3))
    reference = float(np.median(recording.ranges))
    shifted = about_a_reference(recording, reference, -float(recording.ranges.max()))
    assert (shifted.ranges < 0.0).mean() > 0.3
    noise = hl.Noise(SIGMA, 0.0, 0.0) if given else hl.Noise()
    none = hl.CalibrationOptions("none")
    found, usual = hl.calibrate(shifted, noise, none), hl.calibrate(recording, noise, none)
    # A guess about the arm makes sigmas just twice as large, or hardly so.
    named = [
        [one for one in result.warnings if one.code != "errors-by-pose"]
        for result in (found, usual)
    ]
    assert (found.status, named[0]) == ("converged", named[1])
    for name, beam in found.beams.items():
        other = usual.beams[name]
        right = other.location + reference * other.direction
        apart = np.abs(beam.location - right) / beam.location_sigma
        assert (apart < (1e-3 if given else 0.05)).all()
        assert beam.direction_sigma == pytest.approx(other.direction_sigma, rel=0.01)


def test_a_triangulation_sensor_with_range_errors_is_calibrated():
    for seed in range(5):
        recording, truth = simulated("paper", Layout(3, 5, 20), SIGMA, seed)
        shifted = about_a_reference(recording, 0.015, -0.03)
        k1, k2 = 0.01, 0.5
        d = shifted.ranges.copy()
        for _ in range(20):  # the reading d of a distance s solves s = d + k1 d + k2 d^2
            d = shifted.ranges - k1 * d - k2 * d**2
        found = hl.calibrate(replace(shifted, ranges=d), hl.Noise(SIGMA, 0.0, 0.0))
        assert found.status == "converged"
        for beam, r, v in zip(found.beams.values(), truth.locations, truth.directions, strict=True):
            assert (np.abs(beam.location - r - 0.015 * v) < 5.0 * beam.location_sigma).all()
            apart = np.abs(beam.range_error - [k1, k2])
            assert (apart < 5.0 * beam.range_error_sigma).all()


def test_negative_readings_pass_from_file_to_result_where_the_range_has_them(tmp_path):
    recording, _ = simulated("paper", Layout(3, 5, 20), SIGMA)
    shifted = about_a_reference(recording, 0.015, -0.03)
    path = tmp_path / "recording.csv"
    hl.write_recording(path, shifted)
    with pytest.raises(hl.InputError, match="range_mm in the rig file"):
        hl.read_recording(path)
    sensor = hl.Sensor(-0.03, 0.03)
    read = hl.read_recording(path, sensor)
    assert (read.ranges == shifted.ranges).all()
    assert not read.warnings
    found = hl.calibrate(read, hl.Noise(SIGMA, 0.0, 0.0), hl.CalibrationOptions(sensor=sensor))
    assert found.status == "converged"
    assert not found.fit.rejected
    assert hl.spot(found, "1", -0.001) is not None
    with pytest.raises(hl.InputError, match="sensor's range_min"):
        replace(shifted, range_min=0.0)


def test_stations_of_one_pose_without_readings_are_nothing_to_merge():
    R, t = np.tile(np.eye(3), (6, 1, 1)), np.arange(6.0)[:, None] * [0.01, 0.0, 0.0]
    t[3] = t[2]
    d = np.linspace(0.3, 0.4, 6)[:, None]
    d[2:4] = np.nan
    recording = hl.Recording(R, t, d, plane_labels=("a",) * 6, beam_names=("1",))
    assert merged_stations(recording, None) == (recording, ())


def test_a_visit_that_was_averaged_keeps_its_weight_when_it_is_screened_again():
    R, t = np.tile(np.eye(3), (7, 1, 1)), np.arange(7.0)[:, None] * [0.01, 0.0, 0.0]
    t[[1, 2, 6]] = t[0]
    d = np.array([[0.3], [0.3002], [0.3001], [0.4], [0.42], [0.43], [0.3001]])
    recording = hl.Recording(R, t, d, plane_labels=("a",) * 7, beam_names=("1",))
    once, _ = merged_stations(recording, None)
    twice, warnings = merged_stations(once, None)
    assert not warnings
    assert once.samples[:, 0].tolist() == twice.samples[:, 0].tolist() == [3, 1, 1, 1, 1, 1, 1]
    assert np.array_equal(once.ranges, twice.ranges, equal_nan=True)
    assert once.ranges[6, 0] == 0.3001
