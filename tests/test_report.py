"""The report: read by an HTML parser that shares nothing with what wrote it."""

import dataclasses
import hashlib
import json
import math
import os
import re
import xml.etree.ElementTree as ElementTree
from html.parser import HTMLParser

import numpy as np
import pytest
from helpers import GRIPPER, simulated
from scipy.stats import binom, norm

import handlaser_gtsam as hl
from handlaser_gtsam.files.calibration_writing import calibration_text
from handlaser_gtsam.files.report.page import safe_json
from handlaser_gtsam.files.report.report import report_text
from handlaser_gtsam.model.joint import correlation_matrix
from handlaser_gtsam.validation.scenes import Layout

EXACT = {"pose_translation_sigma": 0.0, "pose_rotation_sigma": 0.0}
MB = 1_000_000
HOSTILE = (
    "<script>alert(1)</script>",
    "</script><img src=x onerror=alert(1)>",
    "%{x} $x^2$ &lt;b&gt; <b>bold</b> <a href='http://evil.example'>a</a>",
    '" onclick="alert(1)" {{ 7*7 }} {% raw %} `${1}` <!-- ' + "x" * 140,
)
PLANES = {"A": "2020-01-01", "B": "<!--<script>", "C": "é" * 60, "D": "]]></style><h1>D"}
VOID = {"meta", "link", "img", "br", "circle", "path", "rect"}


class Page(HTMLParser):
    """Tags with their attributes, and the text of every element that has an identifier."""

    def __init__(self, text: str) -> None:
        super().__init__(convert_charrefs=True)
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.path: list[tuple[str, str | None]] = []
        self.scripts: dict[str, str] = {}
        self.words: list[tuple[str, str]] = []
        self.cells: dict[str, list[list[tuple[str, float | None]]]] = {}
        self.style = ""
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        found = dict(attrs)
        self.tags.append((tag, found))
        if tag not in VOID:
            self.path.append((tag, found.get("id")))
        table = self._inside("table-")
        if tag == "tr" and table:
            self.cells.setdefault(table, []).append([])
        if tag == "td" and table:
            value = found.get("data-v")
            self.cells[table][-1].append(("", None if value is None else float(value)))

    def handle_startendtag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))

    def handle_endtag(self, tag):
        assert self.path, f"</{tag}> ends nothing"
        assert self.path[-1][0] == tag, f"</{tag}> inside {self.path[-1]}"
        self.path.pop()

    def handle_data(self, data):
        tag, name = self.path[-1] if self.path else ("", None)
        if tag == "script":
            self.scripts[name or str(len(self.scripts))] = data
        elif tag == "style":
            self.style += data
        elif data.strip():
            self.words.append((tag, data))
            table = self._inside("table-")
            if tag == "td" and table:
                text, value = self.cells[table][-1][-1]
                self.cells[table][-1][-1] = (text + data, value)

    def _inside(self, beginning):
        names = [name for _, name in self.path if name and name.startswith(beginning)]
        return names[-1].removeprefix(beginning) if names else ""

    @property
    def text(self) -> str:
        return " ".join(" ".join(data.split()) for _, data in self.words)

    def table(self, name: str) -> list[list[tuple[str, float | None]]]:
        return [row for row in self.cells.get(name, []) if row]

    def data(self, name: str):
        return json.loads(self.scripts[name])


@pytest.fixture(scope="module")
def rig():
    return hl.read_rig(GRIPPER / "rig.toml")


@pytest.fixture(scope="module")
def calibration(gripper, rig):
    return hl.calibrate(gripper, rig.noise, hl.CalibrationOptions(sensor=rig.sensor))


@pytest.fixture(scope="module")
def options(rig):
    return hl.ReportOptions(rig, recording_file=GRIPPER / "recording.csv", command="handlaser ...")


@pytest.fixture(scope="module")
def page(calibration, options):
    return Page(report_text(calibration, options))


