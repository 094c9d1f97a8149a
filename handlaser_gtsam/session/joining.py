"""Planes that join: fitted beside the beams, judged, and made into factors; nothing is changed yet."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from ..arrays import BoolArray
from ..data.parameters import Beams
from ..data.recording import Recording
from ..model.families import MOUNT_DIM
from ..model.sensor import FLAT, within_incidence
from ..outliers.snooping import price
from ..solvers.isam import BeamState, GraphPart
from .config import SessionConfig
from .contents import CONTRADICTED, Contents, PlaneContents, named
from .drift import DriftHistory
from .fitted import FittedPlane, determined_plane, outliers

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
        own, before = contents.planes.get(plane), history.without_plane(plane)
        if own is None:
            history = before
            continue
        fitted = determined_plane(config, own.used(), state.beams, own.origin)
        if fitted is None:
            contents, history = contents.with_plane(plane, own.taken_out()), before
            continue
        less = _less(own, fitted, _flat(fitted, own.used()), FLAT, state)
        own, fitted = less or (own, fitted)
        if config.reject:
            # Unless a beam that has moved explains them, readings that contradict others are out.
            contradicted = outliers(fitted, own.used(), state)
            less = _less(own, fitted, contradicted, CONTRADICTED, state)
            if less is not None and not _rather_moved(fitted, less[1], before, plane, state):
                own, fitted = less
        known = fitted.information(history)
        if fitted.fits(known, history):
            history = history.with_plane(plane, known)
        else:
            history = before
            inconsistent.append(plane)
            if config.reject:
                culprit = _culprit(fitted, own.used(), state)
                contents = contents.with_plane(plane, own.taken_out(culprit))
                continue
        number = free + len(joined) if own.number is None else own.number
        own = replace(own, number=number, origin=fitted.origin, culprit=None)
        contents, joined[plane] = contents.with_plane(plane, own), fitted
    return contents, history, joined, tuple(inconsistent)


def fitted_planes(
    contents: Contents, config: SessionConfig, beams: Beams
) -> Mapping[str, FittedPlane]:
    """Return the planes that are determined beside `beams`, and not excluded."""
    taking_part = {name: p for name, p in contents.planes.items() if p.culprit is None}
    fitted = {name: determined_plane(config, p.used(), beams) for name, p in taking_part.items()}
    return {name: plane for name, plane in fitted.items() if plane is not None}


def history_of(
    config: SessionConfig, beams: Beams, fitted: Mapping[str, FittedPlane]
) -> tuple[DriftHistory, frozenset[str]]:
    """Return what planes beside `beams` know of these, and the planes that do not fit any beams."""
    history, inconsistent = DriftHistory.empty(config, beams), []
    for name, plane in fitted.items():
        information = plane.information(history)
        if plane.fits(information, history):
            history = history.with_plane(name, information)
        else:
            inconsistent.append(name)
    return history, frozenset(inconsistent)


def factors_of(contents: Contents, fitted: Mapping[str, FittedPlane]) -> dict[int, GraphPart]:
    """Return the factors of planes of the contents, by their number."""
    numbers, stations = contents.numbers, contents.station_numbers
    return {
        numbers[name]: plane.factors(numbers[name], stations, contents.planes[name].used())
        for name, plane in fitted.items()
    }


def _less(
    own: PlaneContents, fitted: FittedPlane, bad: BoolArray | None, reason: str, state: BeamState
) -> tuple[PlaneContents, FittedPlane] | None:
    """Return contents and plane with readings (M, B) rejected; None for none, or too few left."""
    if bad is None or not bad.any():
        return None
    less = replace(own, rejected=(*own.rejected, *named(own.used(), bad, reason)))
    again = determined_plane(fitted.config, less.used(), state.beams, fitted.origin)
    return None if again is None else (less, again)


def _flat(fitted: FittedPlane, used: Recording) -> BoolArray | None:
    """Return the readings (M, B) that meet the plane flatter than the sensor allows."""
    readings, sensor = fitted.readings, fitted.config.options.sensor
    if sensor.max_incidence >= 0.5 * np.pi:
        return None
    flat = np.ones(len(readings), dtype=bool)
    flat[within_incidence(readings, fitted.parameters, sensor)] = False
    return None if flat.all() else fitted.mask(used, flat)


def _culprit(fitted: FittedPlane, used: Recording, state: BeamState) -> str:
    """Return the only beam without which the plane would fit; empty where there is none."""
    culprits = []
    for name in used.beam_names if len(used.beam_names) > 1 else ():
        bad = np.zeros(used.ranges.shape, dtype=bool)
        bad[:, used.beam_names.index(name)] = True
        rest = determined_plane(fitted.config, used.without(bad), state.beams, fitted.origin)
        if rest is not None and rest.agrees(state):
            culprits.append(name)
    return culprits[0] if len(culprits) == 1 else ""


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
