"""Planes that join: fitted beside the beams, judged, and made into factors; nothing is changed yet."""

from collections.abc import Mapping

import numpy as np

from ..data.parameters import Beams
from ..data.recording import Recording
from ..model.families import MOUNT_DIM
from ..model.sensor import FLAT, Rejected, within_incidence
from ..outliers.snooping import price
from ..solvers.isam import BeamState, GraphPart
from .config import SessionConfig
from .contents import CONTRADICTED, Contents, named
from .drift import DriftHistory
from .fitted import FittedPlane, fit_plane, outliers

GROSS_ERROR = 0.02
"""Prior probability that a reading is a gross error."""
DISPLACED = 1e-3
"""Prior probability that a beam is displaced between two planes."""


def join_planes(
    config: SessionConfig,
    state: BeamState,
    contents: Contents,
    history: DriftHistory,
    planes: tuple[str, ...],
    *,
    reject: bool,
) -> tuple[Contents, DriftHistory, Mapping[str, FittedPlane], tuple[str, ...]]:
    """Join `planes` to the beams as they are, or take out those that are not determined.

    Parameters
    ----------
    config : SessionConfig
    state : BeamState
    contents : Contents
        With the changes of these planes in them.
    history : DriftHistory
    planes : tuple of str
    reject : bool
        Whether readings that the others contradict are rejected.

    Returns
    -------
    Contents
        With outliers rejected, and planes that are not determined out of the graph.
    DriftHistory
    joined : mapping of str to FittedPlane
        Planes that joined.
    inconsistent : tuple of str
        Planes that do not fit, whichever beam has moved a little. They are excluded, or join all the
        same where nothing is to be rejected.
    """
    joined: dict[str, FittedPlane] = {}
    inconsistent: list[str] = []
    free = max(contents.numbers.values(), default=-1) + 1
    for plane in planes:
        own = contents.planes.get(plane)
        fitted = None if own is None else fit_plane(config, own.used(), state.beams, own.origin)
        if own is None or fitted is None or not fitted.determined():
            contents = contents if own is None else contents.taken_out(plane)
            history = history.without_plane(plane)
            continue
        contents, fitted = _within_incidence(fitted, contents, plane, state)
        if reject:
            contents, fitted = _screened(fitted, contents, plane, state, history)
        known = fitted.information(history)
        if fitted.fits(known, history):
            history = history.with_plane(plane, known)
        else:
            history = history.without_plane(plane)
            inconsistent.append(plane)
            if reject:
                culprit = _culprit(fitted, contents.planes[plane].used(), state)
                contents = contents.taken_out(plane, culprit)
                continue
        number = free + len(joined) if own.number is None else own.number
        contents = contents.placed(plane, number, fitted.origin)
        joined[plane] = fitted
    return contents, history, joined, tuple(inconsistent)


def fitted_planes(
    contents: Contents, config: SessionConfig, beams: Beams
) -> Mapping[str, FittedPlane]:
    """Return the planes that are determined beside `beams`, and not excluded."""
    determined = {}
    for name, plane in contents.planes.items():
        fitted = None if plane.culprit is not None else fit_plane(config, plane.used(), beams)
        if fitted is not None and fitted.determined():
            determined[name] = fitted
    return determined


def factors_of(contents: Contents, fitted: Mapping[str, FittedPlane]) -> dict[int, GraphPart]:
    """Return the factors of planes of the contents, by their number."""
    factors = {}
    for plane, fitted_plane in fitted.items():
        plane_contents = contents.planes[plane]
        if plane_contents.number is not None:
            factors[plane_contents.number] = fitted_plane.factors(
                plane_contents.number, contents.station_numbers, plane_contents.used()
            )
    return factors


def _less(
    fitted: FittedPlane,
    contents: Contents,
    plane: str,
    rejected: tuple[Rejected, ...],
    state: BeamState,
) -> tuple[Contents, FittedPlane] | None:
    """Return contents and plane with more readings rejected; None where too few are left."""
    less = contents.rejecting(plane, rejected)
    again = fit_plane(fitted.config, less.planes[plane].used(), state.beams, fitted.origin)
    return None if again is None or not again.determined() else (less, again)


def _within_incidence(
    fitted: FittedPlane, contents: Contents, plane: str, state: BeamState
) -> tuple[Contents, FittedPlane]:
    """Reject the readings that meet the plane flatter than the sensor allows."""
    readings, config = fitted.readings, fitted.config
    if config.options.sensor.max_incidence >= 0.5 * np.pi:
        return contents, fitted
    flat = np.ones(len(readings), dtype=bool)
    flat[within_incidence(readings, fitted.parameters, config.options.sensor)] = False
    if not flat.any() or flat.all():
        return contents, fitted
    used = contents.planes[plane].used()
    rejected = named(used, fitted.mask(used, flat), FLAT)
    return _less(fitted, contents, plane, rejected, state) or (contents, fitted)


def _culprit(fitted: FittedPlane, used: Recording, state: BeamState) -> str:
    """Return the only beam without which the plane would fit; empty where there is none."""
    culprits = []
    for name in used.beam_names if len(used.beam_names) > 1 else ():
        bad = np.zeros(used.ranges.shape, dtype=bool)
        bad[:, used.beam_names.index(name)] = True
        rest = fit_plane(fitted.config, used.without(bad), state.beams, fitted.origin)
        if rest is not None and rest.determined() and rest.agrees(state):
            culprits.append(name)
    return culprits[0] if len(culprits) == 1 else ""


def _screened(
    fitted: FittedPlane, contents: Contents, plane: str, state: BeamState, history: DriftHistory
) -> tuple[Contents, FittedPlane]:
    """Reject readings that the others contradict, unless a beam that has moved explains them."""
    used = contents.planes[plane].used()
    bad = outliers(fitted, used, state)
    if bad is None or not bad.any():
        return contents, fitted
    less = _less(fitted, contents, plane, named(used, bad, CONTRADICTED), state)
    if less is None or _rather_moved(fitted, less[1], history.without_plane(plane), plane, state):
        return contents, fitted
    return less


def _rather_moved(
    fitted: FittedPlane, again: FittedPlane, known: DriftHistory, plane: str, state: BeamState
) -> bool:
    """Tell whether a beam has moved rather than that the rejected readings are gross errors.

    The explanation with the larger fall of chi2 beyond its price is believed. A reading that is
    anything within the span W of the readings costs 2 ln(W / (sqrt(2 pi) sigma)), a move ln N for each
    of its unknowns, both twice the logarithm of how rare they are.
    """
    whole = known.with_plane(plane, fitted.information(known))
    moved = whole.search(fitted.config.sigma_dof, whole.recent())
    if moved is None:
        return False
    d, sigma = fitted.readings.distance, fitted.whitening.sigma
    gone = len(d) - len(again.readings.distance)
    gross = fitted.misfit(state) - again.misfit(state)
    gross -= 2.0 * gone * (max(price(d, sigma), 0.0) - np.log(GROSS_ERROR))
    beams = len(fitted.config.names)
    move = moved.statistic - MOUNT_DIM * np.log(len(d)) - 2.0 * np.log(beams / DISPLACED)
    return bool(move > gross)
