"""What a session becomes as planes come and go, as beams move, and beside the batch solution."""

from dataclasses import replace

import numpy as np

from ..data.recording import join
from ..errors import GrazingBeamError, InputError
from ..pipeline import calibrate
from ..quantities import FAR_SIGMAS, SAME_OPTIMUM
from ..results.calibration import Calibration
from .config import Given, ProcessNoise, SessionConfig
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
    now: AnyState | None, contents: Contents, given: Given
) -> tuple[AnyState | None, Update]:
    """Calibrate everything together, and start from there if that converges.

    Raises
    ------
    InputError
        The readings of a new beam do not determine it, or a beam has moved before it came.
    """
    if now is not None and now.config.links:
        beam = "a new beam after another one was split"
        raise InputError(beam, "a session of its own for it")
    noise, options, _ = given
    waits = Update((), contents.waiting, UNKNOWN, None, None)
    try:
        batch = calibrate(contents.everything(), noise, options)
    except InputError as error:
        if now is not None or not options.free:
            raise
        return None, replace(waits, message=str(error))  # the first planes may have no such error
    if batch.status != "converged":
        if now is not None:  # a new beam that is not determined: nothing is lost
            raise InputError(f"a new beam ({batch.message})", "readings that determine it")
        return None, replace(waits, message=batch.message)
    config = SessionConfig.of(batch, given)
    new = (FreedState.of if options.free else _begun_from)(batch, contents, config)
    return new, Update(
        tuple(new.contents.numbers),
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
        if inconsistent and new.config.reject and not (new.trusted or new.config.links):
            batch, config = _batch(new)
            if batch.status == "converged":
                new, message = _begun_from(batch, new.contents, config), RESTARTED
                joined, inconsistent = tuple(new.contents.numbers), ()
        new, comparison = compare_if_due(new)
    begun_again = message or (comparison is not None and comparison.changes)
    same = new.config.names == now.config.names
    gain = 0.5 * (new.integrated.information - now.integrated.information)
    if begun_again or not same or new.config.terms != now.config.terms:
        gain = UNKNOWN
    old = set(now.contents.rejected)
    return new, Update(
        joined,
        new.contents.waiting,
        gain,
        new.integrated.sigmas(),
        now.integrated.sigmas() if same else None,
        message,
        tuple(reading for reading in new.contents.rejected if reading not in old),
        new.moved(recently=True),
        inconsistent,
        comparison,
    )


def compare_if_due(now: SessionState) -> tuple[SessionState, Comparison | None]:
    """Compare with the batch solution where that is due; return what follows from it."""
    every = now.config.incremental.compare_every
    due = max(LEAST_CHANGES, min(every, len(now.contents.numbers) // 4))
    far = now.state.apart(now.compared.beams, now.compared.sigmas())[0] > FAR_SIGMAS
    if every == 0 or (now.changes < due and not far):
        return now, None
    config = _learned(now)
    changes = config.changes(now.config)
    if changes:
        now = begin(now.contents, config, now.state.beams)
        excluded = tuple(now.contents.excluded)
        if excluded:  # they may fit beside the new scales
            now, _, _ = now.changed(now.contents.included(excluded), excluded)
    inside = now.inside()
    comparison = inside.compared(now.integrated)
    if max(comparison.largest, comparison.largest_sigma) > SAME_OPTIMUM:
        words = "restarted from the batch solution, which it had left"
        changes = (*changes, Change("from-batch", words))
        now = begin(now.contents, now.config, inside.solved()[2].beams)
    planes = len(now.contents.numbers)
    now = replace(now, compared=now.state, changes=0, learned_with=planes)
    return now, replace(comparison, changes=changes)


def _learned(now: SessionState) -> SessionConfig:
    """Return the config that everything so far calls for: scales, and a range sigma not given."""
    config = now.config
    if config.learned is not None:
        learned = now.inside().learned(config.learned)
        sigma = float(learned.variances().range_sigma[0])
        return replace(config, learned=learned, sigma=sigma)
    if config.noise.range_sigma is not None or config.links:
        return config
    sigma, dof = now.inside().range_sigma()
    return replace(config, sigma=sigma, sigma_dof=float(dof))


def recalibrate(now: AnyState) -> tuple[AnyState, Comparison]:
    """Calibrate everything at once and compare; take over scales and outliers that differ."""
    if isinstance(now, FreedState):
        return now.recalibrated()
    if now.config.links:
        return now, now.inside().compared(now.integrated)
    batch, config = _batch(now)
    if batch.status != "converged":
        words = f"everything together does not converge: {batch.message}"
        found = now.inside().compared(now.integrated)
        return now, replace(found, changes=(Change("not-converged", words),))
    changes = config.changes(now.config)
    contents = now.contents.restarted(batch.fit.rejected)
    out = [{(r.station, r.beam) for r in each.rejected} for each in (contents, now.contents)]
    if out[0] != out[1]:
        changes = (*changes, Change("outliers", "outliers chosen again"))
    if now.contents.excluded:
        words = "planes that did not fit taken in again"
        changes = (*changes, Change("excluded-planes", words))
    if changes:  # from the estimate so far, not from what it is to be compared with
        order = [now.config.names.index(name) for name in batch.beams]
        r, v, k = (array[order] for array in now.state.beams)
        now = begin(contents, config, (r, v, k))
    now = replace(now, learned_with=len(now.contents.numbers))
    return now, Comparison(*now.config.apart(now.integrated, batch), changes)


def split_beam(
    now: AnyState,
    beam: str,
    since: str,
    sigmas: tuple[float, float, tuple[float, float]],
) -> SessionState:
    """Return a session in which a beam has moved before a plane; see `Session.split_beam`."""
    if isinstance(now, FreedState):
        expected = "two sessions, of the planes before and after it; or no errors that are free"
        raise InputError(f"a split of beam {beam} beside errors that are unknowns", expected)
    config, contents, before = now.config, now.contents, f"{beam} until {since}"
    if beam not in config.names or beam in contents.names:
        raise InputError(f"beam {beam!r}", f"one of {', '.join(contents.current(config.names))}")
    seen = {*contents.numbers, *contents.excluded}
    order = [plane for plane in contents.planes if plane in seen]
    if since not in order[1:] or before in config.names:
        raise InputError(
            f"a move of beam {beam} before plane {since!r}",
            "a plane with others before it, and every move once",
        )
    contents = contents.split(beam, since, before).included(order[order.index(since) :])
    for name in (before, beam):
        if not any(name in contents.planes[plane].recording.beam_names for plane in order):
            missing = f"no reading of beam {beam} on one side of plane {since}"
            raise InputError(missing, "some on both")
    index, count = config.names.index(beam), len(config.names)
    noise = ProcessNoise(count, index, *sigmas)
    old = tuple(replace(link, now=count) if link.now == index else link for link in config.links)
    learned = None if config.learned is None else config.learned.for_beams(count + 1)
    config = replace(
        config,
        names=(*config.names, before),
        terms=(*config.terms, config.terms[index]),
        links=(*old, noise),
        learned=learned,
    )
    r, v, k = (np.vstack((array, array[index])) for array in now.state.beams)
    try:
        return begin(contents, config, (r, v, k))
    except (RuntimeError, GrazingBeamError) as error:
        begun = _begun_from_nowhere(contents, config)
        if begun is None:
            raise InputError(
                f"a move that process noise of {noise.location_sigma:g} m and "
                f"{noise.direction_sigma:g} rad does not settle ({error})",
                "noise as large as the move, or more planes after it",
            ) from error
        return begun


def _begun_from_nowhere(contents: Contents, config: SessionConfig) -> SessionState | None:
    """Begin from a batch calibration: the beam has moved too far for the present estimate."""
    recording = join([plane.used() for plane in contents.planes.values()])
    options = replace(config.options, outliers="keep")
    calibration = calibrate(recording, replace(config.noise, range_sigma=config.sigma), options)
    if calibration.status != "converged":
        return None
    r, v, k = config.beams_of(calibration)
    estimated = np.arange(2) < np.array(config.terms)[:, None]
    try:
        return begin(contents, config, (r, v, np.where(estimated, k, 0.0)))
    except (RuntimeError, GrazingBeamError):
        return None


def _batch(now: SessionState) -> tuple[Calibration, SessionConfig]:
    """Return the batch calibration of everything, and what all planes have in common after it."""
    batch = calibrate(now.contents.everything(), now.config.noise, now.config.options)
    return batch, SessionConfig.of(batch, now.config.given)


def _begun_from(batch: Calibration, contents: Contents, config: SessionConfig) -> SessionState:
    """Begin from a batch calibration of everything."""
    return begin(contents.restarted(batch.fit.rejected), config, batch.parameters().beams)
