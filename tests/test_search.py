"""One search: how much of it runs, by counts of its rounds, and what a file that fits nothing gives."""

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
from helpers import GRIPPER, bench, motion, recording_of, simulated

import handlaser_gtsam as hl
from handlaser_gtsam import model
from handlaser_gtsam.model import damped_search as damped
from handlaser_gtsam.model.block import Rows, Slot, Weights
from handlaser_gtsam.model.reduction import reduction_of
from handlaser_gtsam.model.targets.point import POINT
from handlaser_gtsam.observability.rank import observability
from handlaser_gtsam.outliers import consensus
from handlaser_gtsam.outliers.reading_tests import leverages, price
from handlaser_gtsam.results import rereading
from handlaser_gtsam.solvers.beam_problem import Candidate
from handlaser_gtsam.starts import choice, robust
from handlaser_gtsam.starts.growing import excerpt_of
from handlaser_gtsam.starts.rounds import Round, search
from handlaser_gtsam.validation.scenes import Layout

NOISE = hl.Noise(3e-5, 0.0, 0.0)


@pytest.fixture
def counts(monkeypatch):
    """Count the rounds of candidates and the steps of their refinements."""
    found = {"plain": 0, "robust": 0, "steps": 0}

    def counted(kind, function):
        def refined(*arguments):
            found[kind] += 1
            return function(*arguments)

        return refined

    def stepped(*arguments):
        found["steps"] += 1
        return step(*arguments)

    step = damped.damped_step
    monkeypatch.setattr(damped, "damped_step", stepped)
    for kind, module in (("plain", choice), ("robust", robust)):
        refined_starts = counted(kind, module.refined_starts)
        monkeypatch.setattr(module, "refined_starts", refined_starts)
    return found


@pytest.mark.parametrize("size", [1e-3, 1e-2, 1e-1])
@pytest.mark.parametrize("rows", [((5, 1), (20, 1)), ((5, 1), (20, 3)), ((12, 1), (12, 2))])
def test_two_spoilt_readings_need_neither_sweeps_nor_a_robust_search(counts, size, rows):
    recording = hl.read_recording(GRIPPER / "recording.csv")
    ranges = recording.ranges.copy()
    for row in rows:
        ranges[row] += size
    found = hl.calibrate(replace(recording, ranges=ranges), NOISE)
    assert counts["robust"] == 0
    assert counts["plain"] == 1
    # Of one candidate at a time: the start, a screening of at most 20 rounds and a test after the
    # solution. Sweeps and a robust search took as many steps, of a dozen candidates at a time.
    assert counts["steps"] < 200
    assert found.status == "converged"
    rejected = {(r.station, r.sensor) for r in found.fit.rejected}
    assert rejected == {(str(j + 1), str(i + 1)) for j, i in rows}


def test_without_a_range_sigma_several_starts_must_agree_before_the_screening_counts(counts):
    recording = hl.read_recording(GRIPPER / "recording.csv")
    ranges = recording.ranges.copy()
    ranges[5, 1] += 0.01
    ranges[20, 3] += 0.01
    found = hl.calibrate(replace(recording, ranges=ranges))
    assert counts["robust"] == 0
    assert counts["plain"] == 2
    assert {(r.station, r.sensor) for r in found.fit.rejected} == {("6", "2"), ("21", "4")}


@pytest.mark.slow
def test_a_third_of_outliers_is_searched_for_robustly(counts):
    recording, _ = simulated("arm", range_sigma=1e-3)
    rng = np.random.default_rng(0)
    spoilt = rng.random(recording.ranges.shape) < 0.3
    ranges = np.where(spoilt, rng.uniform(0.1, 0.5, spoilt.shape), recording.ranges)
    found = hl.calibrate(replace(recording, ranges=ranges), hl.Noise(1e-3))
    assert found.status == "converged"
    assert counts["robust"] >= 1


def test_a_beam_that_loses_a_quarter_of_its_readings_is_not_settled_by_a_plain_screening():
    recording = recording_of(bench(1, 1), *motion("free", 40), [0] * 40, 1e-4)
    readings = recording.readings()
    judge = consensus.ConsensusJudge(readings, 0, 1e-4)
    one = judge.screened(bench(1, 1))
    assert one is not None
    assert judge.settles(one, agreed=False)
    kept = one.kept.copy()
    kept[:10] = False
    assert not judge.settles(one._replace(kept=kept), agreed=True)


