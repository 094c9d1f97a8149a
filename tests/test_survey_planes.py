"""Shots that see several planes: which of them a label means."""

from dataclasses import replace

import numpy as np
import pytest

import handlaser_gtsam as hl
from benchmarks import rigs_by_rays, rigs_by_scene
from benchmarks.rigs import FAR, errors_of, survey_of
from handlaser_gtsam.estimation import survey as estimation
from handlaser_gtsam.estimation.survey import (
    _freed_of_false_relations,
    first_fit,
    first_state,
    state_of,
)
from handlaser_gtsam.estimation.survey_outliers import GROSS
from handlaser_gtsam.estimation.survey_planes import other_planes_taken, with_planes_ahead
from handlaser_gtsam.estimation.survey_rows import rows_of
from handlaser_gtsam.model.condensed_shots import grown
from handlaser_gtsam.model.sensors.kinds import KINDS
from handlaser_gtsam.model.targets_in_shots import planes_in

NOISE = 1e-3


def corner(part, rng):
    """Return angles and ranges of a scan with a part of its points on a wall x = 1, others on y = 1."""
    angle = np.radians(45.0 - 100.0 * part + np.linspace(0.0, 100.0, 400))
    reading = 1.0 / np.maximum(np.cos(angle), np.sin(angle))
    return angle[:, None], reading + rng.normal(scale=NOISE, size=400)


@pytest.mark.parametrize("part", [0.3, 0.5, 0.7])
def test_the_planes_of_a_corner_are_found(part):
    across, reading = corner(part, np.random.default_rng(0))
    planes = planes_in(KINDS["scanner"], (across, reading))
    assert len(planes) == 2
    # 1 / range = q . (cos, sin), with q the foot of the plane over its squared distance.
    found = sorted((one.shape for one in planes), key=lambda q: q[1])
    np.testing.assert_allclose(found, [[1.0, 0.0], [0.0, 1.0]], atol=6.0 * NOISE)
    assert sum(one.kept.sum() for one in planes) > 0.95 * len(reading)
    assert not (planes[0].kept & planes[1].kept).any()


def test_rounding_makes_no_more_planes():
    across, reading = corner(0.5, np.random.default_rng(0))
    assert len(planes_in(KINDS["scanner"], (across, np.round(reading, 2)))) == 2


def test_an_arc_is_no_planes_although_short_pieces_of_it_look_flat():
    angle, rng = np.linspace(-0.3, 0.3, 300), np.random.default_rng(1)
    aside = 0.5 * np.sin(angle)
    reading = 0.5 * np.cos(angle) - np.sqrt(0.16**2 - aside**2) + rng.normal(scale=1e-4, size=300)
    assert planes_in(KINDS["scanner"], (angle[:, None], reading)) == []


def test_noise_inside_shots_is_what_the_points_say_that_count_in_the_end():
    """A scan of which most points are on another wall says nothing of the noise of the right one."""
    rng, count = np.random.default_rng(0), 12
    parts = [0.3 if i % 4 == 0 else 0.7 for i in range(count)]  # of the wall x = 1
    angle, reading = (
        np.concatenate(some) for some in zip(*(corner(p, rng) for p in parts), strict=True)
    )
    scan = hl.Shots.scanner("scan", np.repeat(np.arange(count), 400), angle[:, 0], reading)
    R, t = np.broadcast_to(np.eye(3), (count, 3, 3)), np.zeros((count, 3))
    t[:, 1] = 0.1 * np.arange(count)  # along the wall
    rows = rows_of(hl.Survey(hl.StationList(R, t, ("plane:wall",) * count), (scan,)))
    mixed = [replace(item, shot=grown(item.shot, 40.0, 1.0)) for item in rows.items]
    state = state_of(replace(rows, items=tuple(mixed)), hl.Noise())
    sensor, wall = [*np.eye(3).ravel(), *np.zeros(7)], [1.0, 0.0, 0.0, -1.0, 0.0, 0.0, 0.0]
    state.values = {
        "pose": rows.poses(),
        "sensor": np.array([[sensor]]),
        "plane": np.array([[wall]]),
    }
    assert other_planes_taken(state, GROSS, {})
    assert (state.misfits() < GROSS).all()
    assert {item.growth for item in state.rows.items} == {1.0}
    ahead = with_planes_ahead(replace(rows, items=tuple(mixed)))
    assert {item.growth for item in ahead.items} == {1.0}


