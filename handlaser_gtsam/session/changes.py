"""What a session becomes when planes come, change or go, and its distance from a batch solution."""

from dataclasses import replace

from ..data.noise import Noise
from ..errors import InputError
from ..estimation.options import CalibrationOptions
from ..pipeline import calibrate
from ..quantities import FAR_SIGMAS, SAME_OPTIMUM
from ..results.calibration import Calibration
from .config import SessionConfig
from .contents import Contents
from .freed import FreedState
from .reports import Change, Comparison, Update
from .state import SessionState, begin

AnyState = SessionState | FreedState

RESTARTED = (
    "restarted from everything: the planes so far did not fit the calibration they began with"
)
UNKNOWN = float("nan")
LEAST_CHANGES = 4
"""Changes between two comparisons with the batch solution at least: a comparison takes its time."""


def started(
    now: AnyState | None, contents: Contents, noise: Noise, options: CalibrationOptions
) -> tuple[AnyState | None, Update]:
    """Calibrate everything together, and start from there if that converges.

    Raises
    ------
    InputError
        The readings of a new beam do not determine it.
    """
    waits = Update((), contents.waiting, UNKNOWN, None, None)
    try:
        batch = calibrate(contents.recording(), noise, options)
    except InputError as error:
        if now is not None or not options.free:
            raise
        return None, replace(waits, message=str(error))  # the first planes may have no such error
    if batch.status != "converged":
        if now is not None:  # a new beam that is not determined: nothing is lost
            raise InputError(f"a new beam ({batch.message})", "readings that determine it")
        return None, replace(waits, message=batch.message)
    new: AnyState
    config = SessionConfig.of(batch, noise, options)
    if options.free:
        new = FreedState.of(batch, contents, config)
    else:
        new = begin(contents.restarted(batch.fit.rejected), config, batch.parameters().beams)
    return new, Update(
        tuple(new.contents.inside),
        new.contents.waiting,
        UNKNOWN,
        new.integrated.sigmas(),
        None,
        rejected=new.contents.rejected,
        moved=new.moved(),
    )


def changed(now: AnyState, contents: Contents, planes: tuple[str, ...]) -> tuple[AnyState, Update]:
    """Bring a session to `contents`, in which only `planes` differ from the present ones.

    Raises
    ------
    InputError
        The beams would not be determined.
    """
    new: AnyState
    new, joined, inconsistent = now.changed(contents, planes)
    comparison, message = None, ""
    if isinstance(new, SessionState):
        if inconsistent and new.config.reject and not new.trusted:
            batch, config = _batch(new)
            if batch.status == "converged":
                contents = new.contents.restarted(batch.fit.rejected)
                new, message = begin(contents, config, batch.parameters().beams), RESTARTED
                joined, inconsistent = tuple(new.contents.inside), ()
        new, comparison = compare_if_due(new)
    begun_again = message or (comparison is not None and comparison.changes)
    gain = 0.5 * (new.integrated.information - now.integrated.information)
    old = set(now.contents.rejected)
    return new, Update(
        joined,
        new.contents.waiting,
        UNKNOWN if begun_again else gain,
        new.integrated.sigmas(),
        now.integrated.sigmas(),
        message,
        tuple(reading for reading in new.contents.rejected if reading not in old),
        new.moved(recently=True),
        inconsistent,
        comparison,
    )


def compare_if_due(now: SessionState) -> tuple[SessionState, Comparison | None]:
    """Compare with the batch solution where that is due; return what follows from it."""
    due = max(LEAST_CHANGES, len(now.contents.inside) // 4)
    far = now.state.apart(now.compared.beams, now.compared.sigmas())[0] > FAR_SIGMAS
    if now.changes < due and not far:
        return now, None
    config = now.learned()
    changes = config.changes(now.config)
    if changes:
        now = begin(now.contents, config, now.state.beams)
        excluded = tuple(now.contents.excluded)
        if excluded:  # they may fit beside the new scales
            now, _, _ = now.changed(now.contents.included(), excluded)
    comparison = now.compare()
    if max(comparison.largest, comparison.largest_sigma) > SAME_OPTIMUM:
        words = "restarted from the batch solution, which it had left"
        changes = (*changes, Change("from-batch", words))
        now = begin(now.contents, now.config, now.batch.solution.parameters.beams)
    planes = len(now.contents.inside)
    now = replace(now, compared=now.state, changes=0, learned_with=planes)
    return now, replace(comparison, changes=changes)


def recalibrate(now: AnyState) -> tuple[AnyState, Comparison]:
    """Calibrate everything at once and compare; take over scales and outliers that differ."""
    if isinstance(now, FreedState):
        return now.recalibrated()
    batch, config = _batch(now)
    if batch.status != "converged":
        words = f"everything together does not converge: {batch.message}"
        return now, replace(now.compare(), changes=(Change("not-converged", words),))
    changes = config.changes(now.config)
    contents = now.contents.restarted(batch.fit.rejected)
    out = [{(r.station, r.sensor) for r in each.rejected} for each in (contents, now.contents)]
    if out[0] != out[1]:
        changes = (*changes, Change("outliers", "outliers chosen again"))
    if now.contents.excluded:
        words = "planes that did not fit taken in again"
        changes = (*changes, Change("excluded-planes", words))
    if changes:  # from the estimate so far, not from what it is to be compared with
        order = [now.config.names.index(name) for name in batch.beams]
        r, v, k = (array[order] for array in now.state.beams)
        now = begin(contents, config, (r, v, k))
    now = replace(now, learned_with=len(now.contents.inside))
    return now, Comparison(*now.config.apart(now.integrated, batch), changes)


def split_beam(now: AnyState, beam: str, since: str) -> AnyState:
    """Return a session in which a beam has moved before a plane; see `Session.split_beam`."""
    contents = now.contents
    present = [name for name in now.config.names if name not in contents.names]
    if beam not in present:
        raise InputError(f"beam {beam!r}", f"one of {', '.join(present)}")
    before = f"{beam} until {since}"
    if since not in list(contents.planes)[1:] or before in contents.names:
        raise InputError(
            f"a move of beam {beam} before plane {since!r}",
            "a plane with others before it, and every move once",
        )
    split = contents.split(beam, since)
    if not {beam, before} <= set(split.recording().beam_names):
        raise InputError(f"no reading of beam {beam} on one side of plane {since}", "some on both")
    new, _ = started(now, split, now.config.noise, now.config.options)
    assert new is not None, "what does not determine the beams is refused"
    return new


def _batch(now: SessionState) -> tuple[Calibration, SessionConfig]:
    """Return the batch calibration of everything, and what all planes have in common after it."""
    noise, options = now.config.noise, now.config.options
    batch = calibrate(now.contents.recording(), noise, options)
    return batch, SessionConfig.of(batch, noise, options)