def shifted(recording):
    return replace(recording, ranges=np.roll(recording.ranges, 1, axis=0))


def mirrored(recording):
    return replace(recording, world_t_hand=recording.world_t_hand * [1.0, -1.0, 1.0])


@pytest.mark.slow
@pytest.mark.parametrize(("spoilt", "told"), [(shifted, True), (mirrored, False)])
def test_a_file_that_fits_nothing_is_refused_with_bounded_work(counts, spoilt, told):
    """Either no optimum is reached or too little is determined; the message says that nothing fits."""
    recording, _ = simulated("arm", Layout(2, 3, 10), 1e-3, 4)
    found = hl.calibrate(spoilt(recording), hl.Noise(1e-3, 0.0, 0.0) if told else hl.Noise())
    assert found.status in ("unobservable", "not_converged")
    told_so = ("do not fit", "fit only", "read so, the readings fit")
    assert any(words in w.message for w in found.warnings for words in told_so)
    assert counts["robust"] <= 2
    # Seven rounds of the calibration's own search, and at most four for a way to read the file.
    assert counts["plain"] <= 60


@pytest.mark.slow
def test_saturated_readings_are_solved_without_them():
    """A third of the readings at one value is a code of the sensor: the rest is calibrated."""
    recording, truth = simulated("arm", Layout(8, 5, 18), 1e-3, 1)
    rng = np.random.default_rng(1)
    top = 1.2 * recording.ranges.max()
    ranges = np.where(rng.random(recording.ranges.shape) < 0.3, top, recording.ranges)
    found = hl.calibrate(replace(recording, ranges=ranges), hl.Noise(1e-3))
    assert found.status == "converged"
    for name, location in zip(recording.beam_names, truth.locations, strict=True):
        beam = found.beams[name]
        assert (np.abs(beam.location - location) < 5.0 * beam.sigma[:3]).all()


def test_mistakes_are_looked_for_with_one_beam_where_its_readings_suffice():
    recording, _ = simulated("arm", Layout(3, 2, 20), 1e-3, 4)
    one, rows = rereading.one_beam(recording)
    assert one.ranges.shape == (40, 1)
    assert rows.tolist() == list(range(40))
    few, _ = simulated("arm", Layout(3, 2, 10), 1e-3, 4)
    assert rereading.one_beam(few)[0] is few


class _Rounds:
    """A loss that keeps starts as they are and compares their first offsets, and a judge of these."""

    def refined(self, latest):
        return [Candidate(at, float(at.offsets[0]), 0.0, method) for method, at in latest.starts]

    def mended(self, best, _latest):
        return [None] * len(best)

    def convinced(self, found, latest, before):
        self.before = before
        return found[0].criterion <= latest.agreeing


def test_the_search_draws_no_round_after_it_is_convinced():
    def at(offset):
        return "x", replace(bench(1, 1), offsets=np.array([float(offset)]))

    drawn = []

    def rounds():
        for values, enough in (((5, 3), 1), ((4, 1), 1), ((0,), 1)):
            drawn.append(values)
            yield Round([at(value) for value in values], 1.0, enough)

    both = _Rounds()
    known = Candidate(bench(1, 1), 9.0, 0.0, "known")
    found, convinced = search(rounds(), both.refined, both.convinced, both.mended, [known])
    assert convinced
    assert drawn == [(5, 3), (4, 1)]
    assert [one.criterion for one in found] == [1.0, 3.0, 4.0, 5.0, 9.0]
    assert both.before == 3.0


def test_the_price_of_a_reading_is_its_rarity():
    """A residual of z sigmas is as likely under both where z^2 / 2 is the price."""
    distance, sigma = np.array([0.1, 0.6]), 1e-3
    z = np.sqrt(2.0 * price(distance, sigma))
    normal = np.exp(-0.5 * z * z) / (np.sqrt(2.0 * np.pi) * sigma)
    assert normal == pytest.approx(1.0 / 0.5)


