"""Every term that the screen shows stands in the glossary."""

import re
import shutil

import pytest
from helpers import GRIPPER, ROOT, degenerate
from profiler_example import FOLDER

import handlaser_gtsam as hl
from handlaser_gtsam.model.effects import EFFECTS
from handlaser_gtsam.model.families import BEAM
from handlaser_gtsam.results.description import tables, terminal
from handlaser_gtsam.results.verdict import OPENING

PAGE = (ROOT / "docs" / "glossary.md").read_text()
ENTRIES = re.findall(r"^\| (\*\*.*?) \| (.*) \|$", PAGE, flags=re.MULTILINE)
TERMS = [term for names, _ in ENTRIES for term in re.findall(r"\*\*(.+?)\*\*", names)]
RIG = ("--rig", "rig.toml")
LOG = [
    "--pose-format",
    "kuka",
    "--station-column",
    "Point",
    "--plane-column",
    "Plate",
    "--range-units",
    "mm",
]
CHANNELS = ("--range-columns", "1=Laser 1,2=Laser 2,3=Laser 3,4=Laser 4")
LASERS = ("--readings", "kuka_lasers.csv", *CHANNELS, "--range-units", "mm")
KUKA = """
[log]
pose_format = "kuka"
station_column = "Point"
plane_column = "Plate"
readings = "kuka_lasers.csv"
range_columns = ["1=Laser 1", "2=Laser 2", "3=Laser 3", "4=Laser 4"]
range_units = "mm"
"""
PROFILER = (str(FOLDER / "poses.csv"), "--rig", str(FOLDER / "rig.toml"))
SCREENS = (
    ("convert", "kuka_poses.csv", *LASERS, *LOG),
    ("calibrate", "kuka_poses.csv", "--rig", "kuka.toml"),
    ("calibrate", "recording.csv", *RIG, "-v", "--incremental", "--cross-check"),
    ("calibrate", "recording.csv", *RIG, "--cross-check"),
    ("calibrate", "recording.csv", "-v", "--range-error", "k1"),
    ("calibrate", "recording.csv", "-v", "--range-error", "none", "--poses", "exact"),
    ("calibrate", "recording.csv", "--rig", "tight.toml"),
    ("calibrate", "outliers.csv", *RIG, "-v"),
    ("calibrate", "degenerate.csv"),
    ("calibrate", "degenerate.csv", "-v"),
    ("check", "recording.csv", *RIG),
    ("validate", "recording.csv", *RIG, "--splits", "1"),
    ("validate", "recording.csv", *RIG, "--hold-out", "recording.csv"),
    ("plan", "recording.csv", *RIG, "--stations", "3"),
    ("plan", "--rig", "planned.toml"),
    ("study", "study.toml", "--runs", "2"),
    ("check", *PROFILER),
    ("calibrate", *PROFILER, "--incremental"),
    ("validate", *PROFILER, "--splits", "1"),
    ("plan", *PROFILER, "--stations", "1"),
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("screens")
    for source in (GRIPPER / "recording.csv", GRIPPER / "rig.toml"):
        shutil.copy(source, path)
    shutil.copy(ROOT / "examples" / "planned" / "rig.toml", path / "planned.toml")
    shutil.copy(ROOT / "examples" / "study" / "study.toml", path)
    for name in ("kuka_poses.csv", "kuka_lasers.csv"):
        shutil.copy(ROOT / "examples" / "logs" / name, path)
    (path / "kuka.toml").write_text(KUKA)
    rig = (path / "rig.toml").read_text()
    (path / "tight.toml").write_text(f"{rig}\n[limits]\nrms_mm = 0.001\nlocation_sigma_mm = 5\n")
    hl.write_recording(path / "degenerate.csv", degenerate("two planes, no rotation"))
    rows = (path / "recording.csv").read_text().splitlines()
    for number in (4, 17):  # two readings that are far off
        cells = rows[number].split(",")
        cells[-1] = str(float(cells[-1]) + 0.004)
        rows[number] = ",".join(cells)
    (path / "outliers.csv").write_text("\n".join(rows) + "\n")
    return path


@pytest.fixture
def headings(monkeypatch):
    """Collect the heads of columns of the tables that are shown."""
    found = set()
    for module in (tables, terminal):
        show = module.text_table

        def showing(table, *rest, show=show):
            found.update(column.title for column in table.columns)
            return show(table, *rest)

        monkeypatch.setattr(module, "text_table", showing)
    return found


def known(label):
    """Tell whether terms of the glossary begin all parts of a label, as of "2 beams, start"."""
    parts = [label]
    if label[0].isdigit() and not label.startswith("30 %"):
        parts = [re.sub(r"^\d+ ", "", part) for part in re.split("[,;] ", label)]
    return all(any(re.match(rf"{re.escape(t)}s?(?![\w-])", part) for t in TERMS) for part in parts)


@pytest.mark.slow
@pytest.mark.parametrize("screen", SCREENS, ids=" ".join)
def test_what_lines_begin_with_and_heads_of_tables(
    handlaser, folder, monkeypatch, headings, screen
):
    monkeypatch.chdir(folder)
    code, out, _ = handlaser(*screen)
    assert code in (0, 3, 4)
    assert headings <= set(TERMS), headings - set(TERMS)
    labels = {m[1] for m in re.finditer(r"^([^\s:][^:\n]{0,70}):(?=\s|$)", out, re.MULTILINE)}
    assert labels or screen[0] in ("plan", "study")
    missing = {label for label in labels if not known(label)}
    assert not missing
    for head in re.findall(r"^(stations  .*|beam   .*)$", out, re.MULTILINE):
        for word in re.split(r"  +|: |, ", head):
            term = re.sub(r" \[.*?\]", "", word).replace("unit direction", "direction")
            assert known(term), word


def test_words_of_the_code_are_there():
    """Rows of tables, verdicts, systematic errors, and heads that only some screens show."""
    words = [*BEAM.labels, *OPENING.values(), *EFFECTS]
    assert set(words) <= set(TERMS), set(words) - set(TERMS)


@pytest.mark.parametrize(
    "term",
    [
        "numbers from shots",
        "errors and relations",
        "robot errors",
        "in general position",
        "hand by pose",
    ],
)
def test_terms_within_sentences_are_said_and_explained(term):
    """Where lines do not begin with them."""
    said = "".join(path.read_text() for path in (ROOT / "handlaser_gtsam").rglob("*.py"))
    said += (ROOT / "handlaser_gtsam/results/messages.toml").read_text()
    assert term in said
    assert term in TERMS


def test_every_term_stands_once_and_means_something():
    assert len(TERMS) > 100
    assert sorted(TERMS) == sorted(set(TERMS))
    for names, meaning in ENTRIES:
        assert len(meaning.split()) >= 3, names
        assert meaning.endswith("."), names
    rows = [
        line for line in PAGE.splitlines() if line.startswith("| ") and "| meaning |" not in line
    ]
    assert len(rows) == len(ENTRIES)
