"""Links and joints put into a URDF: nothing else of it changes."""

from collections.abc import Sequence
from pathlib import Path
from xml.parsers import expat

from ...errors import InputError
from ...results.lines import NAMES_ON_PAGE
from ...text import shown, some
from ..checked_text import read_text


def put_into(path: Path, added: str, identifiers: Sequence[str], link: str) -> str:
    """Return the text of a URDF into which links and joints were put before its end.

    `identifiers` name the links that are added; their joints are called `NAME_joint`.

    Raises
    ------
    InputError
        No URDF in UTF-8, no such link in it, or links or joints in it that have the names of beams.
    """
    text = read_text(path, "a URDF file")
    outline = _Outline(path, text)
    if link not in outline.links:
        found = f"no link {shown(link)}"
        expected = (
            f"one of {some(outline.links, NAMES_ON_PAGE)}" if outline.links else "a URDF with links"
        )
        raise InputError(found, expected, path)
    if outline.links.count(link) > 1:
        raise InputError(f"the link {shown(link)} twice", "every link once", path)
    for kind, there, names in (
        ("link", outline.links, list(identifiers)),
        ("joint", outline.joints, [f"{name}_joint" for name in identifiers]),
    ):
        taken = [name for name in names if name in there]
        if taken:
            raise InputError(
                f"a {kind} {taken[0]} there already",
                f"a URDF without the beams; it has {some(there, NAMES_ON_PAGE)}",
                path,
            )
    before, after = outline.halves
    ending = "\r\n" if "\r\n" in before else "\n"
    added = added.replace("\n", ending)
    head, newline, last = before.rpartition("\n")
    if newline and not last.strip():  # the end stands on a line of its own, and keeps its indent
        return head + newline + added + last + after
    return before + ending + added + after


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