def test_a_plane_through_spots_is_that_of_its_scatter():
    rng = np.random.default_rng(2)
    points = rng.normal(size=(30, 3)) * [1.0, 0.5, 0.1]
    axes, middle, size = model.plane_through(points)
    means, scatter = model.means_and_scatter(points, np.array([0]))
    values, vectors = np.linalg.eigh(scatter[0])
    assert np.allclose(means[0], middle)
    assert np.allclose(size[::-1] ** 2, values)
    assert abs(axes[2] @ vectors[:, 0]) == pytest.approx(1.0)
    weights = rng.uniform(0.1, 1.0, 30)
    means, scatter = model.means_and_scatter(points, np.array([0, 10]), weights)
    part, share = points[10:], weights[10:] / weights[10:].sum()
    assert np.allclose(means[1], share @ part)
    assert np.allclose(scatter[1], np.cov(part.T, aweights=share, ddof=0))


@pytest.mark.parametrize("layout", [Layout(50, 2, 12), Layout(1, 1, 9000)])
def test_a_part_of_very_many_beams_or_stations_stands_for_the_whole(layout):
    recording, truth = simulated("arm", layout, 0.0)
    readings = recording.readings()
    part = excerpt_of(readings)
    assert not part.is_whole
    assert part.readings.beams == min(layout.beams, 30)
    assert len(part.readings) <= 6000
    e = model.residuals_or_infinite(truth.part(part.beams, part.planes), part.readings)
    assert np.abs(e).max() < 1e-9
    # What is left out grows linearly from what is there: exact readings leave only rounding.
    grown = part.extended(truth.part(part.beams, part.planes))
    assert np.abs(grown.locations - truth.locations).max() < 1e-6


def test_leverages_keep_nothing_of_the_size_of_readings_times_unknowns():
    recording, truth = simulated("arm", Layout(40, 2, 40), 1e-3)
    readings = recording.readings()
    found = observability(truth, readings, 0, 1e-3)
    leverages(truth, readings, found)
    tracemalloc.start()
    h = leverages(truth, readings, found)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert h.sum() == pytest.approx(40 * 5 + 2 * 3)
    assert peak < 0.8 * 8 * len(readings) * 40 * 5


@pytest.mark.parametrize("damping", [0.0, 1e-3, 10.0])
def test_damping_rises_where_the_gain_is_not_a_number(damping):
    """It kept its value: the same step would have been tried until the last trial."""
    options = damped.LevenbergOptions()
    raised = options.adapted(np.array([damping, damping]), np.array([np.nan, 0.9]))
    assert raised[0] > damping
    assert raised[1] <= damping


class Ring:
    """Rows that hold a point on a circle, and hardly say where; the other residuals are constant."""

    weights = Weights()
    readings = 20

    def slots(self):
        return (Slot(POINT.name, np.zeros(1, dtype=int), slice(0, 3)),)

    def evaluate(self, values):
        x, y, z = values[POINT.name][:, 0].T
        columns = np.zeros((4, len(x), 1, self.readings))
        columns[0, :, 0, 0], columns[1, :, 0, 0] = 2e3 * x, 2e3 * y
        columns[-1, :, 0, 0] = 1e3 * (x**2 + y**2 - 1.0)
        columns[0, :, 0, 1], columns[-1, :, 0, 1] = 3e-2, 3e-2 * (x - 2.0)
        columns[2, :, 0, 2], columns[-1, :, 0, 2] = 1.0, z
        columns[-1, :, 0, 3:] = 1.0
        return Rows(columns)


def test_a_search_that_creeps_along_what_is_hardly_determined_ends(monkeypatch):
    """It would take a thousand trials for a ten thousandth of a standard deviation each."""
    blocks, ends = (Ring(),), []
    reduction = reduction_of(blocks, {POINT.name: 1}, {POINT.name: True})
    problem = damped.LeastSquares(blocks, reduction, np.ones(1), np.zeros(1), Ring.readings - 3)
    start = {POINT.name: np.array([[[0.0, 1.0, 0.0]]])}
    for least in (0.0, damped.NEGLIGIBLE):
        monkeypatch.setattr(damped, "NEGLIGIBLE", least)
        trials = []
        options = damped.LevenbergOptions(least_damping=1e-12)
        ends.append((damped.search(problem, start, options, trials.append), len(trials)))
    (on, long), (ended, short) = ends
    assert long == 1000
    assert not on.converged[0]
    assert damped.CREEPING_AFTER < short < 200
    assert ended.converged[0]
    # What is left to gain is nothing that the readings tell.
    assert ended.cost[0] - on.cost[0] < 1e-3
