"""Steps inside an estimate of a survey, each by itself: what comes back, misses, and is trusted."""

from dataclasses import replace

import numpy as np
import pytest

import handlaser_gtsam as hl
from benchmarks import rigs, rigs_by_rays
from handlaser_gtsam.estimation import survey as estimation
from handlaser_gtsam.estimation.survey_outliers import worst_changed
from handlaser_gtsam.estimation.survey_rows import (
    missed,
    rays_before,
    rows_of,
    without_range_errors,
)
from handlaser_gtsam.estimation.survey_starts import _redundancy
from handlaser_gtsam.model.families import BEAM, POSE
from handlaser_gtsam.model.sensors.kinds import KINDS
from handlaser_gtsam.model.sensors.mounted import SENSOR
from handlaser_gtsam.model.targets.point import POINT
from handlaser_gtsam.model.targets.sphere import SPHERE

STATED = hl.Noise(range_sigma=1e-4)


@pytest.fixture(scope="module")
def settled():
    """A settled state, of a profiler before planes and a ball."""
    kind, options, noise = rigs.ROWS["profiler, planes and sphere"]
    found = hl.calibrate(rigs.survey_of(getattr(rigs_by_rays, kind)(1, **options)), noise)._found
    assert found.used.all()
    return found.ended()


def test_a_good_shot_that_was_rejected_comes_back(settled):
    state = replace(settled, used=settled.used.copy())
    state.used[3] = False
    assert worst_changed(state)
    assert state.used.all()
    assert not worst_changed(state)


def test_a_bad_shot_stays_where_it_is(settled):
    """Ten standard deviations off, it is rejected, and does not come back."""
    items = list(settled.rows.items)
    shot = items[3].shot
    items[3] = replace(items[3], shot=replace(shot, reading=shot.reading + 1e-3))
    state = replace(
        settled, rows=replace(settled.rows, items=tuple(items)), used=settled.used.copy()
    )
    assert worst_changed(state)
    assert np.flatnonzero(~state.used).tolist() == [3]
    assert not worst_changed(state)


@pytest.mark.parametrize("k1", [-0.02, 0.0, 0.02])
def test_rays_miss_a_ball_whatever_the_range_error(k1):
    """A derivative by the place of the hand is that of a reading, which a range error makes shorter."""
    mount = np.concatenate((np.eye(3).ravel(), np.zeros(3), [0.0, k1, 0.0, 0.0]))
    pose = np.concatenate((np.eye(3).ravel(), np.zeros(3)))
    values = {
        SENSOR.name: mount[None, None],
        SPHERE.name: np.array([0.0, 0.0, 0.5, 0.05])[None, None],
        POSE.name: pose[None, None],
    }
    rays = KINDS["profiler"].rays(np.array([[0.0], [0.025], [0.0499], [0.075]]))
    none = np.array([0])
    rows = rays_before(0, rays, SPHERE.name, none, none).evaluate(without_range_errors(values))
    assert missed(SPHERE.name, rows)[0].tolist() == [False, False, True, True]
    assert rows.columns[-1, 0, 0, 0] == pytest.approx(0.45, abs=1e-12)


def test_redundancy_counts_numbers_and_not_range_errors():
    """A spot on a point says three numbers; one range before a ball or a plane says one."""
    rng = np.random.default_rng(1)
    stations = hl.StationList(
        np.tile(np.eye(3), (9, 1, 1)),
        rng.normal(size=(9, 3)),
        ("point:tip",) * 4 + ("sphere:b",) * 5,
    )
    rows = rows_of(hl.Survey(stations, ranges=np.full((9, 1), 0.3), beam_names=("laser",)))
    beam, tip, ball = (BEAM.name, 0), (POINT.name, 0), (SPHERE.name, 0)
    assert _redundancy(rows.items[:4], (beam, tip)) == 12 - 5 - 3
    assert _redundancy(rows.items[4:], (beam, ball)) == 5 - 5 - 4
    assert _redundancy(rows.items, (beam, tip, ball)) == 17 - 5 - 3 - 4


@pytest.mark.slow
def test_no_result_rests_on_rays_that_miss_their_ball(monkeypatch):
    """Where the search without such rays does not settle, the one with them is no result."""
    kind, options, _ = rigs.ROWS["mixed"]
    options = {
        **options,
        "sensors": ("profiler", "beam"),
        "targets": "planes+sphere",
        "stations": 8,
    }
    survey = rigs.survey_of(getattr(rigs_by_rays, kind)(3, **options))
    good = hl.calibrate(survey, STATED)._found
    state = good.ended()
    assert estimation._settle_grazing(replace(state, values=dict(state.values)))
    far = {**state.values, SPHERE.name: state.values[SPHERE.name] + [0.0, 0.0, 1.0, 0.0]}
    monkeypatch.setattr(estimation, "_settle", lambda _: False)
    assert not estimation._settle_grazing(replace(state, values=far))


@pytest.mark.slow
def test_the_shift_of_a_target_left_out_is_that_of_the_spots():
    """Of beams, too: a location that moves along its beam moves no spot."""
    survey = rigs.survey_of(
        rigs_by_rays.beams(3, targets="planes+sphere", planes=2, count=2, stations=8)
    )
    found = hl.validate(survey, STATED, splits=0)
    whole = found.calibration
    assert [one.name for one in found.targets] == ["plane:A", "plane:B", "sphere:S1"]
    for one in found.targets[1:]:  # a plane and the ball
        kept = np.array([label != one.name for label in survey.stations.plane_labels])
        rest = hl.calibrate(survey.part(kept), STATED)
        shifts = []
        for i, (name, beam) in enumerate(whole.beams.items()):
            d = np.nanmedian(survey.ranges[:, i])
            spots = []
            for at in (beam, rest.beams[name]):
                k1, k2 = at.range_error
                spots.append(at.location + (d + k1 * d + k2 * d * d) * at.direction)
            shifts.append(np.linalg.norm(spots[0] - spots[1]))
        assert one.result.shift == pytest.approx(max(shifts), rel=1e-3)
