"""The verdict on a calibration that was validated by leaving planes out."""

from dataclasses import replace

from ..data.recording import Recording
from ..results.limits import Limits, rms_checked
from ..results.significance import chance, contradicted
from ..results.verdict import OPENING, Code, Verdict, failures, verdict
from .leave_out import Validation


def verdict_of_validation(
    validation: Validation,
    recording: Recording | None = None,
    limits: Limits | None = None,
    reading: float | None = None,
) -> Verdict:
    """Return the verdict on a calibration that was validated by leaving planes out.

    Beside that on the calibration itself: the rms limit holds for planes that were left out, too, and
    none of them contradicts the beams found without it.
    """
    found = verdict(validation.calibration, recording, limits, reading)
    left_out = {one.plane: one.result for one in validation.planes if one.result is not None}
    checks = tuple(
        check
        for plane, result in left_out.items()
        for check in rms_checked(f"without plane {plane}", result.rms, limits or Limits())
    )
    found = replace(found, limits=(*found.limits, *checks))
    p_values = {plane: result.p_value for plane, result in left_out.items()}
    against = contradicted(p_values)
    end = f"; best improvement: {found.improvement}"
    if not found.usable:
        return found
    if against:
        rarest = min(p_values[plane] for plane in against)
        planes = f"plane{'s' if len(against) > 1 else ''} {_some(against)}"
        verb = "contradict" if len(against) > 1 else "contradicts"
        words = (
            f"{planes} {verb} the beams found without it (by chance {chance(rarest)} recordings)"
        )
        return _rejected(found, "contradicted", words + end)
    if found.exceeded:
        return _rejected(found, "outside-limits", failures(found.limits) + end)
    if not p_values:
        return found
    tested = "1 plane" if len(p_values) == 1 else f"{len(p_values)} planes"
    confirmed = f"{OPENING[found.code]}, confirmed by {tested} left out"
    return replace(found, sentence=found.sentence.replace(OPENING[found.code], confirmed, 1))


def _rejected(found: Verdict, code: Code, words: str) -> Verdict:
    return replace(found, usable=False, code=code, sentence=f"{OPENING[code]}: {words}.")


def _some(names: tuple[str, ...], most: int = 4) -> str:
    shown = ", ".join(names[:most])
    return shown + (f" and {len(names) - most} more" if len(names) > most else "")
