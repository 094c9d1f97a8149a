"""Systematic errors as unknowns: against SciPy and dense algebra, recovered, judged, and refused."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from helpers import GRIPPER, codes, first_and_slow, simulated
from test_systematic import Scene

import handlaser_gtsam as hl
from handlaser_gtsam.model.effects import EFFECTS, OF_STATIONS
from handlaser_gtsam.planning.advice import advice_lines
from handlaser_gtsam.planning.belief import belief_of, station_rows
from handlaser_gtsam.planning.choice import updated
from handlaser_gtsam.results.description.beams import CalibrationDescription
from handlaser_gtsam.results.description.terminal import LINES, screen_lines
from handlaser_gtsam.results.freed import MOST_FREED
from handlaser_gtsam.results.limits import Limits
from handlaser_gtsam.results.projection import FreedColumns, LinearRows, Projection
from handlaser_gtsam.results.score_tests import ScoreTests
from handlaser_gtsam.results.verdict import verdict
from handlaser_gtsam.solvers.reference.errors import ERRORS
from handlaser_gtsam.validation.cross_check import cross_check
from handlaser_gtsam.validation.simulate import Stations

SIGMA = 1e-4
NOISE = hl.Noise(SIGMA, 0.0, 0.0)
SENSOR = hl.Sensor(kind="triangulation")
SIZES = {
    "incidence": 1e-3,
    "cubic": 5e-4,
    "sag": 2e-4,
    "lag": 1e-3,
    "turn-scale": 5e-4,
    "translation-scale": 5e-4,
    "carry-over": 0.01,
    "drift": 5e-4,
    "beam-on-plane": 1e-3,
    "displaced": 5e-4,
    "tool-displaced": 2e-4,
}
"""Sizes that are plausible of a triangulation sensor, a plate and a robot.

