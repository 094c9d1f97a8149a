"""Tables of points as sensors write them: codes for no reading, cut lines, and names of stations.

The scenes are made here: a profiler before a plate that ends in the field of view, and a ToF array.
"""

import re

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import handlaser_gtsam as hl
from handlaser_gtsam.data.screening import codes_of_shots
from handlaser_gtsam.files.points_table import read_points, without_copies
from handlaser_gtsam.files.sensor_tables import SensorTable
from handlaser_gtsam.files.watch.watched import Watched
from handlaser_gtsam.files.watch.worker import Calibrator

STATIONS, RAYS = 16, 80
LOCATION = np.array([0.06, -0.02, 0.10])
TURN = Rotation.from_euler("ZYX", [35.0, -15.0, 5.0], degrees=True).as_matrix()
"""Of the profiler in the hand."""
NORMAL, OFFSET = np.array([0.0, 0.0, 1.0]), 0.05
"""Of the plate: n . x = offset [m]."""
EMPTY = ""


def profiles(rng):
    """Return rotations and positions of the hand, and x and z of rays [mm]: off the plate z is NaN."""
    fan = np.radians(np.linspace(-18.0, 18.0, RAYS))
    u = np.column_stack((np.sin(fan), np.zeros(RAYS), np.cos(fan)))
    R, t, points = [], [], []
    for _ in range(STATIONS):
        # The sensor looks down, turned and tilted by up to 25 degrees.
        tilt = Rotation.from_rotvec([*rng.uniform(-0.4, 0.4, 2), 0.0])
        looks = tilt * Rotation.from_euler("xz", [180.0, rng.uniform(0.0, 360.0)], degrees=True)
        at = np.array([*rng.uniform(-0.05, 0.05, 2), OFFSET + rng.uniform(0.16, 0.24)])
        world_u = looks.apply(u)
        d = (OFFSET - at @ NORMAL) / (world_u @ NORMAL) + rng.normal(0.0, 3e-5, RAYS)
        end = rng.uniform(0.4, 0.7)  # the plate ends at this part of the fan
        z = np.where(np.arange(RAYS) < end * RAYS, d * u[:, 2], np.nan)
        R.append(looks.as_matrix() @ TURN.T)
        t.append(at - R[-1] @ LOCATION + rng.normal(0.0, 3e-5, 3))
        points.append(1e3 * np.column_stack((0.19 * np.tan(fan), z)))
        points[-1][:, 0] = np.where(np.isnan(z), points[-1][:, 0], 1e3 * d * u[:, 0])
    return R, t, points


def survey(folder, code, *, decimals=3, names=None, files=None):
    """Write poses, scans and a rig file; `code` stands where a ray read nothing."""
    R, t, points = profiles(np.random.default_rng(5))
    names = names or [f"{i + 1:03d}" for i in range(STATIONS)]
    files = files or names
    poses = ["plane,station,x,y,z,qx,qy,qz,qw"]
    (folder / "scans").mkdir()
    for name, file, R_i, t_i, p in zip(names, files, R, t, points, strict=True):
        numbers = (*t_i, *Rotation.from_matrix(R_i).as_quat())
        poses.append(",".join(["plate", name, *map(repr, map(float, numbers))]))
        rows = [
            f"{x:.{decimals}f},{code if np.isnan(z) else f'{z:.{decimals}f}'}"
            for x, z in p.tolist()
        ]
        (folder / "scans" / f"scan_{file}.csv").write_text("\n".join(["x,z", *rows]) + "\n")
    (folder / "poses.csv").write_text("\n".join(poses) + "\n")
    (folder / "rig.toml").write_text(
        '[[sensors]]\nname = "line"\nkind = "profiler"\npoints = "scans/scan_*.csv"\nunits = "mm"\n'
    )
    return sum(int(np.isnan(p[:, 1]).sum()) for p in points)


def read(folder):
    return hl.read_survey(folder / "poses.csv", folder / "rig.toml")


