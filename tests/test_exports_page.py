"""The page on exports runs as it is written, and its table is that of the command."""

import re
import shlex

import pytest
from helpers import ROOT

from handlaser_gtsam.files.exports.formats import FORMATS

PAGE = (ROOT / "docs" / "exports.md").read_text()
COMMANDS = "".join(re.findall(r"```sh\n(.*?)```", PAGE, flags=re.DOTALL)).splitlines()


@pytest.fixture
def folder(monkeypatch, tmp_path):
    """Work in a folder with the examples, and whatever the page writes."""
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.slow
def test_the_page_runs_in_its_order(handlaser, folder):
    written = {"examples"}
    for line in COMMANDS:
        words = shlex.split(line)
        assert words[0] == "handlaser"
        code, out, err = handlaser(*words[1:])
        assert code == 0, err
        assert "Traceback" not in err
        if "--out" in words:
            name = words[words.index("--out") + 1]
            written.add(name)
            assert (folder / name).stat().st_size > 0
        else:
            assert "laser_1" in out
    assert {path.name for path in folder.iterdir()} == written
    (block,) = re.findall(r"```python\n(.*?)```", PAGE, flags=re.DOTALL)
    names = {"__name__": "exports"}
    exec(compile(block, "exports.md", "exec"), names)
    mounts, beam = names["mounts"], names["file"].beams[0]
    assert mounts.locations[0].tolist() == list(beam.location_m)  # arrays, and what the file has


def test_every_format_is_on_the_page():
    table = re.findall(r"^\| `([\w-]+)` \|", PAGE, flags=re.MULTILINE)
    named = [name for name in table if name in FORMATS]
    assert sorted(named) == sorted(FORMATS)
    assert {re.search(r"--to (\S+)", line)[1] for line in COMMANDS if "--to" in line} == {*FORMATS}
