"""Sessions with systematic errors as unknowns: after every change a batch calibration of the same."""

import pickle
from dataclasses import replace

import numpy as np
import pytest
from test_freed import NOISE, SENSOR, SIZES, recorded, state
from test_systematic import Scene

import handlaser_gtsam as hl


def options(*free, **others):
    """Return options with errors that are unknowns."""
    return hl.CalibrationOptions(free=free, sensor=SENSOR, **others)


def begun(code, size, *free, seed=3, **others):
    """Return a session of the first two planes, and the parts of the others by plane."""
    recording = recorded(Scene(seed), 0, code, size)
    session = hl.Session(NOISE, options(*free, **others))
    names = recording.plane_names
    session.add(hl.join([recording.plane(name) for name in names[:2]]))
    return session, [recording.plane(name) for name in names[2:]]


def assert_batch(session):
    """Hold that beams, planes, sizes and their sigmas are those of a calibration of what it has."""
    found, recording = session.calibration(), session.state.contents.recording()
    inside = np.isin(recording.plane_labels, session.planes)
    batch = hl.calibrate(recording.part(inside), session.noise, session.options)
    assert found.status == batch.status == "converged"
    assert {(one.station, one.sensor) for one in session.rejected} == {
        (one.station, one.sensor) for one in batch.fit.rejected
    }
    for own, other in zip(found.beams.values(), batch.beams.values(), strict=True):
        seen = other.sigma > 0.0
        # The demand: a millionth of a standard deviation.
        assert (np.abs(own.coordinates - other.coordinates)[seen] < 1e-6 * other.sigma[seen]).all()
        assert own.sigma == pytest.approx(other.sigma, rel=1e-6)
    assert [one.subject for one in found.effects] == [one.subject for one in batch.effects]
    for own, other in zip(found.effects, batch.effects, strict=True):
        assert abs(own.size - other.size) < 1e-6 * other.sigma
    beams = session.beams()
    assert np.array_equal(beams.sigma, [found.beams[name].sigma for name in beams.names])


@pytest.mark.slow
@pytest.mark.parametrize("code", ["incidence", "beam-on-plane", "displaced", "turn-scale"])
def test_every_error_is_found_plane_by_plane_as_at_once(code):
    session, rest = begun(code, SIZES[code], code, range_error="none")
    for part in rest:
        update = session.add(part)
        assert update.targets == part.plane_names
        assert update.information > 0.0
        assert_batch(session)
    assert update.moved is None
    assert session.compare().largest < 1e-6
    assert {one.code for one in session.calibration().effects} == {code}


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
def test_random_sequences_are_the_batch_after_every_step(seed):
    """Planes and stations come and go in any order, and spoiled readings are rejected."""
    rng = np.random.default_rng(seed)
    free, range_error = [
        (("lag",), "none"),
        (("incidence", "drift"), "auto"),
        (("tool-displaced", "cubic"), "k1"),
        (("lag", "carry-over", "sag"), "none"),
    ][seed]
    session, _ = begun(free[0], SIZES[free[0]], *free, seed=seed, range_error=range_error)
    whole = recorded(Scene(seed), 0, free[0], SIZES[free[0]])
    known = set(session.recording().station_names)
    fresh = [j for j, name in enumerate(whole.station_names) if name not in known]
    for _ in range(5):
        action = rng.choice(["add", "spoiled", "remove plane", "remove station", "recalibrate"])
        before = session.calibration()
        try:
            if action in ("add", "spoiled") and fresh:
                part = whole.part(sorted(fresh[:3]))
                ranges = part.ranges.copy()
                if action == "spoiled":
                    ranges[0, 0] += 0.02
                session.add(replace(part, ranges=ranges))
                del fresh[:3]
            elif action == "remove plane":
                session.remove_plane(str(rng.choice(session.planes)))
            elif action == "remove station":
                session.remove_station(str(rng.choice(session.recording().station_names)))
            elif action == "recalibrate":
                assert session.recalibrate().largest < 1e-6
        except hl.InputError:
            assert session.calibration() == before
            continue
        assert_batch(session)


@pytest.mark.slow
def test_drifts_go_by_the_order_in_which_stations_came():
    """Stations of a known plane that come later are later, whichever plane is theirs."""
    scene = Scene(3)
    recording = recorded(scene, 0, "drift", 1e-3)
    assert len(set(recording.plane_labels[:4])) > 1
    session = hl.Session(NOISE, options("drift", range_error="none"))
    for part in np.array_split(np.arange(len(recording.plane_labels)), 3):
        session.add(recording.part(part))
    assert session.recording() == recording
    batch = hl.calibrate(recording, NOISE, session.options)
    assert np.abs(state(session.calibration()) - state(batch)).max() < 1e-12
    assert abs(batch.effects[0].size - 1e-3) < 4.0 * batch.effects[0].sigma


