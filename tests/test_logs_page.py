"""The page on logs runs as it is written."""

import re
import runpy
import shlex
import sys
import tomllib

import pytest
from bags import HAS_ROSBAGS
from helpers import ROOT

import handlaser_gtsam as hl

PAGE = (ROOT / "docs" / "logs.md").read_text()
BAGS = "".join(re.findall(r"```ros\n(.*?)```", PAGE, flags=re.DOTALL)).splitlines()
COMMANDS = "".join(re.findall(r"```sh\n(.*?)```", PAGE, flags=re.DOTALL)).splitlines()


@pytest.mark.parametrize("block", re.findall(r"```python\n(.*?)```", PAGE, flags=re.DOTALL))
def test_python_of_the_page(block, monkeypatch):
    monkeypatch.chdir(ROOT)
    exec(compile(block, "logs.md", "exec"), {"__name__": "logs"})


@pytest.mark.parametrize("line", COMMANDS)
def test_commands_of_the_page(line, handlaser, monkeypatch, tmp_path):
    monkeypatch.chdir(ROOT)
    words = shlex.split(line)
    assert words[0] == "handlaser"
    outputs = [i + 1 for i, word in enumerate(words) if word == "--out"]
    for i in outputs:
        words[i] = str(tmp_path / words[i])
    code, _, err = handlaser(*words[1:])
    assert (code, err) == (0, "")
    assert len(list(tmp_path.iterdir())) == len(outputs)


@pytest.mark.slow
@pytest.mark.skipif(not HAS_ROSBAGS, reason="needs rosbags")
def test_commands_for_bags(handlaser, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    first, *others = map(shlex.split, BAGS)
    monkeypatch.setattr(sys, "argv", first[1:])
    runpy.run_path(str(ROOT / first[1]), run_name="__main__")
    for words in others:
        assert words[0] == "handlaser"
        code, out, err = handlaser(*words[1:])
        assert (code, err) == (0, "")
        if "--estimate-lag" in words or words[1] == "calibrate":
            (lag,) = re.findall(r"stamped ([\d.]+) ms later", " ".join(out.split()))
            assert abs(float(lag) - 40.0) < 10.0
    assert (tmp_path / "recording.csv").exists()
    assert len(others) == 3


def test_the_rig_of_the_page_reads_the_log_of_the_page(tmp_path):
    (text,) = re.findall(r"```toml\n(.*?)```", PAGE, flags=re.DOTALL)
    assert tomllib.loads(text)
    (tmp_path / "rig.toml").write_text(text)
    given = hl.read_rig(tmp_path / "rig.toml").log
    recording = hl.read_log(ROOT / "examples" / "logs" / "kuka.csv", given)
    assert recording.ranges.shape == (44, 4)
