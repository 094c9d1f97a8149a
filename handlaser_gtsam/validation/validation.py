"""What a recording says about its own calibration, and the verdict after that.

Parts of it are predicted by the rest. A part is a plane or another target, or a random choice of the
stations. The same types hold what was found of beams before planes and of surveys.
"""

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from ..arrays import BoolArray, IntArray
from ..data.value import Value
from ..errors import CalibrationWarning, HandlaserError
from ..model.distributions import FAMILY_LEVEL, SINGLE_LEVEL, chance, contradicted
from ..progress import tell
from ..results.calibration import Calibration
from ..results.limits import Limits, rms_checked
from ..results.lines import NAMES_IN_LINE
from ..results.survey import SurveyCalibration
from ..results.survey_verdict import survey_verdict
from ..results.verdict import Verdict, failures, failures_of, verdict
from ..text import some
from .cross_check import CrossCheck
from .other_recording import HoldOut
from .prediction import Prediction, SurveyPrediction

DISAGREES = "reference-disagrees"
"""Code of the cause that SciPy finds another solution."""
PART_LEFT_OUT = 0.3
"""Part of the stations that a random split predicts; before planes, of the stations of every plane."""
USUAL_SPLITS = 5
"""Random splits of the stations: enough to see how predictions scatter; each takes a calibration."""
Predicted = HoldOut | Prediction | SurveyPrediction
"""How the rest predicts a part."""


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class LeftOut(Value):
    """A part of a recording, and how a calibration without it predicts it.

    Attributes
    ----------
    name : str
        The label of a target, or the number of a random split.
    result : HoldOut, Prediction, SurveyPrediction or None
        A `HoldOut` of a plane that beams see, a `Prediction` of a random split of such a recording, a
        `SurveyPrediction` of any part of a survey. None where there is no prediction.
    message : str
        Why there is none.
    """

    name: str
    result: Predicted | None
    message: str = ""

    @property
    def p_value(self) -> float:
        """Probability that chance makes the part differ more from the rest; NaN without a test."""
        found = self.result
        return found.p_value if isinstance(found, HoldOut | SurveyPrediction) else math.nan


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Validation(Value):
    """What a recording says about its own calibration.

    Attributes
    ----------
    calibration : Calibration or SurveyCalibration
        From everything.
    targets : tuple of LeftOut
        Every plane, or other target, predicted from the rest; empty where there is one only.
    splits : tuple of LeftOut
        Random 30 % of the stations, drawn plane by plane for beams before planes, predicted from the
        others.
    reconstructions : tuple of Prediction
        The plane reconstructed from all beams at one station predicts the ranges at the others
        (section 3.2 of Wei and Hirzinger), with the range errors chosen and with none; empty where no
        station has three beams that span a plane, and of surveys.
    reference : CrossCheck or None
        The survey solved again by SciPy; None of beams before planes, which `cross_check` solves again.
    """

    calibration: Calibration | SurveyCalibration
    targets: tuple[LeftOut, ...]
    splits: tuple[LeftOut, ...]
    reconstructions: tuple[Prediction, ...] = ()
    reference: CrossCheck | None = None

    @property
    def predictions(self) -> tuple[Prediction, ...]:
        """The errors of the random splits of beams before planes that could be predicted."""
        found = (one.result for one in self.splits)
        return tuple(one for one in found if isinstance(one, Prediction))

    @property
    def contradicted(self) -> tuple[LeftOut, ...]:
        """What the rest does not predict.

        Chance alone names any part of one of 100 recordings, or of one of 1000 surveys.
        """
        level = SINGLE_LEVEL if isinstance(self.calibration, SurveyCalibration) else FAMILY_LEVEL
        parts = (*self.targets, *self.splits)
        p_values = {number: one.p_value for number, one in enumerate(parts)}
        return tuple(parts[number] for number in contradicted(p_values, level))

    @property
    def contradiction(self) -> str:
        """What is contradicted, in words; empty where nothing is."""
        against = self.contradicted
        names = [one.name for one in against]
        if not against:
            return ""
        if isinstance(self.calibration, SurveyCalibration):
            which = f"(p below {SINGLE_LEVEL:g}): {', '.join(names)}"
            return f"what the rest of the survey does not predict {which}"
        rarest = chance(min(one.p_value for one in against))
        words = f"planes {some(names, NAMES_IN_LINE)} contradict"
        if len(names) == 1:
            words = f"plane {names[0]} contradicts"
        return f"{words} the beams found without it (by chance {rarest} recordings)"

    @property
    def disagreement(self) -> str:
        """What SciPy, which solves all points by themselves, finds otherwise; empty where it agrees."""
        found = "" if self.reference is None else self.reference.difference
        if not found:
            return ""
        return (
            f"SciPy, point by point, finds {found}: do not use this calibration; shots are too noisy, "
            "or have too few points, for their targets: look at larger parts of them, from nearer"
        )

    @property
    def verdict(self) -> Verdict:
        """The verdict on the calibration after these tests, without limits."""
        return verdict_of_validation(self)

    @property
    def usable(self) -> bool:
        """Whether the calibration is usable, SciPy agrees, and every part is predicted by the rest."""
        return self.verdict.usable


