"""The live page in headless Chromium: what it shows, what it asks for, and that it comes back.

Skipped where there is no Chromium, no playwright to drive it (extra `browser`), or no extra `watch`.
"""

import re
import shutil
import time

import pytest
from helpers import GRIPPER

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
playwright = pytest.importorskip("playwright.sync_api", reason="needs playwright")
pytest.importorskip("starlette", reason="needs the extra watch")
pytest.importorskip("uvicorn", reason="needs the extra watch")
pytestmark = [pytest.mark.slow, pytest.mark.skipif(CHROMIUM is None, reason="needs Chromium")]

from watching import HOSTILE_BEAMS, watching, write_hostile  # noqa: E402

ARGUMENTS = (
    *("--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run"),
    *("--disable-background-networking", "--disable-component-update", "--disable-sync"),
    *("--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"),
)
LINES = (GRIPPER / "recording.csv").read_text().splitlines(keepends=True)
RIG = (GRIPPER / "rig.toml").read_text()
SLOW = 90.0  # seconds until a busy machine without a GPU has drawn something
DRAWN = "document.documentElement.dataset.drawn"
COUNT = "document.querySelector('.counts dd')?.textContent"


@pytest.fixture(scope="module")
def chromium():
    with playwright.sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=CHROMIUM, args=ARGUMENTS)
        yield browser
        browser.close()


class Looking:
    """A tab, and everything that it did that it should not."""

    def __init__(self, browser, port, width=1280):
        self.page, self.faults, self.home = browser.new_page(), [], f"http://127.0.0.1:{port}/"
        self.page.set_viewport_size({"width": width, "height": 900})
        self.page.on("console", self._console)
        self.page.on("pageerror", lambda error: self.faults.append(f"error: {error}"))
        self.page.on("request", self._request)
        self.page.on("dialog", lambda one: (self.faults.append("dialog"), one.dismiss()))
        self.page.goto(self.home)

    def _console(self, message):
        if message.type == "error":
            self.faults.append(f"console: {message.text}")

    def _request(self, request):
        if request.url not in (self.home, f"{self.home}events"):
            self.faults.append(f"request: {request.url[:200]}")

    def until(self, condition):
        """Wait; Playwright's own way evaluates in the page, which its policy forbids."""
        end = time.monotonic() + SLOW
        while not self.page.evaluate(condition):
            assert time.monotonic() < end, condition
            self.page.wait_for_timeout(50)

    def has(self, stations):
        """Wait until so many stations are counted, and drawn."""
        self.until(f"{COUNT} === '{stations}'")
        self.until(f"{DRAWN} === document.documentElement.dataset.state")

    def text(self, place):
        return self.page.inner_text(place)


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "rig.toml").write_text(RIG)
    (tmp_path / "recording.csv").write_text("".join(LINES[:5]))
    return tmp_path


LAYOUT = """() => {
  const faults = [], wide = document.documentElement.clientWidth;
  if (document.documentElement.scrollWidth > wide) faults.push("wider than the window");
  const groups = "main > *, section > *, #content > *, .pair > *, .bar > *, dl > div, figure > *, "
    + "tr > *";
  for (const one of document.querySelectorAll(groups)) {
    const next = one.nextElementSibling;
    if (!next || !one.getClientRects().length || !next.getClientRects().length) continue;
    const a = one.getBoundingClientRect(), b = next.getBoundingClientRect();
    const across = Math.min(a.right, b.right) - Math.max(a.left, b.left);
    const down = Math.min(a.bottom, b.bottom) - Math.max(a.top, b.top);
    if (across > 1.5 && down > 1.5) faults.push(`${one.outerHTML} over another`.slice(0, 200));
  }
  for (const one of document.querySelectorAll("h1, h2, p:not(.note), li, dd, dt, .bar span, th")) {
    if (!one.getClientRects().length) continue;
    const box = one.getBoundingClientRect();
    const words = one.textContent, scrolls = one.closest(".scroll");
    if (one.scrollWidth > one.clientWidth + 1 && getComputedStyle(one).display !== "inline") {
      faults.push("cut: " + words);
    }
    if (!scrolls && (box.left < -1 || box.right > wide + 1)) faults.push("beside: " + words);
    const line = parseFloat(getComputedStyle(one).lineHeight);
    if (one.matches("th, .bar span") && box.height > 3.6 * line) faults.push("broken: " + words);
  }
  return faults;
}"""


