"""Values with arrays compare, copy, pickle and print as wholes, and cannot be written to."""

import copy
import dataclasses
import pickle
import typing
from collections.abc import Iterator, Mapping

import annotations
import numpy as np
import pytest

import handlaser_gtsam as hl
from handlaser_gtsam.data.value import Value, same

MOST_CHARACTERS = 1000
"""Of a representation: a few lines."""


@pytest.fixture(scope="module")
def values(gripper):
    """One value of each kind that a calibration and its validation hold, and some made by hand."""
    one = gripper.part([j for j, label in enumerate(gripper.plane_labels) if label in "AB"])
    noise = hl.Noise(range_sigma=3e-5, pose_translation_sigma=0.0, pose_rotation_sigma=0.0)
    plain = hl.CalibrationOptions(range_error="none", outliers="keep")
    calibration = hl.calibrate(gripper, hl.Noise(range_sigma=3e-5))
    mounts = hl.Mounts.of(calibration)
    beam = next(iter(calibration.beams))
    validation = hl.validate(one, noise, plain, splits=1, rng=np.random.default_rng(1))
    return tuple(
        inside(
            (
                calibration,
                validation,
                mounts,
                gripper.readings(),
                hl.Noise(pose_covariance=np.eye(6)),
                calibration.parameters(),
                hl.hold_out(mounts, one),
                hl.cross_check(calibration, gripper),
                hl.spot(calibration, beam, 0.01),
                hl.data.RangeErrorPrior(np.array([[1.0, np.nan]]), np.ones((1, 2))),
            )
        )
    )


def inside(value: object) -> Iterator[Value]:
    """Yield all values inside a value, itself included."""
    if isinstance(value, Mapping):
        value = tuple(value.values())
    if isinstance(value, tuple):
        for one in value:
            yield from inside(one)
    elif dataclasses.is_dataclass(value):
        if isinstance(value, Value):
            yield value
        for field in dataclasses.fields(value):
            yield from inside(getattr(value, field.name))


def arrays(value: Value) -> list[np.ndarray]:
    fields = [getattr(value, field.name) for field in dataclasses.fields(value)]
    return [one for one in fields if isinstance(one, np.ndarray)]


def again(value: Value) -> tuple[Value, Value]:
    return pickle.loads(pickle.dumps(value)), copy.deepcopy(value)


def test_the_values_of_the_interface_are_among_those_tested(values):
    kinds = {type(one).__name__ for one in values}
    wanted = "Calibration Recording Readings Noise Beam Plane Fit JointCovariance Parameters Mounts"
    assert {*wanted.split(), "HoldOut", "RangeErrorPrior", "CrossCheck", "Validation"} <= kinds


def test_copies_are_equal_and_cannot_be_written_to(values):
    for value in values:
        assert value == value
        for other in again(value):
            assert type(other) is type(value)
            assert other == value
            assert not any(array.flags.writeable for array in (*arrays(value), *arrays(other)))


def test_values_that_differ_in_one_number_are_not_equal(values):
    for value in values:
        for field in dataclasses.fields(value):
            number = getattr(value, field.name)
            if not (isinstance(number, np.ndarray) and number.size and number.dtype == float):
                continue
            changed = number.copy()
            changed.flat[-1] = 17.25
            other = copy.deepcopy(value)
            object.__setattr__(other, field.name, changed)
            assert other != value, (type(value), field.name)


def test_values_have_no_hash_since_arrays_have_none(values):
    for value in values:
        with pytest.raises(TypeError, match="unhashable"):
            hash(value)


def test_representations_are_short(values):
    for value in values:
        assert len(repr(value)) <= MOST_CHARACTERS, type(value)
        assert repr(value).startswith(f"{type(value).__name__}(")


def test_representations_show_small_numbers_and_sizes():
    assert repr(hl.Noise(range_sigma=3e-5)) == "Noise(range_sigma=3e-05)"
    lot = hl.data.RangeErrorPrior(np.ones((2, 3)), np.ones((24, 4)))
    assert repr(lot) == "RangeErrorPrior(sigma=[[1., 1., 1.], [1., 1., 1.]], mean=<array 24x4>)"


def test_a_mapping_stays_read_only_in_copies(values):
    calibration = values[0]
    for other in (calibration, *again(calibration)):
        with pytest.raises(TypeError):
            other.beams["another"] = other.beams["1"]


@pytest.mark.parametrize(
    ("a", "b", "equal"),
    [
        (np.nan, np.nan, True),
        (np.array([np.nan, 1.0]), np.array([np.nan, 1.0]), True),
        (np.array([np.nan, 1.0]), np.array([1.0, np.nan]), False),
        (np.array([1.0]), np.array([1.0, 1.0]), False),
        (np.ones((1, 2)), np.ones(2), False),
        (np.ones(1), 1.0, False),
        (None, np.ones(1), False),
        (np.array(["a"]), np.array(["a"]), True),
        ((1.0, np.nan), (1.0, np.nan), True),
        ((1.0,), (1.0, 2.0), False),
        ({"a": 1, "b": 2}, {"b": 2, "a": 1}, False),
        ({"a": np.ones(1)}, {"a": np.ones(1)}, True),
        ("word", "other", False),
    ],
)
def test_fields_are_the_same(a, b, equal):
    assert same(a, b) is equal
    assert same(b, a) is equal


def test_who_holds_arrays_is_a_value():
    """Dataclasses without arrays compare as they are; their hash then follows their fields."""
    with_gtsam = {hl.solvers.LevenbergResult, hl.solvers.CalibrationGraph, hl.solvers.PosePriors}
    for kind in annotations.reachable() - with_gtsam:
        if dataclasses.is_dataclass(kind) and not annotations.is_inside(kind):
            array = "ndarray" in str(typing.get_type_hints(kind, None, annotations.LATE))
            assert issubclass(kind, Value) or not array, kind
            assert issubclass(kind, Value) == (kind.__hash__ is None), kind
