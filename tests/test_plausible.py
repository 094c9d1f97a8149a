"""What may hide: plausible sizes of systematic errors, by formulas of their own."""

import math
from dataclasses import replace

import numpy as np
import pytest
from helpers import GRIPPER

import handlaser_gtsam as hl
from benchmarks.cell_mistakes import make_cell
from handlaser_gtsam.model.effects import EFFECTS
from handlaser_gtsam.model.effects.plausible import CODES, KINDS
from handlaser_gtsam.results.limits import Limits
from handlaser_gtsam.results.spots import spot_at
from handlaser_gtsam.results.verdict import verdict

EXACT = hl.Noise(2e-5, pose_translation_sigma=0.0, pose_rotation_sigma=0.0)
SIZES = {"incidence": 2e-4, "tilt": 2e-4, "carry-over": 1e-3, "cubic": 1e-4, "drift": 1e-4}
"""Small enough to be linear in."""


class Quiet:
    """A generator without noise."""

    def standard_normal(self, shape=None):
        return np.zeros(shape) if shape else 0.0


def readings_with(cell, code, size):
    """Return the readings of a cell, exact but for one systematic error."""
    d = cell.d
    if code == "incidence":
        return d + size * cell.tangent**2
    if code == "tilt":
        # What the normal, seen from the sensor, leans towards one axis across the beam.
        n = np.einsum("mji,mj->mi", cell.R, cell.n)
        side = np.cross(cell.v, [0.0, 1.0, 0.0])
        side /= np.linalg.norm(side, axis=1, keepdims=True)
        return d + size * (n @ side.T) / np.einsum("mi,bi->mb", n, cell.v)
    if code == "carry-over":
        return d + size * (np.roll(d, 1, axis=1) - d)
    if code == "cubic":
        return d + size * (d / d.max()) ** 3
    return d + size * (cell.time - 0.5)[:, None]


def cell_with(code, size, *, noisy=False):
    cell = make_cell(4)
    rng, cell.rng = cell.rng, Quiet()
    cell.record_poses()
    cell.rng = rng if noisy else Quiet()
    cell.read()
    cell.d = readings_with(cell, code, size)
    return cell


def recording_of(cell):
    names = tuple(f"s{i}" for i in range(cell.d.shape[1]))
    return hl.Recording(cell.recorded_R, cell.recorded_t, cell.d, tuple(cell.labels), names)


def calibrated(cell, sensor=None, terms="k1k2"):
    options = hl.CalibrationOptions(range_error=terms, sensor=sensor or hl.Sensor())
    return hl.calibrate(recording_of(cell), EXACT, options)


def spot_errors(cell, found, code, size, reading):
    """Return how far the spots of all beams are off, given that the sensor errs so."""
    d = reading
    own = size * (d / cell.d.max()) ** 3 if code == "cubic" else 0.0
    off = []
    for i, beam in enumerate(found.beams.values()):
        truth = cell.r[i] + (d + cell.k[i, 0] * d + cell.k[i, 1] * d**2 - own) * cell.v[i]
        off.append(float(np.linalg.norm(spot_at(found, beam, d)[0] - truth)))
    return np.array(off)


@pytest.mark.parametrize("code", SIZES)
def test_what_a_hidden_error_does_to_a_spot(code):
    """The stated shift is what the solution does where a sensor errs by the plausible size."""
    size = SIZES[code]
    plausible = hl.Plausible(**{code.replace("-", "_"): size})
    cell = cell_with(code, size)
    found = calibrated(cell, hl.Sensor(plausible=plausible))
    stated = {one.code: one for one in found.systematic}[code]
    reading = found.fit.median_reading
    # Of the size that may hide: less, where the recording would show the plausible one.
    shift = stated.spots(reading, unnoticed=True) * size / stated.unnoticed
    off = spot_errors(cell, found, code, size, reading)
    assert shift == pytest.approx(off, rel=0.1, abs=0.02 * off.max()), code
    assert stated.plausible == size


def test_the_headline_says_what_may_hide_and_how_to_see_it():
    cell = cell_with("incidence", 0.0, noisy=True)
    found = calibrated(cell, hl.Sensor(kind="triangulation"))
    judged = verdict(found)
    assert judged.code == "usable-with-care"
    whole = 1e3 * (judged.spot_error + judged.hidden_error)
    assert f"up to {whole:.1f} mm if there is a range error of" in judged.sentence
    assert "this recording would not show" in judged.sentence
    assert "best improvement: to see it, " in judged.sentence
    assert "random errors only" not in judged.sentence


