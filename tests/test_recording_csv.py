"""Recordings as files: what is read, and one clear refusal for every fault."""

from dataclasses import replace

import numpy as np
import pytest
from helpers import GRIPPER, simulated

import handlaser_gtsam as hl
from handlaser_gtsam.errors import InputError
from handlaser_gtsam.files.recording_csv import read_recording, write_recording

HEADER = "plane,station,x,y,z,qx,qy,qz,qw,range_1,range_2"
ROWS = [
    "A,s1,0.1,0.2,0.3,0,0,0,1,0.02,0.021",
    "A,s2,0.1,0.2,0.4,0,0,0,1,0.03,",
    "B,s3,0.1,0.2,0.5,0,0,0.6,0.8,,0.025",
]


def written(tmp_path, *lines, end="\n", encoding="utf-8"):
    path = tmp_path / "recording.csv"
    path.write_bytes((end.join(lines) + end).encode(encoding))
    return path


def refusal(path):
    with pytest.raises(InputError) as caught:
        read_recording(path)
    assert "\n" not in str(caught.value)
    assert str(path) in str(caught.value)
    return caught.value


def test_columns_become_a_recording(tmp_path):
    recording = read_recording(written(tmp_path, HEADER, *ROWS))
    assert recording.beam_names == ("1", "2")
    assert recording.plane_names == ("A", "B")
    assert recording.station_names == ("s1", "s2", "s3")
    assert recording.plane_of_station.tolist() == [0, 0, 1]
    assert np.isnan(recording.ranges).tolist() == [[False, False], [False, True], [True, False]]
    # qz = sin(half), qw = cos(half): a turn about z by 2 atan2(0.6, 0.8).
    c, s = 0.8**2 - 0.6**2, 2 * 0.6 * 0.8
    assert np.allclose(recording.world_R_hand[2], [[c, -s, 0], [s, c, 0], [0, 0, 1]])


def test_readings_are_sorted_by_plane_beam_station(tmp_path):
    readings = read_recording(written(tmp_path, HEADER, *ROWS[::-1])).readings()
    assert readings.plane.tolist() == [0, 1, 1, 1]
    assert readings.beam.tolist() == [1, 0, 0, 1]
    assert readings.distance.tolist() == [0.025, 0.03, 0.02, 0.021]
    assert readings.block_starts().tolist() == [0, 1, 3]


@pytest.mark.parametrize("separator", [";", "\t"])
def test_other_separators(tmp_path, separator):
    lines = [line.replace(",", separator) for line in (HEADER, *ROWS)]
    recording = read_recording(written(tmp_path, *lines))
    assert recording.ranges[0].tolist() == [0.02, 0.021]


def test_bom_crlf_spaces_and_blank_lines(tmp_path):
    lines = [HEADER.replace(",", ", "), ROWS[0].replace(",", " , "), "", *ROWS[1:]]
    path = written(tmp_path, *lines, end="\r\n", encoding="utf-8-sig")
    recording = read_recording(path)
    assert recording.station_names == ("s1", "s2", "s3")
    assert recording.ranges[0].tolist() == [0.02, 0.021]


def test_blank_lines_before_the_header(tmp_path):
    path = written(tmp_path, "", "", HEADER, ROWS[0], ROWS[1].replace("0.03", "-0.03"))
    assert refusal(path).line == 5


def test_utf_16_is_refused_as_such(tmp_path):
    assert "UTF-8" in str(refusal(written(tmp_path, HEADER, *ROWS, encoding="utf-16")))


def test_lines_are_counted_past_blank_lines(tmp_path):
    error = refusal(written(tmp_path, HEADER, ROWS[0], "", ROWS[1].replace("0.03", "-0.03")))
    assert error.line == 4


def test_stations_without_labels_are_numbered(tmp_path):
    lines = [line.split(",", 2)[0] + "," + line.split(",", 2)[2] for line in (HEADER, *ROWS)]
    assert read_recording(written(tmp_path, *lines)).station_names == ("1", "2", "3")


