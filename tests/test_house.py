"""The page on the house names every folder, every step of the way exists, and its code runs."""

import ast
import re

import pytest
from helpers import ROOT

PACKAGE = ROOT / "handlaser_gtsam"
PAGE = (ROOT / "docs" / "house.md").read_text()


def section(title: str) -> str:
    return PAGE.split(f"## {title}\n")[1].split("\n## ")[0]


def test_the_page_names_every_folder_and_nothing_else():
    listed = re.findall(
        r"^\| `(\w+)/` \|", section("The folders, from the ground up"), re.MULTILINE
    )
    folders = [path.name for path in PACKAGE.iterdir() if (path / "__init__.py").exists()]
    assert sorted(listed) == sorted(folders)


def test_every_step_of_the_way_is_there():
    way = section("From the CSV row to the verdict")
    steps = re.findall(r"\| `([\w/]+\.py)` \| `(\w+)` \|", way)
    assert len(steps) == way.count("\n|") - 2  # all rows but the two of the header
    for file, name in steps:
        tree = ast.parse((PACKAGE / file).read_text())
        assert name in {getattr(node, "name", "") for node in tree.body}, (file, name)


def test_every_file_that_the_page_names_is_there():
    for file in re.findall(r"`([\w/]+\.py)`", PAGE):
        assert (PACKAGE / file).exists(), file


@pytest.mark.parametrize("block", re.findall(r"```python\n(.*?)```", PAGE, flags=re.DOTALL))
def test_python_of_the_page(block, monkeypatch):
    monkeypatch.chdir(ROOT)
    exec(compile(block, "house.md", "exec"), {"__name__": "house"})