@pytest.mark.slow
def test_a_plane_that_is_not_determined_or_does_not_fit_waits():
    session, (third, fourth) = begun("lag", SIZES["lag"], "lag", range_error="none")
    one = np.arange(third.ranges.size).reshape(third.ranges.shape) == 0
    update = session.add(third.without(~one).part([0]))  # one reading determines no plane
    assert update.waiting == third.plane_names
    assert update.targets == ()
    assert_batch(session)
    scene, rng = Scene(3), np.random.default_rng(0)
    ranges, names = rng.uniform(0.2, 0.6, (len(scene.R), 3)), [f"w{j}" for j in range(len(scene.R))]
    labels = ["wrong"] * len(names)
    wrong = hl.Recording(scene.R, scene.t, ranges, labels, ("b0", "b1", "b2"), names)
    update = session.add(hl.join([wrong, fourth]))  # more readings than of all others
    assert update.inconsistent == ("wrong", *fourth.plane_names)
    assert session.waiting == (*third.plane_names, *update.inconsistent)
    assert_batch(session)
    (change,) = session.recalibrate().changes
    assert change == "not-converged"
    assert_batch(session)
    session.remove_plane("wrong")
    (change,) = session.recalibrate().changes
    assert change == "excluded-planes"
    assert session.waiting == third.plane_names
    assert_batch(session)


@pytest.mark.slow
def test_a_beam_that_was_displaced_is_named_beside_the_error():
    recording = recorded(Scene(3), 0, "incidence", 1e-3)
    names = recording.plane_names
    ranges = recording.ranges.copy()
    ranges[recording.plane_of_station == 3, 1] += 1e-3
    session = hl.Session(NOISE, options("incidence", range_error="none", outliers="keep"))
    session.add(hl.join([recording.plane(name) for name in names[:3]]))
    update = session.add(replace(recording, ranges=ranges).plane(names[3]))
    assert update.moved is not None
    assert (update.moved.name, update.moved.since) == ("b1", names[3])
    assert session.moved().name == "b1"
    session.split_beam("b1", names[3])
    assert session.moved() is None
    assert list(session.calibration().beams) == ["b0", "b1", "b2", f"b1 until {names[3]}"]
    assert session.recording().beam_names == ("b0", "b1", "b2")
    assert_batch(session)


@pytest.mark.slow
def test_copies_and_what_is_raised_on_the_way_change_nothing(monkeypatch):
    session, rest = begun("lag", SIZES["lag"], "lag", range_error="none")
    copy = pickle.loads(pickle.dumps(session))
    before = session.calibration()
    with monkeypatch.context() as patch:
        patch.setattr(
            "handlaser_gtsam.session.freed.calibrate_from",
            lambda *_: replace(before, status="not_converged", interrupted=True),
        )
        with pytest.raises(KeyboardInterrupt):
            session.add(rest[0])
    assert session.calibration() == before
    assert rest[0].plane_names[0] not in session.recording().plane_names
    for one in (session, copy):
        one.add(rest[0])
        assert_batch(one)
    readings, at = session.estimate()
    residuals = hl.model.residuals(hl.model.scene(at, readings), readings.distance)
    assert np.sqrt(np.mean(residuals**2)) < 2e-4


@pytest.mark.slow
def test_what_cannot_be_an_unknown_of_a_session_is_refused_at_once():
    with pytest.raises(hl.InputError, match="no plausible size"):
        hl.Session(NOISE, hl.CalibrationOptions(free=("incidence",)))
    session = hl.Session(NOISE, options("beam-on-plane"))
    recording = recorded(Scene(3))
    update = session.add(recording.plane("p0"))  # no beam sees two planes yet
    assert update.message
    assert not session.started
    session.add(hl.join([recording.plane(name) for name in ("p1", "p2", "p3")]))
    assert_batch(session)


@pytest.mark.slow
def test_the_command_says_what_every_plane_taught_beside_the_error(tmp_path, handlaser, refusal):
    path, rig, out = tmp_path / "r.csv", tmp_path / "rig.toml", tmp_path / "c.json"
    recording = recorded(Scene(3), 0, "lag", SIZES["lag"])
    hl.write_recording(path, recording)
    rig.write_text(
        "[noise]\nrange_sigma_mm = 0.1\npose_translation_sigma_mm = 0\npose_rotation_sigma_deg = 0\n"
        '[sensor]\nkind = "triangulation"\n'
    )
    one_by_one = ("calibrate", path, "--rig", rig, "--incremental", "--range-error", "none")
    code, text, err = handlaser(*one_by_one, "--free", "lag", "--out", out)
    assert code == 0, err
    assert "plane by plane and all at once agree to" in text
    (lag,) = hl.read_calibration(out).effects
    batch = hl.calibrate(recording, NOISE, options("lag", range_error="none")).effects[0]
    assert abs(lag.size - batch.size) < 1e-6 * batch.sigma
    assert "--free drift plane by plane" in refusal(*one_by_one, "--free", "lag,drift")
