"""Sensors of many rays in bags: scans, clouds and topics of ranges, before stops of the hand."""

import numpy as np
import pytest
from bags import HAS_ROSBAGS, write_bag
from scipy.spatial.transform import Rotation, Slerp

import handlaser_gtsam as hl
from benchmarks import rigs_by_rays
from benchmarks.rigs import EXACT, errors_of, survey_of

pytestmark = pytest.mark.skipif(not HAS_ROSBAGS, reason="needs rosbags")
STAND, WAY, RATE = 1.6, 0.8, 25.0
"""Seconds that the hand stands, and that it moves; poses a second."""


def poses(rig, make):
    """Poses of a hand that stops at every station of a rig, and moves from one to the next."""
    q, both = Rotation.from_matrix(rig.R), STAND + WAY
    for time in np.arange(0.0, both * len(rig.R) - WAY, 1.0 / RATE):
        number = int(time // both)
        part = max((time - both * number - STAND) / WAY, 0.0)
        after = min(number + 1, len(rig.R) - 1)
        turn = Slerp([0.0, 1.0], q[[number, after]])(part).as_quat()
        yield (
            "pose",
            time,
            make.pose(time, (1.0 - part) * rig.t[number] + part * rig.t[after], turn),
        )


def published(rig, make, messages):
    """Poses, and `messages(name, rows)` of each station at half of its stop, and once on the way."""
    yield from poses(rig, make)
    for name, table in rig.tables.items():
        for number in range(len(rig.R)):
            rows = np.flatnonzero(table["station"] == number)
            if len(rows):
                time = (STAND + WAY) * number + 0.5 * STAND
                yield from messages(make, name, table, rows, time)
                wrong = time + 0.5 * (STAND + WAY)  # while the hand moves: of no station
                yield from messages(make, name, table, rows, wrong)


def scans(make, name, table, rows, time):
    angles = np.linspace(-0.25 * np.pi, 0.25 * np.pi, 361)
    ranges = np.full(361, np.nan)
    place = np.rint((table["angle"][rows] - angles[0]) / (angles[1] - angles[0])).astype(int)
    ranges[place] = table["reading"][rows]
    yield name, time, make.fan(time, angles, ranges)


def clouds(make, name, table, rows, time):
    if table["kind"] == "profiler":
        points = np.column_stack((table["x"][rows], 0.0 * rows, table["z"][rows]))
    else:
        points = np.column_stack([table[axis][rows] for axis in "xyz"])
    yield name, time, make.cloud(time, points, "f4" if table["kind"] == "points" else "f8")


def zones(make, name, table, rows, time):
    for zone, d in zip(table["zone"][rows].tolist(), table["reading"][rows], strict=True):
        yield f"{name}/{zone}", time + 1e-3 * zone, make.range(time + 1e-3 * zone, d)


def rig_file(folder, rig, kind, topics, more=""):
    labels, runs = list(rig.label), []
    for number, label in enumerate(labels, start=1):
        if not runs or runs[-1][0] != label:
            runs.append([label, number, number])
        runs[-1][2] = number
    ranges = ", ".join(f'"{label}={first}..{last}"' for label, first, last in runs)
    text = f'[log]\nplane_ranges = [{ranges}]\n\n[[sensors]]\nname = "{kind}"\nkind = "{kind}"\n'
    listed = ", ".join(f'"{topic}"' for topic in topics)
    (folder / "rig.toml").write_text(f"{text}topics = [{listed}]\n{more}")
    return folder / "rig.toml"


OPTIONS = {"array": {"zones": 4, "convention": "radial"}}
CASES = {
    "scanner": (scans, {"targets": "planes+sphere"}, "ros1"),
    "points": (clouds, {"planes": 3}, "ros2"),
    "profiler": (clouds, {"targets": "planes+sphere"}, "mcap"),
}


@pytest.mark.slow
@pytest.mark.parametrize("kind", CASES)
def test_what_a_bag_has_is_what_was_published_at_the_stops(tmp_path, kind):
    messages, options, format_ = CASES[kind]
    rig = getattr(rigs_by_rays, kind)(6, stations=10, **options)
    bag = write_bag(tmp_path, format_, lambda make: published(rig, make, messages))
    file = rig_file(tmp_path, rig, kind, [kind])
    survey, wanted = hl.read_survey(bag, file), survey_of(rig)
    assert np.abs(survey.stations.world_R_hand - rig.R).max() < 1e-9
    assert np.abs(survey.stations.world_t_hand - rig.t).max() < 1e-9
    assert survey.stations.plane_labels == tuple(rig.label)
    (found,), (given,) = survey.shots, wanted.shots
    assert (found.station == np.sort(given.station)).all()
    order = np.argsort(given.station, kind="stable")
    assert np.abs(found.reading - given.reading[order]).max() < 1e-6  # single precision
    result = hl.calibrate(survey, EXACT)
    assert result.status == "converged"
    for error, C in errors_of(rig, result):
        assert error @ np.linalg.solve(C, error) < 50.0


def test_a_sensor_that_reads_on_the_way_alone_is_named(tmp_path):
    """It ended in a bug instead of a line."""
    rig = rigs_by_rays.scanner(6, planes=3, stations=8)

    def messages(make):
        yield from published(rig, make, scans)
        table = rig.tables["scanner"]
        rows = np.flatnonzero(table["station"] == 0)
        yield from scans(make, "other", table, rows, STAND + 0.5 * WAY)

    bag = write_bag(tmp_path, "ros1", messages)
    more = '\n[[sensors]]\nname = "other"\nkind = "scanner"\ntopics = ["other"]\n'
    file = rig_file(tmp_path, rig, "scanner", ["scanner"], more)
    with pytest.raises(hl.InputError, match="no point of other at any station before a target"):
        hl.read_survey(bag, file)


@pytest.mark.slow
def test_units_are_not_stated_of_messages(tmp_path):
    rig = rigs_by_rays.scanner(6, planes=3, stations=8)
    bag = write_bag(tmp_path, "ros2", lambda make: published(rig, make, scans))
    file = rig_file(tmp_path, rig, "scanner", ["scanner"], 'units = "mm"\n')
    with pytest.raises(hl.InputError, match="units or angles of scanner with topics of a bag"):
        hl.read_survey(bag, file)


def test_stops_without_a_message_or_a_label_are_said_and_how_the_bag_was_read(tmp_path):
    rig = rigs_by_rays.scanner(6, planes=3, stations=8)
    number = len(rig.R)
    table = rig.tables["scanner"]
    rig.tables["scanner"] = {
        name: x[table["station"] != 2] if np.ndim(x) and len(x) == len(table["station"]) else x
        for name, x in table.items()
    }
    bag = write_bag(tmp_path, "ros2", lambda make: published(rig, make, scans))
    text = rig_file(tmp_path, rig, "scanner", ["scanner"]).read_text()
    file = tmp_path / "rig.toml"
    file.write_text(text.replace(f"..{number}", f"..{number - 1}"))
    survey = hl.read_survey(bag, file)
    assert len(survey.stations) == number - 2
    assert [(one.code, one.values["stations"]) for one in survey.warnings] == [
        ("stations-left-out", 1),
        ("stations-left-out", 1),
    ]
    assert survey.lines[0].startswith("poses from pose")
    assert survey.lines[1].startswith(f"{number} moments at which the hand stands")


def test_scans_that_take_long_while_the_hand_moves_are_said(tmp_path):
    rig = rigs_by_rays.scanner(6, planes=3, stations=8)

    def messages(make):
        for topic, time, message in published(rig, make, scans):
            if topic == "scanner":
                message.time_increment = 1e-4
            yield topic, time, message

    bag = write_bag(tmp_path, "ros2", messages)
    file = rig_file(tmp_path, rig, "scanner", ["scanner"])
    assert not hl.read_survey(bag, file).warnings
    way = '[log]\ninterpolate = true\ntolerance_s = 0.1\nplane = "A"\n'
    file.write_text(way + file.read_text()[file.read_text().index("\n[[sensors]]") :])
    warnings = hl.read_survey(bag, file).warnings
    (said,) = [one for one in warnings if one.code == "scan-while-moving"]
    assert said.values["lasts_s"] == pytest.approx(0.0361)


def test_one_topic_of_two_sensors_is_refused(tmp_path):
    rig = rigs_by_rays.scanner(6, planes=3, stations=8)
    bag = write_bag(tmp_path, "ros2", lambda make: published(rig, make, scans))
    again = '\n[[sensors]]\nname = "again"\nkind = "scanner"\ntopics = ["scanner"]\n'
    file = rig_file(tmp_path, rig, "scanner", ["scanner"], again)
    with pytest.raises(hl.InputError, match="topic 'scanner' twice"):
        hl.read_survey(bag, file)


@pytest.mark.parametrize("average", ["mean", "median"])
def test_a_scanner_and_a_laser_of_one_bag_are_one_survey(tmp_path, average):
    """Of a laser what it reads at one stop is averaged, as in a bag of lasers alone."""
    rig = rigs_by_rays.mixed(3, sensors=("scanner", "beam"), stations=10)
    wanted, laser = survey_of(rig), rig.tables.pop("beam")
    off = 1e-3 * np.array([-1.0, 0.0, 1.0, 0.0, 2.0])  # of five readings of each stop [m]

    def messages(make):
        yield from published(rig, make, scans)
        for number, d in zip(laser["station"].tolist(), laser["reading"].tolist(), strict=True):
            for i, more in enumerate(off.tolist()):
                time = (STAND + WAY) * number + 0.5 * STAND + 0.05 * (i - 2)
                gross = 0.1 * (number == 3 and i == 1)
                yield "laser", time, make.range(time, d + more + gross)

    bag, file = (
        write_bag(tmp_path, "mcap", messages),
        rig_file(tmp_path, rig, "scanner", ["scanner"]),
    )
    alone, text = hl.read_survey(bag, file), file.read_text()
    stated = f'[log]\nrange_columns = ["beam=laser"]\naverage = "{average}"\n'
    file.write_text(text.replace("[log]\n", stated))
    survey = hl.read_survey(bag, file)
    assert survey.beam_names == ("beam",)
    read = ~np.isnan(survey.ranges)
    assert (read == ~np.isnan(wanted.ranges)).all()
    middle = off.mean() if average == "mean" else 0.0
    apart = np.abs(survey.ranges[read] - wanted.ranges[read] - middle)
    assert np.sort(apart)[-2] < 1e-6
    assert (apart.max() > 0.01) == (average == "mean")  # of the stop with the gross reading
    gross = [one.values for one in survey.warnings if one.code == "gross-readings"]
    assert gross == ([{"readings": 1, "stations": 1}] if average == "mean" else [])
    (shots,) = survey.shots
    assert alone.stations.station_names == survey.stations.station_names
    assert (shots.reading == alone.shots[0].reading).all()
    file.write_text(text.replace("[log]\n", '[log]\nrange_columns = ["beam=scanner[3]"]\n'))
    with pytest.raises(hl.InputError, match="topic 'scanner' twice"):
        hl.read_survey(bag, file)


@pytest.mark.parametrize("stated", [False, True])
def test_cones_beside_a_scanner_are_warned_of_where_no_half_angle_is_stated(tmp_path, stated):
    rig = rigs_by_rays.mixed(3, sensors=("scanner", "beam"), stations=10)
    laser = rig.tables.pop("beam")

    def messages(make):
        yield from published(rig, make, scans)
        for number, d in zip(laser["station"].tolist(), laser["reading"].tolist(), strict=True):
            time = (STAND + WAY) * number + 0.5 * STAND
            yield "sonar", time, make.range(time, d, kind=0, view=0.5)

    file = rig_file(tmp_path, rig, "scanner", ["scanner"])
    cone = '[sensor]\nkind = "ultrasonic"\nhalf_angle_deg = 14.3\n\n' if stated else ""
    file.write_text(
        file.read_text().replace("[log]\n", f'{cone}[log]\nrange_columns = ["sonar"]\n')
    )
    survey = hl.read_survey(write_bag(tmp_path, "mcap", messages), file)
    assert (survey.cones > 0.0).all() == stated
    assert ("no-half-angle" in {one.code for one in survey.warnings}) != stated


@pytest.mark.parametrize("kind", ["scanner", "array"])
@pytest.mark.parametrize("late", [0.0, 0.3])
def test_readings_that_still_move_when_the_hand_stands_are_said(tmp_path, kind, late):
    """Readings of another moment of the hand are of another place, at one end of each stop."""
    rig = getattr(rigs_by_rays, kind)(3, planes=3, stations=8, **OPTIONS.get(kind, {}))
    table, topics = rig.tables[kind], [kind]
    if kind == "array":
        topics = [f"array/{i}" for i in range(len(table["directions"]))]
        lines = [f"{i},{x},{y},{z}" for i, (x, y, z) in enumerate(table["directions"].tolist())]
        (tmp_path / "zones.csv").write_text("\n".join(["zone,x,y,z", *lines]) + "\n")

    def messages(make):
        yield from poses(rig, make)
        publish, both = scans if kind == "scanner" else zones, STAND + WAY
        for time in np.arange(0.0, both * len(rig.R) - WAY, 0.05).tolist():
            number = int((time - late) // both) if time >= late else 0
            on_way = max((time - late - both * number - STAND) / WAY, 0.0)
            rows = np.flatnonzero(table["station"] == number)
            if kind == "array" and time > 1.0:  # the first zone reads at the begin only
                rows = rows[table["zone"][rows] > 0]
            shot = {**table, "reading": table["reading"] + 0.1 * on_way}
            yield from publish(make, kind, shot, rows, time)

    bag = write_bag(tmp_path, "mcap", messages)
    more = 'zones = "zones.csv"\n' if kind == "array" else ""
    survey = hl.read_survey(bag, rig_file(tmp_path, rig, kind, topics, more))
    said = [one.values for one in survey.warnings if one.code == "moving-readings"]
    assert len(said) == (late > 0.0)
    assert all(one["stops"] >= len(rig.R) // 2 for one in said)


@pytest.mark.slow
def test_zones_of_an_array_are_topics_of_ranges(tmp_path):
    rig = rigs_by_rays.array(3, planes=3, zones=4, convention="radial", stations=10)
    table = rig.tables["array"]
    bag = write_bag(tmp_path, "ros2", lambda make: published(rig, make, zones))
    lines = [f"{i},{x},{y},{z}" for i, (x, y, z) in enumerate(table["directions"].tolist())]
    (tmp_path / "zones.csv").write_text("\n".join(["zone,x,y,z", *lines]) + "\n")
    topics = [f"array/{i}" for i in range(len(lines))]
    file = rig_file(tmp_path, rig, "array", topics, 'zones = "zones.csv"\n')
    survey = hl.read_survey(bag, file)
    assert len(survey.shots[0].reading) == len(table["reading"])
    result = hl.calibrate(survey, EXACT)
    for error, C in errors_of(rig, result):
        assert error @ np.linalg.solve(C, error) < 50.0


@pytest.mark.slow
def test_the_command_calibrates_a_bag_and_says_what_is_wrong_with_one(tmp_path, handlaser, refusal):
    rig = rigs_by_rays.scanner(6, planes=3, stations=8)
    bag = write_bag(tmp_path, "ros2", lambda make: published(rig, make, scans))
    file = rig_file(tmp_path, rig, "scanner", ["scanner"])
    code, out, _ = handlaser("calibrate", bag, "--rig", file)
    assert code == 0
    assert out.startswith("Usable: sensor scanner within")
    text = file.read_text()
    wrong = {
        'topics = ["scan"]': "found topic 'scan' of type none",
        'topics = ["pose"]': "found topic 'pose' of type geometry_msgs/msg/PoseStamped",
        'topics = ["scanner", "pose"]': "found 2 topics of the sensor scanner",
        'points = "points.csv"': "a table of points of scanner, or no topics, with a bag",
    }
    for line, words in wrong.items():
        file.write_text(text.replace('topics = ["scanner"]', line))
        assert words in refusal("calibrate", bag, "--rig", file)
    file.write_text(text.replace("[log]", '[log]\npose_format = "kuka"'))
    assert "says nothing of a bag" in refusal("calibrate", bag, "--rig", file)
