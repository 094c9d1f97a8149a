"""The house: data flows one way, and what talks to the outside stands in one place."""

import ast
import tomllib
from functools import cache
from pathlib import Path

from helpers import ROOT

PACKAGE = ROOT / "handlaser_gtsam"

FLOORS = [
    "base",
    "data",
    "model",
    "factors",
    "solvers",
    "starts",
    "observability",
    "outliers",
    "estimation",
    "results",
    "pipeline",
    "validation",
    "planning",
    "session",
    "files",
    "cli",
]
"""From the ground up, one folder a floor. A module may import from its own floor or below."""
BASE = ("arrays", "checks", "errors", "lazy", "progress", "quantities", "text")
"""The files that lie flat below all folders."""
WITHOUT_GTSAM = ("data", "model", "starts", "observability", "outliers")
"""Floors that work on NumPy alone, with all that they import."""
MADE_UP = {"validation.scenes", "validation.simulate"}
"""Modules that do so, too."""


def modules() -> dict[str, Path]:
    """Every module of the package by its name inside the package, factors/ included."""
    found = {}
    for folder, prefix in ((PACKAGE, ()), (ROOT / "factors", ("factors",))):
        for path in folder.rglob("*.py"):
            if folder == PACKAGE and "factors" in path.relative_to(PACKAGE).parts:
                continue
            parts = (*prefix, *path.relative_to(folder).with_suffix("").parts)
            found[".".join(part for part in parts if part != "__init__")] = path
    return found


MODULES = modules()


@cache
def tree(name: str) -> ast.Module:
    """The syntax of a module."""
    return ast.parse(MODULES[name].read_text())


@cache
def imports(name: str) -> set[str]:
    """Names inside the package that a module imports at run time, and outer packages."""
    path = MODULES[name]
    parts = name.split(".") if name else []
    package = parts if path.name == "__init__.py" else parts[:-1]
    found = set()
    checking = {
        id(node)
        for block in ast.walk(tree(name))
        if isinstance(block, ast.If) and "TYPE_CHECKING" in ast.dump(block.test)
        for node in ast.walk(block)
    }
    for node in ast.walk(tree(name)):
        if id(node) in checking:
            continue
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        if isinstance(node, ast.ImportFrom):
            base = node.module.split(".") if node.module else []
            if node.level:
                base = package[: len(package) - node.level + 1] + base
            elif base[0] == "handlaser_gtsam":
                base = base[1:]
            inner = ".".join(base)
            if node.level or (node.module or "").startswith("handlaser_gtsam"):
                for alias in node.names:
                    full = f"{inner}.{alias.name}".strip(".")
                    found.add(full if full in MODULES else inner)
            else:
                found.add(node.module or "")
    return found


def room(name: str) -> str:
    """The floor on which a module stands."""
    return "base" if name in BASE else name.split(".")[0]


def test_every_module_has_a_floor():
    assert {room(name) for name in MODULES if name} == set(FLOORS)


def test_arrows_point_downwards():
    wrong = []
    for name in filter(None, MODULES):
        here = FLOORS.index(room(name))
        wrong += [
            f"{name} imports {target}"
            for target in imports(name) & set(filter(None, MODULES))
            if FLOORS.index(room(target)) > here
        ]
    assert not wrong


def test_nothing_private_is_imported_across_rooms():
    wrong, seen = [], 0
    for name, path in MODULES.items():
        outside = 1 if path.parent == PACKAGE else 2
        for node in ast.walk(tree(name)):
            if not isinstance(node, ast.ImportFrom) or node.level < outside:
                continue
            seen += 1
            wrong += [
                f"{name} imports {alias.name}"
                for alias in node.names
                if alias.name.startswith("_") and not alias.name.endswith("__")
            ]
    assert seen > 100
    assert not wrong


def test_there_are_no_circles():
    graph = {name: imports(name) & set(MODULES) - {name, ""} for name in MODULES}
    done: set[str] = set()

    def visit(name: str, path: tuple[str, ...]) -> None:
        assert name not in path, " -> ".join((*path, name))
        if name not in done:
            for target in graph[name]:
                visit(target, (*path, name))
            done.add(name)

    for name in graph:
        visit(name, ())


def test_the_mathematics_does_not_know_gtsam():
    """Neither itself nor through a solver that it calls."""
    waiting = [name for name in MODULES if room(name) in WITHOUT_GTSAM or name in MADE_UP]
    seen = set(waiting)
    while waiting:
        name = waiting.pop()
        assert "gtsam" not in imports(name), name
        assert room(name) != "factors", name
        further = imports(name) & set(filter(None, MODULES)) - seen
        seen |= further
        waiting += further
    assert {room(name) for name in seen} > set(WITHOUT_GTSAM)
    assert seen > MADE_UP


def test_every_room_says_its_job():
    rooms = [folder for folder in PACKAGE.iterdir() if (folder / "__init__.py").exists()]
    assert len(rooms) <= 14
    for folder in rooms:
        says = ast.get_docstring(ast.parse((folder / "__init__.py").read_text()))
        assert says, folder
        assert len(says.splitlines()) == 1, folder
    assert len(list(PACKAGE.glob("*.py"))) <= len(BASE) + 2  # pipeline.py and __init__.py


def test_the_reference_shares_no_equation():
    reference = {name for name in MODULES if name.startswith("solvers.reference")}
    assert len(reference) > 3
    data = {"data.parameters", "data.recording", "data.survey"}
    for name in reference:
        assert "gtsam" not in imports(name)
        assert imports(name) & set(MODULES) <= {"arrays", "errors", *data, *reference}


@cache
def calls(name: str) -> set[str]:
    return {ast.unparse(node.func) for node in ast.walk(tree(name)) if isinstance(node, ast.Call)}


def test_only_the_command_line_prints():
    assert [name for name in MODULES if "print" in calls(name) and not name.startswith("cli")] == []


def test_only_files_opens_files():
    """By a method of a path, or `open`; anybody may call the functions of `files`.

    `os.open` is not meant: it opens the null device for a stdout whose reader has gone away; nor is
    `webbrowser.open`, which opens no file.
    """
    methods = {"open", "read_text", "read_bytes", "write_text", "write_bytes", "fdopen", "mkstemp"}
    openers = {
        room(name)
        for name in MODULES
        for call in calls(name) - {"os.open", "webbrowser.open"}
        if call == "open" or ("." in call and call.split(".")[-1] in methods)
    }
    assert openers == {"files"}


def test_only_factors_makes_custom_factors():
    makers = [name for name in MODULES if {"gtsam.CustomFactor", "CustomFactor"} & calls(name)]
    assert {room(name) for name in makers} == {"factors"}


def test_the_link_to_the_factors_is_there():
    assert (PACKAGE / "factors").is_symlink()
    assert (PACKAGE / "factors").resolve() == ROOT / "factors"


def test_every_package_is_shipped():
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text())
    listed = set(settings["tool"]["setuptools"]["packages"])
    folders = {path.parent for path in PACKAGE.rglob("__init__.py")} | {PACKAGE / "factors"}
    assert listed == {".".join(folder.relative_to(ROOT).parts) for folder in folders}
