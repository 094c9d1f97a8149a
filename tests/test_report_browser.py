"""The report in headless Chromium: what is drawn, how it is laid out, and what it prints.

Skipped where there is no Chromium, or no playwright to drive it (extra `browser`).
"""

import dataclasses
import re
import shutil
import subprocess

import pytest
from helpers import GRIPPER
from test_report import HOSTILE, PLANES, undetermined

import handlaser_gtsam as hl

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
playwright = pytest.importorskip("playwright.sync_api", reason="needs playwright")
pytestmark = [pytest.mark.slow, pytest.mark.skipif(CHROMIUM is None, reason="needs Chromium")]

QUIET = (
    *("--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run"),
    *("--disable-background-networking", "--disable-component-update", "--disable-sync"),
)
SOFTWARE_GL = ("--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader")
FLAT = ("qq", "correlation", "by-range", "by-incidence", "by-station", "by-plane", "by-count")
WIDTHS = (1280, 390)
SLOW = 60_000  # milliseconds until a busy machine without a GPU has drawn something
ROUNDING = 1.5  # pixels


@pytest.fixture(scope="module")
def driver():
    with playwright.sync_playwright() as found:
        yield found


@pytest.fixture(scope="module")
def chromium(driver):
    browser = driver.chromium.launch(executable_path=CHROMIUM, args=[*QUIET, *SOFTWARE_GL])
    yield browser
    browser.close()


@pytest.fixture(scope="module")
def reports(tmp_path_factory):
    """Three pages: of the shipped recording, with names that try everything, and undetermined."""
    folder = tmp_path_factory.mktemp("reports")
    recording = hl.read_recording(GRIPPER / "recording.csv")
    rig = hl.read_rig(GRIPPER / "rig.toml")
    named = dataclasses.replace(
        recording,
        beam_names=HOSTILE,
        plane_labels=tuple(PLANES[plane] for plane in recording.plane_labels),
        station_names=tuple(f"<i>{name}</i>&amp;" for name in recording.station_names),
    )
    limits = hl.Limits(rms=2e-5, location_sigma=2e-4, direction_sigma=0.005)
    told = hl.ReportOptions(rig, recording_file=GRIPPER / "recording.csv")
    strict = hl.ReportOptions(dataclasses.replace(rig, limits=limits))
    hl.write_report(folder / "good.html", hl.calibrate(recording, rig.noise), told)
    hl.write_report(folder / "hostile.html", hl.calibrate(named, rig.noise), strict)
    hl.write_report(folder / "open.html", undetermined(recording))
    return folder


class Seen:
    """A page, and everything that it did that it should not."""

    def __init__(self, browser, path, width):
        self.page = browser.new_page(viewport={"width": width, "height": 900})
        self.faults: list[str] = []
        self.page.on("console", self._console)
        self.page.on("pageerror", lambda error: self.faults.append(f"error: {error}"))
        self.page.on("request", self._request)
        self.page.on("dialog", lambda one: (self.faults.append("dialog"), one.dismiss()))
        self.page.goto(path.as_uri(), wait_until="load")
        self.page.wait_for_selector("html[data-ready=yes]", timeout=SLOW)

    def _console(self, message):
        if message.type == "error" or "MathJax" in message.text:
            self.faults.append(f"console: {message.text}")

    def _request(self, request):
        if not request.url.startswith(("file:", "data:", "blob:")):
            self.faults.append(f"request: {request.url}")

    def show_space(self):
        self.page.locator(".space:not(.later)").scroll_into_view_if_needed()
        self.page.wait_for_selector(
            ".space:not(.later) .canvas[data-drawn]", timeout=SLOW, state="attached"
        )

    def evaluate(self, script, value=None):
        return self.page.evaluate(script, value)


@pytest.fixture(
    scope="module", params=[(n, w) for n in ("good", "hostile", "open") for w in WIDTHS]
)
def seen(request, chromium, reports):
    """Pages that are looked at; what a test changes it puts back."""
    name, width = request.param
    if request.param == ("good", 1280):
        found = request.getfixturevalue("good")
    else:
        found = Seen(chromium, reports / f"{name}.html", width)
    found.name, found.width = name, width
    found.show_space()
    yield found
    if request.param != ("good", 1280):
        found.page.close()


@pytest.fixture(scope="module")
def good(chromium, reports):
    found = Seen(chromium, reports / "good.html", 1280)
    yield found
    found.page.close()


