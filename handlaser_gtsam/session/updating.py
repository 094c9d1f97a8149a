"""What a session becomes when planes and stations come and go, and when a beam has moved."""

from dataclasses import replace

import numpy as np

from ..data.parameters import Beams
from ..data.recording import join
from ..errors import GrazingBeamError, InputError
from ..pipeline import calibrate
from .beginning import SessionArguments, beams_of
from .comparing import compare_if_due
from .config import ProcessNoise, SessionConfig
from .contents import Contents
from .reports import Update
from .state import SessionState, begin

RESTARTED = (
    "restarted from everything: the planes so far did not fit the calibration they began with"
)
UNKNOWN = float("nan")


def started(
    now: SessionState | None, contents: Contents, given: SessionArguments
) -> tuple[SessionState | None, Update]:
    """Calibrate everything together, and start the graph from there if that converges.

    Raises
    ------
    InputError
        The readings of a new beam do not determine it, or a beam has moved before it came.
    """
    if now is not None and now.config.links:
        beam = "a new beam after another one was split"
        raise InputError(beam, "a session of its own for it")
    batch = given.calibrated(contents)
    if batch.status != "converged":
        if now is not None:  # a new beam that is not determined: nothing is lost
            raise InputError(f"a new beam ({batch.message})", "readings that determine it")
        return None, Update((), contents.waiting, UNKNOWN, None, None, batch.message)
    new = given.begun(contents, batch)
    new = replace(new, estimate=new.integrated())
    return new, Update(
        tuple(new.contents.numbers),
        new.contents.waiting,
        UNKNOWN,
        new.integrated().sigmas(),
        None,
        rejected=new.contents.rejected,
        moved=new.moved(),
    )


def changed(
    now: SessionState, contents: Contents, planes: tuple[str, ...], given: SessionArguments
) -> tuple[SessionState, Update]:
    """Bring a session to `contents`, in which only `planes` differ from the present ones.

    Raises
    ------
    InputError
        The beams would not be determined.
    """
    new, joining = now.changed(contents, planes, reject=given.reject)
    gain, restarted = 0.5 * (new.state.information - now.state.information), False
    if joining.inconsistent and given.reject and not (new.trusted or new.config.links):
        batch = given.calibrated(new.contents)
        restarted = batch.status == "converged"
        new = given.begun(new.contents, batch) if restarted else new
    new, comparison = compare_if_due(new)
    if restarted or (comparison is not None and comparison.changes):
        gain = UNKNOWN
    new = replace(new, estimate=new.integrated())
    old = set(now.contents.rejected)
    return new, Update(
        tuple(new.contents.numbers if restarted else joining.fitted),
        new.contents.waiting,
        gain,
        new.integrated().sigmas(),
        now.integrated().sigmas() if new.config.names == now.config.names else None,
        RESTARTED if restarted else "",
        tuple(reading for reading in new.contents.rejected if reading not in old),
        new.moved(recently=True),
        () if restarted else joining.inconsistent,
        comparison,
    )


def split_beam(
    now: SessionState,
    given: SessionArguments,
    beam: str,
    since: str,
    sigmas: tuple[float, float, tuple[float, float]],
) -> SessionState:
    """Return a session in which a beam has moved before a plane; see `Session.split_beam`."""
    config, before = now.config, f"{beam} until {since}"
    contents = _split_contents(now, beam, since, before)
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
        return begin(contents, config, (r, v, k), given.incremental)
    except (RuntimeError, GrazingBeamError) as error:
        begun = _begun_from_nowhere(contents, config, given)
        if begun is None:
            raise InputError(
                f"a move that process noise of {noise.location_sigma:g} m and "
                f"{noise.direction_sigma:g} rad does not settle ({error})",
                "noise as large as the move, or more planes after it",
            ) from error
        return begun


def _split_contents(now: SessionState, beam: str, since: str, before: str) -> Contents:
    """Return the contents with the beam renamed before the move.

    Raises
    ------
    InputError
        No such beam or plane, no plane before it, no reading on one side, or a move that is known.
    """
    names, contents = now.config.names, now.contents
    if beam not in names or beam in contents.names:
        raise InputError(f"beam {beam!r}", f"one of {', '.join(now.current)}")
    seen = {*contents.numbers, *contents.excluded}
    order = [plane for plane in contents.planes if plane in seen]
    if since not in order[1:] or before in names:
        raise InputError(
            f"a move of beam {beam} before plane {since!r}",
            "a plane with others before it, and every move once",
        )
    split = contents.split(beam, since, before).included(order[order.index(since) :])
    for name in (before, beam):
        if not any(name in split.planes[plane].recording.beam_names for plane in order):
            missing = f"no reading of beam {beam} on one side of plane {since}"
            raise InputError(missing, "some on both")
    return split


def _begun_from_nowhere(
    contents: Contents, config: SessionConfig, given: SessionArguments
) -> SessionState | None:
    """Begin from a batch calibration: the beam has moved too far for the present estimate."""
    recording = join([plane.used() for plane in contents.planes.values()])
    options = replace(given.options, outliers="keep")
    calibration = calibrate(recording, replace(given.noise, range_sigma=config.sigma), options)
    if calibration.status != "converged":
        return None
    r, v, k = beams_of(calibration, config.names)
    estimated = np.arange(2) < np.array(config.terms)[:, None]
    beams: Beams = (r, v, np.where(estimated, k, 0.0))
    try:
        return begin(contents, config, beams, given.incremental)
    except (RuntimeError, GrazingBeamError):
        return None
