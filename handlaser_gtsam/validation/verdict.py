"""The verdict on a calibration that was validated by holding planes out."""

from dataclasses import replace

from ..results.limits import Limits, rms_checked
from ..results.lines import NAMES_IN_LINE
from ..results.significance import chance, contradicted
from ..results.verdict import Verdict, best_improvement, failures, verdict
from ..text import some
from .leave_out import Validation


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
    against, last = contradicted(p_values), best_improvement(found.best)
    found = replace(found, limits=(*found.limits, *checks), contradicted_by=against)
    if not found.usable:
        return found
    if against:
        rarest = chance(min(p_values[plane] for plane in against))
        words = f"{_planes(against)} the beams found without it (by chance {rarest} recordings)"
        return replace(found, code="contradicted", findings=(words, last))
    if found.exceeded:
        return replace(found, code="outside-limits", findings=(failures(found.limits), last))
    return replace(found, confirmed_by=len(p_values))


def _planes(names: tuple[str, ...]) -> str:
    if len(names) == 1:
        return f"plane {names[0]} contradicts"
    return f"planes {some(names, NAMES_IN_LINE)} contradict"