def test_the_load_event_waits_for_every_flat_figure(chromium, reports):
    """Print commands without a reader print then; what is in view was drawn before the rest."""
    page = chromium.new_page()
    page.add_init_script(
        "addEventListener('load', () => { window.atLoad = "
        "[...document.querySelectorAll('.plot:not(.space) .canvas[data-drawn=yes]')]"
        ".map((one) => one.id); });"
    )
    page.goto((reports / "good.html").as_uri(), wait_until="load")
    page.wait_for_selector("html[data-ready=yes]", timeout=SLOW)
    assert sorted(page.evaluate("window.atLoad")) == sorted(FLAT)
    assert page.evaluate("performance.getEntriesByName('view-drawn', 'mark').length") == 1
    page.close()


def test_every_flat_figure_draws_its_points(seen):
    expected = FLAT if seen.name != "open" else ("by-range", "by-station", "by-plane")
    drawn = seen.evaluate(
        "[...document.querySelectorAll('.plot:not(.space) .canvas')]"
        ".map(one => [one.id, one.dataset.drawn])"
    )
    assert sorted(drawn) == sorted([name, "yes"] for name in expected)
    for name in expected:
        shapes = seen.evaluate(
            "name => document.querySelectorAll(`#${name} .points path, #${name} .hm image`).length",
            name,
        )
        wanted = {"correlation": 1, "by-count": 30}.get(name, 16 if seen.name == "open" else 170)
        assert shapes >= wanted, (name, shapes)


COLOURS = """async (name) => {
  const place = document.getElementById(name);
  const url = await Plotly.toImage(place, {format: "png", width: 400, height: 300});
  const image = new Image();
  await new Promise((done) => { image.onload = done; image.src = url; });
  const canvas = document.createElement("canvas");
  canvas.width = 400; canvas.height = 300;
  const context = canvas.getContext("2d", {willReadFrequently: true});
  context.drawImage(image, 0, 0);
  const pixels = context.getImageData(0, 0, 400, 300).data;
  const found = {};
  for (let i = 0; i < pixels.length; i += 4) {
    if (pixels[i + 3] < 200) continue;
    const key = [pixels[i] >> 5, pixels[i + 1] >> 5, pixels[i + 2] >> 5].join();
    found[key] = (found[key] || 0) + 1;
  }
  return Object.values(found).filter((count) => count > 4).length;
}"""


def test_both_views_in_space_are_drawn(good):
    """Pixels of many colours: planes, beams of four colours, axes, and text."""
    good.show_space()
    assert good.page.get_attribute("#space-world", "data-drawn") == "yes"
    assert good.evaluate(COLOURS, "space-world") >= 8
    good.page.click("button[data-show=space-hand]")
    good.page.wait_for_selector("#space-hand[data-drawn]", timeout=SLOW)
    assert good.page.get_attribute("#space-hand", "data-drawn") == "yes"
    assert good.evaluate(COLOURS, "space-hand") >= 6
    assert not good.page.is_visible("#space-world")
    good.page.click("button[data-show=space-world]")
    assert good.page.is_visible("#space-world")
    assert good.faults == []


def test_a_browser_without_webgl_shows_the_still_picture(driver, reports):
    browser = driver.chromium.launch(
        executable_path=CHROMIUM,
        args=[*QUIET, "--disable-3d-apis", "--disable-software-rasterizer"],
    )
    found = Seen(browser, reports / "good.html", 1280)
    found.show_space()
    assert found.page.get_attribute("#space-world", "data-drawn") == "still"
    assert found.page.is_visible("[data-space=space-world] .still svg")
    assert not found.page.is_visible("#space-world")
    assert [one for one in found.faults if not one.startswith("console")] == []
    browser.close()


def test_nothing_is_asked_for_and_nothing_fails(seen):
    assert seen.faults == []


@pytest.mark.parametrize("seen", [("hostile", width) for width in WIDTHS], indirect=True)
def test_names_are_shown_as_they_are(seen):
    body = seen.page.inner_text("body")
    for name in HOSTILE[:3]:
        assert name in body
    legend = seen.page.locator("#by-range .legendtext").all_text_contents()
    assert legend[0] == "beam <script>alert(1)</script>"
    assert legend[2] == "beam %{x} $x^2$ &l…ample'>a</a>"  # cut in its middle
    assert seen.page.locator("main a[href^=http], main img, main i").count() == 0
    ticks = seen.page.locator("#by-plane .xtick text").all_text_contents()
    assert ticks[0] == "2020-01-01"


