"""The default screen of handlaser calibrate: 30 lines of 100 columns, the verdict first."""

import math
import re
from dataclasses import replace

import numpy as np
import pytest
import typer
from helpers import GRIPPER, degenerate, error_of

import handlaser_gtsam as hl
from handlaser_gtsam.cli.answer import Answer
from handlaser_gtsam.cli.words import hold_out_lines
from handlaser_gtsam.model.sensor_limits import Rejected
from handlaser_gtsam.results.description.beams import CalibrationDescription
from handlaser_gtsam.results.description.terminal import LINES, full_lines, screen_lines
from handlaser_gtsam.results.limits import Limits
from handlaser_gtsam.results.lines import WIDTH, decimals, wrapped
from handlaser_gtsam.results.verdict import verdict
from handlaser_gtsam.validation.other_recording import HoldOut

RECORDING, RIG = GRIPPER / "recording.csv", GRIPPER / "rig.toml"
OPENINGS = ("Usable", "Usable with care", "Not usable")


def fits(text):
    lines = text.splitlines()
    assert len(lines) <= LINES
    assert max(len(line) for line in lines) <= WIDTH
    assert lines[0].startswith(OPENINGS)
    return lines


@pytest.fixture(scope="module")
def recording():
    return hl.read_recording(RECORDING)


@pytest.fixture(scope="module")
def calibration(recording):
    return hl.calibrate(recording, hl.read_rig(RIG).noise)


def test_the_shipped_recording_fits_on_the_screen(handlaser, tmp_path):
    arguments = ("--cross-check", "--out", tmp_path / "result.json")
    code, out, err = handlaser("calibrate", RECORDING, "--rig", RIG, *arguments)
    assert (code, err) == (0, "")
    lines = fits(out)
    assert lines[-1] == f"wrote {tmp_path / 'result.json'}"
    assert "n . x + b = 0" not in out
    for beam in "1234":
        (row,) = [line for line in lines if line.startswith(f"{beam}  ")]
        assert len(row.split()) == 12


@pytest.mark.slow
@pytest.mark.parametrize(("beams", "scene"), [(1, "paper"), (8, "arm"), (20, "paper")])
def test_simulated_scenes_fit_on_the_screen(handlaser, tmp_path, beams, scene):
    options = ("--scene", scene, "--beams", beams, "--planes", 6, "--k1", 0.01)
    handlaser("simulate", tmp_path, *options, "--quiet")
    arguments = ("calibrate", tmp_path / "recording.csv", "--rig", tmp_path / "rig.toml")
    code, out, _ = handlaser(*arguments)
    assert code == 0
    lines = fits(out)
    rows = [line for line in lines if line.split(" ")[0].isdigit() and "station" not in line]
    assert len(rows) == min(beams, 8)
    assert ("and 12 more: --verbose" in out) == (beams == 20)


def test_the_full_tables_are_no_wider(handlaser):
    code, out, _ = handlaser("calibrate", RECORDING, "--rig", RIG, "--verbose")
    assert code == 0
    assert out.startswith(OPENINGS)
    assert max(len(line) for line in out.splitlines()) <= WIDTH
    assert "planes. n . x + b = 0" in out
    assert "95 % from" in out


def test_outliers_are_listed_in_one_line(handlaser, tmp_path, recording):
    ranges = recording.ranges.copy()
    ranges[[3, 8, 14, 20, 26, 33], [0, 1, 2, 3, 0, 1]] += 0.004
    path = tmp_path / "outliers.csv"
    hl.write_recording(path, replace(recording, ranges=ranges))
    _, out, _ = handlaser("calibrate", path, "--rig", RIG)
    lines = fits(out)
    (line,) = [line for line in lines if line.startswith("rejected: ")]
    assert "6 readings" in line
    assert "and 3 more" in line


