"""The page on the house names every folder and every step of the way; code on the method runs."""

import re
import sys
from pathlib import Path

import pytest
from helpers import GRIPPER, ROOT
from profiler_example import FOLDER

import handlaser_gtsam as hl

PACKAGE = Path(hl.__file__).parent
"""Where the package that runs is: installed, it may be elsewhere than these tests."""
PAGE = (ROOT / "docs" / "house.md").read_text()
METHOD = (ROOT / "docs" / "method.md").read_text()


def section(title: str) -> str:
    return PAGE.split(f"## {title}\n")[1].split("\n## ")[0]


def test_the_page_names_every_folder_and_nothing_else():
    listed = re.findall(
        r"^\| `(\w+)/` \|", section("The folders, from the ground up"), re.MULTILINE
    )
    folders = [path.name for path in PACKAGE.iterdir() if (path / "__init__.py").exists()]
    assert sorted(listed) == sorted(folders)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("title", "read"),
    [
        ("From the CSV row to the verdict", lambda: hl.read_recording(GRIPPER / "recording.csv")),
        ("The way of a survey", lambda: hl.read_survey(FOLDER / "poses.csv", FOLDER / "rig.toml")),
    ],
)
def test_the_way_is_the_order_of_the_first_calls(tmp_path, title, read):
    """Traced: a recording or a survey is read and calibrated, judged and written."""
    way = section(title)
    steps = re.findall(r"\| `([\w/]+\.py)` \| `(\w+)` \|", way)
    assert len(steps) == way.count("\n|") - 2  # all rows but the two of the header
    called = {}

    def enter(frame, event, _):
        if event == "call":
            code = frame.f_code
            called.setdefault((code.co_filename, code.co_name), len(called))

    sys.setprofile(enter)
    try:
        calibration = hl.calibrate(read())
        assert calibration.verdict is not None
        hl.write_calibration(tmp_path / "calibration.json", calibration)
    finally:
        sys.setprofile(None)
    order = [called.get((str(PACKAGE / file), name), -1) for file, name in steps]
    assert -1 not in order, steps[order.index(-1)]
    assert [x for _, x in sorted(zip(order, steps, strict=True))] == steps


def test_every_file_that_the_page_names_is_there():
    for file in re.findall(r"`([\w/]+\.py)`", PAGE):
        assert (PACKAGE / file).exists(), file


@pytest.mark.slow
@pytest.mark.parametrize("block", re.findall(r"```python\n(.*?)```", METHOD, flags=re.DOTALL))
def test_python_of_the_page_on_the_method(block, monkeypatch):
    monkeypatch.chdir(ROOT)
    exec(compile(block, "method.md", "exec"), {"__name__": "method"})
