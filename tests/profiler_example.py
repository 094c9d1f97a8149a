"""The example of a profiler, read and calibrated once for all tests of a process."""

from functools import cache

from helpers import ROOT

import handlaser_gtsam as hl

FOLDER = ROOT / "examples" / "profiler"


@cache
def example():
    """Return the survey of the example."""
    return hl.read_survey(FOLDER / "poses.csv", FOLDER / "rig.toml")


@cache
def calibrated_example():
    """Return its calibration with noise of which nothing is stated."""
    return hl.calibrate(example())