def test_a_false_angle_is_blamed_where_a_search_has_turned_a_plane_round(monkeypatch):
    """Readings do not tell a plane from itself the other way round, which 180 degrees less fits.

    A quick start without relations, which needs steps to the minimum before it fits, tells it.
    """
    exact = hl.Noise(pose_translation_sigma=1e-5, pose_rotation_sigma=1e-5)
    rig = rigs_by_rays.profiler(3, planes=2, stations=12, hand_sigma=(1e-5, 1e-5))
    rows = rows_of(survey_of(rig), exact)
    state = first_state(rows, exact)
    assert state.minimize()
    rough = {name: x.copy() for name, x in state.values.items()}
    rough["plane"][..., 3] += 0.002
    monkeypatch.setattr(estimation, "start_of", lambda *_, **__: (dict(rough), ()))
    planes = state.values["plane"][0]
    angle = float(np.arccos(-planes[0, :3] @ planes[1, :3]))
    known = hl.Known("angle", rows.targets["plane"], value=angle, sigma_angle=1e-4)
    planes[0, :4] *= -1.0
    fitted = replace(state, rows=replace(rows, known=(known,)))
    free = _freed_of_false_relations(fitted, settled=False)
    assert free
    assert first_fit(free).fits
    assert not first_fit(fitted).fits  # which the false relation draws away


@pytest.mark.slow
@pytest.mark.parametrize("scene", ["room", "small plates on a table", "small plates before a wall"])
def test_the_plane_of_the_label_needs_not_fill_most_of_the_view(scene):
    """What all shots agree on tells which of the walls, or of plate and table, is meant."""
    rig = rigs_by_scene.scanner(1, scene=scene, hand_sigma=(5e-5, 1e-4))
    share = np.median(rig.truth["share"])
    found = hl.calibrate(survey_of(rig))
    assert share < 0.5
    assert found.usable
    ((error, C),) = errors_of(rig, found)
    assert (np.abs(error) < FAR * np.sqrt(np.diagonal(C))).all()


@pytest.mark.slow
@pytest.mark.parametrize("seed", [2, 4, 16])
def test_wrong_labels_do_no_harm_where_a_scan_sees_several_walls(seed):
    """Where the wall that is named is in view it counts, and else the shot is rejected.

    Rays of the first and the last graze the wall that is named: one such shot came back, as what it
    alone decides agrees with anything, and another moved the sensor by 4 m. Parts of the second have to
    begin with the planes as they were read.
    """
    rig = rigs_by_scene.scanner(seed, scene="room", hand_sigma=(5e-5, 1e-4))
    survey = survey_of(rig)
    labels = np.array(survey.stations.plane_labels, dtype=object)
    wrong = [int(np.flatnonzero(labels == name)[0]) for name in np.unique(labels)]
    labels[wrong] = labels[np.roll(wrong, 1)]
    stations = replace(survey.stations, plane_labels=tuple(labels))
    found = hl.calibrate(replace(survey, stations=stations))
    assert found.usable
    ((error, C),) = errors_of(rig, found)
    assert (np.abs(error) < FAR * np.sqrt(np.diagonal(C))).all()


@pytest.mark.slow
def test_a_false_relation_is_named_beside_shots_that_come_back():
    """Shots that were lost count again where relations are left out; then there are more of them."""
    survey = survey_of(rigs_by_scene.scanner(1, scene="room", hand_sigma=(5e-5, 1e-4)))
    begun, found = rows_of(survey), hl.calibrate(survey)._found
    ended = {item.station: item.points for item in found.rows.items}
    right = [i.station for i in begun.items if np.isin(i.points, ended[i.station]).mean() > 0.5]
    back = [station for _, station in begun.lost if station in ended]
    assert back
    stations = survey.stations.plane_labels
    some = survey.part(np.isin(np.arange(len(stations)), [*right, *back[:2]]))
    walls = ("plane:west", "plane:south")
    known = hl.Known("angle", walls, value=np.radians(85.0), sigma_angle=np.radians(1e-3))
    tied = hl.calibrate(replace(some, known=(known,)))
    assert [one.code for one in tied.warnings] == ["relation-contradicted"]
