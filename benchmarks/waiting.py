"""What a person waits for, in processor time, beside what was asked for.

    python -m benchmarks.waiting

The help (wall time of a new process, median of five), a recording read at two sizes, the report of 13
planes with its hold-out beside `validate`, where there are Chromium and playwright how long that report
takes to open, and the choice of 44 stations from 1,200. Logs and bags are timed by `benchmarks.logs`,
solvers by `benchmarks.solve`.
"""

import importlib.util
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

import handlaser_gtsam as hl
from handlaser_gtsam.planning.choice import choose
from handlaser_gtsam.validation.quick_validation import held_out
from handlaser_gtsam.validation.scenes import SCENES, Layout
from handlaser_gtsam.validation.simulate import Errors, simulate

HEADER = "plane,station,x,y,z,qx,qy,qz,qw,range_left,range_right"
ROW = "{0},s{1},0.123456789,0.223456789,0.323456789,0,0,0,1,0.0212345,0.0312345"
SIZES = 15_000, 150_000
MOST_BYTES = 6_000_000


def seconds(run: Callable[[], object]) -> float:
    """Return the processor time of a run."""
    begin = time.process_time()
    run()
    return time.process_time() - begin


def told(what: str, found: float, most: float, unit: str) -> bool:
    """Print one figure beside what it may be; return whether it holds."""
    holds = found <= most
    print(f"{what}: {found:.3g} {unit}" + ("" if holds else f"  MISSES {most:g} {unit}"))
    return holds


def help_seconds() -> float:
    """Return how long a new process takes to show its help."""
    code = "import sys; sys.argv[1:] = ['--help']; from handlaser_gtsam.cli import main; main()"
    each = []
    for _ in range(5):
        begin = time.perf_counter()
        subprocess.run([sys.executable, "-c", code], stdout=subprocess.DEVNULL, check=True)
        each.append(time.perf_counter() - begin)
    return statistics.median(each)


def growth(folder: Path) -> float:
    """Return by how much reading takes longer where there are ten times as many rows."""
    each = []
    for size in SIZES:
        path = folder / f"{size}.csv"
        rows = (ROW.format("AB"[j % 2], j) for j in range(size))
        path.write_text("\n".join([HEADER, *rows, ""]))
        each.append(seconds(lambda path=path: hl.read_recording(path)))  # type: ignore[misc]
    return each[1] / each[0]


def report_figures(folder: Path) -> list[bool]:
    """Print time and size of the report of 13 planes, and its hold-out beside `validate`."""
    truth, stations = SCENES["paper"](Layout(4, 13, 11), np.random.default_rng(0))
    errors = Errors(3e-5, 5e-5, 5e-4)
    recording = simulate(truth, stations, errors, np.random.default_rng(1))
    noise = hl.Noise(3e-5, 5e-5, 5e-4)
    found, path = hl.calibrate(recording, noise), folder / "report.html"
    hl.write_report(path, found)  # what it imports does not count
    fast = seconds(lambda: held_out(found)) / seconds(lambda: hl.validate(recording, noise))
    return [
        told("report of 13 planes", seconds(lambda: hl.write_report(path, found)), 2.0, "s"),
        told("its size", float(path.stat().st_size), MOST_BYTES, "bytes"),
        told("its hold-out, beside validate", fast, 0.2, "times"),
        *opening(path),
    ]


def opening(path: Path) -> list[bool]:
    """Print how long a report takes until its load event, and until what is in view is drawn."""
    chromium = shutil.which("chromium") or shutil.which("chromium-browser")
    if chromium is None or importlib.util.find_spec("playwright") is None:
        return []
    from playwright.sync_api import sync_playwright

    loaded, drawn = [], []
    with sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
        for _ in range(3):
            page = browser.new_page()
            page.goto(path.as_uri(), wait_until="load")
            page.wait_for_selector("html[data-ready=yes]")
            entry = "performance.getEntriesByType('navigation')[0].loadEventEnd"
            loaded.append(1e-3 * page.evaluate(entry))
            view = "performance.getEntriesByName('view-drawn', 'mark')[0].startTime"
            drawn.append(1e-3 * page.evaluate(view))
            page.close()
        browser.close()
    return [
        told("what is in view is drawn, best of three", min(drawn), 2.0, "s"),
        told("all flat figures are, before the load event", min(loaded), 5.0, "s"),
    ]


def choice_seconds() -> float:
    """Return how long the choice of 44 stations from 1,200 takes, at the mean and four draws."""
    rows = np.random.default_rng(0).standard_normal((5, 1200, 4, 40))
    return seconds(lambda: choose(rows, np.eye(40), np.eye(40)[:20], 44, exchange=False))


def main() -> None:
    """Print all figures; exit 1 where one misses what was asked for."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        kept = [
            told("help", help_seconds(), 0.5, "s"),
            told("ten times as many rows read", growth(folder), 15.0, "times as long"),
            *report_figures(folder),
            told("44 of 1200 stations chosen", choice_seconds(), 1.0, "s"),
        ]
    sys.exit(0 if all(kept) else 1)


if __name__ == "__main__":
    main()