@pytest.mark.parametrize("code", ["0.000", "9999.000", "330.000", "-215.5", "0", "-9999.9"])
def test_a_code_of_a_profiler_is_left_out_counted_and_named(tmp_path, code):
    for name in ("plain", "coded"):
        (tmp_path / name).mkdir()
    survey(tmp_path / "plain", EMPTY)
    count = survey(tmp_path / "coded", code)
    plain, coded = read(tmp_path / "plain"), read(tmp_path / "coded")
    assert plain.warnings == ()
    (warning,) = coded.warnings
    assert warning.code == "reading-code"
    what = f"z = {float(code):g}"
    assert warning.values == {"readings": count, "sensor": "line", "value": what}
    assert f"{count} points of sensor line with {what} counted as no reading" in warning.message
    assert coded.shots[0] == plain.shots[0]


@pytest.mark.slow
def test_a_calibration_goes_on_without_codes_and_says_so(tmp_path, handlaser):
    survey(tmp_path, "330.000")
    code, out, _ = handlaser("calibrate", tmp_path / "poses.csv", "--rig", tmp_path / "rig.toml")
    assert code == 0
    assert "with z = 330 counted as no reading" in " ".join(out.split())
    found = hl.calibrate(read(tmp_path))
    assert found.status == "converged"
    off = found.sensors["line"].location - LOCATION
    # A plate alone leaves nothing open: 16 stations are turned about all axes.
    assert np.linalg.norm(off) < 5.0 * found.sensors["line"].largest_sigmas[0]


def test_two_codes_are_both_found(tmp_path):
    survey(tmp_path, "9999")
    for path in sorted((tmp_path / "scans").iterdir()):
        lines = path.read_text().splitlines()
        path.write_text("\n".join([*lines, *["0.5,-9999"] * 5]) + "\n")
    values = {one.values["value"] for one in read(tmp_path).warnings}
    assert values == {"z = 9999", "z = -9999"}


@pytest.mark.parametrize(("kind", "first"), [("array", "zone"), ("scanner", "angle")])
@pytest.mark.parametrize(("below", "words"), [((-1,), "-1"), ((-1, -1, -2), "-2, -1")])
def test_distances_below_zero_are_counted_and_named(tmp_path, kind, first, below, words):
    names, good = "stuv", [f"{name},{10 * i},{100 + i}" for name in "stuv" for i in range(3)]
    bad = [f"t,{30 + 10 * i},{reading}" for i, reading in enumerate(below)]
    (tmp_path / "p.csv").write_text(
        "\n".join([f"station,{first},reading", *good, *bad, "u,30,0", ""])
    )
    (tmp_path / "zones.csv").write_text(
        "zone,x_deg,y_deg\n" + "".join(f"{i},{i - 20},{i % 20}\n" for i in range(0, 60, 10))
    )
    more = 'zones = "zones.csv"\n' if kind == "array" else ""
    (tmp_path / "rig.toml").write_text(
        f'[[sensors]]\nname = "tof"\nkind = "{kind}"\npoints = "p.csv"\n{more}'
    )
    poses = [f"{name},plane:A,{i},0,0,0,0,0,1" for i, name in enumerate(names)]
    (tmp_path / "poses.csv").write_text("\n".join(["station,plane,x,y,z,qx,qy,qz,qw", *poses, ""]))
    survey = read(tmp_path)
    assert len(survey.shots[0].reading) == len(good)
    (warning,) = survey.warnings
    what = f"reading = {words}"
    assert warning.code == "reading-code"
    assert warning.values == {"readings": len(below), "sensor": "tof", "value": what}
    assert f"with {what} counted as no reading: no distance is below zero" in warning.message