def test_other_columns_are_named(tmp_path):
    lines = [HEADER + ",time,angle_1,rate", *(row + ",12:00,3,4" for row in ROWS)]
    recording = read_recording(written(tmp_path, *lines))
    assert recording.ignored_columns == ("time", "angle_1", "rate")


def test_quaternions_are_normalised_up_to_a_thousandth(tmp_path):
    row = ROWS[0].replace("0,0,0,1", "0,0,0,1.0009")
    R = read_recording(written(tmp_path, HEADER, row, *ROWS[1:])).world_R_hand[0]
    assert np.array_equal(R, np.eye(3))


FAULTS = {
    "no plane column": (
        [HEADER.replace("plane", "surface"), *ROWS],
        1,
        "plane",
        "no column 'plane'",
    ),
    "no pose column": ([HEADER.replace("qw", "w"), *ROWS], 1, "qw", "no column 'qw'"),
    "capital letters": ([HEADER.replace(",x,", ",X,"), *ROWS], 1, "x", "column 'X'"),
    "misspelt beam": ([HEADER.replace("range_2", "rang_2"), *ROWS], 1, "rang_2", "'range_2'"),
    "beam without underscore": (
        [HEADER.replace("range_2", "range2"), *ROWS],
        1,
        "range2",
        "'range_2'",
    ),
    "swapped letters": ([HEADER.replace("range_2", "rnage_2"), *ROWS], 1, "rnage_2", "'range_2'"),
    "capital beam": ([HEADER.replace("range_2", "Range_2"), *ROWS], 1, "Range_2", "'range_2'"),
    "no beam": ([HEADER.replace("range_", "d_"), *ROWS], 1, "range_NAME", "no column of ranges"),
    "column twice": ([HEADER.replace("range_2", "range_1"), *ROWS], 1, "range_1", "twice"),
    "text": ([HEADER, ROWS[0].replace("0.02,", "far,"), *ROWS[1:]], 2, "range_1", "'far'"),
    "text in pose": ([HEADER, ROWS[0], ROWS[1].replace("0.4", "up"), ROWS[2]], 3, "z", "'up'"),
    "decimal comma": (
        [line.replace(",", ";") for line in (HEADER, ROWS[0])] + ["A;s2;0,1;0;0;0;0;0;1;0.1;0.1"],
        3,
        "x",
        "decimals with a point",
    ),
    "empty pose": ([HEADER, ROWS[0].replace("0.2", ""), *ROWS[1:]], 2, "y", "an empty cell"),
    "empty label": ([HEADER, ROWS[0].replace("A", "", 1), *ROWS[1:]], 2, "plane", "an empty cell"),
    "nan pose": ([HEADER, ROWS[0].replace("0.2", "NaN"), *ROWS[1:]], 2, "y", "'NaN'"),
    "infinity": ([HEADER, ROWS[0].replace("0.2", "inf"), *ROWS[1:]], 2, "y", "'inf'"),
    "quaternion": (
        [HEADER, ROWS[0].replace("0,0,0,1", "0,0,0,1.01"), *ROWS[1:]],
        2,
        "qx, qy, qz, qw",
        "length 1.01, 0.01 off",
    ),
    "zero quaternion": (
        [HEADER, ROWS[0].replace("0,0,0,1", "0,0,0,0"), *ROWS[1:]],
        2,
        "qx, qy, qz, qw",
        "length 0",
    ),
    "negative range": ([HEADER, *ROWS[:2], ROWS[2].replace("0.025", "-0.1")], 4, "range_2", "-0.1"),
    "zero range": ([HEADER, ROWS[0].replace("0.021", "0.0"), *ROWS[1:]], 2, "range_2", "0.0"),
    "station twice": ([HEADER, *ROWS, ROWS[0]], 5, "station", "'s1' again (first at line 2)"),
    "plane unread": ([HEADER, *ROWS, "C,s4,0,0,0,0,0,0,1,,"], 5, "plane", "plane 'C' without any"),
    "beam unread": (
        [HEADER + ",range_3", *(row + "," for row in ROWS)],
        None,
        "range_3",
        "no reading at all",
    ),
    "too many fields": ([HEADER, ROWS[0], ROWS[1] + ",1,2", ROWS[2]], 3, None, "13 fields"),
    "too few fields": ([HEADER, ROWS[0], "A,s2,0.1", ROWS[2]], 3, None, "3 fields"),
    "one field less": ([HEADER, ROWS[0], ROWS[1][:-1], ROWS[2]], 3, None, "10 fields"),
    "line break in quotes": (
        [HEADER, ROWS[0], '"B', 'b",s2,0,0,0,0,0,0,1,0.1,0.1'],
        3,
        None,
        "a stray quote",
    ),
    "stray quote in a label": (
        [HEADER, *ROWS[:2], ROWS[2].replace("B", '"B')],
        4,
        None,
        "a stray quote",
    ),
    "stray quote in the header": (
        [HEADER + ',"note', *(row + "," for row in ROWS)],
        1,
        None,
        "a stray quote in '\"note'",
    ),
    "stray quote in a note": (
        [HEADER + ",note", ROWS[0] + ',"ok', ROWS[1] + ",", ROWS[2] + ',ok"'],
        2,
        None,
        "a stray quote",
    ),
    "quotes in a cell": ([HEADER, ROWS[0].replace("s1", '5" plate')], 2, None, "a stray quote"),
    "control character": ([HEADER, ROWS[0].replace("s1", "s\x07")], 2, None, "'\\x07'"),
    "null character": ([HEADER, *ROWS[:2], ROWS[2].replace("0.6", "0.6\0")], 4, None, "'\\x00'"),
    "terminal escape": ([HEADER, ROWS[0].replace("s1", "\x1b[31ms")], 2, None, "'\\x1b'"),
    "right to left": ([HEADER, ROWS[0].replace("s1", "\u202e1s")], 2, "station", "'\\u202e1s'"),
    "no-break space": ([HEADER, ROWS[0].replace("s1", "s1\xa0")], 2, "station", "'s1\\xa0'"),
    "second byte-order mark": ([HEADER, "\ufeff" + ROWS[0]], 2, "plane", "'\\ufeffA'"),
    "name of an ignored column": (
        [HEADER + ",\u2066note", *(row + "," for row in ROWS)],
        1,
        None,
        "'\\u2066note'",
    ),
    "endless name": (
        [HEADER.replace("range_2", "range_" + "2" * 201), *ROWS],
        1,
        None,
        "207 characters",
    ),
    "beam without a name": (
        [HEADER.replace("range_2", "range_"), *ROWS],
        1,
        "range_",
        "an empty name of a beam",
    ),
    "carriage return in a line": ([HEADER, ROWS[0] + "\r" + ROWS[1]], 2, None, "a carriage return"),
    "quaternion that overflows": (
        [HEADER, ROWS[0].replace("0,0,0,1", "1e308,0,0,1e308"), *ROWS[1:]],
        2,
        "qx, qy, qz, qw",
        "length inf",
    ),
    "endless label": ([HEADER, ROWS[0].replace("A", "A" * 201, 1)], 2, "plane", "201 characters"),
    "position in another galaxy": (
        [HEADER, ROWS[0].replace("0.3", "1e300"), *ROWS[1:]],
        2,
        "z",
        "'1e300'",
    ),
    "range beyond reason": ([HEADER, ROWS[0].replace("0.021", "1e307")], 2, "range_2", "1e307"),
    "open quote": ([HEADER, ROWS[0], '"A,s2,0,0'], 3, None, "a stray quote"),
    "header only": ([HEADER], None, None, "no station"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_every_fault_is_placed(tmp_path, fault):
    lines, line, column, words = FAULTS[fault]
    error = refusal(written(tmp_path, *lines))
    assert (error.line, error.column) == (line, column)
    assert words in str(error)
    assert error.expected


def without_end(tmp_path, *lines):
    path = tmp_path / "recording.csv"
    path.write_bytes("\n".join(lines).encode())
    return path


def test_quotes_around_whole_cells_are_taken_away(tmp_path):
    note = ['"moved, slowly"', '"a ""b"""', ""]
    rows = [f'"{row[0]}"{row[1:]},{text}' for row, text in zip(ROWS, note, strict=True)]
    recording = read_recording(written(tmp_path, HEADER + ',"note, if any"', *rows))
    assert recording.plane_labels == ("A", "A", "B")
    assert recording.ranges[0].tolist() == [0.02, 0.021]
    assert recording.ignored_columns == ("note, if any",)


def test_rows_of_separators_are_blank(tmp_path):
    path = written(tmp_path, HEADER, ROWS[0], "," * 10, *ROWS[1:], ",,,", " \t")
    assert read_recording(path).station_names == ("s1", "s2", "s3")


def test_a_column_without_a_name_is_called_by_its_number(tmp_path):
    path = written(tmp_path, "," + HEADER, *(f"{j},{row}" for j, row in enumerate(ROWS)))
    assert read_recording(path).ignored_columns == ("(column 1 without a name)",)


@pytest.mark.parametrize("cut", range(1, len(ROWS[2])))
def test_a_file_that_is_cut_is_refused_wherever_its_end_is_lost(tmp_path, cut):
    text = "\n".join([HEADER, *ROWS])[:-cut]
    error = refusal(without_end(tmp_path, text))
    assert error.line == text.count("\n") + 1
    assert "cut" in str(error) or "longer one" in str(error)


@pytest.mark.parametrize(
    "last",
    [
        pytest.param("0.025", id="as many decimals as the others"),
        pytest.param('"0.02"', id="quotes that are closed"),
        pytest.param("0.025123456", id="decimals below a nanometre"),
        pytest.param("2.5e-02", id="exponent"),
    ],
)
def test_a_last_line_without_an_end_is_read_if_its_last_cell_is_whole(tmp_path, last):
    row = ROWS[2].replace("0.025", last)
    recording = read_recording(without_end(tmp_path, HEADER, *ROWS[:2], row))
    assert recording.ranges[2, 1] == float(last.strip('"'))


@pytest.mark.parametrize("last", ["0.02", "1", "", "2.5e-0", "2.5e"])
def test_a_last_cell_that_may_be_cut_is_refused(tmp_path, last):
    row = ROWS[2].replace("0.025", last)
    error = refusal(without_end(tmp_path, HEADER, *ROWS[:2], row))
    assert (error.line, error.column) == (4, "range_2")
    assert "a last line without a line end" in str(error)


def test_what_nobody_reads_may_be_cut(tmp_path):
    rows = [row + ",note" for row in ROWS]
    assert len(read_recording(without_end(tmp_path, HEADER + ",note", *rows)).plane_labels) == 3


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("0.03", "0.03_1"),
        ("0.03", "0x1p-5"),
        ("0.03", "\u0660.03"),
        ("0.03", "1,030"),
        ("0.03", "1e999"),
        ("0.03", "- 0.03"),
    ],
)
def test_what_is_no_plain_number_is_refused(tmp_path, old, new):
    rows = [row.replace(",", ";").replace(old, new) for row in ROWS]
    error = refusal(written(tmp_path, HEADER.replace(",", ";"), *rows))
    assert (error.line, error.column) == (3, "range_1")


