"""The order of rows, beams and planes in a file changes nothing."""

from dataclasses import replace

import numpy as np
import pytest
from helpers import simulated

import handlaser_gtsam as hl
from handlaser_gtsam.data.recording import sorted_readings
from handlaser_gtsam.validation.scenes import Layout


def shuffled(recording, seed):
    """The same recording with rows and beam columns in another order; planes follow the rows."""
    rng = np.random.default_rng(seed)
    rows = rng.permutation(len(recording.plane_labels))
    columns = rng.permutation(len(recording.beam_names))
    return hl.Recording(
        recording.world_R_hand[rows],
        recording.world_t_hand[rows],
        recording.ranges[np.ix_(rows, columns)],
        tuple(recording.plane_labels[i] for i in rows),
        tuple(recording.beam_names[i] for i in columns),
        tuple(recording.station_names[i] for i in rows),
    )


@pytest.mark.slow
@pytest.mark.parametrize(("scene", "sigma"), [("paper", 3e-5), ("arm", None), ("arm", 1e-3)])
@pytest.mark.parametrize("garbage", [False, True])
def test_the_order_changes_nothing(scene, sigma, garbage):
    recording, _ = simulated(scene, Layout(2, 3, 12), {"paper": 3e-5, "arm": 1e-3}[scene])
    if garbage:
        ranges = recording.ranges.copy()
        ranges[::7, 1] = ranges.mean()
        recording = replace(recording, ranges=ranges)
    first = hl.calibrate(recording, hl.Noise(sigma))
    again = hl.calibrate(shuffled(recording, 1), hl.Noise(sigma))
    assert again.status == first.status == "converged"
    assert (again.message, again.iterations) == (first.message, first.iterations)
    for name, beam in first.beams.items():
        other = again.beams[name]
        for quantity in ("location", "direction", "range_error", "sigma"):
            mine, its = getattr(beam, quantity), getattr(other, quantity)
            assert np.array_equal(mine, its), quantity  # to the last bit
    for name, plane in first.planes.items():
        assert np.array_equal(plane.normal, again.planes[name].normal)
        assert plane.offset == again.planes[name].offset
    key = [(r.station, r.sensor, r.reason, r.residual) for r in first.fit.rejected]
    assert sorted(key) == sorted(
        (r.station, r.sensor, r.reason, r.residual) for r in again.fit.rejected
    )


def test_sorted_readings_are_the_recording():
    recording, _ = simulated("arm", Layout(2, 3, 5))
    readings, order = sorted_readings(shuffled(recording, 3))
    other = shuffled(recording, 3)
    station, beam = order.stations[readings.station], order.beams[readings.beam]
    assert np.array_equal(readings.distance, other.ranges[station, beam])
    assert np.array_equal(readings.world_t_hand, other.world_t_hand[station])
    assert np.array_equal(order.planes[readings.plane], other.plane_of_station[station])
    assert sorted(zip(station, beam, strict=True)) == [(j, i) for j in range(15) for i in range(2)]