def test_a_table_sorts_by_its_numbers_both_ways(good):
    column = good.page.locator("#table-stations th", has_text="rms mm")
    place = column.evaluate("one => one.cellIndex")
    values = """place => [...document.querySelectorAll("#table-stations tbody tr")]
        .map(row => Number(row.cells[place].dataset.v))"""
    before = good.evaluate(values, place)
    column.locator("button").click()
    assert good.evaluate(values, place) == sorted(before) != before
    assert column.get_attribute("aria-sort") == "ascending"
    column.locator("button").click()
    assert good.evaluate(values, place) == sorted(before, reverse=True)
    assert column.get_attribute("aria-sort") == "descending"
    names = good.page.locator("#table-stations th", has_text="station").first
    names.locator("button").click()
    order = good.page.locator("#table-stations tbody td:first-child").all_text_contents()
    assert order == [str(i) for i in range(1, 45)]  # 2 before 10


def test_the_calibration_is_saved_as_it_is(good, tmp_path):
    with good.page.expect_download() as started:
        good.page.click("#save")
    started.value.save_as(tmp_path / "calibration.json")
    found = hl.read_calibration(tmp_path / "calibration.json")
    assert [beam.name for beam in found.beams] == ["1", "2", "3", "4"]


# --- layout ------------------------------------------------------------------------------------------

FAULTS = """(rounding) => {
  const faults = [], wide = document.documentElement.clientWidth;
  const visible = (one) => one.getClientRects().length
    && getComputedStyle(one).visibility !== "hidden";
  const named = (one) => `${one.tagName}#${one.id} ${one.textContent.trim().slice(0, 30)}`;
  if (document.documentElement.scrollWidth > wide) faults.push("the page is wider than the window");

  // Text of the page: inside the window, and inside every element that would cut it.
  const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  for (let node = walker.nextNode(); node; node = walker.nextNode()) {
    const owner = node.parentElement;
    if (!node.data.trim() || owner.closest("script, svg") || !visible(owner)) continue;
    const range = document.createRange();
    range.selectNodeContents(node);
    for (const box of range.getClientRects()) {
      if (box.left < -rounding || box.right > wide + rounding) faults.push("beside: " + named(owner));
      const scroll = owner.closest(".scroll");
      if (scroll && box.right > scroll.getBoundingClientRect().right + rounding) {
        faults.push("cut: " + named(owner));
      }
    }
  }
  // Boxes that stand beside or below each other do not overlap.
  const groups = "main > *, section > *, .plots > *, .spaces > *, dl > div, figure > *, tr > *, "
    + "nav > *, li";
  for (const one of document.querySelectorAll(groups)) {
    const next = one.nextElementSibling;
    if (!next || !visible(one) || !visible(next)) continue;
    const a = one.getBoundingClientRect(), b = next.getBoundingClientRect();
    const across = Math.min(a.right, b.right) - Math.max(a.left, b.left);
    const down = Math.min(a.bottom, b.bottom) - Math.max(a.top, b.top);
    if (across > rounding && down > rounding) faults.push(`overlap: ${named(one)} and ${named(next)}`);
  }
  // Text of the figures: inside its figure, and not one over the other.
  for (const place of document.querySelectorAll(".plot:not(.space) .canvas[data-drawn]")) {
    const frame = place.getBoundingClientRect(), boxes = [];
    for (const one of place.querySelectorAll("svg text")) {
      if (!one.textContent.trim() || getComputedStyle(one).opacity === "0") continue;
      const box = one.getBoundingClientRect();
      if (!box.width) continue;
      if (box.left < frame.left - rounding || box.right > frame.right + rounding
          || box.top < frame.top - rounding || box.bottom > frame.bottom + rounding) {
        faults.push(`outside of ${place.id}: ${one.textContent}`);
      }
      boxes.push([one, box]);
    }
    boxes.forEach(([one, a], i) => boxes.slice(i + 1).forEach(([other, b]) => {
      const turned = one.getAttribute("transform")?.includes("rotate(")
        && !/rotate\\(0|rotate\\(-90/.test(one.getAttribute("transform"));
      const across = Math.min(a.right, b.right) - Math.max(a.left, b.left);
      const down = Math.min(a.bottom, b.bottom) - Math.max(a.top, b.top);
      if (!turned && across > 2 && down > 3) {
        faults.push(`text over text in ${place.id}: ${one.textContent} and ${other.textContent}`);
      }
    }));
  }
  return faults;
}"""


def test_nothing_overlaps_and_no_text_is_cut(seen):
    assert seen.evaluate(FAULTS, ROUNDING) == []