That of the lag is ten of its standard deviations: the readings fit so well even with it that no other
start is searched for."""
LARGE_LAG = 0.05
"""Of which the turns show at second order, and the readings fit nothing until it is estimated."""


def recorded(scene, seed=0, code="", size=0.0, sigma=SIGMA):
    """Return a recording of a scene with an error of some size."""
    d = scene.ranges(code, size)
    d = d + np.random.default_rng(seed).normal(0.0, sigma, d.shape)
    labels = tuple(f"p{p}" for p in scene.plane)
    return hl.Recording(scene.R, scene.t, d, labels, ("b0", "b1", "b2"))


def freed(recording, *free, noise=NOISE, sensor=SENSOR, **options):
    """Calibrate with errors that are unknowns."""
    chosen = hl.CalibrationOptions(free=free, sensor=sensor, **options)
    return hl.calibrate(recording, noise, chosen)


def state(found):
    """Return all coordinates of beams and planes."""
    return np.concatenate(
        [one.coordinates for part in (found.beams, found.planes) for one in part.values()]
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("code", "range_error"),
    first_and_slow(
        ("incidence", "none"),
        ("incidence", "auto"),
        ("lag", "none"),
        ("lag", "auto"),
        *((code, "k1") for code in SIZES),
    ),
)
def test_scipy_agrees_by_formulas_of_its_own(code, range_error):
    noise = NOISE if range_error == "none" else hl.Noise(SIGMA, 1e-4, 1e-4)
    scene = Scene(3)
    found = freed(recorded(scene, 0, code, SIZES[code]), code, noise=noise, range_error=range_error)
    assert found.status == "converged"
    agrees(found)


def agrees(found):
    """Hold that SciPy finds the same."""
    check = cross_check(found, found.recorded)
    # Weights, and what an error of size 1 does, settle to 1e-5 standard deviations in both.
    assert check.largest < 1e-4, check
    assert check.largest_sigma < 1e-6, check


@pytest.mark.slow
@pytest.mark.parametrize("code", ["lag", "sag", "drift", "displaced", "tool-displaced"])
def test_scipy_agrees_where_readings_of_which_an_error_is_made_are_rejected(code):
    recording = recorded(Scene(3), 0, code, SIZES[code])
    ranges = recording.ranges.copy()
    ranges[7, 1] += 0.02
    ranges[-1] += 0.03  # no reading of the last station is left
    found = freed(replace(recording, ranges=ranges), code)
    assert len(found.fit.rejected) >= 4
    agrees(found)


@pytest.mark.parametrize("seed", [0, 1])
def test_errors_that_are_unknowns_make_no_sigma_too_large(seed):
    """They take up a part of the residuals: of 144 readings some 83 degrees of freedom are left."""
    assert codes(freed(recorded(Scene(seed), seed), "displaced")) == []


@pytest.mark.slow
def test_scipy_knows_every_error_and_all_of_them_at_once():
    assert set(ERRORS) == {code for code, effect in EFFECTS.items() if effect.can_be_freed}
    found = freed(recorded(Scene(3), 0, "lag", LARGE_LAG), *ERRORS)
    assert len(found.effects) == 81
    agrees(found)
    assert not [one for one in found.systematic if one.found]


def test_an_error_that_scipy_has_no_formula_of_is_refused():
    found = freed(recorded(Scene(3)), "lag", range_error="none")
    new = tuple(replace(effect, code="mine") for effect in found.effects)
    with pytest.raises(hl.InputError, match="a freed mine"):
        cross_check(replace(found, effects=new), recorded(Scene(3)))


@pytest.mark.slow
def test_several_errors_are_unknowns_at_once():
    recording = recorded(Scene(3), 0, "lag", LARGE_LAG)
    found = freed(recording, "lag", "incidence", "turn-scale")
    check = cross_check(found, recording)
    # The turns of lag and scale are added, and the right Jacobian of their sum ends at second order.
    assert check.largest < 1e-3
    assert check.largest_sigma < 1e-3
    lag = next(one for one in found.effects if one.code == "lag")
    assert abs(lag.size - LARGE_LAG) < 4.0 * lag.sigma < 2e-3


def test_a_lag_follows_a_way_that_bends():
    """Half of the way from the previous to the next station would leave mounts wrong by 2 to 7 mm."""
    scene = Scene(3)
    found = freed(recorded(scene, 0, "lag", 0.1), "lag", noise=None)
    assert found.usable
    for beam, r in zip(found.beams.values(), scene.r, strict=True):
        assert (np.abs(beam.location - r) < 4.0 * beam.sigma[:3]).all()
        assert (beam.sigma[:3] < 5e-4).all()


def test_a_lag_passes_stations_without_a_reading():
    """Without them the step of their neighbours was twice as long, and mounts were up to 3 mm off."""
    scene = Scene(1)
    recording = recorded(scene, 1, "lag", LARGE_LAG)
    ranges = recording.ranges.copy()
    ranges[[9, 20, 30]] = np.nan
    found = freed(replace(recording, ranges=ranges), "lag", noise=None)
    agrees(found)
    (lag,) = found.effects
    assert abs(lag.size - LARGE_LAG) < 4.0 * lag.sigma < 2e-3
    for beam, r in zip(found.beams.values(), scene.r, strict=True):
        assert (np.abs(beam.location - r) < 4.0 * beam.sigma[:3]).all()
        assert (beam.sigma[:3] < 5e-4).all()


@pytest.mark.slow
@pytest.mark.parametrize("code", ["lag", "incidence", "drift"])
def test_a_simulated_error_is_recovered_with_honest_covariances(code):
    runs, size = 10, SIZES[code]
    squares, count, of_size = 0.0, 0, []
    for seed in range(runs):
        scene = Scene(seed)
        found = freed(
            recorded(scene, 1000 + seed, code, size), code, range_error="none", outliers="keep"
        )
        planes = [int(name[1:]) for name in found.planes]
        truth = [np.concatenate((scene.r[i], scene.v[i], [0.0, 0.0])) for i in range(scene.beams)]
        truth += [np.append(scene.n[p], scene.b[p]) for p in planes]
        S, e = found.covariance.matrix(), state(found) - np.concatenate(truth)
        unit = np.where(np.diagonal(S) > 0.0, np.sqrt(np.diagonal(S)), 1.0)
        values, axes = np.linalg.eigh(S / np.outer(unit, unit))
        kept = values > 1e-9  # unit vectors have no variance along themselves
        squares += float((((axes.T @ (e / unit))[kept]) ** 2 / values[kept]).sum())
        count += int(kept.sum())
        first = found.effects[0]
        of_size.append(((first.size - size) / first.sigma) ** 2)
    # Four standard deviations of a mean of chi-squared numbers with one degree of freedom each.
    assert abs(squares / count - 1.0) < 4.0 * np.sqrt(2.0 / count)
    # The true size is fixed, not drawn from the prior, which pulls by a part of its variance.
    assert np.mean(of_size) < 1.0 + 4.0 * np.sqrt(2.0 / runs)


@pytest.mark.slow
def test_mounts_are_known_as_well_as_the_error_allows():
    recording = recorded(Scene(3), 0, "incidence", 1e-3)
    known = freed(recording, range_error="none")
    assert "systematic-incidence" in codes(known)
    before = 0.0
    for plausible in (1e-9, 3e-4, 1e-3, 1e-2):
        sensor = replace(SENSOR, plausible=hl.Plausible(incidence=plausible))
        found = freed(recording, "incidence", sensor=sensor, range_error="none")
        sigma = np.array([beam.sigma[:6] for beam in found.beams.values()])
        assert (sigma > before).all()
        before = sigma * (1.0 - 1e-9)
        if (
            plausible == 1e-9
        ):  # an error that cannot be there is none: the numbers are those without it
            assert np.abs(state(found) - state(known)).max() < 1e-9
            assert np.allclose(sigma, [b.sigma[:6] for b in known.beams.values()], rtol=1e-9)
    assert "systematic-incidence" not in codes(found)
    assert not [one for one in found.systematic if one.code == "incidence"]


def test_further_unknowns_add_what_dense_algebra_adds():
    found = freed(recorded(Scene(1)), range_error="k1")
    joint, rng = found.covariance, np.random.default_rng(2)
    size = len(joint.beams)
    beams, planes = rng.normal(size=(size, 2)) * 1e-3, rng.normal(size=(4, 4, 2)) * 1e-3
    planes[:, :3] = joint.plane_bases @ np.einsum("pij,piq->pjq", joint.plane_bases, planes[:, :3])
    A = np.array([[2.0, 0.3], [0.3, 0.5]])
    lifted = [lift @ beams[6 * i : 6 * i + 6] for i, lift in enumerate(joint.beam_lifts())]
    M = np.concatenate([*lifted, *planes])
    twice = joint.following(beams[:, :1], planes[..., :1], A[:1, :1])
    twice = twice.following(beams[:, 1:], planes[..., 1:], A[1:, 1:])
    for whole, known in ((joint.following(beams, planes, A), A), (twice, np.diag(np.diagonal(A)))):
        expected = joint.matrix() + M @ known @ M.T
        # Sums of numbers of 1e-6 in which the smallest of 1e-9 keep seven digits.
        assert np.abs(whole.matrix() - expected).max() < 1e-15


def test_all_other_errors_are_tested_beside_a_freed_one():
    truth, readings, station = Scene(2).problem(Scene(2).ranges())
    how = hl.model.whitening(truth, readings, hl.model.Variances(np.full(3, SIGMA)))
    prior = np.tile((1e-3, 1e-2), (3, 1))
    columns = np.random.default_rng(0).normal(size=(len(readings), 2)) * 3e-4
    some = FreedColumns(("lag", "cubic"), columns, np.array([0.3, -0.2]))
    rows = LinearRows(truth, readings, how, prior, station, freed=some)
    tests, pull = ScoreTests(rows, None), Projection(rows, prior).pull
    assert not np.isin(tests.codes, ("lag", "cubic")).any()
    # Dense: rows of readings, then of the priors of range errors and of the freed ones.
    J = np.hstack((rows.sparse.toarray(), columns)) / SIGMA
    weights = np.zeros((pull.size + 2, J.shape[1]))
    weights[np.arange(pull.size), np.arange(pull.size)] = pull.ravel() / SIGMA
    weights[[-2, -1], [-2, -1]] = 1.0
    J = np.vstack((J, weights))
    for member in np.flatnonzero(~tests.strained)[::7]:
        column = np.append(tests.column(member), np.zeros(pull.size + 2)) / SIGMA
        x, *_ = np.linalg.lstsq(J, column, rcond=None)
        left = np.linalg.norm(column - J @ x) ** 2 * SIGMA**2
        # A projection of a column whose square is up to 1e3 times what is left.
        assert tests.left[member] == pytest.approx(left, rel=1e-6)
        assert np.allclose(
            tests.moved[member], x[: pull.size], rtol=1e-5, atol=1e-8 * np.abs(x).max()
        )


def test_what_the_readings_do_not_tell_is_said():
    # k1 of all beams scales every length, as the robot's translations do.
    found = freed(recorded(Scene(3)), "translation-scale", range_error="k1")
    (one,) = found.effects
    assert not one.determined
    assert one.sigma == pytest.approx(one.prior_sigma, rel=1e-3)
    assert one.prior_sigma == pytest.approx(1e-3 / np.sqrt(3.0))
    assert "effect-undetermined" in codes(found)
    assert "do not determine a scale error of the robot's translations" in one.words
    known = freed(recorded(Scene(3)), range_error="k1")
    assert found.observability.unknowns == known.observability.unknowns
    assert found.fit.dof == known.fit.dof
    # That is what k1 is known to: by hardly anything without the error, and by its plausible size.
    grown, before = (np.array([b.sigma[6] for b in x.beams.values()]) for x in (found, known))
    assert (grown > before).all()
    assert np.hypot(before, one.prior_sigma) == pytest.approx(grown, rel=0.05)


def test_the_remedy_of_an_undetermined_error_is_whole_on_any_screen():
    """The warning, the headline and the facts say the same, however much else there is to say."""
    recording, rig = hl.read_recording(GRIPPER / "recording.csv"), hl.read_rig(GRIPPER / "rig.toml")
    found = freed(recording, "lag", "incidence", noise=rig.noise)
    (one,) = [effect for effect in found.effects if not effect.determined]
    assert re.fullmatch(r"-?\d\.\d+ \+- 0\.\d+ mm", one.brief)
    remedy = f"({one.brief}, hardly better than its prior), {EFFECTS['incidence'].reveal}"
    judged = verdict(found, limits=Limits(rms=5e-5, location_sigma=1e-4, direction_sigma=1e-3))
    assert judged.best.code == "effect-undetermined"
    assert EFFECTS["incidence"].reveal in judged.sentence
    described = CalibrationDescription(found, judged)
    # Next best stations, a cross-check and files that are written keep up to 8 lines for themselves.
    for closing in range(9):
        screen = screen_lines(described, closing=closing)
        assert len(screen) + closing <= LINES
        text = " ".join(line.strip() for line in screen)
        assert f"WARNING: to determine incidence {remedy}" in text
        assert f"undetermined: incidence {one.brief}" in text


def test_a_determined_size_is_an_unknown_as_every_other():
    found = freed(recorded(Scene(3), 0, "lag", SIZES["lag"]), "lag", range_error="none")
    assert found.effects[0].determined
    known = freed(recorded(Scene(3)), range_error="none")
    assert found.observability.unknowns == known.observability.unknowns + 1
    assert found.observability.rank == known.observability.rank + 1
    assert found.fit.dof == known.fit.dof - 1


def test_poses_and_readings_are_kept_with_the_error_and_without():
    scene = Scene(3)
    found = freed(recorded(scene, 0, "lag", SIZES["lag"]), "lag", range_error="none")
    R, t = scene.true_poses("lag", found.effects[0].size)
    # The interpolated poses, moved by the size that was found.
    assert np.abs(found.recording.world_R_hand - R).max() < 1e-12
    assert np.abs(found.recording.world_t_hand - t).max() < 1e-12
    assert found.recorded == recorded(scene, 0, "lag", SIZES["lag"])
    assert found.problem().graph.error(found.values) == pytest.approx(found.cost, rel=1e-6)


@pytest.mark.slow
def test_readings_that_the_error_had_spoiled_are_taken_back_and_wrong_ones_are_not():
    scene = Scene(5)
    recording = recorded(scene, 0, "incidence", 4e-3)
    ranges = recording.ranges.copy()
    ranges[7, 1] += 0.02
    found = freed(replace(recording, ranges=ranges), "incidence", range_error="none")
    assert [(one.station, one.sensor) for one in found.fit.rejected] == [("8", "b1")]
    without = freed(replace(recording, ranges=ranges), range_error="none")
    assert len(without.fit.rejected) > 1
    (one,) = found.effects
    assert abs(one.size - 4e-3) < 4.0 * one.sigma


def test_errors_of_planes_and_of_the_tool_have_an_unknown_each():
    scene = Scene(3)
    found = freed(
        recorded(scene, 0), "beam-on-plane", "drift", "tool-displaced", range_error="none"
    )
    subjects = [one.subject for one in found.effects]
    assert len([one for one in found.effects if one.code == "beam-on-plane"]) == 12
    assert {"beam b0 on plane p2", "steady", "warming up", "along x steadily"} <= set(subjects)
    z = np.array([one.size / one.sigma for one in found.effects])
    assert np.abs(z).max() < 4.0  # nothing is there
    # Colours of plates may be wrong by so much: 2 mm in a metre of the largest reading, over root 3.
    assert found.planes["p0"].offset_sigma > 3e-4


REFUSED = {
    "a code that is none": (("lags",), {}, "'lags'"),
    "an error that nothing shows": (("tilt",), {}, "free tilt, which no recording tells from"),
    "no plausible size": (
        ("incidence",),
        {"sensor": hl.Sensor()},
        'no plausible size; .*kind = "triangulation" or .*, or incidence_mm in .plausible.',
    ),
    "a size of zero": (("incidence",), {"sensor": hl.Sensor(kind="other")}, "size of zero"),
    "a robust loss": (("lag",), {"loss": "huber"}, "free errors with a huber loss"),
    "a text": ("lag", {}, "'lag'"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_cannot_be_an_unknown_is_refused(case):
    free, options, words = REFUSED[case]
    recording = recorded(Scene(3))
    with pytest.raises(hl.InputError, match=words):
        hl.calibrate(
            recording, NOISE, hl.CalibrationOptions(free=free, **{"sensor": SENSOR, **options})
        )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("codes", "range_error"),
    [*(((code,), "none") for code in OF_STATIONS), (OF_STATIONS, "k1")],
)
def test_a_plan_counts_the_errors_as_a_calibration_with_its_stations_will(codes, range_error):
    scene = Scene(3)
    whole = recorded(scene, 0, codes[0], SIZES[codes[0]])
    late = np.arange(len(whole.plane_labels)) >= 24
    found = freed(whole.part(~late), *codes, range_error=range_error)
    after = freed(whole, *codes, range_error=range_error)
    belief = belief_of(found)
    assert (belief.errors, belief.uncounted) == (codes, ())
    plane = np.array([belief.plane_names.index(label) for label in whole.plane_labels])
    stations = Stations(whole.world_R_hand, whole.world_t_hand, plane)[late]
    rows = station_rows(belief, stations)
    errors, unknowns = len(codes), np.arange(belief.first_plane)
    expected = after.covariance.matrix(planes=[], ambient=False)
    largest = np.nanmax(whole.part(~late).ranges)
    *_, spots = scene.flat_ranges(*scene.true_poses("", 0.0))
    # The squared distance of the farthest spot from the middle of its plane, before and after.
    farthest = [
        max(
            ((own - own.mean(axis=(0, 1))) ** 2).sum(axis=2).max()
            for own in (spots[rows & (scene.plane == p)] for p in range(scene.planes))
        )
        for rows in (~late, late | True)
    ]
    units = {"cubic": largest**-3, "sag": farthest[0] / farthest[1]}
    unit = [units.get(code, 1.0) for code in codes]
    sizes = np.array([one.sigma for one in after.effects]) * unit
    sigma = np.concatenate((sizes, np.sqrt(np.diagonal(expected))))

    def forecast(rows):
        variance = np.diagonal(updated(belief.covariance, rows))[unknowns]
        return np.sqrt(variance[variance > 0.0]) / sigma

    # The estimate differs by some standard deviations in between, and so do the derivatives.
    assert np.abs(forecast(rows) - 1.0).max() < 0.03
    for factor in (0.0, -1.0):  # as if the stations had no such error, or the opposite one
        wrong = rows.copy()
        wrong[..., :errors] *= factor
        assert np.abs(forecast(wrong) - 1.0).max() > 0.15


@pytest.mark.slow
def test_a_plan_says_which_errors_its_stations_are_taken_to_be_without(
    tmp_path, handlaser, refusal
):
    scene = Scene(3)
    recording = recorded(scene, 0, "lag", SIZES["lag"])
    found = freed(recording, "lag", "incidence", "drift", range_error="none")
    sensor = hl.Sensor(0.2, 0.6, kind="triangulation")
    plan = hl.plan(found, 2, sensor)
    assert plan.uncounted == ("lag", "drift")
    assert plan.forecast.location_sigma[0] == pytest.approx(
        max(beam.sigma[:3].max() for beam in found.beams.values())
    )
    only = freed(recording, "lag", range_error="none")
    assert belief_of(only).errors == ()
    assert any(
        "without the freed errors lag" in line for line in advice_lines(hl.plan(only, 1, sensor))
    )
    path, rig, out = tmp_path / "r.csv", tmp_path / "rig.toml", tmp_path / "c.json"
    hl.write_recording(path, recording)
    rig.write_text(
        "[noise]\nrange_sigma_mm = 0.1\npose_translation_sigma_mm = 0\npose_rotation_sigma_deg = 0\n"
        '[sensor]\nkind = "triangulation"\nrange_mm = [200, 600]\n'
        "[workspace]\nbox_mm = [[-200, -200, -200], [200, 200, 200]]\n"
    )
    few = ("--rig", rig, "--stations", 2)
    code, text, err = handlaser("plan", path, *few, "--free", "lag,incidence")
    assert code == 0, err
    assert "the stations are taken to be without the freed errors lag:" in text
    hl.write_recording(path, recorded(scene))
    assert handlaser("calibrate", path, "--rig", rig, "--free", "incidence", "--out", out)[0] == 0
    code, text, err = handlaser("plan", "--calibration", out, *few)
    assert code == 0, err
    assert "--free incidence instead of --calibration" in err.replace("\n", " ")
    assert "--free without RECORDING" in refusal(
        "plan", "--calibration", out, *few, "--free", "incidence"
    )


def test_more_sizes_than_are_known_together_are_refused():
    many, _ = simulated("paper", hl.validation.Layout(planes=30))
    with pytest.raises(hl.InputError, match=f"1 to {MOST_FREED}"):
        freed(many, "displaced", noise=hl.Noise(3e-5, 0.0, 0.0), range_error="none")


@pytest.mark.slow
def test_validation_takes_the_error_out_as_the_whole_recording_has_it():
    recording = recorded(Scene(3), 0, "lag", LARGE_LAG)
    options = hl.CalibrationOptions("none", free=("lag",), sensor=SENSOR)
    found = hl.validate(recording, NOISE, options, splits=1)
    assert found.calibration.effects[0].determined
    # With a lag of five hundredths of the way in the readings they would be 5 mm.
    assert max(one.result.rms for one in found.targets) < 5.0 * SIGMA


@pytest.mark.slow
def test_every_view_has_the_error(tmp_path, handlaser, refusal):
    path, rig, out, page = (tmp_path / n for n in ("r.csv", "rig.toml", "c.json", "page.html"))
    hl.write_recording(path, recorded(Scene(3), 0, "lag", 2e-3))
    rig.write_text(
        "[noise]\nrange_sigma_mm = 0.1\npose_translation_sigma_mm = 0\npose_rotation_sigma_deg = 0\n"
        '[sensor]\nkind = "triangulation"\n'
    )
    files = ("--rig", rig, "--out", out, "--report", page)
    code, text, err = handlaser(
        "calibrate", path, *files, "--free", "lag, incidence", "--cross-check"
    )
    assert code == 0, err
    lag, incidence = json.loads(out.read_text())["effects"]
    words = f"a lag between poses and readings by {100.0 * lag['size']:.2g} %"
    line = f"freed errors: {words} of the step to the next station (+-"
    assert line in text.replace("\n  ", " ")
    assert (lag["code"], lag["unit"], lag["determined"]) == ("lag", "1", True)
    assert abs(lag["size"] - 2e-3) < 4.0 * lag["sigma"]
    assert incidence["code"] == "incidence"
    assert hl.read_calibration(out).effects[0].size == lag["size"]
    assert words in page.read_text()
    verbose = handlaser("calibrate", path, "--rig", rig, "--free", "lag", "--verbose")[1]
    assert "freed errors: a lag" in verbose.replace("\n  ", " ")
    err = refusal("calibrate", GRIPPER / "recording.csv", "--free", "lags")
    assert err.startswith("handlaser: found --free 'lags'; expected one of 'incidence'")