@pytest.fixture(scope="module")
def hostile(gripper, rig):
    ranges = gripper.ranges.copy()
    ranges[3, 1] += 0.005
    named = dataclasses.replace(
        gripper,
        ranges=ranges,
        beam_names=HOSTILE,
        plane_labels=tuple(PLANES[plane] for plane in gripper.plane_labels),
        station_names=tuple(f"<i>{name}</i>&amp;" for name in gripper.station_names),
    )
    found = hl.calibrate(named, rig.noise)
    limits = hl.Limits(rms=2e-5, location_sigma=2e-4, direction_sigma=0.005)
    command = "handlaser calibrate '<script>alert(2)</script>.csv'"
    told = hl.ReportOptions(dataclasses.replace(rig, limits=limits), command=command)
    return Page(report_text(found, told))


def undetermined(gripper):
    """Return a result in which no coordinate is determined, wherever along the valley a search ends."""
    return hl.calibrate(gripper.part([4, 5, 6, 7]), hl.Noise(3e-5, **EXACT))


# --- one file ----------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["page", "hostile"])
def test_nothing_is_loaded_from_anywhere(kind, request):
    """No element names another file, no style imports one, and the page's own policy forbids both."""
    found = request.getfixturevalue(kind)
    loading = ("src", "href", "action", "data", "poster", "srcset", "formaction", "xlink:href")
    named = [
        (tag, value)
        for tag, attributes in found.tags
        for name, value in attributes.items()
        if name in loading and not (value or "").startswith(("#", "data:"))
    ]
    assert named == []
    kinds = {tag for tag, _ in found.tags}
    assert not kinds & {"iframe", "object", "embed", "img", "base", "form", "audio", "video"}
    assert not re.search(r"@import|url\(", found.style)
    policy = [a["content"] for tag, a in found.tags if a.get("http-equiv")]
    assert policy[0].startswith("default-src 'none'")
    assert "http" not in policy[0]


def test_every_element_ends_where_it_should(page, hostile):
    """`Page` asserts the nesting; nothing is open at the end."""
    assert page.path == hostile.path == []


def test_the_licence_of_the_library_is_readable_in_both_pages(calibration, options):
    pytest.importorskip("starlette", reason="needs the extra watch")
    from handlaser_gtsam.files.report.page import live_page

    for html in (report_text(calibration, options), live_page()[0]):
        shown = html[: html.index("<script")]
        assert "Permission is hereby granted, free of charge" in shown
        assert 'THE SOFTWARE IS PROVIDED "AS IS"' in shown


def test_long_names_that_differ_at_their_ends_are_told_apart(gripper, rig):
    beams = tuple(f"distal phalanx of the left finger, triangulation sensor {i}" for i in range(4))
    plates = {name: f"calibration plate on the granite table, side {name}" for name in "ABCD"}
    labels = tuple(plates[label] for label in gripper.plane_labels)
    named = dataclasses.replace(gripper, beam_names=beams, plane_labels=labels)
    page = Page(report_text(hl.calibrate(named, rig.noise), hl.ReportOptions(rig)))
    for table in ("spots", "planes"):
        names = [row[0][0] for row in page.table(table)]
        assert len(set(names)) == len(names) == 4
    figures = page.data("figures")
    legend = [one["name"] for one in figures["by-range"]["data"] if one.get("name")]
    assert len(set(legend)) == 4
    assert len(set(figures["by-plane"]["layout"]["xaxis"]["ticktext"])) == 4


def test_the_verdict_comes_first(page, calibration, rig):
    body = [(tag, " ".join(words.split())) for tag, words in page.words if tag != "title"]
    assert body[0] == ("p", "Calibration of recording.csv")
    assert body[1] == ("h1", "Usable")
    summary = calibration.summary(rig.limits).split("\n")[0]
    assert summary.startswith(body[1][1])
    assert body[2][1].rstrip(".").lower() in summary.lower()


def test_identifiers_stand_once(page):
    names = [attributes["id"] for _, attributes in page.tags if "id" in attributes]
    assert len(names) == len(set(names))
    links = [a["href"][1:] for tag, a in page.tags if tag == "a"]
    assert links
    assert set(links) <= set(names)


@pytest.mark.slow
def test_size_of_thirteen_planes(tmp_path):
    recording, _ = simulated(layout=Layout(planes=13))
    found = hl.calibrate(recording, hl.Noise(3e-5, 5e-5, 5e-4))
    hl.write_report(tmp_path / "report.html", found)
    assert (tmp_path / "report.html").stat().st_size < 6 * MB


