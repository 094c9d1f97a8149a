"""What a recording says about its own calibration, and the verdict after that."""

from dataclasses import dataclass, replace

from ..data.value import Value
from ..errors import CalibrationWarning
from ..model.distributions import FAMILY_LEVEL, SINGLE_LEVEL, chance, contradicted
from ..quantities import IN_PERCENT
from ..results.calibration import Calibration
from ..results.limits import Limits, rms_checked
from ..results.lines import NAMES_IN_LINE
from ..results.survey import SurveyCalibration
from ..results.survey_verdict import survey_verdict
from ..results.verdict import Verdict, failures, failures_of, verdict
from ..text import some
from .cross_check import CrossCheck
from .leave_out import LeftOut
from .other_recording import HoldOut
from .prediction import Prediction

LARGEST_DIFFERENCE = 0.5
"""A parameter may differ from SciPy's by this many of its standard deviations, and a standard deviation
by this part. Shots are condensed to first order in their noise: of balls that are read with a noise of
2 % of the range they differ by up to 0.47, which makes errors a tenth larger than is stated."""
DISAGREES = "reference-disagrees"
"""Code of the cause that SciPy finds another solution."""


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
        reference = self.reference
        if reference is None:
            return ""
        if reference.largest > LARGEST_DIFFERENCE:
            found = f"finds another solution, by {reference.difference}"
        elif reference.largest_sigma > LARGEST_DIFFERENCE:
            percent = IN_PERCENT * reference.largest_sigma
            found = (
                f"finds standard deviations that differ by {percent:.0f} % in "
                f"{reference.sigma_parameter}"
            )
        else:
            return ""
        return (
            f"SciPy, point by point, {found}: do not use this calibration; shots are too noisy, or "
            "have too few points, for their targets: look at larger parts of them, from nearer"
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
    held = {one.name: one.result for one in validation.targets}
    fitted = {name: found for name, found in held.items() if isinstance(found, HoldOut)}
    checks = tuple(
        check
        for name, found in fitted.items()
        for check in rms_checked(f"without plane {name}", found.rms, limits)
    )
    against = tuple(one.name for one in validation.contradicted)
    judged = replace(judged, limits=(*judged.limits, *checks))
    if not judged.usable:
        return judged
    why = []
    if validation.reference is not None and validation.disagreement:
        of = validation.reference
        values: dict[str, float | str] = {"parameter": of.parameter, "difference": of.largest}
        if of.largest <= LARGEST_DIFFERENCE:
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
