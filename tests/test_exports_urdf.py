"""Beams put into an existing URDF: all else stays as it was, and names are looked at first."""

import re

import numpy as np
import pytest
import yourdfpy
from exported import calibrated

import handlaser_gtsam as hl

ROBOT = """<?xml version="1.0" encoding="UTF-8"?>
<!-- an arm: Größe -->
<robot name="arm">
\t<link name="base"/>
  <link  name='tool0' ></link>
    <joint name="turn" type="revolute"><parent link="base"/><child link="tool0"/>
    <axis xyz="0 0 1"/><limit lower="-3" upper="3" effort="1" velocity="1"/></joint>
  <transmission name="t"><joint name="laser_1_joint"/><link name="laser_2"/></transmission>


</robot>
<!-- the end -->
"""
FILE = calibrated()


@pytest.fixture
def put(tmp_path):
    """Write a URDF, and return it with the beams in it."""

    def run(text, link="tool0", beams=()):
        path, out = tmp_path / "robot.urdf", tmp_path / "out.urdf"
        path.write_bytes(text.encode() if isinstance(text, str) else text)
        options = hl.ExportOptions(beams, link=link, into=path)
        hl.write_export(out, FILE, "urdf", options)
        assert out.read_bytes().decode() == hl.export_text(FILE, "urdf", options)
        return out.read_bytes()

    return run


VARIANTS = {
    "as it is": ROBOT,
    "CRLF": ROBOT.replace("\n", "\r\n"),
    "byte-order mark": "\ufeff" + ROBOT,
    "the end indented": ROBOT.replace("</robot>", "   </robot >"),
    "in one line": re.sub(r"\s*\n\s*", " ", ROBOT),
    "no line end": ROBOT.rstrip("\n"),
}


@pytest.mark.parametrize("name", VARIANTS)
def test_all_else_stays_byte_for_byte(put, name):
    before = VARIANTS[name].encode()
    after = put(before)
    added = hl.export_text(FILE, "urdf", hl.ExportOptions(link="tool0"))
    added = added.replace("\n", "\r\n").encode() if name == "CRLF" else added.encode()
    assert after.count(added) == 1
    start = after.index(added)
    rest = after[:start] + after[start + len(added) :]
    assert rest in (before, before.replace(b"</robot>", b"\n</robot>"))
    assert (rest == before) == (name != "in one line")
    if name == "CRLF":
        assert b"\n" not in after.replace(b"\r\n", b"")


def test_the_robot_has_the_beams_at_its_hand(put, tmp_path):
    put(ROBOT)
    robot = yourdfpy.URDF.load(str(tmp_path / "out.urdf"), load_meshes=False)
    assert robot.validate()
    robot.update_cfg({"turn": 0.7})
    hand = robot.get_transform("tool0", "base")
    for number, beam in enumerate(FILE.beams, 1):
        pose = np.linalg.inv(hand) @ robot.get_transform(f"laser_{number}", "base")
        assert np.abs(pose[:3, 3] - beam.location_m).max() < 1e-9
        assert np.abs(pose[:3, 0] - beam.direction).max() < 1e-9


def test_a_link_that_is_missing_is_refused_with_those_there_are(put):
    with pytest.raises(hl.InputError, match="no link 'flange'; expected one of base, tool0"):
        put(ROBOT, "flange")
    with pytest.raises(
        hl.InputError, match="no link 'laser_2'"
    ):  # a transmission only refers to it
        put(ROBOT, "laser_2")


def test_names_that_are_taken_are_refused(put):
    taken = ROBOT.replace('"base"', '"laser_2"')
    with pytest.raises(hl.InputError, match=r"a link laser_2 there already; .* laser_2, tool0"):
        put(taken)
    put(taken, beams=("1", "3"))
    with pytest.raises(hl.InputError, match="a joint laser_3_joint there already"):
        put(ROBOT.replace('"turn"', '"laser_3_joint"'))
    twice = put(ROBOT).decode()
    with pytest.raises(hl.InputError, match="a link laser_1 there already"):
        put(twice)


REFUSED = {
    "no XML": ("<robot name='x'><link name='tool0'></robot>", "no XML \\(mismatched tag\\)"),
    "nothing": ("", "no XML"),
    "another root": ("<sdf><link name='tool0'/></sdf>", "the root element 'sdf'"),
    "a link twice": ("<robot><link name='tool0'/><link name='tool0'/></robot>", "'tool0' twice"),
    "macros only": (
        "<robot xmlns:xacro='x'><xacro:macro><link name='tool0'/></xacro:macro></robot>",
        "expected a URDF with links",
    ),
    "no UTF-8": ('<robot><link name="tool0" a="\xe4"/></robot>'.encode("latin-1"), "not UTF-8"),
    "laughs": (
        '<!DOCTYPE r [<!ENTITY a "aaaaaaaaaa">'
        + "".join(
            f'<!ENTITY {b} "{f"&{a};" * 10}">' for a, b in zip("abcdefgh", "bcdefghi", strict=True)
        )
        + '\n]><robot><link name="tool0"/>&i;</robot>',
        "no XML",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_is_no_urdf_is_refused(put, case):
    text, words = REFUSED[case]
    with pytest.raises(hl.InputError, match=words) as caught:
        put(text)
    assert "\n" not in str(caught.value)
    assert "robot.urdf" in str(caught.value)


def test_many_links_are_not_all_listed(put):
    many = "".join(f'<link name="link{i}"/>' for i in range(100))
    with pytest.raises(hl.InputError, match="link11 and 88 more"):
        put(f"<robot>{many}</robot>")
