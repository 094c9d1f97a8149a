"""Links and joints put into a URDF: nothing else of it changes."""

import re
from collections.abc import Sequence
from pathlib import Path
from xml.etree import ElementTree
from xml.parsers import expat

from ...errors import InputError
from ...results.lines import NAMES_ON_PAGE
from ...text import shown, some
from ..checked_text import read_text

END = re.compile(r"</robot\s*>(?:\s|<!--(?:(?!-->).)*-->|<\?(?:(?!\?>).)*\?>)*\Z", re.DOTALL)
"""The end of the root, behind which nothing but comments and instructions may follow."""


def put_into(path: Path, added: str, identifiers: Sequence[str], link: str) -> str:
    """Return the text of a URDF into which links and joints were put before its end.

    `identifiers` name the links that are added; their joints are called `NAME_joint`.

    Raises
    ------
    InputError
        No URDF in UTF-8, no such link in it, or links or joints in it that have the names of beams.
    """
    text = read_text(path, "a URDF file")
    try:
        root = ElementTree.fromstring(text.encode())
    except ElementTree.ParseError as error:
        what = expat.ErrorString(error.code)
        raise InputError(f"no XML ({what})", "a URDF file", path, error.position[0]) from error
    if root.tag != "robot":
        raise InputError(f"the root element {shown(root.tag)}", "a URDF file: <robot>", path)
    links = [one.get("name", "") for one in root.findall("link")]
    if link not in links:
        expected = f"one of {some(links, NAMES_ON_PAGE)}" if links else "a URDF with links"
        raise InputError(f"no link {shown(link)}", expected, path)
    if links.count(link) > 1:
        raise InputError(f"the link {shown(link)} twice", "every link once", path)
    # Only those of the root: a joint in a transmission only refers to one.
    joints = [one.get("name", "") for one in root.findall("joint")]
    for kind, there, names in (
        ("link", links, list(identifiers)),
        ("joint", joints, [f"{name}_joint" for name in identifiers]),
    ):
        taken = [name for name in names if name in there]
        if taken:
            found = f"a {kind} {taken[0]} there already"
            raise InputError(
                found, f"a URDF without the beams; it has {some(there, NAMES_ON_PAGE)}", path
            )
    end = END.search(text)
    assert end is not None  # for there is a link inside
    before, after = text[: end.start()], text[end.start() :]
    ending = "\r\n" if "\r\n" in before else "\n"
    added = added.replace("\n", ending)
    head, newline, last = before.rpartition("\n")
    if newline and not last.strip():  # the end stands on a line of its own, and keeps its indent
        return head + newline + added + last + after
    return before + ending + added + after