def test_without_a_kind_the_headline_says_that_it_counts_random_errors_only():
    judged = verdict(calibrated(cell_with("incidence", 0.0, noisy=True)))
    assert judged.code == "usable"
    assert judged.hidden is None
    assert "random errors only: state [sensor] kind" in judged.sentence


def test_what_is_small_beside_the_noise_leaves_a_calibration_usable():
    small = hl.Plausible(**dict.fromkeys(hl.Plausible.__dataclass_fields__, 1e-9))
    cell = cell_with("drift", 0.0, noisy=True)
    judged = verdict(calibrated(cell, hl.Sensor(kind="other", plausible=small)))
    assert judged.code == "usable"
    assert judged.hidden_error < 1e-6


def test_limits_count_what_may_hide_as_a_uniform_error():
    cell, limits = cell_with("tilt", 0.0), Limits(location_sigma=1.0)
    without = verdict(calibrated(cell), limits=limits).limits[0]
    nothing = dict.fromkeys(hl.Plausible.__dataclass_fields__, 0.0)
    sensor = hl.Sensor(plausible=hl.Plausible(**(nothing | {"tilt": 3e-3})))
    found = calibrated(cell, sensor)
    counted = verdict(found, limits=limits).limits[0]
    h = {one.code: one for one in found.systematic}["tilt"].location_shift[0]
    sigma = next(iter(found.beams.values())).location_sigma
    assert counted.value == pytest.approx(math.sqrt((sigma**2 + h**2 / 3.0).max()), rel=1e-9)
    assert counted.random == pytest.approx(without.value)
    assert math.isnan(without.random)
    low = verdict(found, limits=Limits(location_sigma=1e-3))
    assert low.code == "outside-limits"
    assert "of it random errors" in low.sentence


def test_what_the_recording_shows_counts_no_more_than_it_may_hide():
    """Where even a small drift would be found, a large plausible one changes nothing."""
    cell = cell_with("drift", 0.0)
    large = calibrated(cell, hl.Sensor(plausible=hl.Plausible(drift=0.5)))
    one = {one.code: one for one in large.systematic}["drift"]
    assert one.unnoticed == one.detectable < 0.01


def test_carry_over_takes_two_channels():
    cell = cell_with("drift", 0.0)
    cell.d = cell.d[:, :1]
    assert "carry-over" not in {one.code for one in calibrated(cell).systematic}


def test_carry_over_follows_the_columns_of_the_recording():
    """The same readings under other names: what is before a channel does not depend on them."""
    cell = cell_with("carry-over", 0.02)
    first = recording_of(cell)
    names = first.beam_names
    other = hl.Recording(
        cell.recorded_R, cell.recorded_t, cell.d, tuple(cell.labels), names[1:] + names[:1]
    )
    sizes = []
    for one in (first, other):
        found = hl.calibrate(one, EXACT, hl.CalibrationOptions(range_error="k1k2"))
        sizes.append({e.code: e for e in found.systematic}["carry-over"].size)
    assert sizes[0] == pytest.approx(sizes[1], rel=1e-6)


def test_a_session_counts_what_may_hide_as_a_batch_does():
    cell = cell_with("incidence", 0.0)
    options = hl.CalibrationOptions(range_error="k1k2", sensor=hl.Sensor(kind="triangulation"))
    batch = hl.calibrate(recording_of(cell), EXACT, options)
    session = hl.Session(EXACT, options)
    session.add(recording_of(cell))
    one, other = verdict(batch), verdict(session.calibration())
    assert other.hidden.code == one.hidden.code
    assert other.hidden_error == pytest.approx(one.hidden_error, rel=0.05)


@pytest.mark.parametrize("kind", KINDS)
def test_kinds_are_fields_of_rig_files(kind, tmp_path):
    rig = tmp_path / "rig.toml"
    rig.write_text(
        f'[sensor]\nkind = "{kind}"\n[plausible]\nincidence_mm = 0.2\nlag_percent = 0.0\n'
    )
    sensor = hl.read_rig(rig).sensor
    sizes = sensor.plausible_sizes(0.1)
    assert sizes["incidence"] == pytest.approx(2e-4)
    assert sizes["lag"] == 0.0
    assert sizes["cubic"] == pytest.approx(0.1 * EFFECTS["cubic"].of_sensor[kind])