@pytest.mark.slow
def test_a_long_recording_of_long_names_stays_below_six_megabytes():
    recording, _ = simulated(layout=Layout(planes=60, beams=8))
    names = tuple(f"<{i}>" + "&" * 190 for i in range(8))
    planes = tuple(f"<{plane}>" + "é" * 150 for plane in recording.plane_labels)
    stations = tuple(f"<{name}>" + "'" * 150 for name in recording.station_names)
    named = dataclasses.replace(
        recording, beam_names=names, plane_labels=planes, station_names=stations
    )
    found = hl.calibrate(named, hl.Noise(3e-5, **EXACT), hl.CalibrationOptions("none"))
    assert found.success
    assert len(report_text(found, hl.ReportOptions()).encode()) < 6 * MB


# --- numbers -----------------------------------------------------------------------------------------


def test_the_page_holds_the_calibration_itself(page, calibration):
    assert page.data("calibration") == json.loads(calibration_text(calibration))


def test_the_table_of_mounts_has_the_numbers_of_the_calibration(page, calibration):
    scale = [1e3, 1e3, 1e3, 1.0, 1.0, 1.0, 1.0, 1.0]
    names = ["location x", "location y", "location z", "direction x", "direction y", "direction z"]
    rows = {(row[0][0], row[1][0]): row for row in page.table("mounts")}
    for name, beam in calibration.beams.items():
        interval = calibration.intervals(name)
        for i, quantity in enumerate([*names, "k1", "k2"]):
            shown = [value for _, value in rows[name, quantity][2:6]]
            told = [beam.coordinates[i], beam.sigma[i], *interval[i]]
            assert shown == pytest.approx([x * scale[i] for x in told], rel=1e-12)
        angle = rows[name, "direction, angle"][3][1]
        assert angle == pytest.approx(math.degrees(beam.direction_sigma))
    assert len(rows) == 9 * len(calibration.beams)


def test_numbers_are_shown_to_two_digits_of_their_standard_deviation(page):
    for row in page.table("mounts"):
        if row[1][0] == "direction, angle":
            continue
        digits = {len(text.partition(".")[2]) for text, _ in row[2:6]}
        assert len(digits) == 1
        for text, value in row[2:6]:
            assert float(text.replace("\N{MINUS SIGN}", "-")) == pytest.approx(
                value, abs=0.5 * 10.0 ** -digits.copy().pop()
            )


def test_spots_planes_and_stations_have_their_numbers(page, calibration, gripper):
    for row, (name, beam) in zip(page.table("spots"), calibration.beams.items(), strict=True):
        spot = hl.spot(calibration, name, calibration.fit.median_reading)
        numbers = [value for _, value in row[2:]]
        told = [spot.along, spot.across, spot.reading_sigma]
        assert numbers[:3] == pytest.approx([1e3 * x for x in told])
        assert numbers[3] == pytest.approx(math.degrees(beam.direction_sigma))
    for row, plane in zip(page.table("planes"), calibration.planes.values(), strict=True):
        assert [value for _, value in row[1:4]] == plane.normal.tolist()
        assert row[5][1] == 1e3 * plane.offset
    e = calibration.fit.residuals
    rows = page.table("stations")
    assert [row[0][0] for row in rows] == list(gripper.station_names)
    for j, row in enumerate(rows):
        own = e[j][~np.isnan(e[j])]
        assert row[5][1] == len(own)
        assert row[6][1] == pytest.approx(1e3 * math.sqrt(np.mean(own**2)))
        assert abs(row[7][1]) == pytest.approx(1e3 * np.abs(own).max())
        assert row[8][0] == gripper.beam_names[int(np.nanargmax(np.abs(e[j])))]
    worst = max(row[9][1] for row in rows)
    assert worst == pytest.approx(calibration.fit.max_standardized_residual, rel=1e-9)