@pytest.mark.parametrize("content", [b"", b"\n\n", b"\xef\xbb\xbf", b"  \n"])
def test_an_empty_file(tmp_path, content):
    path = tmp_path / "recording.csv"
    path.write_bytes(content)
    assert "empty file" in str(refusal(path))


def test_bytes_that_are_no_text(tmp_path):
    path = tmp_path / "recording.csv"
    path.write_bytes("\n".join([HEADER, ROWS[0], ROWS[1].replace("A", "\xc4")]).encode("latin-1"))
    error = refusal(path)
    assert error.line == 3
    assert f"0xc4, which is not UTF-8, at offset {len(HEADER) + len(ROWS[0]) + 2}" in str(error)


@pytest.mark.parametrize("name", ["missing.csv", "."])
def test_no_file(tmp_path, name):
    assert "no readable file" in str(refusal(tmp_path / name))


def test_writing_and_reading_returns_the_numbers(tmp_path):
    recording, _ = simulated("arm")
    path = tmp_path / "there" / "back.csv"
    path.parent.mkdir()
    write_recording(path, recording)
    back = read_recording(path)
    assert np.array_equal(back.ranges, recording.ranges, equal_nan=True)
    assert np.array_equal(back.world_t_hand, recording.world_t_hand)
    # Rotations go through quaternions of 16 digits.
    assert np.abs(back.world_R_hand - recording.world_R_hand).max() < 1e-15
    assert back.plane_labels == recording.plane_labels


