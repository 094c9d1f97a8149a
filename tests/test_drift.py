"""Which beam has moved, and since when; and going on without throwing anything away."""

import math
from dataclasses import replace
from itertools import accumulate

import numpy as np
import pytest
from helpers import first_and_slow, simulated

import handlaser_gtsam as hl
from benchmarks import drift
from benchmarks.drift import CASES, run_once
from handlaser_gtsam import model
from handlaser_gtsam.estimation.scale_mixture import parts_of
from handlaser_gtsam.session import moved_beam, state
from handlaser_gtsam.validation.scenes import SCENES, Layout
from handlaser_gtsam.validation.simulate import Errors, simulate

SIGMA, TURN = 1e-4, math.radians(0.3)
NOISE, NONE = hl.Noise(SIGMA, 0.0, 0.0), hl.CalibrationOptions("none")


def displaced(planes=10, before=6, beams=3, beam=1, turn=TURN, seed=3, stations=9):
    """Return a recording in which a beam turns before a plane, and the truth after it."""
    rng = np.random.default_rng(seed)
    truth, where = SCENES["arm"](Layout(beams, planes, stations), rng)
    v = truth.directions.copy()
    across = model.tangent_basis(v)[beam, :, 0]
    v[beam] = math.cos(turn) * v[beam] + math.sin(turn) * across
    later = replace(truth, directions=v)
    early, late = (simulate(one, where, Errors(SIGMA), rng) for one in (truth, later))
    rows = [np.flatnonzero(early.plane_of_station < before)]
    rows.append(np.flatnonzero(early.plane_of_station >= before))
    return hl.join([early.part(rows[0]), late.part(rows[1])]), later


def plane(recording, index):
    return recording.part(np.flatnonzero(recording.plane_of_station == index))


def fed(recording, noise=NOISE, options=NONE, stop=None):
    session, updates = hl.Session(noise, options), []
    for index in range(stop or len(recording.plane_names)):
        updates.append(session.add(plane(recording, index)))
    return session, updates


@pytest.mark.slow
@pytest.mark.parametrize("beam", [0, 2])
def test_a_turned_beam_is_named_at_once_and_ever_after(beam):
    recording, _ = displaced(beam=beam)
    session, updates = fed(recording)
    assert all(update.moved is None for update in updates[:6])
    for update in updates[6:]:
        assert (update.moved.name, update.moved.since) == (str(beam + 1), "G")
        assert update.rejected == ()
    moved = session.moved()
    assert moved.p_value < 1e-20
    assert math.degrees(moved.turn) == pytest.approx(0.3, abs=0.05)
    assert np.abs(moved.shift).max() < 1e-3


def test_what_nothing_has_moved_is_quiet():
    session, updates = fed(displaced(turn=0.0)[0])
    assert all(update.moved is None for update in updates)
    assert session.moved() is None


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_study_of_drift(case, monkeypatch):
    """One run with and one without a change of what `benchmarks.drift` counts, of twelve planes."""
    monkeypatch.setattr(drift, "PLANES", 12)
    monkeypatch.setattr(drift, "BEFORE", 6)
    assert run_once(case, TURN, "arm", 1)[0]
    assert not run_once(case, 0.0, "arm", 101)[3]


@pytest.mark.slow
def test_the_statistic_is_the_fall_of_chi2():
    """Against two batch solutions: one beam for all planes, and another one from an epoch on."""
    recording, _ = displaced(turn=math.radians(0.08), planes=8, before=5)
    session, _ = fed(recording, options=hl.CalibrationOptions("none", outliers="keep"))
    state = session.state
    pieces = [fitted.information[0] for fitted in state.contents.consistent.values()]
    names = [f"{i + 1}" for i in range(3)]
    early, late = (
        np.flatnonzero((recording.plane_of_station < 5) == side) for side in (True, False)
    )
    split = hl.join([recording.part(early).renamed("2", "2 before"), recording.part(late)])
    keep = hl.CalibrationOptions("none", outliers="keep")
    one, two = (hl.calibrate(r, NOISE, keep).fit.chi2 for r in (recording, split))
    M, s = _scores(pieces, 5)
    own = moved_beam.moves(state.config)[names.index("2")]
    statistic = s[own] @ np.linalg.solve(M[np.ix_(own, own)], s[own])
    assert one - two > 20.0
    assert statistic == pytest.approx(one - two, rel=5e-3)  # the model is not quite linear