def test_figures_draw_the_residuals(page, calibration, gripper):
    figures = page.data("figures")
    e, d = calibration.fit.residuals * 1e3, gripper.ranges * 1e3
    for beam, trace in enumerate(figures["by-range"]["data"]):
        assert trace["x"] == pytest.approx(d[:, beam], rel=1e-5)
        assert trace["y"] == pytest.approx(e[:, beam], rel=1e-5)
    in_order = figures["by-station"]["data"][2]
    assert in_order["x"] == list(range(1, len(e) + 1))
    assert in_order["y"] == pytest.approx(e[:, 2], rel=1e-5)
    z = figures["qq"]["data"][-1]
    assert len(z["x"]) == calibration.fit.readings
    assert np.all(np.diff(z["y"]) >= 0.0)
    assert np.allclose(z["x"], -np.array(z["x"])[::-1], atol=1e-5)
    # The reading of a rank is below the edge where at least so many of all are.
    count = len(z["x"])
    for edge, part in zip(figures["qq"]["data"], (0.025, 0.975), strict=False):
        for rank in (1, count // 3, count):
            below = norm.cdf(edge["y"][rank - 1])
            assert binom.sf(rank - 1, count, below) == pytest.approx(part, abs=1e-3)


def test_incidence_is_that_of_beam_and_plane(page, calibration, gripper):
    """By the angle between two lines, from the recording and the table alone."""
    trace = page.data("figures")["by-incidence"]["data"][1]
    beam = list(calibration.beams.values())[1]
    for j in range(len(gripper.plane_labels)):
        n = calibration.planes[gripper.plane_labels[j]].normal
        v = gripper.world_R_hand[j] @ beam.direction
        angle = math.degrees(math.atan2(np.linalg.norm(np.cross(n, v)), abs(n @ v)))
        assert trace["x"][j] == pytest.approx(angle, rel=1e-4)


def test_spots_lie_on_their_planes(page, calibration):
    """The view in space, and so the still picture, puts each spot within its residual of its plane."""
    traces = page.data("figures")["space-world"]["data"]
    planes = list(calibration.planes.values())
    spots = [trace for trace in traces if trace.get("text") and trace["name"].startswith("beam")]
    assert len(spots) == len(calibration.beams)
    for trace in spots:
        for x, y, z, words in zip(*(trace[k] for k in ("x", "y", "z", "text")), strict=True):
            (name,) = re.findall(r"plane (\w+)$", words)
            plane = next(one for one in planes if one.name == name)
            height = plane.normal @ [x, y, z] / 1e3 + plane.offset
            assert abs(height) < 2.0 * calibration.fit.max_residual


def test_correlations_are_those_of_the_covariance(page, calibration):
    S, names = calibration.covariance.matrix(planes=[]), calibration.covariance.beam_names
    C = correlation_matrix(names, calibration.parameters().directions, S)[1]
    drawn = np.array(page.data("figures")["correlation"]["data"][0]["z"])
    assert drawn.shape == (28, 28)  # 7 a beam: of a direction, one component follows
    assert np.allclose(drawn, C, atol=1e-3)
    listed = page.table("correlations")
    upper = np.abs(C[np.triu_indices(28, 1)])
    assert f"{(upper > 0.95).sum()} pairs" in page.text  # as the JSON has them, and their advice
    assert abs(listed[0][2][1]) == pytest.approx(upper.max(), abs=1e-3)


def test_head_and_end_say_what_it_was_made_of(page, calibration, gripper):
    digest = hashlib.sha256((GRIPPER / "recording.csv").read_bytes()).hexdigest()
    assert page.text.count(digest) == 2
    for words in (
        "176 used, 0 rejected",
        "4: A, B, C, D",
        "handlaser_gtsam",
        "hand frame",
        "0 to 30",
    ):
        assert words in page.text
    assert str(len(gripper.plane_labels)) in page.text
    assert calibration.message.rstrip(".") in page.text
    assert "condition number is" in page.text


def test_every_systematic_error_and_every_plane_held_out_has_a_row(page, calibration):
    names = [row[0][0] for row in page.table("systematic")]
    assert names == [one.code for one in calibration.systematic]
    assert [row[0][0] for row in page.table("held-out")] == list(calibration.planes)
    assert "predicted from the other 70 %" in page.text


# --- names from files --------------------------------------------------------------------------------


def test_names_are_text_wherever_they_stand(page, hostile):
    scripts = [tag for tag, _ in hostile.tags if tag == "script"]
    assert len(scripts) == len([tag for tag, _ in page.tags if tag == "script"])
    assert {tag for tag, _ in hostile.tags} <= {tag for tag, _ in page.tags} | {"td", "li", "ul"}
    assert not any(name.startswith("on") for _, attributes in hostile.tags for name in attributes)
    for name in HOSTILE[:3]:
        assert name in hostile.text
    assert {row[0][0] for row in hostile.table("mounts")} == set(HOSTILE)
    assert {row[0][0] for row in hostile.table("planes")} == set(PLANES.values())
    assert "handlaser calibrate '<script>alert(2)</script>.csv'" in hostile.text


def test_names_in_figures_are_escaped_for_plotly(hostile):
    """Which reads some HTML, entities, and what stands between dollars as TeX."""
    text = hostile.scripts["figures"]
    assert "<" not in text
    figures = json.loads(text)

    def texts(value):
        if isinstance(value, dict):
            for name, one in value.items():
                if name not in ("hovertemplate", "family", "legendgroup"):
                    yield from texts(one)
        elif isinstance(value, list):
            for one in value:
                yield from texts(one)
        elif isinstance(value, str):
            yield value

    for one in texts(figures):
        plain = one.replace("<br>", "")
        assert "<" not in plain, one
        assert "$" not in plain, one
    templates = re.findall(r'"hovertemplate":"(.*?)"', text)
    assert templates
    assert all("script" not in one for one in templates if "%{" in one)


@pytest.mark.parametrize(
    "value", ["</script>", "<!--<script>", "\u2028\u2029", "&lt;", "]]>", "\\u003c"]
)
def test_json_in_a_script_ends_nothing_and_reads_back(value):
    text = safe_json({"name": [value]})
    assert not re.search("[<>&\u2028\u2029]", text)
    assert json.loads(text) == {"name": [value]}


def test_json_of_what_is_no_number_is_refused():
    for value in (math.nan, math.inf):
        with pytest.raises(ValueError, match="JSON"):
            safe_json([value])


def test_still_pictures_are_sound_xml(calibration, hostile, options):
    pictures = re.findall(
        r"<svg.*?</svg>", report_text(calibration, options).partition("<script")[0], re.DOTALL
    )
    assert len(pictures) == 2
    for picture in pictures:
        root = ElementTree.fromstring(picture)
        assert root.tag.endswith("svg")
        box = [float(x) for x in root.get("viewBox").split()]
        numbers = re.findall(r"M(-?[\d.]+) (-?[\d.]+)", picture)
        assert numbers
        assert all(-1.0 <= float(x) <= box[2] + 1.0 for x, _ in numbers)
        assert all(-1.0 <= float(y) <= box[3] + 1.0 for _, y in numbers)
    assert hostile.scripts


# --- what is no calibration --------------------------------------------------------------------------


@pytest.mark.slow
def test_an_undetermined_one_says_so_first_and_shows_no_number_that_means_nothing(gripper):
    found = undetermined(gripper)
    page = Page(report_text(found, hl.ReportOptions()))
    words = [data for tag, data in page.words if tag == "h1"]
    assert words == ["Not usable, undetermined"]
    assert "beam 1: location, direction" in page.text
    assert "The recording determines no parameter." in page.text
    for table in ("mounts", "spots", "planes", "limits", "correlations", "systematic", "held-out"):
        assert page.table(table) == []
    assert set(page.data("figures")) == {"space-world", "by-range", "by-station", "by-plane"}
    assert not re.search(r"\b(nan|inf|None)\b", page.text)
    assert "21 of 31 unknowns are determined" in page.text
    for name, beam in page.data("calibration").items():
        assert name or beam  # the JSON of the calibration is there, with its nulls


@pytest.mark.slow
def test_of_a_part_that_is_determined_the_numbers_are_shown():
    """Pure translations tell the directions, and no location."""
    from helpers import degenerate

    found = hl.calibrate(degenerate("one plane, one axis"), hl.Noise(1e-4, **EXACT))
    assert found.status == "unobservable"
    known = {
        (name, i)
        for name, beam in found.beams.items()
        for i in range(6 + beam.terms)
        if math.isfinite(beam.sigma[i])
    }
    page = Page(report_text(found, hl.ReportOptions()))
    shown = [row for row in page.table("mounts") if row[2][1] is not None]
    assert len(shown) == len(known)
    for row in page.table("mounts"):
        if row[2][1] is None and row[1][0] != "direction, angle":
            assert row[2][0] == "undetermined"
            assert [value for _, value in row[3:6]] == [None] * 3


@pytest.mark.slow
def test_readings_that_do_not_fit_are_no_calibration(gripper):
    part = gripper.part(np.arange(22)).without(np.arange(4) >= np.full((22, 1), 2))
    spoilt = part.ranges * (1.0 + 0.3 * np.random.default_rng(0).standard_normal((22, 2)))
    found = hl.calibrate(dataclasses.replace(part, ranges=spoilt), hl.Noise(3e-5, **EXACT))
    assert found.status == "not_converged"
    page = Page(report_text(found, hl.ReportOptions()))
    assert [data for tag, data in page.words if tag == "h1"] == [
        "Not usable, the readings do not fit"
    ]
    assert "There is no calibration." in page.text
    assert page.table("mounts") == page.table("planes") == []
    assert not re.search(r"\b(nan|inf|None)\b", page.text)


def test_a_calibration_without_its_recording_has_a_report(calibration):
    without = dataclasses.replace(calibration, recording=None)
    page = Page(report_text(without, hl.ReportOptions()))
    assert page.table("mounts")
    assert page.table("stations") == []
    assert "space-hand" in page.data("figures")
    assert "by-range" not in page.data("figures")


@pytest.mark.slow
@pytest.mark.parametrize("case", ["huber", "keep", "estimated", "no range error", "one plane"])
def test_every_kind_of_calibration_has_a_report(gripper, case):
    noise, recording = hl.Noise(3e-5, 5e-5, 5e-4), gripper
    options = {
        "huber": hl.CalibrationOptions(loss="huber"),
        "keep": hl.CalibrationOptions(outliers="keep"),
        "estimated": hl.CalibrationOptions(poses="estimated", range_error="k1"),
        "no range error": hl.CalibrationOptions(range_error="none"),
        "one plane": hl.CalibrationOptions(range_error="none"),
    }[case]
    if case == "one plane":
        recording, _ = simulated(layout=Layout(planes=1, stations=24))
        noise = hl.Noise(3e-5, **EXACT)
    found = hl.calibrate(recording, noise, options)
    page = Page(report_text(found, hl.ReportOptions()))
    assert found.success == bool(page.table("spots"))
    assert not re.search(r"\b(nan|inf|None)\b", page.text)


# --- options and the command -------------------------------------------------------------------------


@pytest.mark.slow
def test_the_same_input_makes_the_same_page(calibration, options):
    assert report_text(calibration, options) == report_text(calibration, options)


def test_the_date_is_that_of_the_file(calibration, tmp_path):
    copy = tmp_path / "recording.csv"
    copy.write_bytes((GRIPPER / "recording.csv").read_bytes())
    os.utime(copy, (1_600_000_000, 1_600_000_000))  # 2020-09-13, UTC
    text = Page(report_text(calibration, hl.ReportOptions(recording_file=copy))).text
    assert "2020-09-13 (of the recording's file)" in text


def test_every_file_of_a_log_is_named_with_its_hash(calibration, tmp_path):
    """Of a folder, as a bag of ROS 2 is one, that of the hashes of its files in their order."""
    bag, second = tmp_path / "bag", tmp_path / "second.csv"
    bag.mkdir()
    second.write_text("more")
    parts = {"b.db3": b"data", "metadata.yaml": b"about"}
    for name, content in parts.items():
        (bag / name).write_bytes(content)
    each = [hashlib.sha256(parts[name]).hexdigest() for name in sorted(parts)]
    told = hl.ReportOptions(recording_file=bag, beside=(second,))
    text = Page(report_text(calibration, told)).text
    assert hashlib.sha256("\n".join(each).encode()).hexdigest() in text
    assert hashlib.sha256(b"more").hexdigest() in text
    assert "second.csv" in text


def test_limits_pass_and_fail_one_by_one(calibration, rig):
    limits = hl.Limits(rms=2e-5, location_sigma=2e-4, direction_sigma=0.0050)
    told = hl.ReportOptions(dataclasses.replace(rig, limits=limits))
    page = Page(report_text(calibration, told))
    states = {(row[0][0], row[1][0]): row[5][0] for row in page.table("limits")}
    assert states["rms", "all"] == "fail"
    for name, beam in calibration.beams.items():
        location = float(beam.location_sigma.max()) <= 2e-4
        assert states["location std dev", f"beam {name}"] == ("pass" if location else "fail")
        turn = beam.direction_sigma <= 0.0050
        assert states["direction std dev", f"beam {name}"] == ("pass" if turn else "fail")
    assert set(states.values()) == {"pass", "fail"}
    assert [data for tag, data in page.words if tag == "h1"] == ["Not usable, outside the limits"]


def test_a_rejected_reading_is_listed_with_its_reason(hostile):
    ((station, beam, reason, residual),) = hostile.table("rejected")
    assert (station[0], beam[0]) == ("<i>4</i>&amp;", HOSTILE[1])
    assert reason[0]
    assert abs(residual[1]) > 4.0  # mm, of the 5 mm that were put in


@pytest.mark.slow
def test_the_command_writes_it(handlaser, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    recording, rig = GRIPPER / "recording.csv", GRIPPER / "rig.toml"
    code, printed, _ = handlaser(
        *("calibrate", recording, "--rig", rig, "--report", "a.html", "--out", "a.json"),
    )
    assert code == 0
    assert "wrote a.html" in printed
    page = Page((tmp_path / "a.html").read_text())
    assert page.data("calibration") == json.loads((tmp_path / "a.json").read_text())
    assert f"handlaser calibrate {recording} --rig {rig} --report a.html" in page.text
    quiet = handlaser("calibrate", recording, "--rig", rig, "--report", "b.html", "--quiet")
    assert quiet[:2] == (0, "")
    assert Page((tmp_path / "b.html").read_text()).table("next") == page.table("next") != []


@pytest.mark.slow
def test_an_undetermined_recording_has_a_report_all_the_same(handlaser, gripper, tmp_path):
    hl.write_recording(tmp_path / "few.csv", gripper.part([0, 1, 2, 3]))
    code, _, said = handlaser(
        "calibrate", tmp_path / "few.csv", "--poses", "exact", "--report", tmp_path / "few.html"
    )
    assert code == 3
    assert "Traceback" not in said
    assert "Not usable, undetermined" in (tmp_path / "few.html").read_text()


REFUSED = {
    "the recording": (["--report", "{recording}"], "the input itself as --report"),
    "a missing folder": (["--report", "{folder}/none/a.html"], "no way to write"),
    "the same file": (["--report", "{folder}/a", "--out", "{folder}/a"], "one file as --out"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_cannot_be_is_refused_in_one_line(refusal, tmp_path, case):
    recording = tmp_path / "recording.csv"
    content = (GRIPPER / "recording.csv").read_bytes()
    recording.write_bytes(content)
    arguments, words = REFUSED[case]
    told = [one.format(recording=recording, folder=tmp_path) for one in arguments]
    assert words in refusal("calibrate", recording, *told)
    assert recording.read_bytes() == content
    assert sorted(path.name for path in tmp_path.iterdir()) == ["recording.csv"]


@pytest.mark.parametrize(
    "fields",
    [
        {"rig": 3},
        {"reading": "15"},
        {"plan": 3},
        {"command": 3},
        {"recording_file": 3},
    ],
)
def test_options_refuse_what_is_none(fields):
    with pytest.raises(hl.InputError):
        hl.ReportOptions(**fields)


@pytest.mark.slow
def test_what_is_no_calibration_or_no_file_is_refused(calibration, tmp_path):
    with pytest.raises(hl.InputError, match=r"Calibration\(\.\.\.\)"):
        hl.write_report(tmp_path / "a.html", 3)
    for missing in (tmp_path / "none.csv", tmp_path):
        told = hl.ReportOptions(recording_file=missing)
        with pytest.raises(hl.InputError, match="no readable file"):
            hl.write_report(tmp_path / "a.html", calibration, told)
    assert list(tmp_path.iterdir()) == []


# --- odd recordings ----------------------------------------------------------------------------------


def sound(found):
    page = Page(report_text(found, hl.ReportOptions()))
    assert not re.search(r"\b(nan|inf|None)\b", page.text)
    return page


@pytest.mark.slow
def test_readings_without_noise_have_a_report():
    recording, _ = simulated(range_sigma=1e-15)
    for noise in (hl.Noise(None, **EXACT), hl.Noise(3e-5, **EXACT)):
        page = sound(hl.calibrate(recording, noise, hl.CalibrationOptions("none")))
        assert len(page.table("mounts")) == 4 * 7


def test_negative_readings_have_a_report():
    """Of a sensor that reads the distance from a reference amid its range."""
    recording, _ = simulated(layout=Layout(planes=5))
    shift = float(np.median(recording.ranges)) + 0.001
    moved = dataclasses.replace(recording, ranges=recording.ranges - shift, range_min=-0.03)
    found = hl.calibrate(moved, hl.Noise(3e-5, **EXACT), hl.CalibrationOptions("none"))
    assert found.success
    assert found.fit.median_reading < 0.0
    page = sound(found)
    assert len(page.table("spots")) == 4
    assert min(page.data("figures")["by-range"]["data"][0]["x"]) < 0.0


def test_repeated_stations_have_one_row(gripper):
    """What is shown is what was solved: copies of a station are merged."""
    rows = [*range(44), 3, 3, 7]
    again = hl.Recording(
        gripper.world_R_hand[rows],
        gripper.world_t_hand[rows],
        gripper.ranges[rows],
        tuple(gripper.plane_labels[j] for j in rows),
        gripper.beam_names,
    )
    found = hl.calibrate(again, hl.Noise(3e-5, **EXACT))
    page = sound(found)
    assert [row[0][0] for row in page.table("stations")] == [str(j) for j in range(1, 45)]
    assert "44 with readings, of 47" in page.text
    assert "repeat" in page.text


def test_stations_without_some_beams_count_what_was_read(gripper):
    ranges = gripper.ranges.copy()
    ranges[5, 1:] = np.nan
    ranges[9, 0] = np.nan
    found = hl.calibrate(dataclasses.replace(gripper, ranges=ranges), hl.Noise(3e-5, **EXACT))
    rows = sound(found).table("stations")
    assert [rows[j][5][0] for j in (4, 5, 9)] == ["4", "1", "3"]


@pytest.mark.slow
def test_of_many_stations_those_with_the_largest_residuals_are_listed():
    recording, _ = simulated(layout=Layout(planes=50))
    found = hl.calibrate(recording, hl.Noise(3e-5, **EXACT), hl.CalibrationOptions("none"))
    page = sound(found)
    largest = np.nanmax(np.abs(found.fit.residuals), axis=1)
    worst = np.sort(np.argsort(-largest, kind="stable")[:200])
    names = [row[0][0] for row in page.table("stations")]
    assert names == [recording.station_names[j] for j in worst]
    assert "The 200 stations of 550 with the largest residuals" in page.text
    assert re.search(r"\d+ of 2200 readings are drawn, the largest residuals among them", page.text)
    assert "40 of 50 planes were held out" in page.text


@pytest.mark.slow
def test_plane_by_plane_has_the_same_report(handlaser, tmp_path):
    told = ("calibrate", GRIPPER / "recording.csv", "--rig", GRIPPER / "rig.toml", "--incremental")
    code, _, _ = handlaser(*told, "--report", tmp_path / "a.html", "--out", tmp_path / "a.json")
    assert code == 0
    page = Page((tmp_path / "a.html").read_text())
    assert page.data("calibration") == json.loads((tmp_path / "a.json").read_text())
    assert len(page.table("stations")) == 44


@pytest.mark.slow
def test_robot_and_sensor_are_those_of_the_rig(calibration, rig):
    """An arm that cannot be loaded gives no next stations; its name stands in the head all the same."""
    robot = hl.planning.Robot("folder/<arm>.urdf", "tool0")
    workspace = hl.planning.Workspace([0.5, 0.0, 0.2], [0.8, 0.2, 0.6], np.eye(3), robot=robot)
    sensor = hl.Sensor(0.0, 0.03, max_incidence=math.radians(40.0), linearity=0.002)
    told = dataclasses.replace(rig, workspace=workspace, sensor=sensor)
    page = Page(report_text(calibration, hl.ReportOptions(told)))
    assert "<arm>.urdf, hand frame tool0" in page.text
    assert "reads 0 to 30 mm, up to 40 deg of incidence, expected linear to 0.2 %" in page.text
    assert page.table("next") == []
