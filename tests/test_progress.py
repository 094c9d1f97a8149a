"""What long computations tell their caller."""

import pytest

import handlaser_gtsam as hl

EXACT = hl.CalibrationOptions("k1k2", poses="exact")
"""What is true of the shipped recording: where it does not fit, much more is tried."""


def test_every_phase_of_a_calibration_tells(gripper):
    told = []
    hl.calibrate(gripper, progress=told.append)
    assert list(dict.fromkeys(one.phase for one in told)) == ["search", "solve", "scales", "tests"]
    assert all((one.trial is not None) == (one.phase == "solve") for one in told)
    numbers = [one.trial.number for one in told if one.phase == "solve"]
    assert numbers[:2] == [1, 2]


@pytest.mark.slow
def test_a_validation_counts_its_parts(gripper):
    told = []
    hl.validate(gripper, hl.Noise(3e-5), EXACT, splits=1, progress=told.append)
    parts = [one for one in told if one.phase == "leave-out"]
    assert [(one.done, one.total) for one in parts] == [(i, 7) for i in range(7)]
    assert [parts[i].name for i in (0, 1, 5, 6)] == [
        "everything",
        "without plane A",
        "split 1",
        "without range error",
    ]
    assert {"search", "solve", "hold-out"} < {one.phase for one in told}


def test_nobody_is_told_after_the_end(gripper):
    told = []
    hl.calibrate(gripper, hl.Noise(3e-5), EXACT, progress=told.append)
    before = len(told)
    hl.calibrate(gripper, hl.Noise(3e-5), EXACT)
    assert len(told) == before


@pytest.mark.parametrize("phase", ["search", "tests"])
def test_a_stop_outside_the_solver_is_passed_on(gripper, phase):
    def stop(told):
        if told.phase == phase:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        hl.calibrate(gripper, hl.Noise(3e-5), EXACT, progress=stop)


def test_a_stop_within_the_solver_ends_all_that_follows(gripper):
    parts = []

    def stop(told):
        if told.total:
            parts.append(told)
        if told.phase == "solve" and len(parts) == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        hl.validate(gripper, hl.Noise(3e-5), EXACT, splits=1, progress=stop)
    assert len(parts) == 2


def test_what_cannot_be_called_is_refused(gripper):
    problem = hl.calibrate(gripper, hl.Noise(3e-5), EXACT).problem()
    for compute in (
        lambda: hl.calibrate(gripper, progress=3),
        lambda: hl.validate(gripper, progress=3),
        lambda: hl.optimize(problem.graph, problem.values, progress=3),
    ):
        with pytest.raises(hl.InputError, match="3 of type int as progress; expected a function"):
            compute()
