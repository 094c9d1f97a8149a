"""README, examples and benchmark run as written."""

import ast
import json
import re
import runpy
import sys
from string import Formatter

import pytest
from helpers import ROOT

README = (ROOT / "README.md").read_text()
STUDIES = (ROOT / "docs" / "studies.md").read_text()
BLOCKS = re.findall(r"```python\n(.*?)```", README + STUDIES, flags=re.DOTALL)


@pytest.mark.slow
@pytest.mark.parametrize("block", BLOCKS)
def test_python_of_the_readme(block, monkeypatch):
    monkeypatch.chdir(ROOT)
    exec(compile(block, "README.md", "exec"), {"__name__": "readme"})


def test_the_study_in_the_documents_is_one(tmp_path):
    from handlaser_gtsam import read_study

    (text,) = re.findall(r"```toml\n(.*?)```", STUDIES, flags=re.DOTALL)
    (tmp_path / "study.toml").write_text(text)
    assert len(read_study(tmp_path / "study.toml").cases) == 2
    assert read_study(ROOT / "examples" / "study" / "study.toml").runs > 0


def test_the_recording_in_the_readme_reads(tmp_path):
    from handlaser_gtsam import read_recording

    (text,) = re.findall(r"```text\n(plane,.*?)```", README, flags=re.DOTALL)
    (tmp_path / "recording.csv").write_text(text)
    assert read_recording(tmp_path / "recording.csv").ranges.shape == (2, 2)


def test_links_of_the_documents_lead_somewhere():
    documents = [ROOT / "README.md", *(ROOT / "docs").glob("*.md")]
    links = [
        (document, target)
        for document in documents
        for target in re.findall(r"\]\(([^)#]+)", document.read_text())
        if "://" not in target
    ]
    assert len(links) > len(documents)
    assert [link for link in links if not (link[0].parent / link[1]).exists()] == []


@pytest.mark.slow
@pytest.mark.parametrize("example", sorted((ROOT / "examples").glob("0*.py")), ids=lambda p: p.name)
def test_examples_run(example, capsys):
    """As programs, under the warning filters of the tests themselves."""
    runpy.run_path(str(example), run_name="__main__")
    assert capsys.readouterr().out.strip()


def test_the_first_example_is_short():
    assert len((ROOT / "examples" / "01_calibrate.py").read_text().splitlines()) < 30


def test_the_converter_refuses_folders_that_do_not_match(tmp_path, monkeypatch):
    (tmp_path / "transforms.csv").write_text("1,0,0,0,0,1,0,0,0,0,1,0,0,0,0,1,\n")
    (tmp_path / "measurements.csv").write_text("t,300,301\nt,302\n")
    converter = ROOT / "examples" / "spd_to_recording.py"
    monkeypatch.setattr(sys, "argv", ["", str(tmp_path), str(tmp_path / "out.csv")])
    with pytest.raises(SystemExit, match="1 poses and 2 readings"):
        runpy.run_path(str(converter), run_name="__main__")
    assert not (tmp_path / "out.csv").exists()


@pytest.mark.slow
def test_the_benchmark_compares_solvers_on_one_optimum(tmp_path, monkeypatch):
    out = tmp_path / "rows.json"
    arguments = ["--planes", "4", "6", "--repeat", "1", "--together", "5", "--out"]
    monkeypatch.setattr(sys, "argv", ["", *arguments, str(out)])
    runpy.run_module("benchmarks.solve", run_name="__main__")
    rows = json.loads(out.read_text())
    assert [(row["solver"], row["planes"]) for row in rows] == [
        (solver, planes)
        for planes in (4, 6)
        for solver in ("graph", "sums", "reduction", "reference", "gtsam-lm")
    ]
    for planes in (4, 6):
        costs = [row["cost"] for row in rows if row["planes"] == planes]
        assert max(costs) - min(costs) <= 1e-6 * min(costs)
    assert all(row["seconds"] > 0.0 and row["iterations"] > 0 for row in rows)