def zones(rng, step, sigma, *, walls, tilted):
    """Return readings [mm] and stations of an array before a plate, at one distance at five stations.

    The plate may not fill the field of view; then there is a wall behind it.
    """
    g = np.tan(np.radians(np.linspace(-22.0, 22.0, 8)))
    u = np.stack([*np.meshgrid(g, g), np.ones((8, 8))], axis=-1).reshape(-1, 3)
    reading, station = [], []
    for k in range(20):
        flat = k < 5 or not tilted
        turn = Rotation.from_rotvec(
            [*(0.0 if flat else 0.25) * rng.normal(size=2), 0.0]
        ).as_matrix()
        near = (300.0 if k < 5 else rng.uniform(300.0, 400.0)) * turn[2, 2]
        d = near / (u @ turn[:, 2])
        if walls:
            behind = (near + 1200.0) / (u @ turn[:, 2])
            d = np.where(np.abs(u[:, :2] * d[:, None]).max(axis=1) < 90.0, d, behind)
        reading.append(np.round((d + sigma * rng.normal(size=64)) / step) * step)
        station.append(np.full(64, k))
    return np.concatenate(reading), np.concatenate(station)


@pytest.mark.parametrize("step", [10.0, 1.0, 0.1])
@pytest.mark.parametrize("walls", [False, True])
@pytest.mark.parametrize("tilted", [False, True])
def test_rounded_readings_of_a_flat_plate_are_no_codes(step, walls, tilted):
    """One number stands up to 64 times at each of five stations, at one end of all readings."""
    for sigma in (0.0, 0.3, 3.0):
        for seed in range(10):
            rng = np.random.default_rng(seed)
            reading, station = zones(rng, step, sigma, walls=walls, tilted=tilted)
            assert codes_of_shots(reading, station) == ()
            # And a code beside them is one.
            coded = np.where(rng.random(len(reading)) < 0.1, 8190.0, reading)
            if tilted and step < 10.0:
                assert codes_of_shots(coded, station) == (8190.0,)


@pytest.mark.parametrize("stations", [1, 2])
def test_what_stands_at_few_stations_is_no_code(stations):
    rng = np.random.default_rng(0)
    reading, station = rng.uniform(200.0, 300.0, 640), np.repeat(np.arange(10), 64)
    reading[(station < stations) & (np.arange(640) % 2 == 0)] = 500.0
    assert codes_of_shots(reading, station) == ()


@pytest.mark.slow
def test_codes_of_scanners_and_arrays_and_their_echoes(tmp_path):
    """The nearest echo of a zone is its nearest reading, not a code that is nearer."""
    (tmp_path / "zones.csv").write_text("zone,x_deg,y_deg\n0,0,0\n1,10,0\n2,0,10\n3,5,10\n")
    rng = np.random.default_rng(2)
    rows = ["station,zone,reading"]
    poses = ["plane,station,x,y,z,qx,qy,qz,qw"]
    for k in range(8):
        poses.append(f"A,s{k},0,0,{0.1 * k},0,0,0,1")
        for zone in range(4):
            near, far = rng.uniform(300.0, 320.0), rng.uniform(330.0, 350.0)
            rows += [f"s{k},{zone},{d:.2f}" for d in (near, far)]
            rows.append(f"s{k},{zone},20")
    (tmp_path / "d.csv").write_text("\n".join(rows) + "\n")
    (tmp_path / "poses.csv").write_text("\n".join(poses) + "\n")
    (tmp_path / "rig.toml").write_text(
        '[[sensors]]\nname = "tof"\nkind = "array"\npoints = "d.csv"\nzones = "zones.csv"\n'
    )
    found = read(tmp_path)
    (warning,) = found.warnings
    assert warning.values == {"readings": 32, "sensor": "tof", "value": "reading = 20"}
    before = found.shots[0].before
    assert np.isnan(before).sum() == 32
    assert (before[~np.isnan(before)] > 0.29).all()