def test_where_a_kind_is_stated_not_only_random_errors_count(tmp_path, handlaser):
    rig = tmp_path / "rig.toml"
    rig.write_text('[sensor]\nkind = "other"\n')
    code, out, _ = handlaser("calibrate", str(GRIPPER / "recording.csv"), "--rig", str(rig))
    assert code == 0
    assert "random errors only" not in out


@pytest.mark.parametrize(
    ("table", "words"),
    [
        ('[sensor]\nkind = "laser"', "sensor.kind 'laser'"),
        ("[plausible]\nincidence_mm = -1", "plausible.incidence_mm -1 mm"),
        ("[plausible]\nincidents_mm = 1", "incidents_mm"),
    ],
)
def test_what_cannot_be_is_refused_in_one_line(table, words, tmp_path, refusal):
    rig = tmp_path / "rig.toml"
    rig.write_text(table + "\n")
    assert words in refusal("calibrate", str(GRIPPER / "recording.csv"), "--rig", str(rig))


def test_tilts_of_a_sensor_look_like_another_place():
    """Half a turn of the sensor about its beam changes the sign, and the mean is right."""
    cell = cell_with("tilt", 5e-4)
    first = calibrated(cell)
    second = calibrated(cell_with("tilt", -5e-4))
    for name, truth in zip(first.beams, cell.r, strict=True):
        mean = 0.5 * (first.beams[name].location + second.beams[name].location)
        assert np.linalg.norm(mean - truth) < 0.05 * 5e-4
        off = np.linalg.norm(first.beams[name].location - truth)
        assert off == pytest.approx(5e-4, rel=0.1)


# Stations that tell what may hide


def planned_in_cell(free, seed=1):
    """Plan 12 stations after the recording of a cell, read there, and calibrate with all."""
    noise = hl.Noise(2e-5, pose_translation_sigma=4e-5, pose_rotation_sigma=math.radians(0.008))
    sensor = hl.Sensor(0.02, 0.25, math.radians(65.0), kind="triangulation")
    options = hl.CalibrationOptions(sensor=sensor)
    cell = make_cell(seed)
    cell.record_poses()
    cell.read()
    before = hl.calibrate(recording_of(cell), noise, options)
    known = hl.calibrate(recording_of(cell), noise, replace(options, free=free))
    plan = hl.plan(known, 12, sensor)
    first = [cell.labels.index(label) for label in plan.stations.plane_labels]
    more = make_cell(seed)
    more.R, more.t = plan.stations.world_R_hand, plan.stations.world_t_hand
    more.plane, more.n, more.h = cell.plane[first], cell.n[first], cell.h[first]
    more.record_poses()
    more.read()
    names = [f"later {i}" for i in range(len(first))]
    later = recording_of(more)
    later = hl.Recording(
        later.world_R_hand, later.world_t_hand, later.ranges, more.labels, later.beam_names, names
    )
    after = hl.calibrate(hl.join([recording_of(cell), later]), noise, options)
    size = {one.code: one.detectable for one in after.systematic}["incidence"]
    return before, plan, after, size


@pytest.mark.slow
def test_planned_stations_tell_an_error_with_incidence():
    before, plan, after, told = planned_in_cell(("incidence",))
    _, other, _, without = planned_in_cell(())
    assert told < 0.9 * without
    shift = [
        {one.code: one for one in found.systematic}["incidence"].spots(0.1, unnoticed=True).max()
        for found in (before, after)
    ]
    assert shift[1] < 0.1 * shift[0]
    # What may be there counts in the forecast, before and after.
    assert plan.forecast.location_sigma[0] > 3.0 * other.forecast.location_sigma[0]
    assert plan.forecast.location_sigma[-1] > other.forecast.location_sigma[-1]


def test_every_error_of_which_a_size_is_plausible_has_a_field_and_no_other_has():
    sized = {code for code, one in EFFECTS.items() if one.of_sensor or one.of_cell is not None}
    assert set(CODES) == sized