def test_every_code_has_its_row():
    """Of verdicts, systematic errors, and warnings, whose codes stand in calls all over the package."""
    from handlaser_gtsam.model.effects import EFFECTS
    from handlaser_gtsam.results.messages import MESSAGES
    from handlaser_gtsam.results.verdict import OPENING

    page = (ROOT / "docs" / "messages.md").read_text()
    first = " ".join(re.findall(r"^\| (.*?) \|", page, re.MULTILINE))
    listed = set(re.findall(r"`([a-z-]+)`", first))
    assert {*OPENING, *EFFECTS} <= listed
    codes = {message.partition(":")[0] for message in MESSAGES["warnings"]}
    for path in (ROOT / "handlaser_gtsam").rglob("*.py"):
        for call in re.findall(r"CalibrationWarning\(\s*\"([a-z-]+)\"", path.read_text()):
            codes.add(call)
    assert len(codes) > 10
    assert codes <= listed, codes - listed


@pytest.mark.slow
def test_words_hold_what_their_call_gives_and_each_is_used():
    """Placeholders are keys of mappings, or keywords, in the function that warns or says them."""
    from handlaser_gtsam.results.dependence import Dependence
    from handlaser_gtsam.results.messages import MESSAGES

    package, given, tables = ROOT / "handlaser_gtsam", {"checks"}, set()
    used = {"checks"}  # it stands in others
    folders = "results", "files", "session", "validation", "cli"
    paths = [path for folder in folders for path in (package / folder).rglob("*.py")]
    trees = {path: ast.parse(path.read_text()) for path in paths}
    constants = {
        node.targets[0].id: node.value.value
        for tree in trees.values()
        for node in tree.body
        if isinstance(node, ast.Assign)
        and isinstance(node.value, ast.Constant)
        and isinstance(node.value.value, str)
        and isinstance(node.targets[0], ast.Name)
    }
    for path, tree in trees.items():
        for function in (node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)):
            keys = {
                key.value
                for node in ast.walk(function)
                if isinstance(node, ast.Dict)
                for key in node.keys
                if isinstance(key, ast.Constant)
            }
            for call in ast.walk(function):
                called = getattr(getattr(call, "func", None), "id", "")
                if called not in ("warned", "said", "improvement_of", "table_of", "listed"):
                    continue
                first = call.args[0]
                words = ast.unparse(first)
                if words in ("name", "sentence", "f'best:{message}'", "f'table:{name}'"):
                    continue  # what the calls of these functions name
                if called == "table_of" and not isinstance(first, ast.Constant):
                    continue  # a table of a file
                table = MESSAGES["warnings" if called == "warned" else "sentences"]
                parts = first.values if isinstance(first, ast.JoinedStr) else [first]
                pattern = "best:" if called == "improvement_of" else ""
                if called in ("table_of", "listed"):
                    pattern = "table:"
                    tables.add(first.value)
                if words == "worst":
                    pattern, parts = "best:(poses|range-span|motion:.*)", []
                for part in parts:
                    if isinstance(part, ast.FormattedValue):
                        part = part.value
                    text = getattr(part, "value", constants.get(getattr(part, "id", "")))
                    pattern += "[a-z:_ -]+" if text is None else re.escape(text)
                here = {one for one in table if re.fullmatch(pattern, one)}
                assert here or pattern.startswith("table:"), (path.name, call.lineno)
                used |= here
                named = {word.arg for word in call.keywords}
                if pattern.startswith("without:"):
                    named = {*(named - {None}), *"xyzABC"}
                if None in named and called == "said":
                    continue  # of a mapping of places or sigmas, which a target has
                words = named | keys | given
                words |= {"number"} if len(call.args) > 1 else set()
                if path.name == "dependence.py":
                    words |= set(Dependence._fields)
                for message in here:
                    fields = {name for _, name, _, _ in Formatter().parse(table[message]) if name}
                    assert fields <= words, (path.name, message, fields - words)
    assert used == {*MESSAGES["warnings"], *MESSAGES["sentences"]}
    assert tables == {*MESSAGES["tables"]}


def test_results_are_of_this_version():
    """Figures of versions before stood beside the present ones, and were taken for these."""
    text = (ROOT / "docs" / "results.md").read_text()
    for words in ("the version before", "Before the ", "took 28", "since the solver became"):
        assert words not in text