@pytest.mark.parametrize("word", ["---", "-", "\N{EN DASH}", "nan", "-overflow"])
def test_words_and_dashes_say_that_there_is_no_reading(tmp_path, word):
    for name in ("plain", "said"):
        (tmp_path / name).mkdir()
    survey(tmp_path / "plain", EMPTY)
    survey(tmp_path / "said", word)
    assert read(tmp_path / "said").shots[0] == read(tmp_path / "plain").shots[0]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("end", "words"),
    [
        (
            "-3.843,12",
            "column z: found a last line without a line end: '12' may be what is left of a longer "
            "one; expected a line end; add one if the line is whole",
        ),
        (
            "-3",
            "found 1 field in a last line that is cut; expected 2, as in the header; take it away, "
            "or copy the whole file again",
        ),
        ("-3.843,", "an empty cell may be what is left of a longer one"),
    ],
)
def test_a_last_line_that_is_cut_is_refused_and_watch_waits_for_it(
    tmp_path, refusal, monkeypatch, end, words
):
    survey(tmp_path, EMPTY)
    last = tmp_path / "scans" / f"scan_{STATIONS:03d}.csv"
    whole = last.read_text()
    count = len(read(tmp_path).shots[0].reading)
    last.write_text(whole + end)
    err = refusal("calibrate", tmp_path / "poses.csv", "--rig", tmp_path / "rig.toml")
    assert str(last) in err
    assert words in err
    seen = []
    monkeypatch.setattr(Calibrator, "_of_survey", lambda _, *read: seen.append(read[0]) or {})
    one = Calibrator(Watched(tmp_path / "poses.csv", tmp_path / "rig.toml", rig_needed=True))
    answer = one.answer(settled=False)
    assert (answer.error, "is not whole yet" in answer.note) == ("", True)
    answer = one.answer(settled=True)
    assert (answer.error, words in answer.note) == ("", True)
    assert [len(survey.shots[0].reading) for survey in seen] == [count, count]
    last.write_text(whole + "-3.843,185.125\n")
    answer = one.answer(settled=True)
    assert (answer.error, answer.note) == ("", "")
    assert len(seen[-1].shots[0].reading) == count + 1


@pytest.mark.slow
def test_a_last_line_without_a_line_end_that_is_whole_is_read(tmp_path):
    survey(tmp_path, EMPTY)
    last = tmp_path / "scans" / f"scan_{STATIONS:03d}.csv"
    count = len(read(tmp_path).shots[0].reading)
    last.write_text(last.read_text() + "-3.843,185.125")
    assert len(read(tmp_path).shots[0].reading) == count + 1
    # In a column that is not read nothing is lost.
    text = re.sub(r"(?m)$", ",5", last.read_text()).replace("x,z,5", "x,z,light")
    last.write_text(text)
    assert len(read(tmp_path).shots[0].reading) == count + 1


@pytest.mark.parametrize(
    ("station", "file"),
    [("{}", "{:03d}"), ("{}.0", "{:03d}"), ("{:03d}", "{}"), ("{}.0", "{}"), ("{}", "{}.00")],
)
def test_names_of_files_that_are_equal_numbers_are_the_same(tmp_path, station, file):
    numbers = range(1, STATIONS + 1)
    names, files = [station.format(i) for i in numbers], [file.format(i) for i in numbers]
    survey(tmp_path, EMPTY, names=names, files=files)
    assert len(set(read(tmp_path).shots[0].station.tolist())) == STATIONS


def test_rows_of_a_table_find_equal_numbers_too(tmp_path):
    numbers = range(1, STATIONS + 1)
    survey(tmp_path, EMPTY, names=[f"{i}.0" for i in numbers], files=[f"{i:03d}" for i in numbers])
    expected = read(tmp_path).shots[0]
    rows = ["station,x,z"]
    for path in sorted((tmp_path / "scans").iterdir()):
        rows += [f"{path.stem[-3:]},{row}" for row in path.read_text().splitlines()[1:]]
    (tmp_path / "all.csv").write_text("\n".join(rows) + "\n")
    rig = tmp_path / "rig.toml"
    rig.write_text(rig.read_text().replace("scans/scan_*.csv", "all.csv"))
    assert read(tmp_path).shots[0] == expected


