"""Options and arguments beyond sense: refused in one line that says what would be right."""

import numpy as np
import pytest
from helpers import GRIPPER

import handlaser_gtsam as hl
from handlaser_gtsam.model.damped_search import LevenbergOptions
from handlaser_gtsam.model.losses import Loss
from handlaser_gtsam.observability.rank import ObservabilityOptions
from handlaser_gtsam.results.limits import Limits
from handlaser_gtsam.validation.scenes import Layout
from handlaser_gtsam.validation.simulate import Errors

WORDS = {
    "range_error": "'auto', 'none', 'k1', 'k1k2'",
    "outliers": "'reject', 'keep'",
    "loss": "'gaussian', 'huber', 'cauchy', 'tukey'",
    "poses": "'auto', 'exact', 'marginalised', 'estimated'",
}
SLIPS = ("foo", "AUTO", "", None, True, 1, ["auto"], "\x1b[31mauto", b"auto")


@pytest.mark.parametrize("option", WORDS)
@pytest.mark.parametrize("slip", SLIPS)
def test_words_that_are_no_option_are_refused_with_the_list(option, slip):
    with pytest.raises(hl.InputError) as caught:
        hl.CalibrationOptions(**{option: slip})
    assert str(caught.value) == f"found {option} {slip!r}; expected one of {WORDS[option]}"


def case(kind, **fields):
    shown = ", ".join(f"{name}={value!r}" for name, value in fields.items())
    return pytest.param(kind, fields, id=f"{kind.__name__}({shown})"[:80])


@pytest.mark.parametrize(
    ("kind", "fields"),
    [
        case(hl.CalibrationOptions, range_sigma_by_beam="yes"),
        case(hl.CalibrationOptions, estimate_noise=1),
        case(hl.CalibrationOptions, sensor=(0.0, 0.03)),
        case(hl.CalibrationOptions, solver=None),
        case(hl.CalibrationOptions, observability=hl.Sensor()),
        case(hl.Sensor, range_min="0"),
        case(hl.Sensor, range_min=False),
        case(hl.Sensor, range_max=1e300),
        case(hl.Sensor, range_max=np.nan),
        case(hl.Sensor, max_incidence="45"),
        case(hl.Sensor, linearity=None),
        case(hl.Sensor, linearity=np.inf),
        case(Limits, rms=True),
        case(Limits, rms=1e300),
        case(Limits, location_sigma=-1.0),
        case(Limits, direction_sigma="small"),
        case(Loss, name="foo"),
        case(Errors, range_sigma=1e300),
        case(Errors, pose_translation_sigma=np.nan),
        case(Errors, pose_rotation_sigma="0"),
        case(Layout, beams=0),
        case(Layout, beams=1.5),
        case(Layout, planes=True),
        case(Layout, stations=10**8),
        case(Layout, beams=1000, planes=1000, stations=1000),
        case(Layout, k1="0"),
        case(Layout, k2=-1e300),
        case(LevenbergOptions, max_iterations=-1),
        case(LevenbergOptions, max_iterations=1e3),
        case(LevenbergOptions, step_tolerance=np.nan),
        case(LevenbergOptions, damping_factor=1.0),
        case(LevenbergOptions, most_damping=1e300),
        case(ObservabilityOptions, most_sigma=0.0),
        case(ObservabilityOptions, least_information=-1.0),
    ],
)
def test_values_beyond_sense_are_refused(kind, fields):
    with pytest.raises(hl.InputError) as caught:
        kind(**fields)
    assert str(caught.value).isprintable()
    field = "scene" if len(fields) > 1 else next(iter(fields))  # of so many, none is at fault alone
    named = {"name": "loss"}
    assert named.get(field, field) in str(caught.value).replace("range sigma", "range_sigma")


@pytest.mark.parametrize("number", [np.float32(0.5), np.int64(1), 1, np.float64(0.25)])
def test_numbers_of_numpy_are_numbers(number):
    assert hl.Noise(range_sigma=number).range_sigma == number


def test_calibrate_wants_what_it_says():
    recording = hl.read_recording(GRIPPER / "recording.csv")
    path = str(GRIPPER / "recording.csv")
    for arguments, words in (
        ((path,), "as recording; expected handlaser_gtsam.Recording"),
        ((recording, 3e-5), "as noise; expected handlaser_gtsam.Noise"),
        ((recording, None, "huber"), "as options; expected handlaser_gtsam.CalibrationOptions"),
        ((recording, 0), "as noise"),
    ):
        with pytest.raises(hl.InputError, match=words):
            hl.calibrate(*arguments)
