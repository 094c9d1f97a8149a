"""The SciPy reference itself: which unknowns a residual depends on, and its sparse solutions."""

import numpy as np
import pytest
from helpers import simulated

import handlaser_gtsam as hl
from benchmarks import rigs_by_distance, rigs_by_rays
from benchmarks.rigs import EXACT, STATED, body_of, survey_of
from handlaser_gtsam.data.parameters import RangeErrorPrior
from handlaser_gtsam.model.weighting import Variances
from handlaser_gtsam.solvers.reference import problem as reference
from handlaser_gtsam.starts import find_start
from handlaser_gtsam.validation import cross_check
from handlaser_gtsam.validation.scenes import Layout


def of_a_recording():
    """Beams before planes, with priors, errors of the poses and systematic errors as unknowns."""
    recording, _ = simulated(layout=Layout(planes=3, stations=12))
    start = find_start(recording.readings()).parameters
    beams, stations = len(recording.beam_names), len(recording.plane_labels)
    pose = np.tile(1e-8 * np.eye(6), (stations, 1, 1))
    return cross_check.recording_problem(
        recording,
        start,
        (0, 1, 2, 2),
        Variances(np.full(beams, 3e-5), 1e-5, pose),
        RangeErrorPrior(np.tile([0.01, np.inf], (beams, 1))),
        {"lag": 0.05, "incidence": 1e-3},
        of_reading=True,
    )


def of_a_body():
    rig = rigs_by_rays.profiler(3, targets="body", hand_sigma=(1e-5, 1e-5))
    found = hl.calibrate(survey_of(rig, body_of(rig)), STATED)
    return cross_check._problem(found._found)


def of_beams_on_a_point():
    rig = rigs_by_distance.beams(4, count=2)
    names = survey_of(rig).beam_names
    v, w = (rig.truth[name]["direction"] for name in names)
    of = tuple(f"beam:{name}" for name in names)
    known = hl.Known("angle", of, np.arccos(v @ w), 0.0, 1e-4)
    return cross_check._problem(hl.calibrate(survey_of(rig, [known]), EXACT)._found)


@pytest.mark.slow
@pytest.mark.parametrize("made", [of_a_recording, of_a_body, of_beams_on_a_point])
def test_no_residual_depends_on_more_than_its_pattern(made, monkeypatch):
    residuals = reference.Residuals(made())
    assert residuals.sparsity() is None
    monkeypatch.setattr(reference, "DENSE_UNKNOWNS", 0)
    pattern = residuals.sparsity().toarray() > 0.0
    x = residuals.unknowns.x0
    columns = [residuals(x + step) != residuals(x - step) for step in 1e-6 * np.eye(len(x))]
    depends = np.column_stack(columns)
    assert pattern.shape == depends.shape
    assert not (depends & ~pattern).any()
    # And most of the pattern is needed.
    assert depends.sum() > 0.5 * pattern.sum()
    assert not pattern.all()


def test_a_sparse_solution_is_the_dense_one(monkeypatch):
    recording, _ = simulated(layout=Layout(planes=4, stations=12))
    beams, start = len(recording.beam_names), find_start(recording.readings()).parameters
    variances = Variances(np.full(beams, 3e-5))
    problem = cross_check.recording_problem(recording, start, (0,) * beams, variances)
    dense = reference.solve(problem)
    monkeypatch.setattr(reference, "DENSE_UNKNOWNS", 0)
    sparse = reference.solve(problem)
    for key, S in dense.covariances.items():
        sigma = np.sqrt(np.diagonal(S))
        known = sigma > 1e-9 * sigma.max()
        off = np.abs(sparse.values[key] - dense.values[key])[known] / sigma[known]
        # Both end with a Gauss-Newton step by differences that are good to 1e-9.
        assert off.max() < 1e-5