def test_nothing_is_left_beside_a_file_that_cannot_be_written(tmp_path):
    recording, _ = simulated()
    target = tmp_path / "folder.csv"
    target.mkdir()
    with pytest.raises(InputError, match="no regular file"):
        write_recording(target, recording)
    assert list(tmp_path.iterdir()) == [target]


def test_the_shipped_recording_reads():
    recording = read_recording(GRIPPER / "recording.csv")
    assert recording.ranges.shape == (44, 4)


def test_line_ends_of_an_old_mac_are_read(tmp_path):
    text = (GRIPPER / "recording.csv").read_text()
    (tmp_path / "mac.csv").write_bytes(text.replace("\n", "\r").encode())
    assert len(read_recording(tmp_path / "mac.csv").plane_labels) == 44


@pytest.mark.parametrize(
    "name",
    [
        'a"b',
        '"a"',
        '"',
        '""',
        "a,b",
        "a;b;;;;;;;;;;;;;;;;",
        "#",
        "'",
        "\u00e4 \u58c1",
        "range_1",
        "plane",
    ],
)
def test_any_name_that_can_be_printed_is_written_and_read_back(tmp_path, name):
    recording, _ = simulated()
    labels = tuple(label.replace("A", name) for label in recording.plane_labels)
    named = replace(recording.renamed("2", name), plane_labels=labels, station_names=())
    stations = (name, *named.station_names[1:])
    named = replace(named, station_names=stations)
    write_recording(tmp_path / "named.csv", named)
    back = read_recording(tmp_path / "named.csv")
    assert back.beam_names == named.beam_names
    assert back.plane_labels == named.plane_labels
    assert back.station_names == named.station_names


