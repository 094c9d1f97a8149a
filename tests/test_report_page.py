"""The page on reports runs as it is written."""

import re
import shlex
import shutil

import pytest
from helpers import ROOT

from handlaser_gtsam.files.report.page import SECTIONS

PAGE = (ROOT / "docs" / "report.md").read_text()
COMMANDS = "".join(re.findall(r"```sh\n(.*?)```", PAGE, flags=re.DOTALL)).splitlines()


@pytest.fixture
def examples(tmp_path, monkeypatch):
    shutil.copytree(ROOT / "examples" / "gripper", tmp_path / "examples" / "gripper")
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.slow
def test_python_of_the_page(examples):
    pytest.importorskip("matplotlib", reason="needs the extra plots")
    (block,) = re.findall(r"```python\n(.*?)```", PAGE, flags=re.DOTALL)
    exec(compile(block, "report.md", "exec"), {"__name__": "report"})
    written = {path.name for path in examples.iterdir()}
    assert written == {"examples", "calibration.html", "by-range.svg", "pictures"}


@pytest.mark.slow
@pytest.mark.parametrize("line", COMMANDS)
def test_commands_of_the_page(line, handlaser, examples):
    words = shlex.split(line)
    assert words[0] == "handlaser"
    if words[1] == "plot":
        pytest.importorskip("matplotlib", reason="needs the extra plots")
    code, _, err = handlaser(*words[1:])
    assert (code, err) == (0, "")
    names = [words[i + 1] for i, word in enumerate(words) if word in ("--report", "--out")]
    assert {path.name for path in examples.iterdir()} == {"examples", *names}


def test_every_part_of_the_report_is_explained():
    listed = re.findall(r"^\| ([A-Z][\w -]*) \|", PAGE, re.MULTILINE)
    assert listed == [name for name in SECTIONS.values() if name]
