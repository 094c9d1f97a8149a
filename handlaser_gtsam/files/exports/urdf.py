"""Beams as URDF and xacro: a link and a fixed joint for each, the beam along +x of its link.

That is what `sensor_msgs/Range` wants of the frame that its messages name.
"""

from collections.abc import Sequence
from pathlib import Path
from xml.parsers import expat
from xml.sax.saxutils import quoteattr

from ...errors import InputError
from ...text import shown, some
from ..checked_text import read_text
from .beams import ROLL, ExportedBeam, number, origin_line
from .frames import yaw_pitch_roll

SHOWN = 40
"""Names of links that a message lists."""
XACRO = "http://www.ros.org/wiki/xacro"


def urdf_text(beams: Sequence[ExportedBeam], link: str) -> str:
    """Return links and joints to put into the `<robot>` of a URDF."""
    return _comments() + "".join(_beam(beam, quoteattr(link)) for beam in beams)


def xacro_text(beams: Sequence[ExportedBeam], link: str) -> str:
    """Return a xacro file with a macro `handlaser_beams`, whose parent is `link` unless told."""
    inside = "".join(_beam(beam, '"${parent}"', "${prefix}") for beam in beams)
    inside = "".join(f"  {line}\n" for line in inside.splitlines())
    params = quoteattr(f"parent:={link} prefix:=''")
    return (
        f'<?xml version="1.0"?>\n<robot xmlns:xacro="{XACRO}">\n{_comments()}'
        "  <!-- Include this file, and call <xacro:handlaser_beams/> once in the robot. -->\n"
        f'  <xacro:macro name="handlaser_beams" params={params}>\n{inside}'
        "  </xacro:macro>\n</robot>\n"
    )


def urdf_with(path: Path, beams: Sequence[ExportedBeam], link: str) -> str:
    """Return the text of a URDF with beams put in before its end; all else is as it was.

    Raises
    ------
    InputError
        No URDF in UTF-8, no such link in it, or links or joints in it that have the names of beams.
    """
    text = read_text(path, "a URDF file")
    outline = _Outline(path, text)
    if link not in outline.links:
        found = f"no link {shown(link)}"
        expected = f"one of {some(outline.links, SHOWN)}" if outline.links else "a URDF with links"
        raise InputError(found, expected, path)
    if outline.links.count(link) > 1:
        raise InputError(f"the link {shown(link)} twice", "every link once", path)
    for kind, there, names in (
        ("link", outline.links, [beam.identifier for beam in beams]),
        ("joint", outline.joints, [_joint(beam) for beam in beams]),
    ):
        taken = [name for name in names if name in there]
        if taken:
            raise InputError(
                f"a {kind} {taken[0]} there already",
                f"a URDF without the beams; it has {some(there, SHOWN)}",
                path,
            )
    before, after = outline.halves
    ending = "\r\n" if "\r\n" in before else "\n"
    added = urdf_text(beams, link).replace("\n", ending)
    head, newline, last = before.rpartition("\n")
    if newline and not last.strip():  # the end stands on a line of its own, and keeps its indent
        return head + newline + added + last + after
    return before + ending + added + after


def _comments() -> str:
    lines = (
        origin_line(),
        "x of each frame lies along its beam, from where the true range is zero. Units: m, rad.",
        ROLL,
    )
    return "".join(f"  <!-- {line} -->\n" for line in lines)


def _joint(beam: ExportedBeam) -> str:
    return f"{beam.identifier}_joint"


def _beam(beam: ExportedBeam, parent: str, prefix: str = "") -> str:
    """Return the link and the joint of a beam; `parent` is in quotes."""
    frame = beam.frame("x")
    xyz = " ".join(map(number, frame.t))
    rpy = " ".join(map(number, reversed(yaw_pitch_roll(frame.R))))
    name = prefix + beam.identifier
    return (
        f"  <!-- {beam.comment} -->\n"
        f'  <link name="{name}"/>\n'
        f'  <joint name="{prefix}{_joint(beam)}" type="fixed">\n'
        f"    <parent link={parent}/>\n"
        f'    <child link="{name}"/>\n'
        f'    <origin xyz="{xyz}" rpy="{rpy}"/>\n'
        "  </joint>\n"
    )


class _Outline:
    """The links and joints of a URDF, and where its root ends; nothing else of it is looked at."""

    def __init__(self, path: Path, text: str) -> None:
        self.links: list[str] = []
        self.joints: list[str] = []
        self._open: list[str] = []
        self._root, self._end = "", 0
        data = text.encode()
        self._parser = expat.ParserCreate("UTF-8")
        self._parser.StartElementHandler = self._begin
        self._parser.EndElementHandler = self._finish
        try:
            self._parser.Parse(data, True)
        except expat.ExpatError as error:
            what = expat.ErrorString(error.code)
            raise InputError(f"no XML ({what})", "a URDF file", path, error.lineno) from error
        if self._root != "robot":
            raise InputError(f"the root element {shown(self._root)}", "a URDF file: <robot>", path)
        self.halves = data[: self._end].decode(), data[self._end :].decode()

    def _begin(self, name: str, attributes: dict[str, str]) -> None:
        if self._open == ["robot"]:  # a joint in a transmission only refers to one
            named = {"link": self.links, "joint": self.joints}.get(name, [])
            named.append(attributes.get("name", ""))
        self._open.append(name)

    def _finish(self, name: str) -> None:
        self._open.pop()
        if not self._open:
            self._root, self._end = name, self._parser.CurrentByteIndex