def _scores(pieces, epoch):
    totals = list(accumulate(pieces))
    matrix, vector, _ = parts_of(totals[-1])
    T = np.linalg.inv(matrix)
    late, late_vector, _ = parts_of(totals[-1] - totals[epoch - 1])
    return late - late @ T @ late, late_vector - late @ (T @ vector)


@pytest.mark.slow
def test_forgetting_recalibrates_the_beam_and_keeps_the_planes():
    recording, truth = displaced(planes=12)
    session, _ = fed(recording, stop=7)
    assert session.moved().name == "2"
    session.split_beam("2", since="G")
    assert session.planes == tuple("ABCDEFG")
    assert session.moved() is None
    wide = session.beams()
    for index in range(7, 12):
        update = session.add(plane(recording, index))
        assert update.moved is None
        assert session.compare().largest < 0.01
        assert session.compare().largest_sigma < 0.01
    beams = session.beams()
    assert beams.names == ("1", "2", "3")
    sigma, before = (np.sqrt(np.diagonal(one.covariance)).reshape(3, 8) for one in (beams, wide))
    assert (sigma[1, :6] < 0.7 * before[1, :6]).all()
    error = np.hstack((beams.locations - truth.locations, beams.directions - truth.directions))
    assert (np.abs(error) < 4.0 * sigma[:, :6]).all()
    result = session.calibration()
    assert list(result.beams) == ["1", "2", "3", "2 until G"]
    turned = np.arccos(result.beams["2"].direction @ result.beams["2 until G"].direction)
    assert math.degrees(turned) == pytest.approx(0.3, abs=0.1)
    assert session.recording().beam_names == ("1", "2", "3")
    assert np.array_equal(np.sort(session.recording().ranges), np.sort(recording.ranges))


@pytest.mark.parametrize("options", first_and_slow(NONE, hl.CalibrationOptions()))
def test_a_split_is_the_calibration_of_one_beam_more(options):
    """What the session holds after a split, and planes that came after it, is that of `calibrate`."""
    recording, _ = displaced()
    session, _ = fed(recording, options=options, stop=8)
    session.split_beam("2", "G")
    for index in (8, 9):
        session.add(plane(recording, index))
    early, late = (
        np.flatnonzero((recording.plane_of_station < 6) == side) for side in (True, False)
    )
    split = hl.join([recording.part(early).renamed("2", "2 until G"), recording.part(late)])
    alone, found = hl.calibrate(split, NOISE, options), session.recalibrate()
    assert found.largest < 0.01
    assert found.largest_sigma < 0.01
    own = session.calibration()
    assert set(own.beams) == set(alone.beams)
    for name, beam in alone.beams.items():
        assert (np.abs(own.beams[name].location - beam.location) < 0.01 * beam.sigma[:3]).all()
        assert own.beams[name].sigma == pytest.approx(beam.sigma, rel=0.01)
    assert session.recording() == recording


def test_the_states_of_a_beam_are_no_channel_logged_twice():
    """They lie in one place, and never read at one station."""
    recording, _ = displaced(planes=6, before=3)
    session, _ = fed(recording, stop=4)
    session.split_beam("2", "D")
    session.add(plane(recording, 4))
    result = session.calibration()
    assert "column-twice" not in [one.code for one in result.warnings]
    assert result.verdict.usable


@pytest.mark.slow
def test_a_beam_may_be_displaced_twice():
    recording, _ = displaced(planes=12, before=4)
    session, _ = fed(recording)
    session.split_beam("2", "E")
    session.split_beam("2", "I")
    assert session.compare().largest < 0.01
    assert list(session.calibration().beams) == ["1", "2", "3", "2 until E", "2 until I"]
    assert session.beams().names == ("1", "2", "3")


