"""Figures of the report of a survey: what is drawn of whom, on which scale."""

import json
import re

import numpy as np
import pytest
from profiler_example import example

import handlaser_gtsam as hl
from benchmarks import rigs_by_rays
from benchmarks.rigs import survey_of
from handlaser_gtsam.files.report.options import ReportOptions
from handlaser_gtsam.files.report.scene import in_hand
from handlaser_gtsam.files.report.survey import survey_report
from handlaser_gtsam.files.report.survey_figures import (
    along_the_rays,
    by_station,
    by_target,
    on_targets,
    profiles,
    seen_by_all,
)

WRONG = 4
"""The station whose shot is displaced, and so rejected."""


@pytest.fixture(scope="module")
def survey():
    """The example with one shot 40 mm too far and slanted."""
    read = example()
    shots = read.shots[0]
    z = np.array(shots.reading)
    mine = shots.station == WRONG
    z[mine] += 0.04 + 0.5 * shots.across[mine, 0]
    moved = hl.Shots.profiler(shots.name, shots.station, shots.across[:, 0], z)
    return hl.Survey(read.stations, (moved,))


@pytest.fixture(scope="module")
def result(survey):
    found = hl.calibrate(survey)
    assert [one.station for one in found.rejected] == [survey.stations.station_names[WRONG]]
    return found


@pytest.mark.slow
def test_a_rejected_shot_is_drawn_at_the_edge_and_does_not_set_the_scale(result, survey):
    seen = list(seen_by_all(result, survey))
    for figure in (by_station(survey, seen), by_target(survey, seen)):
        used, out = figure.data
        low, high = figure.layout["yaxis"]["range"]
        assert len(used["x"]) == 23
        assert max(map(abs, used["y"])) <= high == -low
        assert high < 2.0  # mm; the shot is some 40 mm away
        assert np.abs(out["y"]) == pytest.approx([high], rel=1e-3)  # numbers have four digits
        assert re.search(r"P5: -?\d+\.?\d* mm, rejected", out["text"][0])
        assert abs(float(out["text"][0].split()[1])) > 20.0
        assert used["name"] == "sensor scanner"
    assert by_station(survey, seen).data[1]["x"] == [WRONG + 1.0]


@pytest.mark.slow
def test_other_figures_are_without_the_rejected_shot(result, survey):
    seen = list(seen_by_all(result, survey))
    spots = in_hand(seen).beams[0][1][:, 1]
    used = seen[0].hand[seen[0].used] * 1e3
    assert all(np.abs(used - one).sum(axis=1).min() < 1e-9 for one in spots)
    assert len(profiles(survey, seen).data) == 23
    (first, plate), (second, ball) = on_targets(result, survey, seen)
    assert (first.label, second.label) == ("plane:plate", "sphere:ball")
    page = survey_report(result, ReportOptions())
    assert "<figcaption>plane:plate seen from before it: how far points" in page
    assert "<figcaption>sphere:ball seen from where sensors looked: how far points" in page
    radius = result.targets["sphere:ball"].values["radius"] * 1e3
    assert 0.5 * radius < np.hypot(ball.data[0]["x"], ball.data[0]["y"]).max() < 1.01 * radius
    for figure in (plate, ball):
        mark = figure.data[0]["marker"]
        assert np.abs(mark["color"]).max() < 2.0
        assert mark["cmax"] == -mark["cmin"] > 0.0
    along = along_the_rays(seen).data[0]
    assert min(along["x"]) == -1.0
    assert max(along["x"]) == 1.0
    # Standard deviations of a reading, whose share along the normal is at most the whole.
    assert 0.3 < np.std(along["y"]) < 1.2


@pytest.mark.slow
def test_points_are_in_the_frame_of_the_target(result, survey):
    """Spots recomputed here, from the mount and the plane alone."""
    one = next(seen_by_all(result, survey))
    mount, of, shots = result.sensors["scanner"], survey.stations, survey.shots[0]
    p = np.column_stack((shots.across[:, 0], 0.0 * shots.reading, shots.reading))
    p = p @ mount.rotation.T + mount.location
    assert one.hand == pytest.approx(p)
    p = np.einsum("nij,nj->ni", of.world_R_hand[shots.station], p)
    p += of.world_t_hand[shots.station]
    plane = result.targets["plane:plate"].values
    mine = shots.station < 12
    off = p[mine] @ [plane["nx"], plane["ny"], plane["nz"]] + plane["b"]
    assert one.off[mine] == pytest.approx(off, abs=1e-12)


@pytest.mark.slow
def test_the_page_names_sensors_and_beams_and_has_all_figures():
    sensors = ("profiler", "points", "beam")
    survey = survey_of(rigs_by_rays.mixed(101, sensors=sensors, stations=8))
    result = hl.calibrate(survey)
    page = survey_report(result, ReportOptions())
    text = re.search(r'<script[^>]*id="figures"[^>]*>(.*?)</script>', page, re.DOTALL).group(1)
    figures = json.loads(text)
    names = {"space-world", "space-hand", "by-station", "by-target", "along", "on-target-1"}
    assert names <= set(figures)
    assert all(f'data-figure="{name}"' in page for name in figures)
    called = {trace.get("name") for trace in figures["space-world"]["data"]}
    assert {"sensor profiler", "sensor points", "beam beam"} <= called
    assert not any(name and name.startswith("beam profiler") for name in called)


def test_beams_before_points_are_drawn_by_how_far_they_miss():
    survey = survey_of(rigs_by_rays.beams(101, targets="point"))
    result = hl.calibrate(survey)
    seen = list(seen_by_all(result, survey))
    assert along_the_rays(seen) is None
    assert profiles(survey, seen) is None
    tip = np.array([result.targets["point:tip"].values[x] for x in "xyz"])
    off = np.linalg.norm(seen[0].place - tip, axis=1)
    assert seen[0].off == pytest.approx(off)
    assert by_target(survey, seen).data[0]["name"] == "beam beam1"
