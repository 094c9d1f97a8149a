"""What all tests share: the command, and benchmarks importable behind whatever is installed.

HYPOTHESIS_PROFILE=gate draws ten times as many examples, others in every run. HANDLASER_SKIPPED names
a file to which the tests that were skipped are added, a line each: the gate runs them with every extra.
"""

import gc
import os
import sys
from pathlib import Path

# Tests run in as many processes as there are processors. NumPy reads this when it is imported.
# Screens are as wide as a test says, and not as the terminal that it is run from.
os.environ.pop("COLUMNS", None)
os.environ["OMP_NUM_THREADS"] = os.environ["OPENBLAS_NUM_THREADS"] = "1"

import pytest
from hypothesis import settings

import handlaser_gtsam as hl
from handlaser_gtsam.cli import main

ROOT = Path(__file__).parents[1]
sys.path.append(str(ROOT))
settings.register_profile("quick", max_examples=40, deadline=None, derandomize=True, database=None)
settings.register_profile("gate", max_examples=400, deadline=None, database=None)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "quick"))
# What collection makes stays: to look for garbage in it takes a quarter of its time.
gc.disable()


def pytest_collection_finish():
    """Collect garbage again; frozen, objects would have no referrers for Hypothesis to find."""
    gc.enable()


def pytest_runtest_logreport(report):
    """Note a test that was skipped; processes of xdist report to the one that writes."""
    noted = os.environ.get("HANDLASER_SKIPPED")
    if noted and report.skipped and "PYTEST_XDIST_WORKER" not in os.environ:
        with Path(noted).open("a") as file:
            print(report.nodeid, file=file)


pytest_collectreport = pytest_runtest_logreport
"""A file whose imports are missing is skipped as a whole."""


@pytest.fixture(scope="session")
def gripper():
    """Return the recording that ships: four beams before four planes."""
    return hl.read_recording(ROOT / "examples" / "gripper" / "recording.csv")


@pytest.fixture
def handlaser(monkeypatch, capsys):
    """Run the command in this process; return exit code, stdout and stderr."""

    def run(*arguments):
        monkeypatch.setattr(sys, "argv", ["handlaser", *map(str, arguments)])
        with pytest.raises(SystemExit) as caught:
            main()
        captured = capsys.readouterr()
        return caught.value.code or 0, captured.out, captured.err

    return run


@pytest.fixture
def refusal(handlaser):
    """Run the command in this process where it refuses something; return the one line it says."""

    def run(*arguments):
        code, out, err = handlaser(*arguments)
        assert (code, out) == (2, ""), err
        assert err.endswith("\n")
        assert err.count("\n") == 1
        return err

    return run


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config, log):
    """Give every process a part of the tests in their order; who is done first takes from the others.

    What the tests of a file share is then made once, and all end together.
    """
    if config.getoption("dist") != "load":  # something else is asked for
        return None
    from xdist.scheduler import WorkStealingScheduling

    return WorkStealingScheduling(config, log)