@pytest.mark.slow
def test_what_cannot_be_forgotten_is_refused():
    session, _ = fed(displaced()[0])
    with pytest.raises(hl.InputError, match="beam 'x'"):
        session.split_beam("x", "G")
    with pytest.raises(hl.InputError, match="before plane 'A'"):
        session.split_beam("2", "A")
    with pytest.raises(hl.InputError, match="unknown plane 'x'; expected one of A, B, "):
        session.split_beam("2", "x")
    blind = np.zeros(session.recording().ranges.shape, dtype=bool)
    blind[:, 1] = displaced()[0].plane_of_station > 4
    unseen, _ = fed(displaced()[0].without(blind))
    with pytest.raises(hl.InputError, match="on one side of plane G"):
        unseen.split_beam("2", "G")
    assert unseen.beams().names == ("1", "2", "3")
    session.split_beam("2", "G")
    with pytest.raises(hl.InputError, match="every move once"):
        session.split_beam("2", "G")
    with pytest.raises(hl.InputError, match="beam '2 until G'"):
        session.split_beam("2 until G", "C")
    assert session.compare().largest < 0.01


@pytest.mark.slow
@pytest.mark.parametrize("seed", [8, 10])
def test_gross_errors_among_the_first_planes_are_no_move(seed):
    """They led to wrong beams, beside which another beam seemed to have moved, to the end."""
    recording, truth = displaced(planes=4, before=2, turn=0.0, seed=seed, stations=8)
    rng, ranges = np.random.default_rng(seed), recording.ranges.copy()
    early = np.argwhere(~np.isnan(ranges) & (recording.plane_of_station < 2)[:, None])
    wrong = [tuple(at) for at in early[rng.choice(len(early), 3, replace=False)]]
    for at in wrong:
        ranges[at] += rng.choice([-1, 1]) * rng.uniform(5e-3, 3e-2)
    session, updates = fed(replace(recording, ranges=ranges), NOISE, hl.CalibrationOptions())
    assert all(update.moved is None for update in updates)
    assert {(one.station, one.sensor) for one in session.rejected} == {
        (recording.station_names[j], recording.beam_names[i]) for j, i in wrong
    }
    beams = session.beams()
    assert (np.abs(beams.locations - truth.locations) < 4.5 * beams.sigma[:, :3]).all()


def test_new_garbage_is_left_out_and_a_plane_of_nothing_else_is_doubted():
    recording, _ = displaced(turn=0.0)
    session, _ = fed(recording, stop=8)
    ranges = recording.ranges.copy()
    rows = np.flatnonzero(recording.plane_of_station == 8)
    ranges[rows[1], 0] += 0.02
    ranges[rows[4], 2] -= 0.005
    bad = replace(recording, ranges=ranges)
    update = session.add(plane(bad, 8))
    assert {(one.station, one.sensor) for one in update.rejected} == {
        (recording.station_names[rows[1]], "1"),
        (recording.station_names[rows[4]], "3"),
    }
    assert update.moved is None
    assert session.compare().largest < 0.01
    listed = {(one.station, one.sensor) for one in session.calibration().fit.rejected}
    assert listed == {(one.station, one.sensor) for one in session.rejected}
    rows = np.flatnonzero(recording.plane_of_station == 9)
    ranges[rows] += 0.01 * np.random.default_rng(1).normal(size=(len(rows), 3))
    update = session.add(plane(replace(recording, ranges=ranges), 9))
    assert update.inconsistent == update.waiting == ("J",)
    assert update.targets == ()
    assert update.moved is None
    assert session.compare().largest < 0.01


@pytest.mark.slow
def test_a_plane_that_was_itself_moved_does_no_harm():
    """Shifted by a centimetre in the middle of its stations: it waits, and later planes are as ever."""
    recording, truth = displaced(planes=12, turn=0.0)
    ranges = recording.ranges.copy()
    rows = np.flatnonzero(recording.plane_of_station == 6)
    ranges[rows[5:]] += 0.01
    session, updates = fed(replace(recording, ranges=ranges))
    assert updates[6].inconsistent == ("G",)
    assert all(update.moved is None for update in updates)
    assert session.rejected == ()
    assert session.waiting == ("G",)
    beams = session.beams()
    sigma = np.sqrt(np.diagonal(beams.covariance)).reshape(3, 8)[:, :3]
    assert (np.abs(beams.locations - truth.locations) < 4.5 * sigma).all()
    keep, _ = fed(replace(recording, ranges=ranges), options=hl.CalibrationOptions("none", "keep"))
    assert keep.waiting == ()
    assert keep.compare().largest < 0.01