def test_a_warning_is_said_once(calibration, capsys):
    """Of what the verdict says the screen has no further line, and stderr none."""
    far = hl.CalibrationWarning("far-beam", "a beam lies 4 m away; in inches?", {})
    found = replace(calibration, warnings=(far,))
    judged = verdict(found)
    lines = screen_lines(CalibrationDescription(found, judged), closing=3)
    assert " ".join(" ".join(lines).split()).count("a beam lies 4 m away") == 1
    with pytest.raises(typer.Exit):
        Answer("", (), (far,), (4, judged.sentence)).give(json=True)
    assert capsys.readouterr().err.count("a beam lies 4 m away") == 1


def test_warnings_that_do_not_fit_are_counted(calibration):
    words = tuple(
        hl.CalibrationWarning("far-reading", f"{i} " + "a reading is far off, look at it " * 7)
        for i in range(12)
    )
    many = replace(calibration, warnings=words)
    lines = screen_lines(CalibrationDescription(many, verdict(many)), closing=3)
    fits("\n".join(lines))
    assert len(lines) <= LINES - 3
    shown = sum(line.startswith("WARNING") for line in lines)
    assert 0 < shown < 12
    assert lines[-1] == f"and {12 - shown} more warnings: --verbose"


def test_the_worst_case_of_everything_fits(calibration):
    """Long names, many beams, outliers, limits and warnings at once."""
    names = [f"laser on the left gripper finger {i}" for i in range(8)]
    beams = {
        name: replace(beam, name=name)
        for name, beam in zip(names, [*calibration.beams.values()] * 2, strict=True)
    }
    rejected = tuple(Rejected(f"station {i}", names[0], "A", "off", 1e-3) for i in range(40))
    fit = replace(calibration.fit, rejected=rejected, max_residual_at=("a far station", names[1]))
    wide = replace(
        calibration,
        beams=beams,
        fit=fit,
        covariance=None,
        systematic=(error_of(np.full((8, 3), 1e-5), found=False),),
        warnings=(
            hl.CalibrationWarning("x", "look at every one of the readings of the recording " * 8),
        )
        * 9,
    )
    judged = verdict(wide, Limits(1e-6, 1e-6, 1e-6))
    fits("\n".join(screen_lines(CalibrationDescription(wide, judged), closing=3)))


@pytest.mark.slow
def test_the_undetermined_is_named_in_words(handlaser, tmp_path):
    path = tmp_path / "recording.csv"
    hl.write_recording(path, degenerate("two planes, no rotation"))
    code, out, _ = handlaser("calibrate", path)
    assert code == 3
    lines = fits(out)
    assert lines[0].startswith("Not usable, undetermined")
    assert not any(line.startswith("1  ") for line in lines)  # no number means anything


@pytest.mark.slow
def test_the_stations_that_are_missing_leave_room_for_the_rest(handlaser, tmp_path, recording):
    """Twelve stations in words would be more than the screen has."""
    path, rig = tmp_path / "begun.csv", GRIPPER.parent / "planned" / "rig.toml"
    hl.write_recording(path, recording.part(range(4)))
    code, out, _ = handlaser("calibrate", path, "--rig", rig)
    assert code == 3
    lines = fits(out)
    more = re.fullmatch(r"  and (\d+) more: --verbose", lines[-1])
    hidden = 0 if more is None else int(more[1])
    shown = sum(line.startswith("  before plane A") for line in lines)
    assert shown >= 2
    every = handlaser("calibrate", path, "--rig", rig, "--verbose")[1]
    assert every.count("  before plane A") == shown + hidden
    assert not any(line.endswith("...") for line in lines[:3])  # the verdict is never cut


def test_values_have_the_digits_of_their_sigma():
    assert decimals(0.0814, 4) == 3
    assert decimals(12.3, 4) == 0
    assert decimals(1e-9, 4) == 4
    assert decimals(0.0, 4) == 4


def test_wrapping_keeps_paths_whole():
    path = "/" + "x" * 150
    assert path in [line.strip() for line in wrapped(f"wrote {path}")]
    assert len(wrapped("word " * 100, 2)) == 2


def test_limits_are_said_to_hold(handlaser, tmp_path):
    rig = tmp_path / "rig.toml"
    rig.write_text(RIG.read_text() + "\n[limits]\nrms_mm = 0.2\nlocation_sigma_mm = 0.5\n")
    code, out, _ = handlaser("calibrate", RECORDING, "--rig", rig)
    assert code == 0
    (line,) = [line for line in fits(out) if line.startswith("limits held: ")]
    assert "of 0.2 mm" in line
    assert "of 0.5 mm" in line