def test_files_without_a_pose_are_refused_with_what_to_do(tmp_path, refusal):
    given = "calibrate", tmp_path / "poses.csv", "--rig", tmp_path / "rig.toml"
    numbers = range(1, STATIONS + 1)
    survey(tmp_path, EMPTY, names=[f"P{i}" for i in numbers], files=[f"{i:03d}" for i in numbers])
    err = refusal(*given)
    assert (
        "points of station '001', '002', '003', '004' and 12 more, by the name of the file" in err
    )
    assert "no such pose among P1, P2, P3, P4 and 12 more; expected the same names, or equal" in err
    assert "what stands for the * in the name of a file is compared with the names of the" in err
    poses = tmp_path / "poses.csv"
    poses.write_text(poses.read_text().replace("plate,P", "plate,"))
    read(tmp_path)
    rows = poses.read_text().splitlines(keepends=True)
    poses.write_text("".join(rows[:7] + rows[8:]))
    err = refusal(*given)
    assert (
        "scan_007.csv: found points of station '007', by the name of the file, and no such" in err
    )
    assert "expected all points with a pose: add that of '007', or remove scan_007.csv" in err
    # Of stations 7 and 07 the name 007 means neither.
    row = rows[7]
    poses.write_text("".join([*rows, row.replace(",7,", ",07,")]))
    assert "'007'" in refusal(*given)


def again(rows, how):
    """Rows of one station, stored again as files and sensors do."""
    return {
        "pasted twice": rows + rows,
        "pasted three times": rows + rows + rows,
        "each row twice": [row for row in rows for _ in range(2)],
        "each row twice, pasted twice": 2 * [row for row in rows for _ in range(2)],
    }[how]


@pytest.mark.parametrize(
    "how",
    ["pasted twice", "pasted three times", "each row twice", "each row twice, pasted twice"],
)
def test_points_that_all_stand_more_than_once_count_once(tmp_path, how):
    """They made standard deviations too small by the root of how often they stand, without a word."""
    survey(tmp_path, EMPTY)
    once = read(tmp_path)
    for path in sorted((tmp_path / "scans").iterdir())[3:]:
        head, *rows = path.read_text().splitlines()
        path.write_text("\n".join([head, *again(rows, how)]) + "\n")
    found = read(tmp_path)
    assert found.shots == once.shots
    (warning,) = found.warnings
    assert warning.code == "repeated-stations"
    assert warning.values == {"sensor": "line", "stations": 16, "repeated": 13, "first": "004"}
    assert once.warnings == ()


def test_readings_that_all_are_zero_are_none(tmp_path):
    """They ended in a bug instead of a line."""
    (tmp_path / "points.csv").write_text("station,angle,reading\n1,0,0\n1,1,0\n")
    scanner = SensorTable(name="scanner", kind="scanner")
    with pytest.raises(hl.InputError, match="no reading at all"):
        read_points(scanner, {"": tmp_path / "points.csv"}, ("1",))


def test_rounded_readings_of_an_array_that_are_equal_are_no_copies():
    """Four frames of four zones: zones that read the same number are of different rays."""
    rng = np.random.default_rng(0)
    zone = np.tile(np.arange(4.0), 4)
    for _ in range(200):
        reading = 500.0 + rng.integers(0, 2, 16)
        numbers = np.column_stack((zone, reading))
        frames = reading.reshape(4, 4)
        station, left, doubled = without_copies(np.zeros(16, dtype=np.intp), numbers)
        if (frames[:2] == frames[2:]).all():  # frames that repeat as a whole tell nothing new
            assert doubled.tolist() == [0]
            continue
        assert not len(doubled)
        assert len(station) == 16
        assert np.array_equal(left, numbers)
    same = np.column_stack((np.arange(16.0), np.full(16, 500.0)))
    assert len(without_copies(np.zeros(16, dtype=np.intp), same)[0]) == 16
    # Some rows twice are part of a file that may be right.
    part = np.concatenate((same, same[:5]))
    assert len(without_copies(np.zeros(21, dtype=np.intp), part)[0]) == 21
