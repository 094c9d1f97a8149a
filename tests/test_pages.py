"""The site: pages that are followed command by command run as written, and the API page is whole."""

import re
import shlex

import annotations
import pytest
from helpers import ROOT

import handlaser_gtsam as hl

DOCS = ROOT / "docs"


@pytest.mark.slow
@pytest.mark.parametrize(
    "page", ["tutorial", "trust", pytest.param("sensors", marks=pytest.mark.slow)]
)
def test_commands_of_a_page_run_in_order(page, handlaser, monkeypatch, tmp_path):
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    monkeypatch.chdir(tmp_path)
    blocks = re.findall(r"```sh\n(.*?)```", (DOCS / f"{page}.md").read_text(), flags=re.DOTALL)
    lines = "".join(blocks).splitlines()
    assert lines
    for line in lines:
        name, *words = shlex.split(line)
        assert name == "handlaser"
        code, out, err = handlaser(*words)
        assert (code, err) == (0, ""), line
        assert out
        if "--out" in words:
            assert (tmp_path / words[words.index("--out") + 1]).stat().st_size > 0


@pytest.mark.slow
def test_the_tutorial_ends_with_urdf_and_report_in_three_commands(refusal):
    text = (DOCS / "tutorial.md").read_text()
    commands = re.findall(r"^handlaser .*$", text, re.MULTILINE)
    assert len(commands) == 3
    assert "--report calibration.html" in commands[1]
    assert "--to urdf" in commands[2]
    assert "--pose-format kuka" in refusal(*shlex.split(commands[0])[1:-2], *fanuc(text))


def fanuc(text):
    """The wrong convention that the tutorial tells to try, with the folder of the repository."""
    words = shlex.split(re.search(r"`(--pose-format fanuc [^`]*)`", text)[1])
    return [*words, "--readings", str(ROOT / "examples" / "logs" / "kuka_lasers.csv")]


def test_the_page_on_python_holds_every_public_name():
    text = (DOCS / "api.md").read_text()
    listed = re.findall(r"^::: handlaser_gtsam\.([\w.]+)$", text, re.MULTILINE)
    homes = {one.rpartition(".")[2]: one.rpartition(".")[0] for one in listed}
    assert len(listed) == len(homes)
    things = annotations.offered()
    whole = {*dir(hl.factors), *dir(hl.model)}  # described as modules
    assert set(things) - whole <= set(homes)
    assert set(homes) - {"factors"} <= set(things)
    table = {
        name: set(re.findall(r"`(\w+)`", held))
        for name, held in re.findall(r"^\| `hl\.(\w+)` \| (.*) \|$", text, re.MULTILINE)
    }
    assert {name: set(dir(getattr(hl, name))) for name in set(table) - {"model"}} == {
        name: held for name, held in table.items() if name != "model"
    }
    assert table["model"] <= set(dir(hl.model))
    for name in set(homes) - {"factors"}:
        assert homes[name] == things[name].__module__.removeprefix("handlaser_gtsam.")


def test_every_page_is_in_the_navigation():
    nav = (ROOT / "mkdocs.yml").read_text().split("\nnav:\n")[1]
    assert set(re.findall(r"(\w+)\.md", nav)) == {page.stem for page in DOCS.glob("*.md")}