def turned_view(tab):
    """Turn the view in space by dragging; return the script that tells how it is turned.

    While a busy machine still renews sections the view may move away under the mouse: then once more.
    """
    eye = "document.getElementById('space-world')._fullLayout.scene.camera.eye.x"
    before, end = tab.page.evaluate(eye), time.monotonic() + SLOW
    while abs(tab.page.evaluate(eye) - before) < 0.05:
        assert time.monotonic() < end
        tab.page.evaluate(
            "document.getElementById('space-world').scrollIntoView({block: 'center'})"
        )
        box = tab.page.locator("#space-world").bounding_box()
        tab.page.mouse.move(box["x"] + 300, box["y"] + 250)
        tab.page.mouse.down()
        tab.page.mouse.move(box["x"] + 420, box["y"] + 260, steps=6)
        tab.page.mouse.up()
        tab.page.wait_for_timeout(1000)
    return eye


def test_it_follows_the_recording_and_comes_back_after_a_restart(chromium, folder):
    """In a wide window and in a narrow one, laid out in every state; a turned view stays turned."""
    with watching(folder, "--port", 0) as (_, port):
        tab, narrow = Looking(chromium, port), Looking(chromium, port, 390)
        for one in (tab, narrow):
            one.has(4)
            assert one.page.evaluate(LAYOUT) == []
        assert tab.text("h1") == "Not usable, undetermined"
        assert "It is drawn once the stations determine every beam" in tab.text("#next")
        with (folder / "recording.csv").open("a") as file:
            file.write("".join(LINES[5:20]))
            file.flush()
            tab.has(19)
            assert tab.text("h1") == "Usable"
            assert tab.page.locator("#table-beams tbody tr").count() == 4
            assert tab.page.locator("#table-next tbody tr").count() == 3
            assert tab.page.locator("#by-count .points path").count() > 6
            # It is drawn once a reader comes near it, and has no place on the page before.
            tab.page.evaluate("document.getElementById('space').scrollIntoView()")
            tab.until("document.getElementById('space-world').dataset.drawn === 'yes'")
            assert tab.page.locator("#space-world canvas").count() == 1
            assert tab.text("#connection") == "live"
            assert "recording.csv" in tab.page.title()
            eye = turned_view(tab)
            turned = tab.page.evaluate(eye)
            file.write(LINES[20])
            file.flush()
            tab.has(20)
            assert abs(tab.page.evaluate(eye) - turned) < 1e-6
        (folder / "recording.csv").write_text("".join(LINES[:20]) + "A," + "x" * 70 + "\n")
        for one in (tab, narrow):
            one.until("!document.getElementById('error').hidden")
            assert one.page.evaluate(LAYOUT) == []
            assert one.faults == []
        assert "line 21: found 2 fields" in tab.text("#error")
        assert tab.text("h1") == "Usable"  # the last good one
        (folder / "recording.csv").unlink()
        tab.until("document.getElementById('error').hidden")
        assert "waiting for recording.csv" in tab.text("#note")
        assert tab.page.evaluate("document.querySelector('main').classList.contains('stale')")
    tab.until("document.getElementById('connection').dataset.now === 'lost'")
    (folder / "recording.csv").write_text("".join(LINES))
    with watching(folder, "--port", port):
        for one in (tab, narrow):
            one.until("document.getElementById('connection').dataset.now === 'live'")
            one.has(44)
            assert not one.page.is_visible("#error")
            assert one.page.evaluate(LAYOUT) == []
            one.page.add_style_tag(content="#next { margin-bottom: -90px; width: 2000px }")
            assert len(one.page.evaluate(LAYOUT)) > 0  # it finds what it looks for
    lost = ("ERR_CONNECTION", "ERR_INCOMPLETE")
    for one in (tab, narrow):
        assert [fault for fault in one.faults if not any(words in fault for words in lost)] == []
        assert re.fullmatch(r"http://127\.0\.0\.1:\d+/", one.home)
        one.page.close()


def test_names_are_text_and_nothing_of_them_runs(chromium, folder):
    write_hostile(folder / "recording.csv")
    with watching(folder, "--port", 0) as (_, port):
        tab = Looking(chromium, port)
        tab.has(44)
        names = tab.page.locator("#table-beams tbody td:first-child").all_text_contents()
        assert names == list(HOSTILE_BEAMS)
        tab.page.locator("#space").scroll_into_view_if_needed()
        tab.until("document.getElementById('space-world').dataset.drawn === 'yes'")
        legend = tab.page.locator("#space-world .legendtext").all_text_contents()
        assert legend[0] == "beam <script>alert(1)</script>"
        assert tab.page.locator("main img").count() == 0
        assert tab.faults == []
        tab.page.close()