@pytest.mark.parametrize("seen", [("good", 390)], indirect=True)
def test_the_checks_of_the_layout_find_what_they_look_for(seen):
    """A box moved over its neighbour, a cell that does not break, and a page too wide are found."""
    styles = {
        "overlap: ": "#fit h2 { margin-bottom: -60px; padding-bottom: 40px }",
        "cut: ": "#table-planes td { padding-right: 40px }",
        "the page is wider than": "#next p { width: 500px; white-space: nowrap }",
    }
    for words, style in styles.items():
        tag = seen.page.add_style_tag(content=style)
        assert any(one.startswith(words) for one in seen.evaluate(FAULTS, ROUNDING))
        tag.evaluate("one => one.remove()")
    assert seen.evaluate(FAULTS, ROUNDING) == []


def _until_drawn_again(found):
    """Wait until figures are as wide as their places: plotly.js waits a moment after a change."""
    place = "document.querySelector('#qq .main-svg').getBoundingClientRect().width"
    wanted = "document.querySelector('#qq').clientWidth"
    for _ in range(100):
        found.page.wait_for_timeout(100)
        if abs(found.evaluate(place) - found.evaluate(wanted)) < ROUNDING:
            break
    found.page.wait_for_timeout(500)


def test_a_window_that_changes_its_size_is_laid_out_anew_and_so_is_paper(chromium, reports):
    """Paper is as wide as A4 within its margins: stills instead of what turns, and nothing cut."""
    found = Seen(chromium, reports / "good.html", 1280)
    for width in (390, 800, 1280):
        found.page.set_viewport_size({"width": width, "height": 900})
        _until_drawn_again(found)
        assert found.evaluate(FAULTS, ROUNDING) == [], width
    found.page.set_viewport_size({"width": 688, "height": 1000})
    _until_drawn_again(found)
    found.page.emulate_media(media="print")
    assert found.evaluate(FAULTS, ROUNDING) == []
    assert not found.page.is_visible("nav")
    assert not found.page.is_visible("#save")
    assert found.page.is_visible("[data-space=space-world] .still svg")
    assert found.page.is_visible("[data-space=space-hand] .still svg")
    assert found.page.locator(".space canvas:visible").count() == 0
    assert found.page.is_visible(".sign")
    assert found.faults == []
    found.page.close()


def test_without_scripts_the_page_is_whole_but_for_its_figures(chromium, reports):
    context = chromium.new_context(
        java_script_enabled=False, viewport={"width": 390, "height": 900}
    )
    page = context.new_page()
    page.goto((reports / "good.html").as_uri())
    assert page.is_visible("#table-mounts")
    assert page.is_visible("[data-space=space-world] .still svg")
    assert not page.is_visible("#qq")
    context.close()


@pytest.mark.parametrize(
    "seen", [(name, 1280) for name in ("good", "hostile", "open")], indirect=True
)
def test_it_prints_to_a4_pages(seen):
    content = seen.page.pdf(prefer_css_page_size=True, print_background=True)
    boxes = re.findall(rb"/MediaBox \[0 0 ([\d.]+) ([\d.]+)\]", content)
    assert 3 <= len(boxes) <= 20
    for width, height in boxes:  # 210 by 297 mm in points
        assert float(width) == pytest.approx(595.3, abs=1.0)
        assert float(height) == pytest.approx(841.9, abs=1.0)


@pytest.mark.skipif(shutil.which("pdftotext") is None, reason="needs pdftotext")
@pytest.mark.parametrize("name", ["good", "hostile", "open"])
def test_paper_without_a_reader_has_all_figures_and_no_torn_title(
    chromium, reports, name, tmp_path
):
    """As a program prints it, with the load event; what a page ends with is no title of the next."""
    path, pdf = reports / f"{name}.html", tmp_path / "report.pdf"
    printing = [f"--print-to-pdf={pdf}", "--no-pdf-header-footer", path.as_uri()]
    subprocess.run([CHROMIUM, "--headless", *QUIET, *printing], check=True, capture_output=True)
    text = subprocess.run(["pdftotext", "-layout", str(pdf), "-"], check=True, capture_output=True)
    pages = text.stdout.decode().split("\f")
    whole = " ".join(" ".join(pages).split())
    assert "drawing" not in whole.lower()
    titles = ["reading, mm", "station, in their order", "plane"]
    titles += [] if name == "open" else ["incidence, deg", "expected", "stations"]
    for title in titles:
        assert title in whole
    found = Seen(chromium, path, 1280)
    heads = found.page.locator("h2, h3, figure.table > figcaption").all_text_contents()
    found.page.close()
    ends = {" ".join(one.split())[-40:] for one in heads}
    lines = [[line for line in page.splitlines() if line.strip()] for page in pages]
    for page in filter(None, lines):
        last = " ".join(page[-1].split())
        assert not any(last.endswith(end) for end in ends if end), last
