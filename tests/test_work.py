"""How much one calibration works: a person waits for every solve, graph and rank decision."""

import sys
from collections import Counter

import pytest
from helpers import ROOT

import handlaser_gtsam as hl
from handlaser_gtsam.factors import SharedEvaluation
from handlaser_gtsam.model.beams_on_planes import BeamsOnPlanes

MOST = {"levenberg_marquardt": 4, "build_graph": 4, "observability": 7, "linearize": 45}
"""On the recording that ships; `linearize` is that of the model, of the reduction and of the graph. The
rank is judged in every round in which weights settle."""
HOMES = {
    "levenberg_marquardt": "solvers.graph_levenberg",
    "build_graph": "solvers.graph",
    "observability": "observability.rank",
    "linearize": "model.equation",
}


@pytest.fixture
def counted(monkeypatch):
    """Count the calls of each of `MOST`, wherever it was imported."""
    counts = Counter()

    def counting(name, function):
        def call(*arguments, **options):
            counts[name] += 1
            return function(*arguments, **options)

        return call

    hl.calibrate  # everything that it needs is imported with it  # noqa: B018
    modules = [m for name, m in sys.modules.items() if name.startswith("handlaser_gtsam") and m]
    for name, home in HOMES.items():
        original = getattr(sys.modules[f"handlaser_gtsam.{home}"], name)
        for module in modules:
            for attribute, value in list(vars(module).items()):
                if value is original:
                    monkeypatch.setattr(module, attribute, counting(name, original))
    for kind in (BeamsOnPlanes, SharedEvaluation):
        monkeypatch.setattr(kind, "evaluate", counting("linearize", kind.evaluate))
    return counts


@pytest.mark.parametrize("given", ["rig", "nothing"])
def test_a_clean_recording_is_solved_a_few_times_only(counted, given):
    folder = ROOT / "examples" / "gripper"
    recording, noise, options = hl.read_recording(folder / "recording.csv"), None, None
    if given == "rig":
        rig = hl.read_rig(folder / "rig.toml")
        noise, options = rig.noise, hl.CalibrationOptions(sensor=rig.sensor)
    calibration = hl.calibrate(recording, noise, options)
    assert calibration.status == "converged"
    most = (
        MOST if given == "rig" else MOST | {"linearize": 115}
    )  # and unknown pose errors of two kinds
    assert set(counted) == set(most), "a function that is counted was not called at all"
    assert {name: n for name, n in counted.items() if n > most[name]} == {}
