"""Names of beams and links that want to break out of an export, and what becomes of them."""

import ast
import re
import shlex
import subprocess
from xml.dom.minidom import parseString

import pytest
import xacro
import yaml
from blark.parse import parse_source_code
from exported import COMPILER, HOSTILE, calibrated
from hypothesis import given
from hypothesis import strategies as st

import handlaser_gtsam as hl
from handlaser_gtsam.files.exports.rendering import comment_text, identifiers, literal, number
from handlaser_gtsam.text import name_fault

FILE = calibrated(names=HOSTILE)
PLAIN = calibrated(names=tuple(f"p{i}" for i in range(len(HOSTILE))))
LINK = hl.ExportOptions(link="tool0")
NAMES = identifiers(HOSTILE)
OPTIONS = {
    "urdf": LINK,
    "xacro": LINK,
    "ros2-static": LINK,
    "ros2-yaml": LINK,
    "fanuc": hl.ExportOptions(tool=1),
}
TEXTS = {
    to: hl.export_text(FILE, to, OPTIONS.get(to))
    for to in (
        *("urdf", "xacro", "ros2-static", "ros2-yaml"),
        *("kuka", "abb", "fanuc", "ur", "c", "python", "st"),
    )
}


def test_identifiers_are_words_that_differ():
    assert len({name.lower() for name in NAMES}) == len(HOSTILE)
    for name in NAMES:
        assert re.fullmatch(r"laser[a-z0-9_]*", name)
        assert len(name) <= 24
    assert identifiers(["1", "left", "laser 3", "Laser", "lasers", "β"]) == (
        *("laser_1", "laser_left", "laser_3", "laser", "laser_lasers", "laser_u03b2"),
    )
    assert identifiers(["a b", "a_b", "x" * 40]) == (
        "laser_a_b_1",
        "laser_a_b_2",
        f"laser_{'x' * 16}_3",
    )


@pytest.mark.slow
@given(st.lists(st.text(min_size=1, max_size=40), min_size=1, max_size=12, unique=True))
def test_identifiers_differ_or_are_refused(names):
    try:
        found = identifiers(names)
    except hl.InputError:
        return
    assert len(set(found)) == len(names)
    assert all(re.fullmatch(r"laser[a-z0-9_]*", one) and len(one) <= 24 for one in found)


def test_names_that_collide_all_the_same_are_refused():
    with pytest.raises(hl.InputError, match="laser_a_1"):
        identifiers(["a", "A", "a-1"])


@given(st.text(max_size=60))
def test_comments_are_harmless(name):
    found = comment_text(name)
    assert re.fullmatch(r"[A-Za-z0-9 _.+\[\]-]*", found)
    assert "--" not in found


@given(st.text(max_size=60).filter(lambda name: not name_fault(name)))
def test_literals_are_the_name_in_python_and_yaml(name):
    assert literal(name).isascii()
    assert ast.literal_eval(literal(name)) == name
    assert yaml.safe_load(literal(name)) == name


@pytest.mark.parametrize("to", [to for to in TEXTS if to != "fanuc"])
def test_a_hostile_name_changes_names_and_comments_only(to):
    """What is left without names, comments and numbers is that of plain names, line by line."""
    plain = hl.export_text(PLAIN, to, OPTIONS.get(to))
    assert TEXTS[to].isascii()
    assert len(TEXTS[to].splitlines()) == len(plain.splitlines())

    def bones(text):
        text = re.sub(r"beam .*?: location", "beam: location", text)
        text = re.sub(r'^    ".*": \(\(', "    name: ((", text, flags=re.MULTILINE)
        return re.sub(r"(?i)\blaser_\w+", "laser", text)

    assert bones(TEXTS[to]) == bones(plain)


def test_a_fanuc_program_has_nothing_but_steps_and_positions():
    head, positions = TEXTS["fanuc"].split("/POS\n")
    for at, line in enumerate(head.split("/MN\n")[1].splitlines(), 1):
        step = re.fullmatch(
            r" *(\d+):  (!.{1,30}|PR\[\d+\]=P\[\d+\]|UTOOL\[\d+\]=PR\[\d+\]) ;", line
        )
        assert step, line
        assert int(step[1]) == at
        assert ";" not in step[2]
    assert positions.count("P[") == len(HOSTILE)


@pytest.mark.slow
def test_parsers_read_hostile_names():
    for to in ("urdf", "xacro"):
        text = f"<robot>{TEXTS[to]}</robot>" if to == "urdf" else TEXTS[to]
        document = parseString(text)
        if to == "xacro":
            call = text.replace("</robot>", "<xacro:handlaser_beams/></robot>")
            document = parseString(call)
            xacro.process_doc(document)
        assert [one.getAttribute("name") for one in document.getElementsByTagName("link")] == [
            *NAMES
        ]
        assert len(document.getElementsByTagName("joint")) == len(HOSTILE)
    sent = yaml.safe_load(TEXTS["ros2-yaml"])["transforms"]
    assert [one["child_frame_id"] for one in sent] == [*NAMES]
    assert len(shlex.split(TEXTS["ros2-static"], comments=True)) == 1 + 23 * len(HOSTILE)
    space = {}
    exec(TEXTS["python"], space)
    assert tuple(space["BEAMS"]) == HOSTILE
    # All numbers of a beam but the first: they are the longest part, and no name is in them.
    few = re.sub(r"(:= \(X := LREAL#[^,]*),.*\);", r"\1);", TEXTS["st"])
    assert few.count("LREAL#") < len(NAMES) + 10
    assert parse_source_code(few).exception is None


@pytest.mark.skipif(COMPILER is None, reason="no C compiler")
def test_a_compiler_reads_hostile_names(tmp_path):
    (tmp_path / "beams.c").write_text(TEXTS["c"])
    command = [COMPILER, "-std=c99", "-Wall", "-Wextra", "-Werror", "-trigraphs", "-c", "beams.c"]
    run = subprocess.run(
        [*command, "-Wno-unused-const-variable"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert run.returncode == 0, run.stderr


@pytest.mark.parametrize("link", ["tool 0", "$(rm x)", "${1/0}", "a'b", 'a"b', "-x", "tööl", "a;b"])
@pytest.mark.parametrize("to", ["xacro", "ros2-static", "ros2-yaml"])
def test_links_that_ros_cannot_have_are_refused(to, link):
    with pytest.raises(hl.InputError, match="letters, digits"):
        hl.export_text(FILE, to, hl.ExportOptions(link=link))


def test_a_link_of_a_urdf_may_have_any_name():
    link = 'the "hand" & <tool>'
    document = parseString(
        f"<robot>{hl.export_text(FILE, 'urdf', hl.ExportOptions(link=link))}</robot>"
    )
    parents = {one.getAttribute("link") for one in document.getElementsByTagName("parent")}
    assert parents == {link}


def test_only_these_characters_stay_in_a_comment():
    every = "".join(map(chr, range(32, 127)))
    kept = [c for c in every if comment_text(c) == c]
    assert "".join(kept) == " +-.0123456789ABCDEFGHIJKLMNOPQRSTUVWXYZ_abcdefghijklmnopqrstuvwxyz"


@pytest.mark.parametrize("value", [1e-5, -2e-300, 3.0, 1e22, -0.0, 0.1, 1.5e-7])
def test_numbers_have_a_point_and_all_their_digits(value):
    """YAML takes 1e-05 for a text, and structured text for a mistake."""
    text = number(value)
    assert re.fullmatch(r"-?\d+\.\d+(e[+-]\d+)?", text)
    assert yaml.safe_load(text) == value == float(text)
    assert text != "-0.0"
