"""How well a calibration predicts readings that it has not seen.

A reading that was rejected as an outlier of the whole recording stays rejected.
"""

from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from ..arrays import BoolArray
from ..checks import require_count, require_kind
from ..data.noise import Noise
from ..data.recording import Recording
from ..data.value import Value
from ..errors import InputError, SolverError
from ..estimation.options import CalibrationOptions
from ..model.distributions import chance, contradicted
from ..pipeline import calibrate, calibrate_from
from ..progress import Listener, tell, told_to
from ..results.calibration import Calibration
from ..results.limits import Limits, rms_checked
from ..results.lines import NAMES_IN_LINE
from ..results.mounts import Mounts
from ..results.verdict import Verdict, failures, verdict
from ..text import some
from .hold_out import HoldOut, hold_out
from .prediction import Prediction, predict, reconstruction
from .simulate import generator

PART_LEFT_OUT = 0.3
"""Part of the stations that a random split predicts; in recordings, of the stations of every plane."""
USUAL_SPLITS = 5
"""Random splits of the stations: enough to see how predictions scatter; each takes a calibration."""


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class PlaneLeftOut(Value):
    """A calibration without one plane, and how its beams fit that plane; None where it failed."""

    plane: str
    result: HoldOut | None
    message: str


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Validation(Value):
    """What a recording says about its own calibration.

    Attributes
    ----------
    calibration : Calibration
        From everything.
    planes : tuple of PlaneLeftOut
        Empty where there is one plane only.
    splits : tuple of Prediction
        30 % of the stations of every plane, predicted from the others.
    reconstruction, without_range_error : Prediction or None
        The plane reconstructed from all beams at one station predicts the ranges at the others
        (section 3.2 of Wei and Hirzinger), with the range errors chosen and with none; None where no
        station has three beams that span a plane.
    """

    calibration: Calibration
    planes: tuple[PlaneLeftOut, ...]
    splits: tuple[Prediction, ...]
    reconstruction: Prediction | None
    without_range_error: Prediction | None


def validate(
    recording: Recording,
    noise: Noise | None = None,
    options: CalibrationOptions | None = None,
    *,
    splits: int = USUAL_SPLITS,
    rng: np.random.Generator | None = None,
    progress: Listener | None = None,
) -> Validation:
    """Validate the calibration of a recording by leaving parts of it out.

    Parameters
    ----------
    recording : Recording
    noise : Noise, optional
    options : CalibrationOptions, optional
    splits : int
        Random 70/30 splits.
    rng : numpy.random.Generator, optional
        Chooses the splits; the same ones each time where not given.
    progress : callable, optional
        Called with a `Progress` before every calibration, and in every phase of each.

    Raises
    ------
    InputError
        No sensible number of splits, or what `calibrate` refuses.
    SolverError
        The whole recording gives no calibration.
    """
    require_count("splits", splits, 0, 10**9)
    rng, noise = generator(rng), Noise() if noise is None else noise
    of_surveys = "a Recording; hl.validation.validate_survey takes a Survey"
    require_kind("recording", recording, Recording, of_surveys)
    options = CalibrationOptions() if options is None else options
    with told_to(progress):
        planes = recording.plane_names if len(recording.plane_names) > 1 else ()
        total = 2 + len(planes) + splits
        tell("leave-out", 0, total, "everything")
        whole = _ended(calibrate(recording, noise, options))
        if whole.status != "converged":
            raise SolverError(f"no calibration to validate: {whole.message}")
        kept = whole.used_in(recording)
        # Errors that are unknowns are taken out of all readings as the whole recording has them.
        keep = replace(options, outliers="keep", free=())
        left_out = []
        for number, plane in enumerate(planes):
            tell("leave-out", 1 + number, total, f"without plane {plane}")
            mine = np.array([label == plane for label in kept.plane_labels])
            result, message = None, ""
            try:
                others = _ended(calibrate(*_part(kept, noise, ~mine), keep))
                message = others.message
                if others.status == "converged":
                    held, seen = _part(kept, noise, mine)
                    seen = others.noise(seen) if others.noise_estimate else seen
                    result, message = hold_out(Mounts.of(others), held, seen), ""
            except InputError as error:
                message = str(error)
            left_out.append(PlaneLeftOut(plane, result, message))
        predictions = []
        for number in range(splits):
            tell("leave-out", 1 + len(planes) + number, total, f"split {number + 1}")
            training = training_stations(kept, rng)
            with suppress(InputError):  # without a calibration there is no prediction
                calibration = calibrate(*_part(kept, noise, training), keep)
                predictions.append(predict(calibration, *_part(kept, noise, ~training)))
        tell("leave-out", total - 1, total, "without range error")
        bare = _ended(
            calibrate_from(whole.parameters(), kept, noise, replace(keep, range_error="none"))
        )
        return Validation(
            whole,
            tuple(left_out),
            tuple(predictions),
            reconstruction(whole, kept),
            reconstruction(bare, kept),
        )


def _ended(calibration: Calibration) -> Calibration:
    """Return a calibration; Ctrl-C in it ends everything."""
    if calibration.interrupted:
        raise KeyboardInterrupt
    return calibration


def _part(recording: Recording, noise: Noise, stations: BoolArray) -> tuple[Recording, Noise]:
    """Return some stations, with their beams that read anything, and their noise."""
    rows = np.flatnonzero(stations & ~np.isnan(recording.ranges).all(axis=1))
    S = noise.pose_covariance
    seen = noise if S is None or S.ndim == 2 else replace(noise, pose_covariance=S[rows])
    return recording.part(rows), seen


def training_stations(recording: Recording, rng: np.random.Generator) -> BoolArray:
    """Return which stations (M,) a split calibrates with: 70 % of the stations of every plane."""
    training = np.zeros(len(recording.plane_labels), dtype=bool)
    for plane in range(len(recording.plane_names)):
        rows = np.flatnonzero(recording.plane_of_station == plane)
        training[rng.permutation(rows)[: int(np.ceil((1.0 - PART_LEFT_OUT) * len(rows)))]] = True
    return training


def verdict_of_validation(validation: Validation, limits: Limits | None = None) -> Verdict:
    """Return the verdict on a calibration that was validated by holding planes out.

    Beside the verdict on the calibration itself: the rms limit holds for planes held out, too, and
    none of them contradicts the beams found without it.
    """
    found = verdict(validation.calibration, limits)
    left_out = {one.plane: one.result for one in validation.planes if one.result is not None}
    checks = tuple(
        check
        for plane, result in left_out.items()
        for check in rms_checked(f"without plane {plane}", result.rms, limits or Limits())
    )
    p_values = {plane: result.p_value for plane, result in left_out.items()}
    against, last = contradicted(p_values), found.best.clause
    found = replace(found, limits=(*found.limits, *checks), contradicted_by=against)
    if not found.usable:
        return found
    if against:
        rarest = chance(min(p_values[plane] for plane in against))
        words = f"planes {some(against, NAMES_IN_LINE)} contradict"
        if len(against) == 1:
            words = f"plane {against[0]} contradicts"
        words = f"{words} the beams found without it (by chance {rarest} recordings)"
        return replace(found, code="contradicted", findings=(words, last))
    if found.exceeded:
        return replace(found, code="outside-limits", findings=(failures(found.limits), last))
    return replace(found, confirmed_by=len(p_values))