def systematic_of(calibration, *errors):
    """Return what the screen and the full tables say of systematic errors."""
    changed = replace(calibration, systematic=errors)
    described = CalibrationDescription(changed, verdict(changed))
    lines = screen_lines(described)
    first = next(i for i, line in enumerate(lines) if line.startswith("systematic errors"))
    text = lines[first]
    for line in lines[first + 1 :]:
        if not line.startswith("  "):
            break
        text += f" {line.strip()}"
    return text, " ".join(" ".join(full_lines(described)).split())


def test_the_largest_error_that_could_go_unnoticed_is_named(calibration):
    """By what it does to a spot: 0.01 mm an axis here, not by its own size."""
    small, large = np.full((4, 3), 1e-6), np.full((4, 3), 1e-5)
    text, full = systematic_of(
        calibration,
        error_of(small, found=False, detectable=1.0),
        error_of(large, found=False, code="lag"),
        error_of(9.0 * large, found=False, confounded=True, code="translation-scale"),
    )
    assert "none of 2 kinds found (cannot be told: translation-scale)" in text
    assert "the worst that would go unnoticed: lag below 0.1 mm, moving a spot by 0.017 mm" in text
    assert "sag" not in text
    assert re.search(r"translation-scale +cannot be told", full)


@pytest.mark.parametrize("confounded", [4, 9])
def test_what_is_said_of_systematic_errors_is_not_cut(calibration, confounded):
    """The longest code and sizes with two digits stand beside many that are confounded."""
    large = np.full((4, 3), 1.23e-5)
    errors = [error_of(large, found=False, code="translation-scale", unit="1", detectable=1.2e-4)]
    errors += [
        error_of(large, found=False, confounded=True, code="inverse-cosine")
        for _ in range(confounded)
    ]
    text, _ = systematic_of(calibration, *errors)
    assert "..." not in text
    assert text.endswith("translation-scale below 0.012 %, moving a spot by 0.021 mm")
    assert ("and 5 more" in text) == (confounded == 9)


def test_the_errors_found_are_named_by_p(calibration):
    shift = np.full((4, 3), 1e-5)
    errors = (
        error_of(shift),
        error_of(shift, code="lag", p_value=1e-7, message="a lag"),
        error_of(shift, code="drift", p_value=1e-3, explained_by="lag"),
    )
    text, full = systematic_of(calibration, *errors)
    assert "lag of 0.1 mm (p = 1e-07), moving a spot by 0.017 mm; sag of" in text
    assert text.endswith("(which explains drift)")
    assert all(error.remedy in full for error in errors[:2])


@pytest.mark.parametrize(
    ("p", "opening"),
    [
        (0.5, "The calibration holds: "),
        (0.005, "The calibration hardly holds: "),
        (0.0005, "The calibration does not hold: "),
        (math.nan, "Not tested: "),
    ],
)
def test_what_p_means_of_an_old_calibration(p, opening):
    found = HoldOut(9, 1e-5, 1e-5, 1.0, 1, 0.5, 1.0, 6, p, (), np.zeros(6), 0.5, ("1", "1"))
    assert hold_out_lines(found)[0].startswith(opening)


def test_a_result_that_is_not_usable_exits_with_4(handlaser, monkeypatch):
    """An error that moves every spot by a metre, as if the tests had found it."""
    from handlaser_gtsam import pipeline

    harm = error_of(np.ones((4, 3)), p_value=1e-9)
    run = pipeline.calibrate
    monkeypatch.setattr(
        pipeline,
        "calibrate",
        lambda *arguments: replace(run(*arguments), systematic=(harm,)),
    )
    code, out, err = handlaser("calibrate", RECORDING, "--rig", RIG)
    assert code == 4
    assert out.startswith("Not usable, a systematic error: a sag of 0.1 mm")
    assert err.count("\n") == 1
