"""Copies of a session: pickled or deep, they answer alike and go on by themselves."""

import copy
import math
import pickle
from dataclasses import replace

import numpy as np
import pytest
from test_drift import NOISE, displaced
from test_session import EXACT, NONE, ROBOT, assert_batch, filled, plane, recorded

import handlaser_gtsam as hl

CASES = {
    "exact": (EXACT, NONE, (0.0, 0.0)),
    "estimated": (ROBOT, replace(NONE, poses="estimated"), (0.0, 0.0)),
    "unknown": (hl.Noise(), hl.CalibrationOptions(), (0.02, 0.3)),
}


def by_pickle(session):
    return pickle.loads(pickle.dumps(session))


def assert_alike(one, other):
    """Alike to rounding: GTSAM eliminates the same linear system in another order."""
    assert one.planes == other.planes
    assert one.waiting == other.waiting
    assert one.rejected == other.rejected
    a, b = one.calibration(), other.calibration()
    assert a.status == b.status
    assert [w.code for w in a.warnings] == [w.code for w in b.warnings]
    for name, beam in a.beams.items():
        sigma = np.where(beam.sigma > 0.0, beam.sigma, 1.0)
        for x, y in (
            (beam.location, b.beams[name].location),
            (beam.direction, b.beams[name].direction),
        ):
            assert (np.abs(x - y) < 1e-6 * sigma[:3].max()).all()
        assert b.beams[name].sigma == pytest.approx(beam.sigma, rel=1e-6)
    for name, own in a.planes.items():
        assert abs(own.offset - b.planes[name].offset) < 1e-5 * own.offset_sigma
    assert b.fit.chi2 == pytest.approx(a.fit.chi2, rel=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("case", "copied"),
    [("exact", copy.deepcopy), ("estimated", by_pickle), ("unknown", copy.deepcopy)],
)
def test_a_copy_gives_the_same_answers_and_goes_on(case, copied):
    noise, options, k = CASES[case]
    recording = recorded(7, beams=2, noise=ROBOT if case == "estimated" else EXACT, k=k)
    session = filled(recording.part(recording.plane_of_station < 5), noise, options)
    other = copied(session)
    assert np.array_equal(other.beams().covariance, session.beams().covariance)
    assert np.array_equal(other.beams().locations, session.beams().locations)
    assert_alike(session, other)
    before = session.beams()
    other.add(plane(recording, 5))
    assert np.array_equal(session.beams().locations, before.locations)
    session.add(plane(recording, 5))
    for one in (session, other):
        one.remove_plane("B")
    assert_alike(session, other)
    assert_batch(other)


@pytest.mark.parametrize("copied", [copy.deepcopy, by_pickle])
def test_a_session_from_which_something_was_taken_can_be_copied(copied):
    recording = recorded(5, beams=2, noise=EXACT)
    session = filled(recording, EXACT, NONE)
    session.remove_plane("B")
    assert_alike(session, copied(session))
    session.remove_station(session.recording().station_names[3])
    session.compare()
    assert_alike(session, copied(session))


@pytest.mark.slow
def test_a_copy_knows_what_was_rejected_and_what_was_split():
    recording, _ = displaced(planes=8, turn=math.radians(0.3))
    ranges = recording.ranges.copy()
    ranges[50, 0] += 0.02
    session = filled(replace(recording, ranges=ranges), NOISE, NONE)
    assert session.rejected
    assert by_pickle(session).moved().since == session.moved().since == "G"
    session.split_beam("2", "G")
    other = by_pickle(session)
    assert_alike(session, other)
    assert list(other.calibration().beams) == ["1", "2", "3", "2 until G"]
    with pytest.raises(hl.InputError, match="every move once"):
        other.split_beam("2", "G")
    assert_batch(other)


def test_a_session_without_calibration_can_be_copied():
    recording = recorded(3)
    session = hl.Session(EXACT, NONE)
    assert not session.started
    session.add(plane(recording, 0, slice(0, 2)))
    other = by_pickle(session)
    assert other.waiting == session.waiting == ("A",)
    assert other.noise == EXACT
    other.add(hl.join([plane(recording, 1), plane(recording, 2)]))
    assert other.started
    assert not session.started