@pytest.mark.slow
@pytest.mark.parametrize("degrees", [1.0, 5.0, 12.0, 30.0])
def test_a_large_displacement_is_named_too(degrees):
    recording, truth = displaced(turn=math.radians(degrees))
    session, updates = fed(recording)
    for update in updates[6:]:
        assert (update.moved.name, update.moved.since) == ("2", "G")
    session.split_beam("2", "G")
    session.recalibrate()
    beams = session.beams()
    assert session.compare().largest < 0.01
    sigma = np.sqrt(np.diagonal(beams.covariance)).reshape(3, 8)[1, 3:6]
    assert (np.abs(beams.directions[1] - truth.directions[1]) < 5.0 * sigma).all()


@pytest.mark.slow
@pytest.mark.parametrize("degrees", [5.0, 10.0])
def test_a_large_displacement_of_one_beam_of_five_is_no_gross_error(degrees):
    """Its readings are few enough of a plane to be thrown away one by one."""
    turn = math.radians(degrees)
    _, updates = fed(displaced(beams=5, planes=8, before=5, turn=turn)[0])
    for update in updates[5:]:
        assert (update.moved.name, update.moved.since) == ("2", "F")


@pytest.mark.slow
@pytest.mark.parametrize("seed", [2, 10])
def test_beams_that_are_poorly_known_at_first_have_not_moved(seed):
    """One plane leaves sixteen beams some degrees off: what it says of them has to follow them."""
    recording, _ = simulated(layout=Layout(16, 4, 16), seed=seed)
    session, updates = fed(recording, hl.Noise(3e-5, 0.0, 0.0))
    assert len(session.planes) == 4
    assert all(update.moved is None for update in updates)


@pytest.mark.slow
@pytest.mark.parametrize("gone", ["ABC", "DEFGHIJ"])
def test_the_planes_of_one_side_of_a_move_stay(gone):
    session, _ = fed(displaced(before=3)[0])
    session.split_beam("2", "D")
    refused = 0
    for name in gone:
        try:
            session.remove_plane(name)
        except hl.InputError:
            refused += 1
        assert session.compare().largest < 0.01
    assert refused
    assert list(session.calibration().beams) == ["1", "2", "3", "2 until D"]


def test_an_estimate_that_moves_far_is_compared_at_once(monkeypatch):
    monkeypatch.setattr(state, "LEAST_CHANGES", 99)
    recording, _ = displaced(planes=6, before=5, turn=math.radians(3.0))
    options = hl.CalibrationOptions("none", outliers="keep")
    session = hl.Session(NOISE, options)
    session.add(recording.part(np.flatnonzero(recording.plane_of_station < 4)))
    assert session.add(plane(recording, 4)).comparison is None
    comparison = session.add(plane(recording, 5)).comparison
    assert comparison is not None
    assert comparison.largest < 0.01


@pytest.mark.slow
@pytest.mark.parametrize("degrees", [20.0, 45.0])
def test_a_far_move_that_was_told_raises_no_alarm(degrees):
    """What was assumed of the move is no sign of another, and no start is near enough."""
    recording, truth = displaced(planes=9, turn=math.radians(degrees), stations=10)
    session, _ = fed(recording, stop=7)
    session.split_beam("2", "G")
    for index in (7, 8):
        assert session.add(plane(recording, index)).moved is None
    assert session.waiting == ()
    assert session.compare().largest < 0.01
    sigma = session.beams().sigma[1, 3:6]
    assert (np.abs(session.beams().directions[1] - truth.directions[1]) < 5.0 * sigma + 2e-3).all()


@pytest.mark.slow
def test_a_calibration_that_began_wrongly_is_begun_anew():
    """From the study: a first plane that left good readings out, and one that chose too few terms."""
    assert run_once(CASES[2], TURN, "arm", 17)[:3] == (True, True, True)
    assert not run_once(CASES[3], 0.0, "arm", 144)[3]
