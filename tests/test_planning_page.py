"""The page on planning runs as it is written."""

import re
import shlex
import tomllib

import pytest
from helpers import ROOT

PAGE = (ROOT / "docs" / "planning.md").read_text()
COMMANDS = re.findall(r"```sh\n(.*?)```", PAGE, flags=re.DOTALL)


@pytest.mark.slow
@pytest.mark.parametrize("block", re.findall(r"```python\n(.*?)```", PAGE, flags=re.DOTALL))
def test_python_of_the_page(block, monkeypatch):
    monkeypatch.chdir(ROOT)
    exec(compile(block, "planning.md", "exec"), {"__name__": "planning"})


@pytest.mark.parametrize("line", "".join(COMMANDS).splitlines())
def test_commands_of_the_page(line, handlaser, monkeypatch, tmp_path):
    monkeypatch.chdir(ROOT)
    words = shlex.split(line)
    assert words[0] == "handlaser"
    outputs = [i + 1 for i, word in enumerate(words) if word in ("--out", "--picture")]
    for i in outputs:
        words[i] = str(tmp_path / words[i])
    code, _, err = handlaser(*words[1:])
    assert (code, err) == (0, "")
    assert len(list(tmp_path.iterdir())) == len(outputs)


def test_the_rig_of_the_page_reads(tmp_path):
    from handlaser_gtsam import read_rig

    (text,) = re.findall(r"```toml\n(.*?)```", PAGE, flags=re.DOTALL)
    assert tomllib.loads(text)
    (tmp_path / "rig.toml").write_text(text)
    rig = read_rig(tmp_path / "rig.toml")
    assert rig.workspace is not None
    assert rig.bounds is not None
