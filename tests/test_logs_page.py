"""The page on logs runs as it is written."""

import re
import shlex
import tomllib

import pytest
from helpers import ROOT

import handlaser_gtsam as hl

PAGE = (ROOT / "docs" / "logs.md").read_text()
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


def test_the_rig_of_the_page_reads_the_log_of_the_page(tmp_path):
    (text,) = re.findall(r"```toml\n(.*?)```", PAGE, flags=re.DOTALL)
    assert tomllib.loads(text)
    (tmp_path / "rig.toml").write_text(text)
    given = hl.read_rig(tmp_path / "rig.toml").log
    recording = hl.read_log(ROOT / "examples" / "logs" / "kuka.csv", given)
    assert recording.ranges.shape == (44, 4)