def test_dashes_in_a_recording_are_counted(tmp_path):
    rows = [f"A,0,0,{k},0,0,0,1,{'---' if k == 2 else 1.0 + k}" for k in range(4)]
    path = tmp_path / "recording.csv"
    path.write_text("\n".join(["plane,x,y,z,qx,qy,qz,qw,range_1", *rows]) + "\n")
    (warning,) = read_recording(path).warnings
    assert "one reading of '---' of beam 1 counted as no reading" in warning.message
    path.write_text(path.read_text().replace("---", "-+-"))
    with pytest.raises(InputError, match=r"found '-\+-'; expected a finite number"):
        read_recording(path)


@pytest.mark.parametrize("log", [False, True])
def test_stations_without_a_reading_are_counted(tmp_path, log):
    """They were left out without a word; of codes for no reading each is said already."""
    rows = [
        f"A,0,0,{k},0,0,0,1,{'' if k in (2, 3) else '---' if k == 4 else 1.0 + k}" for k in range(6)
    ]
    path = tmp_path / "recording.csv"
    path.write_text("\n".join(["plane,x,y,z,qx,qy,qz,qw,range_1", *rows]) + "\n")
    given = hl.LogFormat(pose_format="ros", as_stated=True)
    found = hl.read_log(path, given) if log else read_recording(path)
    empty, code = sorted(one.message for one in found.warnings)
    assert "one reading of '---'" in code
    assert empty == "2 of 6 stations have no reading, and were left out"
