"""Pictures of a calibration: PNG files, figures of matplotlib, and what a notebook shows."""

import dataclasses
import struct
from xml.etree import ElementTree

import pytest
from helpers import GRIPPER

import handlaser_gtsam as hl
from handlaser_gtsam.files.report.options import ReportOptions
from handlaser_gtsam.files.report.report import report_text
from handlaser_gtsam.results.description.tables import NAME_IN_TABLE
from handlaser_gtsam.text import shortened

HOSTILE = ("<script>alert(1)</script>", "$x^2$ & </td>", "_hidden", "%{x}" + "y" * 100)
FLAT = ("by-range", "by-incidence", "by-station", "by-plane", "qq", "correlation", "by-count")
SPACE = ("space-world", "space-hand")


@pytest.fixture(scope="module")
def noise():
    return hl.Noise(3e-5, pose_translation_sigma=0.0, pose_rotation_sigma=0.0)


@pytest.fixture(scope="module")
def calibration(gripper, noise):
    return hl.calibrate(gripper, noise)


@pytest.fixture(scope="module")
def hostile(gripper, noise):
    return hl.calibrate(dataclasses.replace(gripper, beam_names=HOSTILE), noise)


@pytest.fixture(scope="module")
def drawn(calibration):
    pytest.importorskip("matplotlib", reason="needs the extra plots")
    return hl.plot(calibration)


def size_of(path):
    """Width and height of a PNG, from its header."""
    head = path.read_bytes()[:24]
    assert head[:8] == b"\x89PNG\r\n\x1a\n"
    return struct.unpack(">II", head[16:24])


# --- a notebook --------------------------------------------------------------------------------------


def test_a_notebook_shows_the_verdict_and_a_row_a_beam(calibration):
    page = calibration._repr_html_()
    root = ElementTree.fromstring(f"<div>{page.replace('&plusmn;', '+-')}</div>")
    summary = " ".join(calibration.summary().split())  # which breaks lines
    assert summary.startswith(root.find(".//b").text)
    rows = root.findall(".//tbody/tr")
    assert len(rows) == 4
    for row, beam in zip(rows, calibration.beams.values(), strict=True):
        name, *numbers = ["".join(cell.itertext()) for cell in row]
        assert name == beam.name
        shown = [float(x.replace("\N{MINUS SIGN}", "-")) for x in numbers[:3]]
        assert shown == pytest.approx(beam.location * 1e3, abs=5.1e-3)
        assert float(numbers[3]) == pytest.approx(beam.location_sigma.max() * 1e3, rel=0.05)


def test_names_in_a_notebook_are_text(hostile):
    page = hostile._repr_html_()
    assert "<script" not in page
    root = ElementTree.fromstring(f"<div>{page.replace('&plusmn;', '+-')}</div>")
    first = [row[0].text for row in root.findall(".//tbody/tr")]
    assert first == [shortened(name, NAME_IN_TABLE) for name in HOSTILE]


@pytest.mark.slow
def test_a_notebook_shows_no_number_that_means_nothing(gripper, noise):
    page = hl.calibrate(gripper.part([4, 5, 6, 7]), noise)._repr_html_()
    assert "Not usable, undetermined" in page
    assert "<td>" not in page
    assert "nan" not in page
    assert "inf" not in page


# --- figures -----------------------------------------------------------------------------------------


def test_there_is_a_figure_for_every_one_of_the_report(drawn, calibration):
    assert tuple(drawn) == FLAT
    page = report_text(calibration, ReportOptions())
    for name in drawn:
        assert f'data-figure="{name}"' in page


def test_points_are_the_residuals(drawn, calibration, gripper):
    axes = drawn["by-range"].axes[0]
    lines = [line for line in axes.get_lines() if line.get_gid()]
    assert [line.get_gid() for line in lines] == [f"beam {name}" for name in calibration.beams]
    for beam, line in enumerate(lines):
        assert line.get_xdata() == pytest.approx(gripper.ranges[:, beam] * 1e3, rel=1e-5)
        residuals = calibration.fit.residuals[:, beam] * 1e3
        assert line.get_ydata() == pytest.approx(residuals, rel=1e-5)


def test_names_in_pictures_are_shown_as_they_are(hostile):
    pytest.importorskip("matplotlib", reason="needs the extra plots")
    drawn = hl.plot(hostile)
    texts = drawn["by-range"].axes[0].get_legend().get_texts()
    assert [text.get_text() for text in texts][:3] == [f"beam {one}" for one in HOSTILE[:3]]
    assert not any(text.get_parse_math() for text in texts)


# --- files -------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_the_command_draws_a_recording(handlaser, tmp_path):
    pytest.importorskip("matplotlib", reason="needs the extra plots")
    recording, rig = GRIPPER / "recording.csv", GRIPPER / "rig.toml"
    folder = tmp_path / "pictures"
    code, printed, _ = handlaser("plot", recording, "--rig", rig, "--out", folder)
    assert code == 0
    names = [*(f"{name}.svg" for name in SPACE), *(f"{name}.png" for name in FLAT)]
    assert sorted(path.name for path in folder.iterdir()) == sorted(names)
    assert printed.split() == [word for name in names for word in ("wrote", str(folder / name))]
    for name in names[: len(SPACE)]:
        assert ElementTree.parse(folder / name).getroot().tag.endswith("svg")
    for name in names[len(SPACE) :]:
        width, height = size_of(folder / name)
        assert min(width, height) > 400
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    handlaser("plot", recording, "--rig", rig, "--out", folder)
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before


@pytest.mark.slow
def test_an_undetermined_recording_draws_what_it_can(handlaser, gripper, tmp_path):
    pytest.importorskip("matplotlib", reason="needs the extra plots")
    hl.write_recording(tmp_path / "few.csv", gripper.part([0, 1, 2, 3]))
    told = ("plot", tmp_path / "few.csv", "--poses", "exact", "--out", tmp_path / "few")
    code, _, said = handlaser(*told)
    assert code == 3
    assert "does not determine" in said
    drawn = {path.stem for path in (tmp_path / "few").iterdir()}
    assert drawn == {"space-world", "by-range", "by-station", "by-plane"}


@pytest.mark.slow
def test_a_folder_that_cannot_be_made_is_refused(calibration, tmp_path):
    pytest.importorskip("matplotlib", reason="needs the extra plots")
    (tmp_path / "file").write_text("")
    for folder in (tmp_path / "file", tmp_path / "none" / "folder"):
        with pytest.raises(hl.InputError, match="no way to make the folder"):
            hl.write_pictures(folder, calibration)
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def test_what_is_no_calibration_is_refused(tmp_path):
    pytest.importorskip("matplotlib", reason="needs the extra plots")
    with pytest.raises(hl.InputError, match=r"Calibration\(\.\.\.\)"):
        hl.write_pictures(tmp_path, 3)


def test_without_matplotlib_it_says_what_to_install(calibration, tmp_path, monkeypatch):
    import sys

    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(hl.InputError, match=r"handlaser-gtsam\[plots\]"):
        hl.write_pictures(tmp_path / "a", calibration)
    assert list(tmp_path.iterdir()) == []
