"""Any file is read as it plainly stands, or refused in one line: bytes, cells and fields of any kind.

The judges are those of `benchmarks.fuzz`, which reads thousands of files more.
"""

import json
import random
import tomllib

import pytest
from hypothesis import given
from hypothesis import strategies as st

from benchmarks import mutated_fields, mutated_tables
from benchmarks.judged_readers import WrongError, judge_recording, judge_result, judge_rig
from benchmarks.plain_readers import UnclearError, plain_recording

HEADER = ["plane", "station", "x", "y", "z", "qx", "qy", "qz", "qw", "range_1", "range_2", "note"]
ROWS = [
    ["A", "s1", "0.1", "0.2", "0.3", "0", "0", "0", "1", "0.020", "0.021", "ok"],
    ["A", "s2", "0.1", "0.2", "0.4", "0", "0", "0", "1", "0.030", "", ""],
    ["B", "s3", "0.1", "0.2", "0.5", "0", "0", "0.6", "0.8", "", "0.025", ""],
]
GOOD = "\n".join(",".join(row) for row in [HEADER, *ROWS]).encode() + b"\n"
RIG = mutated_fields.rig_text(random.Random(0))
RESULT = mutated_fields.result_text(random.Random(0))
NASTY = "\"',;\t\r\n\0\x1b\x85\u2028\u202e\ufeff\xa0\u0661-+.eE_xnaif0123456789"

texts = st.text(st.sampled_from(NASTY) | st.characters(), max_size=6)
values = st.sampled_from([*mutated_tables.NUMBERS, *mutated_tables.TEXTS]) | texts
seeds = st.integers(0, 2**32)


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    return tmp_path_factory.mktemp("fuzz") / "file"


@given(st.integers(0, len(GOOD)), st.integers(0, 12), st.binary(max_size=8))
def test_bytes_put_into_a_recording(path, first, gone, new):
    judge_recording(path, GOOD[:first] + new + GOOD[first + gone :])


@given(st.lists(st.tuples(st.integers(0, 3), st.integers(0, 11), values), min_size=1, max_size=3))
def test_cells_put_into_a_recording(path, changes):
    rows = [list(row) for row in [HEADER, *ROWS]]
    for row, column, text in changes:
        rows[row][column] = text
    text = "".join(",".join(row) + "\n" for row in rows)
    judge_recording(path, text.encode("utf-8", "surrogatepass"))


@given(seeds)
def test_mishaps_of_recordings(path, seed):
    judge_recording(path, mutated_tables.mutated_recording(random.Random(seed)))


@given(seeds)
def test_recordings_that_are_only_written_in_an_unusual_way_are_read(path, seed):
    data = mutated_tables.harmless_recording(random.Random(seed))
    assert judge_recording(path, data) == "read"


@given(st.sampled_from(mutated_fields.TOKEN.findall(RIG)), values | st.floats().map(repr))
def test_values_put_into_a_rig(path, old, new):
    judge_rig(path, RIG.replace(old, new, 1).encode("utf-8", "surrogatepass"))


@given(seeds)
def test_mishaps_of_rigs(path, seed):
    rng = random.Random(seed)
    judge_rig(path, mutated_fields.mutated_text(mutated_fields.rig_text(rng), rng))


def paths_of(record, here=()):
    """Every place in a JSON record, as the keys and indices that lead there."""
    found = [here] if here else []
    if isinstance(record, dict | list):
        inner = record.items() if isinstance(record, dict) else enumerate(record)
        for key, value in inner:
            found += paths_of(value, (*here, key))
    return found


words = st.none() | st.booleans() | st.integers() | st.floats() | texts
records = st.recursive(words, lambda inner: st.lists(inner, max_size=3), max_leaves=6)


@given(st.sampled_from(paths_of(json.loads(RESULT))), records)
def test_values_put_into_a_result(path, place, value):
    record = json.loads(RESULT)
    inside = record
    for key in place[:-1]:
        inside = inside[key]
    inside[place[-1]] = value
    judge_result(path, json.dumps(record).encode())


@given(seeds)
def test_mishaps_of_results(path, seed):
    rng = random.Random(seed)
    judge_result(path, mutated_fields.mutated_text(mutated_fields.result_text(rng), rng))


def test_good_files_are_read(path):
    assert judge_recording(path, GOOD) == "read"
    assert judge_rig(path, RIG.encode()) == "read"
    assert judge_result(path, RESULT.encode()) == "read"
    assert tomllib.loads(RIG)["noise"]["range_sigma_mm"] > 0.0


def test_the_judge_sees_a_changed_meaning(path, monkeypatch):
    """A reader that takes one station less, another number, or what is unclear, is caught."""
    import handlaser_gtsam as hl

    read = hl.read_recording
    for change in (lambda r: r.part([0, 2]), lambda r: r.renamed("1", "3")):
        monkeypatch.setattr(hl, "read_recording", lambda path, change=change: change(read(path)))
        with pytest.raises(WrongError):
            judge_recording(path, GOOD)
    path.write_bytes(GOOD)
    good = read(path)
    monkeypatch.setattr(hl, "read_recording", lambda _: good)
    with pytest.raises(WrongError, match="other ranges"):
        judge_recording(path, GOOD.replace(b"0.020", b"0.02001"))
    with pytest.raises(WrongError, match="though it holds"):
        judge_recording(path, GOOD.replace(b"0.020", b"0_020"))


@pytest.mark.parametrize(
    "data",
    [
        pytest.param(GOOD + b"\xff", id="no UTF-8"),
        pytest.param(GOOD.replace(b"0.021,", b""), id="a short row"),
        pytest.param(GOOD.replace(b"0.021", b"far"), id="no number"),
        pytest.param(GOOD.replace(b"ok", b'"ok'), id="a quote that is not closed"),
        pytest.param(GOOD.replace(b"range_2", b"range_1"), id="a column twice"),
    ],
)
def test_the_plain_reader_knows_what_is_unclear(data):
    with pytest.raises(UnclearError):
        plain_recording(data)