def verdict_of_validation(validation: Validation, limits: Limits | None = None) -> Verdict:
    """Return the verdict on a calibration after its validation.

    Beside the verdict on the calibration itself: SciPy agrees where it was asked, the rest predicts
    every part, and the rms limit holds for each plane as the beams found without it fit it.
    """
    calibration, limits = validation.calibration, limits or Limits()
    if isinstance(calibration, SurveyCalibration):
        judged = survey_verdict(calibration, limits)
        last = []  # what the rest does not predict, or SciPy finds otherwise, is all to look at
    else:
        judged = verdict(calibration, limits)
        last = [judged.best.clause]
    held = [(one.name, one.result) for one in validation.targets]
    fitted = [(name, found.rms) for name, found in held if isinstance(found, HoldOut)]
    of_planes = (rms_checked(f"without plane {name}", rms, limits) for name, rms in fitted)
    checks = tuple(check for found in of_planes for check in found)
    against = tuple(one.name for one in validation.contradicted)
    judged = replace(judged, limits=(*judged.limits, *checks))
    if not judged.usable:
        return judged
    why = []
    if validation.reference is not None and validation.disagreement:
        of = validation.reference
        values: dict[str, float | str] = {"parameter": of.parameter, "difference": of.largest}
        if of.largest <= of.allowed:
            values = {"parameter": of.sigma_parameter, "difference": of.largest_sigma}
        why.append(CalibrationWarning(DISAGREES, validation.disagreement, values))
    if against:
        values = {"parts": ", ".join(against)}
        why.append(CalibrationWarning("not-predicted", validation.contradiction, values))
    code = "contradicted"
    findings = [one.message for one in why]
    if not why:
        code = "outside-limits"
        why = list(failures_of(checks))
        findings = [failures(checks)]
    if not why:
        return replace(judged, confirmed_by=len(fitted))
    causes = (*why, *judged.causes)
    return replace(judged, code=code, findings=(*findings, *last), causes=causes)


def leave_out(
    targets: Mapping[str, BoolArray],
    splits: Iterable[BoolArray],
    of_target: Callable[[BoolArray], Predicted],
    of_split: Callable[[BoolArray], Predicted],
    total: int,
    *,
    kind: str = "",
) -> tuple[tuple[LeftOut, ...], tuple[LeftOut, ...]]:
    """Predict targets, and random splits, from what is left without each.

    Parameters
    ----------
    targets : mapping of str to (M,) of bool
        The stations before each target.
    splits : iterable of (M,) of bool
        The stations that each leaves out.
    of_target, of_split : callable
        Predict such stations from the others; a HandlaserError says why that cannot be.
    total : int
        How many steps the progress counts, with what precedes and follows.
    kind : str
        What precedes the name of a target in the progress.

    Returns
    -------
    targets, splits : tuple of LeftOut
    """

    def predicted(name: str, predict: Callable[[BoolArray], Predicted], out: BoolArray) -> LeftOut:
        try:
            return LeftOut(name, predict(out))
        except HandlaserError as error:
            return LeftOut(name, None, str(error))

    found, drawn = [], []
    for done, (name, out) in enumerate(targets.items(), 1):
        tell("leave-out", done, total, f"without {kind}{name}")
        found.append(predicted(name, of_target, out))
    for number, out in enumerate(splits, 1):
        tell("leave-out", len(targets) + number, total, f"split {number}")
        drawn.append(predicted(f"{number}", of_split, out))
    return tuple(found), tuple(drawn)


def drawn(groups: IntArray, rng: np.random.Generator) -> BoolArray:
    """Return which of N stations, or stops, a random split leaves out: 30 % of every group (N,)."""
    out = np.zeros(len(groups), dtype=bool)
    for group in np.unique(groups):
        members = rng.permutation(np.flatnonzero(groups == group))
        out[members[: round(PART_LEFT_OUT * len(members))]] = True
    return out
